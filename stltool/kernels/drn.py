"""The lines of a DRN file's bytes (models/formats/drn.py): states, actions and their successors.

Numbers stay exact: a decimal w·10^q is (DECIMAL, w, q), a fraction a/b is (FRACTION, a, b), with |w|, |a|, b < 10^18.
Every other text between `begin` and `end` is (TEXT, begin, end), for the caller to read.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.cells import nearest
from stltool.kernels.jit import kernel, part

U8: TypeAlias = NDArray[np.uint8]
I8: TypeAlias = NDArray[np.int8]
I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]

DECIMAL, FRACTION, TEXT = 0, 1, 2
DONE, UNKNOWN, DISORDER, EARLY, COLON, INDEX, TAIL = 0, 1, 2, 3, 4, 5, 6  # how reading ended

_LF, _CR, _SPACE, _TAB, _ZERO, _COLON, _COMMA, _SLASH, _POINT = 10, 13, 32, 9, 48, 58, 44, 47, 46
_OPEN, _CLOSE, _AND, _NOT, _EQUAL, _PLUS, _MINUS = 91, 93, 38, 33, 61, 43, 45
_DIGITS = 18


@part
def _skip(data: U8, i: int, stop: int) -> int:
    """The first byte from i on that is not a space; ends of lines are none."""
    while i < stop and (data[i] == _SPACE or data[i] == _TAB or data[i] == _CR):
        i += 1
    return i


@part
def _line_end(data: U8, i: int, stop: int) -> int:
    while i < stop and data[i] != _LF:
        i += 1
    return i


@part
def _word_end(data: U8, i: int, end: int) -> int:
    while i < end and data[i] != _SPACE and data[i] != _TAB and data[i] != _CR:
        i += 1
    return i


@part
def _trimmed(data: U8, i: int, end: int) -> int:
    """The end of a text without the spaces behind it."""
    while end > i and (data[end - 1] == _SPACE or data[end - 1] == _TAB or data[end - 1] == _CR):
        end -= 1
    return end


@part
def _is_word(data: U8, i: int, end: int, length: int, first: int, last: int) -> bool:
    """Whether a word of that length, with these first and last letters, and a space stand at i: state, action."""
    if i + length > end or data[i] != first or data[i + length - 1] != last:
        return False
    return i + length == end or data[i + length] == _SPACE or data[i + length] == _TAB


@kernel
def exact(data: U8, i: int, end: int) -> tuple[int, np.int64, np.int64, int]:
    """The number that begins at i, and the byte behind it; TEXT if it is none, or too long."""
    begin = i
    negative = False
    if i < end and (data[i] == _MINUS or data[i] == _PLUS):
        negative = data[i] == _MINUS
        i += 1
    w: np.int64 = np.int64(0)
    q: np.int64 = np.int64(0)
    digits, significant, point = 0, 0, False
    while i < end:
        digit = np.int64(data[i]) - _ZERO
        if 0 <= digit <= 9:
            digits += 1
            if w > 0 or digit > 0:
                significant += 1
            if significant > _DIGITS:  # before w could overflow
                return TEXT, np.int64(begin), np.int64(end), end
            w = 10 * w + digit
            q -= point
        elif data[i] == _POINT and not point:
            point = True
        else:
            break
        i += 1
    if digits == 0:
        return TEXT, np.int64(begin), np.int64(end), end
    if negative:
        w = -w
    if i < end and data[i] == _SLASH and not point:
        i += 1
        below, first, long = np.int64(0), i, 0
        while i < end and 0 <= np.int64(data[i]) - _ZERO <= 9:
            if below > 0 or data[i] > _ZERO:
                long += 1
            if long > _DIGITS:
                return TEXT, np.int64(begin), np.int64(end), end
            below = 10 * below + np.int64(data[i]) - _ZERO
            i += 1
        if i == first or below == 0:
            return TEXT, np.int64(begin), np.int64(end), end
        return FRACTION, w, below, i
    if i < end and (data[i] == 69 or data[i] == 101):  # E, e
        i += 1
        down = i < end and data[i] == _MINUS
        i += i < end and (data[i] == _MINUS or data[i] == _PLUS)
        power, first = np.int64(0), i
        while i < end and 0 <= np.int64(data[i]) - _ZERO <= 9 and power < 1000:
            power = 10 * power + np.int64(data[i]) - _ZERO
            i += 1
        if i == first or power >= 1000:
            return TEXT, np.int64(begin), np.int64(end), end
        q += -power if down else power
    return DECIMAL, w, q, i


@kernel
def count_lines(data: U8, start: int, stop: int) -> tuple[int, int, int, int, bool, int]:
    """The numbers of states, choices, entries and rewards, whether there are intervals, and where a line is unlike any
    other; −1: none is."""
    n_states, n_choices, n_entries, n_rewards, intervals, acting = 0, 0, 0, 0, False, False
    i = start
    while i < stop:
        i = _skip(data, i, stop)
        end = _line_end(data, i, stop)
        if i < end:
            byte = data[i]
            state = _is_word(data, i, end, 5, 115, 101)
            if state or _is_word(data, i, end, 6, 97, 110):
                n_states += state
                n_choices += not state
                acting = not state
                j = i if state else _word_end(data, _skip(data, i + 6, end), end)
                while j < end and data[j] != _OPEN and data[j] != 34:
                    j += 1
                if j < end and data[j] == _OPEN:
                    commas = 1
                    while j < end and data[j] != _CLOSE:
                        commas += data[j] == _COMMA
                        j += 1
                    n_rewards = max(n_rewards, commas)
            elif _ZERO <= byte <= _ZERO + 9:
                n_choices += not acting
                acting = True
                n_entries += 1
                if not intervals:
                    for j in range(i, end):
                        intervals = intervals or data[j] == _OPEN
            elif not (byte == _SLASH and i + 1 < end and data[i + 1] == _SLASH):
                return n_states, n_choices, n_entries, n_rewards, intervals, i
        i = end + 1
    return n_states, n_choices, n_entries, n_rewards, intervals, -1


@part
def _rewards(data: U8, i: int, end: int, column: int, kind: I8, above: I64, below: I64, at: I64) -> int:
    """Read "[1, 2]" at i into one column of rewards; returns the byte behind it, i if there is none, −1 if it is not
    closed."""
    if i >= end or data[i] != _OPEN:
        return i
    i += 1
    row = 0
    while True:
        i = _skip(data, i, end)
        stop = i
        while stop < end and data[stop] != _COMMA and data[stop] != _CLOSE:
            stop += 1
        if stop == end:
            return -1
        last = _trimmed(data, i, stop)
        k, a, b, behind = exact(data, i, last)
        if behind != last:
            k, a, b = TEXT, np.int64(i), np.int64(last)
        kind[row, column], above[row, column], below[row, column], at[row, column] = k, a, b, i
        row += 1
        i = stop + 1
        if data[stop] == _CLOSE:
            return i


@kernel
def read_lines(
    data: U8,
    start: int,
    stop: int,
    choice_start: I64,
    row_start: I64,
    state_at: I64,
    state_rest: I64,
    comment: I64,
    named: I64,
    choice_at: I64,
    action: I64,
    target: I64,
    entry_at: I64,
    kind: I8,
    above: I64,
    below: I64,
    state_rewards: tuple[I8, I64, I64, I64],
    choice_rewards: tuple[I8, I64, I64, I64],
) -> tuple[int, int]:
    """Read all lines. Returns how it ended, and where.

    state_rest, comment, named, action   (n, 2): where the texts of labels, //[…], //"…" and names of actions stand
    state_at, choice_at, entry_at        where the lines begin
    kind, above, below                   (2, entries): the ends of probabilities; (1, entries) without intervals
    *_rewards                            kind, above, below (rewards, n), and where they begin
    """
    s, c, k = -1, -1, -1
    acting = False
    i = start
    while i < stop:
        i = _skip(data, i, stop)
        end = _line_end(data, i, stop)
        if i >= end:
            i = end + 1
            continue
        if _is_word(data, i, end, 5, 115, 101):
            s += 1
            acting = False
            choice_start[s] = c + 1
            state_at[s] = i
            j = _skip(data, i + 5, end)
            number, first = np.int64(0), j
            while j < end and _ZERO <= data[j] <= _ZERO + 9 and j < first + 12:
                number = 10 * number + np.int64(data[j]) - _ZERO
                j += 1
            if j == first or number != s:
                return DISORDER, i
            if j < end and not (data[j] == _SPACE or data[j] == _TAB or data[j] == _CR):
                return INDEX, i
            j = _rewards(data, _skip(data, j, end), end, s, *state_rewards)
            if j < 0:
                return TAIL, i
            j = _skip(data, j, end)
            state_rest[s, 0], state_rest[s, 1] = j, _trimmed(data, j, end)
        elif _is_word(data, i, end, 6, 97, 110):
            if s < 0:
                return EARLY, i
            c += 1
            acting = True
            row_start[c] = k + 1
            choice_at[c] = i
            j = _skip(data, i + 6, end)
            first = j
            j = _word_end(data, j, end)
            action[c, 0], action[c, 1] = first, j
            j = _rewards(data, _skip(data, j, end), end, c, *choice_rewards)
            if j < 0 or _skip(data, j, end) < end:
                return TAIL, i
        elif data[i] == _SLASH:
            if s >= 0 and i + 2 < end and data[i + 2] == _OPEN and comment[s, 1] == 0:
                last = _trimmed(data, i, end)
                if data[last - 1] == _CLOSE:
                    comment[s, 0], comment[s, 1] = i + 3, last - 1
            elif s >= 0 and i + 2 < end and data[i + 2] == 34 and named[s, 1] == 0:
                named[s, 0], named[s, 1] = i + 2, _trimmed(data, i, end)
        else:
            if s < 0:
                return EARLY, i
            if not acting:
                c += 1
                acting = True
                row_start[c], choice_at[c] = k + 1, i
            k += 1
            entry_at[k] = i
            j = i
            to, first = np.int64(0), j
            while j < end and _ZERO <= data[j] <= _ZERO + 9 and j < first + 18:
                to = 10 * to + np.int64(data[j]) - _ZERO
                j += 1
            target[k] = to
            j = _skip(data, j, end)
            if j >= end or data[j] != _COLON:
                return COLON, i
            j = _skip(data, j + 1, end)
            last = _trimmed(data, j, end)
            if j < last and data[j] == _OPEN and data[last - 1] == _CLOSE and len(kind) == 2:
                middle = j + 1
                while middle < last and data[middle] != _COMMA:
                    middle += 1
                if middle == last:
                    return TAIL, i
                for e in range(2):
                    begin = _skip(data, j + 1 if e == 0 else middle + 1, last)
                    ending = _trimmed(data, begin, middle if e == 0 else last - 1)
                    one, a, b, behind = exact(data, begin, ending)
                    if behind != ending:
                        one, a, b = TEXT, np.int64(begin), np.int64(ending)
                    kind[e, k], above[e, k], below[e, k] = one, a, b
            else:
                one, a, b, behind = exact(data, j, last)
                if behind != last:
                    one, a, b = TEXT, np.int64(j), np.int64(last)
                for e in range(len(kind)):
                    kind[e, k], above[e, k], below[e, k] = one, a, b
        i = end + 1
    choice_start[s + 1] = c + 1
    row_start[c + 1] = k + 1
    return DONE, -1


@kernel
def same(data: U8, a: int, b: int, length: int) -> bool:
    for k in range(length):  # noqa: SIM110 - a generator is slower when compiled
        if data[a + k] != data[b + k]:
            return False
    return True


@kernel
def intern(data: U8, where: I64, table: I64, number: I64) -> None:
    """number[k] = the first text that is equal to text k; `table` is of −1, longer than twice the number of texts, its
    length a power of 2."""
    mask = len(table) - 1
    for k in range(len(where)):
        begin, end = where[k, 0], where[k, 1]
        h: np.int64 = np.int64(1469598103934665603)
        for i in range(begin, end):
            h = (h ^ np.int64(data[i])) * np.int64(1099511628211)
        slot = (h ^ (h >> 29)) & mask
        while True:
            other = table[slot]
            if other < 0:
                table[slot] = number[k] = k
                break
            if where[other, 1] - where[other, 0] == end - begin and same(data, where[other, 0], begin, end - begin):
                number[k] = other
                break
            slot = (slot + 1) & mask


@kernel
def read_variables(data: U8, where: I64, names: I64, truths: I8, values: F64) -> int:
    """The variables in Storm's comments //[!b	& x=3]; −1, or the first state whose comment is unlike the others.

    names   (variables, 2): where the name of each stands, empty if it is never written: Storm does not write a Boolean
            that is true
    truths  (variables,) whether it is Boolean
    values  (variables, states)
    """
    n = len(names)
    for s in range(len(where)):
        i, stop = where[s, 0], where[s, 1]
        for v in range(n):
            end = i
            while end < stop and data[end] != _AND:
                end += 1
            if (end == stop) != (v == n - 1):
                return s
            begin = _skip(data, i, end)
            last = _trimmed(data, begin, end)
            negated = begin < last and data[begin] == _NOT
            begin += negated
            sign = begin
            while sign < last and data[sign] != _EQUAL:
                sign += 1
            name_end = _trimmed(data, begin, sign)
            if name_end > begin:
                if names[v, 1] == 0:
                    names[v, 0], names[v, 1] = begin, name_end
                known = names[v, 1] - names[v, 0]
                if known != name_end - begin or not same(data, names[v, 0], begin, known):
                    return s
            if sign == last:
                truths[v] = 1
                values[v, s] = 0.0 if negated else 1.0
            else:
                begin = _skip(data, sign + 1, last)
                k, a, b, behind = exact(data, begin, last)
                if negated or behind != last or k == TEXT:
                    return s
                if k == FRACTION:
                    if abs(a) > 9007199254740992 or b > 9007199254740992:
                        return s
                    values[v, s] = np.float64(a) / np.float64(b)
                else:
                    value, certain = nearest(abs(a), np.int64(0), 0, b)
                    if not certain:
                        return s
                    values[v, s] = -value if a < 0 else value
            i = end + 1
    return -1


@kernel
def doubles(kind: I8, above: I64, below: I64, out: F64) -> int:
    """The doubles nearest to numbers; NaN where that is not certain, or a text. Returns how many those are."""
    unsure = 0
    for k in range(len(kind)):
        a = above[k]
        value, certain = np.nan, False
        if kind[k] == DECIMAL:
            value, certain = nearest(abs(a), np.int64(0), 0, below[k])
            value = -value if a < 0 else value
        elif kind[k] == FRACTION:
            certain = abs(a) <= 9007199254740992 and below[k] <= 9007199254740992
            value = np.float64(a) / np.float64(below[k])
        out[k] = value if certain else np.nan
        unsure += not certain
    return unsure
