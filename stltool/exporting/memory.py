"""What an automaton remembers, as variables: one for each part of the task where they can be told apart.

Part i of an automaton has levels (`TaskAutomaton.tracks`), and level_i(q) determines, with all others, the state q. It
becomes a variable x_i if its next level follows from the letter and its own level alone,

    x_i' = f_i(ℓ, x_i)

The automaton has merged states that mean the same, so that levels may follow from others too, and several combinations
of levels stand for one of its states. In particular it has merged those in which the task is decided: there a variable
takes one more value, "the task is violated" or "the task holds", if its own level is what decides. Whatever f is found
is compared with δ wherever runs come to. If that fails, there is a single variable, the number of the state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE, UNDECIDED, TaskAutomaton
from stltool.automata.automaton import Track
from stltool.display import Card, Displayed, counted, listed
from stltool.exporting.clock import Clock
from stltool.exporting.words import Names
from stltool.logic.printer import Text

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

_LONGEST = 40  # characters of a variable's name
_MOST_COMBINATIONS, _FEW_COMBINATIONS = 3, 100  # of levels: for each state of the automaton, and in any case
_DECIDED = {FALSE: "the task is violated", TRUE: "the task holds"}


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the memory.

    what      the part of the task that it belongs to
    meanings  what each of its values 0, 1, … means
    update    (n_letters, n_values) int32: its next value; −1 where that never occurs
    """

    name: str
    what: str
    meanings: tuple[str, ...]
    update: I32


@dataclass(frozen=True, eq=False, repr=False)
class Memory(Displayed):
    """The states of an automaton in terms of its variables; these states are numbered on their own.

    values    (n, n_variables) int32: the variables in each state
    state     (n,) int64: the automaton's state
    closed    (n,) int8: the verdict where it is decided at every step, UNDECIDED elsewhere
    entry     (n_letters,) int32: the state after the first letter
    delta     (n_letters, n) int32: the next state; closed states stay
    """

    variables: tuple[Variable, ...]
    values: I32
    state: I64
    closed: I8
    entry: I32
    delta: I32

    def __len__(self) -> int:
        return len(self.state)

    def _card(self) -> Card:
        sizes = (f"{variable.name} (0 to {len(variable.meanings) - 1})" for variable in self.variables)
        return Card(f"Memory: {counted(len(self), 'state')}", [{"variables": listed(sizes)}])

    def verdicts(self, of_automaton: I8) -> I8:
        """(n,) the verdicts at a step, from those of the automaton's states."""
        return np.where(self.closed != UNDECIDED, self.closed, of_automaton[self.state]).astype(np.int8)


def memory_of(automaton: TaskAutomaton, clock: Clock, text: Text, names: Names) -> Memory:
    """The memory of an automaton; formulas are written by `text`, and `names` makes names unique."""
    reached = _reached(automaton, clock.closed)
    tracks = automaton.tracks(text)
    for update in _attempts(automaton, clock.closed, reached, tracks):
        found = _factored(automaton, clock.closed, reached, tracks, update, names)
        if found is not None:
            return found
    return _numbered(automaton, clock.closed, reached, text, names)


def _reached(automaton: TaskAutomaton, closed: I8) -> I64:
    """The states that runs come to, whatever the letters, ascending; runs end in closed ones. The state before the
    first letter is among them if a letter closes the task at once."""
    seen = np.zeros(automaton.n_states, dtype=np.bool_)
    first = automaton.delta[:, automaton.initial]
    frontier = np.unique(first)
    if (closed[first] != UNDECIDED).any():
        frontier = np.union1d(frontier, [automaton.initial])
    while len(frontier):
        seen[frontier] = True
        after = np.unique(automaton.delta[:, frontier[closed[frontier] == UNDECIDED]])
        frontier = after[~seen[after]]
    return np.flatnonzero(seen)


