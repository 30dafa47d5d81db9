"""A model file → MDP, by the file's ending."""

from __future__ import annotations

from pathlib import Path

from stltool.errors import FileError
from stltool.models.formats.explicit import load_explicit
from stltool.models.grid import load_grid
from stltool.models.mdp import MDP

_LOADERS = {".toml": load_grid, ".tra": load_explicit}


def load_model(path: str | Path) -> MDP:
    """Read a model by its file's ending. Raises FileError, ModelError.

    `.toml` is a grid world (models/grid.py), `.tra` PRISM's explicit files (models/formats/explicit.py).
    """
    path = Path(path)
    loader = _LOADERS.get(path.suffix.lower())
    if loader is None:
        if not path.exists():
            raise FileError(f"{path}: there is no such model file")
        raise FileError(f"{path}: no model format has the ending {path.suffix!r}; known: {', '.join(_LOADERS)}")
    return loader(path)
