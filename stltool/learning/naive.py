"""naive: one Q update per environment step, the baseline of [Wang24, §V-B]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.kernels import Group
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.judged import EVERY, BestSoFar
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner
from stltool.learning.problem import Problem
from stltool.learning.published import Published
from stltool.learning.schedule import Decaying
from stltool.learning.settings import setting
from stltool.learning.tables import ClockedTable, Entries


@dataclass(frozen=True, kw_only=True)
class PublishedNaive(Published):
    """Q(s, q, a) on the surrogate reward; one update per step, no memory."""

    name: ClassVar[str] = "naive"


@dataclass(frozen=True, kw_only=True)
class Exact:
    """The settings of a Q-table that carries the clock, on the exact objective."""

    kernels: ClassVar[tuple[Group, ...]] = ("clocked",)

    caution: float = setting(0.1, "κ in the judged policy's weight n / (n + κ) for a choice seen n times", least=0)


@dataclass(frozen=True, kw_only=True)
class Clocked(Decaying, Exact):
    """The same, learned step by step, exploring with a probability that decays."""

    least_step: float = setting(0.02, "smallest learning rate, α = max(least_step, 1/n)", above=0, most=1)

    def table(self, problem: Problem) -> ClockedTable:
        return ClockedTable(Entries(problem), self.caution, self.least_step)


@dataclass(frozen=True, kw_only=True)
class Naive(Clocked, Learner["NaiveRun"]):
    """Q_t(s, q, a) on the exact objective; only the visited entry is updated."""

    name: ClassVar[str] = "naive"

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> NaiveRun:
        table = self.table(problem)
        return NaiveRun(problem, table, BestSoFar(problem, counts, self.caution), counts)

    def episode(self, state: NaiveRun, episode: Episode) -> None:
        epsilon = self.epsilon(episode.number)
        explore = episode.rng.random((episode.length, 2)).tolist()
        state.best.begin(episode)
        while episode.verdict is None:
            t, s, q = episode.t, episode.s, episode.q
            u, chance = explore[t]
            a = int(chance * episode.n_choices) if u < epsilon else state.table.best(t, s, q, chance)
            episode.step(a)
            state.table.update(t, s, q, a, episode.s)
        if (episode.number + 1) % EVERY == 0:
            state.best.end(state.table.policy_table())

    def policy(self, state: NaiveRun) -> NDArray[Any]:
        return state.best.better(state.table.policy_table())

    def arrays(self, state: NaiveRun) -> dict[str, Kept]:
        return {**state.table.arrays(), **state.best.arrays(state.problem.n_choices)}

    def check(self, state: NaiveRun) -> None:
        state.table.check()
        state.best.check(state.counts)
        state.table.require_visits(state.counts)


@dataclass(frozen=True)
class NaiveRun:
    """The state of a run."""

    problem: Problem
    table: ClockedTable
    best: BestSoFar
    counts: Counts
