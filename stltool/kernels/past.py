"""Since over rows of samples, in one pass that does not depend on the window: for robustness, and for truth in int8.

    S(t) = max(ψ_t, min(φ_t, S(t−1)))                                        φ since ψ, back to the row's start
    B(t) of (A₁,B₁) ∘ (A₂,B₂) = (min(A₁,A₂), max(B₂, min(A₂,B₁)))            φ since[0,b] ψ

over the pairs (φ_t, ψ_t). The window's b + 1 pairs are a suffix of one block of b + 1 samples and a prefix of the next
[van Herk; Gil and Werman], so products of blocks from both ends give each with one more ∘. NaN propagates as in numpy.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part

Values: TypeAlias = NDArray[Any]


@part
def _greater(x: Any, y: Any) -> Any:
    return x if x >= y or x != x else y


@part
def _less(x: Any, y: Any) -> Any:
    return x if x <= y or x != x else y


@kernel
def since_start(left: Values, right: Values, rows: int, stride: int, steps: int, out: Values) -> None:
    """Since without a window; sample t of row r is at r·stride + t."""
    for r in range(rows):
        value = right[r * stride]
        out[r * stride] = value
        for i in range(r * stride + 1, r * stride + steps):
            value = _greater(right[i], _less(left[i], value))
            out[i] = value


@kernel
def since_within(
    left: Values, right: Values, rows: int, stride: int, steps: int, b: int, out: Values, least: Values, best: Values,
    after: Values,
) -> None:  # fmt: skip
    """Since over a window of b + 1 samples; `least`, `best` and `after` have room for a row."""
    width = b + 1
    for r in range(rows):
        row = r * stride
        for first in range(0, steps, width):
            end = min(first + width, steps)
            a, value = left[row + first], right[row + first]
            least[first], best[first] = a, value
            for t in range(first + 1, end):
                value = _greater(right[row + t], _less(left[row + t], value))
                a = _less(a, left[row + t])
                least[t], best[t] = a, value
            a, value = left[row + end - 1], right[row + end - 1]
            after[end - 1] = value
            for t in range(end - 2, first - 1, -1):
                value = _greater(value, _less(a, right[row + t]))
                a = _less(a, left[row + t])
                after[t] = value
        for t in range(steps):
            if t <= b or (t - b) % width == 0:
                out[row + t] = best[t]
            else:
                out[row + t] = _greater(best[t], _less(least[t], after[t - b]))
