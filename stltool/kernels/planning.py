"""Backward induction over all (t, s, q) of a small problem in one call, for the model-based learner's plans.

    V_t(s, q) = max over c of  Σ_s' p(s'|c) · V_{t+1}(s', δ(L(s'), q)) + outside(c) · top_t(q)     where q is undecided
                1 / 0                                                                  where it is satisfied / violated
    top_t(q)  = min(worth_t, max over s' of V_{t+1}(s', δ(L(s'), q))), but worth_t for a choice that is all outside

Every sum is added in the order of the entries, what leads outside last, so its result does not depend on the machine.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]


@kernel
def plan(
    since: int, first_choice: I64, start: I64, target: I64, probability: F64, outside: F64, worth: F64, letter: I32,
    delta: I32, verdicts: NDArray[np.int8], spans: I64, table: NDArray[Any],
) -> None:  # fmt: skip
    """Fill `table` (h, S, Q) with the first best choices of steps since … h−1.

    first_choice (S+1,) are each state's choices, start (choices+1,) each choice's entries: target, probability
    outside (choices,): the rest of each row, worth `worth` (h,) after each step, but no more than the best state
    verdicts (h+1, Q): true 1, false 0, undecided −1        spans (h, letters, 2): where undecided states are
    """
    h, S, Q = table.shape
    V, W = np.empty((S, Q)), np.empty((S, Q))
    total, best, top = np.empty(Q), np.empty(Q), np.empty(Q)
    which = np.empty(Q, np.int64)
    for s in range(S):
        for q in range(Q):
            V[s, q] = 1.0 if verdicts[h, q] == 1 else 0.0
    for t in range(h - 1, since - 1, -1):
        low, high = np.int64(Q), np.int64(0)
        for i in range(spans.shape[1]):
            if spans[t, i, 1] > spans[t, i, 0]:
                low, high = min(low, spans[t, i, 0]), max(high, spans[t, i, 1])
        for q in range(low, high):
            top[q] = 0.0
        for s in range(S):
            row, ahead, seen = V[s], W[s], delta[letter[s]]
            for q in range(low, high):
                ahead[q] = row[seen[q]]
                top[q] = max(top[q], ahead[q])
        for s in range(S):
            row = V[s]
            for q in range(Q):
                row[q] = 1.0 if verdicts[t, q] == 1 else 0.0
            lo, hi = spans[t, letter[s], 0], spans[t, letter[s], 1]
            n = hi - lo
            if n <= 0:
                continue
            for c in range(first_choice[s], first_choice[s + 1]):
                lost = outside[c]
                first, after = start[c], start[c + 1]
                if first == after:
                    for j in range(n):
                        total[j] = lost * worth[t]
                else:
                    p, values = probability[first], W[target[first], lo:hi]
                    for j in range(n):
                        total[j] = p * values[j]
                    for e in range(first + 1, after):
                        p, values = probability[e], W[target[e], lo:hi]
                        for j in range(n):
                            total[j] += p * values[j]
                    for j in range(n):
                        total[j] += lost * min(top[lo + j], worth[t])
                if c == first_choice[s]:
                    for j in range(n):
                        best[j], which[j] = total[j], 0
                else:
                    a = c - first_choice[s]
                    for j in range(n):
                        better = total[j] > best[j]
                        best[j] = total[j] if better else best[j]
                        which[j] = a if better else which[j]
            for j in range(n):
                table[t, s, lo + j] = which[j]
                if verdicts[t, lo + j] == -1:
                    row[lo + j] = best[j]


def warm_up() -> None:
    """Compile or load it, on a problem of one state and one step."""
    one, whole, places, verdicts = np.zeros(1), np.zeros(1, dtype=np.int32), np.arange(2), np.zeros((2, 1), np.int8)
    spans, table = np.zeros((1, 1, 2), dtype=np.int64), np.zeros((1, 1, 1), dtype=np.uint8)
    plan(0, places, places, np.zeros(1, np.int64), one, one, one, whole, whole[None], verdicts, spans, table)
