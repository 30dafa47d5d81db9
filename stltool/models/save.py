"""An MDP → a model file, by the file extension: what other tools read, and `load_model` reads back."""

from __future__ import annotations

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
from stltool.models.formats.drn_text import drn_text
from stltool.models.formats.umb import is_own_umb, umb_bytes
from stltool.models.mdp import MDP

WHAT = "model"
_GZIP_HEAD = b"\x1f\x8b\x08\x10" + bytes(4) + b"\x02\xff"  # deflated, with a comment, at no time, by any system


def save_model(model: MDP, path: str | Path) -> None:
    """Write a model file; with its companion files, all or none. An older one that stltool wrote is replaced.

    `.umb` is the unified Markov binary format (formats/umb.py), `.drn` Storm's text format (formats/drn.py), both read
    by Storm and others; `.drn.gz` is compressed. Exact probabilities are written as fractions. What a format cannot
    represent is refused: several initial states, parameters without values, black boxes.
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
    require_result(path, WHAT, is_own)


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


_WRITERS: dict[str, Callable[[MDP, Path], Mapping[Path, bytes | None]]] = {
    ".umb": lambda model, path: {path: umb_bytes(model)},
    ".drn": _drn,
    ".drn.gz": lambda model, path: {path: _drn_archive(model, path)},
}
