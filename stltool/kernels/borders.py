"""Comparisons of polynomials, or of their roots with one, over arrays: monitoring/borders.py says how and why.

Some hundred samples at a time, which stay near the processor. Both sides are computed in doubles with bounds on their
errors (monitoring/doubles.py); samples that are nearer to the border than that are put together, and computed again in
whole numbers modulo 2⁶⁴, and what cannot be seen so modulo 2¹²⁸ (wide.py). A value is m modulo 2⁶⁴ and k of the decimal
m / 10^k, in a register of its own; the first registers are the signals. Most often, all samples of a signal have one k.
"""

from __future__ import annotations

import functools
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.decimals import decimals
from stltool.kernels.jit import kernel, part
from stltool.kernels.streams import EQUAL, GREATER, GREATER_EQUAL, LESS, LESS_EQUAL, UNEQUAL, _doubles
from stltool.kernels.twofold import HIGH, LOW, MOST_PLACES, divided, root_minus, rounded
from stltool.kernels.wide import CONSTANT, NEGATED, PRODUCT, SUM, WIDTH, difference

F64: TypeAlias = NDArray[np.float64]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]
U8: TypeAlias = NDArray[np.uint8]

TILE = 256
SPARE = 5  # tiles besides two for each register
_UNIT, _TINY = 2.0**-53, 1e-322  # as in monitoring/doubles.py
_TENS = np.array([pow(10, k, 1 << 64) for k in range(MOST_PLACES + 1)], dtype=np.uint64).view(np.int64)
_ROOM = 2.0**63 * (1 - 2.0**-20)
_BELOW = 2.0**63 - 1024  # the double before 2⁶³
_EXACT = 22  # 10^22 is a double
_WHOLE = 1 << 53
_SEEN = 100  # samples of a column that show how many places it may have


# --------------------------------------------------------------------------------------------------------- doubles


@part
def _evaluate(now: I64, number: float, v: F64, e: F64, size: int) -> None:
    """An operation's values and bounds of their errors."""
    kind, out, a, b = now[0], now[1] * TILE, now[2] * TILE, now[3] * TILE
    if kind == CONSTANT:
        for i in range(size):
            v[out + i], e[out + i] = number, 4.0 * _UNIT * abs(number) + _TINY
    elif kind == NEGATED:
        for i in range(size):
            v[out + i], e[out + i] = -v[a + i], e[a + i]
    elif kind == PRODUCT:
        for i in range(size):
            x, y, ex, ey = v[a + i], v[b + i], e[a + i], e[b + i]
            v[out + i] = x * y
            e[out + i] = (abs(x) * ey + abs(y) * ex + ex * ey) + 4.0 * _UNIT * abs(x * y) + _TINY
    else:
        for i in range(size):
            x = v[a + i] + v[b + i] if kind == SUM else v[a + i] - v[b + i]
            v[out + i], e[out + i] = x, (e[a + i] + e[b + i]) + 4.0 * _UNIT * abs(x) + _TINY


@functools.partial(part, ieee=True)
def _root(v: F64, e: F64, root: F64, error: F64) -> None:
    for i in range(len(root)):
        x = np.sqrt(v[i]) + 0.0  # not −0, whose bound would be −∞
        slope = 0.55 if v[i] > 16 * e[i] else (1.0 if v[i] > e[i] else np.inf)
        root[i], error[i] = x, slope * (1.25 * e[i] / x) + 4.0 * _UNIT * abs(x) + _TINY


@part
def _near(left: F64, left_error: F64, right: F64, right_error: F64, bound: F64, near: I64) -> int:
    """Which samples may be on the border, and how many; and bounds of the differences."""
    count = 0
    for i in range(len(near)):
        apart = abs(left[i] - right[i])
        error = 2.5 * (left_error[i] + right_error[i]) + 4.0 * _UNIT * apart + _TINY
        bound[i] = apart * (1 + 8 * _UNIT) + error / 8
        near[i] = 0 if apart > error else 1
        count += near[i]
    return count


# --------------------------------------------------------------------------------------------------- whole numbers


