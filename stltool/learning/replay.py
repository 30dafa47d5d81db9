"""A first-in, first-out memory of transitions, rows of integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.learning.kept import Kept
from stltool.learning.settings import setting
from stltool.sizes import require_memory


@dataclass(frozen=True, kw_only=True)
class Batches:
    """The settings of a method that replays batches from a memory."""

    memory: int = setting(1000, "capacity of the replay memory in transitions; the oldest leave first", least=1)
    period: int = setting(4, "steps between replays within an episode", least=1)
    batch: int = setting(64, "transitions drawn with replacement at each replay", least=1)


class ReplayMemory:
    """Holds the last `capacity` rows of `width` int32 columns."""

    def __init__(self, capacity: int, width: int) -> None:
        require_memory(4 * capacity * width, f"a replay memory of {capacity} transitions", "set a smaller memory")
        self.rows = np.zeros((capacity, width), dtype=np.int32)
        self._place = np.zeros(2, dtype=np.int64)  # next row, rows held

    @property
    def size(self) -> int:
        return int(self._place[1])

    def add(self, rows: NDArray[np.int32]) -> None:
        """Append rows (n, width); the oldest are dropped."""
        capacity, start = len(self.rows), int(self._place[0])
        kept = rows[-capacity:]
        self.rows[(start + np.arange(len(kept))) % capacity] = kept
        self._place[:] = (start + len(kept)) % capacity, min(self.size + len(kept), capacity)

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Indices of n rows, uniform with replacement."""
        return rng.integers(self.size, size=n)

    def arrays(self, most: NDArray[np.int64]) -> dict[str, Kept]:
        """Everything, for a checkpoint; `most` (width,) are the columns' greatest values."""
        return {
            "memory": Kept(self.rows, 0, most),
            "place": Kept(self._place, 0, [len(self.rows) - 1, len(self.rows)]),
        }

    def checked(self, added: int) -> NDArray[np.int32]:
        """The rows held (n, width), the newest anywhere; ValueError where `added` rows in all cannot have left them."""
        following, held = self._place.tolist()
        if held != min(added, len(self.rows)) or (held < len(self.rows) and following != held):
            raise ValueError(f"the memory holds {held} rows of {added}, and the next one is {following}")
        if self.rows[held:].any():
            raise ValueError("the memory holds rows beyond its end")
        return self.rows[:held]
