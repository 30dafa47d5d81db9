"""What of the clock a product's states must carry, and which property of them is the task's probability.

Verdicts depend on the step: verdict_t(q). States carry the step min(t, c), where from step c on every automaton state
that an undecided run is in has one verdict at all steps before the horizon h. At h the rest is decided:

    nothing is left        P(Φ) = P(F satisfied)
    as false               P(Φ) = P(F<=h satisfied)
    as true                P(Φ) = 1 − P(F<=h violated)
    some of both           c = h: the step is carried to the end, and P(Φ) = P(F satisfied)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, UNDECIDED, TaskAutomaton
from stltool.display import Card, Displayed

I8 = NDArray[np.int8]


@dataclass(frozen=True, eq=False, repr=False)
class Clock(Displayed):
    """How far steps are counted, and what verdicts are there.

    last       c: the last step that states tell apart
    stretches  (first, last, verdicts (n_automaton_states,)): ascending, from step 0 to c
    bound      h if the property is bounded by it; None: it is not
    rest       FALSE | TRUE: what runs are that are undecided after the bound
    closed     (n_automaton_states,) int8: the verdict of a state in which no run is ever undecided; UNDECIDED elsewhere
    """

    last: int
    stretches: tuple[tuple[int, int, I8], ...]
    bound: int | None
    rest: int
    closed: I8

    def _card(self) -> Card:
        bound = "the property has no bound" if self.bound is None else f"the property has the bound {self.bound}"
        return Card(f"Clock: steps are counted up to {self.last}; {bound}")

    def verdicts(self, t: int) -> I8:
        """Those of step min(t, c)."""
        return next(verdicts for first, last, verdicts in self.stretches if t <= last)


def clock_of(automaton: TaskAutomaton, least: int = 0, whole: bool = False) -> Clock:
    """The clock of an automaton that tells at least the steps up to `least` apart; `whole`: all of them."""
    h = automaton.horizon
    visits = list(_visits(automaton))
    closed = _closed(automaton, visits)
    settled, later, c = np.full(automaton.n_states, UNDECIDED, dtype=np.int8), np.zeros(automaton.n_states, bool), 0
    for _, last, verdicts, states in reversed(visits):
        if last == h:
            continue
        if (settled[states] != verdicts[states])[later[states]].any():
            c = last + 1
            break
        settled[states], later[states] = verdicts[states], True
    c, bound, rest = max(c, min(least, h)), None, FALSE
    final, at_end = automaton.verdicts(h), visits[-1][3] if visits[-1][1] == h else np.empty(0, dtype=np.int64)
    new = at_end[~later[at_end]]
    settled[new] = final[new]
    left = at_end[settled[at_end] == UNDECIDED]
    contradicted = (settled[at_end] != final[at_end]) & (settled[at_end] != UNDECIDED)
    both = len(np.unique(final[left])) > 1
    if whole or contradicted.any() or both or c >= h - 1:
        c, settled = h, final
    elif len(left):
        bound, rest = h, int(final[left[0]])
    pieces: list[tuple[int, int, I8]] = []
    starts = [*automaton.verdict_starts.tolist(), h + 1]
    for row, first, after in zip(automaton.verdict_rows, starts, starts[1:], strict=False):
        if first < c:
            pieces.append((first, min(after, c) - 1, row))
    return Clock(c, (*pieces, (c, c, settled)), bound, rest, closed)


def _visits(automaton: TaskAutomaton) -> Iterator[tuple[int, int, I8, NDArray[np.int64]]]:
    """(first step, last step, verdicts, states): where runs that were undecided before are, whatever the letters."""
    t, h = 0, automaton.horizon
    states = np.unique(automaton.delta[:, automaton.initial]).astype(np.int64)
    starts = [*automaton.verdict_starts.tolist(), h + 1]
    while t <= h:
        verdicts = automaton.verdicts(t)
        after = np.unique(automaton.delta[:, states[verdicts[states] == UNDECIDED]]).astype(np.int64)
        last = t
        if np.array_equal(after, states):  # so it remains as long as verdicts do
            last = next(start for start in starts if start > t) - 1
        yield t, last, verdicts, states
        t, states = last + 1, after


def _closed(automaton: TaskAutomaton, visits: list[tuple[int, int, I8, NDArray[np.int64]]]) -> I8:
    closed = np.full(automaton.n_states, UNDECIDED, dtype=np.int8)
    known = np.zeros(automaton.n_states, dtype=np.bool_)
    changing = np.zeros(automaton.n_states, dtype=np.bool_)
    for _, _, verdicts, states in visits:
        changing[states] |= known[states] & (closed[states] != verdicts[states])
        closed[states], known[states] = verdicts[states], True
    closed[changing] = UNDECIDED
    return closed