@part
def _has_places(x: F64, k: int, whole: I64) -> bool:
    """Whether all numbers are decimals of k places and below 10^15, and then the whole numbers."""
    unlike = 0
    for i in range(len(x)):
        rounded = np.rint(x[i] * HIGH[k])
        unlike += not (rounded / HIGH[k] == x[i] and abs(rounded) < 1e15)
        whole[i] = np.int64(rounded) if abs(rounded) < 1e15 else 0
    return unlike == 0


@part
def _up(places: int, own: int) -> Any:
    """By how much a value over 10^own is multiplied for it to be over 10^places, modulo 2⁶⁴."""
    return _TENS[min(places - own, MOST_PLACES)]


@part
def _operate(now: I64, m: I64, places: I64, size: int) -> None:
    kind, out, a, b = now[0], now[1] * TILE, now[2] * TILE, now[3] * TILE
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
def _operate_alike(now: I64, m: I64, alike: I64, size: int) -> None:
    """The same, where all samples of a register have one k."""
    kind, out, a, b = now[0], now[1] * TILE, now[2] * TILE, now[3] * TILE
    if kind == CONSTANT:
        alike[now[1]] = now[3]
        for i in range(size):
            m[out + i] = now[2]
    elif kind == NEGATED:
        alike[now[1]] = alike[now[2]]
        for i in range(size):
            m[out + i] = -m[a + i]
    elif kind == PRODUCT:
        alike[now[1]] = alike[now[2]] + alike[now[3]]
        for i in range(size):
            m[out + i] = m[a + i] * m[b + i]
    else:
        most = max(alike[now[2]], alike[now[3]])
        x, y = _up(most, alike[now[2]]), _up(most, alike[now[3]])
        alike[now[1]] = most
        if kind != SUM:
            y = -y
        for i in range(size):
            m[out + i] = m[a + i] * x + m[b + i] * y


@part
def _pick(near: I64, size: int, bound: F64) -> None:
    """Put the numbers of the samples that are near in front, and their bounds."""
    count = 0
    for i in range(size):
        is_near = near[i]
        near[count], bound[count] = i, bound[i]
        count += is_near


@part
def _gather(source: F64, at: I64, out: F64) -> None:
    """In place, too, as `at` ascends."""
    for i in range(len(at)):
        out[i] = source[at[i]]


@part
def _bound_squares(bound: F64, b: F64, error: F64, known: I64) -> int:
    """Make bounds of √A − B those of A − B², and known only where B > 0; returns where it is not."""
    unknown = 0
    for i in range(len(known)):
        bound[i] *= 2 * abs(b[i]) + 2 * error[i] + bound[i]
    for i in range(len(known)):
        known[i] = b[i] > 2 * error[i]
        unknown += 1 - known[i]
    return unknown


@part
def _subtract(
    x: I64, x_places: I64, y: I64, y_places: I64, squared: bool, bound: F64, out: I64, known: I64
) -> None:  # fmt: skip
    """D of x − y, or of x − y²; where |D| is bounded by 2⁶³, so that it is D, `known` becomes 2."""
    for i in range(len(out)):
        right, places = (y[i] * y[i], 2 * y_places[i]) if squared else (y[i], y_places[i])
        most = max(x_places[i], places)
        out[i] = x[i] * _up(most, x_places[i]) - right * _up(most, places)
        fits = (most <= MOST_PLACES) & (bound[i] * HIGH[min(most, MOST_PLACES)] < _ROOM)
        known[i] += known[i] & fits


@part
def _subtract_alike(
    x: I64, x_places: int, y: I64, y_places: int, squared: bool, bound: F64, out: I64, known: I64
) -> bool:  # fmt: skip
    """The same, where all samples of a register have one k; whether some D is not known to be 0."""
    y_places = 2 * y_places if squared else y_places
    most = max(x_places, y_places)
    up, down, power = _up(most, x_places), _up(most, y_places), HIGH[min(most, MOST_PLACES)]
    if squared:
        for i in range(len(out)):
            out[i] = x[i] * up - y[i] * y[i] * down
    else:
        for i in range(len(out)):
            out[i] = x[i] * up - y[i] * down
    differs = 0
    for i in range(len(out)):
        fits = (most <= MOST_PLACES) & (bound[i] * power < _ROOM)
        known[i] += known[i] & fits
        differs |= out[i] | (known[i] ^ 2)
    return differs != 0


