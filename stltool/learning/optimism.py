"""Optimism about a choice that was tried n times: the share of its value that is hoped to be the best there is.

    h(s, a) = max( b / (n + b),  1 − r^(−1/2n) ),   r = max(1, N / (C·n)),   N visits of the state, which has C choices

The first term is one for beginners: an untried choice is all hope, and what has been tried is soon trusted. The second
one is the v with (1 − v)^n = r^(−1/2), the value that n failures in a row do not refute at that level, as in KL-UCB
[Garivier11]: a choice that is neglected while its state is visited again and again regains all hope. So every choice
that can be reached is tried again, for ever, and an unlucky beginning does not last.

Hope leads to a paradise that satisfies the task, worth a thousandth less than 1, and less the later it is entered:
near-certain success comes first, and exploring is not postponed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_HAIR = 1e-3  # far above rounding, below any gain worth exploring for


def hope(visits: NDArray[Any], of_state: NDArray[Any], optimism: float) -> NDArray[np.float64]:
    """h of choices tried `visits` times; `of_state`: the mean of the visits of their state's choices."""
    n = np.maximum(visits, 1)
    neglected: NDArray[np.float64] = 1.0 - np.maximum(of_state / n, 1.0) ** (-0.5 / n)
    return np.maximum(optimism / (visits + optimism), neglected)


def paradise(t: Any, horizon: int) -> Any:
    """What paradise is worth if it is entered after step t."""
    return 1.0 - _HAIR * (1 + t / horizon)
