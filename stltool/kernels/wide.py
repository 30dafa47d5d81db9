"""Comparisons of polynomials on their border in whole numbers modulo 2¹²⁸, for samples that kernels/borders.py leaves.

The same computation: computed doubles have 16 or 17 digits, so that squares and products of them are beyond 2⁶³. A
value is two words, the lower one as if it had no sign, and k of the decimal m / 10^k.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.borders import _HIGH, _LOW, CONSTANT, MOST_PLACES, NEGATED, PRODUCT, SUM, WIDTH, _divided, _rounded
from stltool.kernels.decimals import decimals
from stltool.kernels.jit import kernel, part

F64: TypeAlias = NDArray[np.float64]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]
I8: TypeAlias = NDArray[np.int8]
B1: TypeAlias = NDArray[np.bool_]
Wide: TypeAlias = tuple[np.uint64, np.uint64]  # lower and upper word

_TENS = [pow(10, k, 1 << 128) for k in range(MOST_PLACES + 1)]
_TENS_LOWER = np.array([power % (1 << 64) for power in _TENS], dtype=np.uint64)
_TENS_UPPER = np.array([power >> 64 for power in _TENS], dtype=np.uint64)
_ROOM = 2.0**127 * (1 - 2.0**-20)
_ZERO, _ONE, _HALF, _MASK = np.uint64(0), np.uint64(1), np.uint64(32), np.uint64(0xFFFFFFFF)
_SIGN = np.uint64(1 << 63)


@part
def _times(a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64) -> Wide:
    """(a + 2⁶⁴b)(c + 2⁶⁴d) modulo 2¹²⁸."""
    a0, a1, c0, c1 = a & _MASK, a >> _HALF, c & _MASK, c >> _HALF
    low, one, other = a0 * c0, a0 * c1, a1 * c0
    middle = (low >> _HALF) + (one & _MASK) + (other & _MASK)
    upper = a1 * c1 + (one >> _HALF) + (other >> _HALF) + (middle >> _HALF)
    return a * c, upper + a * d + b * c


@part
def _plus(a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64) -> Wide:
    lower = a + c
    return lower, b + d + (_ONE if lower < a else _ZERO)


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


@kernel
def settle(
    columns: F64, code: I64, inside: int, side: int, root: bool, apart: F64, b: F64, error: F64, sign: I8, margin: F64,
    settled: B1, m: U64, upper: U64, places: I64, digits: I64, own: I64,
) -> None:  # fmt: skip
    """What `settle` of kernels/borders.py finds, of the samples that are not settled.

    m, upper, places   a value for each register         digits, own   one for each column
    """
    n_names, n = columns.shape
    for j in range(n):
        if settled[j]:
            continue
        sure = True
        for name in range(n_names):
            decimals(columns[name, j : j + 1], digits[name : name + 1], own[name : name + 1])
            sure &= own[name] >= 0
            m[name], places[name] = np.uint64(digits[name]), max(own[name], 0)
            upper[name] = np.uint64(digits[name] >> 63)
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
                    m[out], upper[out] = _plus(left[0], left[1], right[0], right[1])
                else:
                    m[out], upper[out] = _minus(left[0], left[1], right[0], right[1])
                places[out] = most
        other, its, within = (m[side], upper[side]), places[side], apart[j]
        squared = other
        if root:
            squared = _times(other[0], other[1], other[0], other[1])
            within *= 2 * abs(b[j]) + 2 * error[j] + within
            sure &= b[j] > 2 * error[j]
        y_places = 2 * its if root else its
        most = max(places[inside], y_places)
        K = min(most, MOST_PLACES)
        if not (sure and most <= MOST_PLACES and within * _HIGH[K] < _ROOM):
            continue
        up = most - places[inside]
        left = _times(m[inside], upper[inside], _TENS_LOWER[up], _TENS_UPPER[up])
        up = most - y_places
        right = _times(squared[0], squared[1], _TENS_LOWER[up], _TENS_UPPER[up])
        lower, top = _minus(left[0], left[1], right[0], right[1])
        high, low = _doubles(lower, top)
        high, low = _divided(high, low, _HIGH[K], _LOW[K])
        if root:
            its = min(its, MOST_PLACES)
            value, rest = _doubles(other[0], other[1])
            value, rest = _divided(value, rest, _HIGH[its], _LOW[its])
            # B itself is needed, not B modulo 2¹²⁸; and √A + B must be known well enough with the rough δ
            rough = high / (2 * value) if value > 0 else np.inf
            if not (abs(value - b[j]) <= 1e-9 * b[j] and abs(rough) < 2.0**-45 * b[j]):
                continue
            total = 2 * value + rough
            part = total - 2 * value
            rest = ((2 * value - (total - part)) + (rough - part)) + 2 * rest
            high, low = _divided(high, low, total, rest)
        found, certain = _rounded(high, low, 2.0**-85)
        if certain:
            sign[j] = 0 if lower | top == _ZERO else (-1 if top >= _SIGN else 1)
            margin[j], settled[j] = found, True
