"""One sample of a running trace: what an online monitor computes. Its whole state is three arrays: N, F and B.

N (integers) begins with a header: the clock, sizes, and where each table begins; F holds doubles, B sets of steps, 64
to a word. monitoring/stream.py lays them out. `advance` reads one sample. It refuses it, leaving all as it was, or

    1. evaluates the comparisons without arithmetic (the others are judged by the caller, who hands in the results);
    2. with WAITS, runs the network: at time n a node of horizon h computes its margin at step n − h. Windows are
       monotone queues, for until and since two stacks over an associative ∘ [Tangwongsan15, §2]: O(1) amortised;
    3. runs the engine that decides steps early (monitoring/early.py): an automaton whose starts coalesce, an automaton
       with one state per open step, or three-valued truth over sets of steps.

Times count the samples since the arrays were made; N[BASE] is the step of the first.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

from stltool.kernels import jit
from stltool.kernels.told import FULL, NOTHING, REFUSED, SEVERAL

I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]
U64: TypeAlias = NDArray[np.uint64]

# the header of N: numbers
TIME, BASE, ROOM, HORIZON, BACK, RESULT, WAITS, ENGINE, TOLD, START, ACTIVE, SLOTS = range(12)
# sizes of tables
N_NAMES, N_ATOMS, N_NODES, N_KEPT, N_STARTS, N_LEAVES, N_STATES, N_OPS, N_WORDS, N_LANES = range(12, 22)
# where tables begin: in N
NAMES, ATOMS, TRUTH, NODES, COUNTERS, MARK, VERDICT, TOLD_NOW = range(22, 30)
LETTER, LEAVES, DELTA, FIRST, OUTCOME, LISTS, FOLLOWING, CLOSED, OPEN_STATES, PROGRAM = range(30, 40)
# in F, in B
VALUES, NUMBERS, GIVEN, MARGIN, RING, KEPT, KNOWN, LANES = range(40, 48)
STARTS, BEGINS, LAST = range(48, 51)  # in N
HEADER = 51
ROOT = 7  # length of the table of addresses

COALESCED, EACH, STRUCTURE = range(3)  # engines
ATOM_WIDTH = 6  # an atom: kind, comparator or name, left name or −1, its sign, right name, its sign
FIXED, GIVEN_ATOM, LABEL, PLAIN = range(4)
GREATER, GREATER_EQUAL, LESS, LESS_EQUAL, EQUAL, UNEQUAL = range(6)
# a node: op, register, operands, time of its first push, of its first value, width, start and length of its ring
NODE_WIDTH = 9
NOT, AND, OR, IFF, DELAY, GREATEST, LEAST, UNTIL, SINCE = range(9)
# an instruction: op, operands, a, b, its truth beyond the trace, lower and upper
OP_WIDTH = 7
OP_ATOM, OP_NOT, OP_AND, OP_OR, OP_IFF, OP_EVENTUALLY, OP_ALWAYS, OP_UNTIL, OP_ONCE, OP_HISTORICALLY, OP_SINCE = range(
    11
)
LIST_ROWS = 6

OPEN, SAME = 0, 3  # in VERDICT, beside 1 and 2 for false and true: SAME as of the step before

part = functools.partial(jit.part, counts=False)
kernel = functools.partial(jit.kernel, counts=False)
entry = functools.partial(jit.kernel, counts=False, lock=True)
_ZERO, _ONE, _ALL = np.uint64(0), np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)


# ------------------------------------------------------------------------------------------------------------ atoms


@part
def _side(N: I64, F: F64, at: int, number: int) -> Any:
    name = N[at]
    if name < 0:
        return F[number]
    x = F[N[VALUES] + name]
    return x if N[at + 1] > 0 else -x


@part
def evaluate(N: I64, F: F64) -> bool:
    """Margins and truths of the atoms; whether all samples and margins are finite numbers."""
    for i in range(N[N_NAMES]):
        x = F[N[VALUES] + i]
        if not np.isfinite(x) or (N[N[NAMES] + i] == 1 and x != 0.0 and x != 1.0):
            return False
    for i in range(N[N_ATOMS]):
        at = N[ATOMS] + ATOM_WIDTH * i
        kind, which = N[at], N[at + 1]
        if kind == LABEL:
            true = F[N[VALUES] + which] != 0.0
            margin = np.inf if true else -np.inf
        elif kind == PLAIN:
            left, right = _side(N, F, at + 2, N[NUMBERS] + 2 * i), _side(N, F, at + 4, N[NUMBERS] + 2 * i + 1)
            margin = left - right
            if which == GREATER:
                true = left > right
            elif which == GREATER_EQUAL:
                true = left >= right
            elif which == LESS:
                true, margin = left < right, right - left
            elif which == LESS_EQUAL:
                true, margin = left <= right, right - left
            elif which == EQUAL:
                true, margin = left == right, 0.0 - abs(margin)
            else:
                true, margin = left != right, abs(margin)
            margin += 0.0
            if not np.isfinite(margin):
                return False
        else:
            margin, true = F[N[GIVEN] + 2 * i], F[N[GIVEN] + 2 * i + 1] != 0.0
        F[N[MARGIN] + i] = margin
        N[N[TRUTH] + i] = 1 if true else 0
    return True


# ---------------------------------------------------------------------------------------------------------- network


@part
def _push_window(N: I64, F: F64, node: int, count: int, greatest: bool) -> None:
    """Push a value onto the monotone queue of a node."""
    width, ring, mask = N[node + 6], N[RING] + N[node + 7], N[node + 8] - 1
    mark, x = N[MARK] + N[node + 7], F[N[MARGIN] + N[node + 2]]
    head, tail, n = N[count], N[count + 1], N[count + 2]
    if greatest:
        while tail > head and F[ring + ((tail - 1) & mask)] <= x:
            tail -= 1
    else:
        while tail > head and F[ring + ((tail - 1) & mask)] >= x:
            tail -= 1
    F[ring + (tail & mask)] = x
    N[mark + (tail & mask)] = n
    if N[mark + (head & mask)] <= n - width:
        head += 1
    N[count], N[count + 1], N[count + 2] = head, tail + 1, n + 1


@part
def _joined(since: bool, a: float, b: float, c: float, d: float) -> Any:
    """The right part of (a, b) ∘ (c, d), the first being older."""
    return max(d, min(b, c)) if since else max(b, min(a, d))


@part
def _push_pair(N: I64, F: F64, node: int, count: int, since: bool) -> None:
    """Push a pair onto the two stacks of a node: the older one of aggregates, the newer one of pairs."""
    width, old = N[node + 6], N[RING] + N[node + 7]
    total, young = old + 2 * width, old + 2 * width + 2
    left, right = F[N[MARGIN] + N[node + 2]], F[N[MARGIN] + N[node + 3]]
    older, newer = N[count], N[count + 1]
    if older + newer == width:
        if older == 0:
            for k in range(newer - 1, -1, -1):
                a, b = F[young + 2 * k], F[young + 2 * k + 1]
                if older > 0:
                    c, d = F[old + 2 * older - 2], F[old + 2 * older - 1]
                    a, b = min(a, c), _joined(since, a, b, c, d)
                F[old + 2 * older], F[old + 2 * older + 1] = a, b
                older += 1
            newer = 0
        older -= 1  # the oldest leaves
    F[young + 2 * newer], F[young + 2 * newer + 1] = left, right
    if newer > 0:
        a, b = F[total], F[total + 1]
        left, right = min(a, left), _joined(since, a, b, left, right)
    F[total], F[total + 1] = left, right
    N[count], N[count + 1] = older, newer + 1


@part
def _pair_value(N: I64, F: F64, node: int, count: int, since: bool) -> Any:
    """The right part of the aggregate of a node's pairs; −∞ if there are none."""
    width, old = N[node + 6], N[RING] + N[node + 7]
    older, newer = N[count], N[count + 1]
    if newer == 0:
        return -np.inf
    c, d = F[old + 2 * width], F[old + 2 * width + 1]
    if older == 0:
        return d
    return _joined(since, F[old + 2 * older - 2], F[old + 2 * older - 1], c, d)


