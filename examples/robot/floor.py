"""The factory floor in metres. A cell is 1 m wide; x points to the right and y upwards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stltool as stl

_HERE = Path(__file__).resolve().parent
FACTORY = _HERE if (_HERE / "floor-5x5.toml").exists() else _HERE.parent / "factory"  # a copy has its files beside it

HALF = 0.36
"""Half the width of a wall block. Blocks as wide as their cell would touch at the corners, and a diagonal move past one
would be impossible; these leave a robot some 4 cm on either side."""

STEPS = {
    "stay": (0, 0), "N": (0, 1), "S": (0, -1), "W": (-1, 0), "E": (1, 0),
    "NW": (-1, 1), "SW": (-1, -1), "NE": (1, 1), "SE": (1, -1),
}  # fmt: skip


@dataclass(frozen=True)
class Oil:
    """A patch of oil: a disc, in metres."""

    x: float
    y: float
    radius: float


OIL = (Oil(2.5, 1.5, 0.35), Oil(3.5, 1.5, 0.35))
"""Where the shortest way from the start to A ends and turns: who loses grip there can neither stop nor turn."""


@dataclass(frozen=True, eq=False)
class Floor:
    """What a plant needs to know of a grid model, and where its cells are.

    nominal   the model with made-up probabilities: its states are the cells, in the same order
    centres   (S, 2) of the cells;  blocks (B, 2) of the walls
    target    (S, A): the cell at which a move aims; its own where a wall or the edge is in the way
    start     the cell where every run starts
    """

    nominal: stl.MDP
    width: int
    height: int
    centres: NDArray[np.float64]
    blocks: NDArray[np.float64]
    target: NDArray[np.int64]
    start: int
    oil: tuple[Oil, ...]

    @classmethod
    def of(cls, nominal: stl.MDP, oil: tuple[Oil, ...] = OIL) -> Floor:
        """The floor of a grid model with king moves."""
        layout = nominal.layout
        cells = list(zip(layout.column.tolist(), layout.row.tolist(), strict=True))
        index = {cell: s for s, cell in enumerate(cells)}
        walls = [(x, y) for x in range(layout.width) for y in range(layout.height) if (x, y) not in index]
        steps = [STEPS[name] for name in nominal.action_names]
        target = [[index.get((x + dx, y + dy), s) for dx, dy in steps] for s, (x, y) in enumerate(cells)]
        return cls(
            nominal, layout.width, layout.height, np.array(cells) + 0.5, np.array(walls).reshape(-1, 2) + 0.5,
            np.array(target), int(nominal.initial.argmax()), oil,
        )  # fmt: skip

    def cells(self, xy: NDArray[np.float64]) -> NDArray[np.int64]:
        """The free cell nearest to each position (n, 2): a robot that leans on a wall is in the cell next to it."""
        away = xy[:, None] - self.centres
        nearest: NDArray[np.int64] = np.einsum("nsi,nsi->ns", away, away).argmin(axis=1)
        return nearest

    def oily(self, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which positions (..., 2) lie in oil."""
        found = np.zeros(xy.shape[:-1], dtype=np.bool_)
        for patch in self.oil:
            found |= np.hypot(xy[..., 0] - patch.x, xy[..., 1] - patch.y) < patch.radius
        return found


def factory(oil: tuple[Oil, ...] = OIL) -> Floor:
    """The paper's floor of 5 × 5 cells, with oil."""
    return Floor.of(stl.load_model(FACTORY / "floor-5x5.toml"), oil)
