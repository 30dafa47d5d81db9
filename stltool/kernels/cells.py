"""The cells of a CSV file's bytes (monitoring/logs/text.py): numbers to the nearest double, truth values, missing ones.

A decimal is w·10^q with w < 10^36. Both factors are sums of two doubles, hi + lo, within 2^-105, and so is their
product v: r = hi + lo rounded is the double nearest to the decimal unless a change of v by 2^-99 |v| would change r
([Dekker71] for the products; the test is Ziv's). Such decimals, about one in 10^13 and the exact halves, and those far
from 1 are left to Python, like every cell that is not a plain number.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part
from stltool.kernels.twofold import product

U8: TypeAlias = NDArray[np.uint8]
I8: TypeAlias = NDArray[np.int8]
I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]

SKIPPED, NUMBER, LABEL, TEXT = 0, 1, 2, 3  # kinds of columns
DONE, UNLIKE, FULL = 0, 1, 2  # how reading ended: all rows; lines that are not rows; too many special cells

_QUOTE, _LF, _CR, _SPACE, _TAB, _PLUS, _MINUS, _ZERO = 34, 10, 13, 32, 9, 43, 45, 48
_FAR = 290
_DIGITS = 18  # of each half of w
_DOUBT = 2.0**-99


def _powers() -> tuple[F64, F64]:
    values = [Fraction(10) ** q for q in range(-_FAR, _FAR + 1)]
    high = [float(value) for value in values]
    return np.array(high), np.array([float(value - Fraction(hi)) for value, hi in zip(values, high, strict=True)])


_HIGH, _LOW = _powers()


@kernel
def nearest(w: np.int64, rest: np.int64, behind: int, q: np.int64) -> tuple[float, bool]:
    """The double nearest to (w·10^behind + rest)·10^q, and whether that is certain; w, rest < 10^18, behind ≤ 18."""
    if w == 0:
        return 0.0, True
    if behind == 0 and w <= 9007199254740992 and -22 <= q <= 22:
        return (np.float64(w) / _HIGH[_FAR - q] if q < 0 else np.float64(w) * _HIGH[_FAR + q]), True
    if q < -_FAR or q > _FAR:
        return 0.0, False
    hi: float = np.float64(w)
    lo: float = np.float64(w - np.int64(hi))
    if behind > 0:
        tail = lo * _HIGH[_FAR + behind] + np.float64(rest)
        hi, lo = product(hi, _HIGH[_FAR + behind])
        lo += tail
    ph, pl = _HIGH[_FAR + q], _LOW[_FAR + q]
    r, e = product(hi, ph)
    e += hi * pl + lo * ph
    value = r + e
    if not 1e-270 < value < 1e290:
        return 0.0, False
    e -= value - r
    doubt = value * _DOUBT
    return value, value + (e + doubt) == value and value + (e - doubt) == value


@part
def long_digits(data: U8, i: int, stop: int, point: int) -> tuple[np.int64, np.int64, int, np.int64, int]:
    """A number of many digits as (w·10^behind + rest)·10^q, and the byte behind it; −1 if they are too many."""
    w: np.int64 = np.int64(0)
    rest: np.int64 = np.int64(0)
    q: np.int64 = np.int64(0)
    behind, used, fraction = 0, 0, False
    while i < stop:
        digit = np.int64(data[i]) - _ZERO
        if 0 <= digit <= 9:
            if used < _DIGITS:
                w = 10 * w + digit
                if w > 0:
                    used += 1
            elif behind < _DIGITS:
                rest = 10 * rest + digit
                behind += 1
            else:
                return w, rest, behind, q, -1
            q -= fraction
        elif data[i] == point and not fraction:
            fraction = True
        else:
            break
        i += 1
    return w, rest, behind, q, i


@kernel
def number(data: U8, i: int, stop: int, point: int) -> tuple[float, int]:
    """The number that begins at i, and the byte behind it; −1 if there is none that is certain."""
    negative = False
    if i < stop and (data[i] == _MINUS or data[i] == _PLUS):
        negative = data[i] == _MINUS
        i += 1
    w: np.int64 = np.int64(0)
    rest: np.int64 = np.int64(0)
    q: np.int64 = np.int64(0)
    behind, begin = 0, i
    while i < stop and 0 <= np.int64(data[i]) - _ZERO <= 9:
        w = 10 * w + (np.int64(data[i]) - _ZERO)
        i += 1
    digits = i - begin
    significant = digits
    if i < stop and data[i] == point:
        i += 1
        first = i
        if w == 0:
            while i < stop and data[i] == _ZERO:
                i += 1
            significant = first - i
        while i < stop and 0 <= np.int64(data[i]) - _ZERO <= 9:
            w = 10 * w + (np.int64(data[i]) - _ZERO)
            i += 1
        digits += i - first
        significant += i - first
        q = np.int64(first - i)
    if significant > _DIGITS:
        w, rest, behind, q, i = long_digits(data, begin, stop, point)
        if i < 0:
            return 0.0, -1
    if digits == 0:
        return 0.0, -1
    if i < stop and (data[i] == 69 or data[i] == 101):  # E, e
        i += 1
        down = i < stop and data[i] == _MINUS
        i += i < stop and (data[i] == _MINUS or data[i] == _PLUS)
        power, first = np.int64(0), i
        while i < stop and _ZERO <= data[i] <= _ZERO + 9 and power < 10000:
            power = 10 * power + np.int64(data[i]) - _ZERO
            i += 1
        if i == first:
            return 0.0, -1
        q += -power if down else power
    value, certain = nearest(w, rest, behind, q)
    return (-value if negative else value), (i if certain else -1)


@part
def truth(data: U8, i: int, stop: int) -> tuple[float, int]:
    """1 or 0 of the word true or false at i, in any case, and the byte behind it; −1 if there is neither."""
    if i + 4 <= stop and data[i] | 32 == 116 and data[i + 1] | 32 == 114 and data[i + 2] | 32 == 117:
        return 1.0, (i + 4 if data[i + 3] | 32 == 101 else -1)
    if i + 5 <= stop and data[i] | 32 == 102 and data[i + 1] | 32 == 97 and data[i + 2] | 32 == 108:
        return 0.0, (i + 5 if data[i + 3] | 32 == 115 and data[i + 4] | 32 == 101 else -1)
    return 0.0, -1


@kernel
def count(data: U8, start: int, stop: int, byte: int) -> int:
    """How often a byte occurs."""
    n = 0
    for i in range(start, stop):
        n += data[i] == byte
    return n


@part
def blank(data: U8, start: int, stop: int) -> bool:
    """Whether only white space is left."""
    for i in range(start, stop):
        if data[i] != _SPACE and data[i] != _TAB and data[i] != _CR and data[i] != _LF:
            return False
    return True


@kernel
def read_rows(
    data: U8,
    start: int,
    stop: int,
    separator: int,
    point: int,
    kinds: I8,
    out: F64,
    base: int,
    most: int,
    texts: I64,
    special: I64,
) -> tuple[int, int, int]:
    """Read rows that begin at `start`, one per line, until `stop`. Returns how it ended, their number and that of the
    special cells.

    kinds     of every column
    out       (columns read, rows): numbers, and truth as 1 and 0; NaN at special cells; `most` rows from `base` on
    texts     (rows, 2): where cells of the TEXT column begin and end
    special   (most, 4): cells that are missing or not plain: column read, row, begin, end
    """
    n, n_special, i = len(kinds), 0, start
    row = 0
    while i < stop:
        if row == most:
            return UNLIKE, row, n_special
        column = 0  # among those that are read
        begun = i
        for k in range(n):
            kind = kinds[k]
            while i < stop and data[i] == _SPACE:
                i += 1
            quoted = i < stop and data[i] == _QUOTE
            first = i + 1 if quoted else i
            read, value, after = False, 0.0, -1
            if kind in (NUMBER, LABEL):
                j = first
                while j < stop and (data[j] == _SPACE or (data[j] == _TAB and separator != _TAB)):
                    j += 1
                value, after = number(data, j, stop, point) if kind == NUMBER else truth(data, j, stop)
                if after >= 0:
                    while after < stop and (data[after] == _SPACE or (data[after] == _TAB and separator != _TAB)):
                        after += 1
                    if quoted:
                        read = after < stop and data[after] == _QUOTE
                    else:
                        read = after == stop or data[after] == separator or data[after] == _LF or data[after] == _CR
            if read:
                last = i = after
            elif quoted:
                i = first
                while i < stop and (data[i] != _QUOTE or (i + 1 < stop and data[i + 1] == _QUOTE)):
                    i += 1 if data[i] != _QUOTE else 2
                last = i
            else:
                while i < stop and data[i] != separator and data[i] != _LF and data[i] != _CR:
                    i += 1
                last = i
            if quoted:
                if i >= stop:
                    return UNLIKE, row, n_special
                i += 1
            ended = i >= stop or data[i] == _LF or (data[i] == _CR and i + 1 < stop and data[i + 1] == _LF)
            if k == 0 and ended and not quoted and blank(data, begun, i):
                return (DONE if blank(data, i, stop) else UNLIKE), row, n_special
            if ended != (k == n - 1) or not (ended or data[i] == separator):
                return UNLIKE, row, n_special
            if kind == TEXT:
                texts[row, 0], texts[row, 1] = first, last
            elif kind != SKIPPED:
                if not read:
                    if n_special == len(special):
                        return FULL, row, n_special
                    special[n_special] = column, row, first, last
                    n_special += 1
                    value = np.nan
                out[column, base + row] = value
                column += 1
            if not ended:
                i += 1
        if i < stop and data[i] == _CR:
            i += 1
        i += 1
        row += 1
    return DONE, row, n_special
