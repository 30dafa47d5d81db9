"""Q-learning's inner loops. S model states, N automaton states, C choices, E entries (pairs (t, q) still open).

surrogate   Q (S, N, C):   Q[s,q,a] += α (r(q') + γ max Q[s',q',·] − Q[s,q,a])                  [Wang24, eq. 5]
clocked     Q (S, C, E), V (S, E+2):   Q[s,a,e] += α ((1−g) V[s', succ(e)] + g · worth(e) − Q[s,a,e]),   V = max over a,
            g the share of (s, a) that leads outside, of doubt or of hope

`env`, `table` and `replay` are the named tuples of kernels/tuples.py. Kernels pass int64 to each other, whatever arrays
hold, so that each is compiled once.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part
from stltool.kernels.rollout import inversion
from stltool.kernels.tuples import Replay, Surrogate, Tables, one_state

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def greedy(values: F64, n: int, chance: float) -> int:
    """The index of the best of the first n, ties broken by `chance` in [0, 1)."""
    best, ties = values[0], 1
    for i in range(1, n):
        if values[i] > best:
            best, ties = values[i], 1
        elif values[i] == best:
            ties += 1
    wanted = int(chance * ties)
    for i in range(n):
        if values[i] == best:
            if wanted == 0:
                return i
            wanted -= 1
    return 0


# ----------------------------------------------------------------------------------------------- as published


@part
def surrogate_update(table: Any, s: Any, q: Any, a: Any, s2: Any, q2: Any) -> None:
    best = table.Q[s2, q2, 0]
    for b in range(1, table.Q.shape[2]):
        best = max(best, table.Q[s2, q2, b])
    table.Q[s, q, a] += table.alpha * (table.reward[q2] + table.gamma * best - table.Q[s, q, a])


@part
def remember(rows: I32, place: I64, s: Any, q: Any, a: Any, s2: Any, q2: Any) -> int:
    """Store a row, replacing the oldest if the memory is full; place = (next, size). Returns its index."""
    i = int(place[0])
    rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4] = s, q, a, s2, q2
    place[0] = (i + 1) % len(rows)
    place[1] = min(place[1] + 1, len(rows))
    return i


@kernel
def replay_batch(table: Any, replay: Any, u: F64) -> None:
    """One update for each number of u: the first `n_facts` are drawn from the facts, the rest from the memory."""
    sums = np.empty(0)
    if replay.weighted:
        sums, total = np.empty(replay.place[1]), 0.0
        for i in range(len(sums)):
            total += replay.weight[i]
            sums[i] = total
    for j in range(len(u)):
        if j < replay.n_facts:
            row = replay.facts[int(u[j] * replay.facts_place[1])]
        elif replay.weighted:
            row = replay.rows[inversion(sums, np.int64(0), len(sums), u[j] * sums[-1])]
        else:
            row = replay.rows[int(u[j] * replay.place[1])]
        surrogate_update(
            table, np.int64(row[0]), np.int64(row[1]), np.int64(row[2]), np.int64(row[3]), np.int64(row[4])
        )


@kernel
def surrogate_observe(
    table: Any, replay: Any, draws: F64, letter: Any, t: int, s: Any, q: Any, a: int, s2: Any, q2: Any
) -> None:
    """The update of a published method for one transition; `letter` is that of s', draws (n, batch) of the episode."""
    if replay.online:
        surrogate_update(table, s, q, a, s2, q2)
    if replay.period == 0:
        return
    if replay.n_facts > 0:
        remember(replay.facts, replay.facts_place, s, q, a, s2, q2)
    if len(replay.imagined) == 0:
        remember(replay.rows, replay.place, s, q, a, s2, q2)
    for i in range(len(replay.imagined)):
        before, after = np.int64(replay.imagined[i]), np.int64(replay.after[letter, i])
        row = remember(replay.rows, replay.place, s, before, a, s2, after)
        replay.weight[row] = replay.closeness[q, i] if replay.weighted else 1.0
    if t % replay.period == 0:
        replay_batch(table, replay, draws[t // replay.period])


@kernel
def surrogate_episode(
    env: Any, letter: I32, delta: I32, initial: Any, table: Any, replay: Any,
    moves: F64, explore: F64, epsilon: float, draws: F64, states: I32, actions: I32,
) -> None:  # fmt: skip
    """A whole episode of len(actions) steps from states[0], which is not read; states (n+1,) and actions (n,) are
    filled."""
    s, q = np.int64(states[0]), initial
    for t in range(len(actions)):
        n = env.choice_start[s + 1] - env.choice_start[s]
        if explore[t, 0] < epsilon:
            a = int(explore[t, 1] * n)
        else:
            a = greedy(table.Q[s, q], n, explore[t, 1])
        c = env.choice_start[s] + a
        lo, hi = env.row_start[c], env.row_start[c + 1]
        s2 = np.int64(env.target[inversion(env.sums, lo, hi, moves[t] * env.sums[hi - 1])])
        q2 = np.int64(delta[letter[s2], q])
        surrogate_observe(table, replay, draws, np.int64(letter[s2]), t, s, q, a, s2, q2)
        states[t + 1], actions[t] = s2, a
        s, q = s2, q2


# ------------------------------------------------------------------------------------------------- corrected


@kernel
def clocked_update(
    Q: F64, V: F64, visits: I64, s: int, a: int, e: int, n_choices: int, value: float, least: float
) -> None:
    """The factual update of one entry, α = max(least, 1/n), n with this visit."""
    Q[s, a, e] += max(least, 1.0 / visits[s, a, e]) * (value - Q[s, a, e])
    best = Q[s, 0, e]
    for b in range(1, n_choices):
        best = max(best, Q[s, b, e])
    V[s, e] = best


@kernel
def clocked_transitions(
    Q: F64, V: F64, visits: I64, letter: I32, entries: I64, successor: I32, n_choices: I64, least: float,
    share: F64, worth: F64, rows: I32,
) -> None:  # fmt: skip
    """Every open (t, q) for which real transitions, rows (n, 3) of (s, a, s'), are evidence, one after another.

    entries (n_letters,): how many a state has, those of the last step first; successor (n_letters, n_letters, E).
    share (S, C) of every choice's value is `worth` (n_letters, E).
    """
    for i in range(len(rows)):
        s, a, s2 = rows[i, 0], rows[i, 1], rows[i, 2]
        alpha, outside = max(least, 1.0 / visits[s, a]), share[s, a]
        after, aside = successor[letter[s], letter[s2]], worth[letter[s]]
        mine, values, ahead = Q[s, a], V[s], V[s2]
        for e in range(entries[letter[s]]):  # later steps come first, so values of the same state are already updated
            old = mine[e]
            new = old + alpha * ((1.0 - outside) * ahead[after[e]] + outside * aside[e] - old)
            mine[e] = new
            if new >= values[e]:
                values[e] = new
            elif old == values[e]:
                best = Q[s, 0, e]
                for b in range(1, n_choices[s]):
                    best = max(best, Q[s, b, e])
                values[e] = best


def _published() -> None:
    env = Tables(*one_state(), np.ones(1), np.ones(1))
    rows, place, one = np.zeros((1, 5), dtype=np.int32), np.zeros(2, dtype=np.int64), np.ones(1)
    whole = np.zeros((1, 1), dtype=np.int32)
    replay = Replay(True, 1, rows, one, place, whole[0], whole, True, np.ones((1, 1)), 1, rows, place)
    table = Surrogate(np.zeros((1, 1, 1)), one, 0.1, 0.9)
    draws, states = np.zeros((1, 1)), np.zeros(2, dtype=np.int32)
    letter, actions, moves = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.int32), np.zeros(1)
    surrogate_episode(
        env, letter, whole, 0, table, replay, moves, np.zeros((1, 2)), 0.5, draws, states, actions
    )  # fmt: skip
    surrogate_observe(table, replay, draws, 0, 0, 0, 0, 0, 0, 0)
    greedy(table.Q[0, 0], 1, 0.5)


def _clocked() -> None:
    Q, V, visits = np.zeros((1, 1, 1)), np.zeros((1, 3)), np.ones((1, 1, 1), dtype=np.int64)
    letter, successor = np.zeros(1, dtype=np.int32), np.zeros((1, 1, 1), dtype=np.int32)
    clocked_update(Q, V, visits, 0, 0, 0, 1, 0.0, 0.1)
    n, rows = np.ones(1, dtype=np.int64), np.zeros((1, 3), dtype=np.int32)
    share, worth = np.zeros((1, 1)), np.zeros((1, 1))
    clocked_transitions(Q, V, visits[0], letter, n, successor, n, 0.1, share, worth, rows)


WARM_UP = {"published": _published, "clocked": _clocked}
"""Compile or load every kernel of a group that Python calls, on a model of one state and one step."""
