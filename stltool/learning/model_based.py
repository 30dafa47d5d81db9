"""model-based: learned transition counts, optimism about the unknown, planning with the kernels of the checker.

Acting (R-max [Brafman02]): a choice taken fewer than `known_after` times leads to a paradise that
satisfies the task; others follow their counted frequencies. Paradise is worth a thousandth less than 1, and less the
later it is entered: near-certain success comes first, and exploring is not postponed. The plan is recomputed whenever a
choice becomes known, and at the beginning of every episode. Once the task is violated, the rest of the episode takes
the choices tried least.

The policy that is judged trusts counts with caution: of n(s,a) visits, successor s' has the share n(s,a,s') / (n + κ),
and the rest fails. So a choice seen once is not preferred to one that has proved itself many times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner, rarest
from stltool.learning.problem import Problem
from stltool.learning.settings import setting
from stltool.sizes import Numbers, require_memory

_HAIR = 1e-3  # how much less than 1 paradise is worth: far above rounding, below any gain worth exploring for


@dataclass(frozen=True, kw_only=True)
class ModelBased(Learner["Planner"]):
    """Acts on an optimistic plan over the counted transitions; a cautious plan gives the judged policy."""

    name: ClassVar[str] = "model-based"

    known_after: int = setting(1, "visits after which planning uses the counts of a choice, not optimism", least=1)
    caution: float = setting(0.1, "κ in the judged policy's weight n / (n + κ) for a choice seen n times", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> Planner:
        return Planner(problem, counts)

    def episode(self, state: Planner, episode: Episode) -> None:
        chances = episode.rng.random((episode.length, 2))[:, 1].tolist()
        visits = state.counts.visits
        self.replan(state, visits, 0)
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            first, after = state.problem.first_choice[s : s + 2].tolist()
            if episode.verdict is False:
                a = rarest(visits[first:after], chances[t])
            else:
                a = int(state.plan[t, s, episode.q])
            episode.step(a)
            visits[first + a] += 1
            if visits[first + a] == self.known_after:
                self.replan(state, visits, t + 1)

    def replan(self, state: Planner, visits: NDArray[np.int64], t: int) -> None:
        """The optimistic plan of the steps from t on, after choices were taken `visits` times."""
        h = state.problem.automaton.horizon
        rows = state.rows(visits, self.known_after, 0.0)
        state.induct(*rows, lambda step: 1.0 - _HAIR * (1 + step / h), t, state.plan)

    def policy(self, state: Planner) -> NDArray[Any]:
        table = np.zeros_like(state.plan)
        state.induct(*state.rows(state.counts.visits, 1, self.caution), lambda t: 0.0, 0, table)
        return table

    def arrays(self, state: Planner) -> dict[str, Kept]:
        return {}  # all that is learned is in the counts; every episode begins with a new plan


class Planner:
    """Plans over the transitions counted so far; `plan` (h, S, N) is the current plan."""

    def __init__(self, problem: Problem, counts: Counts) -> None:
        automaton, S = problem.automaton, problem.n_states
        layer, itemsize = S * automaton.n_states, np.dtype(problem.choice_type).itemsize
        require_memory(
            (itemsize * automaton.horizon + 24) * layer,
            f"planning {automaton.horizon} steps of {layer} product states",
            "shorten the windows",
        )
        self.problem, self.counts = problem, counts
        self.plan = np.zeros(problem.shape, dtype=problem.choice_type)

    def rows(
        self, visits: NDArray[np.int64], known_after: int, caution: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
        """CSR rows over the model's states and one more, outside: where unknown choices and doubts lead."""
        counts, outside = self.counts, self.problem.n_states
        choice, target, seen = counts.choice, counts.target, counts.seen
        trusted = visits >= max(known_after, 1)
        kept = trusted[choice]
        doubtful = np.arange(counts.n_choices) if caution else np.flatnonzero(~trusted)
        doubt = np.where(trusted, caution / (visits + caution) if caution else 0.0, 1.0)[doubtful]
        rows = np.concatenate([choice[kept], doubtful])
        order = np.argsort(rows, kind="stable")
        probability = np.concatenate([seen[kept] / (visits[choice[kept]] + caution), doubt])[order]
        successor = np.concatenate([target[kept], np.full(len(doubtful), outside)])[order].astype(np.int32)
        length = np.bincount(rows, minlength=counts.n_choices)
        return np.concatenate([[0], np.cumsum(length)]).astype(np.int64), successor, probability

    def induct(
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

        problem, automaton = self.problem, self.problem.automaton
        S, h = problem.n_states, automaton.horizon
        values, out = np.zeros((S, automaton.n_states)), np.empty((S, automaton.n_states))
        W = np.empty((S + 1, automaton.n_states))
        _decide(automaton.verdicts(h), values)
        for t in range(h - 1, first - 1, -1):
            sweep.gather(values, problem.letter, automaton.delta, 0, S, W)
            W[S] = outside(t)
            sweep.optimum(problem.first_choice, row_start, target, probability, W, True, 0, S, out, table[t])
            _decide(automaton.verdicts(t), out)
            values, out = out, values


def _decide(verdicts: NDArray[np.int8], values: NDArray[np.float64]) -> None:
    values[:, verdicts == TRUE] = 1.0
    values[:, verdicts == FALSE] = 0.0
