"""Comparisons on their border, decided in vectors: exact, with whole numbers modulo 2⁶⁴.

A sample is here if its two sides, in doubles, are no farther apart than their error E (comparisons.py). Every value is
the decimal m / 10^k that it prints as. Sums, differences, products and powers of such are again whole numbers over a
power of ten, and so is the difference of the sides, D / 10^K. D is known modulo 2⁶⁴ by the wrapping arithmetic of
64-bit integers, however large the terms are, and |D| ≤ 2E·10^K; so where that is below 2⁶³ it is D. Where it is not,
as in squares of computed doubles, of 16 and 17 digits, the same is done modulo 2¹²⁸ (kernels/wide.py).

    the sides      without roots       left − right = D / 10^K
                   √A and B > 0        A − B² = D / 10^K has the sign of √A − B = D / (10^K (√A + B))

min, max and abs choose by the doubles, or in the same way where these are too near. What is left over (divisions,
other powers and roots, products of more than three numbers of many digits) is told, and judged one by one.

Many samples of a comparison that does not choose are judged by a kernel, near the border or not (`judged`). `_Exact`
does the same in numpy, but modulo 2⁶⁴ only.

The margin is the nearest double of the quotient: D, 10^K and the quotient are taken as sums of two doubles. It is left
over where it is too near to half-way between two doubles.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Arithmetic, Call, Comparator, Comparison, Negate, Number, Term, Variable
from stltool.monitoring.doubles import PLACES, bounded, short_decimals
from stltool.numbers import shortest

Floats: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Words: TypeAlias = "NDArray[np.uint64] | np.uint64"
Places: TypeAlias = "NDArray[np.int64] | np.int64"
Whole: TypeAlias = tuple[Words, Places]  # m modulo 2⁶⁴, and k
Pair: TypeAlias = tuple[Floats, Floats]  # the sum of two doubles

_MOST_PLACES = 76
_PLACES_OF_CONSTANTS = 44
_LARGEST_POWER = 8
_TURNED: dict[Comparator, Comparator] = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
COMPILED_FROM = 2000  # samples; for fewer, printing each is quicker than loading a compiled kernel
_MANY = 1 << 27
_seen = 0  # samples that this process has judged in numpy
_ROOM = 2.0**63 * (1 - 2.0**-20)
_BELOW = 2.0**63 - 1024  # the double before 2⁶³
_TENS = np.array([pow(10, k, 1 << 64) for k in range(_MOST_PLACES + 1)], dtype=np.uint64)
_TENS_HIGH = np.array([float(10**k) for k in range(_MOST_PLACES + 1)])
_EXACT_TENS = _TENS_HIGH[:23]
_TENS_LOW = np.array([float(10**k - int(high)) for k, high in enumerate(_TENS_HIGH)])


def possible(node: Comparison) -> bool:
    """Whether the comparison's terms are of the kinds decided here."""
    root, side = _sides(node)
    return _is_polynomial(root.args[0] if isinstance(root, Call) else node.left) and _is_polynomial(side)


def differences(
    node: Comparison, columns: Mapping[str, Floats], apart: Floats
) -> tuple[NDArray[np.int8], Floats, Mask]:
    """Sign and nearest double of left − right for samples (n,), and a mask of those that are settled.

    `apart` bounds |left − right| of each. To be called under `np.errstate(all="ignore")`, for a `possible` comparison.
    """
    root, side = _sides(node)
    exact = _Exact(columns)
    if root is None:
        whole, places = exact.difference(exact.whole(node.left), exact.whole(node.right), apart)
        margin = exact.quotient(whole, places)
        return np.sign(whole).astype(np.int8), margin, exact.settled
    inside, other = exact.whole(root.args[0]), exact.whole(side)
    b, error = bounded(side, columns)
    exact.settled &= b > 2 * error
    whole, places = exact.difference(inside, _times(other, other), apart * (2 * np.abs(b) + 2 * error + apart))
    margin = exact.over_sum(whole, places, other, np.asarray(b))
    sign = np.sign(whole).astype(np.int8)
    return (sign, margin, exact.settled) if root is node.left else (-sign, 0.0 - margin, exact.settled)


