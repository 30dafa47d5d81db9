"""Optimism about a choice that was tried n times: the share of its value that is hoped to be the best there is.

    h(s, a) = 1 − ε^(1/n),   ε = 1 − u^(1/b),   u uniform in [0, 1), drawn once an episode

h is the v with (1 − v)^n = ε: the greatest probability of success that n failures in a row do not refute at level ε, as
in KL-UCB [Garivier11]. The level is drawn, so that hope for a choice seen once has its posterior distribution, which is
Beta(b, 1), as in posterior sampling [Strens00]: some episodes hope for next to nothing, and now and then one hopes for
all. But the level is the same for all choices: what has been tried less promises more, and many small hopes
close by do not outdo one that is far away. If each choice drew its own, the greatest of many always would.

An untried choice is all hope, and every choice that can be reached is tried again, for ever: an unlucky
beginning does not last.

Hope leads to a paradise that satisfies the task, worth a thousandth less than 1, and less the later it is entered:
near-certain success comes first, and exploring is not postponed.

Caution is the opposite, for the policy that is judged: the share κ / (n + κ) of a choice counts as a failure, or next
to one. So where the data promise nothing, what has been tried least is preferred to what is known to fail.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST = 1e-300
_HAIR = 1e-3  # far above rounding, below any gain worth exploring for
NEXT_TO_NOTHING = 1e-12  # far above rounding of values that are next to nothing, below any that counts


def level(optimism: float, chance: Any) -> Any:
    """ε of an episode by its u, which is `chance`; b is `optimism`."""
    return 1.0 - chance ** (1.0 / optimism)


def unrefuted(visits: NDArray[Any], level: Any) -> NDArray[np.float64]:
    """h of choices tried `visits` times, in an episode of that level."""
    return np.where(visits > 0, 1.0 - level ** (1.0 / np.maximum(visits, 1)), 1.0)


def paradise(t: Any, horizon: int) -> Any:
    """What paradise is worth if it is entered after step t."""
    return 1.0 - _HAIR * (1 + t / horizon)


def nothing(t: Any) -> Any:
    """What failing is worth after step t."""
    return np.full(np.shape(t), NEXT_TO_NOTHING)


def doubt(visits: Any, caution: float) -> NDArray[np.float64]:
    """The share of choices tried `visits` times that counts as a failure; κ is `caution`."""
    share: NDArray[np.float64] = np.where(visits > 0, caution / np.maximum(visits + caution, _LEAST), 1.0)
    return share
