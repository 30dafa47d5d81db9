"""One backward sweep over a range of model states, W[s', q] = V_{t+1}[s', δ(L(s'), q)] gathered beforehand.

    optimum    out[s,q] = opt_c Σ_s' p(s'|c) · W[s',q]            best[s,q] = the choice's number within its state
    policy     out[s,q] = Σ_s' p(s'|π(s,q)) · W[s',q]
    mixture    out[s,q] = Σ_c π(c|s,q) Σ_s' p(s'|c) · W[s',q]

Loops release the GIL, so threads can share the states out. Inner loops run along q, which is contiguous.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel

F64: TypeAlias = NDArray[np.float64]
Choices: TypeAlias = NDArray[np.signedinteger[Any]]  # int16 where that holds them
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
Numbers: TypeAlias = NDArray[Any]


@kernel
def gather(values: F64, letter: I32, delta: I32, lo: int, hi: int, out: F64) -> None:
    """out[s,q] = values[s, delta[letter[s], q]] for lo <= s < hi."""
    for s in range(lo, hi):
        row = delta[letter[s]]
        for q in range(out.shape[1]):
            out[s, q] = values[s, row[q]]


@kernel
def optimum(
    choice_start: I64, row_start: I64, target: I32, probability: Numbers, W: Numbers,
    maximize: bool, lo: int, hi: int, out: Numbers, best: Choices,
) -> None:  # fmt: skip
    """In doubles; in integers where `probability`, W and out are int64 (kernels/fixed.py)."""
    n_q = W.shape[1]
    total = np.empty(n_q, dtype=W.dtype)
    for s in range(lo, hi):
        first = choice_start[s]
        for c in range(first, choice_start[s + 1]):
            total[:] = 0
            for k in range(row_start[c], row_start[c + 1]):
                p = probability[k]
                row = W[target[k]]
                for q in range(n_q):
                    total[q] += p * row[q]
            if c == first:
                for q in range(n_q):
                    out[s, q] = total[q]
                    best[s, q] = 0
            elif maximize:
                for q in range(n_q):
                    if total[q] > out[s, q]:
                        out[s, q] = total[q]
                        best[s, q] = c - first
            else:
                for q in range(n_q):
                    if total[q] < out[s, q]:
                        out[s, q] = total[q]
                        best[s, q] = c - first


@kernel
def policy(
    choice_start: I64, row_start: I64, target: I32, probability: F64, W: F64,
    chosen: Choices, lo: int, hi: int, out: F64,
) -> None:  # fmt: skip
    """chosen[s,q]: the choice's number within its state; negative where the policy says nothing (value NaN)."""
    for s in range(lo, hi):
        for q in range(W.shape[1]):
            if chosen[s, q] < 0:
                out[s, q] = np.nan
                continue
            c = choice_start[s] + chosen[s, q]
            total = 0.0
            for k in range(row_start[c], row_start[c + 1]):
                total += probability[k] * W[target[k], q]
            out[s, q] = total


@kernel
def mixture(
    choice_start: I64, row_start: I64, target: I32, probability: F64, W: F64,
    weight: F64, lo: int, hi: int, out: F64,
) -> None:  # fmt: skip
    """weight[s,q,i]: the probability of the state's i-th choice."""
    for s in range(lo, hi):
        first = choice_start[s]
        for q in range(W.shape[1]):
            value = 0.0
            for c in range(first, choice_start[s + 1]):
                w = weight[s, q, c - first]
                if w > 0.0:
                    total = 0.0
                    for k in range(row_start[c], row_start[c + 1]):
                        total += probability[k] * W[target[k], q]
                    value += w * total
            out[s, q] = value


def one_state() -> tuple[I64, I64, I32, F64]:
    """The rows of a model of one state, to warm kernels up with: read-only as a model's, which numba tells apart."""
    rows = np.array([0, 1], dtype=np.int64), np.array([0, 1], dtype=np.int64), np.zeros(1, dtype=np.int32), np.ones(1)
    for array in rows:
        array.setflags(write=False)
    return rows


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state."""
    rows, layer, letter = one_state(), np.zeros((1, 1)), np.zeros(1, dtype=np.int32)
    for dtype in (np.float64, np.int64):
        gather(layer.astype(dtype), letter, np.zeros((1, 1), dtype=np.int32), 0, 1, layer.astype(dtype))
    optimum(*rows, layer, True, 0, 1, layer.copy(), np.zeros((1, 1), dtype=np.int16))
    policy(*rows, layer, np.zeros((1, 1), dtype=np.int16), 0, 1, layer.copy())
    mixture(*rows, layer, np.ones((1, 1, 1)), 0, 1, layer.copy())
