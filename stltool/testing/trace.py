"""A trace that prints as Python code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Trace(dict[str, "NDArray[np.float64] | NDArray[np.bool_]"]):
    """A trace: name → array (n_steps,), which prints as Python code, {'x': [0.0, 0.5], 'a': [True, False]}."""

    def __repr__(self) -> str:
        return "{" + ", ".join(f"{name!r}: {array.tolist()!r}" for name, array in self.items()) + "}"
