"""One backward sweep in exact integers: value (s, q) as digits of `bits` bits, least first, over the denominator D^k.

    out[s,q] = opt_c Σ_k n_k · V[s', δ(L(s'), q)]        one factor D more than V's denominator

Σ n = D for a row and D · 2^bits ≤ 2^62, so a digit's sum fits and carries run once a row.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel
from stltool.kernels.sweep import Choices, one_state

I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def optimum(
    choice_start: I64, row_start: I64, target: I32, numerator: I64, letter: I32, delta: I32, V: I64,
    chosen: Choices, maximize: bool, wanted: NDArray[np.bool_], bits: int, lo: int, hi: int, out: I64, best: Choices,
) -> None:  # fmt: skip
    """Where `wanted[s,q]`: the optimum over all choices, or `chosen[s,q]`'s value where that is not negative."""
    n_in, n_out, mask = V.shape[2], out.shape[2], (1 << bits) - 1
    total = np.empty(n_out, dtype=np.int64)
    for s in range(lo, hi):
        first, last = choice_start[s], choice_start[s + 1]
        for q in range(V.shape[1]):
            if not wanted[s, q]:
                continue
            only = chosen[s, q]
            found = False
            for c in range(first, last) if only < 0 else range(first + only, first + only + 1):
                total[:] = 0
                for k in range(row_start[c], row_start[c + 1]):
                    n = numerator[k]
                    digits = V[target[k], delta[letter[target[k]], q]]
                    for i in range(n_in):
                        total[i] += n * digits[i]
                carry = np.int64(0)
                for i in range(n_out):
                    carry += total[i]
                    total[i] = carry & mask
                    carry >>= bits
                better = not found
                if found:
                    for i in range(n_out - 1, -1, -1):
                        if total[i] != out[s, q, i]:
                            better = (total[i] > out[s, q, i]) == maximize
                            break
                if better:
                    found = True
                    best[s, q] = c - first
                    for i in range(n_out):
                        out[s, q, i] = total[i]


def warm_up() -> None:
    """Compile or load every kernel here, on a model of one state."""
    rows, one, letter = one_state()[:3], np.ones(1, dtype=np.int64), np.zeros(1, dtype=np.int32)
    layer, choice = np.zeros((1, 1, 1), dtype=np.int64), np.zeros((1, 1), dtype=np.int16)
    delta, wanted = np.zeros((1, 1), dtype=np.int32), np.ones((1, 1), dtype=np.bool_)
    optimum(*rows, one, letter, delta, layer, choice, True, wanted, 61, 0, 1, layer.copy(), choice.copy())
