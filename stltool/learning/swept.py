"""Q-tables that replay all transitions seen so far: backwards, a whole row at a time.

    Q_t(s, q, a) = (1 − g) · mean of V_{t+1}(s', q') over the stored transitions (s, a, s') + g · worth_t

with g the share of (s, a) that leads outside (learning/optimism.py). It is what replaying the stored transitions of a
choice for ever, with learning rates 1/n, would come to [Seijen15]; one such step has no learning rate and no noise.

The order is that of the clock, from the last step of the task to the first: so what an episode has found reaches every
value that depends on it at once, through a corridor of any length.

CautiousTable   replays, at each step, the choices of which something else is stored now, and those that lead to a state
                whose value at the next step has changed, as in prioritized sweeping [Moore93]
HopefulTable    hopes otherwise in each episode; replays all choices, but only in what can follow the present situation
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.tuples import stored_of, with_room
from stltool.learning.counts import Counts
from stltool.learning.optimism import doubt, nothing, paradise
from stltool.learning.problem import Problem
from stltool.learning.tables import Entries, ExactTable

_LEAST = 1e-300
_STAMPS = np.iinfo(np.int32).max


class Transitions:
    """All transitions of a run, as the kernels replay them: those counted so far, and those that are `add`ed.

    total   how many there are
    """

    def __init__(self, problem: Problem, counts: Counts) -> None:
        from stltool.kernels import learning

        self.total = counts.total
        choice, target, seen = counts.choice, counts.target, counts.seen
        self.stored = stored_of(problem.n_states, problem.most_choices, 2 * len(seen) + 64)
        s = np.searchsorted(problem.first_choice, choice, side="right") - 1
        for row in np.stack([s, choice - problem.first_choice[s], target, seen], axis=1).tolist():
            learning.store(self.stored, *row)

    def add(self, s: int, a: int, s2: int) -> bool:
        """Store one; whether it is the first (s, a, s')."""
        from stltool.kernels import learning

        self.total += 1
        room = len(self.stored.row)
        if self.stored.size[0] == room:
            self.stored = with_room(self.stored, 2 * room)
        return bool(learning.store(self.stored, s, a, s2, 1))


class CautiousTable(ExactTable):
    """The values of the most cautious plan for the transitions; they depend on these only, to the last bit.

    visits (S, C)   how often each choice had been taken at the last sweep
    """

    def __init__(self, entries: Entries, caution: float) -> None:
        super().__init__(entries, nothing)
        self.caution, self.visits = caution, np.zeros(entries.shape[:2], dtype=np.int64)

    def sweep(self, transitions: Transitions) -> None:
        """Replay whatever has changed since the last one."""
        from stltool.kernels import learning

        entries, problem, stored = self.entries, self.entries.problem, transitions.stored
        changed: NDArray[np.bool_] = (self.visits != stored.visits).any(axis=1)
        self.visits[changed] = stored.visits[changed]
        learning.clocked_sweep(
            self.Q, self.V, stored, problem.letter, entries.bounds, entries.successor, problem.n_choices,
            doubt(self.visits, self.caution), self.worth, changed,
        )  # fmt: skip


class HopefulTable(ExactTable):
    """The values of a hopeful plan for what can follow a situation."""

    def __init__(self, entries: Entries) -> None:
        super().__init__(entries, partial(paradise, horizon=entries.problem.automaton.horizon))
        S, _, E = entries.shape
        self._mark, self._stamp = np.zeros((S, E), dtype=np.int32), 0
        self._order = np.zeros((int(entries.numbers[entries.problem.letter].sum()), 2), dtype=np.int32)

    def look_ahead(self, transitions: Transitions, level: float, t: int, s: int, q: int) -> None:
        """Replay from (t, s, q) on, at this level of hope, by the transitions stored."""
        from stltool.kernels import learning

        entries, problem = self.entries, self.entries.problem
        if self._stamp == _STAMPS:
            self._mark[:], self._stamp = 0, 0
        self._stamp += 1
        learning.clocked_ahead(
            self.Q, self.V, transitions.stored, problem.letter, entries.successor, problem.n_choices,
            math.log(max(level, _LEAST)), self.worth, self._mark, self._order, self._stamp, s,
            int(entries.index[problem.letter[s], t, q]),
        )  # fmt: skip
