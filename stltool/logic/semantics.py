"""Truth and robustness of a formula at a step of a trace (docs/semantics.md §1): the slow, obvious reference.

    (s,t) ⊨ F[a,b] φ   iff  (s,u) ⊨ φ for some u in t+a … t+b          G[a,b]: for every such u
    (s,t) ⊨ φ U[a,b] ψ iff  (s,u) ⊨ ψ for some u in t+a … t+b, and (s,v) ⊨ φ for every v in t … u−1
    (s,t) ⊨ once[a,b] φ iff (s,u) ⊨ φ for some u in t−b … t−a, u ≥ 0   historically[a,b]: for every such u
    (s,t) ⊨ φ since[a,b] ψ iff (s,u) ⊨ ψ for some such u, and (s,v) ⊨ φ for every v in u+1 … t
    (s,t) ⊨ rise φ     iff  (s,t) ⊨ φ, and t = 0 or not (s,t−1) ⊨ φ

φ release[a,b] ψ is ¬(¬φ U[a,b] ¬ψ), and φ trigger[a,b] ψ is ¬(¬φ since[a,b] ¬ψ). A window of the past that lies before
step 0 is empty: once and since are false there, historically and trigger true.

Robustness replaces "some" by max, "every" by min, and predicates by signed margins. Arithmetic is exact: a double means
the decimal that it prints as (0.1 is 1/10), and roots are not rounded, so borderline cases such as x + y == 0.8 and
sqrt(x^2 + y^2) <= 0.05 are decided as written. Only powers beyond 1000, or whose exponent is no fraction with a
denominator up to 12, are computed in doubles. All else in stltool that judges traces is tested against this file.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, TypeAlias, assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import mapping, whole
from stltool.errors import NameLookupError, TraceError
from stltool.logic.algebraic import Algebraic, TooCloseError, power, root
from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    ArithmeticOperator,
    Call,
    Comparator,
    Comparison,
    Constant,
    Eventually,
    Formula,
    FunctionName,
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
    delay,
    formula_of,
    horizon,
    label_names,
    lookback,
    variables,
)
from stltool.logic.names import near_names
from stltool.logic.task import Task
from stltool.numbers import shortest

SIGNALS = "{'x': [0.1, 0.5]}"  # an example, for messages
_LARGEST_EXPONENT = 1000  # beyond it, powers are computed in doubles

Signals: TypeAlias = Mapping[str, ArrayLike]
"""name → array (n_steps,): reals for variables, Booleans (or 0 / 1) for labels."""

Real: TypeAlias = Fraction | Algebraic | float  # a float only for infinities and after a rounded power

COMPARE: dict[Comparator, Callable[[Real, Real], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
COMPUTE: dict[ArithmeticOperator, Callable[[Any, Any], Real]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "^": power,
}  # fmt: skip
CALL: dict[FunctionName, Callable[..., Real]] = {"abs": abs, "min": min, "max": max, "sqrt": root}


def satisfies(phi: Formula | Task, signals: Signals, t: int = 0) -> bool:
    """Whether the trace satisfies φ at step t.

    `signals` maps every name of φ to an array of n_steps samples. Raises TraceError if the trace ends before step
    t + horizon(φ), and NameLookupError if a name is missing.
    """
    phi, t = formula_of(phi, "satisfies' formula"), whole(t, "satisfies' step t", least=0)
    return _true(phi, _samples(phi, signals, t, "satisfies"), t)


def robustness(phi: Formula | Task, signals: Signals, t: int = 0) -> float:
    """How far the trace is from changing the truth of φ at step t.

    > 0 implies true, < 0 implies false. A label has margin +inf or -inf; `==` has -|d| and `!=` has |d|. Errors as for
    `satisfies`.
    """
    phi, t = formula_of(phi, "robustness' formula"), whole(t, "robustness' step t", least=0)
    samples = _samples(phi, signals, t, "robustness")
    return _margin(phi, t, lambda psi, at: _predicate_margin(psi, samples, at))


def time_robustness(phi: Formula | Task, signals: Signals, t: int = 0, *, most: int) -> float:
    """For how many steps the truth of φ at step t outlives changes of timing: from −most to most, ± inf by constants.

    The right time robustness of [Donze10], by min and max over the formula like robustness: a predicate's is the number
    of steps after t during which it keeps its truth, up to `most`, negative where it is false. ≥ k > 0 implies that φ
    is true even if every predicate is read up to k steps late; ≤ −k likewise of false; 0 tells nothing. Errors as for
    `satisfies`, of a trace that goes on for `most` steps.
    """
    phi, t = formula_of(phi, "time_robustness' formula"), whole(t, "time_robustness' step t", least=0)
    most = whole(most, "time_robustness' most", least=1)
    samples = _samples(Always(Interval(0, most), phi), signals, t, "time_robustness")

    def lasting(psi: Comparison | Label, at: int) -> float:
        now = _true(psi, samples, at)
        steps = 0
        while steps < most and _true(psi, samples, at + steps + 1) == now:
            steps += 1
        return steps if now else -steps

    return _margin(phi, t, lasting)


def _samples(phi: Formula, signals: Signals, t: int, caller: str) -> dict[str, NDArray[np.float64]]:
    """The arrays of the names in φ, as floats, each long enough to decide φ at t."""
    mapping(signals, f"{caller}' signals", SIGNALS)
    needed, back = t + horizon(phi) + 1, lookback(phi)
    first = 0 if back is None else max(t - back, 0)
    labels = label_names(phi)
    samples = {}
    for name, span in {**variables(phi), **labels}.items():
        if name not in signals:
            message = f"the trace has no signal {name}; {near_names(name, signals)}"
            raise NameLookupError(span.show(message) if span else message)
        values = samples_of(name, signals[name])
        if values.ndim != 1:
            raise TraceError(f"signal {name} has shape {values.shape}; a trace is one-dimensional")
        if len(values) < needed:
            raise TraceError(
                f"signal {name} has {len(values)} samples; this formula at step {t} needs {needed} "
                f"(its horizon is {horizon(phi)}); give a longer trace"
            )
        if values.dtype.kind not in "biuf":
            raise TraceError(f"signal {name} holds {values.dtype}, not numbers")
        values = values.astype(np.float64)
        window = values[first:needed]
        if np.isnan(window).any():
            raise TraceError(f"signal {name} is NaN at step {first + int(np.isnan(window).argmax())}")
        if name in labels and not np.isin(window, (0.0, 1.0)).all():
            raise TraceError(
                f"{name} is used as a label, but its signal has values other than true and false; "
                f"compare it, as in {name} > 0"
            )
        samples[name] = values
    if not samples and t + horizon(phi) > 0:
        _check_constant_length(phi, signals, needed)
    return samples


def samples_of(name: str, values: ArrayLike) -> NDArray[Any]:
    """The samples as an array of any shape; TraceError if they do not form one."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError):
        raise TraceError(f"signal {name} is not an array: its rows differ in length or are not numbers") from None


