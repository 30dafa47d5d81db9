"""One step of many runs at once: n live runs, each with its state s, automaton state q and number; u (n,) in [0, 1).

    pick     choice[k] = chosen[s, q]                                            a deterministic policy
    mix      choice[k] = the first i with Σ_{j ≤ i} w[s,q,j] > u · Σ_j w[s,q,j]  a mixture
    move     s' = the first successor whose cumulative probability exceeds u · (the row's total),  q' = δ(L(s'), q)

Runs are independent, so the processor can overlap their lookups; the loop over steps is outside.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel
from stltool.kernels.tuples import one_state

Choices: TypeAlias = NDArray[np.signedinteger[Any]]  # of a policy: int16 where that holds them
F64: TypeAlias = NDArray[np.float64]
I8: TypeAlias = NDArray[np.int8]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def inversion(sums: F64, lo: Any, hi: int, x: float) -> int:
    """The first entry of sums[lo:hi] that exceeds x; the last one if none does."""
    hi -= 1
    while lo < hi:
        middle = (lo + hi) // 2
        if x < sums[middle]:
            hi = middle
        else:
            lo = middle + 1
    return int(lo)


@kernel
def pick(chosen: Choices, s: I32, q: I32, choice: I32) -> int:
    """The first run for which the policy defines no action (a negative entry), or −1."""
    for k in range(len(choice)):
        choice[k] = chosen[s[k], q[k]]
        if choice[k] < 0:
            return k
    return -1


@kernel
def mix(weight: F64, u: F64, s: I32, q: I32, choice: I32) -> None:
    for k in range(len(choice)):
        row = weight[s[k], q[k]]
        total = 0.0
        for w in row:
            total += w
        x, below = u[k] * total, 0.0
        for i in range(len(row)):
            below += row[i]
            if x < below:
                choice[k] = i
                break


@kernel
def move(
    choice_start: I64, row_start: I64, target: I32, sums: F64, letter: I32, delta: I32, verdict: I8,
    choice: I32, u: F64, s: I32, q: I32, number: I32, outcome: I8,
) -> int:  # fmt: skip
    """Move undecided runs to the front, and return their number; outcome[number] receives every run's verdict."""
    live = 0
    for k in range(len(choice)):
        c = choice_start[s[k]] + choice[k]
        lo, hi = row_start[c], row_start[c + 1]
        after = target[inversion(sums, lo, hi, u[k] * sums[hi - 1])]
        memory = delta[letter[after], q[k]]
        outcome[number[k]] = verdict[memory]
        s[live], q[live], number[live] = after, memory, number[k]
        live += verdict[memory] < 0
    return live


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state."""
    rows, sums = one_state(), np.ones(1)
    index, choice, u = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.int32), np.zeros(1)
    pick(np.zeros((1, 1), dtype=np.int16), index, index, choice)
    mix(np.ones((1, 1, 1)), u, index, index, choice)
    verdict, outcome = np.zeros(1, dtype=np.int8), np.zeros(1, dtype=np.int8)
    delta = np.zeros((1, 1), dtype=np.int32)
    move(*rows, sums, index.copy(), delta, verdict, choice, u, index, index, index, outcome)