@part
def _pair(whole: np.int64) -> tuple[float, float]:
    """A whole number as the sum of two doubles."""
    high = min(np.float64(whole), _BELOW)
    return high, np.float64(whole - np.int64(high))


@part
def _distance(d: np.int64, K: int, root: bool, m: np.int64, places: int, b: float) -> tuple[float, bool]:
    """The nearest double of D / 10^K, or of √A − B for A − B² = D / 10^K and B = m / 10^places, and whether it is."""
    if d == 0:  # √A = B, too
        return 0.0, True
    if not root and K <= _EXACT and -_WHOLE < d < _WHOLE:
        return np.float64(d) / HIGH[K], True
    high, low = _pair(d)
    high, low = divided(high, low, HIGH[K], LOW[K])
    if not root:
        return rounded(high, low, 2.0**-95)
    value, rest = _pair(m)
    value, rest = divided(value, rest, HIGH[places], LOW[places])
    return root_minus(high, low, value, rest, b)


@part
def _write(
    left: F64, right: F64, greater: bool, less: bool, equal: bool, scale: float, absolute: bool, truth: U8, margin: F64
) -> None:
    """Truth and margin by the doubles: whether it holds if left is greater, less, or equal; how it depends on left −
    right."""
    for i in range(len(truth)):
        truth[i] = (greater & (left[i] > right[i])) | (less & (left[i] < right[i])) | (equal & (left[i] == right[i]))
    for i in range(len(margin)):
        apart = left[i] - right[i]
        margin[i] = scale * (abs(apart) if absolute else apart) + 0.0


# ---------------------------------------------------------------------------------------------------------- a block


