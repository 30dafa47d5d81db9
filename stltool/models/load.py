"""A model file → MDP, by the file extension, and for TOML by its `kind`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stltool.arguments import flag
from stltool.arguments import path as path_of
from stltool.errors import FileError, ModelError
from stltool.models.formats.explicit import load_explicit
from stltool.models.grid import grid_from_table
from stltool.models.gymnasium.file import gymnasium_from_table
from stltool.models.mdp import MDP
from stltool.models.toml import Faults, ModelFaults, located, read_toml

_KINDS: dict[str, Callable[[dict[str, Any], str, bool], MDP]] = {
    "grid": grid_from_table,
    "gymnasium": gymnasium_from_table,
}


def load_model(path: str | Path, normalize: bool = False) -> MDP:
    """Read a model file. Raises FileError, and ModelError listing all faults of the file with their lines.

    `.toml` is a grid world (models/grid.py) or a Gymnasium environment (models/gymnasium/file.py), depending on its
    `kind`; `.tra` is PRISM's explicit format (models/formats/explicit.py). `normalize` rescales probabilities that miss
    a sum of 1 by at most 1/1000, as `MDP.from_arrays` does; so does the key `normalize = true` of a TOML file.
    """
    path, normalize = path_of(path, "load_model's path"), flag(normalize, "normalize")
    loader = _LOADERS.get(path.suffix.lower())
    if loader is None:
        if not path.exists():
            raise FileError(f"{path}: there is no such model file")
        known = ", ".join(_LOADERS)
        raise FileError(f"{path}: no model format has the extension {path.suffix!r}; known extensions: {known}")
    return loader(path, normalize)


def _load_toml(path: Path, normalize: bool) -> MDP:
    table, text = read_toml(path)
    kind, faults = table.get("kind"), Faults()
    try:
        if not isinstance(kind, str) or kind not in _KINDS:
            known = " or ".join(f'kind = "{name}"' for name in _KINDS)
            faults.add("kind", f"kind is {kind!r}; write {known}")
        if not isinstance(table.get("normalize", False), bool):
            faults.add("normalize", f"normalize is {table['normalize']!r}; write true or false")
        faults.refuse()
        return _KINDS[str(kind)](table, path.stem, normalize)
    except ModelFaults as error:
        raise located(path, text, error) from None
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def companions(path: Path) -> list[Path]:
    """The files next to a model file that are read together with it, if they exist."""
    beside = (path.with_suffix(ending) for ending in _BESIDE.get(path.suffix.lower(), ()))
    return [other for other in beside if other.exists()]


_BESIDE = {".tra": (".lab", ".sta")}
_LOADERS: dict[str, Callable[[Path, bool], MDP]] = {".toml": _load_toml, ".tra": load_explicit}
