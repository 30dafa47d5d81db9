"""Q-learning's inner loops. S model states, N automaton states, C choices, h steps.

surrogate   Q (S, N, C):     Q[s,q,a] += α (r(q') + γ max Q[s',q',·] − Q[s,q,a])                 paper, eq. 5
clocked     Q (S, C, h, N), V (S, h+1, N):  Q_t[s,a,q] += α (V_{t+1}[s',q'] − Q_t[s,a,q]),  V = max over a
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
B1: TypeAlias = NDArray[np.bool_]


@njit(cache=True)
def surrogate_updates(Q: F64, reward: F64, tuples: I32, drawn: I64, alpha: float, gamma: float) -> None:
    """One update per drawn row (s, q, a, s', q') of `tuples`, in order."""
    for i in drawn:
        s, q, a, s2, q2 = tuples[i, 0], tuples[i, 1], tuples[i, 2], tuples[i, 3], tuples[i, 4]
        best = Q[s2, q2, 0]
        for b in range(1, Q.shape[2]):
            best = max(best, Q[s2, q2, b])
        Q[s, q, a] += alpha * (reward[q2] + gamma * best - Q[s, q, a])


@njit(cache=True)
def clocked_update(
    Q: F64, V: F64, n: I32, live: B1, t: int, s: int, q: int, a: int, s2: int, q2: int, n_choices: int, least: float
) -> None:
    """The factual update: one (t, q) from one real transition, α = max(least, 1/n)."""
    if not live[t, q]:
        return
    n[s, a, t, q] += 1
    alpha = max(least, 1.0 / n[s, a, t, q])
    Q[s, a, t, q] += alpha * (V[s2, t + 1, q2] - Q[s, a, t, q])
    best = Q[s, 0, t, q]
    for b in range(1, n_choices):
        best = max(best, Q[s, b, t, q])
    V[s, t, q] = best


@njit(cache=True)
def clocked_transition(
    Q: F64, V: F64, live: B1, memory: I32, after: I32, s: int, a: int, s2: int, n_choices: int, alpha: float
) -> None:
    """Every (t, q) that one real transition (s, a, s') speaks for.

    `memory`: the automaton states that can be current in s; `after[q]`: the state after reading s'.
    """
    for t in range(live.shape[0] - 1, -1, -1):
        for q in memory:
            if live[t, q]:
                Q[s, a, t, q] += alpha * (V[s2, t + 1, after[q]] - Q[s, a, t, q])
        for q in memory:
            if live[t, q]:
                best = Q[s, 0, t, q]
                for b in range(1, n_choices):
                    best = max(best, Q[s, b, t, q])
                V[s, t, q] = best


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state and one step."""
    tuples, first = np.zeros((1, 5), dtype=np.int32), np.zeros(1, dtype=np.int64)
    surrogate_updates(np.zeros((1, 1, 1)), np.zeros(1), tuples, first, 0.1, 0.9)
    Q, V, live = np.zeros((1, 1, 1, 1)), np.zeros((1, 2, 1)), np.ones((1, 1), dtype=np.bool_)
    clocked_update(Q, V, np.zeros((1, 1, 1, 1), dtype=np.int32), live, 0, 0, 0, 0, 0, 0, 1, 0.1)
    clocked_transition(Q, V, live, tuples[0, :1].copy(), tuples[0, :1].copy(), 0, 0, 0, 1, 0.1)
