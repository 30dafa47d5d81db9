"""naive: one Q update per environment step, the paper's baseline from [15]."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.learning.tables import ClockedTable, SurrogateTable

_FIRST = np.zeros(1, dtype=np.int64)


class FaithfulNaive:
    """As published: Q(s, q, a) on the surrogate reward."""

    def __init__(self, problem: Problem, settings: Settings, outer: str, rng: np.random.Generator) -> None:
        self.table = SurrogateTable(problem, settings, outer)

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]:
        return self.table.row(t, s, q)

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self.table.update(np.array([[s, q, a, s2, q2]], dtype=np.int32), _FIRST)

    def end_episode(self) -> None:
        pass

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()


class Naive:
    """Corrected: Q_t(s, q, a) on the exact objective, the visited entry only."""

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        self.table = ClockedTable(problem, settings, count_every_entry=True)

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]:
        return self.table.row(t, s, q)

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self.table.update(t, s, q, a, s2, q2)

    def end_episode(self) -> None:
        pass

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()
