"""A first-in first-out memory of transitions, rows of whole numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.sizes import require_memory


class ReplayMemory:
    """Holds the last `capacity` rows of `width` int32 columns."""

    def __init__(self, capacity: int, width: int) -> None:
        require_memory(4 * capacity * width, f"a replay memory of {capacity} transitions", "set a smaller memory")
        self.rows = np.zeros((capacity, width), dtype=np.int32)
        self.size = 0
        self._next = 0

    def add(self, rows: NDArray[np.int32]) -> None:
        """Append rows (n, width); the oldest leave."""
        rows = rows[-len(self.rows) :]
        end = self._next + len(rows)
        if end <= len(self.rows):
            self.rows[self._next : end] = rows
        else:
            split = len(self.rows) - self._next
            self.rows[self._next :], self.rows[: end - len(self.rows)] = rows[:split], rows[split:]
        self._next = end % len(self.rows)
        self.size = min(self.size + len(rows), len(self.rows))

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Indices of n rows, uniform with replacement."""
        return rng.integers(self.size, size=n)