def _attempts(automaton: TaskAutomaton, closed: I8, reached: I64, tracks: tuple[Track, ...]) -> Iterator[list[I32]]:
    """Candidates for f_i: with decisions as values of their own, then with the levels of merged states; and where the
    automaton has merged states that differ in a level, with what is most frequent, then with the last level."""
    states = reached[closed[reached] == UNDECIDED]
    if not tracks or not len(states):
        return
    after = automaton.delta[:, states]
    for own_decisions, frequent in ((True, True), (True, False), (False, True)):
        yield [
            _update(track.level_of, len(track.levels), states, after, closed, own_decisions, frequent)
            for track in tracks
        ]


def _update(level: I32, n_levels: int, states: I64, after: I32, closed: I8, own_decisions: bool, frequent: bool) -> I32:
    """f (n_letters, n_levels + 2) of one part, whose last two levels are decisions (false, true); −1 where it is never
    taken."""
    here = np.broadcast_to(level[states], after.shape)
    letter = np.broadcast_to(np.arange(len(after))[:, None], after.shape)
    verdict, width = closed[after], n_levels + 2

    def gathered(which: NDArray[np.bool_], value: NDArray[Any]) -> I32:
        found = np.full((len(after), width), -1, dtype=np.int32)
        votes = (letter[which].astype(np.int64) * width + here[which]) * width + value[which]
        kinds, count = np.unique(votes, return_counts=True)
        if frequent:  # of several, the last one assigned stays
            kinds = kinds[np.argsort(count, kind="stable")]
        found.reshape(-1)[kinds // width] = kinds % width
        return found

    open_ = verdict == UNDECIDED
    regular = gathered(open_, level[after])
    only_closed = ~open_ & (regular[letter, here] < 0)
    ending = gathered(only_closed, n_levels + verdict.astype(np.int32) if own_decisions else level[after])
    return np.where(regular >= 0, regular, ending).astype(np.int32)


def _factored(
    automaton: TaskAutomaton, closed: I8, reached: I64, tracks: tuple[Track, ...], updates: list[I32], names: Names
) -> Memory | None:
    """The memory with these updates; None if they do not do what δ does.

    Each combination x of levels stands for a state π(x) of the automaton: π(f(ℓ, x)) = δ(ℓ, π(x)) wherever it is
    reached. Several may stand for one state, which the automaton has merged.
    """
    levels = np.stack([track.level_of for track in tracks], axis=1)
    found = _Combinations([update.shape[1] for update in updates])
    if not found.fits:
        return None
    merged = np.arange(automaton.n_states)  # decided states are as good as each other
    for verdict in (FALSE, TRUE):
        alike = np.flatnonzero(closed == verdict)
        merged[alike] = alike[:1]
    q0, most = automaton.initial, _MOST_COMBINATIONS * len(reached) + _FEW_COMBINATIONS
    first = np.unique(automaton.delta[:, q0]).astype(np.int64)
    before = bool((closed[first] != UNDECIDED).any())  # begin before the first letter then
    if before and closed[q0] != UNDECIDED:
        return None
    first = np.array([q0]) if before else first
    frontier = found.add(levels[first], first)
    steps: list[tuple[I64, I64]] = []  # codes before (n,), and after (n_letters, n)
    while frontier is not None and len(frontier[0]) and len(found.codes) <= most:
        rows, states = frontier
        acting = closed[states] == UNDECIDED
        rows, states = rows[acting], states[acting]
        after = np.stack([update[:, level] for update, level in zip(updates, rows.T, strict=True)], axis=2)
        if (after < 0).any():
            return None
        steps.append((found.code_of(rows), found.code_of(after)))
        frontier = found.add(after.reshape(-1, len(updates)), merged[automaton.delta[:, states]].ravel())
    if frontier is None or len(frontier[0]):
        return None
    n = len(found.codes)
    delta = np.broadcast_to(np.arange(n), (automaton.n_letters, n)).copy()
    for codes, codes_after in steps:
        delta[:, np.searchsorted(found.codes, codes)] = np.searchsorted(found.codes, codes_after)
    start = np.searchsorted(found.codes, found.code_of(levels[automaton.delta[:, q0]]))
    entry = delta[:, np.searchsorted(found.codes, found.code_of(levels[q0]))] if before else start
    values = found.rows
    used = [np.unique(column) for column in values.T]
    kept = [i for i, known in enumerate(used) if len(known) > 1]
    columns = [np.searchsorted(used[i], values[:, i]) for i in kept]
    return Memory(
        tuple(_variable(tracks[i], updates[i], used[i], names) for i in kept),
        np.array(columns, dtype=np.int32).reshape(len(kept), n).T,
        found.states,
        closed[found.states],
        entry.astype(np.int32),
        delta.astype(np.int32),
    )


class _Combinations:
    """Combinations of levels, by their codes in ascending order, each with the automaton's state that it stands for."""

    def __init__(self, widths: list[int]) -> None:
        self._widths, self.fits = widths, math.prod(widths) < 2**62
        self.codes, self.states = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)

    def code_of(self, rows: NDArray[Any]) -> I64:
        """(…,) of rows (…, n_parts)"""
        code = np.zeros(rows.shape[:-1], dtype=np.int64)
        for i, width in enumerate(self._widths):
            code = code * width + rows[..., i]
        return code

    @property
    def rows(self) -> I32:
        parts, rest = [], self.codes
        for width in reversed(self._widths):
            rest, part = np.divmod(rest, width)
            parts.append(part)
        return np.stack(parts[::-1], axis=1).astype(np.int32)

    def add(self, rows: NDArray[Any], states: I64) -> tuple[I32, I64] | None:
        """Those that are new, (rows, states); None if one would stand for two states."""
        codes, which, back = np.unique(self.code_of(rows), return_index=True, return_inverse=True)
        known = np.isin(codes, self.codes)
        place = np.searchsorted(self.codes, codes[known])
        if (states[which][back] != states).any() or (self.states[place] != states[which[known]]).any():
            return None
        new = which[~known]
        together = np.concatenate([self.codes, codes[~known]])
        order = np.argsort(together)
        self.codes, self.states = together[order], np.concatenate([self.states, states[new]])[order]
        return rows[new].astype(np.int32), states[new]


