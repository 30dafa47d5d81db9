"""cfer: counterfactual experience replay [Wang24, Alg. 1 and eq. 14].

One real transition (s, a, s') is evidence for every automaton state q at once, since δ and the labels are known: as
published, each such tuple enters the memory; corrected, the memory holds real transitions only, and one of them
updates every open (t, q) it speaks for in one vector operation, the episode backwards.

Corrected, exploring is count-based: what was never tried in this state comes first; then, with chance ε and when the
task is violated already, what was tried least. The policy that is judged weighs values with n / (n + κ), n visits of
the choice: what was seen once is not preferred to what has proved itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.learning.learner import Learner, Path, rarest
from stltool.learning.problem import Problem
from stltool.learning.published import Published
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import Settings
from stltool.learning.tables import ClockedTable


class FaithfulCfer(Published):
    """As published: the factual update online, the counterfactual tuples into the memory, batches drawn from it."""

    counterfactual = True


class Cfer(Learner):
    """Corrected: exact objective, every open (t, q) from each real transition, replay of real transitions."""

    explores_on = True

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        self.table = ClockedTable(problem, settings, count_every_entry=False)
        self._memory = ReplayMemory(settings.memory, width=3)
        self._problem, self._settings, self._rng = problem, settings, rng

    def act(self, t: int, s: int, q: int, u: float, chance: float) -> int:
        visits = self.table.visits[s, : self._problem.n_choices[s]]
        if u < self.epsilon or visits.min() == 0:
            return rarest(visits, chance)
        return self.table.best(t, s, q, chance)

    def end_episode(self, path: Path) -> None:
        rows = path.rows()[::-1]
        np.add.at(self.table.visits, (rows[:, 0], rows[:, 1]), 1)
        self.table.update_all(rows)
        self._memory.add(rows)
        if self._settings.replays:
            self.table.update_all(self._memory.rows[self._memory.draw(self._settings.replays, self._rng)])

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()

    def arrays(self) -> dict[str, NDArray[Any]]:
        return {**self.table.arrays(), **self._memory.arrays()}
