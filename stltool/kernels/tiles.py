"""Numbers of a backward induction by steps, eight automaton states at a time, for values strictly between 0 and 1.

Layers and their sets are those of kernels/words.py. A layer's values are stored by *tiles* of eight automaton states
that have an open or sure pair: tile number tiles[i] … of the layer's i-th state, ascending; lanes that are neither
contain `rest`, the value of unlisted pairs (not 0). In doubles, or in fixed point (int64, rounded up).

    blocks   assigns to every row and word that is read a block of 64 numbers of W, the next values seen through δ
    gather   fills W:   W[s', q] = V_{t+1}[s', δ(L(s'), q)]
    sweep    V_t[s,q] = opt_c Σ_s' p(s'|c) · W[s',q] on open pairs, with the choice; best value and best choice stay in
             registers

Values do not depend on how threads share the states: each is computed by one thread, in a fixed order.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from stltool.kernels import lanes
from stltool.kernels.jit import kernel, part
from stltool.kernels.lanes import (
    add,
    at,
    both,
    greater,
    load,
    mask,
    mul,
    narrow_where,
    put,
    select,
    splat,
    splat_at,
    store,
    trailing,
)
from stltool.kernels.words import ONE, ZERO, spread

Bytes: TypeAlias = NDArray[np.uint8]
Bools: TypeAlias = NDArray[np.bool_]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]
Numbers: TypeAlias = NDArray[Any]

PAD = 64  # numbers before and after a row of values, so that shifted loads stay inside
_BYTE = np.uint64(255)


@kernel
def tile_maps(delta: I32, n_words: int) -> tuple[Bools, I32, I32, Bytes]:
    """δ by letter and tile: whether a lane takes value q + shift (in the mask) or that of one state, and the shift and
    the state.

    (letters · 8 · n_words,) each. Otherwise values are gathered one by one.
    """
    n_letters, n_states = delta.shape
    n = 8 * n_words
    simple = np.zeros((n_letters, n), np.bool_)
    shift, constant = np.zeros((n_letters, n), np.int32), np.zeros((n_letters, n), np.int32)
    moved = np.zeros((n_letters, n), np.uint8)
    for letter in range(n_letters):
        row = delta[letter]
        for b in range(n):
            lo, hi = 8 * b, min(n_states, 8 * b + 8)
            most = 0
            for i in range(lo, hi):
                for j in range(lo, hi):
                    bits, count = 0, 0
                    for r in range(lo, hi):
                        if row[r] - r == row[i] - i:
                            bits |= 1 << (r - lo)
                            count += 1
                        elif row[r] == row[j]:
                            count += 1
                    if count > most:
                        most, moved[letter, b], shift[letter, b], constant[letter, b] = count, bits, row[i] - i, row[j]
            simple[letter, b] = most >= hi - lo
    return simple.ravel(), shift.ravel(), constant.ravel(), moved.ravel()


@kernel
def blocks(n: int, rows: U64, groups: U64, n_words: int, width: int, shift: int, block: I32) -> int:
    """block[j·n_words + w]: the block of word w of row j, where it is not 0; returns the number of blocks."""
    count = 0
    for j in range(n):
        left = groups[j]
        while left != ZERO:
            g = trailing(left) << shift
            left &= left - ONE
            for w in range(max(g - 1, 0), min(g + (1 << shift) - 1, n_words)):
                if at(rows, j * width + w + 1) != ZERO:
                    put(block, j * n_words + w, np.int32(count))
                    count += 1
    return count


@kernel
def gather(
    found: I32, n: int, rows: U64, groups: U64, block: I32, W: I64, slot: I32, start: I64, word: I32,
    open_bits: U64, sure_bits: U64, tiles: I64, values: I64, decided: I64, undecided: U64, letter: I32,
    delta: I32, simple: Bools, moves_by: I32, constant: I32, moved: Bytes, n_words: int, width: int, shift: int,
) -> None:  # fmt: skip
    """Fill the blocks of W from the next layer's values; doubles are moved as the int64 of the same bits.

    decided (PAD + 64·n_words + PAD,): the value of each automaton state that is not listed: its verdict's or `rest`;
    undecided is a row of words; delta (letters · 64·n_words,).
    """
    n_padded = 64 * n_words
    row = decided.copy()
    inner = row[PAD:]
    for j in range(n):
        s = found[j]
        i = np.int64(slot[s])
        if i >= 0:
            tile = tiles[i]
            for k in range(start[i], start[i + 1]):
                w: Any = np.int64(at(word, k))
                left, listed = spread(at(open_bits, k) | at(sure_bits, k)), at(undecided, w + 1)
                while left != ZERO:
                    q = trailing(left)
                    left &= left - ONE
                    here = mask(np.uint8((listed >> np.uint64(q)) & _BYTE))
                    store(inner, 64 * w + q, select(here, load(values, 8 * tile), load(inner, 64 * w + q)))
                    tile += 1
        base, opened = np.int64(letter[s]), groups[j]
        while opened != ZERO:
            g = trailing(opened) << shift
            opened &= opened - ONE
            for w in range(max(g - 1, 0), min(g + (1 << shift) - 1, n_words)):
                left = at(rows, j * width + w + 1)
                if left == ZERO:
                    continue
                left, to = spread(left), 64 * np.int64(at(block, j * n_words + w))
                while left != ZERO:
                    q = trailing(left)
                    left &= left - ONE
                    e = base * 8 * n_words + 8 * w + (q >> 3)
                    if at(simple, e):
                        shifted = load(row, PAD + 64 * w + q + np.int64(at(moves_by, e)))
                        other = splat_at(row, PAD + np.int64(at(constant, e)))
                        store(W, to + q, select(mask(at(moved, e)), shifted, other))
                    else:
                        store(W, to + q, lanes.gather(inner, delta, base * n_padded + 64 * w + q))
        if i >= 0:  # unchanged
            for k in range(start[i], start[i + 1]):
                w = np.int64(at(word, k))
                left = spread(at(open_bits, k) | at(sure_bits, k))
                while left != ZERO:
                    q = trailing(left)
                    left &= left - ONE
                    store(inner, 64 * w + q, load(decided, PAD + 64 * w + q))


def _settle(x: Any, denominator: Any, inverse: Any) -> Any:
    """A sum in the values' own unit: ⌈x / denominator⌉ in fixed point, x itself in doubles."""


