"""Strategies for traces: within ranges, with a bounded change from step to step, or with a wanted verdict."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import strategies as st

from stltool.arguments import described, mapping, whole
from stltool.display import cut
from stltool.errors import NameLookupError, SettingsError, near_misses
from stltool.logic.formula import Formula, Not, bounded_formula_of, variables
from stltool.logic.regions import Choices, Draw, Range, Span
from stltool.logic.task import Task
from stltool.numbers import Exactable, NumberError, exact, shortest
from stltool.testing.constructive import Constructor, near
from stltool.testing.names import LABELS, SIGNALS, VALUES, Signals, by, many
from stltool.testing.ranges import Limits, range_of, ranges_of
from stltool.testing.trace import Trace


def traces(
    steps: int | st.SearchStrategy[int],
    labels: Sequence[str] | None = None,
    signals: Signals = SIGNALS,
    most_change: Mapping[str, Exactable] | None = None,
) -> st.SearchStrategy[Trace]:
    """Traces: name → array (n_steps,).

    steps        their number, or a strategy of it
    labels       names of Boolean signals; by default a, b, c, or none if `signals` has ranges
    signals      names, whose few values exercise borders; or name → range: a pair (lowest, highest), from which
                 decimals with few digits are drawn, or any strategy of numbers, such as st.floats(0, 9)
    most_change  name → how far the signal moves from one step to the next at most. It moves towards each value that its
                 strategy draws, so with a strategy that has gaps, such as st.sampled_from, values in the gaps occur

    Raises SettingsError for ranges and changes that are none.
    """
    if not isinstance(steps, st.SearchStrategy):
        steps = st.just(whole(steps, "traces' steps", least=0))
    ranged = isinstance(signals, Mapping)
    names = tuple(labels) if labels is not None else () if ranged else LABELS
    given = dict(mapping(signals, "traces' signals", "{'x': (0, 9)}")) if isinstance(signals, Mapping) else {}
    columns: dict[str, Range | st.SearchStrategy[Any] | None] = dict.fromkeys(signals)
    for name, limits in given.items():
        columns[name] = limits if isinstance(limits, st.SearchStrategy) else range_of(name, limits)
    return _traces(steps, names, columns, _changes(most_change, given))


def _changes(most_change: Mapping[str, Exactable] | None, ranged: Mapping[str, object]) -> dict[str, Fraction]:
    found = {}
    for name, change in mapping(most_change, "traces' most_change", "{'x': 0.5}", optional=True).items():
        if name not in ranged:
            raise NameLookupError(f"most_change names {name}, which has no range; {near_misses(name, ranged)}")
        try:
            found[name] = exact(change)
        except NumberError as error:
            raise SettingsError(f"most_change of {name}: {error}") from None
        if found[name] < 0:
            raise SettingsError(f"most_change of {name} is {change}; give 0 or more")
    return found


@st.composite
def _traces(
    draw: st.DrawFn,
    steps: st.SearchStrategy[int],
    labels: tuple[str, ...],
    columns: Mapping[str, Range | st.SearchStrategy[Any] | None],
    changes: Mapping[str, Fraction],
) -> Trace:
    n = draw(steps)
    trace = Trace()
    for name in labels:
        trace[name] = np.array(draw(many((False, True), n)), dtype=np.bool_)
    for name, values in columns.items():
        if values is None:
            column: list[float] = draw(many(VALUES, n))
        elif isinstance(values, st.SearchStrategy):
            column = [_number(name, draw(values)) for _ in range(n)]
            if name in changes:
                column = slowed(column, changes[name])
        else:
            column = _within(by(draw), values, n, changes.get(name))
        trace[name] = np.array(column, dtype=np.float64)
    return trace


def _within(draw: Draw, limits: Range, n: int, change: Fraction | None) -> list[float]:
    span, column = Span(*limits), list[Fraction]()
    for _ in range(n):
        if column and change is not None:
            low, high = column[-1] - change, column[-1] + change
            span = Span(
                low if limits[0] is None else max(low, limits[0]), high if limits[1] is None else min(high, limits[1])
            )
        choices = Choices.within(span)
        column.append(choices.pick(draw) if choices is not None else column[-1])
    return list(map(float, column))


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise SettingsError(f"the strategy of {name} drew {described(value)}; give one of finite numbers")
    number = float(value)
    if not np.isfinite(number):
        raise SettingsError(f"the strategy of {name} drew {number}; exclude it: allow_nan=False, allow_infinity=False")
    return number


def slowed(towards: Sequence[float], change: Fraction) -> list[float]:
    """From the first value towards each of the others, by at most `change`, in exact decimals."""
    column = [towards[0]]
    for goal in towards[1:]:
        here = shortest(column[-1])
        wanted = min(max(shortest(goal), here - change), here + change)
        value = float(wanted)
        while abs(shortest(value) - here) > change:  # rounded away from here
            value = float(np.nextafter(value, column[-1]))
        column.append(value)
    return column


# -------------------------------------------------------------------------------------------------- a wanted verdict


def satisfying_traces(
    phi: Formula | Task,
    signals: Mapping[str, Limits] | None = None,
    labels: Sequence[str] = (),
    steps: int | None = None,
    within: Exactable | None = None,
    most_change: Mapping[str, Exactable] | None = None,
) -> st.SearchStrategy[Trace]:
    """Traces on which φ holds at step 0, built without rejecting any (testing/constructive.py).

    signals  name → range, as in `traces`: pairs and st.floats(lowest, highest); a signal of φ without one has no
             limits. Signals and `labels` that φ does not read are in the traces, too
    steps    of a trace: at least horizon + 1, the default
    within   near misses: robustness at most this, and at least 0
    most_change   name → how far the signal moves from one step to the next at most, exactly (testing/slow.py); of
             signals that are compared with numbers alone, linearly

    The step at which the verdict becomes certain is uniform over those that are possible, and shrinks to the first.
    Comparisons are solved exactly if they are linear, with abs, min and max; others from a table of points, in which
    values may be missing. Raises InfeasibleError if there is no such trace (or, with others, if none was found),
    SettingsError if a comparison reads several steps or a range is none, SizeError for formulas that are too large.
    """
    return _with_verdict(phi, True, signals, labels, steps, within, most_change, "satisfying_traces")


def violating_traces(
    phi: Formula | Task,
    signals: Mapping[str, Limits] | None = None,
    labels: Sequence[str] = (),
    steps: int | None = None,
    within: Exactable | None = None,
    most_change: Mapping[str, Exactable] | None = None,
) -> st.SearchStrategy[Trace]:
    """Traces on which φ fails at step 0; with `within`, robustness is at most 0, and at least −within.

    Everything else as in `satisfying_traces`.
    """
    return _with_verdict(phi, False, signals, labels, steps, within, most_change, "violating_traces")


def _with_verdict(
    phi: Formula | Task, verdict: bool, signals: Mapping[str, Limits] | None, labels: Sequence[str],
    steps: int | None, within: Exactable | None, most_change: Mapping[str, Exactable] | None, door: str,
) -> st.SearchStrategy[Trace]:  # fmt: skip
    formula = bounded_formula_of(phi, f"{door}' formula")
    ranges = ranges_of(signals, f"{door}' signals")
    wanted = f"{'satisfies' if verdict else 'violates'} {cut(str(formula), 100)}"
    goal: Formula = formula if verdict else Not(formula)
    if within is not None:
        try:
            epsilon = exact(within)
        except NumberError as error:
            raise SettingsError(f"within: {error}; give a robustness, 0.1") from None
        if epsilon < 0:
            raise SettingsError(f"within is {within}; give 0 or more")
        goal = near(goal, epsilon)
        wanted += f" with robustness within {within} of 0,"
    changes = _changes(most_change, {**ranges, **variables(formula)})
    made = _constructor(goal, tuple(ranges.items()), tuple(labels), wanted, tuple(changes.items()))
    if steps is not None:
        steps = whole(steps, f"{door}' steps", least=made.horizon + 1)
    return _built(made, steps)


@functools.lru_cache(maxsize=32)
def _constructor(
    goal: Formula, ranges: tuple[tuple[str, Range], ...], labels: tuple[str, ...], wanted: str,
    changes: tuple[tuple[str, Fraction], ...],
) -> Constructor:  # fmt: skip
    return Constructor(goal, dict(ranges), labels, wanted, dict(changes))


@st.composite
def _built(draw: st.DrawFn, made: Constructor, steps: int | None) -> Trace:
    return Trace(made.build(by(draw), steps))
