"""Lines of numbers in text files (models/formats/lines.py): indices, a number, a word; from the bytes, to arrays.

    index … index number [word]           PRISM's .tra, .trew, .srew; a number is a decimal or [decimal,decimal]
    index number:index … [word]           the same by rows
    index: index …                        .lab
    index:(value,…)                       .sta; a value is an integer, true or false

Empty lines and lines that begin with # are skipped. A line that is not plainly of its form is left to Python: the
kernel stops there. Decimals are w / 10^places with w < 10^18 and 0 ≤ places ≤ 18; other numbers, and words, are looked
up in a table of texts (`find`): the kernel stops at an unknown one, Python adds it, and the kernel resumes.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.cells import nearest
from stltool.kernels.jit import kernel, part

U8: TypeAlias = NDArray[np.uint8]
B8: TypeAlias = NDArray[np.bool_]
I8: TypeAlias = NDArray[np.int8]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]

DONE, ODD, TEXT, WORD, FULL, WIDE = 0, 1, 2, 3, 4, 5
"""How reading ended: at the end; at a line that is left to Python; at a number or a word that is not in its table; at
a row for which there is no room; at an interval, where there is no room for upper ends."""

SHORTEST = 10**15 - 1
"""Decimals w / 10^places up to this w are the shortest ones of their doubles."""
RANGE = -2
"""In the place of places: an interval."""

UNKNOWN, NO_TYPE, TRUTH, NUMBER = -1, 0, 1, 2

_LF, _CR, _TAB, _SPACE, _HASH, _PLUS, _COMMA, _MINUS, _POINT, _ZERO, _COLON = 10, 13, 9, 32, 35, 43, 44, 45, 46, 48, 58
_OPEN, _CLOSE, _ROUND_OPEN, _ROUND_CLOSE = 91, 93, 40, 41
_DIGITS = 18
_INDEX_DIGITS = 9
_MASK = (1 << 40) - 1


@part
def blanks(data: U8, i: int, stop: int) -> int:
    """The first byte from i that is neither a space nor a tab nor a carriage return."""
    while i < stop and (data[i] == _SPACE or data[i] == _TAB or data[i] == _CR):
        i += 1
    return i


@part
def token(data: U8, i: int, stop: int) -> int:
    """The end of the word that begins at i."""
    while i < stop and data[i] != _SPACE and data[i] != _TAB and data[i] != _CR and data[i] != _LF:
        i += 1
    return i


@part
def line_end(data: U8, i: int, stop: int) -> int:
    """The end of the line, or `stop`."""
    while i < stop and data[i] != _LF:
        i += 1
    return i


@part
def next_line(data: U8, i: int, stop: int, line: int) -> tuple[int, int]:
    """Where the next line with content begins, without its blanks, and its number; `line` is that of the line at i."""
    while i < stop:
        begin = blanks(data, i, stop)
        if begin < stop and data[begin] != _LF and data[begin] != _HASH:
            return begin, line
        i = line_end(data, begin, stop) + 1
        line += 1
    return stop, line


@part
def index(data: U8, i: int, stop: int) -> tuple[np.int64, int]:
    """The number without sign at i, and the byte after it; −1 if there is none, or it is long."""
    n, begin = np.int64(0), i
    while i < stop and 0 <= np.int64(data[i]) - _ZERO <= 9:
        n = 10 * n + (np.int64(data[i]) - _ZERO)
        i += 1
        if i - begin > _INDEX_DIGITS:
            return np.int64(0), -1
    return n, (i if i > begin else -1)


@part
def decimal(data: U8, i: int, stop: int) -> tuple[float, np.int64, np.int64, int]:
    """The decimal at i: its double, w, places, and the byte after it; −1 if there is none of at most 18 digits and
    places whose double is certain."""
    negative = i < stop and data[i] == _MINUS
    if i < stop and (data[i] == _MINUS or data[i] == _PLUS):
        i += 1
    w, places = np.int64(0), np.int64(0)
    used, digits, point = 0, 0, False
    while i < stop:
        digit = np.int64(data[i]) - _ZERO
        if 0 <= digit <= 9:
            w = 10 * w + digit
            used += 1 if w > 0 else 0
            if used > _DIGITS:
                return 0.0, w, places, -1
            digits += 1
            places += np.int64(point)
        elif data[i] == _POINT and not point:
            point = True
        else:
            break
        i += 1
    if digits == 0:
        return 0.0, w, places, -1
    if i < stop and (data[i] == 69 or data[i] == 101):  # E, e
        i += 1
        down = i < stop and data[i] == _MINUS
        if i < stop and (data[i] == _MINUS or data[i] == _PLUS):
            i += 1
        power, i = index(data, i, stop)
        if i < 0 or power > 1000:
            return 0.0, w, places, -1
        places += power if down else -power
    if w == 0:
        return 0.0, w, np.int64(0), i
    while places < 0 and used < _DIGITS:
        w *= 10
        used += 1
        places += 1
    while places > _DIGITS and w % 10 == 0:
        w //= 10
        places -= 1
    if places < 0 or places > _DIGITS:
        return 0.0, w, places, -1
    value, certain = nearest(w, np.int64(0), 0, -places)
    return (-value if negative else value), (-w if negative else w), places, (i if certain else -1)


@kernel
def code_of(data: U8, i: int, stop: int) -> np.int64:
    """The hash of a text."""
    code = np.int64(stop - i)
    for k in range(i, stop):
        code = ((code * 1000003) ^ np.int64(data[k])) & _MASK
    return code


@part
def find(data: U8, i: int, stop: int, slots: I32, spans: I64, arena: U8) -> int:
    """The number of the text at i … stop−1 in a table, or `UNKNOWN`.

    slots   numbers of texts by hash, `UNKNOWN` where there is none; their number is a power of two
    spans   (texts, 2): where in `arena` each begins and ends
    """
    at = int(code_of(data, i, stop)) & (len(slots) - 1)
    while slots[at] >= 0:
        n = int(slots[at])
        begin, end = spans[n, 0], spans[n, 1]
        if end - begin == stop - i:
            k = 0
            while k < stop - i and arena[begin + k] == data[i + k]:
                k += 1
            if k == stop - i:
                return n
        at = (at + 1) & (len(slots) - 1)
    return UNKNOWN


@kernel
def entries(
    data: U8,
    start: int,
    stop: int,
    line: int,
    row: int,
    limits: I64,
    worded: bool,
    lead: I32,
    last: I32,
    value: F64,
    upper: F64,
    w: I64,
    places: I8,
    words: I32,
    texts: tuple[I32, I64, U8, F64],
    named: tuple[I32, I64, U8],
) -> tuple[int, int, int, int, int]:
    """Read lines from `start` on; the first one has the number `line`, its entry goes to `row`.

    limits      what each index must be below
    worded      whether a word may follow the number
    lead, last  (indices − 1, rows), (rows,): the indices          value   (rows,) the nearest doubles
    upper       (rows,) or empty: upper ends of intervals, whose lower ends are `value`
    w, places   (rows,) numbers exactly: w / 10^places; with places = −1, text number w of `texts`
    words       (rows,) numbers of words among `named`, −1 for none
    texts, named   slots, spans and arena of tables; for `texts` also the doubles

    Returns how it ended, where (the beginning of a line), its number, the row, and where the unknown text begins.
    """
    i = start
    while True:
        i, line = next_line(data, i, stop, line)
        if i == stop:
            return DONE, stop, line, row, stop
        begin = i
        if row == len(value):
            return FULL, begin, line, row, begin
        for k in range(len(limits)):
            number, i = index(data, i, stop)
            if i < 0 or number >= limits[k] or i == stop or (data[i] != _SPACE and data[i] != _TAB):
                return ODD, begin, line, row, begin
            if k < len(lead):
                lead[k, row] = number
            else:
                last[row] = number
            i = blanks(data, i, stop)
        if i < stop and data[i] == _OPEN:
            if len(upper) == 0:
                return WIDE, begin, line, row, begin
            first, digits, _, i = decimal(data, i + 1, stop)
            if i < 0 or i == stop or data[i] != _COMMA or digits > SHORTEST:
                return ODD, begin, line, row, begin
            top, digits, _, i = decimal(data, i + 1, stop)
            if i < 0 or i == stop or data[i] != _CLOSE or token(data, i, stop) != i + 1 or digits > SHORTEST:
                return ODD, begin, line, row, begin
            i += 1
            value[row], upper[row], places[row] = first, top, RANGE
        else:
            first, w[row], place, after = decimal(data, i, stop)
            end = token(data, i, stop)
            if after != end:
                n = find(data, i, end, texts[0], texts[1], texts[2])
                if n < 0:
                    return TEXT, begin, line, row, i
                first, w[row], place = texts[3][n], n, np.int64(-1)
            value[row], places[row] = first, place
            if len(upper) > 0:
                upper[row] = first
            i = end
        i = blanks(data, i, stop)
        words[row] = UNKNOWN
        if worded and i < stop and data[i] != _LF:
            end = token(data, i, stop)
            n = find(data, i, end, named[0], named[1], named[2])
            if n < 0:
                return WORD, begin, line, row, i
            words[row] = n
            i = blanks(data, end, stop)
        if i < stop and data[i] != _LF:
            return ODD, begin, line, row, begin
        row += 1
        i += 1
        line += 1


@kernel
def rows(
    data: U8,
    start: int,
    stop: int,
    line: int,
    row: int,
    limit: int,
    worded: bool,
    seen: I32,
    lead: I32,
    last: I32,
    value: F64,
    upper: F64,
    w: I64,
    places: I8,
    words: I32,
    texts: tuple[I32, I64, U8, F64],
    named: tuple[I32, I64, U8],
) -> tuple[int, int, int, int, int]:
    """The same for lines with a whole row: `lead` are the state and the number of the line among those of the state.

    limit   what states must be below          seen   (limit,) how many lines of a state there were
    """
    i = start
    while True:
        i, line = next_line(data, i, stop, line)
        if i == stop:
            return DONE, stop, line, row, stop
        begin, first_row = i, row
        state, i = index(data, i, stop)
        if i < 0 or state >= limit or token(data, i, stop) != i:
            return ODD, begin, line, first_row, begin
        name = UNKNOWN
        i = blanks(data, i, stop)
        while i < stop and data[i] != _LF:
            end = token(data, i, stop)
            colon = i
            while colon < end and data[colon] != _COLON:
                colon += 1
            if colon == end:  # the word at the end
                if not worded or name >= 0:
                    return ODD, begin, line, first_row, begin
                name = find(data, i, end, named[0], named[1], named[2])
                if name < 0:
                    return WORD, begin, line, first_row, i
                i = blanks(data, end, stop)
                continue
            if name >= 0:
                return ODD, begin, line, first_row, begin
            if row == len(value):
                return FULL, begin, line, first_row, begin
            if data[i] == _OPEN:
                if len(upper) == 0:
                    return WIDE, begin, line, first_row, begin
                first, digits, _, i = decimal(data, i + 1, stop)
                if i < 0 or i == stop or data[i] != _COMMA or digits > SHORTEST:
                    return ODD, begin, line, first_row, begin
                top, digits, _, i = decimal(data, i + 1, stop)
                if i < 0 or i + 1 != colon or data[i] != _CLOSE or digits > SHORTEST:
                    return ODD, begin, line, first_row, begin
                value[row], upper[row], places[row] = first, top, RANGE
            else:
                first, w[row], place, after = decimal(data, i, stop)
                if after != colon:
                    n = find(data, i, colon, texts[0], texts[1], texts[2])
                    if n < 0:
                        return TEXT, begin, line, first_row, i
                    first, w[row], place = texts[3][n], n, np.int64(-1)
                value[row], places[row] = first, place
                if len(upper) > 0:
                    upper[row] = first
            number, after = index(data, colon + 1, stop)
            if after != end or number >= limit:
                return ODD, begin, line, first_row, begin
            lead[0, row], lead[1, row], last[row] = state, seen[state], number
            row += 1
            i = blanks(data, end, stop)
        for k in range(first_row, row):
            words[k] = name
        seen[state] += 1
        i += 1
        line += 1


@kernel
def labels(data: U8, start: int, stop: int, line: int, rank: I64, holds: B8) -> tuple[int, int, int]:
    """Read lines of labels. `rank`: the row in `holds` (labels, states) of each number, or −1.

    Returns how it ended, where, and the number of the line.
    """
    i = start
    while True:
        i, line = next_line(data, i, stop, line)
        if i == stop:
            return DONE, stop, line
        begin = i
        state, i = index(data, i, stop)
        if i < 0 or state >= holds.shape[1]:
            return ODD, begin, line
        i = blanks(data, i, stop)
        if i == stop or data[i] != _COLON:
            return ODD, begin, line
        i = blanks(data, i + 1, stop)
        first = i
        while i < stop and data[i] != _LF:  # all or nothing of a line
            number, i = index(data, i, stop)
            if i < 0 or number >= len(rank) or rank[number] < 0 or token(data, i, stop) != i:
                return ODD, begin, line
            i = blanks(data, i, stop)
        end, i = i, first
        while i < end:
            number, i = index(data, i, stop)
            holds[rank[number], state] = True
            i = blanks(data, i, stop)
        i = end + 1
        line += 1


@kernel
def valuations(data: U8, start: int, stop: int, line: int, seen: B8, types: I8, values: F64) -> tuple[int, int, int]:
    """Read lines of the variables' values (variables, states): integers, true and false.

    seen    (states,) those that have values        types   (variables,) NO_TYPE, TRUTH or NUMBER

    Returns how it ended, where, and the number of the line.
    """
    i = start
    while True:
        i, line = next_line(data, i, stop, line)
        if i == stop:
            return DONE, stop, line
        begin = i
        state, i = index(data, i, stop)
        if i < 0 or state >= len(seen) or seen[state] or i + 1 >= stop or data[i] != _COLON:
            return ODD, begin, line
        i += 1
        if data[i] != _ROUND_OPEN:
            return ODD, begin, line
        for k in range(len(types)):
            i += 1
            negative = i < stop and data[i] == _MINUS
            if negative:
                i += 1
            kind, value = NUMBER, 0.0
            if i + 4 <= stop and data[i] == 116 and data[i + 1] == 114 and data[i + 2] == 117 and data[i + 3] == 101:
                kind, value = TRUTH, 1.0
                i += 4
            elif (
                i + 5 <= stop
                and data[i] == 102
                and data[i + 1] == 97
                and data[i + 2] == 108
                and data[i + 3] == 115
                and data[i + 4] == 101
            ):
                kind = TRUTH
                i += 5
            else:
                first = i
                number, i = index(data, i, stop)
                if i < 0 or (data[first] == _ZERO and i - first > 1) or (negative and number == 0):
                    return ODD, begin, line  # not as numbers are printed
                value = float(-number) if negative else float(number)
            if (kind == TRUTH and negative) or (types[k] != NO_TYPE and types[k] != kind):
                return ODD, begin, line
            if i == stop or data[i] != (_COMMA if k < len(types) - 1 else _ROUND_CLOSE):
                return ODD, begin, line
            types[k] = kind
            values[k, state] = value
        i = blanks(data, i + 1, stop)
        if i < stop and data[i] != _LF:
            return ODD, begin, line
        seen[state] = True
        i += 1
        line += 1
