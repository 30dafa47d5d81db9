"""The two Q-tables: the paper's stationary one on its surrogate reward, and the exact one that carries the clock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TRUE
from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.sizes import require_memory


class SurrogateTable:
    """Q(s, q, a) on the surrogate reward, as published: stationary, discounted, bootstrapping past the end.

    The reward of arriving in q' is 2χ − 1 under an outer F and χ − offset under an outer G, where χ is the truth of
    the inner formula that q' shows (paper eq. 12 up to e^−50, Table I).
    """

    def __init__(self, problem: Problem, settings: Settings, outer: str) -> None:
        automaton = problem.automaton
        shape = (problem.n_states, automaton.n_states, problem.most_choices)
        _require_table(shape)
        self.Q = np.zeros(shape)
        unavailable = np.arange(shape[2]) >= problem.n_choices[:, None, None]
        self.Q[np.broadcast_to(unavailable, shape)] = -np.inf
        chi = (automaton.verdict_rows[-1] == TRUE).astype(np.float64)
        offset = 0.5 if settings.scale == "published" else 0.9
        self.reward = 2 * chi - 1 if outer == "F" else chi - offset
        self._settings = settings

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]:
        """The values of the choices in (s, q)."""
        values: NDArray[np.float64] = self.Q[s, q]
        return values

    def update(self, tuples: NDArray[np.int32], drawn: NDArray[np.int64]) -> None:
        """One update for each drawn row (s, q, a, s', q') of `tuples`."""
        from stltool.kernels import learning

        learning.surrogate_updates(self.Q, self.reward, tuples, drawn, self._settings.alpha, self._settings.gamma)

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy, uniform over ties: (S, Q, C) weights."""
        best = self.Q.max(axis=2, keepdims=True) == self.Q
        weights: NDArray[np.float64] = best / best.sum(axis=2, keepdims=True)
        return weights


class ClockedTable:
    """Q_t(s, q, a) on the exact objective: γ = 1, value 1 or 0 where the verdict falls, learned backwards in t.

    V starts at 0 where undecided; step sizes are max(least_step, 1/n).
    """

    def __init__(self, problem: Problem, settings: Settings, count_every_entry: bool) -> None:
        automaton = problem.automaton
        h, n = automaton.horizon, automaton.n_states
        shape = (problem.n_states, problem.most_choices, h, n)
        _require_table(shape)
        self.Q = np.zeros(shape)
        self.V = np.zeros((problem.n_states, h + 1, n))
        for t in range(h + 1):
            self.V[:, t, automaton.verdicts(t) == TRUE] = 1.0
        self.live = automaton.live()
        self.visits = np.zeros(shape if count_every_entry else shape[:2], dtype=np.int32)
        current = self.live.any(axis=0)
        self._memory = [np.intersect1d(row, np.flatnonzero(current)).astype(np.int32) for row in automaton.delta]
        self._problem = problem
        self._least = settings.least_step

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]:
        """The values of the choices in (t, s, q)."""
        values: NDArray[np.float64] = self.Q[s, : self._problem.n_choices[s], t, q]
        return values

    def update(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        """The factual update of one entry."""
        from stltool.kernels import learning

        n_choices = int(self._problem.n_choices[s])
        learning.clocked_update(self.Q, self.V, self.visits, self.live, t, s, q, a, s2, q2, n_choices, self._least)

    def update_all(self, s: int, a: int, s2: int) -> None:
        """Every (t, q) that a real transition speaks for."""
        from stltool.kernels import learning

        problem = self._problem
        learning.clocked_transition(
            self.Q, self.V, self.live, self._memory[problem.letter[s]],
            problem.automaton.delta[problem.letter[s2]], s, a, s2, int(problem.n_choices[s]),
            max(self._least, 1.0 / max(1, self.visits[s, a])),
        )  # fmt: skip

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy, the first of ties: (h, S, Q) choices."""
        table = np.empty((self.Q.shape[2], self.Q.shape[0], self.Q.shape[3]), dtype=np.int16)
        for s, n_choices in enumerate(self._problem.n_choices):
            table[:, s] = self.Q[s, :n_choices].argmax(axis=0)
        return table


def _require_table(shape: tuple[int, ...]) -> None:
    entries = int(np.prod([float(n) for n in shape]))
    require_memory(2 * 8 * entries, f"a Q-table of {' × '.join(str(n) for n in shape)} entries", "shorten the windows")