@part
def run_network(N: I64, F: F64) -> None:
    """The margins of all nodes that have one at this time."""
    time, margin = N[TIME], N[MARGIN]
    for i in range(N[N_NODES]):
        node, count = N[NODES] + NODE_WIDTH * i, N[COUNTERS] + 3 * i
        op, out = N[node], margin + N[node + 1]
        pushes, shows = time >= N[node + 4], time >= N[node + 5]
        if op in (GREATEST, LEAST):
            if pushes:
                _push_window(N, F, node, count, op == GREATEST)
            if shows:
                head = N[count]
                if head < N[count + 1]:
                    F[out] = F[N[RING] + N[node + 7] + (head & (N[node + 8] - 1))]
                else:
                    F[out] = -np.inf if op == GREATEST else np.inf
        elif op in (UNTIL, SINCE):
            if pushes:
                _push_pair(N, F, node, count, op == SINCE)
            if shows:
                F[out] = _pair_value(N, F, node, count, op == SINCE)
        elif op == DELAY:
            if pushes:
                ring, mask, n = N[RING] + N[node + 7], N[node + 8] - 1, N[count]
                F[ring + (n & mask)] = F[margin + N[node + 2]]
                N[count] = n + 1
                if shows:
                    F[out] = F[ring + ((n - N[node + 6]) & mask)]
        elif shows:
            x, y = F[margin + N[node + 2]], F[margin + N[node + 3]]
            if op == NOT:
                F[out] = 0.0 - x
            elif op == AND:
                F[out] = min(x, y)
            elif op == OR:
                F[out] = max(x, y)
            elif op == IFF:
                F[out] = min(max(0.0 - x, y), max(x, 0.0 - y))


