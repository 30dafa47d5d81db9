"""The policy that a run ends with: the best so far by its own data.

    P̂(π) = Σ_s starts(s) · V^π_0(s, δ(L(s), q₀)) / Σ_s starts(s)

where V^π is by the counted frequencies, with caution: of n visits of a choice, a successor seen m times has the share
m / (n + κ), and the rest fails. A Q-table moves on while it learns; what it moves to need not be better. So from time
to time its policy is compared with the best one so far, on the same data, and the better one is kept.

Whether the curve of P still moves is a question of its own (`settled`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stltool.choices import Form, Table
from stltool.learning.counts import Counts
from stltool.learning.kept import Kept
from stltool.learning.model_based import Planner, require_starts
from stltool.learning.problem import Problem

if TYPE_CHECKING:
    from stltool.learning.episode import Episode
    from stltool.learning.trainer import Point

EVERY = 20  # episodes between two comparisons
_MOVES = 0.01  # a change of P that counts


class BestSoFar:
    """The best table of choices (h, S, Q) so far, and where episodes started."""

    def __init__(self, problem: Problem, counts: Counts, caution: float) -> None:
        self._planner, self._caution = Planner(problem, counts, most=0), caution
        self.table = np.zeros(problem.shape, dtype=problem.choice_type)

    @property
    def starts(self) -> NDArray[np.int64]:
        return self._planner.starts

    def begin(self, episode: Episode) -> None:
        """Count where an episode starts."""
        if episode.verdict is None:
            self.starts[episode.s] += 1

    def end(self, policy: NDArray[Any]) -> None:
        """Keep the better of the best so far and the present policy, which is a table."""
        self.table[...] = self.better(policy)

    def better(self, policy: NDArray[Any]) -> NDArray[Any]:
        """The better of these two by the data so far, the present one of equals."""
        return policy if self.value(policy) >= self.value(self.table) else self.table

    def value(self, policy: NDArray[Any] | Form) -> float:
        """P̂ of a policy; 0 before the first episode."""
        form = Table(policy) if isinstance(policy, np.ndarray) else policy
        return self._planner.value(form, self._caution)

    def arrays(self, n_choices: NDArray[np.int64]) -> dict[str, Kept]:
        """Everything, for a checkpoint; n_choices (S,)."""
        return {"best": Kept(self.table, 0, n_choices[:, None] - 1), "starts": Kept(self.starts, 0)}

    def check(self, counts: Counts) -> None:
        require_starts(self.starts, counts)


def settled(history: Sequence[Point]) -> bool | None:
    """Whether P has come to rest: in the last quarter of the episodes it changed by at most 1/100.

    At least three evaluations are compared. None: there are fewer, or P is not known.
    """
    if not history:
        return None
    last = [point.probability for point in history if 4 * point.episode >= 3 * history[-1].episode]
    if len(last) < 3:
        last = [point.probability for point in history[-3:]]
    known = [value for value in last if value is not None]
    if len(known) < max(3, len(last)):
        return None
    return max(known) - min(known) <= _MOVES
