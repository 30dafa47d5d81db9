"""A model file → MDP, by the file extension, and for TOML by its `kind`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stltool.arguments import flag, mapping
from stltool.arguments import path as path_of
from stltool.errors import FileError, ModelError, SettingsError, StlToolError
from stltool.models.composition import composition_from_table, member_files
from stltool.models.formats.drn import load_drn
from stltool.models.formats.explicit import load_explicit
from stltool.models.formats.language import JANI, PRISM, load_language
from stltool.models.formats.umb import load_umb
from stltool.models.grid import grid_from_table
from stltool.models.gymnasium.file import gymnasium_from_table
from stltool.models.mdp import MDP
from stltool.models.toml import Faults, ModelFaults, located, read_toml
from stltool.numbers import Exactable

_KINDS: dict[str, Callable[[dict[str, Any], str, bool], MDP]] = {
    "grid": grid_from_table,
    "gymnasium": gymnasium_from_table,
}


def load_model(
    path: str | Path, normalize: bool = False, *, constants: Mapping[str, Exactable | bool] | None = None
) -> MDP:
    """Read a model file. Raises FileError, and ModelError listing all faults of the file with their lines.

    `.toml` is a grid world (models/grid.py), a Gymnasium environment (models/gymnasium/file.py) or a composition of
    model files (models/composition.py), depending on its `kind`; `.tra` is PRISM's explicit format
    (models/formats/explicit.py), `.umb` the unified Markov binary format (models/formats/umb.py), `.drn` and `.drn.gz`
    Storm's text format (models/formats/drn.py); `.prism`, `.pm`, `.nm` and `.jani` are programs, which Storm builds
    (models/formats/language.py).

    normalize  rescale probabilities that miss a sum of 1 by at most 1/1000, as `MDP.from_arrays` does; so does the key
               `normalize = true` of a TOML file
    constants  name → value of constants that a program leaves open
    """
    path, normalize = path_of(path, "load_model's path"), flag(normalize, "normalize")
    known = mapping(constants, "load_model's constants", "{'N': 3}", optional=True)
    if known:
        if path.suffix.lower() not in (*PRISM, JANI):
            raise SettingsError(f"{path}: only programs in PRISM's language or JANI have constants; leave them out")
        return load_language(path, normalize, known)
    return _load(path, normalize, _Opened())


@dataclass
class _Opened:
    """The compositions that contain a file, outermost first, and the members that have been read, by path; None: faulty
    ones."""

    within: tuple[Path, ...] = ()
    known: dict[tuple[Path, bool], MDP | None] = field(default_factory=dict)


def _load(path: Path, normalize: bool, opened: _Opened) -> MDP:
    if path.suffix.lower() == ".toml":
        return _load_toml(path, normalize, opened)
    loader = next((found for ending, found in _LOADERS.items() if path.name.lower().endswith(ending)), None)
    if loader is None:
        if not path.exists():
            raise FileError(f"{path}: there is no such model file")
        known = ", ".join((".toml", *_LOADERS))
        raise FileError(f"{path}: no model format has the extension {path.suffix!r}; known extensions: {known}")
    return loader(path, normalize)


def _load_toml(path: Path, normalize: bool, opened: _Opened) -> MDP:
    table, text = read_toml(path)
    kind, faults = table.get("kind"), Faults()
    try:
        if not isinstance(kind, str) or kind not in (*_KINDS, "composition"):
            known = ", ".join(f'"{name}"' for name in _KINDS)
            faults.add("kind", f'kind is {kind!r}; write kind = {known} or "composition"')
        if not isinstance(table.get("normalize", False), bool):
            faults.add("normalize", f"normalize is {table['normalize']!r}; write true or false")
        faults.refuse()
        if kind == "composition":
            inside = _Opened((*opened.within, path.resolve()), opened.known)
            return composition_from_table(table, path, lambda file, fix: _member(file, fix, inside), normalize)
        return _KINDS[str(kind)](table, path.stem, normalize)
    except ModelFaults as error:
        raise located(path, text, error) from None
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def _member(path: Path, normalize: bool, opened: _Opened) -> MDP:
    """A member of a composition, read once. ModelError if it contains a composition that it is a member of."""
    try:
        place = path.resolve()
    except (OSError, RuntimeError) as error:  # links in a circle
        raise FileError(f"{path}: cannot be read: {error}") from None
    if place in opened.within:
        circle = [*opened.within[opened.within.index(place) :], place]
        raise ModelError(f"{' → '.join(one.name for one in circle)}: a composition cannot be its own member")
    if len(opened.within) > _DEEPEST:
        raise ModelError(f"compositions of compositions, {_DEEPEST} levels and more; write fewer")
    key = (place, normalize)
    if key not in opened.known:
        opened.known[key] = None
        opened.known[key] = _load(path, normalize, opened)
    found = opened.known[key]
    if found is None:
        raise ModelError(f"{path}: its faults are told above")
    return found


def companions(path: Path) -> list[Path]:
    """The files that are read together with a model file, if they exist: those next to it, a composition's members."""
    if path.suffix.lower() == ".toml":
        return list(dict.fromkeys(_members(path, (path,))))
    beside = (path.with_suffix(ending) for ending in _BESIDE.get(path.suffix.lower(), ()))
    return [other for other in beside if other.exists()]


def _members(path: Path, within: tuple[Path, ...]) -> Iterator[Path]:
    try:
        table, _ = read_toml(path)
        files = member_files(table, Faults()) if table.get("kind") == "composition" else {}
    except StlToolError:
        return
    for file, _, _ in files.values():
        member = path.parent / file
        if member.exists() and member not in within and len(within) <= _DEEPEST:
            yield from (member, *companions(member)) if member.suffix.lower() != ".toml" else (
                member, *_members(member, (*within, member))
            )  # fmt: skip


_DEEPEST = 10
_BESIDE = {".tra": (".lab", ".sta")}
_LOADERS: dict[str, Callable[[Path, bool], MDP]] = {
    ".tra": load_explicit,
    ".drn": load_drn,
    ".drn.gz": load_drn,
    ".umb": load_umb,
    **dict.fromkeys((*PRISM, JANI), load_language),
}
