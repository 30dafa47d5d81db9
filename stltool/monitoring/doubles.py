"""Terms over arrays in doubles, each value v̂ with a bound E on its distance from the value in the semantics.

First-order terms as in [Higham02, §3.3]; u = 2⁻⁵³ is the unit roundoff:

    number, signal   E = 4u|v̂|                  a double is at most u|v̂| from the decimal it prints as
    a + b, a − b     E = Ea + Eb + 4u|v̂|
    a · b            E = |a|Eb + |b|Ea + Ea·Eb + 4u|v̂|
    a / b            E = (Ea + |v̂|Eb) / (|b| − Eb) + 4u|v̂|            if |b| > Eb
    sqrt a           E = Ea / v̂ + 4u|v̂|                               if a > Ea;  .55 Ea / v̂ + 4u|v̂|   if a > 16 Ea
    a ^ c            a product if c is 1 … 8, else
                     E = |c| max((|a| ± Ea)^(c−1)) Ea + 32u|v̂|         c a constant, away from the border at 0
    min, max, abs, − E = max of the operands'

and ∞ otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Any, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Arithmetic, Call, Negate, Number, Term, Variable

Floats: TypeAlias = NDArray[np.float64]
Values: TypeAlias = Floats | np.float64
Bounded: TypeAlias = tuple[Values, Values]  # values and their bounds

UNIT = 2.0**-53
TINY = 1e-322  # covers losses by underflow
WIDER = 1.25  # covers the rounding of the bounds themselves
_LARGEST_EXPONENT = 1000.0
_LARGEST_PRODUCT = 8  # powers up to here are products
PLACES = (0, 1, 2, 3, 4, 5, 6, 8, 10)  # that the decimals of a whole column may have


def bounded(term: Term, columns: Mapping[str, Floats]) -> Bounded:
    """To be called under `np.errstate(all="ignore")`."""
    match term:
        case Number(number):
            return _rounded(np.float64(number))
        case Variable(name):
            return _rounded(columns[name])
        case Negate(arg):
            value, error = bounded(arg, columns)
            return np.negative(value), error
        case Arithmetic(op, left, right):
            (a, ea), (b, eb) = bounded(left, columns), bounded(right, columns)
            match op:
                case "+":
                    return _rounded(np.add(a, b), ea + eb)
                case "-":
                    return _rounded(np.subtract(a, b), ea + eb)
                case "*":
                    return _product((a, ea), (b, eb))
                case "/":
                    value, room = np.divide(a, b), np.abs(b) - eb
                    return _rounded(value, np.where(room > 0, WIDER * (ea + np.abs(value) * eb) / room, np.inf))
                case "^":
                    if isinstance(right, Number) and right.value in range(1, _LARGEST_PRODUCT + 1):
                        return reduce(_product, [(a, ea)] * int(right.value))
                    return _power(a, ea, right)
                case _:
                    assert_never(op)
        case Call(function, args):
            operands = [bounded(arg, columns) for arg in args]
            value, error = operands[0]
            match function:
                case "abs":
                    return np.abs(value), error
                case "sqrt":
                    root = np.sqrt(value) + 0.0  # not −0, whose bound would be −∞
                    steep = np.where(value > error, 1.0, np.inf)
                    return _rounded(root, np.where(value > 16 * error, 0.55, steep) * (WIDER * error / root))
                case "min" | "max":
                    extremum = np.minimum if function == "min" else np.maximum
                    for other, its in operands[1:]:
                        value, error = extremum(value, other), np.maximum(error, its)
                    return value, error
                case _:
                    assert_never(function)
        case _:
            assert_never(term)


def _rounded(value: Any, error: Any = 0.0, units: float = 4.0) -> Bounded:
    return value, error + units * UNIT * np.abs(value) + TINY


def _product(x: Bounded, y: Bounded) -> Bounded:
    (a, ea), (b, eb) = x, y
    return _rounded(np.multiply(a, b), np.abs(a) * eb + np.abs(b) * ea + ea * eb)


def _power(a: Values, ea: Values, exponent: Term) -> Bounded:
    c = _constant_value(exponent)
    if c is None:
        return np.zeros_like(a), np.full_like(a, np.inf)
    value = np.power(a, c)
    high, low = np.abs(a) + ea, np.abs(a) - ea
    if c.is_integer() and 0 <= c <= _LARGEST_EXPONENT:
        slope = c * np.power(high, max(c - 1.0, 0.0))
    else:
        away = low > 0 if c.is_integer() else a > ea
        slope = np.where(away, abs(c) * np.maximum(np.power(high, c - 1.0), np.power(low, c - 1.0)), np.inf)
    return _rounded(value, WIDER * slope * ea, units=32.0)


def _constant_value(term: Term) -> float | None:
    if isinstance(term, Number):
        return float(term.value)
    if isinstance(term, Negate):
        inner = _constant_value(term.arg)
        return None if inner is None else -inner
    return None


def short_decimals(values: Floats) -> tuple[NDArray[np.int64], int] | None:
    """Whole numbers m and k with m / 10^k the decimals that the values print as, if k is small; None otherwise.

    A decimal of at most 15 digits that reads as a double is what the double prints as.
    """
    for k in PLACES:
        if _with_places(values[:100], k) is not None and (whole := _with_places(values, k)) is not None:
            return whole, k
    return None


def _with_places(values: Floats, k: int) -> NDArray[np.int64] | None:
    whole = np.rint(values * 10.0**k)
    if not (whole / 10.0**k == values).all() or max(-whole.min(), whole.max()) >= 1e15:
        return None
    return whole.astype(np.int64)
