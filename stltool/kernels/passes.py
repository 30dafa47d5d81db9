"""A program over traces, tile by tile: all its passes over some thousand samples stay in the first-level cache.

What monitoring/blocks.py does with numpy, whose results these are, in margins or, with `truth`, in 0 and 1. Rows are
either *open*, their steps decided by the samples there are, and judged in tiles; or they end, and windows are cut
there, or the last sample is held. Of the latter, some are judged side by side: sample t of row r lies at t·lanes + r,
so that one loop runs over all of them, and a window is cut at one place. NaN must not occur.

An instruction: op, register, operands, a, b, horizon of its operands, and of an atom: kind, comparator, for both sides
the column or −1 and a sign. A column is an address and the bytes from row to row; `numbers` has two per atom.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import types
from numpy.typing import NDArray

from stltool.kernels.streams import (
    ATOM_WIDTH,
    EQUAL,
    GREATER,
    GREATER_EQUAL,
    LESS,
    LESS_EQUAL,
    OP_ALWAYS,
    OP_AND,
    OP_ATOM,
    OP_EVENTUALLY,
    OP_IFF,
    OP_NOT,
    OP_OR,
    OP_UNTIL,
    _arrays_of,
    _doubles,
    kernel,
    part,
)

I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]
Values: TypeAlias = NDArray[Any]

WIDTH = 7 + ATOM_WIDTH
PLAIN_ATOM, LABEL_ATOM, GIVEN_ATOM, FIXED_ATOM = range(4)  # `numbers` of a fixed one: margin, truth
SPARE = 4  # values that an operator needs besides its own
TILE = 1024  # samples, at least
LANES = 8  # rows side by side
_truths = _arrays_of(types.uint8)


@part
def _fold(left: Values, right: Values, out: Values, greatest: bool) -> None:
    """All of one length; in place if `out` begins where an operand does."""
    if greatest:
        for i in range(len(out)):
            x, y = left[i], right[i]
            out[i] = x if x > y else y
    else:
        for i in range(len(out)):
            x, y = left[i], right[i]
            out[i] = x if x < y else y


@part
def _fold_four(a: Values, b: Values, c: Values, d: Values, out: Values, greatest: bool) -> None:
    """All of one length; `out` is another array."""
    if greatest:
        for i in range(len(out)):
            x = a[i] if a[i] > b[i] else b[i]
            y = c[i] if c[i] > d[i] else d[i]
            out[i] = x if x > y else y
    else:
        for i in range(len(out)):
            x = a[i] if a[i] < b[i] else b[i]
            y = c[i] if c[i] < d[i] else d[i]
            out[i] = x if x < y else y


@part
def _negate(x: Values, out: Values, truth: bool) -> None:
    for i in range(len(out)):
        out[i] = 1 - x[i] if truth else 0 - x[i]  # 0, not −0, for 0


@kernel
def _side(out: F64, address: int, sign: int, number: float) -> None:
    """The left or right side of a comparison."""
    if address == 0:
        out[:] = number
        return
    x = _doubles(address, len(out))
    if sign > 0:
        for i in range(len(out)):
            out[i] = x[i]
    else:
        for i in range(len(out)):
            out[i] = -x[i]


@part
def _compare(op: int, left: F64, right: F64, out: Values, truth: bool) -> None:
    n = len(out)
    if truth:
        if op == GREATER:
            for i in range(n):
                out[i] = left[i] > right[i]
        elif op == GREATER_EQUAL:
            for i in range(n):
                out[i] = left[i] >= right[i]
        elif op == LESS:
            for i in range(n):
                out[i] = left[i] < right[i]
        elif op == LESS_EQUAL:
            for i in range(n):
                out[i] = left[i] <= right[i]
        elif op == EQUAL:
            for i in range(n):
                out[i] = left[i] == right[i]
        else:
            for i in range(n):
                out[i] = left[i] != right[i]
    elif op in (GREATER, GREATER_EQUAL):
        for i in range(n):
            out[i] = left[i] - right[i] + 0.0
    elif op in (LESS, LESS_EQUAL):
        for i in range(n):
            out[i] = right[i] - left[i] + 0.0
    elif op == EQUAL:
        for i in range(n):
            out[i] = 0.0 - abs(left[i] - right[i])
    else:
        for i in range(n):
            out[i] = abs(left[i] - right[i])


@part
def _compare_with(op: int, x: F64, number: float, out: Values, truth: bool) -> None:
    """The usual comparison, of a signal with a number."""
    n = len(out)
    if truth:
        if op == GREATER:
            for i in range(n):
                out[i] = x[i] > number
        elif op == GREATER_EQUAL:
            for i in range(n):
                out[i] = x[i] >= number
        elif op == LESS:
            for i in range(n):
                out[i] = x[i] < number
        else:
            for i in range(n):
                out[i] = x[i] <= number
    elif op <= GREATER_EQUAL:
        for i in range(n):
            out[i] = x[i] - number + 0.0
    else:
        for i in range(n):
            out[i] = number - x[i] + 0.0


@kernel
def within(x: F64, limit: float) -> bool:
    """Whether all samples lie between −limit and limit."""
    beyond = 0
    for i in range(len(x)):
        beyond += not abs(x[i]) < limit
    return beyond == 0


@part
def _checked(now: I64, columns: I64, row: int, first: int, n: int, limit: float) -> bool:
    """Whether all samples that a comparison reads lie between −limit and limit."""
    for side in range(2):
        column = now[9 + 2 * side]
        if now[7] == PLAIN_ATOM and column >= 0:
            address = columns[2 * column] + row * columns[2 * column + 1] + 8 * first
            if not within(_doubles(address, n), limit):
                return False
    return True


@part
def _atom(
    now: I64, numbers: F64, columns: I64, row: int, first: int, out: Values, sides: F64, size: int, truth: bool
) -> None:
    kind, op, n = now[7], now[8], len(out)
    if kind == PLAIN_ATOM and now[9] >= 0 and now[10] > 0 and now[11] < 0 and op <= LESS_EQUAL:
        address = columns[2 * now[9]] + row * columns[2 * now[9] + 1] + 8 * first
        _compare_with(op, _doubles(address, n), numbers[1], out, truth)
    elif kind == PLAIN_ATOM:
        left, right = sides[:n], sides[size : size + n]
        for side in range(2):
            column = now[9 + 2 * side]
            address = 0
            if column >= 0:
                address = columns[2 * column] + row * columns[2 * column + 1] + 8 * first
            _side(left if side == 0 else right, address, now[10 + 2 * side], numbers[side])
        _compare(op, left, right, out, truth)
    elif kind == FIXED_ATOM:
        out[:] = numbers[1 if truth else 0]
    else:
        address = columns[2 * now[9]] + row * columns[2 * now[9] + 1]
        if kind == LABEL_ATOM or truth:
            known = _truths(address + first, n)
            for i in range(n):
                if truth:
                    out[i] = known[i]
                else:
                    out[i] = np.inf if known[i] != 0 else -np.inf
        else:
            margins = _doubles(address + 8 * first, n)
            for i in range(n):
                out[i] = margins[i]


@part
def _window(x: Values, width: int, greatest: bool, out: Values, one: Values, other: Values, lanes: int) -> None:
    """out[t] = max (or min) of x[t … t+width−1], cut at the end of x; of the steps of `out`, which are not more.

    A pass joins up to four windows, which may overlap.
    """
    n, span = len(x), 1
    if width == 1:
        for i in range(len(out)):
            out[i] = x[i]
    known = x
    while span < width:
        wider = min(4 * span, width)
        third = (wider - span) * lanes
        first, second = span * lanes, min(2 * span * lanes, third)
        count = min(n, len(out) + (width - wider) * lanes)  # of the results, later passes need these
        target = out if wider == width else one
        # where all windows are within x, where three, where two
        four, three, two = min(count, max(n - third, 0)), min(count, max(n - second, 0)), min(count, max(n - first, 0))
        if wider <= 2 * span:
            two = three = four
        for piece in range(3):
            low, high, y, z = 0, four, second, third
            if piece == 1:
                low, high, y, z = four, three, second, second
            elif piece == 2:
                low, high, y, z = three, two, first, first
            if low >= high:
                continue
            if piece == 2 or wider <= 2 * span:
                _fold(known[low:high], known[z + low : z + high], target[low:high], greatest)
            else:
                _fold_four(
                    known[low:high], known[first + low : first + high], known[y + low : y + high],
                    known[z + low : z + high], target[low:high], greatest,
                )  # fmt: skip
        for i in range(two, count):
            target[i] = known[i]
        known, span = target, wider
        one, other = other, one


@part
def _suffixes(x: Values, greatest: bool, out: Values, lanes: int) -> None:
    """out[t] = max (or min) of x[t …]."""
    n = len(x)
    for i in range(n - lanes, n):
        out[i] = x[i]
    for i in range(n - lanes - 1, -1, -1):
        best, y = out[i + lanes], x[i]
        out[i] = (best if best > y else y) if greatest else (best if best < y else y)


@part
def _until(
    left: Values, right: Values, a: int, width: int, out: Values, A: Values, B: Values, C: Values, before: Values,
    lanes: int,
) -> None:  # fmt: skip
    """φ U[a,a+width−1] ψ at the steps of `out`, a witness being within ψ: see monitoring/blocks.py."""
    wanted, n, span = len(out), len(right) - a * lanes, 1
    if a > 0:
        _window(left, a, False, before[:wanted], A, B, lanes)
    for i in range(n):
        A[i], B[i] = left[a * lanes + i], right[a * lanes + i]
    while span < width:
        step = min(span, width - span)
        both = min(n - step * lanes, wanted + (width - span - step) * lanes)
        after = step * lanes
        _fold(A[:both], B[after : after + both], C[:both], False)
        _fold(B[:both], C[:both], B[:both], True)
        _fold(A[:both], A[after : after + both], C[:both], False)
        for i in range(both, n):
            C[i] = A[i]
        A, C, span = C, A, span + step
    if a > 0:
        _fold(before[:wanted], B[:wanted], out, False)
    else:
        for i in range(wanted):
            out[i] = B[i]


@part
def _beyond(left: Values, last: Values, out: Values, until: bool, hold: bool, empty: Any) -> None:
    """Values of `out`, at steps whose windows begin after the end.

    Held samples: every later one is the last; before a witness of until, `left` holds to the end.
    """
    for i in range(len(out)):
        if hold:
            y = last[i % len(last)]
            out[i] = left[i] if until and left[i] < y else y
        else:
            out[i] = empty


@part
def _interleave(x: Values, out: Values) -> None:
    """LANES rows, one after the other, side by side. All at once: that takes a third of the time."""
    n = len(x) // LANES
    a, b, c, d = x[:n], x[n : 2 * n], x[2 * n : 3 * n], x[3 * n : 4 * n]
    e, f, g, h = x[4 * n : 5 * n], x[5 * n : 6 * n], x[6 * n : 7 * n], x[7 * n : 8 * n]
    for t in range(n):
        at = LANES * t
        out[at], out[at + 1], out[at + 2], out[at + 3] = a[t], b[t], c[t], d[t]
        out[at + 4], out[at + 5], out[at + 6], out[at + 7] = e[t], f[t], g[t], h[t]


@part
def _separate(x: Values, out: Values) -> None:
    """What `_interleave` has joined."""
    n = len(x) // LANES
    a, b, c, d = out[:n], out[n : 2 * n], out[2 * n : 3 * n], out[3 * n : 4 * n]
    e, f, g, h = out[4 * n : 5 * n], out[5 * n : 6 * n], out[6 * n : 7 * n], out[7 * n : 8 * n]
    for t in range(n):
        at = LANES * t
        a[t], b[t], c[t], d[t] = x[at], x[at + 1], x[at + 2], x[at + 3]
        e[t], f[t], g[t], h[t] = x[at + 4], x[at + 5], x[at + 6], x[at + 7]


@kernel
def run(
    program: I64, numbers: F64, columns: I64, rows: int, steps: int, lanes: int, hold: bool, truth: bool,
    least: Any, greatest: Any, scratch: Values, sides: F64, size: int, decided: int, out: Values, at: int, wide: int,
    above: Values, limit: float,
) -> int:  # fmt: skip
    """Write the decided steps of all rows to `out`, from `at` on, where one row is `wide` values after the other.

    Also whether they are above 0 to `above`, unless it is empty. Returns how many are 0, as far as that was looked at;
    or −1, if `limit` is not 0 and some sample does not lie between −limit and limit.

    `lanes` is 0 for open rows; for others, LANES if these are judged side by side, and 1 if not. `scratch` has `size`
    values for each register, and SPARE more; `sides` two. As many open rows are computed together as have room there; a
    longer one in parts.
    """
    n_ops = len(program) // WIDTH
    result = program[(n_ops - 1) * WIDTH + 1] * size
    open_, spare, across = lanes == 0, len(scratch) - SPARE * size, max(lanes, 1)
    horizon = steps - decided if open_ else 0
    parts = open_ and steps > size
    group, tile = lanes, decided
    if open_:
        group, tile = (1, size - horizon) if parts else (size // steps, decided)
    one, other = scratch[spare : spare + size], scratch[spare + size : spare + 2 * size]
    third, fourth = scratch[spare + 2 * size : spare + 3 * size], scratch[spare + 3 * size :]
    zeros = 0
    for begin in range(0, rows, group):
        row = begin if open_ else min(begin, rows - group)  # the last rows of those side by side, some again
        together = min(group, rows - row)
        for first in range(0, decided, tile):
            m = min(tile, decided - first)
            length = m + horizon if parts else together * steps
            for i in range(n_ops):
                now = program[i * WIDTH : (i + 1) * WIDTH]
                op, a, b = now[0], now[4], now[5]
                count = length - now[6] if open_ else length  # values of the operands
                value = scratch[now[1] * size : now[1] * size + count]
                if parts and i == n_ops - 1:  # of which nothing else is needed
                    value = out[at + row * wide + first :][:m]
                if op == OP_ATOM:
                    n, values = m + horizon if parts else steps, value if across == 1 else one[:count]
                    for r in range(together):
                        if limit > 0 and not _checked(now, columns, row + r, first, n, limit):
                            return -1
                        known = values[r * steps : r * steps + n]
                        _atom(now, numbers[2 * i : 2 * i + 2], columns, row + r, first, known, sides, size, truth)
                    if across > 1:
                        _interleave(values, value)
                    continue
                x = scratch[now[2] * size : now[2] * size + count]
                y = scratch[now[3] * size : now[3] * size + count]
                if op == OP_NOT:
                    _negate(x, value, truth)
                elif op in (OP_AND, OP_OR):
                    _fold(x, y, value, op == OP_OR)
                elif op == OP_IFF:
                    p, q = one[:count], other[:count]
                    _negate(x, p, truth)
                    _fold(p, y, p, True)
                    _negate(y, q, truth)
                    _fold(x, q, q, True)
                    _fold(p, q, value, False)
                else:
                    # steps whose windows begin before the end; there, these are cut
                    inside, width = count - (b if open_ else a * across), b - a + 1
                    if not open_:
                        width = min(width, steps - a)
                    some = op == OP_EVENTUALLY
                    if width > 0 and op == OP_UNTIL:
                        _until(x, y, a, width, value[:inside], one, other, third, fourth, across)
                    elif width > 0 and not open_ and width == steps - a:
                        _suffixes(x[a * across :], some, value[:inside], across)
                    elif width > 0:
                        _window(x[a * across :], width, some, value[:inside], one, other, across)
                    if not open_ and a > 0:
                        if hold and op == OP_UNTIL:
                            _suffixes(x, False, fourth[:count], across)
                        held, empty = y[count - across :], greatest if op == OP_ALWAYS else least
                        _beyond(fourth[inside:count], held, value[inside:], op == OP_UNTIL, hold, empty)
            found = scratch[result : result + length]
            if across > 1:
                found = one[:length]
                _separate(scratch[result : result + length], found)
            for r in range(together):
                to = at + (row + r) * wide + first
                target, values = out[to : to + m], found[r * steps : r * steps + m]
                if not parts:
                    for t in range(m):
                        target[t] = values[t]
                if len(above) > 0:
                    signs = above[to : to + m]
                    for t in range(m):
                        signs[t] = target[t] > 0
                        zeros += target[t] == 0
    return zeros