# ---------------------------------------------------------------------------------------------------------- engines


@part
def _decide(N: I64, t: int, value: int, told: int) -> int:
    """Note the verdict of the step at time t, 1 or 2 for false or true; returns the number of runs told now."""
    N[N[VERDICT] + (t & (N[SLOTS] - 1))] = value
    if N[WAITS] != 0:
        return told
    at, code = N[TOLD_NOW] + 2 * told, _code(N, t, value)
    if told > 0 and N[at - 2] + (N[at - 1] << 3) == code:
        N[at - 1] += 1
        return told
    N[at], N[at + 1] = code, 1
    return told + 1


@part
def _code(N: I64, t: int, value: int) -> Any:
    """A decision as a number: step << 3 | robustness is known << 2 | verdict << 1 | 1."""
    return (N[BASE] + t) << 3 | (4 if N[WAITS] != 0 else 0) | (value - 1) << 1 | 1


@part
def _letter(N: I64) -> Any:
    code = 0
    for i in range(N[N_LEAVES]):
        code |= N[N[TRUTH] + N[N[LEAVES] + i]] << i
    return N[N[LETTER] + code]


@part
def _begin(N: I64, letter: int) -> Any:
    """The state in which the start of this step begins; afterwards, the letter is behind the next one."""
    start = N[START]
    N[START] = N[N[STARTS] + letter * N[N_STARTS] + start]
    return N[N[BEGINS] + start]


@part
def _append(N: I64, tail: int, x: int) -> int:
    """Append the run that begins at x to the one that begins at `tail`; returns where the last one then begins."""
    mask = N[SLOTS] - 1
    at = tail & mask
    if N[N[LAST] + at] + 1 != x:
        N[N[FOLLOWING] + at] = x
        return x
    N[N[LAST] + at], N[N[FOLLOWING] + at] = N[N[LAST] + (x & mask)], N[N[FOLLOWING] + (x & mask)]
    N[N[VERDICT] + (x & mask)] = SAME
    return tail