def _check_constant_length(phi: Formula, signals: Signals, needed: int) -> None:
    """A formula without names still needs a trace of sufficient length, if there is a signal to measure."""
    shortest = min((len(np.atleast_1d(samples_of(*item))) for item in signals.items()), default=needed)
    if shortest < needed:
        raise TraceError(f"the trace has {shortest} samples; {phi} needs {needed}")


def _true(phi: Formula, signal: Mapping[str, NDArray[np.float64]], t: int) -> bool:
    match phi:
        case Constant(value):
            return value
        case Label(name):
            return bool(signal[name][t])
        case Comparison() if delay(phi) > t:
            return False
        case Comparison(op, left, right):
            return _decided(phi, COMPARE[op], _value(left, signal, t), _value(right, signal, t))
        case Not(arg):
            return not _true(arg, signal, t)
        case And(args):
            return all(_true(arg, signal, t) for arg in args)
        case Or(args):
            return any(_true(arg, signal, t) for arg in args)
        case Implies(left, right):
            return not _true(left, signal, t) or _true(right, signal, t)
        case Iff(left, right):
            return _true(left, signal, t) == _true(right, signal, t)
        case Eventually(interval, arg):
            return any(_true(arg, signal, u) for u in _window(interval, t))
        case Always(interval, arg):
            return all(_true(arg, signal, u) for u in _window(interval, t))
        case Until(interval, left, right):
            return any(
                _true(right, signal, u) and all(_true(left, signal, v) for v in range(t, u))
                for u in _window(interval, t)
            )
        case Release(interval, left, right):
            return all(
                _true(right, signal, u) or any(_true(left, signal, v) for v in range(t, u))
                for u in _window(interval, t)
            )
        case Once(interval, arg):
            return any(_true(arg, signal, u) for u in _earlier(interval, t))
        case Historically(interval, arg):
            return all(_true(arg, signal, u) for u in _earlier(interval, t))
        case Since(interval, left, right):
            return any(
                _true(right, signal, u) and all(_true(left, signal, v) for v in range(u + 1, t + 1))
                for u in _earlier(interval, t)
            )
        case Trigger(interval, left, right):
            return all(
                _true(right, signal, u) or any(_true(left, signal, v) for v in range(u + 1, t + 1))
                for u in _earlier(interval, t)
            )
        case Rise(arg):
            return _true(arg, signal, t) and (t == 0 or not _true(arg, signal, t - 1))
        case _:
            assert_never(phi)


