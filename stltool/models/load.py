"""A model file → MDP, by the file extension, and for TOML by its `kind`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stltool.arguments import mapping
from stltool.arguments import path as path_of
from stltool.errors import FileError, ModelError, SettingsError, StlToolError, marked
from stltool.models.composition import composition_from_table, member_files
from stltool.models.formats.drn import load_drn
from stltool.models.formats.explicit import companions as explicit_files
from stltool.models.formats.explicit import load_explicit
from stltool.models.formats.language import JANI, PRISM, load_language
from stltool.models.formats.umb import load_umb
from stltool.models.grid import grid_from_table
from stltool.models.gymnasium.file import gymnasium_from_table
from stltool.models.loading import Deadlocks, Loading, started
from stltool.models.mdp import MDP
from stltool.models.toml import Faults, ModelFaults, located, read_toml
from stltool.numbers import Exactable

_KINDS: dict[str, Callable[[dict[str, Any], str, bool], MDP]] = {
    "grid": grid_from_table,
    "gymnasium": gymnasium_from_table,
}


def load_model(
    path: str | Path,
    normalize: bool = False,
    *,
    initial: str | int | Sequence[str | int] | None = None,
    deadlocks: Deadlocks = "loop",
    constants: Mapping[str, Exactable | bool] | None = None,
) -> MDP:
    """Read a model file. Raises FileError, and ModelError listing all faults of the file with their lines.

    `.toml` is a grid world (models/grid.py), a Gymnasium environment (models/gymnasium/file.py) or a composition of
    model files (models/composition.py), depending on its `kind`; `.tra` and `.tra.gz` are PRISM's explicit format, or
    Storm's (models/formats/explicit.py), `.umb` is the unified Markov binary format (models/formats/umb.py), `.drn` and
    `.drn.gz` are Storm's text format (models/formats/drn.py); `.prism`, `.pm`, `.nm`, `.sm` and `.jani` are programs,
    which Storm builds (models/formats/language.py).

    normalize  rescale probabilities that miss a sum of 1 by at most 1/1000, as `MDP.from_arrays` does; so does the key
               `normalize = true` of a TOML file
    initial    where runs start: the name or the number of a state; a list of them: in each with the same probability;
               or "uniform": so in the file's initial states, for formats that mark several without probabilities
    deadlocks  states without transitions stay where they are ("loop", as in PRISM; `notes` names them), or are refused
               ("error")
    constants  name → value of constants that a program leaves open
    """
    path, loading = path_of(path, "load_model's path"), Loading.of(normalize, initial, deadlocks)
    known = mapping(constants, "load_model's constants", "{'N': 3}", optional=True)
    if known:
        if path.suffix.lower() not in (*PRISM, JANI):
            raise SettingsError(f"{path}: only programs in PRISM's language or JANI have constants; leave them out")
        return load_language(path, loading, known)
    return _load(path, loading, _Opened())


@dataclass
class _Opened:
    """The compositions that contain a file, outermost first, and the members that have been read, by path; None: faulty
    ones."""

    within: tuple[Path, ...] = ()
    known: dict[tuple[Path, Loading], MDP | None] = field(default_factory=dict)


def _load(path: Path, loading: Loading, opened: _Opened) -> MDP:
    if path.suffix.lower() == ".toml":
        return started(_load_toml(path, loading, opened), loading)
    loader = next((found for ending, found in _LOADERS.items() if path.name.lower().endswith(ending)), None)
    if loader is None:
        if not os.path.exists(path):
            raise FileError(f"{path}: there is no such model file")
        if os.path.isdir(path):
            raise FileError(f"{path}: this is a folder; name a model file")
        known = ", ".join((".toml", *_LOADERS))
        raise FileError(f"{path}: no model format has the extension {path.suffix!r}; known extensions: {known}")
    return loader(path, loading)


def _load_toml(path: Path, loading: Loading, opened: _Opened) -> MDP:
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
            inner = replace(loading, initial=())
            return composition_from_table(
                table, path, lambda file, fix: _member(file, replace(inner, normalize=fix), inside), loading.normalize
            )
        return _KINDS[str(kind)](table, path.stem, loading.normalize)
    except ModelFaults as error:
        raise located(path, text, error) from None
    except ModelError as error:
        raise ModelError(f"{path}: {marked(error)}") from None


def _member(path: Path, loading: Loading, opened: _Opened) -> MDP:
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
    key = (place, loading)
    if key not in opened.known:
        opened.known[key] = None
        opened.known[key] = _load(path, loading, opened)
    found = opened.known[key]
    if found is None:
        raise ModelError(f"{path}: its faults are told above")
    return found


def companions(path: Path) -> list[Path]:
    """The files that are read together with a model file, if they exist: those next to it, a composition's members."""
    if path.suffix.lower() == ".toml":
        return list(_members(path, {Path(os.path.realpath(path))}))
    return explicit_files(path) if path.name.lower().endswith((".tra", ".tra.gz")) else []


def _members(path: Path, seen: set[Path]) -> Iterator[Path]:
    """The members of a composition, theirs, and so on, each once; none of a file that cannot be read."""
    try:
        table, _ = read_toml(path)
        files = member_files(table, Faults()) if table.get("kind") == "composition" else {}
    except StlToolError:
        return
    for file, _, _ in files.values():
        member = path.parent / file
        if os.path.exists(member) and (place := Path(os.path.realpath(member))) not in seen:
            seen.add(place)
            yield member
            yield from _members(member, seen) if member.suffix.lower() == ".toml" else companions(member)


_DEEPEST = 10
_LOADERS: dict[str, Callable[[Path, Loading], MDP]] = {
    ".tra": load_explicit,
    ".tra.gz": load_explicit,
    ".drn": load_drn,
    ".drn.gz": load_drn,
    ".umb": load_umb,
    **dict.fromkeys((*PRISM, JANI), load_language),
}
