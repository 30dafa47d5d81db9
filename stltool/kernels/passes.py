"""A program over traces, tile by tile: all its passes over some thousand samples stay in the first-level cache.

What monitoring/blocks.py does with numpy, whose results these are, in margins or, with `truth`, in 0 and 1. A row is
either *open*, its steps decided by the samples there are, in tiles; or it has padding, which each windowed operand
fills for its reader. NaN must not occur.

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
)

I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]
Values: TypeAlias = NDArray[Any]

WIDTH = 7 + ATOM_WIDTH
PLAIN_ATOM, LABEL_ATOM, GIVEN_ATOM, FIXED_ATOM = range(4)  # `numbers` of a fixed one: margin, truth
WINDOWS = (OP_EVENTUALLY, OP_ALWAYS)
SPARE = 4  # values that an operator needs besides its own
TILE = 1024  # samples, at least
_truths = _arrays_of(types.uint8)


@kernel
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


@kernel
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


@kernel
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


@kernel
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


@kernel
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


@kernel
def _checked(now: I64, columns: I64, row: int, first: int, n: int, limit: float) -> bool:
    """Whether all samples that a comparison reads lie between −limit and limit."""
    for side in range(2):
        column = now[9 + 2 * side]
        if now[7] == PLAIN_ATOM and column >= 0:
            address = columns[2 * column] + row * columns[2 * column + 1] + 8 * first
            if not within(_doubles(address, n), limit):
                return False
    return True


@kernel
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


@kernel
def _window(x: Values, width: int, greatest: bool, out: Values, one: Values, other: Values) -> None:
    """out[t] = max (or min) of x[t … t+width−1]; x has width − 1 values more than `out`.

    A pass joins up to four windows, which may overlap.
    """
    count, span = len(out) + width - 1, 1
    if width == 1:
        for i in range(len(out)):
            out[i] = x[i]
    known = x[:count]
    while span < width:
        wider = min(4 * span, width)
        last = wider - span
        count -= last
        target = out if wider == width else one[:count]
        if wider <= 2 * span:
            _fold(known[:count], known[last : last + count], target, greatest)
        else:
            second, third = known[span : span + count], known[min(2 * span, last) : min(2 * span, last) + count]
            _fold_four(known[:count], second, third, known[last : last + count], target, greatest)
        known, span = target, wider
        one, other = other, one


@kernel
def _suffixes(x: Values, greatest: bool, out: Values) -> None:
    """out[t] = max (or min) of x[t …]."""
    best = x[len(x) - 1]
    for t in range(len(x) - 1, -1, -1):
        y = x[t]
        best = (best if best > y else y) if greatest else (best if best < y else y)
        out[t] = best


@kernel
def _until(
    left: Values, right: Values, a: int, width: int, out: Values, A: Values, B: Values, C: Values, before: Values
) -> None:
    """φ U[a,a+width−1] ψ at all steps of `out`: see monitoring/blocks.py."""
    n = len(out)
    if a > 0:
        _window(left, a, False, before[:n], A, B)
    count, span = n + width - 1, 1
    for i in range(count):
        A[i], B[i] = left[a + i], right[a + i]
    while span < width:
        step = min(span, width - span)
        count -= step
        _fold(A[:count], B[step : step + count], C[:count], False)
        _fold(B[:count], C[:count], B[:count], True)
        _fold(A[:count], A[step : step + count], C[:count], False)
        A, C, span = C, A, span + step
    if a > 0:
        _fold(before[:n], B[:n], out, False)
    else:
        for i in range(n):
            out[i] = B[i]


@kernel
def _fill(x: Values, rows: int, stride: int, steps: int, hold: bool, neutral: Any) -> None:
    """The padding of an operand: what it is beyond the ends of the rows."""
    for row in range(rows):
        part = x[row * stride : (row + 1) * stride]
        for i in range(steps, stride):
            part[i] = part[steps - 1] if hold else neutral


@kernel
def run(
    program: I64, numbers: F64, columns: I64, rows: int, steps: int, padding: int, hold: bool, truth: bool,
    least: Any, greatest: Any, scratch: Values, sides: F64, size: int, decided: int, out: Values, at: int, wide: int,
    above: Values, limit: float,
) -> int:  # fmt: skip
    """Write the decided steps of all rows to `out`, from `at` on, where one row is `wide` values after the other.

    Also whether they are above 0 to `above`, unless it is empty. Returns how many are 0, as far as that was looked at;
    or −1, if `limit` is not 0 and some sample does not lie between −limit and limit.

    `padding` is −1 for open rows, which touch. `scratch` has `size` values for each register, and SPARE more; `sides`
    two. As many rows are computed together as have room there; a longer one, which is open, in parts.
    """
    n_ops = len(program) // WIDTH
    last = program[(n_ops - 1) * WIDTH : n_ops * WIDTH]
    open_, spare = padding < 0, len(scratch) - SPARE * size
    horizon = steps - decided if open_ else 0
    stride = steps if open_ else steps + padding
    parts = stride > size
    group, tile = (1, size - horizon) if parts else (size // stride, decided)
    one, other = scratch[spare : spare + size], scratch[spare + size : spare + 2 * size]
    third, fourth = scratch[spare + 2 * size : spare + 3 * size], scratch[spare + 3 * size :]
    zeros = 0
    for row in range(0, rows, group):
        together = min(group, rows - row)
        for first in range(0, decided, tile):
            m = min(tile, decided - first)
            length = m + horizon if parts else together * stride
            for i in range(n_ops):
                now = program[i * WIDTH : (i + 1) * WIDTH]
                op, a, b = now[0], now[4], now[5]
                count = length - now[6] if open_ else length  # values of the operands
                value = scratch[now[1] * size : now[1] * size + count]
                if op == OP_ATOM:
                    for r in range(together):
                        known = value[r * stride : r * stride + (m + horizon if parts else steps)]
                        if limit > 0 and not _checked(now, columns, row + r, first, len(known), limit):
                            return -1
                        _atom(now, numbers[2 * i : 2 * i + 2], columns, row + r, first, known, sides, size, truth)
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
                elif op == OP_UNTIL:
                    if not open_:
                        _fill(x, together, stride, steps, hold, least)
                        _fill(y, together, stride, steps, hold, least)
                    _until(x, y, a, b - a + 1, value[: count - b], one, other, third, fourth)
                else:
                    some = op == OP_EVENTUALLY
                    if not open_:
                        _fill(x, together, stride, steps, hold, least if some else greatest)
                    if not open_ and b == steps:
                        for r in range(together):
                            _suffixes(
                                x[r * stride + a : (r + 1) * stride], some, value[r * stride : (r + 1) * stride - a]
                            )
                    else:
                        _window(x[a:], b - a + 1, some, value[: count - b], one, other)
            for r in range(together):
                result = scratch[last[1] * size + r * stride : last[1] * size + r * stride + m]
                begin = at + (row + r) * wide + first
                target = out[begin : begin + m]
                for i in range(m):
                    target[i] = result[i]
                if len(above) > 0:
                    signs = above[begin : begin + m]
                    for i in range(m):
                        signs[i] = result[i] > 0
                        zeros += result[i] == 0
    return zeros
