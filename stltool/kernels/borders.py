"""Comparisons of polynomials on their border, in whole numbers modulo 2⁶⁴: monitoring/borders.py says how and why.

What its `_Exact` does with numpy, operation by operation, is done here for some hundred samples at a time, which stay
in the first-level cache. A value is m modulo 2⁶⁴ and k of the decimal m / 10^k, in a register of its own; the first
registers are the signals. An operation: kind, register, and two operands; of a constant, its m and k.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.decimals import decimals
from stltool.kernels.jit import kernel, part
from stltool.kernels.twofold import product

F64: TypeAlias = NDArray[np.float64]
I64: TypeAlias = NDArray[np.int64]
I8: TypeAlias = NDArray[np.int8]
B1: TypeAlias = NDArray[np.bool_]

CONSTANT, NEGATED, SUM, DIFFERENCE, PRODUCT = range(5)
WIDTH = 4
TILE = 256

MOST_PLACES = 44  # 10^44 is the sum of two doubles
_TENS = np.array([pow(10, k, 1 << 64) for k in range(MOST_PLACES + 1)], dtype=np.uint64).view(np.int64)
_HIGH = np.array([float(10**k) for k in range(MOST_PLACES + 1)])
_LOW = np.array([float(10**k - int(high)) for k, high in enumerate(_HIGH)])
_ROOM = 2.0**63 * (1 - 2.0**-20)
_BELOW = 2.0**63 - 1024  # the double before 2⁶³
_EXACT = 22  # 10^22 is a double
_WHOLE = 1 << 53


@kernel
def has_places(x: F64, power: float) -> bool:
    """Whether all numbers are below 10^15 in whole `power`-ths, and the doubles nearest to such."""
    unlike = 0
    for i in range(len(x)):
        whole = np.rint(x[i] * power)
        unlike += not (whole / power == x[i] and abs(whole) < 1e15)
    return unlike == 0


@part
def _up(places: np.int64, own: np.int64) -> np.int64:
    """By how much a value over 10^own is multiplied for it to be over 10^places, modulo 2⁶⁴."""
    factor: np.int64 = _TENS[min(places - own, np.int64(MOST_PLACES))]
    return factor


@part
def _operate(now: I64, m: I64, places: I64, size: int) -> None:
    kind, out, a, b = now[0], now[1] * size, now[2] * size, now[3] * size
    for i in range(size):
        if kind == CONSTANT:
            m[out + i], places[out + i] = now[2], now[3]
        elif kind == NEGATED:
            m[out + i], places[out + i] = -m[a + i], places[a + i]
        elif kind == PRODUCT:
            m[out + i], places[out + i] = m[a + i] * m[b + i], places[a + i] + places[b + i]
        else:
            most = max(places[a + i], places[b + i])
            left, right = m[a + i] * _up(most, places[a + i]), m[b + i] * _up(most, places[b + i])
            m[out + i], places[out + i] = left + right if kind == SUM else left - right, most


@part
def _pair(whole: np.int64) -> tuple[float, float]:
    """A whole number as the sum of two doubles."""
    high = min(np.float64(whole), _BELOW)
    return high, np.float64(whole - np.int64(high))


@part
def _divided(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """A quotient of sums of two doubles, to some 2⁻¹⁰⁰ of it."""
    first = a / b
    high, error = product(first, b)
    return first, (((a - high) - error) + (a_low - first * b_low)) / b


@part
def _rounded(high: float, low: float, relative: float) -> tuple[float, bool]:
    """The nearest double, and whether that is certain."""
    room = relative * abs(high)
    result = high + (low - room)
    return result + 0.0, result == high + (low + room)


@kernel
def settle(
    columns: F64, shared: I64, code: I64, inside: int, side: int, root: bool, apart: F64, b: F64, error: F64, sign: I8,
    margin: F64, settled: B1, m: I64, places: I64,
) -> None:  # fmt: skip
    """Sign and nearest double of the difference of two registers, or of the root of one and another, for n samples.

    columns   (n_names, n)
    shared    k for columns that are decimals of so few places, or −1
    apart     bounds of the differences; of a root, `b` are the values of the other side in doubles, within `error`
    settled   where that is certain
    m, places TILE values of each register
    """
    n_names, n = columns.shape
    for first in range(0, n, TILE):
        size = min(TILE, n - first)
        for i in range(size):
            settled[first + i] = True
        for name in range(n_names):
            x, whole, k = columns[name, first : first + size], m[name * size : (name + 1) * size], shared[name]
            own = places[name * size : (name + 1) * size]
            if k >= 0:
                for i in range(size):
                    whole[i], own[i] = np.int64(np.rint(x[i] * _HIGH[k])), k
            else:
                decimals(x, whole, own)
                for i in range(size):
                    settled[first + i] &= own[i] >= 0
                    own[i] = max(own[i], 0)
        for at in range(0, len(code), WIDTH):
            _operate(code[at : at + WIDTH], m, places, size)
        for i in range(size):
            j, x_m, x_places = first + i, m[inside * size + i], places[inside * size + i]
            y_m, y_places, within = m[side * size + i], places[side * size + i], apart[j]
            other, tens = y_m, min(y_places, MOST_PLACES)  # with more places, B² has, too: not settled below
            sure = settled[j]
            if root:
                y_m, y_places = y_m * y_m, y_places + y_places
                within *= 2 * abs(b[j]) + 2 * error[j] + within
                sure &= b[j] > 2 * error[j]
            most = max(x_places, y_places)
            K = min(most, MOST_PLACES)
            difference = x_m * _up(most, x_places) - y_m * _up(most, y_places)
            sure &= most <= MOST_PLACES and within * _HIGH[K] < _ROOM
            sign[j] = (difference > 0) - (difference < 0)
            if difference == 0:  # as most samples on a border are: A = B², so √A = B, too
                margin[j] = 0.0
            elif not root and K <= _EXACT and -_WHOLE < difference < _WHOLE:
                margin[j] = np.float64(difference) / _HIGH[K]
            else:
                top, rest = _pair(difference)
                if root:
                    top, rest = _divided(top, rest, _HIGH[K], _LOW[K])
                    high, low = _pair(other)
                    high, low = _divided(high, low, _HIGH[tens], _LOW[tens])
                    # B itself is needed, not B modulo 2⁶⁴; and √A + B must be known well enough with the rough δ
                    sure &= abs(high - b[j]) <= 1e-9 * b[j]
                    rough = top / (2 * high) if sure else 0.0  # B may be 0
                    sure &= abs(rough) < 2.0**-45 * b[j]
                    if not sure:
                        margin[j], settled[j] = 0.0, False
                        continue
                    total = 2 * high + rough
                    part = total - 2 * high
                    low = ((2 * high - (total - part)) + (rough - part)) + 2 * low
                    top, rest = _divided(top, rest, total, low)
                    margin[j], certain = _rounded(top, rest, 2.0**-85)
                else:
                    top, rest = _divided(top, rest, _HIGH[K], _LOW[K])
                    margin[j], certain = _rounded(top, rest, 2.0**-95)
                sure &= certain
            settled[j] = sure