def _predicate_margin(psi: Comparison | Label, signal: Mapping[str, NDArray[np.float64]], t: int) -> float:
    match psi:
        case Label(name):
            return math.inf if signal[name][t] else -math.inf
        case Comparison(_, left, right):
            if delay(psi) > t:
                return -math.inf
            return _as_double(psi, _value(left, signal, t), _value(right, signal, t))
        case _:
            assert_never(psi)


def _margin(phi: Formula, t: int, leaf: Callable[[Comparison | Label, int], float]) -> float:
    """Robustness, where `leaf` is that of a predicate at a step."""
    match phi:
        case Constant(value):
            return math.inf if value else -math.inf
        case Comparison() | Label():
            return leaf(phi, t)
        case Not(arg):
            return -_margin(arg, t, leaf)
        case And(args):
            return min(_margin(arg, t, leaf) for arg in args)
        case Or(args):
            return max(_margin(arg, t, leaf) for arg in args)
        case Implies(left, right):
            return max(-_margin(left, t, leaf), _margin(right, t, leaf))
        case Iff(left, right):
            a, b = _margin(left, t, leaf), _margin(right, t, leaf)
            return min(max(-a, b), max(a, -b))
        case Eventually(interval, arg):
            return max(_margin(arg, u, leaf) for u in _window(interval, t))
        case Always(interval, arg):
            return min(_margin(arg, u, leaf) for u in _window(interval, t))
        case Until(interval, left, right):
            return max(
                min([_margin(right, u, leaf)] + [_margin(left, v, leaf) for v in range(t, u)])
                for u in _window(interval, t)
            )
        case Release(interval, left, right):
            return min(
                max([_margin(right, u, leaf)] + [_margin(left, v, leaf) for v in range(t, u)])
                for u in _window(interval, t)
            )
        case Once(interval, arg):
            return max((_margin(arg, u, leaf) for u in _earlier(interval, t)), default=-math.inf)
        case Historically(interval, arg):
            return min((_margin(arg, u, leaf) for u in _earlier(interval, t)), default=math.inf)
        case Since(interval, left, right):
            witnesses = (
                min([_margin(right, u, leaf)] + [_margin(left, v, leaf) for v in range(u + 1, t + 1)])
                for u in _earlier(interval, t)
            )
            return max(witnesses, default=-math.inf)
        case Trigger(interval, left, right):
            witnesses = (
                max([_margin(right, u, leaf)] + [_margin(left, v, leaf) for v in range(u + 1, t + 1)])
                for u in _earlier(interval, t)
            )
            return min(witnesses, default=math.inf)
        case Rise(arg):
            now = _margin(arg, t, leaf)
            return now if t == 0 else min(now, -_margin(arg, t - 1, leaf))
        case _:
            assert_never(phi)


