"""One backward sweep in int64 fixed point, rounded up: out = ⌈Σ n·W / D⌉ over W in units of 1/one.

Numerators n over one denominator D, Σ n = D for a row, and D·one ≤ 2^62: sums cannot overflow. Arguments as in
kernels/sweep.py; where a policy says nothing the value is −1, and so is whatever depends on it.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel
from stltool.kernels.sweep import Choices, one_state
from stltool.kernels.sweep import optimum as sums

I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def optimum(
    choice_start: I64, row_start: I64, target: I32, numerator: I64, denominator: int, W: I64,
    maximize: bool, lo: int, hi: int, out: I64, best: Choices,
) -> None:  # fmt: skip
    sums(choice_start, row_start, target, numerator, W, maximize, lo, hi, out, best)
    inverse = 1.0 / denominator
    for s in range(lo, hi):
        # ⌈x / D⌉ without an integer division, which does not vectorise: a quotient in doubles, the remainder's, exactly
        for q in range(out.shape[1]):
            x = out[s, q]
            y = np.int64(x * inverse)
            y += np.int64(np.ceil((x - y * denominator) * inverse))
            y -= np.int64((y - 1) * denominator >= x)
            out[s, q] = y + np.int64(y * denominator < x)


@kernel
def policy(
    choice_start: I64, row_start: I64, target: I32, numerator: I64, denominator: int, W: I64,
    chosen: Choices, lo: int, hi: int, out: I64,
) -> None:  # fmt: skip
    for s in range(lo, hi):
        for q in range(W.shape[1]):
            if chosen[s, q] < 0:
                out[s, q] = -1
                continue
            c = choice_start[s] + chosen[s, q]
            total = 0
            known = True
            for k in range(row_start[c], row_start[c + 1]):
                w = W[target[k], q]
                known &= w >= 0
                total += numerator[k] * w
            out[s, q] = -((-total) // denominator) if known else -1


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state."""
    rows, one = one_state()[:3], np.ones(1, dtype=np.int64)
    layer, choice = np.zeros((1, 1), dtype=np.int64), np.zeros((1, 1), dtype=np.int16)
    optimum(*rows, one, 1, layer, True, 0, 1, layer.copy(), choice)
    policy(*rows, one, 1, layer, choice, 0, 1, layer.copy())
