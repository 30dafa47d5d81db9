"""naive: one Q update per environment step, the baseline of [Wang24, §V-B]."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.learning.learner import Learner
from stltool.learning.problem import Problem
from stltool.learning.published import Published
from stltool.learning.settings import Settings
from stltool.learning.tables import ClockedTable


class FaithfulNaive(Published):
    """As published: Q(s, q, a) on the surrogate reward, no memory."""

    replays = False


class Naive(Learner):
    """Corrected: Q_t(s, q, a) on the exact objective, the visited entry only."""

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        self.table = ClockedTable(problem, settings, count_every_entry=True)
        self._n_choices = problem.n_choices

    def act(self, t: int, s: int, q: int, u: float, chance: float) -> int:
        if u < self.epsilon:
            return int(chance * self._n_choices[s])
        return self.table.best(t, s, q, chance)

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self.table.update(t, s, q, a, s2, q2)

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()

    def arrays(self) -> dict[str, NDArray[Any]]:
        return self.table.arrays()
