"""One backward sweep of an interval MDP over a range of model states; W as in sweep.py.

    nature(c, q) = opt { Σ_k p_k · W[s'_k, q] :  lower_k ≤ p_k ≤ lower_k + width_k,  Σ_k p_k = 1 }

with budget[c] = 1 − Σ_k lower_k handed out in the order of W, ascending where nature minimises (`ascending`). Ties go
by the entry's number, so a value does not depend on how the sorting began. Kernels as in sweep.py, with nature(c, q)
in the place of Σ p·W.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from stltool.kernels.jit import kernel
from stltool.kernels.sweep import F64, I32, I64, Choices, gather, one_state

__all__ = ["gather", "mixture", "optimum", "policy", "warm_up"]


@partial(kernel, inline="always")
def _nature(
    start: int, stop: int, q: int, target: I32, lower: F64, width: F64, left: float, ascending: bool, W: F64,
    key: F64, order: I64,
) -> float:  # fmt: skip
    """Inlined, since a call takes as long as a short row.

    `order` holds 0 … stop−start−1 in any order (the last q's is a good start); `key` is scratch.
    """
    n = stop - start
    for i in range(n):
        w = W[target[start + i], q]
        key[i] = w if ascending else -w
    for i in range(1, n):
        k = order[i]
        j = i - 1
        while j >= 0 and (key[order[j]] > key[k] or (key[order[j]] == key[k] and order[j] > k)):
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = k
    total = 0.0
    for i in range(n):
        k = order[i]
        take = min(width[start + k], left)
        left -= take
        total += (lower[start + k] + take) * abs(key[k])
    return 1.0 if total > 1.0 else total


@kernel
def optimum(
    choice_start: I64, row_start: I64, target: I32, lower: F64, width: F64, budget: F64, ascending: bool, W: F64,
    maximize: bool, lo: int, hi: int, out: F64, best: Choices,
) -> None:  # fmt: skip
    key = np.empty(_longest(choice_start, row_start, lo, hi))
    order = np.empty(len(key), dtype=np.int64)
    for s in range(lo, hi):
        first = choice_start[s]
        for c in range(first, choice_start[s + 1]):
            start, stop = row_start[c], row_start[c + 1]
            for i in range(stop - start):
                order[i] = i
            for q in range(W.shape[1]):
                v = _nature(start, stop, q, target, lower, width, budget[c], ascending, W, key, order)
                if c == first or (v > out[s, q] if maximize else v < out[s, q]):
                    out[s, q] = v
                    best[s, q] = c - first


@kernel
def policy(
    choice_start: I64, row_start: I64, target: I32, lower: F64, width: F64, budget: F64, ascending: bool, W: F64,
    chosen: Choices, lo: int, hi: int, out: F64,
) -> None:  # fmt: skip
    """chosen[s,q]: the choice's number within its state; negative where the policy says nothing (value NaN)."""
    key = np.empty(_longest(choice_start, row_start, lo, hi))
    order = np.empty(len(key), dtype=np.int64)
    for s in range(lo, hi):
        for q in range(W.shape[1]):
            if chosen[s, q] < 0:
                out[s, q] = np.nan
                continue
            c = choice_start[s] + chosen[s, q]
            start, stop = row_start[c], row_start[c + 1]
            for i in range(stop - start):
                order[i] = i
            out[s, q] = _nature(start, stop, q, target, lower, width, budget[c], ascending, W, key, order)


@kernel
def mixture(
    choice_start: I64, row_start: I64, target: I32, lower: F64, width: F64, budget: F64, ascending: bool, W: F64,
    weight: F64, lo: int, hi: int, out: F64,
) -> None:  # fmt: skip
    """weight[s,q,i]: the probability of the state's i-th choice, which nature sees."""
    key = np.empty(_longest(choice_start, row_start, lo, hi))
    order = np.empty(len(key), dtype=np.int64)
    for s in range(lo, hi):
        first = choice_start[s]
        for q in range(W.shape[1]):
            value = 0.0
            for c in range(first, choice_start[s + 1]):
                w = weight[s, q, c - first]
                if w > 0.0:
                    start, stop = row_start[c], row_start[c + 1]
                    for i in range(stop - start):
                        order[i] = i
                    value += w * _nature(start, stop, q, target, lower, width, budget[c], ascending, W, key, order)
            out[s, q] = value


@kernel
def _longest(choice_start: I64, row_start: I64, lo: int, hi: int) -> int:
    longest = 0
    for c in range(choice_start[lo], choice_start[hi]):
        longest = max(longest, row_start[c + 1] - row_start[c])
    return longest


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state."""
    layer, rows = np.zeros((1, 1)), (*one_state(), np.zeros(1), np.zeros(1), True)
    optimum(*rows, layer, True, 0, 1, layer.copy(), np.zeros((1, 1), dtype=np.int16))
    policy(*rows, layer, np.zeros((1, 1), dtype=np.int16), 0, 1, layer.copy())
    mixture(*rows, layer, np.ones((1, 1, 1)), 0, 1, layer.copy())
