"""Numbers built from rationals by + − · / and roots, compared exactly.

A number is kept as the expression that it is. Its sign is that of an enclosure that is refined until it excludes 0, or
until it is narrower than what separates a number of this kind from 0 [Burnikel09]. With the rules (logarithms in the
code)

    E                u(E)                        l(E)
    n/m              |n|                         m
    a ± b            u(a) l(b) + l(a) u(b)       l(a) l(b)
    a · b            u(a) u(b)                   l(a) l(b)
    1 / a            l(a)                        u(a)
    a ^ n            u(a)^n                      l(a)^n
    root of index k  (u(a) l(a)^(k−1))^(1/k)     l(a)

and D(E) the product of the indices of all different roots in E, E is a quotient U/L of algebraic integers of degree at
most D(E), whose conjugates are at most u(E) and l(E): U and L follow from the table (the root of U/L is the root of
U·L^(k−1), over L). If E ≠ 0, the product of U's conjugates is a whole number other than 0, so |E| ≥ u(E)^(1−D) / l(E).
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, Literal, TypeAlias

Exact: TypeAlias = "Fraction | Algebraic"
_Kind: TypeAlias = Literal["+", "*", "1/", "^", "root"]

LARGEST_ROOT = 12  # of an exponent p/q; beyond it, powers are computed in doubles
MOST_BITS = 1 << 18  # to which an enclosure is refined
_FIRST_BITS = 96


class TooCloseError(ArithmeticError):
    """Two numbers agree to `MOST_BITS` bits, and the bound that would make them equal is beyond."""


class Algebraic:
    """A real number; irrational unless roots cancel. It compares, exactly, with its like, Fractions and doubles.

    Operations with a finite double give a double; with an infinite one, what doubles give.
    """

    __slots__ = ("_args", "_index", "_key", "_kind", "_known", "_lower", "_roots", "_upper")

    def __init__(self, kind: _Kind, args: tuple[Exact, ...], index: int = 1) -> None:
        self._kind, self._args, self._index = kind, args, index
        self._known: tuple[int, int, int] | None = None  # the last enclosure, and its bits
        self._key: tuple[Any, ...] = (kind, index, *(arg._key if isinstance(arg, Algebraic) else arg for arg in args))
        self._roots: frozenset[tuple[Any, ...]] = frozenset()
        for arg in args:
            if isinstance(arg, Algebraic):
                self._roots |= arg._roots
        (u, low), *rest = (_sizes(arg) for arg in args)  # log₂ of upper bounds
        match kind:
            case "+":
                ((v, m),) = rest
                u, low = max(u + m, low + v) + 1, low + m
            case "*":
                ((v, m),) = rest
                u, low = u + v, low + m
            case "1/":
                u, low = low, u
            case "^":
                u, low = index * u, index * low
            case "root":
                u = -(-(u + (index - 1) * low) // index)
                self._roots |= {self._key}
        self._upper, self._lower = u, low

    def enclosure(self, bits: int) -> tuple[int, int]:
        """Whole numbers low ≤ x·2^bits ≤ high; they approach one another as bits grow."""
        if self._known is None or self._known[2] < bits:
            self._known = (*self._enclose(bits), bits)
        low, high, known = self._known
        return low >> (known - bits), -(-high >> (known - bits))

    def _enclose(self, bits: int) -> tuple[int, int]:
        index = self._index
        match self._kind:
            case "+":
                (a, b), (c, d) = (_enclosure(arg, bits) for arg in self._args)
                return a + c, b + d
            case "*":
                (a, b), (c, d) = (_enclosure(arg, bits) for arg in self._args)
                products = (a * c, a * d, b * c, b * d)
                return min(products) >> bits, -(-max(products) >> bits)
            case "^":
                a, b = _enclosure(self._args[0], bits)
                ends = (a**index, b**index)
                low = 0 if a < 0 < b and index % 2 == 0 else min(ends)
                return low >> bits * (index - 1), -(-max(ends) >> bits * (index - 1))
            case "1/":
                finer = bits
                while True:
                    a, b = _enclosure(self._args[0], finer)
                    if a > 0 or b < 0:
                        one = 1 << (bits + finer)
                        return one // b, -(-one // a)
                    finer *= 2  # ends: the operand was found not to be 0
            case "root":
                a, b = _enclosure(self._args[0], bits)
                shift = bits * (index - 1)
                return _floor_root(max(a, 0) << shift, index), _floor_root(b << shift, index) + 1

    def sign(self) -> int:
        """-1, 0 or 1. Raises TooCloseError if more than `MOST_BITS` would be needed."""
        degree = math.prod(index for _, index, _ in self._roots)
        bits, apart = _FIRST_BITS, self._lower + (degree - 1) * self._upper
        while True:
            low, high = self.enclosure(bits)
            if low > 0 or high < 0:
                return 1 if low > 0 else -1
            if bits > apart and max(-low, high) < 1 << (bits - apart):
                return 0
            if bits >= MOST_BITS:
                raise TooCloseError(
                    f"terms agree to {MOST_BITS} bits, which does not decide whether they are equal for so many roots "
                    "together; write the comparison with fewer roots"
                )
            bits *= 2

    def __float__(self) -> float:
        """The nearest double. Raises OverflowError beyond their range."""
        if not self.sign():
            return 0.0
        bits = _FIRST_BITS
        while True:
            ends = [Fraction(end, 1 << bits) for end in self.enclosure(bits)]
            low, high = map(float, ends)
            if low == high:
                return low
            if bits > 4 * _FIRST_BITS and math.nextafter(low, math.inf) == high:  # as good as half-way between them
                middle = (Fraction(low) + Fraction(high)) / 2
                side = _sign(self - middle)
                return float(middle) if not side else high if side > 0 else low
            bits *= 2

    def __repr__(self) -> str:
        return f"Algebraic({float(self)!r})"

    def __neg__(self) -> Algebraic:
        return Algebraic("*", (self, Fraction(-1)))

    def __abs__(self) -> Algebraic:
        return -self if self.sign() < 0 else self

    def __add__(self, other: Exact | float) -> Exact | float:
        if isinstance(other, float):
            return _with_double(self, other) + other
        return self if _is_zero(other) else Algebraic("+", (self, other))

    def __sub__(self, other: Exact | float) -> Exact | float:
        return self + -other

    def __mul__(self, other: Exact | float) -> Exact | float:
        if isinstance(other, float):
            return _with_double(self, other) * other
        return Fraction(0) if _is_zero(other) else Algebraic("*", (self, other))

    def __truediv__(self, other: Exact | float) -> Exact | float:
        if isinstance(other, float):
            return _with_double(self, other) / other
        return self * _inverse(other)

    def __radd__(self, other: Fraction | float) -> Exact | float:
        return self + other

    def __rsub__(self, other: Fraction | float) -> Exact | float:
        return -self + other

    def __rmul__(self, other: Fraction | float) -> Exact | float:
        return self * other

    def __rtruediv__(self, other: Fraction | float) -> Exact | float:
        if isinstance(other, float):
            return other / _with_double(self, other)
        return _inverse(self) * other

    def __bool__(self) -> bool:
        return self.sign() != 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Algebraic | Fraction | int | float) and self._order(other) == 0

    def __lt__(self, other: Exact | float) -> bool:
        return self._order(other) < 0

    def __le__(self, other: Exact | float) -> bool:
        return self._order(other) <= 0

    def __gt__(self, other: Exact | float) -> bool:
        return self._order(other) > 0

    def __ge__(self, other: Exact | float) -> bool:
        return self._order(other) >= 0

    __hash__ = None  # type: ignore[assignment]  # equal numbers may be different expressions

    def _order(self, other: Exact | float) -> int:
        if isinstance(other, float) and math.isinf(other):
            return -1 if other > 0 else 1
        return _sign(self - (Fraction(other) if isinstance(other, float) else other))


def root(value: Exact | float, index: int = 2) -> Exact | float:
    """The root of a number that is not negative; a Fraction where it is rational. ValueError for a negative one."""
    if isinstance(value, float):
        return math.sqrt(value) if index == 2 else value ** (1 / index)
    if _sign(value) < 0:
        raise ValueError("a root of a negative number")
    if isinstance(value, Fraction):
        top, bottom = _floor_root(value.numerator, index), _floor_root(value.denominator, index)
        if top**index == value.numerator and bottom**index == value.denominator:
            return Fraction(top, bottom)
    elif not value:
        return Fraction(0)
    return Algebraic("root", (value,), index)


def power(base: Exact | float, exponent: Exact | float) -> Exact | float:
    """base ^ exponent: exact if the exponent is p/q with q ≤ `LARGEST_ROOT`, else in doubles.

    Raises ZeroDivisionError, ValueError or OverflowError where there is no value.
    """
    if isinstance(base, float) or not isinstance(exponent, Fraction) or exponent.denominator > LARGEST_ROOT:
        return math.pow(base, exponent)
    whole, index = abs(exponent.numerator), exponent.denominator
    if index > 1 and _sign(base) < 0:
        raise ValueError("a fractional power of a negative number")
    if isinstance(base, Fraction):
        raised: Exact = base**whole
    else:
        raised = Algebraic("^", (base,), whole) if whole else Fraction(1)
    value = root(raised, index) if index > 1 else raised
    assert not isinstance(value, float)
    return value if exponent >= 0 else _inverse(value)


def _is_zero(value: Exact) -> bool:
    """Whether it is 0 in a way that costs nothing to see."""
    return isinstance(value, Fraction | int) and not value


def _with_double(value: Algebraic, other: float) -> float:
    """What stands for the value in an operation with a double: beside an infinite one, its sign is enough."""
    return float(value.sign()) if math.isinf(other) else float(value)


def _inverse(value: Exact) -> Exact:
    if not value:
        raise ZeroDivisionError
    return 1 / value if isinstance(value, Fraction) else Algebraic("1/", (value,))


def _sign(value: Exact | float) -> int:
    return value.sign() if isinstance(value, Algebraic) else (value > 0) - (value < 0)


def _sizes(value: Exact) -> tuple[int, int]:
    """Upper bounds on log₂ u and log₂ l."""
    if isinstance(value, Algebraic):
        return value._upper, value._lower
    return value.numerator.bit_length(), value.denominator.bit_length()


def _enclosure(value: Exact, bits: int) -> tuple[int, int]:
    if isinstance(value, Algebraic):
        return value.enclosure(bits)
    scaled = value.numerator << bits
    return scaled // value.denominator, -(-scaled // value.denominator)


def _floor_root(value: int, index: int) -> int:
    """⌊value^(1/index)⌋, by Newton's method from above."""
    if index == 2 or value < 2:
        return math.isqrt(value) if index == 2 else value
    guess = 1 << -(-value.bit_length() // index)
    while True:
        better = ((index - 1) * guess + value // guess ** (index - 1)) // index
        if better >= guess:
            return guess
        guess = better
