"""Comparisons over arrays, decided exactly as in the slow semantics, which computes in fractions.

Terms are computed in doubles, each value v̂ with a bound E on its distance from the value in the semantics (first-order
terms as in [Higham02, §3.3]; u = 2⁻⁵³ the unit roundoff):

    number, signal   E = 4u|v̂|                  a double is at most u|v̂| from the decimal it prints as
    a + b, a − b     E = Ea + Eb + 4u|v̂|
    a · b            E = |a|Eb + |b|Ea + Ea·Eb + 4u|v̂|
    a / b            E = (Ea + |v̂|Eb) / (|b| − Eb) + 4u|v̂|            if |b| > Eb
    sqrt a           E = Ea / v̂ + 4u|v̂|                               if a > Ea
    a ^ c            E = |c| max((|a| ± Ea)^(c−1)) Ea + 32u|v̂|         c a constant, away from the border at 0
    min, max, abs, − E = max of the operands'

and ∞ otherwise. A sample whose margin |left − right| exceeds twice the bound is decided (the semantics itself sometimes
rounds a power, by no more than these bounds). The remaining samples, few unless data often lie on borders, are
judged one by one with the slow semantics, each combination of values once. Comparisons without arithmetic are exact in
doubles, whose order is that of the decimals they print as.

A margin is within 2E + 4u|margin| of that in the semantics, and equal to it for samples judged one by one. So its sign
is right: > 0 implies true, < 0 implies false.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from math import isfinite
from operator import itemgetter
from typing import Any, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.errors import TraceError
from stltool.logic.formula import (
    Arithmetic,
    Call,
    Comparator,
    Comparison,
    Negate,
    Number,
    Term,
    Variable,
    variables,
)
from stltool.logic.semantics import COMPARE, robustness, satisfies
from stltool.source import Span

Floats: TypeAlias = NDArray[np.float64]
Values: TypeAlias = Floats | np.float64
Bounded: TypeAlias = tuple[Values, Values]  # values and their bounds

_COMPARE: dict[Comparator, np.ufunc] = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip
_REMEMBERED = 1 << 14  # cached results of samples judged one by one
_U = 2.0**-53
_TINY = 1e-322  # covers losses by underflow
_WIDER = 1.25  # covers the rounding of the bounds themselves
_LARGEST_EXPONENT = 1000.0


class Predicate:
    """One comparison, ready to judge arrays."""

    __slots__ = ("_settled", "names", "node", "plain")

    def __init__(self, node: Comparison) -> None:
        self.node = node
        self.names: dict[str, Span | None] = variables(node)
        self.plain = _is_plain(node.left) and _is_plain(node.right)
        self._settled = lru_cache(maxsize=_REMEMBERED)(self._settle)

    def judge(
        self, columns: Mapping[str, Floats], truth: NDArray[np.bool_] | None, margin: Floats | None, wide: bool
    ) -> tuple[NDArray[np.bool_] | None, bool]:
        """Write truth and signed margin of every sample into the given arrays, which have the shape of the columns.

        Returns a mask of samples where a term has no value (truth is then false, the margin NaN), None if there are
        none; and whether some margin is NaN because it is beyond the range of doubles, which without arithmetic is
        possible only if `wide`. To be called under `np.errstate(all="ignore")`.
        """
        if not self.names:
            return self._constant(truth, margin)
        if not self.plain:
            return self._compute(columns, truth, margin)
        left, right = _plain_value(self.node.left, columns), _plain_value(self.node.right, columns)
        if truth is not None:
            _COMPARE[self.node.op](left, right, out=truth)
        if margin is None:
            return None, False
        _signed(self.node.op, left, right, margin)
        if wide:
            np.copyto(margin, np.nan, where=np.isinf(margin))
        return None, wide

    def at_one_sample(self) -> Callable[[Mapping[str, float]], tuple[float, bool]]:
        """A function from one sample, name → value, to the margin and truth that `judge` finds for it.

        It raises TraceError if there is none.
        """
        node = self.node
        if not self.plain:
            return self._at_one_sample
        left, right, compare = _getter(node.left), _getter(node.right), COMPARE[node.op]
        if node.op in ("<", "<="):
            less, more = left, right
        else:
            less, more = right, left
        fold = {"==": lambda d: 0.0 - abs(d), "!=": abs}.get(node.op, lambda d: d + 0.0)

        def judge(sample: Mapping[str, float]) -> tuple[float, bool]:
            margin = fold(more(sample) - less(sample))
            if not isfinite(margin):
                margin = robustness(node, {name: [value] for name, value in sample.items()})  # raises
            return margin, compare(left(sample), right(sample))

        return judge

    def _at_one_sample(self, sample: Mapping[str, float]) -> tuple[float, bool]:
        columns = {name: np.array([[sample[name]]]) for name in self.names}
        truth, margin = np.empty((1, 1), dtype=np.bool_), np.empty((1, 1))
        with np.errstate(all="ignore"):
            self.judge(columns, truth, margin, False)
        if np.isnan(margin[0, 0]):
            robustness(self.node, {name: [value] for name, value in sample.items()})  # raises
        return float(margin[0, 0]), bool(truth[0, 0])

    def _constant(
        self, truth: NDArray[np.bool_] | None, margin: Floats | None
    ) -> tuple[NDArray[np.bool_] | None, bool]:
        true, distance = self._settled()
        if truth is not None:
            truth[...] = bool(true)
        if margin is not None:
            margin[...] = distance
        shape = next(out.shape for out in (truth, margin) if out is not None)
        return np.ones(shape, dtype=np.bool_) if true is None else None, bool(np.isnan(distance))

    def _compute(
        self, columns: Mapping[str, Floats], truth: NDArray[np.bool_] | None, margin: Floats | None
    ) -> tuple[NDArray[np.bool_] | None, bool]:
        left, right, error = self._sides(columns)
        if truth is not None:
            _COMPARE[self.node.op](left, right, out=truth)
        if margin is not None:
            _signed(self.node.op, left, right, margin)
        shape = columns[next(iter(self.names))].shape
        where = np.nonzero(np.broadcast_to(~(np.abs(left - right) > error), shape))
        if not len(where[0]):
            return None, False
        samples = zip(*(columns[name][where].tolist() for name in self.names), strict=True)
        judged = [self._settled(*sample) for sample in samples]
        if truth is not None:
            truth[where] = [true is True for true, _ in judged]
        if margin is not None:
            margin[where] = [distance for _, distance in judged]
        undefined = [true is None for true, _ in judged]
        if not any(undefined):
            return None, any(np.isnan(distance) for _, distance in judged)
        unknown = np.zeros(shape, dtype=np.bool_)
        unknown[where] = undefined
        return unknown, True

    def error(self, columns: Mapping[str, Floats]) -> Values:
        """For every sample, a bound on the distance of the margin that `judge` finds from that in the semantics."""
        error = self._sides(columns)[2] if self.names else np.float64(0.0)
        return np.where(np.isfinite(error), error, 0.0)  # without a bound, samples are judged one by one

    def _sides(self, columns: Mapping[str, Floats]) -> tuple[Values, Values, Values]:
        """Left and right values, and the bound on the error of their difference."""
        (left, ea), (right, eb) = _bounded(self.node.left, columns), _bounded(self.node.right, columns)
        return left, right, 2 * _WIDER * (ea + eb) + 4 * _U * np.abs(left - right) + _TINY

    def _settle(self, *sample: float) -> tuple[bool | None, float]:
        """Truth and margin of one sample by the slow semantics; None and NaN if there is none."""
        signal = {name: [value] for name, value in zip(self.names, sample, strict=True)}
        try:
            true = satisfies(self.node, signal)
        except TraceError:
            return None, np.nan
        try:
            return true, robustness(self.node, signal) + 0.0
        except TraceError:
            return true, np.nan


def _signed(op: Comparator, left: Values, right: Values, out: Floats) -> None:
    """The margin of the comparison."""
    match op:
        case ">" | ">=":
            _subtract(left, right, out)
        case "<" | "<=":
            _subtract(right, left, out)
        case "==" | "!=":
            _subtract(left, right, out)
            np.abs(out, out=out)
            if op == "==":
                np.subtract(0.0, out, out=out)
        case _:
            assert_never(op)


def _subtract(a: Values, b: Values, out: Floats) -> None:
    """a − b, but 0.0 for −0.0, so that extrema do not depend on the order of their operands."""
    if np.ndim(a) == 0:
        np.subtract(a + 0.0, b, out=out)
    elif np.ndim(b) == 0:
        np.subtract(a, b if b != 0 else -0.0, out=out)
    else:
        np.subtract(a, b, out=out)
        np.add(out, 0.0, out=out)


def _is_plain(term: Term) -> bool:
    """A signal or a number, without arithmetic that could round."""
    return isinstance(term, Variable | Number) or (isinstance(term, Negate) and _is_plain(term.arg))


def _plain_value(term: Term, columns: Mapping[str, Floats]) -> Values:
    if isinstance(term, Variable):
        return columns[term.name]
    if isinstance(term, Negate):
        return np.negative(_plain_value(term.arg, columns))
    assert isinstance(term, Number)
    return np.float64(term.value)


def _getter(term: Term) -> Callable[[Mapping[str, float]], float]:
    """A plain term's value at one sample."""
    if isinstance(term, Variable):
        return itemgetter(term.name)
    if isinstance(term, Negate):
        inner = _getter(term.arg)
        return lambda sample: -inner(sample)
    assert isinstance(term, Number)
    number = term.value
    return lambda sample: number


