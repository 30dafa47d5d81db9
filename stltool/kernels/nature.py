"""A backward step for interval probabilities, eight automaton states at a time: nature's choice within the sweep of
kernels/tiles.py, whose arrays these are.

    V_t[s,q] = opt_c nature { Σ_k p_k · W[s'_k, q] : lower_k ≤ p_k ≤ lower_k + width_k, Σ_k p_k = 1 }

The budget 1 − Σ lower goes to the entries in the order of W, to each at most its width (checking/robust.py); equal
values keep the order of the entries. Lanes differ in this order, so every lane sorts its own row by comparing and
exchanging neighbours: in registers for up to four entries; in memory for more, where an entry moves back only as long
as one of the eight lanes still needs it. W and width alone are sorted: Σ lower · W is added in the entries' order.

If nature maximises, everything is computed with −W, which rounds alike.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part
from stltool.kernels.lanes import add, any_bit, at, greater, load, mul, put, select, splat, splat_at, store, sub
from stltool.kernels.tiles import better, finish, open_tiles
from stltool.kernels.words import ZERO

Bytes: TypeAlias = NDArray[np.uint8]
F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]


@kernel
def sweep(
    states: I32, start: I64, word: I32, open_bits: U64, sure_bits: U64, tiles: I64, lo: int, hi: int, slot: I32,
    block: I32, W: F64, near_start: I64, near: I32, choice_start: I64, row_start: I64, position: I32, lower: F64,
    width: F64, budget: F64, longest: int, ascending: bool, maximize: bool, restricted: bool, allowed_start: I64,
    allowed: U64, worst: float, sure: float, rest: float, n_words: int, keep: bool, values: F64,
    best: NDArray[Any],
) -> None:  # fmt: skip
    """As tiles.sweep; `longest`: entries of a row, `ascending`: nature minimises."""
    widest = np.int64(1)
    for i in range(lo, hi):
        widest = max(widest, near_start[states[i] + 1] - near_start[states[i]])
    near_block, which = np.empty(widest, np.int64), np.empty(8, np.int64)
    place, live, certain = np.empty(8, np.int64), np.empty(8, np.uint8), np.empty(8, np.uint8)
    sorted_values, sorted_widths = np.empty(8 * longest, np.float64), np.empty(8 * longest, np.float64)
    sures, rests, nothing, one = splat(sure), splat(rest), splat(worst), splat(1.0)
    sign = splat(1.0 if ascending else -1.0)
    first_choice, divisor = splat(np.int64(0)), splat(np.int64(1))
    for i in range(lo, hi):
        s, tile = states[i], tiles[i]
        near_first, n_near = near_start[s], near_start[s + 1] - near_start[s]
        c0, c1 = choice_start[s], choice_start[s + 1]
        for k in range(start[i], start[i + 1]):
            w, mine = np.int64(at(word, k)), allowed_start[k] if restricted else np.int64(0)
            between, ones = at(open_bits, k), at(sure_bits, k)
            n, tile = open_tiles(between, ones, tile, which, place, live, certain, sures, rests, values)
            if n == 0:
                continue
            for e in range(n_near):
                j = np.int64(slot[near[near_first + e]])
                put(near_block, e, 64 * np.int64(at(block, j * n_words + w)))
            for r in range(n):
                q, b, i_best = at(which, r), nothing, first_choice
                for c in range(c0, c1):
                    bits = at(allowed, mine + c - c0) if restricted else ZERO
                    if restricted and bits & between == ZERO:
                        continue
                    e, d = at(row_start, c), at(row_start, c + 1) - at(row_start, c)
                    left = splat_at(budget, c)
                    w0 = splat_at(width, e)
                    x0 = mul(sign, load(W, at(near_block, np.int64(at(position, e))) + q))
                    x = mul(splat_at(lower, e), x0)
                    if d == 1:
                        x = add(x, mul(_least(w0, left), x0))
                    elif d <= 4:
                        w1 = splat_at(width, e + 1)
                        x1 = mul(sign, load(W, at(near_block, np.int64(at(position, e + 1))) + q))
                        x = add(x, mul(splat_at(lower, e + 1), x1))
                        x0, x1, w0, w1 = _ordered(x0, x1, w0, w1)
                        if d == 2:
                            w0 = _least(w0, left)
                            x = add(x, mul(w0, x0))
                            x = add(x, mul(_least(w1, sub(left, w0)), x1))
                        else:
                            w2 = splat_at(width, e + 2)
                            x2 = mul(sign, load(W, at(near_block, np.int64(at(position, e + 2))) + q))
                            x = add(x, mul(splat_at(lower, e + 2), x2))
                            x1, x2, w1, w2 = _ordered(x1, x2, w1, w2)
                            x0, x1, w0, w1 = _ordered(x0, x1, w0, w1)
                            if d == 3:
                                w0 = _least(w0, left)
                                x = add(x, mul(w0, x0))
                                left = sub(left, w0)
                                w1 = _least(w1, left)
                                x = add(x, mul(w1, x1))
                                x = add(x, mul(_least(w2, sub(left, w1)), x2))
                            else:
                                w3 = splat_at(width, e + 3)
                                x3 = mul(sign, load(W, at(near_block, np.int64(at(position, e + 3))) + q))
                                x = add(x, mul(splat_at(lower, e + 3), x3))
                                x2, x3, w2, w3 = _ordered(x2, x3, w2, w3)
                                x1, x2, w1, w2 = _ordered(x1, x2, w1, w2)
                                x0, x1, w0, w1 = _ordered(x0, x1, w0, w1)
                                w0 = _least(w0, left)
                                x = add(x, mul(w0, x0))
                                left = sub(left, w0)
                                w1 = _least(w1, left)
                                x = add(x, mul(w1, x1))
                                left = sub(left, w1)
                                w2 = _least(w2, left)
                                x = add(x, mul(w2, x2))
                                x = add(x, mul(_least(w3, sub(left, w2)), x3))
                    else:
                        store(sorted_values, 0, x0)
                        store(sorted_widths, 0, w0)
                        for f in range(1, d):
                            w0 = splat_at(width, e + f)
                            x0 = mul(sign, load(W, at(near_block, np.int64(at(position, e + f))) + q))
                            x = add(x, mul(splat_at(lower, e + f), x0))
                            g = f - 1
                            while g >= 0:
                                x1, w1 = load(sorted_values, 8 * g), load(sorted_widths, 8 * g)
                                m = greater(x1, x0)
                                if not any_bit(m):
                                    break
                                store(sorted_values, 8 * g + 8, select(m, x1, x0))
                                store(sorted_widths, 8 * g + 8, select(m, w1, w0))
                                x0, w0 = select(m, x0, x1), select(m, w0, w1)
                                g -= 1
                            store(sorted_values, 8 * g + 8, x0)
                            store(sorted_widths, 8 * g + 8, w0)
                        for f in range(d):
                            w0 = _least(load(sorted_widths, 8 * f), left)
                            x = add(x, mul(w0, load(sorted_values, 8 * f)))
                            left = sub(left, w0)
                    x = _least(mul(sign, x), one)
                    m = better(x, b, maximize, restricted, bits, q)
                    b, i_best = select(m, x, b), select(m, splat(c - c0), i_best)
                finish(b, i_best, r, place, live, certain, divisor, one, sures, rests, keep, values, best)


@part
def _least(x: Any, y: Any) -> Any:
    return select(greater(x, y), y, x)


@part
def _ordered(x: Any, y: Any, v: Any, w: Any) -> tuple[Any, Any, Any, Any]:
    """Two values and their widths v and w, in every lane the smaller value first."""
    m = greater(x, y)
    return select(m, y, x), select(m, x, y), select(m, w, v), select(m, v, w)
