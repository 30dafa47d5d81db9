"""Comparisons of polynomials on their border in whole numbers modulo 2¹²⁸, for samples that kernels/borders.py leaves.

The same computation: computed doubles have 16 or 17 digits, so that squares and products of them are beyond 2⁶³. A
value is two words, the lower one as if it had no sign, and k of the decimal m / 10^k.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from stltool.kernels.jit import compiles, part
from stltool.kernels.twofold import HIGH, LOW, MOST_PLACES, divided, root_minus, rounded

I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]
Wide: TypeAlias = tuple[np.uint64, np.uint64]  # lower and upper word

CONSTANT, NEGATED, SUM, DIFFERENCE, PRODUCT = range(5)
WIDTH = 4  # of an operation: kind, register and two operands; of a constant, its m and k

_COMPILED = compiles()
_TENS = [pow(10, k, 1 << 128) for k in range(MOST_PLACES + 1)]
_TENS_LOWER = np.array([power % (1 << 64) for power in _TENS], dtype=np.uint64)
_TENS_UPPER = np.array([power >> 64 for power in _TENS], dtype=np.uint64)
_ROOM = 2.0**127 * (1 - 2.0**-20)
_ZERO, _ONE, _HALF, _MASK = np.uint64(0), np.uint64(1), np.uint64(32), np.uint64(0xFFFFFFFF)
_SIGN = np.uint64(1 << 63)


def _upper_word_natively(typing: Any, a: Any, b: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        long = ir.IntType(128)
        whole = builder.mul(builder.zext(args[0], long), builder.zext(args[1], long))
        return builder.trunc(builder.lshr(whole, long(64)), ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), generate


_native: Any = intrinsic(_upper_word_natively)


@part
def _upper_word(a: np.uint64, c: np.uint64) -> Any:
    """⌊ac / 2⁶⁴⌋."""
    if _COMPILED:
        return _native(a, c)
    a0, a1, c0, c1 = a & _MASK, a >> _HALF, c & _MASK, c >> _HALF
    one, other = a0 * c1, a1 * c0
    middle = ((a0 * c0) >> _HALF) + (one & _MASK) + (other & _MASK)
    return a1 * c1 + (one >> _HALF) + (other >> _HALF) + (middle >> _HALF)


@part
def _times(a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64) -> Wide:
    """(a + 2⁶⁴b)(c + 2⁶⁴d) modulo 2¹²⁸."""
    return a * c, _upper_word(a, c) + a * d + b * c


@part
def _minus(a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64) -> Wide:
    return a - c, b - d - (_ONE if a < c else _ZERO)


@part
def _doubles(lower: np.uint64, upper: np.uint64) -> tuple[float, float]:
    """A number with a sign, as the sum of two doubles; to 2⁻¹⁰⁵ of it."""
    negative = upper >= _SIGN
    if negative:
        lower, upper = _minus(_ZERO, _ZERO, lower, upper)
    high, low = 0.0, 0.0
    for digits in (upper >> _HALF, upper & _MASK, lower >> _HALF, lower & _MASK):
        high, low = high * 4294967296.0, low * 4294967296.0 + np.float64(digits)
        total = high + low
        high, low = total, low - (total - high)
    return (-high, -low) if negative else (high, low)


@part
def difference(
    code: I64, inside: int, side: int, root: bool, within: float, b: float, margins: bool, m: U64, upper: U64,
    places: I64,
) -> tuple[bool, int, float]:  # fmt: skip
    """Whether one sample is settled, and sign and nearest double of the difference of two registers, or of the root of
    one and another; the last only with `margins`.

    within             a bound of the difference, of a root of A − B², whose B in doubles is b
    m, upper, places   a value for each register, of which those of the signals are given
    """
    for at in range(0, len(code), WIDTH):
        kind, out, x, y = code[at], code[at + 1], code[at + 2], code[at + 3]
        if kind == CONSTANT:  # below 2⁶³
            m[out], upper[out], places[out] = np.uint64(x), np.uint64(x >> 63), y
        elif kind == NEGATED:
            m[out], upper[out] = _minus(_ZERO, _ZERO, m[x], upper[x])
            places[out] = places[x]
        elif kind == PRODUCT:
            m[out], upper[out] = _times(m[x], upper[x], m[y], upper[y])
            places[out] = places[x] + places[y]
        else:
            most = max(places[x], places[y])
            up = min(most - places[x], MOST_PLACES)
            left = _times(m[x], upper[x], _TENS_LOWER[up], _TENS_UPPER[up])
            up = min(most - places[y], MOST_PLACES)
            right = _times(m[y], upper[y], _TENS_LOWER[up], _TENS_UPPER[up])
            if kind == SUM:
                right = _minus(_ZERO, _ZERO, right[0], right[1])
            m[out], upper[out] = _minus(left[0], left[1], right[0], right[1])
            places[out] = most
    other, its = (m[side], upper[side]), places[side]
    squared = _times(other[0], other[1], other[0], other[1]) if root else other
    y_places = 2 * its if root else its
    most = max(places[inside], y_places)
    if not (most <= MOST_PLACES and within * HIGH[min(most, MOST_PLACES)] < _ROOM):
        return False, 0, 0.0
    up = most - places[inside]
    left = _times(m[inside], upper[inside], _TENS_LOWER[up], _TENS_UPPER[up])
    up = most - y_places
    right = _times(squared[0], squared[1], _TENS_LOWER[up], _TENS_UPPER[up])
    lower, top = _minus(left[0], left[1], right[0], right[1])
    sign = 0 if lower | top == _ZERO else (-1 if top >= _SIGN else 1)
    if sign == 0 or not margins:
        return True, sign, 0.0
    high, low = _doubles(lower, top)
    high, low = divided(high, low, HIGH[most], LOW[most])
    if not root:
        margin, certain = rounded(high, low, 2.0**-85)
        return certain, sign, margin
    value, rest = _doubles(other[0], other[1])
    value, rest = divided(value, rest, HIGH[its], LOW[its])
    margin, certain = root_minus(high, low, value, rest, b)
    return certain, sign, margin