@part
def run_coalesced(N: I64, told: int) -> int:
    """Lists of starts by state, the oldest first, in runs of neighbours: FOLLOWING has where the next run begins, LAST
    where this one ends.

    Two starts in one state stay together, and as a state is decided from some clock on, only the head of a list can be
    decided: a sample costs as much as there are states with starts, amortised. A run is decided, and told, as a whole.
    """
    time, mask, n, wide = N[TIME], N[SLOTS] - 1, N[ACTIVE], N[N_STATES] + 1
    letter = _letter(N)
    row, after, lasts = N[DELTA] + letter * N[N_STATES], N[FOLLOWING], N[LAST]
    first, outcome, verdicts = N[FIRST], N[OUTCOME], N[VERDICT]
    head, tail, active = N[LISTS], N[LISTS] + wide, N[LISTS] + 2 * wide
    to_head, to_tail, to_active = head + 3 * wide, tail + 3 * wide, active + 3 * wide
    q = _begin(N, letter)
    N[after + (time & mask)], N[lasts + (time & mask)] = -1, time
    if N[head + q] < 0:
        N[active + n], N[head + q], N[tail + q] = q, time, time
        n += 1
    else:
        N[tail + q] = _append(N, N[tail + q], time)
    m = 0
    for i in range(n):
        q = N[active + i]
        x, end, to = N[head + q], N[tail + q], N[row + q]
        N[head + q] = -1
        newest, value = time - N[first + to], N[outcome + to]
        while 0 <= x <= newest:
            last, following = N[lasts + (x & mask)], N[after + (x & mask)]
            N[verdicts + (x & mask)] = value
            if N[WAITS] == 0:
                at = N[TOLD_NOW] + 2 * told
                N[at], N[at + 1] = _code(N, x, value), min(last, newest) - x + 1
                told += 1
            if last > newest:  # the rest is a run of its own
                N[after + ((newest + 1) & mask)], N[lasts + ((newest + 1) & mask)] = following, last
                N[verdicts + ((newest + 1) & mask)] = OPEN
                following, end = newest + 1, newest + 1 if end == x else end
            x = following
        if x < 0:
            continue
        y, y_end = N[to_head + to], N[to_tail + to]
        if y < 0:
            N[to_active + m], N[to_head + to], N[to_tail + to] = to, x, end
            m += 1
            continue
        if x > N[lasts + (y_end & mask)]:  # all of the other list are older
            left = y_end
        elif y > N[lasts + (end & mask)]:
            N[to_head + to] = x
            left, x, end = end, y, y_end
        else:  # they interleave
            left = np.int64(-1)
            while x >= 0 and y >= 0:
                if x > y:
                    x, y, end, y_end = y, x, y_end, end
                following = N[after + (x & mask)]
                if left < 0:
                    N[to_head + to] = left = x
                else:
                    left = _append(N, left, x)
                x = following
            if x < 0:
                x, end = y, y_end
        now = _append(N, left, x)
        N[to_tail + to] = now if end == x else end
    for i in range(m):
        q = N[to_active + i]
        N[active + i], N[head + q], N[tail + q] = q, N[to_head + q], N[to_tail + q]
        N[to_head + q] = -1
    N[ACTIVE] = m
    return told


@part
def run_each(N: I64, told: int) -> int:
    """A state for every open step: for automata with a state that is decided at some clock and open at a later one."""
    time, mask = N[TIME], N[SLOTS] - 1
    letter = _letter(N)
    row = N[DELTA] + letter * N[N_STATES]
    N[N[OPEN_STATES] + (time & mask)] = _begin(N, letter)
    for age in range(min(time, N[HORIZON]), -1, -1):
        slot = N[OPEN_STATES] + ((time - age) & mask)
        if N[slot] >= 0:
            q = N[row + N[slot]]
            value = N[N[CLOSED] + age * N[N_STATES] + q]
            N[slot] = q if value == 0 else -1
            if value != 0:
                told = _decide(N, time - age, value, told)
    return told