def in_kernel(node: Comparison) -> bool:
    """Whether `judged` takes a `possible` comparison: none that chooses."""
    root, side = _sides(node)
    return not _chooses(side) and not _chooses(root.args[0] if root is not None else node.left)


def worthwhile(samples: int) -> bool:
    """Whether so many samples are to be judged by the kernel, near the border or not.

    Compiling it, once for all processes, takes as long as judging some hundred million samples in numpy. So a process
    does that until it has loaded the kernel for samples on a border, or has judged that many.
    """
    global _seen
    if samples < COMPILED_FROM:
        return False
    _seen += samples
    return "stltool.kernels.borders" in sys.modules or _seen > _MANY


def judged(node: Comparison, columns: Mapping[str, Floats], truth: Mask | None, margin: Floats | None) -> Mask | None:
    """Write truth and margin of a comparison to arrays like the columns; a mask of samples that are left over, if any.

    By one kernel: samples that are not near the border, too. What it finds is the same, bit for bit.
    """
    from stltool.kernels import borders as k
    from stltool.monitoring.stream import COMPARATORS

    arrays = [np.ascontiguousarray(values) for values in columns.values()]
    shape, n = arrays[0].shape, arrays[0].size
    root, side = _sides(node)
    code = _Code(list(columns))
    inside, other = code.register(root.args[0] if root is not None else node.left), code.register(side)
    op = COMPARATORS[node.op if root is None or root is node.left else _TURNED[node.op]]
    truths = _room(truth, shape, np.bool_)
    margins = _room(margin, shape, np.float64)
    left_over = np.zeros(shape, np.bool_)
    tiles = (2 * code.registers + k.SPARE) * k.TILE
    count = k.judge(
        np.array([values.ctypes.data for values in arrays]), n, np.array(PLACES), np.array(code.rows, np.int64).ravel(),
        np.array(code.numbers), inside, other, root is not None, op, code.narrow,
        truths.view(np.uint8).reshape(-1), margins.reshape(-1), left_over.view(np.uint8).reshape(-1), np.empty(tiles),
        np.empty(tiles + 3 * code.registers, np.int64), np.empty(2 * code.registers, np.uint64),
    )  # fmt: skip
    for out, found in ((truth, truths), (margin, margins)):
        if out is not None and found is not out:
            out[...] = found
    return left_over if count else None


