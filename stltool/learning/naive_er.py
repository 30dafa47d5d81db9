"""naive-er: ordinary experience replay over factual transitions [Wang24, §V-B], every `period`-th step a batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.judged import EVERY, BestSoFar
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner
from stltool.learning.naive import Clocked
from stltool.learning.problem import Problem
from stltool.learning.published import Replaying
from stltool.learning.replay import Batches, ReplayMemory
from stltool.learning.tables import ClockedTable


@dataclass(frozen=True, kw_only=True)
class PublishedNaiveER(Replaying):
    """No online update; at steps 0, period, … of an episode, `batch` transitions are drawn with replacement."""

    name: ClassVar[str] = "naive-er"
    online: ClassVar[bool] = False


@dataclass(frozen=True, kw_only=True)
class NaiveER(Batches, Clocked, Learner["ReplayRun"]):
    """Q_t(s, q, a) on the exact objective, learned from a memory of transitions with their step."""

    name: ClassVar[str] = "naive-er"

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> ReplayRun:
        table = self.table(problem)
        memory = ReplayMemory(self.memory, width=6)
        return ReplayRun(problem, table, memory, BestSoFar(problem, counts, self.caution), counts)

    def episode(self, state: ReplayRun, episode: Episode) -> None:
        table, memory = state.table, state.memory
        epsilon = self.epsilon(episode.number)
        explore = episode.rng.random((episode.length, 2)).tolist()
        state.best.begin(episode)
        while episode.verdict is None:
            t, s, q = episode.t, episode.s, episode.q
            u, chance = explore[t]
            a = int(chance * episode.n_choices) if u < epsilon else table.best(t, s, q, chance)
            episode.step(a)
            memory.add(np.array([[t, s, q, a, episode.s, episode.q]], dtype=np.int32))
            if t % self.period == 0:
                for was_t, was_s, was_q, was_a, s2, _ in memory.rows[memory.draw(self.batch, episode.rng)].tolist():
                    table.update(was_t, was_s, was_q, was_a, s2)
        if (episode.number + 1) % EVERY == 0:
            state.best.end(table.policy_table())

    def policy(self, state: ReplayRun) -> NDArray[Any]:
        return state.best.better(state.table.policy_table())

    def arrays(self, state: ReplayRun) -> dict[str, Kept]:
        h, S, N = state.problem.shape
        return {
            **state.table.arrays(),
            **state.best.arrays(state.problem.n_choices),
            **state.memory.arrays(np.array([h, S, N, state.problem.most_choices, S, N]) - 1),
        }

    def check(self, state: ReplayRun) -> None:
        problem, table, memory = state.problem, state.table, state.memory
        table.check()
        state.best.check(state.counts)
        t, s, q, a, s2, q2 = memory.checked(int(state.counts.seen.sum())).T
        if (a >= problem.n_choices[s]).any() or (problem.automaton.delta[problem.letter[s2], q] != q2).any():
            raise ValueError("the memory contains an impossible step")
        if not table.entries.is_open(t, s, q).all():
            raise ValueError("the memory contains a step after the task was decided")
        if int(table.visits.sum(dtype=np.int64)) % self.batch:
            raise ValueError(f"visits do not add up to batches of {self.batch}")
        visited = table.visits.max(axis=2) > 0
        if (visited[_pairs(problem)] & (state.counts.visits == 0)).any():
            raise ValueError("visits are of choices that were never taken")


def _pairs(problem: Problem) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """State of every choice, and its index within that state."""
    s = np.repeat(np.arange(problem.n_states), problem.n_choices)
    return s, np.arange(len(s)) - problem.first_choice[s]


@dataclass(frozen=True)
class ReplayRun:
    """The state of a run."""

    problem: Problem
    table: ClockedTable
    memory: ReplayMemory
    best: BestSoFar
    counts: Counts
