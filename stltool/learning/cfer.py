"""cfer: counterfactual experience replay [Wang24, Alg. 1 and eq. 14].

One real transition (s, a, s') is evidence for every automaton state q at once, since δ and the labels are known. As
published, each such tuple enters the memory. In the corrected version, the memory contains only real transitions, and
each of them updates all open pairs (t, q) that it is evidence for in one vector operation, backwards along the episode.

The corrected version explores by counts: actions never tried in this state come first; then, with probability ε and
once the task is violated, those tried least. The policy that is judged weighs values by n / (n + κ) for n visits of the
choice: a choice seen once is not preferred to one that has proved itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner, rarest
from stltool.learning.naive import Clocked
from stltool.learning.problem import Problem
from stltool.learning.published import Counterfactual
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import setting
from stltool.learning.tables import ClockedTable


@dataclass(frozen=True, kw_only=True)
class PublishedCfer(Counterfactual):
    """The factual update online, the counterfactual tuples into the memory, batches drawn from it."""

    name: ClassVar[str] = "cfer"


@dataclass(frozen=True, kw_only=True)
class Cfer(Clocked, Learner["CferRun"]):
    """Exact objective; each real transition updates every open pair (t, q); replay of real transitions."""

    name: ClassVar[str] = "cfer"

    decay: float = setting(50.0, "n_d of the exploration probability end + (start − end)·exp(−episode / n_d)", above=0)
    memory: int = setting(100_000, "capacity of the replay memory in transitions; the oldest leave first", least=1)
    replays: int = setting(600, "real transitions replayed after each episode", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> CferRun:
        table = self.table(problem, count_every_entry=False)
        return CferRun(problem, table, ReplayMemory(self.memory, width=3), counts)

    def episode(self, state: CferRun, episode: Episode) -> None:
        table, memory = state.table, state.memory
        epsilon = self.epsilon(episode.number)
        explore = episode.rng.random((episode.length, 2)).tolist()
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            u, chance = explore[t]
            visits = table.visits[s, : episode.n_choices]
            explores = episode.verdict is False or u < epsilon or visits.min() == 0
            episode.step(rarest(visits, chance) if explores else table.best(t, s, episode.q, chance))
        rows = episode.transitions()[::-1]
        np.add.at(table.visits, (rows[:, 0], rows[:, 1]), 1)
        table.update_all(rows)
        memory.add(rows)
        if self.replays and memory.size:
            table.update_all(memory.rows[memory.draw(self.replays, episode.rng)])

    def policy(self, state: CferRun) -> NDArray[Any]:
        return state.table.policy_table()

    def arrays(self, state: CferRun) -> dict[str, Kept]:
        S, C = state.problem.n_states, state.problem.most_choices
        return {**state.table.arrays(), **state.memory.arrays(np.array([S, C, S]) - 1)}

    def check(self, state: CferRun) -> None:
        table, counts = state.table, state.counts
        table.check()
        table.require_visits(counts)
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
    memory: ReplayMemory
    counts: Counts
