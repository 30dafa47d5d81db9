"""model-based: learned transition counts, optimism where nothing is known, planning with the checker's kernels.

Acting (R-max [Brafman02]): a choice taken fewer than `known_after` times leads to a paradise that
satisfies the task; others follow their counted frequencies. Paradise is worth a thousandth less than 1, the later the
less: what is as good as sure comes first, and exploring is not put off. The plan is made anew whenever a choice becomes
known, and at every episode's beginning. When the task is violated already, the rest of the episode takes what was tried
least.

The policy that is judged trusts counts with caution: of n(s,a) visits, successor s' has the share n(s,a,s') / (n + κ),
and the rest fails. So a choice seen once is not preferred to one that has proved itself many times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.learning.counts import Counts
from stltool.learning.learner import Learner, rarest
from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.sizes import Numbers, require_memory

_HAIR = 1e-3  # what paradise lacks of 1: far above rounding, below what is worth exploring for


class ModelBased(Learner):
    """Acts on an optimistic plan, is judged by a cautious one; see the module's text."""

    explores_on = True

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator) -> None:
        automaton, S = problem.automaton, problem.n_states
        layer, itemsize = S * automaton.n_states, np.dtype(problem.choice_type).itemsize
        require_memory(
            (itemsize * automaton.horizon + 24) * layer,
            f"planning {automaton.horizon} steps of {layer} product states",
            "shorten the windows",
        )
        self._problem, self._settings = problem, settings
        self._choice_start = np.concatenate([[0], np.cumsum(problem.n_choices)]).astype(np.int64)
        self._counts = Counts(int(self._choice_start[-1]), S)
        self._visits = np.zeros(self._counts.n_choices, dtype=np.int64)
        self._plan = np.zeros((automaton.horizon, S, automaton.n_states), dtype=problem.choice_type)

    def begin_episode(self, epsilon: float, length: int) -> None:
        super().begin_episode(epsilon, length)
        self._replan(0)

    def act(self, t: int, s: int, q: int, u: float, chance: float) -> int:
        if u < 0:
            first, after = self._choice_start[s], self._choice_start[s + 1]
            return rarest(self._visits[first:after], chance)
        return int(self._plan[t, s, q])

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        choice = int(self._choice_start[s]) + a
        self._counts.add(np.array([choice], dtype=np.int64), np.array([s2], dtype=np.int64))
        self._visits[choice] += 1
        if self._visits[choice] == self._settings.known_after:
            self._replan(t + 1)

    def policy_table(self) -> NDArray[Any]:
        table = np.zeros_like(self._plan)
        self._induct(*self._rows(1, self._settings.caution), lambda t: 0.0, 0, table)
        return table

    def arrays(self) -> dict[str, NDArray[Any]]:
        return {**self._counts.arrays(), "visits": self._visits}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._counts.restore(arrays)
        self._visits[:] = arrays["visits"]

    def _replan(self, t: int) -> None:
        """The optimistic plan of the steps from t on."""
        h = self._problem.automaton.horizon
        rows = self._rows(self._settings.known_after, 0.0)
        self._induct(*rows, lambda step: 1.0 - _HAIR * (1 + step / h), t, self._plan)

    def _rows(
        self, known_after: int, caution: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
        """CSR rows over the model's states and one more, outside: where unknown choices and doubts lead."""
        counts, outside = self._counts, self._problem.n_states
        choice, target, seen = counts.choice, counts.target, counts.seen
        trusted = self._visits >= max(known_after, 1)
        kept = trusted[choice]
        doubtful = np.arange(counts.n_choices) if caution else np.flatnonzero(~trusted)
        doubt = np.where(trusted, caution / (self._visits + caution) if caution else 0.0, 1.0)[doubtful]
        rows = np.concatenate([choice[kept], doubtful])
        order = np.argsort(rows, kind="stable")
        probability = np.concatenate([seen[kept] / (self._visits[choice[kept]] + caution), doubt])[order]
        successor = np.concatenate([target[kept], np.full(len(doubtful), outside)])[order].astype(np.int32)
        length = np.bincount(rows, minlength=counts.n_choices)
        return np.concatenate([[0], np.cumsum(length)]).astype(np.int64), successor, probability

    def _induct(
        self,
        row_start: NDArray[np.int64],
        target: NDArray[np.int32],
        probability: NDArray[np.float64],
        outside: Callable[[int], float],
        first: int,
        table: Numbers,
    ) -> None:
        """Backward induction to step `first`, the choices into `table`; being outside is worth `outside(t)`."""
        from stltool.kernels import sweep

        problem, automaton = self._problem, self._problem.automaton
        S, h = problem.n_states, automaton.horizon
        values, out = np.zeros((S, automaton.n_states)), np.empty((S, automaton.n_states))
        W = np.empty((S + 1, automaton.n_states))
        _decide(automaton.verdicts(h), values)
        for t in range(h - 1, first - 1, -1):
            sweep.gather(values, problem.letter, automaton.delta, 0, S, W)
            W[S] = outside(t)
            sweep.optimum(self._choice_start, row_start, target, probability, W, True, 0, S, out, table[t])
            _decide(automaton.verdicts(t), out)
            values, out = out, values


def _decide(verdicts: NDArray[np.int8], values: NDArray[np.float64]) -> None:
    values[:, verdicts == TRUE] = 1.0
    values[:, verdicts == FALSE] = 0.0