def _room(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """An array that lies together for what is asked for, or nothing."""
    return out if out is not None and out.flags.c_contiguous else np.empty(0 if out is None else shape, dtype)


class _Code:
    """The operations of kernels/wide.py for some terms."""

    def __init__(self, names: Sequence[str]) -> None:
        from stltool.kernels import wide

        self._k = wide
        self._names = names
        self.rows: list[list[int]] = []
        self.numbers: list[float] = []
        self.narrow = True  # constants are below 2⁶³, and not only known modulo 2⁶⁴

    @property
    def registers(self) -> int:
        return len(self._names) + len(self.rows)

    def register(self, term: Term) -> int:
        """Where the value of a term is after the operations so far, and those that it adds."""
        match term:
            case Variable(name):
                return self._names.index(name)
            case Number(value):
                constant = _constant(value)
                assert constant is not None
                m, places = int(constant[0].view(np.int64)), int(constant[1])
                self.narrow &= m == shortest(value) * 10**places
                return self._add(self._k.CONSTANT, m, places, value)
            case Negate(arg):
                return self._add(self._k.NEGATED, self.register(arg), 0)
            case Arithmetic("^", left, Number(power)):
                base = result = self.register(left)
                for _ in range(int(power) - 1):
                    result = self._add(self._k.PRODUCT, result, base)
                return result
            case Arithmetic(op, left, right):
                kind = {"*": self._k.PRODUCT, "+": self._k.SUM, "-": self._k.DIFFERENCE}[op]
                return self._add(kind, self.register(left), self.register(right))
            case _:
                raise AssertionError(term)

    def _add(self, kind: int, a: int, b: int, number: float = 0.0) -> int:
        self.rows.append([kind, self.registers, a, b])
        self.numbers.append(number)
        return self.registers - 1


def _chooses(term: Term) -> bool:
    """Whether there is a min, max or abs in a polynomial."""
    match term:
        case Call():
            return True
        case Negate(arg):
            return _chooses(arg)
        case Arithmetic(_, left, right):
            return _chooses(left) or _chooses(right)
        case _:
            return False


def _sides(node: Comparison) -> tuple[Call | None, Term]:
    """The side that is a root, if there is one, and the other."""
    for side, other in ((node.left, node.right), (node.right, node.left)):
        if isinstance(side, Call) and side.function == "sqrt":
            return side, other
    return None, node.right


def _is_polynomial(term: Term) -> bool:
    match term:
        case Variable():
            return True
        case Number(value):
            return _constant(value) is not None
        case Negate(arg):
            return _is_polynomial(arg)
        case Arithmetic("^", left, Number(power)):
            return power in range(1, _LARGEST_POWER + 1) and _is_polynomial(left)
        case Arithmetic(op, left, right):
            return op in "+-*" and _is_polynomial(left) and _is_polynomial(right)
        case Call(function, args):
            return function != "sqrt" and all(map(_is_polynomial, args))


def _constant(value: float) -> Whole | None:
    """m modulo 2⁶⁴ and k of a finite double; None if it has too many places."""
    decimal = shortest(value)
    for k in range(_PLACES_OF_CONSTANTS + 1):
        if 10**k % decimal.denominator == 0:
            return np.uint64(int(decimal * 10**k) % (1 << 64)), np.int64(k)
    return None


def _times(a: Whole, b: Whole) -> Whole:
    return a[0] * b[0], a[1] + b[1]


class _Exact:
    """Terms of n samples as whole numbers; `settled` becomes false where something remains open."""

    def __init__(self, columns: Mapping[str, Floats]) -> None:
        self._columns = columns
        self.settled = np.ones(len(next(iter(columns.values()))), dtype=np.bool_)
        self._given = {name: self._column(values) for name, values in columns.items()}

    def _column(self, values: Floats) -> Whole:
        if (short := short_decimals(values)) is not None:
            return short[0].view(np.uint64), np.int64(short[1])
        if len(values) < COMPILED_FROM:
            found = [_constant(value) if np.isfinite(value) else None for value in values.tolist()]
            words = np.array([0 if one is None else one[0] for one in found], dtype=np.uint64)
            places = np.array([-1 if one is None else one[1] for one in found], dtype=np.int64)
        else:
            from stltool.kernels.decimals import decimals

            whole, places = np.empty(len(values), np.int64), np.empty(len(values), np.int64)
            decimals(np.ascontiguousarray(values), whole, places)
            words = whole.view(np.uint64)
        self.settled &= places >= 0
        return words, np.maximum(places, 0)

    def whole(self, term: Term) -> Whole:
        match term:
            case Variable(name):
                return self._given[name]
            case Number(value):
                constant = _constant(value)
                assert constant is not None
                return constant
            case Negate(arg):
                words, places = self.whole(arg)
                return np.uint64(0) - words, places
            case Arithmetic("^", left, Number(power)):
                base = self.whole(left)
                result = base
                for _ in range(int(power) - 1):
                    result = _times(result, base)
                return result
            case Arithmetic("*", left, right):
                return _times(self.whole(left), self.whole(right))
            case Arithmetic(op, left, right):
                a, b, places = self._aligned(self.whole(left), self.whole(right))
                return (a + b if op == "+" else a - b), places
            case Call("abs", (arg,)):
                return self._larger(arg, Negate(arg))
            case Call(function, (first, *rest)):  # min and max have two arguments at least
                others = Call(function, tuple(rest)) if len(rest) > 1 else rest[0]
                if function == "max":
                    return self._larger(first, others)
                words, places = self._larger(Negate(first), Negate(others))
                return np.uint64(0) - words, places
            case _:
                raise AssertionError(term)

    def _larger(self, left: Term, right: Term) -> Whole:
        """The larger term."""
        a, b, places = self._aligned(self.whole(left), self.whole(right))
        (x, ex), (y, ey) = bounded(left, self._columns), bounded(right, self._columns)
        apart, error = np.abs(x - y), 2 * (ex + ey)
        near = ~(apart > error)
        room = (apart + error) * _TENS_HIGH[np.minimum(places, _MOST_PLACES)]
        self.settled &= ~near | (room < _ROOM)
        return np.where(np.where(near, (a - b).view(np.int64) > 0, x > y), a, b), places

    def _aligned(self, a: Whole, b: Whole) -> tuple[Words, Words, Places]:
        """Both over the same power of ten."""
        places = np.maximum(a[1], b[1])
        up, down = (_TENS[np.minimum(places - its[1], _MOST_PLACES)] for its in (a, b))
        return a[0] * up, b[0] * down, places

    def difference(self, a: Whole, b: Whole, apart: Floats) -> tuple[NDArray[np.int64], Places]:
        """D and K of a − b, where it is less than `apart`."""
        left, right, places = self._aligned(a, b)
        self.settled &= (places <= _MOST_PLACES) & (apart * _TENS_HIGH[np.minimum(places, _MOST_PLACES)] < _ROOM)
        words = np.broadcast_to(left - right, self.settled.shape)
        return words.view(np.int64), np.minimum(places, _MOST_PLACES)

    def quotient(self, whole: NDArray[np.int64], places: Places) -> Floats:
        """The nearest double of the quotient by 10^places."""
        if places.max() < len(_EXACT_TENS) and max(-whole.min(), whole.max()) < 2**53:
            near: Floats = whole.astype(np.float64) / _EXACT_TENS[places]
            return near
        return self._rounded(_divided(_pair(whole), (_TENS_HIGH[places], _TENS_LOW[places])), 2.0**-95)

    def over_sum(self, whole: NDArray[np.int64], places: Places, other: Whole, b: Floats) -> Floats:
        """The nearest double of δ = D / (10^K (√A + B)), where D / 10^K = A − B²: √A + B is 2B + δ."""
        difference = _divided(_pair(whole), (_TENS_HIGH[places], _TENS_LOW[places]))
        tens = np.minimum(other[1], _MOST_PLACES)  # with more places, B² has, too: unsettled by `difference`
        high, low = _divided(_pair(other[0].view(np.int64)), (_TENS_HIGH[tens], _TENS_LOW[tens]))
        rough = difference[0] / (2 * high)
        # B itself is needed, not B modulo 2⁶⁴; and √A + B must be known well enough with the rough δ
        self.settled &= (np.abs(high - b) <= 1e-9 * b) & (np.abs(rough) < 2.0**-45 * b)
        return self._rounded(_divided(difference, _sum(2 * high, rough, 2 * low)), 2.0**-85)

    def _rounded(self, quotient: Pair, relative: float) -> Floats:
        high, low = quotient
        room = relative * np.abs(high)
        result = high + (low - room)
        self.settled &= result == high + (low + room)
        return result + 0.0


# ------------------------------------------------------------------------- sums of two doubles [Dekker71]


def _pair(whole: NDArray[np.int64] | np.int64) -> Pair:
    """Of whole numbers below 2⁶³, exactly."""
    whole = np.asarray(whole)
    high = np.minimum(whole.astype(np.float64), _BELOW)
    return high, (whole - high.astype(np.int64)).astype(np.float64)


def _sum(a: Floats, b: Floats, rest: Floats) -> Pair:
    total = a + b
    part = total - a
    return total, ((a - (total - part)) + (b - part)) + rest


def _split(a: Floats) -> Pair:
    c = 134217729.0 * a
    high = c - (c - a)
    return high, a - high


def _divided(a: Pair, b: Pair) -> Pair:
    """a / b, to some 2⁻¹⁰⁰ of it."""
    first = a[0] / b[0]
    product = first * b[0]
    (f, g), (h, i) = _split(first), _split(b[0])
    error = ((f * h - product) + f * i + g * h) + g * i
    rest = ((a[0] - product) - error) + (a[1] - first * b[1])
    return first, rest / b[0]
