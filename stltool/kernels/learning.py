"""Q-learning's inner loops. S model states, N automaton states, C choices, E entries (pairs (t, q) still open).

surrogate   Q (S, N, C):   Q[s,q,a] += α (r(q') + γ max Q[s',q',·] − Q[s,q,a])                  [Wang24, eq. 5]
clocked     Q (S, C, E), V (S, E+2):   Q[s,a,e] += α ((1−g) V[s', succ(e)] + g · worth(e) − Q[s,a,e]),   V = max over a,
            g the share of (s, a) that leads outside, of doubt or of hope
swept       the same with the mean of V[s', succ(e)] over all stored transitions of (s, a), and α = 1

`env`, `table`, `replay` and `stored` are the named tuples of kernels/tuples.py. Kernels pass int64 to each other,
whatever arrays hold, so that each is compiled once.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part
from stltool.kernels.rollout import inversion
from stltool.kernels.tuples import Replay, Surrogate, Tables, one_state, stored_of

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
def clocked_best(Q: F64, s: int, e: int, n_choices: int, chance: float) -> int:
    """The best choice of an entry, ties broken by `chance` in [0, 1)."""
    best, ties = Q[s, 0, e], 1
    for a in range(1, n_choices):
        if Q[s, a, e] > best:
            best, ties = Q[s, a, e], 1
        elif Q[s, a, e] == best:
            ties += 1
    wanted = int(chance * ties)
    for a in range(n_choices):
        if Q[s, a, e] == best:
            if wanted == 0:
                return a
            wanted -= 1
    return 0


@kernel
def store(stored: Any, s: int, a: int, s2: int, n: int) -> bool:
    """Store n transitions (s, a, s'), those of a choice in the order of s'; whether they are the first."""
    row = s * stored.visits.shape[1] + a
    before, i = -1, int(stored.of_choice[row])
    while i >= 0 and stored.target[i] < s2:
        before, i = i, int(stored.next_of_choice[i])
    stored.visits[s, a] += n
    if i >= 0 and stored.target[i] == s2:
        stored.seen[i] += n
        return False
    new = int(stored.size[0])
    stored.row[new], stored.target[new], stored.seen[new] = row, s2, n
    stored.next_of_choice[new], stored.next_of_target[new] = i, stored.of_target[s2]
    stored.of_target[s2] = new
    if before < 0:
        stored.of_choice[row] = new
    else:
        stored.next_of_choice[before] = new
    stored.size[0] = new + 1
    return True


@kernel
def clocked_sweep(
    Q: F64, V: F64, stored: Any, letter: I32, bounds: I64, successor: I32, n_choices: I64, share: F64, worth: F64,
    changed: Any,
) -> None:  # fmt: skip
    """Replay what is stored of every choice whose value may have changed, from the last step back to the first.

    changed (S,): states of whose choices something else is stored now. share (S, C) of a choice's value is worth
    (n_letters, E). bounds (n_letters, h + 1), successor (n_letters, n_letters, E): of learning/tables.py's `Entries`.
    """
    n_states, C = share.shape
    # the step at which they may change, this one's and the next one's apart
    state_due, choice_due = np.full((2, n_states), -1), np.full((2, n_states * C), -1)
    for t in range(bounds.shape[1] - 2, -1, -1):
        due, choices, following = state_due[t % 2], choice_due[t % 2], (t + 1) % 2
        for s in range(n_states):
            if not changed[s] and due[s] != t:
                continue
            mine = np.int64(letter[s])
            lo, hi = bounds[mine, t + 1], bounds[mine, t]
            if lo == hi:
                continue
            for a in range(n_choices[s]):
                row = s * C + a
                if stored.visits[s, a] == 0 or not (changed[s] or choices[row] == t):
                    continue
                values, outside = Q[s, a], share[s, a]
                for e in range(lo, hi):
                    values[e] = outside * worth[mine, e]
                i = stored.of_choice[row]
                while i >= 0:
                    s2 = stored.target[i]
                    weight = (1.0 - outside) * stored.seen[i] / stored.visits[s, a]
                    after, ahead = successor[mine, letter[s2]], V[s2]
                    for e in range(lo, hi):
                        values[e] += weight * ahead[after[e]]
                    i = stored.next_of_choice[i]
            moved = False
            for e in range(lo, hi):
                best = Q[s, 0, e]
                for a in range(1, n_choices[s]):
                    best = max(best, Q[s, a, e])
                if best != V[s, e]:
                    V[s, e], moved = best, True
            if moved:
                i = stored.of_target[s]
                while i >= 0:
                    choice_due[following, stored.row[i]] = state_due[following, stored.row[i] // C] = t - 1
                    i = stored.next_of_target[i]


@kernel
def clocked_ahead(
    Q: F64, V: F64, stored: Any, letter: I32, successor: I32, n_choices: I64, level: float, worth: F64, mark: I32,
    order: I32, stamp: int, s0: int, e0: int,
) -> int:  # fmt: skip
    """Replay what is stored of every choice of what can follow the entry e0 of state s0: how many entries that were.

    The share 1 − e^(level/n) of a choice taken n times is worth (n_letters, E), level the logarithm of that of hope.
    mark (S, E) and order (S·E, 2): room for the entries that can follow, marked by `stamp`, in the order of steps
    """
    n_states, C = stored.visits.shape
    n = stored.size[0]
    begin, target, weight = np.zeros(n_states * C + 1, np.int64), np.empty(n, np.int64), np.empty(n)
    share = np.ones((n_states, C))
    nexts, first, place = np.empty(n, np.int64), np.zeros(n_states + 1, np.int64), np.full(n_states, -1)
    k = which = 0
    for s in range(n_states):
        for a in range(C):
            if stored.visits[s, a] > 0:
                share[s, a] = 1.0 - np.exp(level / stored.visits[s, a])
            i = stored.of_choice[s * C + a]
            while i >= 0:
                s2 = stored.target[i]
                target[k], weight[k] = s2, (1.0 - share[s, a]) * stored.seen[i] / stored.visits[s, a]
                k += 1
                if place[s2] != s:
                    place[s2], nexts[which] = s, s2
                    which += 1
                i = stored.next_of_choice[i]
            begin[s * C + a + 1] = k
        first[s + 1] = which
    E = mark.shape[1]
    order[0, 0], order[0, 1], mark[s0, e0] = s0, e0, stamp
    done, found = 0, 1
    while done < found:
        before, e = np.int64(order[done, 0]), np.int64(order[done, 1])
        done += 1
        for i in range(first[before], first[before + 1]):
            s2 = nexts[i]
            e2 = successor[letter[before], letter[s2], e]
            if e2 < E and mark[s2, e2] != stamp:
                order[found, 0], order[found, 1], mark[s2, e2] = s2, e2, stamp
                found += 1
    for j in range(found - 1, -1, -1):
        here, e = np.int64(order[j, 0]), np.int64(order[j, 1])
        mine, best = letter[here], 0.0
        for a in range(n_choices[here]):
            row = here * C + a
            value = share[here, a] * worth[mine, e]
            for i in range(begin[row], begin[row + 1]):
                value += weight[i] * V[target[i], successor[mine, letter[target[i]], e]]
            Q[here, a, e] = value
            best = max(best, value)
        V[here, e] = best
    return found


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
    clocked_best(Q, 0, 0, 1, 0.0)
    stored, n, one = stored_of(1, 1, 1), np.ones(1, dtype=np.int64), np.ones((1, 1))
    store(stored, 0, 0, 0, 1)
    bounds, changed = np.array([[1, 0]]), np.zeros(1, dtype=np.bool_)
    clocked_sweep(Q, V, stored, letter, bounds, successor, n, one, one, changed)
    mark, order = np.zeros((1, 1), dtype=np.int32), np.zeros((1, 2), dtype=np.int32)
    clocked_ahead(Q, V, stored, letter, successor, n, 0.0, one, mark, order, 1, 0, 0)


WARM_UP = {"published": _published, "clocked": _clocked}
"""Compile or load every kernel of a group that Python calls, on a model of one state and one step."""