@part
def shift(B: U64, source: int, out: int, steps: int, n: int, fill: Any, back: bool) -> None:
    """B[out](t) = B[source](t + steps), with `back` of t − steps, for n words; `fill` beyond the ends. In place if
    they are the same."""
    words, bits = steps >> 6, np.uint64(steps & 63)
    rest = np.uint64(64) - bits
    if back:
        for k in range(n - 1, -1, -1):
            x = B[source + k - words] if k >= words else fill
            if bits != _ZERO:
                x = (x << bits) | ((B[source + k - words - 1] if k > words else fill) >> rest)
            B[out + k] = x
    else:
        for k in range(n):
            x = B[source + k + words] if k + words < n else fill
            if bits != _ZERO:
                x = (x >> bits) | ((B[source + k + words + 1] if k + words + 1 < n else fill) << rest)
            B[out + k] = x


@part
def gather(
    B: U64, source: int, out: int, spare: int, a: int, width: int, n: int, fill: Any, back: bool, some: bool
) -> None:
    """B[out](t): whether B[source] holds at some (else: at every) step of t+a … t+a+width−1, or of its mirror image."""
    shift(B, source, out, a, n, fill, back)
    span = 1
    while span < width:
        step = min(span, width - span)
        shift(B, out, spare, step, n, fill, back)
        for k in range(n):
            B[out + k] = B[out + k] | B[spare + k] if some else B[out + k] & B[spare + k]
        span += step


@part
def gather_until(
    B: U64, left: int, right: int, out: int, held: int, more: int, before: int, a: int, width: int, n: int,
    left_fill: Any, right_fill: Any, back: bool,
) -> None:  # fmt: skip
    """B[out](t): φ U[a,a+width−1] ψ, with `back` φ since[a,a+width−1] ψ, of B[left] and B[right]."""
    first = 0 if back else a
    shift(B, left, held, first, n, left_fill, back)
    shift(B, right, out, first, n, right_fill, back)
    span = 1
    while span < width:
        step = min(span, width - span)
        shift(B, out, more, step, n, right_fill, back)
        for k in range(n):
            B[out + k] |= B[held + k] & B[more + k]
        shift(B, held, more, step, n, left_fill, back)
        for k in range(n):
            B[held + k] &= B[more + k]
        span += step
    if a > 0:
        if back:
            shift(B, out, out, a, n, _ZERO, back)
        gather(B, left, before, more, 0, a, n, left_fill, back, False)
        for k in range(n):
            B[out + k] &= B[before + k]


