"""Strategies for formulas, and for terms, windows and predicates in them.

A strategy is made once for each set of options: Hypothesis examines a new one for longer than it draws from it. What is
drawn at the top is a new object, not one made by st.builds, so that a failure prints it as text (testing/printing.py).
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

from hypothesis import strategies as st

from stltool.arguments import one_of, whole
from stltool.errors import SettingsError
from stltool.logic.formula import (
    COMPARATORS,
    Always,
    And,
    Arithmetic,
    Call,
    Comparator,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Term,
    Trigger,
    Until,
    Variable,
)
from stltool.logic.regions import Choices, Range, Span
from stltool.testing.names import LABELS, SIGNALS, Signals, below, by
from stltool.testing.ranges import range_of

Fragment: TypeAlias = Literal["any", "paper", "boolean"]

_LEVELS = 5  # of operators above the predicates
_Ranged: TypeAlias = tuple[tuple[str, Range], ...]


def terms(signals: Sequence[str] = SIGNALS) -> st.SearchStrategy[Term]:
    """Arithmetic that has a value everywhere: no division, no root, small integer exponents."""
    return _terms(tuple(signals))


@functools.cache
def _terms(signals: tuple[str, ...]) -> st.SearchStrategy[Term]:
    leaves = st.sampled_from(signals).map(Variable) | st.sampled_from([0.0, 0.5, 1.0, 2.0, 1e-10, 40.0]).map(Number)

    def grow(below: st.SearchStrategy[Term]) -> st.SearchStrategy[Term]:
        return st.one_of(
            below.map(Negate),
            st.builds(Arithmetic, st.sampled_from(["+", "-", "*"]), below, below),
            st.builds(Arithmetic, st.just("^"), below, st.sampled_from([1.0, 2.0]).map(Number)),
            st.tuples(below).map(lambda args: Call("abs", args)),
            st.builds(Call, st.sampled_from(["min", "max"]), st.tuples(below, below) | st.tuples(below, below, below)),
        )

    return st.recursive(leaves, grow, max_leaves=4)


@functools.cache
def intervals(longest: int = 3) -> st.SearchStrategy[Interval]:
    """Windows [a, b] with b at most `longest`."""
    bounds = st.tuples(st.integers(0, longest), st.integers(0, longest))
    return bounds.map(lambda pair: Interval(min(pair), max(pair)))


def predicates(labels: Sequence[str] = LABELS, signals: Signals = SIGNALS) -> st.SearchStrategy[Formula]:
    """Boolean formulas over one state: labels, comparisons, constants under the Boolean operators.

    For `signals` with ranges, as in `traces`, a comparison is of one signal with a number in its range.
    """
    return _predicates(tuple(labels), _of(signals))


@functools.cache
def _predicates(labels: tuple[str, ...], signals: tuple[str, ...] | _Ranged) -> st.SearchStrategy[Formula]:
    return _renewed(st.recursive(_leaves(labels, signals), _boolean, max_leaves=4))


@functools.cache
def _leaves(labels: tuple[str, ...], signals: tuple[str, ...] | _Ranged) -> st.SearchStrategy[Formula]:
    names = tuple(one for one in signals if isinstance(one, str))
    found: st.SearchStrategy[Formula] = st.booleans().map(Constant)
    if labels:
        found = st.sampled_from(labels).map(Label) | found
    if names:
        found |= st.builds(Comparison, st.sampled_from(COMPARATORS), terms(names), terms(names))
    elif signals:
        found |= _within_range(tuple(one for one in signals if not isinstance(one, str)))
    return found


@st.composite
def _within_range(draw: st.DrawFn, signals: _Ranged) -> Formula:
    """A signal compared with a number in its range."""
    name, limits = draw(st.sampled_from(signals))
    op: Comparator = draw(st.sampled_from(COMPARATORS))
    choices = Choices.within(Span(*limits))
    assert choices is not None  # ranges have decimals
    value = float(choices.pick(by(draw)))
    return Comparison(op, Variable(name), Number(value) if value >= 0 else Negate(Number(-value)))


def _of(signals: Signals) -> tuple[str, ...] | _Ranged:
    if isinstance(signals, Mapping):
        return tuple((name, range_of(name, limits)) for name, limits in signals.items())
    return tuple(signals)


@st.composite
def _renewed(draw: st.DrawFn, strategy: st.SearchStrategy[Formula]) -> Formula:
    """The same as objects of their own."""
    return copy.copy(draw(strategy))


@dataclass(frozen=True)
class _Room:
    """What a formula may hold: Hypothesis draws again from a strategy of the same room."""

    predicates: st.SearchStrategy[Formula]
    longest: int
    past: bool
    leaves: int
    depth: int | None
    horizon: int | None
    levels: int = _LEVELS

    def inside(self, b: int | None = None, parts: int = 1) -> _Room:
        """What is left below a temporal operator with last step b, or, without b, below another operator."""
        left = replace(self, leaves=max(1, self.leaves // parts), levels=self.levels - 1)
        if b is None:
            return left
        return replace(
            left,
            depth=None if self.depth is None else self.depth - 1,
            horizon=None if self.horizon is None else self.horizon - b,
        )


def formulas(
    labels: Sequence[str] = LABELS,
    signals: Signals = SIGNALS,
    longest: int = 3,
    max_leaves: int = 8,
    past: bool = False,
    *,
    depth: int | None = None,
    horizon: int | None = None,
    fragment: Fragment = "any",
) -> st.SearchStrategy[Formula]:
    """Any bounded formula: F, G, U, release with windows [a, b] under and over the Boolean operators.

    labels, signals   the names; for signals with ranges, as in `traces`, comparisons are as in `predicates`
    longest           the largest b of a window
    max_leaves        the number of predicates, each of a few labels and comparisons, at most
    past              also once, historically, since, trigger, whose windows may have no end, prev, rise and fall
    depth, horizon    at most so many temporal operators above each other, and at most this horizon
    fragment          "any"; "paper": `flag_formulas` with any windows; "boolean": `predicates`
    """
    one_of(fragment, "formulas' fragment", get_args(Fragment))
    longest = whole(longest, "formulas' longest", 0)
    max_leaves = whole(max_leaves, "formulas' max_leaves", 1)
    depth = None if depth is None else whole(depth, "formulas' depth", 0)
    horizon = None if horizon is None else whole(horizon, "formulas' horizon", 0)
    if fragment == "boolean":
        return predicates(labels, signals)
    if fragment == "paper":
        if depth is not None and depth < 2:
            raise SettingsError(f"formulas' depth is {depth}; the paper's formulas have two operators above each other")
        return flag_formulas(labels, longest, equal=False, signals=signals, horizon=horizon)
    return _formulas(tuple(labels), _of(signals), longest, max_leaves, past, depth, horizon)


@functools.cache
def _formulas(
    labels: tuple[str, ...], signals: tuple[str, ...] | _Ranged, longest: int, max_leaves: int, past: bool,
    depth: int | None, horizon: int | None,
) -> st.SearchStrategy[Formula]:  # fmt: skip
    return _formula(_Room(_predicates(labels, signals), longest, past, max_leaves, depth, horizon))


_ONE = (Not, Eventually, Always, Eventually, Always)
_TWO = (And, Or, Implies, Iff, Until, Release)
_EARLIER_ONE = (Once, Historically, Rise, Once, Historically)
_EARLIER_TWO = (Since, Trigger)
_BOOLEAN = (Not, And, Or, Implies, Iff)


@st.composite
def _formula(draw: st.DrawFn, room: _Room) -> Formula:
    """A predicate in a third of the draws, and the simplest; otherwise an operator for which there is room."""
    kinds: tuple[Any, ...] = _ONE if room.leaves == 1 else _ONE + _TWO
    if room.past:
        kinds += _EARLIER_ONE if room.leaves == 1 else _EARLIER_ONE + _EARLIER_TWO
    if room.depth == 0:
        kinds = tuple(kind for kind in kinds if kind in _BOOLEAN)
    predicate = len(kinds) // 2 + 1
    chosen = draw(below(len(kinds) + predicate)) if room.levels else 0
    if chosen < predicate:
        return copy.copy(draw(room.predicates))
    kind = kinds[chosen - predicate]
    if kind is Not:
        return Not(draw(_formula(room.inside())))
    if kind is Rise:
        return Rise(draw(_formula(room.inside(0))))
    if kind is And or kind is Or:
        n = 2 + draw(below(2)) if room.leaves > 2 else 2
        args = tuple(draw(_formula(room.inside(parts=n))) for _ in range(n))
        return And(args) if kind is And else Or(args)
    if kind is Implies or kind is Iff:
        left, right = (draw(_formula(room.inside(parts=2))) for _ in range(2))
        return Implies(left, right) if kind is Implies else Iff(left, right)
    ahead = kind in (Eventually, Always, Until, Release)
    interval = draw(intervals(room.longest if not ahead or room.horizon is None else min(room.longest, room.horizon)))
    if not ahead and draw(below(4)) == 3:
        interval = Interval(min(interval.a, 1), None)
    n = 1 if kind in _ONE + _EARLIER_ONE else 2
    inside = room.inside(interval.last if ahead else 0, n)
    phi: Formula = kind(interval, *(draw(_formula(inside)) for _ in range(n)))
    return phi


_formula = functools.cache(_formula)


@st.composite
def flag_formulas(
    draw: st.DrawFn,
    labels: Sequence[str] = LABELS,
    longest: int = 3,
    equal: bool = True,
    signals: Signals = (),
    horizon: int | None = None,
) -> Formula:
    """The fragment of [Wang24]: outer F or G over a Boolean combination of inner F and G.

    `equal` gives all inner windows one length: the formulas whose flags are exact.
    """
    widest = max(1, longest if horizon is None else min(longest, horizon + 1))
    tau = draw(st.integers(1, widest))

    def window() -> Interval:
        return Interval(0, (tau if equal else draw(st.integers(1, widest))) - 1)

    psi = predicates(labels, signals)
    parts: list[Formula] = [_windowed(draw)(window(), draw(psi)) for _ in range(draw(st.integers(1, 3)))]
    body = _filled(draw(_shapes(len(parts))), parts)
    last = longest if horizon is None else min(longest, horizon + 1 - (tau if equal else widest))
    phi: Formula = _windowed(draw)(Interval(0, draw(st.integers(0, last))), body)
    return Not(phi) if draw(st.booleans()) else phi


def _windowed(draw: st.DrawFn) -> Callable[[Interval, Formula], Formula]:
    return draw(_OPERATORS)


_OPERATORS: st.SearchStrategy[Callable[[Interval, Formula], Formula]] = st.sampled_from((Eventually, Always))


@functools.cache
def _shapes(n: int) -> st.SearchStrategy[Formula]:
    """Boolean combinations of n parts, each a label with its number."""
    return st.recursive(st.integers(0, n - 1).map(lambda i: Label(str(i))), _boolean, max_leaves=4)


def _filled(shape: Formula, parts: Sequence[Formula]) -> Formula:
    match shape:
        case Label(name):
            return parts[int(name)]
        case Not(arg):
            return Not(_filled(arg, parts))
        case And(args) | Or(args):
            return type(shape)(tuple(_filled(arg, parts) for arg in args))
        case Implies(left, right) | Iff(left, right):
            return type(shape)(_filled(left, parts), _filled(right, parts))
    raise AssertionError(shape)


def _boolean(below: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    some = st.lists(below, min_size=2, max_size=3).map(tuple)
    return st.one_of(
        below.map(Not), some.map(And), some.map(Or), st.builds(Implies, below, below), st.builds(Iff, below, below)
    )
