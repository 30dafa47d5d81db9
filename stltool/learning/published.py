"""The engine of the methods as published (docs/reproduction.md): a surrogate table, a replay memory, ε-greedy episodes.

They differ in four things: whether each step updates online, what enters the memory (nothing, the factual tuple, or the
counterfactual ones), how tuples are drawn, and, not in [Wang24], which share of a batch is factual. Numbers are drawn
at an episode's beginning: two for each step's action, then `batch` for each replay.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.tuples import Replay
from stltool.learning.learner import Learner, Path
from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.learning.tables import SurrogateTable
from stltool.models.environment import Environment
from stltool.sizes import require_memory


class Published(Learner):
    """One of the published methods; see the module's text."""

    compiled = True
    online = True
    replays = True
    counterfactual = False
    weighted = False

    def __init__(self, problem: Problem, settings: Settings, outer: str, rng: np.random.Generator) -> None:
        self.table = SurrogateTable(problem, settings, outer)
        self._problem, self._settings, self._rng = problem, settings, rng
        self.replay = self._memory()
        self._draws = np.empty((0, 0))

    def _memory(self) -> Replay:
        settings, automaton = self._settings, self._problem.automaton
        capacity = int(settings.memory) if self.replays else 1
        imagined = np.empty(0, dtype=np.int32)
        if self.counterfactual:  # flags 0 … τ−1 only: the published off-by-one
            registers = automaton.registers
            imagined = np.flatnonzero((registers < registers.max(axis=0)).all(axis=1)).astype(np.int32)
        share = settings.factual_share if self.counterfactual else None
        n_facts = round(share * settings.batch) if share is not None else 0
        n_weights = automaton.n_states * len(imagined) if self.weighted else 0
        require_memory(
            2 * 28 * capacity + 8 * n_weights, f"a replay memory of {capacity} transitions", "set a smaller memory"
        )
        kept = capacity if n_facts else 1
        return Replay(
            online=self.online,
            period=int(settings.period) if self.replays else 0,
            rows=np.zeros((capacity, 5), dtype=np.int32),
            weight=np.zeros(capacity),
            place=np.zeros(2, dtype=np.int64),
            imagined=imagined,
            after=np.ascontiguousarray(automaton.delta[:, imagined]),
            weighted=self.weighted,
            closeness=self._closeness(imagined) if self.weighted else np.empty((0, 0)),
            n_facts=n_facts,
            facts=np.zeros((kept, 5), dtype=np.int32),
            facts_place=np.zeros(2, dtype=np.int64),
        )

    def _closeness(self, imagined: NDArray[np.int32]) -> NDArray[np.float64]:
        registers = self._problem.automaton.registers
        distance = np.zeros((len(registers), len(imagined)))
        for flag in registers.T:
            distance += np.abs(flag[:, None] - flag[imagined])
        return np.exp(-distance)

    def begin_episode(self, epsilon: float, length: int) -> None:
        super().begin_episode(epsilon, length)
        if self.replays:
            n_replays = -(-length // int(self._settings.period))
            self._draws = self._rng.random((n_replays, int(self._settings.batch)))

    def act(self, t: int, s: int, q: int, u: float, chance: float) -> int:
        from stltool.kernels import learning

        n = int(self._problem.n_choices[s])
        return int(chance * n) if u < self.epsilon else int(learning.greedy(self.table.Q[s, q], n, chance))

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        from stltool.kernels import learning

        letter = int(self._problem.letter[s2])
        learning.surrogate_observe(self.table.kernel, self.replay, self._draws, letter, t, s, q, a, s2, q2)

    def play(self, environment: Environment, explore: NDArray[np.float64]) -> Path:
        from stltool.kernels import learning

        assert environment.generator is not None
        n, automaton = len(explore), self._problem.automaton
        path = Path(np.empty(n + 1, dtype=np.int32), np.empty(n, dtype=np.int32))
        learning.surrogate_episode(
            environment.tables, self._problem.letter, automaton.delta, automaton.initial, self.table.kernel,
            self.replay, environment.generator.random(n + 1), explore, self.epsilon, self._draws, path.states,
            path.actions,
        )  # fmt: skip
        return path

    def policy_table(self) -> NDArray[Any]:
        return self.table.policy_table()

    def arrays(self) -> dict[str, NDArray[Any]]:
        replay = self.replay
        return {
            "Q": self.table.Q, "rows": replay.rows, "weight": replay.weight, "place": replay.place,
            "facts": replay.facts, "facts_place": replay.facts_place,
        }  # fmt: skip