@part
def run_structure(N: I64, B: U64, told: int) -> int:
    """Three-valued truth [Kleene38] of every node at every open step: a lower and an upper lane of bits.

    Windows of the future end in what their operand is beyond the trace, if nothing looks back. Else lanes extend by a
    horizon, as far as an operator of the past can know something.
    """
    time, size, horizon, wide = N[TIME], N[N_WORDS], N[HORIZON], N[N_LANES]
    now, bit = N[KNOWN] + ((time >> 6) & (size - 1)), np.uint64(time & 63)
    for i in range(N[N_ATOMS] + 1):
        if time & 63 == 0:
            B[now + i * size] = _ZERO
        if i < N[N_ATOMS] and N[N[TRUTH] + i] != 0:
            B[now + i * size] |= _ONE << bit
    ops, lanes = N[N_OPS], N[LANES]
    spare = lanes + 2 * ops * wide
    start = max(0, time - horizon - N[BACK]) >> 6
    n, last = ((time + (horizon if N[BACK] > 0 else 0)) >> 6) - start + 1, (time >> 6) - start
    unread = _ALL << bit << _ONE  # steps after this one in the last word
    for i in range(ops):
        at = N[PROGRAM] + OP_WIDTH * i
        op, a, b = N[at], N[at + 3], N[at + 4]
        lower, upper = lanes + 2 * i * wide, lanes + (2 * i + 1) * wide
        x, y = lanes + 2 * N[at + 1] * wide, lanes + 2 * N[at + 2] * wide
        if op == OP_ATOM:
            row = N[KNOWN] + N[at + 1] * size
            for k in range(n):
                known = B[row + ((start + k) & (size - 1))] if k <= last else _ZERO
                ahead = _ZERO if k < last else (unread if k == last else _ALL)
                B[lower + k] = known | ahead if N[at + 5] == 1 else known
                B[upper + k] = known if N[at + 6] == 0 else known | ahead
        elif op == OP_NOT:
            for k in range(n):
                B[lower + k], B[upper + k] = ~B[x + wide + k], ~B[x + k]
        elif op <= OP_IFF:
            for k in range(n):
                p, q, r, s = B[x + k], B[x + wide + k], B[y + k], B[y + wide + k]
                if op == OP_AND:
                    B[lower + k], B[upper + k] = p & r, q & s
                elif op == OP_OR:
                    B[lower + k], B[upper + k] = p | r, q | s
                else:
                    B[lower + k], B[upper + k] = (~q | r) & (p | ~s), (~p | s) & (q | ~r)
        else:
            # windows that reach what is beyond the lanes may end there
            back, begin, width = op >= OP_ONCE, min(a, 64 * n), min(b - a + 1, 64 * n + 1)
            for lane in range(2):
                skip = lane * wide
                beyond = _ALL if N[N[PROGRAM] + OP_WIDTH * N[at + 1] + 5 + lane] == 1 else _ZERO
                if op in (OP_UNTIL, OP_SINCE):
                    right = _ALL if N[N[PROGRAM] + OP_WIDTH * N[at + 2] + 5 + lane] == 1 else _ZERO
                    if back:
                        beyond, right = _ALL, _ZERO
                    gather_until(
                        B, x + skip, y + skip, lower + skip, spare, spare + wide, spare + 2 * wide, begin, width, n,
                        beyond, right, back,
                    )  # fmt: skip
                else:
                    some = op in (OP_EVENTUALLY, OP_ONCE)
                    if back:
                        beyond = _ZERO if some else _ALL
                    gather(B, x + skip, lower + skip, spare, begin, width, n, beyond, back, some)
    lower = lanes + 2 * (ops - 1) * wide
    first = max(0, time - horizon)
    told_row = N[KNOWN] + N[N_ATOMS] * size
    for k in range((first >> 6) - start, last + 1):
        row = told_row + ((start + k) & (size - 1))
        new = (B[lower + k] | ~B[lower + wide + k]) & ~B[row]
        if k == last:
            new &= ~unread
        if k == (first >> 6) - start:
            new &= _ALL << np.uint64(first & 63)
        B[row] |= new
        t = 64 * (start + k)
        while new != _ZERO:
            if new & _ONE:
                true = (B[lower + k] >> np.uint64(t & 63)) & _ONE != _ZERO
                told = _decide(N, t, 2 if true else 1, told)
            new >>= _ONE
            t += 1
    return told


# ---------------------------------------------------------------------------------------------------------- samples


@part
def advance(N: I64, F: F64, B: U64) -> Any:
    """Read the sample in VALUES (and GIVEN); see the module docstring.

    Returns the code of a single decision (`_code`) or what told.py lists: SEVERAL if TOLD_NOW has N[TOLD] runs of
    decisions, of each the code of its first step and the number of its steps.
    """
    time, horizon = N[TIME], N[HORIZON]
    if time >= N[ROOM]:
        return FULL
    if not evaluate(N, F):
        return REFUSED
    verdict, mask = N[VERDICT], N[SLOTS] - 1
    N[verdict + (time & mask)] = OPEN
    if N[WAITS] != 0:
        run_network(N, F)
    if N[ENGINE] == COALESCED:
        told = run_coalesced(N, 0)
    elif N[ENGINE] == EACH:
        told = run_each(N, 0)
    else:
        told = run_structure(N, B, 0)
    oldest = verdict + ((time - horizon) & mask)  # whose run may begin where the next sample is noted
    if time >= horizon and N[oldest] == SAME:
        N[oldest] = N[verdict + ((time - horizon - 1) & mask)]
    names = N[N_NAMES]
    kept = N[KEPT] + (time & (N[N_KEPT] - 1)) * names
    for i in range(names):
        F[kept + i] = F[N[VALUES] + i]
    code = NOTHING
    if N[WAITS] != 0:
        if time >= horizon:
            code = _code(N, time - horizon, N[oldest])
    elif told == 1 and N[N[TOLD_NOW] + 1] == 1:
        code = N[N[TOLD_NOW]]
    elif told > 0:
        code = SEVERAL
    N[TIME], N[TOLD] = time + 1, told
    return code


