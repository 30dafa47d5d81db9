"""An MDP → a model file, by the file extension: what other tools read, and `load_model` reads back."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from stltool.arguments import path as path_of
from stltool.arguments import require
from stltool.errors import FileError, ModelError
from stltool.files import MARK, is_marked, require_result, write_results
from stltool.models.formats.archive import archived
from stltool.models.formats.drn_text import drn_text, is_plain
from stltool.models.formats.given import Valuation
from stltool.models.formats.tra_text import tra_texts
from stltool.models.formats.umb import LONGEST_NAMES, is_own_umb, umb_bytes
from stltool.models.mdp import MDP

WHAT = "model"
_EXPLICIT = (".tra", ".tra.gz")
_GZIP_HEAD = b"\x1f\x8b\x08\x10" + bytes(4) + b"\x02\xff"  # deflated, with a comment, at no time, by any system


def save_model(model: MDP, path: str | Path) -> None:
    """Write a model file; with its companion files, all or none. An older one that stltool wrote is replaced.

    `.umb` is the unified Markov binary format (formats/umb.py), `.drn` and `.drn.gz` Storm's text format
    (formats/drn.py), `.tra` and `.tra.gz` PRISM's explicit files (formats/explicit.py). Exact probabilities are written
    exactly. What a format cannot represent is refused: several initial states, parameters without values, black boxes.
    Left out are names of states in `.tra`, and in `.drn` signals whose names are no identifiers (with dots or without).
    Raises SettingsError and ModelError with the reason, FileError if a file cannot be written.
    """
    require(model, MDP, "save_model's model", "make models by stl.MDP.from_arrays(...) or stl.load_model(...)")
    where = path_of(path, "save_model's path")
    require_writable(where)
    write_results(model_bytes(model, where), WHAT, is_own)


def require_writable(path: Path) -> None:
    """FileError, before the work, if a model could not be written there after it."""
    if ending(path) is None:
        known = ", ".join(_WRITERS)
        raise FileError(f"{path}: models cannot be written with the extension {path.suffix!r}; write one of {known}")
    if ending(path) in _EXPLICIT:
        _require_alone(path)
    for one in files_of(path):
        require_result(one, WHAT, is_own)
    require_result(path, WHAT, is_own)


def files_of(path: Path) -> list[Path]:
    """The files of a model at `path` that exist."""
    if ending(path) in _EXPLICIT:
        return _beside(path)
    return [path] if path.exists() else []


def written_files(path: Path) -> list[Path]:
    """The files that a model at `path` may be written to, and those that are removed."""
    if ending(path) not in _EXPLICIT:
        return [path]
    stem, packed = _stem(path)
    own = [path.with_name(stem + end + packed) for end in (".lab", ".sta", ".srew", ".trew")]
    return list(dict.fromkeys([path, *own, *_beside(path)]))


def model_bytes(model: MDP, path: Path) -> Mapping[Path, bytes | None]:
    """The files of a model that is to be written to `path`; None: no such file may be left there."""
    kind = ending(path)
    assert kind is not None
    if model.parameters:
        names = " and ".join(one.name for one in model.parameters)
        raise ModelError(
            f"{model.name} depends on {names}, which {kind} files do not represent; give a value: "
            f"model.at({model.parameters[0].name}=…), on the command line -p {model.parameters[0].name}=…"
        )
    model.require_probabilities()
    first = np.flatnonzero(model.initial)
    if len(first) != 1:
        raise ModelError(
            f"runs of {model.name} start in {len(first)} states, and {kind} files have one initial state; give a model "
            "that starts in one"
        )
    marked = model.labels.get("init")
    if marked is not None and not np.array_equal(marked, model.initial > 0):
        raise ModelError(f'{kind} files mark the initial state as "init", a label of {model.name}; rename the label')
    return _WRITERS[kind](model, path)


def not_kept(model: MDP, path: Path) -> list[str]:
    """What a file at `path` does not say of the model, in words."""
    lost = []
    if ending(path) in _EXPLICIT and Valuation.of(model).others_of(model) is not None:
        lost.append("the names of its states, which PRISM's files do not have")
    if ending(path) == ".umb" and model.state_names is not None:
        names = Valuation.of(model).others_of(model)
        if names is not None and sum(map(len, names)) > LONGEST_NAMES:
            lost.append("the names of its states, which are too long for index.json")
    unwritten = [name for name in model.signals if not is_plain(name)]
    if ending(path) in (".drn", ".drn.gz") and unwritten:
        lost.append(f"signals whose names are not identifiers: {', '.join(unwritten)}")
    return lost


def ending(path: Path) -> str | None:
    """The extension of a file that can be written, such as .drn.gz; None for others."""
    name = path.name.lower()
    return next((one for one in sorted(_WRITERS, key=len, reverse=True) if name.endswith(one) and name != one), None)


def is_own(path: Path) -> bool:
    """Whether stltool wrote this file."""
    return is_marked(path) or is_own_umb(path)


def compressed(content: bytes) -> bytes:
    """A gzip file that carries our mark as its comment; always the same bytes for the same content."""
    packer = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    body = packer.compress(content) + packer.flush()
    tail = struct.pack("<II", zlib.crc32(content), len(content) & 0xFFFFFFFF)
    return _GZIP_HEAD + MARK.encode() + b"\0" + body + tail


def _drn(model: MDP, path: Path) -> Mapping[Path, bytes | None]:
    return {path: drn_text(model).encode("utf-8", errors="backslashreplace")}


def _drn_archive(model: MDP, path: Path) -> bytes:
    """As Storm does: what it reads under this extension is not a compressed text, but an archive of one."""
    name = path.name[: -len(".gz")]
    return compressed(archived({name: drn_text(model).encode("utf-8", errors="backslashreplace")}))


def _explicit(model: MDP, path: Path) -> Mapping[Path, bytes | None]:
    files: dict[Path, bytes | None] = dict.fromkeys(_beside(path))  # those of an older model are removed
    stem, packed = _stem(path)
    for end, text in tra_texts(model).items():
        content = text.encode("utf-8", errors="backslashreplace")
        files[path.with_name(stem + end + packed)] = compressed(content) if packed else content
    return files


def _stem(path: Path) -> tuple[str, str]:
    """The name of PRISM's explicit files without their endings, and whether ".gz" follows them."""
    packed = ".gz" if path.name.lower().endswith(".gz") else ""
    return path.name[: -len(".tra" + packed)], packed


def _beside(path: Path) -> list[Path]:
    """The files that are read with `path`, one of PRISM's explicit files, as far as they exist, and itself."""
    form = re.compile(re.escape(_stem(path)[0]) + r"(\.lab|\.sta|\d*\.[st]rew)(\.gz)?", re.ASCII)
    try:
        return sorted(one for one in path.parent.iterdir() if one.name == path.name or form.fullmatch(one.name))
    except OSError:
        return []


def _require_alone(path: Path) -> None:
    """FileError if there is a packed or unpacked .tra of the same name, with which labels would be shared."""
    stem, packed = _stem(path)
    other = path.with_name(stem + (".tra" if packed else ".tra.gz"))
    if other.exists():
        raise FileError(f"{path}: {other.name} next to it would be read with the same labels; name another file")


_WRITERS: dict[str, Callable[[MDP, Path], Mapping[Path, bytes | None]]] = {
    ".tra": _explicit,
    ".tra.gz": _explicit,
    ".umb": lambda model, path: {path: umb_bytes(model)},
    ".drn": _drn,
    ".drn.gz": lambda model, path: {path: _drn_archive(model, path)},
}