def _variable(track: Track, update: I32, used: NDArray[np.int32], names: Names) -> Variable:
    n_levels = len(track.levels)
    meanings = [
        track.levels[level].phrase if level < n_levels else _DECIDED[level - n_levels] for level in used.tolist()
    ]
    counting = next((one for one in track.levels if one.subject), None)
    prefix = "" if counting is None else "without_" if counting.risk else "held_"
    number = np.full(update.shape[1] + 1, -1, dtype=np.int32)  # the last one for −1
    number[used] = np.arange(len(used))
    return Variable(names.of(prefix + track.name, _LONGEST), track.name, tuple(meanings), number[update[:, used]])


def _numbered(automaton: TaskAutomaton, closed: I8, reached: I64, text: Text, names: Names) -> Memory:
    """One variable, the number of the state among those that are reached."""
    number = np.full(automaton.n_states, -1, dtype=np.int32)
    number[reached] = np.arange(len(reached))
    update = number[automaton.delta[:, reached]]
    ends = closed[reached] != UNDECIDED
    delta = update.copy()
    delta[:, ends] = np.flatnonzero(ends)
    update[:, ends] = -1
    meanings = tuple("; ".join(one.phrase for one in automaton.memory(q, text)) for q in reached.tolist())
    variable = Variable(names.of("memory", _LONGEST), text(automaton.formula), meanings, update)
    several = len(reached) > 1
    return Memory(
        (variable,) if several else (),
        np.arange(len(reached), dtype=np.int32)[:, None] if several else np.empty((1, 0), dtype=np.int32),
        reached,
        closed[reached],
        number[automaton.delta[:, automaton.initial]],
        delta,
    )