def _bounded(term: Term, columns: Mapping[str, Floats]) -> Bounded:
    match term:
        case Number(number):
            return _rounded(np.float64(number))
        case Variable(name):
            return _rounded(columns[name])
        case Negate(arg):
            value, error = _bounded(arg, columns)
            return np.negative(value), error
        case Arithmetic(op, left, right):
            (a, ea), (b, eb) = _bounded(left, columns), _bounded(right, columns)
            match op:
                case "+":
                    return _rounded(np.add(a, b), ea + eb)
                case "-":
                    return _rounded(np.subtract(a, b), ea + eb)
                case "*":
                    return _rounded(np.multiply(a, b), np.abs(a) * eb + np.abs(b) * ea + ea * eb)
                case "/":
                    value, room = np.divide(a, b), np.abs(b) - eb
                    return _rounded(value, np.where(room > 0, _WIDER * (ea + np.abs(value) * eb) / room, np.inf))
                case "^":
                    return _power(a, ea, right)
                case _:
                    assert_never(op)
        case Call(function, args):
            operands = [_bounded(arg, columns) for arg in args]
            value, error = operands[0]
            match function:
                case "abs":
                    return np.abs(value), error
                case "sqrt":
                    root = np.sqrt(value)
                    return _rounded(root, np.where(value > error, _WIDER * error / root, np.inf))
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
    return value, error + units * _U * np.abs(value) + _TINY


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
    return _rounded(value, _WIDER * slope * ea, units=32.0)


def _constant_value(term: Term) -> float | None:
    if isinstance(term, Number):
        return float(term.value)
    if isinstance(term, Negate):
        inner = _constant_value(term.arg)
        return None if inner is None else -inner
    return None
