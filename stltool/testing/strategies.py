"""Hypothesis strategies: random formulas, traces and MDPs that fit together through the same signal and label names.

A strategy is made once for each set of options: Hypothesis examines a new one for longer than it draws from it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from stltool.logic.expectation import ASKED, RELATIONS, Expectation
from stltool.logic.formula import (
    COMPARATORS,
    Always,
    And,
    Arithmetic,
    Call,
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
from stltool.models import MDP

LABELS = ("a", "b", "c")
SIGNALS = ("x", "y")
_WINDOWED: tuple[Callable[[Interval, Formula], Formula], ...] = (Eventually, Always)
_VALUES = (-2.0, -1.0, 0.0, 0.5, 1.0, 2.0)  # few, so that comparisons reach equality


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


def predicates(labels: Sequence[str] = LABELS, signals: Sequence[str] = SIGNALS) -> st.SearchStrategy[Formula]:
    """Boolean formulas over one state: labels, comparisons, constants under the Boolean operators."""
    return _predicates(tuple(labels), tuple(signals))


@functools.cache
def _predicates(labels: tuple[str, ...], signals: tuple[str, ...]) -> st.SearchStrategy[Formula]:
    leaves: st.SearchStrategy[Formula] = st.sampled_from(labels).map(Label) | st.booleans().map(Constant)
    if signals:
        leaves |= st.builds(Comparison, st.sampled_from(COMPARATORS), terms(signals), terms(signals))
    return st.recursive(leaves, _boolean, max_leaves=4)


@functools.cache
def intervals(longest: int = 3) -> st.SearchStrategy[Interval]:
    """Windows [a, b] with b at most `longest`."""
    bounds = st.tuples(st.integers(0, longest), st.integers(0, longest))
    return bounds.map(lambda pair: Interval(min(pair), max(pair)))


def formulas(
    labels: Sequence[str] = LABELS,
    signals: Sequence[str] = SIGNALS,
    longest: int = 3,
    max_leaves: int = 8,
    past: bool = False,
) -> st.SearchStrategy[Formula]:
    """Any bounded formula: F, G, U, release with windows [a, b], b at most `longest`, under the Boolean operators;
    with `past` also once, historically, since, trigger, whose windows may have no end, prev, rise and fall.
    """
    return _formulas(tuple(labels), tuple(signals), longest, max_leaves, past)


@functools.cache
def _formulas(
    labels: tuple[str, ...], signals: tuple[str, ...], longest: int, max_leaves: int, past: bool
) -> st.SearchStrategy[Formula]:
    earlier = intervals(longest) | st.sampled_from([Interval(0, None), Interval(1, None)])

    def grow(below: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
        ahead = st.one_of(
            _boolean(below),
            st.builds(Eventually, intervals(longest), below),
            st.builds(Always, intervals(longest), below),
            st.builds(Until, intervals(longest), below, below),
            st.builds(Release, intervals(longest), below, below),
        )
        if not past:
            return ahead
        return ahead | st.one_of(
            st.builds(Once, earlier, below),
            st.builds(Historically, earlier, below),
            st.builds(Since, earlier, below, below),
            st.builds(Trigger, earlier, below, below),
            st.builds(Once, st.just(Interval(1, 1)), below),
            below.map(Rise),
            below.map(lambda arg: Rise(Not(arg))),
        )

    return st.recursive(predicates(labels, signals), grow, max_leaves=max_leaves)


@st.composite
def expectations(draw: st.DrawFn, labels: Sequence[str] = LABELS, signals: Sequence[str] = SIGNALS) -> Expectation:
    """What a task file may expect of a formula: any question with its bound and files."""
    question = draw(st.sampled_from(ASKED))
    formula, file = draw(formulas(labels, signals)), draw(st.text("abz é#/.\\'-", min_size=1))
    if question == "holds":
        return Expectation(question, formula, trace=file)
    relation, bound = draw(st.sampled_from(RELATIONS)), draw(st.fractions(0, 1))
    policy = file if question == "P" else None
    return Expectation(question, formula, None, relation, bound, draw(st.booleans()), policy)


@st.composite
def flag_formulas(draw: st.DrawFn, labels: Sequence[str] = LABELS, longest: int = 3, equal: bool = True) -> Formula:
    """The fragment of [Wang24]: outer F or G over a Boolean combination of inner F and G.

    `equal` gives all inner windows one length: the formulas whose flags are exact.
    """
    tau = draw(st.integers(1, longest))

    def window() -> Interval:
        return Interval(0, (tau if equal else draw(st.integers(1, longest))) - 1)

    psi = predicates(labels, signals=())
    operators = st.sampled_from(_WINDOWED)
    parts: list[Formula] = [draw(operators)(window(), draw(psi)) for _ in range(draw(st.integers(1, 3)))]
    body = _filled(draw(_shapes(len(parts))), parts)
    phi: Formula = draw(operators)(Interval(0, draw(st.integers(0, longest))), body)
    return Not(phi) if draw(st.booleans()) else phi


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


@st.composite
def traces(
    draw: st.DrawFn, n_steps: int, labels: Sequence[str] = LABELS, signals: Sequence[str] = SIGNALS
) -> dict[str, NDArray[np.float64] | NDArray[np.bool_]]:
    """A trace: name → array (n_steps,), with few distinct values, so that windows and borders are exercised."""

    def column(values: Sequence[object]) -> list[object]:
        return draw(_many(tuple(values), n_steps))

    trace: dict[str, NDArray[np.float64] | NDArray[np.bool_]] = {}
    for name in labels:
        trace[name] = np.array(column((False, True)), dtype=np.bool_)
    for name in signals:
        trace[name] = np.array(column(_VALUES), dtype=np.float64)
    return trace


@st.composite
def models(
    draw: st.DrawFn,
    max_states: int = 3,
    max_actions: int = 2,
    labels: Sequence[str] = LABELS,
    signals: Sequence[str] = SIGNALS,
    single_start: bool = False,
) -> MDP:
    """A small MDP with rows over sixteenths, some actions unavailable, and the given names."""
    n_states = draw(st.integers(1, max_states))
    n_actions = draw(st.integers(1, max_actions))
    transitions = np.zeros((n_actions, n_states, n_states))
    for s in range(n_states):
        always = draw(st.integers(0, n_actions - 1))
        for a in range(n_actions):
            if a == always or draw(st.booleans()):
                transitions[a, s] = draw(_distributions(n_states))
    return MDP.from_arrays(
        transitions,
        {name: draw(_many(_VALUES, n_states)) for name in signals},
        initial=draw(st.integers(0, n_states - 1)) if single_start else draw(_distributions(n_states)),
        labels={name: draw(_many((False, True), n_states)) for name in labels},
        action_names=[f"act{a}" for a in range(n_actions)],
    )


@st.composite
def interval_models(draw: st.DrawFn, /, **options: Any) -> MDP:
    """A small MDP with intervals over sixteenths; `options` as in `models`.

    Every row contains a distribution as in `models`, with ends up to 1/4 away; entries that were 0 may become possible,
    and lower ends may be 0.
    """
    model = draw(models(**options))
    n_actions, n_states = model.n_actions, model.n_states
    lower, upper = (np.zeros((n_actions, n_states, n_states)) for _ in range(2))
    steps = _many(tuple(range(5)), n_states).map(lambda ns: np.array(ns) / 16)
    rows = model.matrix().toarray()
    for s in range(n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            lower[model.choice_action[c], s] = np.maximum(rows[c] - draw(steps), 0)
            upper[model.choice_action[c], s] = np.minimum(rows[c] + draw(steps), 1)
    return MDP.from_intervals(lower, upper, model.signals, model.initial, model.labels, action_names=model.action_names)


@functools.cache
@st.composite
def _distributions(draw: st.DrawFn, n: int) -> NDArray[np.float64]:
    cuts = sorted(draw(_many(tuple(range(17)), n - 1)))
    return np.diff([0, *cuts, 16]) / 16


@functools.cache
def _many(values: tuple[Any, ...], n: int) -> st.SearchStrategy[list[Any]]:
    return st.lists(st.sampled_from(values), min_size=n, max_size=n)
