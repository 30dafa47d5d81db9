"""Comparisons over arrays, decided exactly as in the slow semantics, which computes in fractions.

Terms are computed in doubles, with bounds on their errors (doubles.py). A sample whose margin |left − right| exceeds
twice the bound E is decided (the semantics itself sometimes rounds a power, by no more than these bounds). Samples
nearer to the border are decided in whole numbers (borders.py), and what is left over one by one with the slow
semantics, each combination of values once. Comparisons that only choose among signals and numbers (by −, abs, min, max)
are exact in doubles, whose order is that of the decimals they print as.

A margin is within 2E + 4u|margin| of that in the semantics, and equal to it for samples near the border. So its sign
is right: > 0 implies true, < 0 implies false.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, reduce
from math import isfinite, prod
from operator import itemgetter
from typing import TypeAlias, assert_never

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
from stltool.monitoring.borders import COMPILED_FROM, differences, in_kernel, judged, possible, worthwhile
from stltool.monitoring.doubles import TINY, UNIT, WIDER, Floats, Values, bounded
from stltool.source import Span

_COMPARE: dict[Comparator, np.ufunc] = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip
_Places: TypeAlias = tuple[NDArray[np.intp], ...]
Bools: TypeAlias = NDArray[np.bool_]

_REMEMBERED = 1 << 14  # cached results of samples judged one by one


class Predicate:
    """One comparison, ready to judge arrays."""

    __slots__ = ("_in_kernel", "_on_borders", "_settled", "names", "node", "plain")

    def __init__(self, node: Comparison) -> None:
        self.node = node
        self.names: dict[str, Span | None] = variables(node)
        self.plain = _is_plain(node.left) and _is_plain(node.right)
        self._on_borders = not self.plain and possible(node)
        self._in_kernel = self._on_borders and in_kernel(node)
        self._settled = lru_cache(maxsize=_REMEMBERED)(self._settle)

    def __reduce__(self) -> tuple[type[Predicate], tuple[Comparison]]:
        return Predicate, (self.node,)

    def judge(
        self, columns: Mapping[str, Floats], truth: Bools | None, margin: Floats | None, wide: bool
    ) -> tuple[Bools | None, bool]:
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

    def _constant(self, truth: Bools | None, margin: Floats | None) -> tuple[Bools | None, bool]:
        true, distance = self._settled()
        if truth is not None:
            truth[...] = bool(true)
        if margin is not None:
            margin[...] = distance
        shape = next(out.shape for out in (truth, margin) if out is not None)
        return np.ones(shape, dtype=np.bool_) if true is None else None, bool(np.isnan(distance))

    def _compute(
        self, columns: Mapping[str, Floats], truth: Bools | None, margin: Floats | None
    ) -> tuple[Bools | None, bool]:
        shape = columns[next(iter(self.names))].shape
        if self._in_kernel and worthwhile(prod(shape)):
            return self._by_kernel(columns, truth, margin)
        left, right, error = self._sides(columns)
        if truth is not None:
            _COMPARE[self.node.op](left, right, out=truth)
        if margin is not None:
            _signed(self.node.op, left, right, margin)
        apart = np.abs(left - right)
        near = np.broadcast_to(~(apart > error), shape)
        count = int(np.count_nonzero(near))
        if self._in_kernel and count >= COMPILED_FROM:
            return self._by_kernel(columns, truth, margin)
        if count and self._on_borders:
            # doubles.py counts 4u for what is at most u, and `error` is 2.5 times its sums: so this is a bound, too
            bound = np.broadcast_to(apart * (1 + 8 * UNIT) + error / 8, shape)
            near = self._at_the_border(columns, near, count, bound, truth, margin)
            count = int(np.count_nonzero(near))
        return self._one_by_one(columns, np.nonzero(near), shape, truth, margin) if count else (None, False)

    def _by_kernel(
        self, columns: Mapping[str, Floats], truth: Bools | None, margin: Floats | None
    ) -> tuple[Bools | None, bool]:
        given = {name: columns[name] for name in self.names}
        left = judged(self.node, given, truth, margin)
        if left is None:
            return None, False
        return self._one_by_one(columns, np.nonzero(left), left.shape, truth, margin)

    def _at_the_border(
        self,
        columns: Mapping[str, Floats],
        near: Bools,
        count: int,
        apart: Floats,
        truth: Bools | None,
        margin: Floats | None,
    ) -> Bools:
        """Settle `count` samples in whole numbers; returns which others are left."""
        dense = 2 * count > near.size  # then all are computed, which is quicker than picking some
        given = {name: columns[name].reshape(-1) if dense else columns[name][near] for name in self.names}
        sign, difference, known = differences(self.node, given, apart.reshape(-1) if dense else apart[near])
        if dense and count == near.size and known.all():
            if truth is not None:
                _COMPARE[self.node.op](sign.reshape(truth.shape), 0, out=truth)
            if margin is not None:
                _signed(self.node.op, difference.reshape(margin.shape), np.float64(0.0), margin)
            return np.zeros_like(near)
        settled = known.reshape(near.shape) if dense else np.zeros_like(near)
        if dense:
            settled &= near
        else:
            settled[near] = known
        picked = settled.reshape(-1) if dense else known
        if truth is not None:
            truth[settled] = _COMPARE[self.node.op](sign[picked], 0)
        if margin is not None:
            found = np.empty(len(sign))
            _signed(self.node.op, difference, np.float64(0.0), found)
            margin[settled] = found[picked]
        return near & ~settled

    def _one_by_one(
        self,
        columns: Mapping[str, Floats],
        where: _Places,
        shape: tuple[int, ...],
        truth: Bools | None,
        margin: Floats | None,
    ) -> tuple[Bools | None, bool]:
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
        (left, ea), (right, eb) = bounded(self.node.left, columns), bounded(self.node.right, columns)
        return left, right, 2 * WIDER * (ea + eb) + 4 * UNIT * np.abs(left - right) + TINY

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
    """Chooses among signals and numbers: nothing is rounded."""
    match term:
        case Variable() | Number():
            return True
        case Negate(arg):
            return _is_plain(arg)
        case Call(function, args):
            return function != "sqrt" and all(map(_is_plain, args))
        case Arithmetic():
            return False
        case _:
            assert_never(term)


def _plain_value(term: Term, columns: Mapping[str, Floats]) -> Values:
    match term:
        case Variable(name):
            return columns[name]
        case Negate(arg):
            return np.negative(_plain_value(arg, columns))
        case Number(value):
            return np.float64(value)
        case Call(function, args):
            values = [_plain_value(arg, columns) for arg in args]
            if function == "abs":
                return np.abs(values[0])
            return reduce(np.minimum if function == "min" else np.maximum, values)
        case _:
            raise AssertionError(term)


def _getter(term: Term) -> Callable[[Mapping[str, float]], float]:
    """A plain term's value at one sample."""
    match term:
        case Variable(name):
            return itemgetter(name)
        case Negate(arg):
            inner = _getter(arg)
            return lambda sample: -inner(sample)
        case Number(number):
            return lambda sample: number
        case Call(function, args):
            getters = [_getter(arg) for arg in args]
            if function == "abs":
                return lambda sample: abs(getters[0](sample))
            choose = min if function == "min" else max
            return lambda sample: choose(get(sample) for get in getters)
        case _:
            raise AssertionError(term)
