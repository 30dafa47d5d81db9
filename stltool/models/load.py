"""A model file → MDP, by the file's ending, and in TOML by its `kind`."""

from __future__ import annotations

from pathlib import Path

from stltool.arguments import path as path_of
from stltool.errors import FileError, ModelError
from stltool.models.formats.explicit import load_explicit
from stltool.models.grid import grid_from_table
from stltool.models.gymnasium.file import gymnasium_from_table
from stltool.models.mdp import MDP
from stltool.models.toml import Fault, line_of, read_toml

_KINDS = {"grid": grid_from_table, "gymnasium": gymnasium_from_table}


def load_model(path: str | Path) -> MDP:
    """Read a model by its file's ending. Raises FileError, ModelError.

    `.toml` is a grid world (models/grid.py) or a Gymnasium environment (models/gymnasium/file.py), as its `kind` says;
    `.tra` PRISM's explicit files (models/formats/explicit.py).
    """
    path = path_of(path, "load_model's path")
    loader = _LOADERS.get(path.suffix.lower())
    if loader is None:
        if not path.exists():
            raise FileError(f"{path}: there is no such model file")
        raise FileError(f"{path}: no model format has the ending {path.suffix!r}; known: {', '.join(_LOADERS)}")
    return loader(path)


def _load_toml(path: Path) -> MDP:
    table, text = read_toml(path)
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        known = " or ".join(f'kind = "{name}"' for name in _KINDS)
        raise ModelError(f"{path}{line_of(text, 'kind')}: kind is {kind!r}; write {known}")
    try:
        return _KINDS[kind](table, path.stem)
    except Fault as fault:
        raise ModelError(f"{path}{line_of(text, *fault.place)}: {fault}") from None
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


_LOADERS = {".toml": _load_toml, ".tra": load_explicit}
