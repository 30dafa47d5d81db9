"""What an automaton remembers, as variables: one for each part of the task where they can be told apart.

Part i of an automaton has levels (`TaskAutomaton.tracks`), and level_i(q) determines, with all others, the state q. It
becomes a variable x_i if its next level depends on the letter and on its own level alone,

    x_i' = f_i(ℓ, x_i)        for every step from an undecided state to another.

Steps after which the task is decided for good lead to states that the automaton has merged; there a variable takes one
more value, "the task is violated" or "the task holds", if its own level is what decides. Whatever is found is compared
with δ in every reachable state and letter. If that fails, there is a single variable, the number of the state.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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
    """Candidates for f_i: first with decisions as values of their own, then with the levels of merged states."""
    if not tracks:
        return
    states = reached[closed[reached] == UNDECIDED]
    if not len(states):
        return
    after = automaton.delta[:, states]
    for own_decisions in (True, False):
        updates = [_update(track.level_of, len(track.levels), states, after, closed, own_decisions) for track in tracks]
        known = [update for update in updates if update is not None]
        if len(known) == len(tracks):
            yield known


def _update(level: I32, n_levels: int, states: I64, after: I32, closed: I8, own_decisions: bool) -> I32 | None:
    """f (n_letters, n_levels + 2) of one part, whose last two levels are decisions (false, true); None if it depends on
    more than that part."""
    shape = (len(after), n_levels + 2)
    here = np.broadcast_to(level[states], after.shape)
    letter = np.broadcast_to(np.arange(len(after))[:, None], after.shape)
    verdict = closed[after]
    open_ = verdict == UNDECIDED

    def gathered(which: NDArray[np.bool_], value: NDArray[np.signedinteger]) -> I32 | None:
        found = np.full(shape, -1, dtype=np.int32)
        found[letter[which], here[which]] = value[which]
        return found if np.array_equal(found[letter[which], here[which]], value[which]) else None

    regular = gathered(open_, level[after])
    if regular is None:
        return None
    only_closed = ~open_ & (regular[letter, here] < 0)
    for merged in (False, True) if own_decisions else (True, False):
        found = gathered(only_closed, level[after] if merged else n_levels + verdict.astype(np.int32))
        if found is not None:
            return np.where(regular >= 0, regular, found).astype(np.int32)
    return None


def _factored(
    automaton: TaskAutomaton,
    closed: I8,
    reached: I64,
    tracks: tuple[Track, ...],
    updates: list[I32],
    names: Names,
) -> Memory | None:
    """The memory with these updates; None if they do not do what δ does."""
    states = reached[closed[reached] == UNDECIDED]
    levels = np.stack([track.level_of for track in tracks], axis=1)
    widths = [update.shape[1] for update in updates]
    if np.prod([float(width) for width in widths]) >= 2**62:
        return None

    def code_of(rows: I32) -> I64:
        code = np.zeros(rows.shape[:-1], dtype=np.int64)
        for i, width in enumerate(widths):
            code = code * width + rows[..., i]
        return code

    own = code_of(levels[states])
    order = np.argsort(own)
    if len(np.unique(own)) < len(own):
        return None
    states, own = states[order], own[order]
    after = automaton.delta[:, states]
    rows = np.stack([update[:, level] for update, level in zip(updates, levels[states].T, strict=True)], axis=2)
    if (rows < 0).any():
        return None
    reach, verdict = code_of(rows), closed[after]
    place = np.minimum(np.searchsorted(own, reach), len(own) - 1)
    is_regular = own[place] == reach
    if (is_regular != (verdict == UNDECIDED)).any() or (states[place] != after)[is_regular].any():
        return None
    ends, first, which = np.unique(reach[~is_regular], return_index=True, return_inverse=True)
    end_verdict = verdict[~is_regular][first]
    if (end_verdict[which] != verdict[~is_regular]).any():
        return None
    delta = place.copy()
    delta[~is_regular] = len(states) + which
    delta = np.concatenate([delta, np.broadcast_to(len(states) + np.arange(len(ends)), (len(delta), len(ends)))], 1)
    values = np.concatenate([levels[states], rows[~is_regular][first]])
    entry = _entry(automaton, states, closed, delta)
    if entry is None:
        return None
    used = [np.unique(column) for column in values.T]
    position = [np.searchsorted(known, column) for known, column in zip(used, values.T, strict=True)]
    variables = [
        _variable(track, update, known, names) for track, update, known in zip(tracks, updates, used, strict=True)
    ]
    kept = [i for i, known in enumerate(used) if len(known) > 1]
    return Memory(
        tuple(variables[i] for i in kept),
        np.array([position[i] for i in kept], dtype=np.int32).reshape(len(kept), len(values)).T,
        np.concatenate([states, after[~is_regular][first]]),
        np.concatenate([np.full(len(states), UNDECIDED), end_verdict]).astype(np.int8),
        entry,
        delta.astype(np.int32),
    )


def _entry(automaton: TaskAutomaton, states: I64, closed: I8, delta: NDArray[np.int64]) -> I32 | None:
    """(n_letters,) the state after the first letter."""
    first = automaton.delta[:, automaton.initial]
    place = {q: i for i, q in enumerate(states.tolist())}
    if automaton.initial in place:
        return delta[:, place[automaton.initial]].astype(np.int32)
    found = [place.get(q, -1) for q in first.tolist()]
    return np.array(found, dtype=np.int32) if min(found) >= 0 else None


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