@kernel
def advance_all(
    N: I64, F: F64, B: U64, samples: F64, given: F64, which: I64, steps: I64, verdicts: I64, margins: F64
) -> int:
    """Read samples (n, n_names), with margins and truths `given` (n, n_which, 2) of the atoms `which`.

    Writes each decision's step and verdict (0 or 1) to `steps` and `verdicts`, which have room for one for every sample
    and every open step; and to `margins` (n,) the final margin that each sample yields, NaN before there is one.
    Returns the number of decisions; −1 − i if sample i is refused or there is no room for it.
    """
    count = 0
    for i in range(len(samples)):
        for j in range(N[N_NAMES]):
            F[N[VALUES] + j] = samples[i, j]
        for j in range(len(which)):
            at = N[GIVEN] + 2 * which[j]
            F[at], F[at + 1] = given[i, j, 0], given[i, j, 1]
        code = advance(N, F, B)
        if code in (REFUSED, FULL):
            return -1 - i
        if code == SEVERAL:
            for k in range(N[TOLD]):
                code, length = N[N[TOLD_NOW] + 2 * k], N[N[TOLD_NOW] + 2 * k + 1]
                for step in range(code >> 3, (code >> 3) + length):
                    steps[count], verdicts[count] = step, code >> 1 & 1
                    count += 1
        elif code != NOTHING:
            steps[count], verdicts[count] = code >> 3, code >> 1 & 1
            count += 1
        margins[i] = F[N[MARGIN] + N[RESULT]] if N[WAITS] != 0 and N[TIME] > N[HORIZON] else np.nan
    return count


# ---------------------------------------------------------------------------------------- calls with an address
# From Python, arrays cost more to hand over than a sample takes to read; an address is an integer. objects.py
# hands over the sample as well.


def _arrays_of(dtype: Any) -> Any:
    """array(address, length): the array there, which nobody counts references to."""

    @intrinsic
    def array(typing: Any, address: Any, length: Any) -> Any:
        kind = types.Array(dtype, 1, "C")

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            made = context.make_array(kind)(context, builder)
            size = context.get_abi_sizeof(context.get_data_type(dtype))
            data = builder.inttoptr(args[0], made.data.type)
            size = context.get_constant(types.intp, size)
            populate_array(made, data, [args[1]], [size], size, None)
            return made._getvalue()

        return kind(types.int64, types.int64), generate

    return array


_integers, _doubles, _sets = (_arrays_of(dtype) for dtype in (types.int64, types.float64, types.uint64))


@entry
def feed_values(root: int) -> Any:
    """`advance` for the arrays that `root` leads to: the addresses and lengths of N, F and B, and the address at
    which the robustness of the newest step with a final one is left."""
    t = _integers(root, ROOT)
    N = _integers(t[0], t[1])
    F = _doubles(t[2], t[3])
    code = advance(N, F, _sets(t[4], t[5]))
    _doubles(t[6], 1)[0] = F[N[MARGIN] + N[RESULT]]
    return code


def entry_point(function: Any) -> Callable[[int], int]:
    """What calls a compiled function of a root.

    numba's entry point takes half the time of its dispatcher. It is not a public name: without it, the dispatcher.
    """
    signature = (types.int64,)
    function.compile(signature)
    found: Callable[[int], int] = getattr(function.overloads[signature], "entry_point", None) or function
    return found
