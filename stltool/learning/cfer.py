"""cfer: counterfactual experience replay [Wang24, Alg. 1 and eq. 14].

One real transition (s, a, s') is evidence for every automaton state q at once, since δ and the labels are known. As
published, each such tuple enters the memory. In the corrected version, the memory contains only real transitions, and
each of them updates all open pairs (t, q) that it is evidence for in one vector operation, backwards along the episode.

The corrected version learns two tables from the same transitions. It acts greedily on one with hope
(learning/optimism.py), and so explores deeply: there an untried choice is worth a paradise, and the Bellman updates
carry that back to wherever it can be reached from. Once the task is violated, the choices tried least come first.

The policy that is judged is that of the other table, which is cautious: of a choice seen n times, the share κ / (n + κ)
counts as a failure, in every update. So what went well once is not preferred to what has proved itself, at no step on
the way, and the table approaches the most cautious plan for the data. (A table without caution takes the best of many
lucky choices for granted all along the way, and no longer tells good from bad.) The run ends with the best of its
policies by its own data (learning/judged.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.learning.aftermath import aftermath
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.judged import EVERY, BestSoFar
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner
from stltool.learning.naive import Exact
from stltool.learning.optimism import Doubt, Hope
from stltool.learning.problem import Problem
from stltool.learning.published import Counterfactual
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import setting
from stltool.learning.tables import ClockedTable, Entries


@dataclass(frozen=True, kw_only=True)
class PublishedCfer(Counterfactual):
    """The factual update online, the counterfactual tuples into the memory, batches drawn from it."""

    name: ClassVar[str] = "cfer"


@dataclass(frozen=True, kw_only=True)
class Cfer(Exact, Learner["CferRun"]):
    """Exact objective, deep exploration; each real transition updates every open pair (t, q); replay of real ones."""

    name: ClassVar[str] = "cfer"

    least_step: float = setting(0.005, "smallest learning rate, α = max(least_step, 1/n)", above=0, most=1)
    optimism: float = setting(0.15, "b in the mean share of hope b / (1 + b) of a choice seen once", above=0)
    memory: int = setting(100_000, "capacity of the replay memory in transitions; the oldest leave first", least=1)
    replays: int = setting(1200, "real transitions replayed after each episode", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> CferRun:
        entries = Entries(problem, tables=2)
        visits = np.zeros(entries.shape[:2], dtype=np.int64)
        table = ClockedTable(entries, visits, Doubt(self.caution), self.least_step)
        hopeful = ClockedTable(entries, visits, Hope(self.optimism), self.least_step, ("U", "W"))
        memory = ReplayMemory(self.memory, width=3)
        return CferRun(problem, table, hopeful, memory, BestSoFar(problem, counts, self.caution), counts)

    def episode(self, state: CferRun, episode: Episode) -> None:
        table, hopeful, memory = state.table, state.hopeful, state.memory
        chances = episode.rng.random(episode.length).tolist()
        state.best.begin(episode)
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            if episode.verdict is False:
                a = aftermath(episode, table.visits[s, : episode.n_choices], chances[t])
                if a < 0:
                    break
                episode.step(a)
            else:
                episode.step(hopeful.best(t, s, episode.q, chances[t]))
        rows = episode.transitions()[::-1]
        np.add.at(table.visits, (rows[:, 0], rows[:, 1]), 1)
        self.learn(state, rows)
        memory.add(rows)
        if self.replays and memory.size:
            self.learn(state, memory.rows[memory.draw(self.replays, episode.rng)])
        if (episode.number + 1) % EVERY == 0:
            state.best.end(table.policy_table())

    def learn(self, state: CferRun, rows: NDArray[np.int32]) -> None:
        state.table.update_all(rows)
        state.hopeful.update_all(rows)

    def policy(self, state: CferRun) -> NDArray[Any]:
        return state.best.better(state.table.policy_table())

    def arrays(self, state: CferRun) -> dict[str, Kept]:
        S, C = state.problem.n_states, state.problem.most_choices
        memory = state.memory.arrays(np.array([S, C, S]) - 1)
        best = state.best.arrays(state.problem.n_choices)
        visits = {"visits": Kept(state.table.visits, 0)}
        return {**state.table.arrays(), **state.hopeful.arrays(), **visits, **memory, **best}

    def check(self, state: CferRun) -> None:
        table, counts = state.table, state.counts
        table.check()
        table.require_visits(counts)
        state.hopeful.check()
        state.best.check(counts)
        s, a, s2 = state.memory.checked(int(counts.seen.sum())).T
        if (a >= state.problem.n_choices[s]).any():
            raise ValueError("the memory contains a choice that its state does not have")
        again = Counts(counts.n_choices, counts.n_states)
        again.add(state.problem.first_choice[s] + a, s2)
        if not counts.contains(again):
            raise ValueError("the memory contains transitions that were never counted")


@dataclass(frozen=True)
class CferRun:
    """The state of a run."""

    problem: Problem
    table: ClockedTable
    hopeful: ClockedTable
    memory: ReplayMemory
    best: BestSoFar
    counts: Counts
