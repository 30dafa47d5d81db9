"""naive-er: ordinary experience replay over factual transitions [Wang24, §V-B], every `period`-th step a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.learning.naive import Naive
from stltool.learning.problem import Problem
from stltool.learning.published import Published
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import Settings


class FaithfulNaiveER(Published):
    """As published: no online update; at steps 0, period, … of the episode draw `batch` with replacement."""

    online = False


class NaiveER(Naive):
    """Corrected: the same memory, its rows with their step, on the exact objective."""

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        super().__init__(problem, settings, rng)
        self._memory = ReplayMemory(settings.memory, width=6)
        self._settings, self._rng = settings, rng

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        self._memory.add(np.array([[t, s, q, a, s2, q2]], dtype=np.int32))
        if t % self._settings.period == 0:
            for row in self._memory.rows[self._memory.draw(self._settings.batch, self._rng)]:
                self.table.update(*row.tolist())

    def arrays(self) -> dict[str, NDArray[Any]]:
        return {**super().arrays(), **self._memory.arrays()}
