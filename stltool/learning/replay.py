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
        self._place = np.zeros(2, dtype=np.int64)  # next row, rows held

    @property
    def size(self) -> int:
        return int(self._place[1])

    def add(self, rows: NDArray[np.int32]) -> None:
        """Append rows (n, width); the oldest leave."""
        capacity, start = len(self.rows), int(self._place[0])
        kept = rows[-capacity:]
        self.rows[(start + np.arange(len(kept))) % capacity] = kept
        self._place[:] = (start + len(kept)) % capacity, min(self.size + len(kept), capacity)

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Indices of n rows, uniform with replacement."""
        return rng.integers(self.size, size=n)

    def arrays(self) -> dict[str, NDArray[np.int32] | NDArray[np.int64]]:
        """Everything, for a checkpoint."""
        return {"memory": self.rows, "place": self._place}
