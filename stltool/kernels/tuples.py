"""Grouped arguments of kernels: named tuples of arrays and numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_LANES = 8  # of a vector; whole ones are read at an array's end


class Tables(NamedTuple):
    """A model ready to be sampled by inversion: the MDP's arrays, `sums` within rows, `first` the initial states'."""

    choice_start: NDArray[np.int64]
    row_start: NDArray[np.int64]
    target: NDArray[np.int32]
    sums: NDArray[np.float64]
    first: NDArray[np.float64]


def one_state() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """choice_start, row_start, target of a model of one state, to warm kernels up: read-only as a model's arrays, which
    numba tells apart."""
    rows = np.array([0, 1], dtype=np.int64), np.array([0, 1], dtype=np.int64), np.zeros(1, dtype=np.int32)
    for array in rows:
        array.setflags(write=False)
    return rows


class Surrogate(NamedTuple):
    """Q (S, N, C) on the surrogate reward (N,), with its learning rate and discount."""

    Q: NDArray[np.float64]
    reward: NDArray[np.float64]
    alpha: float
    gamma: float


class Replay(NamedTuple):
    """A published method's memory. Rows are (s, q, a, s', q'); places are (next row, number of rows).

    online     whether each step updates at once
    period     0: no replay; else every period-th step of the episode draws a batch
    imagined   (k,) the flag vectors that counterfactual tuples start from; none: the factual tuple is kept
    after      (n_letters, k) where they lead;  closeness (N, k) exp(−‖f̃ − f‖₁), the weight of a tuple (`weighted`)
    n_facts    how many of a batch are drawn from `facts`, a separate memory of factual tuples
    """

    online: bool
    period: int
    rows: NDArray[np.int32]
    weight: NDArray[np.float64]
    place: NDArray[np.int64]
    imagined: NDArray[np.int32]
    after: NDArray[np.int32]
    weighted: bool
    closeness: NDArray[np.float64]
    n_facts: int
    facts: NDArray[np.int32]
    facts_place: NDArray[np.int64]


class Stored(NamedTuple):
    """All transitions seen, each distinct (s, a, s') once, in lists by choice and by successor; row = s · C + a.

    visits (S, C)      of_choice (S·C,), of_target (S,): where its list begins, −1: nowhere
    row, target, seen (n,)   of transition i; next_of_choice, next_of_target (n,) its followers in the lists
    size (1,)          how many there are; there is room for more behind them
    """

    visits: NDArray[np.int64]
    of_choice: NDArray[np.int64]
    of_target: NDArray[np.int64]
    row: NDArray[np.int64]
    target: NDArray[np.int64]
    seen: NDArray[np.int64]
    next_of_choice: NDArray[np.int64]
    next_of_target: NDArray[np.int64]
    size: NDArray[np.int64]


def stored_of(S: int, C: int, room: int) -> Stored:
    """None yet, with room for so many."""
    row, target, seen, next_of_choice, next_of_target = np.zeros((5, room), dtype=np.int64)
    return Stored(
        np.zeros((S, C), dtype=np.int64), np.full(S * C, -1), np.full(S, -1), row, target, seen, next_of_choice,
        next_of_target, np.zeros(1, dtype=np.int64),
    )  # fmt: skip


def with_room(stored: Stored, n: int) -> Stored:
    """The same with room for so many."""
    more = (0, n - len(stored.row))
    names = ("row", "target", "seen", "next_of_choice", "next_of_target")
    return stored._replace(**{name: np.pad(getattr(stored, name), more) for name in names})


class Walked(NamedTuple):
    """The transitions counted so far, and one belief about them; entries e of choice c are start[c] … start[c+1]−1.

    start (choices+1,), visits (choices,)          target, seen (entries,): successors, ascending, and how often
    weight (entries,)   what the belief makes of `seen`
    known (S,)          states that were seen
    room for more entries is behind the last ones
    """

    start: NDArray[np.int64]
    visits: NDArray[np.int64]
    target: NDArray[np.int32]
    seen: NDArray[np.int64]
    weight: NDArray[np.float64]
    known: NDArray[np.bool_]


class Rules(NamedTuple):
    """What a learner knows from the beginning: first_choice (S+1,), letter (S,), delta (letters, Q); verdicts (h+1, Q):
    true 1, false 0, undecided −1; worth (h,): of paradise after each step; letters that occur."""

    first_choice: NDArray[np.int64]
    letter: NDArray[np.int32]
    delta: NDArray[np.int32]
    verdicts: NDArray[np.int8]
    worth: NDArray[np.float64]
    occurring: NDArray[np.int64]


class Route(NamedTuple):
    """A plan for the situations (t, s, q) that transitions lead to: groups of those with the same t and s.

    group (h, S): number of the group, −1: none          first (groups+1,): its situations: memory q, choice
    turned (choices,): the number of the plan in whose time the choice was first tried, of the plan's, `counter`
    counter (2,): number of the plan, of marks
    belief (4,): whether there is none (0), one that no plan is held of (1), or one whose plan is held (2); whether it
    was drawn in this episode; the state and memory where the plan that is held begins
    level (1,): of its hope, a logarithm    limit (choices,): how often they may be taken until it is given up
    """

    group: NDArray[np.int32]
    first: NDArray[np.int64]
    memory: NDArray[np.int32]
    choice: NDArray[np.int32]
    turned: NDArray[np.int64]
    counter: NDArray[np.int64]
    belief: NDArray[np.int64]
    level: NDArray[np.float64]
    limit: NDArray[np.int64]


class Chart(NamedTuple):
    """Where transitions lead from one situation on; it holds for all plans from there until they lead elsewhere.

    stamp (5,): numbers of entries and of known states, and step, state and memory, for which it was made
    begin (S+1,), successors (entries,) of states, ascending    slot (entries,): each one's place among its state's

    touched (h·S,) and layer (h+2,): the state of each group, the first group of each step
    child (n,): what successors are worth: 0 or 1, or 2 + a situation; by group, successor and situation
    kind (situations,): its letter and memory, by number from 1; kinds (h+2,): the first of each step
    peak (situations,): its step and memory, by number; peaks (h+1,): the first of each step
    basis (peaks,), feeds (peaks · occurring letters,): which states may be entered from there: a least worth, and kinds
    """

    stamp: NDArray[np.int64]
    begin: NDArray[np.int64]
    successors: NDArray[np.int32]
    slot: NDArray[np.int32]
    touched: NDArray[np.int64]
    layer: NDArray[np.int64]
    child: NDArray[np.int32]
    kind: NDArray[np.int32]
    kinds: NDArray[np.int64]
    peak: NDArray[np.int32]
    peaks: NDArray[np.int64]
    basis: NDArray[np.float64]
    feeds: NDArray[np.int32]


class Room(NamedTuple):
    """Where a chart and a plan are computed; nothing in it outlasts that, but marks smaller than the counter's.

    chance (entries,); hope, fresh (choices,)   what leads outside of choices tried, untried
    value (2 + situations,), best (kinds,), top (peaks,)    ahead (8 · S,): values of eight situations' successors
    memo (n,), unseen (letters,)     hope by visits; whether a state of that letter was never seen
    used (S,), successors (entries,)   places of states; states, sorted
    number (S · (Q + 2),)            what situations of the next step are worth: 2 + their numbers; 0 and 1
    kind_mark, kind_number (letters, Q), peak_mark, peak_number (Q,)   marks of kinds and peaks, and their numbers
    reached (S,), pending (S, Q / 64)   whether the next step leads there; with which memories, as bits
    letter_mark (letters,), bits (letters, Q / 64)   marks of letters of a group's successors; where its memories lead
    """

    chance: NDArray[np.float64]
    hope: NDArray[np.float64]
    fresh: NDArray[np.float64]
    value: NDArray[np.float64]
    best: NDArray[np.float64]
    top: NDArray[np.float64]
    ahead: NDArray[np.float64]
    memo: NDArray[np.float64]
    unseen: NDArray[np.bool_]
    used: NDArray[np.int64]
    successors: NDArray[np.int32]
    number: NDArray[np.int32]
    kind_mark: NDArray[np.int64]
    kind_number: NDArray[np.int32]
    peak_mark: NDArray[np.int64]
    peak_number: NDArray[np.int32]
    reached: NDArray[np.bool_]
    pending: NDArray[np.uint64]
    letter_mark: NDArray[np.int64]
    bits: NDArray[np.uint64]


def lines(n: int) -> NDArray[np.float64]:
    """(n,) zeros that begin where a line of the cache does: vectors of eight then lie in one each."""
    room = np.zeros(n + 8)
    return room[-room.ctypes.data // 8 % 8 :][:n]


def route_of(h: int, S: int, Q: int, choices: int) -> Route:
    """No plan yet, for at most h·S·Q situations."""
    return Route(
        group=np.full((h, S), -1, dtype=np.int32), first=np.zeros(h * S + 1, dtype=np.int64),
        memory=np.zeros(h * S * Q, dtype=np.int32), choice=np.zeros(h * S * Q + _LANES, dtype=np.int32),
        turned=np.zeros(choices, dtype=np.int64), counter=np.zeros(2, dtype=np.int64),
        belief=np.zeros(4, dtype=np.int64), level=np.zeros(1), limit=np.zeros(choices, dtype=np.int64),
    )  # fmt: skip


def chart_of(h: int, S: int, Q: int, letters: int) -> Chart:
    """None yet; no room for entries, and for children."""
    none, situations, peaks = np.zeros(0, dtype=np.int32), h * S * Q, h * Q
    return Chart(
        stamp=np.full(5, -1, dtype=np.int64), begin=np.zeros(S + 1, dtype=np.int64), successors=none, slot=none,
        touched=np.zeros(h * S, dtype=np.int64), layer=np.zeros(h + 2, dtype=np.int64), child=none,
        kind=np.zeros(situations, dtype=np.int32), kinds=np.zeros(h + 2, dtype=np.int64),
        peak=np.zeros(situations + _LANES, dtype=np.int32), peaks=np.zeros(h + 1, dtype=np.int64),
        basis=np.zeros(peaks), feeds=np.zeros(peaks * letters, dtype=np.int32),
    )  # fmt: skip


def room_of(h: int, S: int, Q: int, letters: int, choices: int) -> Room:
    """Room for such charts and plans; none for entries yet."""
    words = (Q + 63) // 64
    return Room(
        chance=np.zeros(0), hope=np.zeros(choices), fresh=np.zeros(choices), value=np.zeros(h * S * Q + 2 + _LANES),
        best=np.zeros(h * min(letters, S) * Q + 1), top=np.zeros(h * Q), ahead=lines(_LANES * S), memo=np.zeros(64),
        unseen=np.zeros(letters, dtype=np.bool_), used=np.zeros(S, dtype=np.int64),
        successors=np.zeros(0, dtype=np.int32), number=np.zeros(S * (Q + 2), dtype=np.int32),
        kind_mark=np.zeros((letters, Q), dtype=np.int64), kind_number=np.zeros((letters, Q), dtype=np.int32),
        peak_mark=np.zeros(Q, dtype=np.int64), peak_number=np.zeros(Q, dtype=np.int32),
        reached=np.zeros(S, dtype=np.bool_), pending=np.zeros((S, words), dtype=np.uint64),
        letter_mark=np.zeros(letters, dtype=np.int64), bits=np.zeros((letters, words), dtype=np.uint64),
    )  # fmt: skip


def with_entries(chart: Chart, room: Room, n: int) -> tuple[Chart, Room]:
    """The same with room for n entries; the chart is to be made again."""
    chart.stamp[:] = -1
    chart = chart._replace(successors=np.zeros(n, dtype=np.int32), slot=np.zeros(n, dtype=np.int32))
    return chart, room._replace(chance=np.zeros(n), successors=np.zeros(n, dtype=np.int32))


def with_children(chart: Chart) -> Chart:
    """The same with more room for children; it is to be made again."""
    chart.stamp[1:] = -1
    return chart._replace(child=np.zeros(2 * len(chart.child) + 4096, dtype=np.int32))


class Draws(NamedTuple):
    """Random numbers of an episode: normal (entries,); chances (length + 1,), the last one of its hope;
    weights (length,), exponential."""

    normal: NDArray[np.float64]
    chances: NDArray[np.float64]
    weights: NDArray[np.float64]


def draws_of(entries: int, length: int) -> Draws:
    """Room for them."""
    return Draws(np.zeros(entries), np.zeros(length + 1), np.zeros(length))