def _window(interval: Interval, t: int) -> range:
    return range(t + interval.a, t + interval.last + 1)


def _decided(phi: Comparison, compare: Callable[[Real, Real], bool], left: Real, right: Real) -> bool:
    try:
        return bool(compare(left, right))
    except TooCloseError as error:
        raise _fault(phi, str(error)) from None


def _fault(node: Comparison | Term, message: str) -> TraceError:
    return TraceError(node.span.show(message) if node.span else f"{type(node).__name__}: {message}")


def _earlier(interval: Interval, t: int) -> range:
    """The steps of a window of the past, cut at step 0."""
    return range(0 if interval.b is None else max(t - interval.b, 0), t - interval.a + 1)


def _comparison_margin(op: Comparator, left: Real, right: Real) -> Real:
    if left == right:  # also inf and inf, whose difference is not a number
        return 0.0
    difference = left - right
    match op:
        case ">" | ">=":
            return difference
        case "<" | "<=":
            return -difference
        case "==":
            return min(difference, -difference)
        case "!=":
            return max(difference, -difference)
        case _:
            assert_never(op)


def _as_double(phi: Comparison, left: Real, right: Real) -> float:
    try:
        margin = float(_comparison_margin(phi.op, left, right))
        if math.isinf(margin) and not _infinite(left) and not _infinite(right):
            raise OverflowError  # of two doubles, after a rounded power
        return margin
    except OverflowError:
        message = "the margin is beyond the range of doubles; scale the signals, or ask only for truth values"
        raise _fault(phi, message) from None
    except TooCloseError as error:
        raise _fault(phi, str(error)) from None


def exact(value: float) -> Real:
    """The decimal that a double prints as, as a fraction; infinities unchanged."""
    return shortest(value) if math.isfinite(value) else float(value)


def _value(term: Term, signal: Mapping[str, NDArray[np.float64]], t: int) -> Real:
    match term:
        case Number(value):
            return exact(value)
        case Variable(name, steps):
            return exact(signal[name][t - steps])
        case Negate(arg):
            return -_value(arg, signal, t)
        case Arithmetic(op, left, right):
            return _apply(term, COMPUTE[op], _value(left, signal, t), _value(right, signal, t))
        case Call(function, args):
            values = [_value(arg, signal, t) for arg in args]
            return _apply(term, CALL[function], *values)
        case _:
            assert_never(term)


def _apply(term: Term, function: Callable[..., Real], *values: Real) -> Real:
    """The function's value, or a TraceError if it has none (1/0, sqrt(-1), an overflow, 0^-1)."""
    value: Real
    try:
        if function is power and not -_LARGEST_EXPONENT <= values[1] <= _LARGEST_EXPONENT:
            values = (float(values[0]), float(values[1]))  # too many digits: rounded instead
        value = function(*values)
    except TooCloseError as error:
        raise _fault(term, str(error)) from None
    except (ZeroDivisionError, ValueError, OverflowError):
        value = math.nan
    overflown = _infinite(value) and not any(map(_infinite, values))
    if overflown or (isinstance(value, float) and math.isnan(value)):
        shown = ", ".join(map(_shown, values))
        raise _fault(term, f"this term has no value for the operands {shown}; guard it, or change the predicate")
    return value


def _infinite(value: Real) -> bool:
    return isinstance(value, float) and math.isinf(value)


def _shown(value: Real) -> str:
    try:
        return f"{float(value):g}"
    except OverflowError:
        return "a number beyond 1e308" if value > 0 else "a number beyond -1e308"
