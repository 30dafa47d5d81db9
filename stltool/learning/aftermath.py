"""After the task is violated: the rest of the episode explores, as long as it can learn anything.

It takes the choices tried least. Where an environment has ended, in a hole or at a goal that came too late, all choices
only ever lead back. Once each has done so a few times, the episode ends, and its steps are spent on others. A state
that is merely hard to leave may be taken for such a one; it is then explored only while the task is still open.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from stltool.learning.episode import Episode
from stltool.learning.learner import rarest

ENOUGH = 5  # times that each choice of a state has been tried, before it may end an episode


def aftermath(episode: Episode, tried: NDArray[Any], chance: float) -> int:
    """The choice tried least, ties broken by `chance` in [0, 1); −1 where there is nothing left to learn.

    tried (choices of the state,): how often
    """
    a = rarest(tried, chance)
    return -1 if tried[a] >= ENOUGH and episode.stuck else a
