"""cfer: counterfactual experience replay [Wang24, Alg. 1 and eq. 14].

One real transition (s, a, s') is evidence for every automaton state q at once, since δ and the labels are known. As
published, each such tuple enters the memory, and batches are drawn from it. In the corrected version, the memory
contains only real transitions, all of them, and each is evidence for all open pairs (t, q). They are not drawn: the
transitions of a choice are replayed together, backwards from the last step to the first (learning/swept.py). So what
was found in one episode is known everywhere before the next one. Replayed that well, a Q-table is a plan for the data.

The corrected version has two tables of the same transitions. It acts greedily on one with hope (learning/optimism.py),
and so explores deeply: there an untried choice is worth a paradise, and the Bellman updates carry that back to wherever
it can be reached from. How much an episode hopes is drawn anew: what was tried often enough is acted on in most of
them. The table is replayed at the beginning, and where a transition is seen for the first time, for all that can follow
by the transitions seen. Once the task is violated, the choices tried least come first.

The policy that is judged is that of the other table, which is cautious: of a choice seen n times, the share κ / (n + κ)
counts as a failure, in every update. So what went well once is not preferred to what has proved itself, at no step on
the way. It is replayed when it is asked for, until nothing changes any more: its policy is the most cautious plan for
the data, and so the best by the run's own data (the one that learning/judged.py would keep).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.learning.aftermath import aftermath
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner
from stltool.learning.naive import Exact
from stltool.learning.optimism import level
from stltool.learning.problem import Problem
from stltool.learning.published import Counterfactual
from stltool.learning.settings import setting
from stltool.learning.swept import CautiousTable, HopefulTable, Transitions
from stltool.learning.tables import Entries


@dataclass(frozen=True, kw_only=True)
class PublishedCfer(Counterfactual):
    """The factual update online, the counterfactual tuples into the memory, batches drawn from it."""

    name: ClassVar[str] = "cfer"


@dataclass(frozen=True, kw_only=True)
class Cfer(Exact, Learner["CferRun"]):
    """Exact objective, deep exploration; real transitions update every open pair (t, q), and are replayed backwards."""

    name: ClassVar[str] = "cfer"

    optimism: float = setting(1.2, "b in the mean share of hope b / (1 + b) of a choice seen once", above=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> CferRun:
        entries = Entries(problem, tables=2)
        return CferRun(problem, counts, CautiousTable(entries, self.caution), HopefulTable(entries))

    def episode(self, state: CferRun, episode: Episode) -> None:
        hopeful, transitions = state.hopeful, state.transitions()
        *chances, chance = episode.rng.random(episode.length + 1).tolist()
        hope, new = level(self.optimism, chance), True
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            if episode.verdict is False:
                a = aftermath(episode, transitions.stored.visits[s, : episode.n_choices], chances[t])
                if a < 0:
                    break
            else:
                if new:
                    hopeful.look_ahead(transitions, hope, t, s, episode.q)
                a = hopeful.best(t, s, episode.q, chances[t])
            episode.step(a)
            new = transitions.add(s, a, episode.s)

    def policy(self, state: CferRun) -> NDArray[Any]:
        state.table.sweep(state.transitions())
        return state.table.policy_table()

    def arrays(self, state: CferRun) -> dict[str, Kept]:
        return {}  # everything is in the counts


@dataclass
class CferRun:
    """The state of a run."""

    problem: Problem
    counts: Counts
    table: CautiousTable
    hopeful: HopefulTable
    _transitions: Transitions | None = None

    def transitions(self) -> Transitions:
        """All that were counted."""
        if self._transitions is None or self._transitions.total != self.counts.total:
            self._transitions = Transitions(self.problem, self.counts)
        return self._transitions
