"""A model file → MDP, by the file's ending."""

from __future__ import annotations

from pathlib import Path

from stltool.errors import FileError
from stltool.models.grid import load_grid
from stltool.models.mdp import MDP

_LOADERS = {".toml": load_grid}


def load_model(path: str | Path) -> MDP:
    """Read a model. `.toml` is a grid world (models/grid.py). Raises FileError, ModelError."""
    path = Path(path)
    loader = _LOADERS.get(path.suffix.lower())
    if loader is None:
        if not path.exists():
            raise FileError(f"{path}: there is no such model file")
        raise FileError(f"{path}: no model format has the ending {path.suffix!r}; known: {', '.join(_LOADERS)}")
    return loader(path)
