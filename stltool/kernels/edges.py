"""One backward step over edges (checking/induction/edges.py), for numbers that exceed one machine word or need sorting.

n open pairs with choices[i] … choices[i+1]−1, choice j with edges start[j] … start[j+1]−1, each of the model's entry[k]
and the slot child[k] ahead. `best` gets the index of each pair's first best choice.

    digits   exact integers, `bits` bits per digit, least first, over the denominator D^k:  Σ n_k · V[child], one factor
             D more than the layer ahead; Σ n = D and D · 2^bits ≤ 2^62, so sums of digits fit and carries run once
    nature   opt { Σ_k p_k · V[child_k] : lower_k ≤ p_k ≤ lower_k + width_k, Σ_k p_k = 1 }, the budget 1 − Σ lower
             distributed in the order of V, ascending if nature minimises; equal values by the entry's number. All
             Σ lower · V are added first: kernels/nature.py does the same, eight at a time
    sums     M weighted sums at once: Σ p_k · (V[child_k] + reward[letter_k, q]), of the choice that is best for the
             first of them, or mixed by `weight`
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def digits(
    choices: I64, start: I64, entry: I64, child: I64, numerator: I64, ahead: I64, bits: int, maximize: bool,
    lo: int, hi: int, out: I64, best: I64,
) -> None:  # fmt: skip
    n_in, n_out, mask = ahead.shape[1], out.shape[1], (1 << bits) - 1
    total = np.empty(n_out, dtype=np.int64)
    for i in range(lo, hi):
        for j in range(choices[i], choices[i + 1]):
            total[:] = 0
            for k in range(start[j], start[j + 1]):
                n, value = numerator[entry[k]], ahead[child[k]]
                for d in range(n_in):
                    total[d] += n * value[d]
            carry = np.int64(0)
            for d in range(n_out):
                carry += total[d]
                total[d] = carry & mask
                carry >>= bits
            better = j == choices[i]
            if not better:
                for d in range(n_out - 1, -1, -1):
                    if total[d] != out[i, d]:
                        better = (total[d] > out[i, d]) == maximize
                        break
            if better:
                best[i] = j - choices[i]
                for d in range(n_out):
                    out[i, d] = total[d]


@kernel
def nature(
    start: I64, entry: I64, child: I64, lower: F64, width: F64, budget: F64, choice: I64, ascending: bool, ahead: F64,
    lo: int, hi: int, out: F64,
) -> None:  # fmt: skip
    """out[j]: the value of choice j; choice[j] is its number in the model, which budget (n_choices,) is by."""
    longest = 1
    for j in range(lo, hi):
        longest = max(longest, start[j + 1] - start[j])
    key, order = np.empty(longest), np.empty(longest, dtype=np.int64)
    for j in range(lo, hi):
        first, n = start[j], start[j + 1] - start[j]
        left, total = budget[choice[j]], 0.0
        for i in range(n):
            w = ahead[child[first + i]]
            total += lower[entry[first + i]] * w
            key[i] = w if ascending else -w
            k = i - 1
            while k >= 0 and key[order[k]] > key[i]:
                order[k + 1] = order[k]
                k -= 1
            order[k + 1] = i
        for i in range(n):
            k = order[i]
            take = min(width[entry[first + k]], left)
            left -= take
            total += take * abs(key[k])
        out[j] = 1.0 if total > 1.0 else total


@kernel
def sums(
    choices: I64, start: I64, entry: I64, child: I64, q: I64, probability: F64, reads: I32, reward: F64, ahead: F64,
    weight: F64, lo: int, hi: int, out: F64, best: I64,
) -> None:  # fmt: skip
    """reads[e]: the letter that entry e of the model leads to; reward (letters, Q, M); weight (choices,), or empty."""
    n, mixed = ahead.shape[1], len(weight) > 0
    total = np.empty(n)
    for i in range(lo, hi):
        for j in range(choices[i], choices[i + 1]):
            total[:] = 0.0
            for k in range(start[j], start[j + 1]):
                e = entry[k]
                p, value, paid = probability[e], ahead[child[k]], reward[reads[e], q[i]]
                for m in range(n):
                    total[m] += p * (value[m] + paid[m])
            if mixed:
                for m in range(n):
                    out[i, m] += weight[j] * total[m]
            elif j == choices[i] or total[0] > out[i, 0]:
                best[i] = j - choices[i]
                for m in range(n):
                    out[i, m] = total[m]
