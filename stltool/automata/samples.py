"""Synthetic traces on which a formula is evaluated at every occurrence: cheap evidence before an automaton is built.

A trace that satisfies φ shows that it can hold; a trace on which φ changes its truth when an occurrence is replaced by
a constant shows that the occurrence is not vacuous. Traces that show neither prove nothing.

    F[a,b] x at t   a 1 among x_{t+a} … x_{t+b}: two prefix sums
    x U[a,b] y      a 1 among y_{t+a} … y_{min(t+b, f)} with f ≥ t the first step at which x fails
    once, since     mirrored, from step 0 on

The traces have one letter throughout, except for up to three blocks of others: constant traces, pulses, switches.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.automata.reachable import Effort
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
)
from stltool.logic.occurrences import Occurrence
from stltool.sizes import Numbers, integer_type

Truth: TypeAlias = NDArray[np.bool_]
"""(n_steps, n_traces): truth at every step that the traces decide."""

_MOST_TRACES = 1024
_MOST_CELLS = 10_000_000  # truth values of all occurrences on all traces


class Samples:
    """Traces over given letters, and the truth of every occurrence of a formula along them."""

    def __init__(
        self, places: Sequence[Occurrence], columns: dict[Formula, int], valuations: NDArray[np.bool_], n_steps: int
    ) -> None:
        """`valuations` (n, n_leaves) are the letters, `columns` the column of each label and comparison in them.

        If the traces would be too long for a table of all occurrences, there are none.
        """
        self.places = places
        n_traces = min(_MOST_TRACES, _MOST_CELLS // (len(places) * n_steps))
        self.letters = _traces(len(valuations), n_steps, n_traces) if n_traces else np.empty((0, 0), dtype=np.int64)
        self._truth: list[Truth] = [np.empty((1, 0), dtype=np.bool_)] * len(places)
        self._holding: dict[int, Numbers] = {}  # the number of operands of an And or an Or that hold
        for i in range(len(places) - 1, -1, -1) if n_traces else ():  # operands come after their operator
            phi = places[i].formula
            match phi:
                case Label() | Comparison():
                    self._truth[i] = valuations[self.letters, columns[phi]]
                case Constant(value):
                    self._truth[i] = np.full(self.letters.shape, value)
                case And() | Or():
                    self._holding[i] = _count([self._truth[j] for j in places[i].operands])
                    self._truth[i] = _junction(phi, self._holding[i])
                case _:
                    self._truth[i] = truth_along(phi, [self._truth[j] for j in places[i].operands])

    @property
    def verdicts(self) -> NDArray[np.bool_]:
        """(n_traces,): the truth of the formula on each trace."""
        verdicts: NDArray[np.bool_] = self._truth[0][0]
        return verdicts

    def notice(self, place: int, constant: bool, effort: Effort) -> bool:
        """Whether a constant in place of this occurrence changes the truth on some trace. SizeError beyond `effort`."""
        changed = np.full_like(self._truth[place], constant)
        while not np.array_equal(changed, self._truth[place]):
            effort.spend_cells(changed.size // 4)
            if place == 0:
                return not np.array_equal(changed[0], self._truth[0][0])
            parent = self.places[place].parent
            phi = self.places[parent].formula
            if isinstance(phi, And | Or):  # in time independent of the other operands
                holding = self._holding[parent]
                n = len(holding)
                changed = _junction(phi, holding - self._truth[place][:n] + changed[:n])
            else:
                operands = [changed if j == place else self._truth[j] for j in self.places[parent].operands]
                changed = truth_along(phi, operands)
            place = parent
        return False


def _traces(n_letters: int, n_steps: int, n_traces: int) -> NDArray[np.int64]:
    """(n_steps, n_traces) letters, the same in every call."""
    rng = np.random.default_rng(0)

    def some_letters() -> NDArray[np.int64]:
        """Early ones more often: those are the extreme assignments."""
        return (n_letters * rng.random(n_traces) ** 2).astype(np.int64)

    letters = np.tile(some_letters(), (n_steps, 1))
    constant = min(n_letters, n_traces // 2)
    letters[:, :constant] = np.arange(constant)
    steps = np.arange(n_steps)[:, None]
    for chance in (1.0, 0.5, 0.25):
        length = np.exp(rng.random(n_traces) * np.log(n_steps + 1))  # short and long ones alike
        start = np.floor(rng.random(n_traces) * (n_steps + length) - length)
        inside = (steps >= start) & (steps <= start + length) & (rng.random(n_traces) < chance)
        inside[:, :constant] = False
        letters = np.where(inside, some_letters(), letters)
    return letters


def truth_along(phi: Formula, operands: Sequence[Truth]) -> Truth:
    """The truth of φ, given that of its operands, at every step that they decide."""
    n = min(len(x) for x in operands)
    match phi:
        case Not():
            return ~operands[0]
        case And() | Or():
            return _junction(phi, _count(operands))
        case Implies():
            return ~operands[0][:n] | operands[1][:n]
        case Iff():
            same: Truth = operands[0][:n] == operands[1][:n]
            return same
        case Eventually(interval, _):
            return _some(interval, operands[0])
        case Always(interval, _):
            return ~_some(interval, ~operands[0])
        case Until(interval, _, _):
            return _until(interval, operands[0][:n], operands[1][:n])
        case Release(interval, _, _):
            return ~_until(interval, ~operands[0][:n], ~operands[1][:n])
        case Once(interval, _):
            return _earlier(interval, operands[0])
        case Historically(interval, _):
            return ~_earlier(interval, ~operands[0])
        case Since(interval, _, _):
            return _since(interval, operands[0][:n], operands[1][:n])
        case Trigger(interval, _, _):
            return ~_since(interval, ~operands[0][:n], ~operands[1][:n])
        case Rise():
            rising: Truth = operands[0].copy()
            rising[1:] &= ~operands[0][:-1]
            return rising
        case Constant() | Label() | Comparison():
            raise AssertionError("it has no operands")
        case _:
            assert_never(phi)


def _count(operands: Sequence[Truth]) -> Numbers:
    n = min(len(x) for x in operands)
    holding: Numbers = operands[0][:n].astype(integer_type(len(operands)))
    for x in operands[1:]:
        holding += x[:n]
    return holding


def _junction(phi: And | Or, holding: Numbers) -> Truth:
    """The truth of an And or an Or, given the number of its operands that hold."""
    found: Truth = holding == len(phi.args) if isinstance(phi, And) else holding > 0
    return found


def _before(x: Truth) -> Numbers:
    """How often x held before each step, (n_steps + 1, n_traces)."""
    counts: Numbers = np.zeros((len(x) + 1, *x.shape[1:]), dtype=integer_type(len(x)))
    np.cumsum(x, axis=0, out=counts[1:])
    return counts


def _some(interval: Interval, x: Truth) -> Truth:
    counts, n = _before(x), len(x) - interval.last
    found: Truth = counts[interval.last + 1 :] > counts[interval.a : interval.a + n]
    return found


def _until(interval: Interval, left: Truth, right: Truth) -> Truth:
    n = len(left) - interval.last
    steps = np.arange(len(left), dtype=np.int64)[:, None]
    fails = np.minimum.accumulate(np.where(left, len(left), steps)[::-1], axis=0)[::-1]
    end = np.minimum(fails[:n], steps[:n] + interval.last)
    counts = _before(right)
    found: Truth = np.take_along_axis(counts, end + 1, axis=0) > counts[interval.a : interval.a + n]
    return found


def _earlier(interval: Interval, x: Truth) -> Truth:
    """Whether x held in a window of the past; before step 0 it did not."""
    counts, steps = _before(x), np.arange(len(x))
    start = np.zeros_like(steps) if interval.b is None else np.maximum(steps - interval.b, 0)
    found: Truth = counts[np.maximum(steps - interval.a + 1, 0)] > counts[start]
    return found & (steps >= interval.a)[:, None]


def _since(interval: Interval, left: Truth, right: Truth) -> Truth:
    """A witness lies in the window and not before the last step at which `left` failed."""
    steps = np.arange(len(left), dtype=np.int64)[:, None]
    fails = np.maximum.accumulate(np.where(left, -1, steps), axis=0)
    start = np.maximum(fails, 0 if interval.b is None else steps - interval.b)
    counts = _before(right)
    stop = np.maximum(steps - interval.a + 1, 0)
    window = np.take_along_axis(counts, np.broadcast_to(stop, left.shape), axis=0)
    found: Truth = window > np.take_along_axis(counts, np.maximum(start, 0), axis=0)
    return found & (stop > start)
