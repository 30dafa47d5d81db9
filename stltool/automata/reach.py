"""Which combinations of several machines' states a run can be in, found breadth first on whole-number codes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.sizes import require_numbered

Codes: TypeAlias = NDArray[np.int64]


def reachable(
    start: int, after: Callable[[Codes], Codes], guard: Callable[[int], None]
) -> tuple[Codes, NDArray[np.int32]]:
    """The codes reachable from `start`, ascending, and delta (n_letters, n_codes) over their places.

    `after` maps codes (n,) to their successors (n_letters, n). `guard` is told how many are known after each step and
    raises where they become too many. Raises SizeError where they are more than int32 can number.
    """
    known = frontier = np.array([start], dtype=np.int64)
    while frontier.size:
        frontier = np.setdiff1d(after(frontier).ravel(), known)
        known = np.union1d(known, frontier)
        guard(len(known))
        require_numbered(len(known), "combinations of automaton states", "shorten the windows")
    return known, np.searchsorted(known, after(known)).astype(np.int32)
