"""cfer: counterfactual experience replay (paper, Algorithm 1 and eq. 14).

One real transition (s, a, s') is evidence for every automaton state q at once, since δ and the labels are known: as
published, each such tuple enters the memory; corrected, the memory holds real transitions only, and one of them
updates every (t, q) it speaks for in one vector operation, the episode backwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.learning.naive_er import FaithfulNaiveER
from stltool.learning.problem import Problem
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import Settings
from stltool.learning.tables import ClockedTable

_FIRST = np.zeros(1, dtype=np.int64)


class FaithfulCfer(FaithfulNaiveER):
    """As published: the factual update online, the counterfactual tuples into the memory, batches drawn from it.

    Counterfactual flags run over 0 … τ−1 only, the published off-by-one.
    """

    def __init__(self, problem: Problem, settings: Settings, outer: str, rng: np.random.Generator) -> None:
        super().__init__(problem, settings, outer, rng)
        registers = problem.automaton.registers
        self._imagined = np.flatnonzero((registers < registers.max(axis=0)).all(axis=1)).astype(np.int32)
        self._after = problem.automaton.delta[:, self._imagined]
        self._letter = problem.letter

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self.table.update(np.array([[s, q, a, s2, q2]], dtype=np.int32), _FIRST)
        rows = np.empty((len(self._imagined), 5), dtype=np.int32)
        rows[:] = (s, 0, a, s2, 0)
        rows[:, 1], rows[:, 4] = self._imagined, self._after[self._letter[s2]]
        self._memory.add(rows)
        self.replay(t)


class Cfer:
    """Corrected: exact objective, every live (t, q) from each real transition, replay of real transitions."""

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        self.table = ClockedTable(problem, settings, count_every_entry=False)
        self._memory = ReplayMemory(settings.memory, width=3)
        self._episode: list[tuple[int, int, int]] = []
        self._settings, self._rng = settings, rng

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]:
        return self.table.row(t, s, q)

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self._episode.append((s, a, s2))

    def end_episode(self) -> None:
        for s, a, s2 in reversed(self._episode):
            self.table.visits[s, a] += 1
            self.table.update_all(s, a, s2)
        self._memory.add(np.array(self._episode, dtype=np.int32))
        self._episode.clear()
        for i in self._memory.draw(self._settings.replays, self._rng):
            s, a, s2 = self._memory.rows[i].tolist()
            self.table.update_all(s, a, s2)

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()