@overload(_settle, strict=False)
def _settle_by_type(x: Any, denominator: Any, inverse: Any) -> Any:
    if x.elem == types.float64:
        return lambda x, denominator, inverse: x
    return lambda x, denominator, inverse: lanes.ceil_div(x, denominator, inverse)


@part
def better(x: Any, best: Any, maximize: bool, restricted: bool, bits: Any, q: Any) -> Any:
    """The lanes of a tile, from bit q of its word on, for which a choice counts and is better."""
    m = greater(x, best) if maximize else greater(best, x)
    if restricted:
        m = both(m, mask(np.uint8((bits >> np.uint64(q)) & _BYTE)))
    return m


@kernel
def sweep(
    states: I32, start: I64, word: I32, open_bits: U64, sure_bits: U64, tiles: I64, lo: int, hi: int, slot: I32,
    block: I32, W: Numbers, near_start: I64, near: I32, choice_start: I64, row_start: I64, position: I32, p: Numbers,
    denominator: int, maximize: bool, restricted: bool, allowed_start: I64, allowed: U64, worst: Any, sure: Any,
    rest: Any, n_words: int, keep: bool, values: Numbers, best: NDArray[Any],
) -> None:  # fmt: skip
    """The layer's states lo … hi−1. `worst` is worse than every value; `best` gets the choices of open pairs by tile.

    Four, two or one tile of a word at a time: the row's entries are read once for all of them.
    """
    longest = np.int64(1)
    for i in range(lo, hi):
        longest = max(longest, near_start[states[i] + 1] - near_start[states[i]])
    near_block, which = np.empty(longest, np.int64), np.empty(8, np.int64)
    place, live, certain = np.empty(8, np.int64), np.empty(8, np.uint8), np.empty(8, np.uint8)
    sures, rests, nothing = splat(sure), splat(rest), splat(worst)
    first_choice = splat(np.int64(0))
    divisor, inverse = splat(np.int64(denominator)), splat(1.0 / denominator)
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
            r = np.int64(0)  # a plain 0 is another type, for which `finish` would be compiled again
            while n - r >= 4:
                q0, q1, q2, q3 = at(which, r), at(which, r + 1), at(which, r + 2), at(which, r + 3)
                b0, b1, b2, b3 = nothing, nothing, nothing, nothing
                i0, i1, i2, i3 = first_choice, first_choice, first_choice, first_choice
                e = at(row_start, c0)
                for c in range(c0, c1):
                    end = at(row_start, c + 1)
                    bits = at(allowed, mine + c - c0) if restricted else ZERO
                    if restricted and bits & between == ZERO:
                        e = end
                        continue
                    weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                    e += 1
                    x0, x1 = mul(weight, load(W, o + q0)), mul(weight, load(W, o + q1))
                    x2, x3 = mul(weight, load(W, o + q2)), mul(weight, load(W, o + q3))
                    while e < end:
                        weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                        e += 1
                        x0, x1 = add(x0, mul(weight, load(W, o + q0))), add(x1, mul(weight, load(W, o + q1)))
                        x2, x3 = add(x2, mul(weight, load(W, o + q2))), add(x3, mul(weight, load(W, o + q3)))
                    number = splat(c - c0)
                    m = better(x0, b0, maximize, restricted, bits, q0)
                    b0, i0 = select(m, x0, b0), select(m, number, i0)
                    m = better(x1, b1, maximize, restricted, bits, q1)
                    b1, i1 = select(m, x1, b1), select(m, number, i1)
                    m = better(x2, b2, maximize, restricted, bits, q2)
                    b2, i2 = select(m, x2, b2), select(m, number, i2)
                    m = better(x3, b3, maximize, restricted, bits, q3)
                    b3, i3 = select(m, x3, b3), select(m, number, i3)
                finish(b0, i0, r, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                finish(b1, i1, r + 1, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                finish(b2, i2, r + 2, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                finish(b3, i3, r + 3, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                r += 4
            while n - r >= 2:
                q0, q1 = at(which, r), at(which, r + 1)
                b0, b1, i0, i1 = nothing, nothing, first_choice, first_choice
                e = at(row_start, c0)
                for c in range(c0, c1):
                    end = at(row_start, c + 1)
                    bits = at(allowed, mine + c - c0) if restricted else ZERO
                    if restricted and bits & between == ZERO:
                        e = end
                        continue
                    weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                    e += 1
                    x0, x1 = mul(weight, load(W, o + q0)), mul(weight, load(W, o + q1))
                    while e < end:
                        weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                        e += 1
                        x0, x1 = add(x0, mul(weight, load(W, o + q0))), add(x1, mul(weight, load(W, o + q1)))
                    number = splat(c - c0)
                    m = better(x0, b0, maximize, restricted, bits, q0)
                    b0, i0 = select(m, x0, b0), select(m, number, i0)
                    m = better(x1, b1, maximize, restricted, bits, q1)
                    b1, i1 = select(m, x1, b1), select(m, number, i1)
                finish(b0, i0, r, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                finish(b1, i1, r + 1, place, live, certain, divisor, inverse, sures, rests, keep, values, best)
                r += 2
            if r < n:
                q0, b0, i0, e = at(which, r), nothing, first_choice, at(row_start, c0)
                for c in range(c0, c1):
                    end = at(row_start, c + 1)
                    bits = at(allowed, mine + c - c0) if restricted else ZERO
                    if restricted and bits & between == ZERO:
                        e = end
                        continue
                    weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                    e += 1
                    x0 = mul(weight, load(W, o + q0))
                    while e < end:
                        weight, o = splat_at(p, e), at(near_block, np.int64(at(position, e)))
                        e += 1
                        x0 = add(x0, mul(weight, load(W, o + q0)))
                    number = splat(c - c0)
                    m = better(x0, b0, maximize, restricted, bits, q0)
                    b0, i0 = select(m, x0, b0), select(m, number, i0)
                finish(b0, i0, r, place, live, certain, divisor, inverse, sures, rests, keep, values, best)


@part
def open_tiles(
    between: Any, ones: Any, tile: int, which: I64, place: I64, live: Bytes, certain: Bytes, sures: Any, rests: Any,
    values: Numbers,
) -> tuple[int, int]:  # fmt: skip
    """Of a word's tiles, from number `tile` on: those with an open pair, by first bit, position in `values`, open and
    sure lanes; the others get their values here. Returns how many have one, and the number of the next word's first
    tile."""
    left, n = spread(between | ones), 0
    while left != ZERO:
        q = trailing(left)
        left &= left - ONE
        a, o = np.uint8((between >> np.uint64(q)) & _BYTE), np.uint8((ones >> np.uint64(q)) & _BYTE)
        if a != 0:
            put(which, n, q)
            put(place, n, 8 * tile)
            put(live, n, a)
            put(certain, n, o)
            n += 1
        else:
            store(values, 8 * tile, select(mask(o), sures, rests))
        tile += 1
    return n, tile


@part
def finish(
    x: Any, number: Any, r: Any, place: I64, live: Bytes, certain: Bytes, divisor: Any, inverse: Any, sures: Any,
    rests: Any, keep: bool, values: Numbers, best: NDArray[Any],
) -> None:  # fmt: skip
    """One tile's result: the open lanes' optimum, `sure` and `rest` on the others."""
    open_lanes, to = mask(at(live, r)), at(place, r)
    other = select(mask(at(certain, r)), sures, rests)
    store(values, to, select(open_lanes, _settle(x, divisor, inverse), other))
    if keep:
        narrow_where(best, to, open_lanes, number)
