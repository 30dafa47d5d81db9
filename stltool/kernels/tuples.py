"""Grouped arguments of kernels: named tuples of arrays and numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
    """

    group: NDArray[np.int32]
    first: NDArray[np.int64]
    memory: NDArray[np.int32]
    choice: NDArray[np.int32]
    turned: NDArray[np.int64]
    counter: NDArray[np.int64]


class Room(NamedTuple):
    """Where a plan is computed; nothing in it outlasts that, but marks that are smaller than the counter's.

    probability (entries,), outside (choices,)   rows with hope
    successors (entries,) of states, begin (S+1,); slot (entries,): an entry's place among its state's successors
    value (2, S, Q), best (2, letters, Q) by memory and the letter read into it; mark, best_mark: whether they are set
    pending (S, Q), n_pending (S,)   memories of the next step by state
    touched, layer       the state of each group; the first group of each step
    place (S,), topped (Q,), ahead (S, Q), lines (4, Q), which (Q,)   for one state, step or group
    memo (n,), unseen (letters,)     hope by visits; whether a state of that letter was never seen
    """

    probability: NDArray[np.float64]
    outside: NDArray[np.float64]
    slot: NDArray[np.int32]
    successors: NDArray[np.int32]
    begin: NDArray[np.int64]
    value: NDArray[np.float64]
    best: NDArray[np.float64]
    mark: NDArray[np.int64]
    best_mark: NDArray[np.int64]
    pending: NDArray[np.int32]
    n_pending: NDArray[np.int64]
    touched: NDArray[np.int64]
    layer: NDArray[np.int64]
    place: NDArray[np.int64]
    topped: NDArray[np.int64]
    ahead: NDArray[np.float64]
    lines: NDArray[np.float64]
    which: NDArray[np.int32]
    memo: NDArray[np.float64]
    unseen: NDArray[np.bool_]


def route_of(h: int, S: int, Q: int, choices: int) -> Route:
    """No plan yet, for at most h·S·Q situations."""
    return Route(
        group=np.full((h, S), -1, dtype=np.int32), first=np.zeros(h * S + 1, dtype=np.int64),
        memory=np.zeros(h * S * Q, dtype=np.int32), choice=np.zeros(h * S * Q, dtype=np.int32),
        turned=np.zeros(choices, dtype=np.int64), counter=np.zeros(2, dtype=np.int64),
    )  # fmt: skip


def room_of(h: int, S: int, Q: int, letters: int, choices: int) -> Room:
    """Room for such plans; none for entries yet."""
    return Room(
        probability=np.zeros(0), outside=np.zeros(choices), slot=np.zeros(0, dtype=np.int32),
        successors=np.zeros(0, dtype=np.int32), begin=np.zeros(S + 1, dtype=np.int64), value=np.zeros((2, S, Q)),
        best=np.zeros((2, letters, Q)), mark=np.zeros((S, Q), dtype=np.int64),
        best_mark=np.zeros((letters, Q), dtype=np.int64), pending=np.zeros((S, Q), dtype=np.int32),
        n_pending=np.zeros(S, dtype=np.int64), touched=np.zeros(h * S, dtype=np.int64),
        layer=np.zeros(h + 2, dtype=np.int64), place=np.full(S, -1, dtype=np.int64), topped=np.zeros(Q, dtype=np.int64),
        ahead=np.zeros((S, Q + 4)), lines=np.zeros((3, Q + 4)), which=np.zeros(Q + 4, dtype=np.int32),
        memo=np.zeros(64), unseen=np.zeros(letters, dtype=np.bool_),
    )  # fmt: skip


def with_entries(room: Room, n: int) -> Room:
    """The same with room for n entries."""
    return room._replace(
        probability=np.zeros(n), slot=np.zeros(n, dtype=np.int32), successors=np.zeros(n, dtype=np.int32)
    )