@kernel
def judge(
    columns: I64, n: int, places_tried: I64, code: I64, numbers: F64, inside: int, side: int, root: bool, op: int,
    narrow: bool, truth: U8, margin: F64, left_over: U8, doubles: F64, integers: I64, words: U64,
) -> int:  # fmt: skip
    """Truth and margin, as there is room for them, of a comparison for n samples; returns how many are left over.

    columns       address of each signal's samples
    places_tried  k that all samples of a signal may have
    code          operations (wide.py), `numbers` has the doubles of constants
    inside, side  the registers of left and right; with `root`, of what is in the root on the left, and of the right
    narrow        constants are below 2⁶³, and not only known modulo 2⁶⁴
    left_over     where neither is known: 1
    doubles, integers, words   room for 2·registers + SPARE tiles, and three in each register
    """
    n_names, n_registers = len(columns), len(columns) + len(code) // WIDTH
    v, e = doubles[: n_registers * TILE], doubles[n_registers * TILE : 2 * n_registers * TILE]
    rest = doubles[2 * n_registers * TILE :]
    m, places = integers[: n_registers * TILE], integers[n_registers * TILE : 2 * n_registers * TILE]
    other = integers[2 * n_registers * TILE :]
    near, known, differences = other[:TILE], other[TILE : 2 * TILE], other[2 * TILE : 3 * TILE]
    hint, alike, own = other[3 * TILE :], other[3 * TILE + n_registers :], other[3 * TILE + 2 * n_registers :]
    for name in range(n_names):
        hint[name] = -1
        x = _doubles(columns[name], n)[:_SEEN]
        for k in places_tried[::-1]:
            if _has_places(x, k, m[: len(x)]):
                hint[name] = k
    turned = op in (LESS, LESS_EQUAL)
    absolute = op in (EQUAL, UNEQUAL)
    greater, less, equal = (
        op in (GREATER, GREATER_EQUAL, UNEQUAL),
        turned or op == UNEQUAL,
        op in (GREATER_EQUAL, LESS_EQUAL, EQUAL),
    )
    scale = -1.0 if turned or op == EQUAL else 1.0
    n_left = 0
    for first in range(0, n, TILE):
        size = min(TILE, n - first)
        for name in range(n_names):
            x = _doubles(columns[name] + 8 * first, size)
            for i in range(size):
                v[name * TILE + i], e[name * TILE + i] = x[i], 4.0 * _UNIT * abs(x[i]) + _TINY
        for at in range(0, len(code), WIDTH):
            _evaluate(code[at : at + WIDTH], numbers[at // WIDTH], v, e, size)
        left, left_error = v[inside * TILE : inside * TILE + size], e[inside * TILE : inside * TILE + size]
        right, right_error = v[side * TILE : side * TILE + size], e[side * TILE : side * TILE + size]
        if root:
            _root(left, left_error, rest[:size], rest[TILE : TILE + size])
            left, left_error = rest[:size], rest[TILE : TILE + size]
        bound = rest[2 * TILE : 2 * TILE + size]
        count = _near(left, left_error, right, right_error, bound, near[:size])
        _write(
            left, right, greater, less, equal, scale, absolute, truth[first if len(truth) > 0 else n :][:size],
            margin[first if len(margin) > 0 else n :][:size],
        )  # fmt: skip
        if count == 0:
            continue

        # those near the border, together
        b, error = rest[3 * TILE : 3 * TILE + count], rest[4 * TILE : 4 * TILE + count]
        if count < size:
            _pick(near, size, bound)
            _gather(v[side * TILE :], near[:count], b)
            _gather(e[side * TILE :], near[:count], error)
            for name in range(n_names):
                _gather(v[name * TILE :], near[:count], v[name * TILE :])
        else:
            for i in range(count):
                near[i] = i
                b[i], error[i] = right[i], right_error[i]
        known[:count] = 1
        all_alike = True
        for name in range(n_names):
            x, whole = v[name * TILE : name * TILE + count], m[name * TILE : name * TILE + count]
            alike[name] = hint[name]
            if hint[name] < 0 or not _has_places(x, hint[name], whole):
                alike[name], all_alike = -1, False
                decimals(x, whole, places[name * TILE : name * TILE + count])
        bound, x_m, y_m = bound[:count], m[inside * TILE :][:count], m[side * TILE :][:count]
        x_places, y_places = places[inside * TILE :][:count], places[side * TILE :][:count]
        unknown = _bound_squares(bound, b, error, known[:count]) if root else 0
        if all_alike:
            for at in range(0, len(code), WIDTH):
                _operate_alike(code[at : at + WIDTH], m, alike, count)
            differs = _subtract_alike(
                x_m, alike[inside], y_m, alike[side], root, bound, differences[:count], known[:count]
            )
            if unknown == 0 and not differs:  # as most samples on a border are
                for i in range(count if len(truth) > 0 else 0):
                    truth[first + near[i]] = equal
                for i in range(count if len(margin) > 0 else 0):
                    margin[first + near[i]] = 0.0
                continue
            for name in range(n_registers):
                places[name * TILE : name * TILE + count] = alike[name]
        else:
            for name in range(n_names):
                its = places[name * TILE : name * TILE + count]
                if alike[name] >= 0:
                    its[:] = alike[name]
                else:
                    for i in range(count):
                        known[i] &= its[i] >= 0
                        its[i] = max(its[i], 0)
            for at in range(0, len(code), WIDTH):
                _operate(code[at : at + WIDTH], m, places, count)
            _subtract(x_m, x_places, y_m, y_places, root, bound, differences[:count], known[:count])
        for i in range(count):
            j, d, settled, apart = first + near[i], differences[i], known[i] == 2, 0.0
            sign = (d > 0) - (d < 0)
            if settled and len(margin) > 0:
                K = max(x_places[i], 2 * y_places[i] if root else y_places[i])
                apart, settled = _distance(d, K, root, y_m[i], y_places[i], b[i])
            if not settled and narrow and known[i] > 0:
                for name in range(n_names):
                    whole = m[name * TILE + i]
                    words[name], words[n_registers + name] = np.uint64(whole), np.uint64(whole >> 63)
                    own[name] = places[name * TILE + i]
                settled, sign, apart = difference(
                    code, inside, side, root, bound[i], b[i], len(margin) > 0, words[:n_registers],
                    words[n_registers:], own,
                )  # fmt: skip
            if not settled:
                left_over[j] = 1
                n_left += 1
                continue
            if len(truth) > 0:
                truth[j] = equal if sign == 0 else (greater if sign > 0 else less)
            if len(margin) > 0:
                margin[j] = scale * (abs(apart) if absolute else apart) + 0.0
    return n_left
