"""An array that a checkpoint stores, with the range of its values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Kept:
    """`values` are read back in place if they lie between `least` and `most` (numbers, or arrays that broadcast).

    Entries that are infinite when a run starts stay so; no others may be infinite, and none is NaN.
    """

    values: NDArray[Any]
    least: ArrayLike = -math.inf
    most: ArrayLike = math.inf

    def take(self, name: str, array: NDArray[Any]) -> None:
        """Read `array` into place; ValueError, naming the entry, unless it has the shape, the type and the range."""
        here = self.values
        if (array.dtype, array.shape) != (here.dtype, here.shape):
            raise ValueError(
                f"{name} is {array.dtype} of shape {array.shape}; it must be {here.dtype} of shape {here.shape}"
            )
        infinite = np.isinf(here)
        bad = np.where(infinite, array != here, ~((array >= self.least) & (array <= self.most) & np.isfinite(array)))
        if bad.any():
            entry = tuple(np.argwhere(bad)[0].tolist())
            raise ValueError(f"{name}{list(entry)} is {array[entry]}, which is out of range")
        here[...] = array
