"""The verdicts that a run can still reach, and whether two automata ever judge a run differently.

    can_v(t, q)     = verdict_t(q) = v,  or it is undecided and some letter λ has can_v(t+1, δ_λ q)
    differ(t, p, q) = both undecided and some letter λ has differ(t+1, δ_λ p, δ_λ q),
                      or p has decided v and q can still become ¬v, or vice versa

Both are computed backwards from the horizon. Between two changes of the verdicts, a step that changes nothing is a
fixed point, and the rest of that stretch is skipped: the cost of windows of 10⁹ steps depends on their states, not
their steps.
"""

from __future__ import annotations

import bisect
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, TaskAutomaton
from stltool.errors import SizeError

Letters: TypeAlias = NDArray[np.int32]
Runs: TypeAlias = list[tuple[int, int]]
"""A sequence of letters as (letter, repetitions); consecutive entries may have the same letter."""

_MOST_PAIRS = 20_000_000  # of states, and transitions between them
_MOST_VERDICTS = 100_000_000  # steps times states
_LONGEST = 10_000  # steps of a run that are found one by one
_CELLS = 1000  # array cells that cost as much as one state explored under one letter


class Effort:
    """The remaining search effort, in states times letters explored; SizeError if it is used up."""

    def __init__(self, most: int) -> None:
        self.most = self.left = most

    def spend(self, amount: int) -> None:
        self.left -= amount
        if self.left < 0:
            self.left = 0
            raise SizeError(f"the search exceeds the limit of {self.most} states times letters")

    def spend_cells(self, cells: int) -> None:
        self.spend(cells // _CELLS + 1)


@dataclass(frozen=True)
class Stretch:
    """Steps first … last, for which `can` (2, n_states) gives the states that can still become false, and true."""

    first: int
    last: int
    can: NDArray[np.bool_]


class ReachableVerdicts:
    """can_v(t, q) of an automaton restricted to some of its letters, at every step."""

    def __init__(self, automaton: TaskAutomaton, letters: Letters, effort: Effort) -> None:
        self.automaton = automaton
        self.letters = np.unique(letters)
        self.delta = automaton.delta[self.letters]
        stretches: list[Stretch] = []  # latest first
        starts = [t for t in automaton.verdict_starts.tolist() if t <= automaton.horizon]
        can = np.zeros((2, automaton.n_states), dtype=np.bool_)
        for first, last in _backwards(starts, automaton.horizon):
            verdict = automaton.verdicts(first)
            decided = np.stack([verdict == FALSE, verdict == TRUE])
            t = last
            while t >= first:
                effort.spend_cells(self.delta.size)
                new = decided | ((verdict == UNDECIDED) & can[:, self.delta].any(axis=1))
                if t < last and (new == can).all():
                    stretches[-1] = Stretch(first, stretches[-1].last, can)
                    break
                stretches.append(Stretch(t, t, new))
                can, t = new, t - 1
        self.stretches = stretches[::-1]
        self._firsts = [stretch.first for stretch in self.stretches]

    def stretch(self, t: int) -> Stretch:
        """The stretch that contains step t; after the horizon, the last one."""
        return self.stretches[bisect.bisect_right(self._firsts, t) - 1]

    def can_become(self, verdict: int) -> bool:
        """Whether some run ends with this verdict."""
        return bool(self.stretch(0).can[verdict, self.delta[:, self.automaton.initial]].any())


def decided_early(automaton: TaskAutomaton, letters: Letters) -> TaskAutomaton:
    """The same automaton, with verdicts as soon as nothing that can still come changes them, if only these letters do.

    Unchanged if it is so large that the verdicts of all steps are no small matter.
    """
    if automaton.horizon * automaton.n_states > _MOST_VERDICTS:
        return automaton
    stretches = ReachableVerdicts(automaton, letters, Effort(sys.maxsize)).stretches
    rows = [np.where(stretch.can.all(axis=0), UNDECIDED, stretch.can[TRUE]) for stretch in stretches]
    return replace(
        automaton,
        verdict_starts=np.array([stretch.first for stretch in stretches], dtype=np.int64),
        verdict_rows=np.array(rows, dtype=np.int8),
    )


def _backwards(starts: Sequence[int], end: int) -> Iterator[tuple[int, int]]:
    """The stretches between `starts` up to `end` as (first, last), latest first."""
    last = end
    for first in reversed(starts):
        yield first, last
        last = first - 1


def shortest_run(reachable: ReachableVerdicts, verdict: int, effort: Effort) -> Runs | None:
    """The fewest letters after which the verdict is certain, whatever follows; some run must have this verdict.

    None if it is too long to be listed.
    """
    delta, initial = reachable.delta, reachable.automaton.initial
    layers: list[tuple[int, int, NDArray[np.int32]]] = []  # states in which a run can be at steps first … last
    states, t = np.unique(delta[:, initial]), 0
    while True:
        effort.spend_cells(delta.shape[0] * len(states))
        stretch = reachable.stretch(t)
        states = states[stretch.can[verdict, states]]
        sure = states[~stretch.can[1 - verdict, states]]
        if sure.size:
            layers.append((t, t, states))
            break
        last = stretch.last if layers and np.array_equal(layers[-1][2], states) else t  # so it remains to the end
        layers.append((t, last, states))
        states, t = np.unique(delta[:, states]), last + 1
    runs = _way_back(reachable, layers, int(sure[0]))
    if runs is None:
        return None
    return [(int(reachable.letters[letter]), count) for letter, count in runs]


def _way_back(
    reachable: ReachableVerdicts, layers: list[tuple[int, int, NDArray[np.int32]]], state: int
) -> Runs | None:
    """Letters that lead through the layers to `state` in the last one, staying in each state as long as possible."""
    backwards: Runs = []
    steps = 0

    def step(before: NDArray[np.int32]) -> bool:
        """Take one step back, to a state in `before`; returns whether the state stays the same."""
        nonlocal state
        stays = np.flatnonzero(reachable.delta[:, state] == state)
        kept = bool(stays.size) and state in before
        if kept:
            letter = int(stays[0])
        else:
            letter, place = (int(i) for i in np.argwhere(reachable.delta[:, before] == state)[0])
            state = int(before[place])
        backwards.append((letter, 1))
        return kept

    for i in range(len(layers) - 1, -1, -1):
        first, last, states = layers[i]
        while first < last:
            steps += 1
            if step(states):
                backwards[-1] = (backwards[-1][0], last - first)
                break
            last -= 1
            if steps > _LONGEST:
                return None
        step(layers[i - 1][2] if i else np.array([reachable.automaton.initial], dtype=np.int32))
    return backwards[::-1]


def differ(
    left: ReachableVerdicts, right: ReachableVerdicts, left_letters: Letters, right_letters: Letters, effort: Effort
) -> bool:
    """Whether some sequence of symbols is judged differently.

    `left_letters` and `right_letters` (n_symbols,) give each automaton's letter for a symbol. Raises SizeError if
    `effort` is not enough.
    """
    letters = np.unique(np.stack([left_letters, right_letters], axis=1), axis=0)
    delta = (left.automaton.delta[letters[:, 0]].astype(np.int64), right.automaton.delta[letters[:, 1]])
    n = right.automaton.n_states
    start = left.automaton.initial * n + right.automaton.initial
    codes = _reachable_pairs(start, delta, effort)
    p, q = np.divmod(codes, n)
    after = np.searchsorted(codes, delta[0][:, p] * n + delta[1][:, q])
    horizon = max(left.automaton.horizon, right.automaton.horizon)
    starts = sorted({stretch.first for reachable in (left, right) for stretch in reachable.stretches})
    result = np.zeros(len(codes), dtype=np.bool_)
    for first, last in _backwards(starts, horizon):
        v, w = (reachable.automaton.verdicts(min(first, reachable.automaton.horizon)) for reachable in (left, right))
        v, w = v[p], w[q]
        can_left, can_right = left.stretch(first).can, right.stretch(first).can
        other_v, other_w = (v == FALSE).astype(np.int64), (w == FALSE).astype(np.int64)
        settled = np.where(v != UNDECIDED, can_right[other_v, q], (w != UNDECIDED) & can_left[other_w, p])
        open_still = (v == UNDECIDED) & (w == UNDECIDED)
        for t in range(last, first - 1, -1):
            effort.spend_cells(after.size)
            new = settled | (open_still & result[after].any(axis=0))
            if t < last and np.array_equal(new, result):
                break
            result = new
    return bool(result[after[:, np.searchsorted(codes, start)]].any())


def _reachable_pairs(
    start: int, delta: tuple[NDArray[np.int64], NDArray[np.int32]], effort: Effort
) -> NDArray[np.int64]:
    """The codes p · n + q of all pairs in which a run can be, and of the start, ascending."""
    n = delta[1].shape[1]
    if delta[0].shape[1] * n > _MOST_PAIRS:
        raise SizeError(f"two automata with {delta[0].shape[1]} and {n} states are too large for a comparison")
    seen = np.zeros(delta[0].shape[1] * n, dtype=np.bool_)
    frontier = np.array([start], dtype=np.int64)
    seen[start] = True
    total = 0
    while frontier.size:
        total += delta[0].shape[0] * len(frontier)
        if total > _MOST_PAIRS:
            raise SizeError(f"the comparison exceeds the limit of {_MOST_PAIRS} transitions between pairs of states")
        effort.spend_cells(delta[0].shape[0] * len(frontier))
        p, q = np.divmod(frontier, n)
        reached = np.unique(delta[0][:, p] * n + delta[1][:, q])
        frontier = reached[~seen[reached]]
        seen[frontier] = True
    return np.flatnonzero(seen)
