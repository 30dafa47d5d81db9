"""The value of starting in each of several states: what one backward induction finds besides the value of the start.

Each is enclosed by the bounds of the whole (bounds.py, fixed.py, robust.py), without what the initial distribution
adds. With few different numbers the bounds are computed in fractions and rounded outwards once; with many, in doubles,
each operation of which is rounded outwards by moving to the next double.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import real, require
from stltool.checking.bounds import around, enclose
from stltool.checking.fixed import FixedPoint
from stltool.display import Card, Displayed, StateNames, probability_text
from stltool.errors import NameLookupError, near_misses
from stltool.models import MDP
from stltool.numbers import round_down, round_up

Floats: TypeAlias = NDArray[np.float64]
Enclosures: TypeAlias = tuple[Floats, Floats, Floats]
"""(value, lower, upper), each (k,)"""

_UNDERFLOW = Fraction(1, 2**1070)  # with room for its division by 1 − γ
_FEW = 10_000  # different numbers whose bounds are computed in fractions
_SHOWN = 10  # rows in a notebook
_SEARCHED = 10_000  # names that are searched for one that is similar


@dataclass(frozen=True)
class StateValue:
    """P if runs start in a state: lower ≤ P ≤ upper, rounding included; `fraction` is exact, if that was asked for."""

    name: str
    value: float
    lower: float
    upper: float
    fraction: Fraction | None = None


@dataclass(frozen=True, eq=False, repr=False)
class StateValues(Displayed, Sequence[StateValue]):
    """P for each of several states that runs may start in, in the order of their numbers.

    states              (k,) int64: numbers of model states, ascending
    value, lower, upper (k,) float64: lower ≤ exact value ≤ upper
    fractions           the exact values, if they were asked for

    `values["x=0"]` is that of a state by name; `values[3]` is the one at position 3.
    """

    model: MDP
    states: NDArray[np.int64]
    value: Floats
    lower: Floats
    upper: Floats
    fractions: tuple[Fraction, ...] | None = None

    def __len__(self) -> int:
        return len(self.states)

    @overload
    def __getitem__(self, which: int | str) -> StateValue: ...
    @overload
    def __getitem__(self, which: slice) -> Sequence[StateValue]: ...
    def __getitem__(self, which: int | str | slice) -> StateValue | Sequence[StateValue]:
        if isinstance(which, slice):
            return [self[i] for i in range(*which.indices(len(self)))]
        if isinstance(which, str):
            if which not in self._named:
                known = list(self._named)[:_SEARCHED]
                raise NameLookupError(f"there is no value for the state {which!r}; {near_misses(which, known)}")
            which = self._named[which]
        require(which, (int, np.integer), "a state's value", "give its name, or its position")
        i = range(len(self))[int(which)]
        fraction = self.fractions[i] if self.fractions is not None else None
        return StateValue(self.names[i], float(self.value[i]), float(self.lower[i]), float(self.upper[i]), fraction)

    @property
    def names(self) -> Sequence[str]:
        """(k,): the states' names, made on demand."""
        return StateNames(len(self.states), lambda i: self.model.state_name(int(self.states[i])))

    @cached_property
    def _named(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    @property
    def least(self) -> StateValue:
        """The first of the smallest values."""
        return self[int(self.value.argmin())]

    @property
    def greatest(self) -> StateValue:
        """The first of the greatest values."""
        return self[int(self.value.argmax())]

    def at_least(self, bound: float | Fraction) -> bool | None:
        """Whether every exact value is at least `bound`; None if that depends on a bound inside an enclosure."""
        bound = real(bound, "at_least's bound")
        least, most = self._ends(min)
        return True if least >= bound else False if most < bound else None

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether every exact value is at most `bound`; None if that depends on a bound inside an enclosure."""
        bound = real(bound, "at_most's bound")
        least, most = self._ends(max)
        return True if most <= bound else False if least > bound else None

    def _ends(self, pick: Callable[..., Any]) -> tuple[Any, Any]:
        """Bounds on the least or the greatest of the exact values."""
        if self.fractions is not None:
            return (pick(self.fractions),) * 2
        return float(pick(self.lower)), float(pick(self.upper))

    def _card(self) -> Card:
        shown = [self[i] for i in range(min(_SHOWN, len(self)))]
        rows = [(each.name, probability_text(each.value), repr(each.lower), repr(each.upper)) for each in shown]
        least, greatest = self.least, self.greatest
        return Card(
            f"StateValues: P from each of {len(self)} states, {least.value:.6g} to {greatest.value:.6g}",
            [{"least": least.name, "greatest": greatest.name}, {"model": self.model.name}],
            (("state", "P", "lower", "upper"), rows),
            more=max(0, len(self) - _SHOWN),
        )


def of_doubles(
    values: Floats, certain: NDArray[np.bool_], n_roundings: int, missing: Fraction, underflow: bool
) -> Enclosures:
    """The enclosures of values computed in doubles; the arguments are those of `bounds.enclose`."""

    def roughly(values: Floats) -> tuple[Floats, Floats]:
        low, high = around(1.0, n_roundings, Fraction(0), underflow=False)  # a value's bounds are multiples of it
        if high > 2:
            return np.zeros_like(values), np.ones_like(values)
        slack = round_up(min(missing, Fraction(2)) + (n_roundings * _UNDERFLOW if underflow else 0))
        below = _down(_down(values * round_down(low)) - slack)
        above = _up(_up(values * round_up(high)) + slack)
        return below, above

    def exactly(value: float) -> tuple[float, float]:
        return enclose(value, n_roundings, missing, underflow)

    lower, upper = _enclosed(values, exactly, roughly)
    return _with_certain(np.clip(values, 0, 1), lower, upper, certain)


def of_units(units: NDArray[np.int64], certain: NDArray[np.bool_], scale: FixedPoint, horizon: int) -> Enclosures:
    """The enclosures of values in fixed point."""
    below = scale.roundings(horizon)

    def exactly(unit: int) -> tuple[float, float]:
        least = max(Fraction(int(unit) - below, scale.one), Fraction(0))
        return round_down(least), round_up(Fraction(int(unit), scale.one))

    def roughly(units: NDArray[np.int64]) -> tuple[Floats, Floats]:
        one = float(scale.one)  # it, a number of units, and their quotient are rounded once each
        return _down(np.maximum(units - below, 0) / one, 4), _up(units / one, 4)

    lower, upper = _enclosed(units, exactly, roughly)
    middle = np.where(upper == 1, upper, (lower + upper) / 2)
    return _with_certain(middle, lower, upper, certain, goal=units > 0)


def of_fractions(values: Sequence[Fraction]) -> Enclosures:
    """The doubles around exact values."""
    ends = {value: (float(value), round_down(value), round_up(value)) for value in set(values)}
    table = np.array([ends[value] for value in values]).reshape(-1, 3)
    return table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy()


def _enclosed(
    values: NDArray[Any],
    exactly: Callable[[Any], tuple[float, float]],
    roughly: Callable[[NDArray[Any]], tuple[Floats, Floats]],
) -> tuple[Floats, Floats]:
    known, which = np.unique(values, return_inverse=True)
    if len(known) <= _FEW:
        ends = np.array([exactly(value) for value in known.tolist()]).reshape(-1, 2)[which.ravel()]
        return ends[:, 0].copy(), ends[:, 1].copy()
    lower, upper = roughly(values)
    return np.clip(lower, 0, 1), np.clip(upper, 0, 1)


def _with_certain(
    value: Floats, lower: Floats, upper: Floats, certain: NDArray[np.bool_], goal: NDArray[np.bool_] | None = None
) -> Enclosures:
    """Values that the graph alone decides are 0 or 1, without any rounding."""
    surely = ((value > 0) if goal is None else goal).astype(np.float64)
    return np.where(certain, surely, value), np.where(certain, surely, lower), np.where(certain, surely, upper)


def _down(values: Floats, n: int = 1) -> Floats:
    for _ in range(n):
        values = np.nextafter(values, -np.inf)
    return values


def _up(values: Floats, n: int = 1) -> Floats:
    for _ in range(n):
        values = np.nextafter(values, np.inf)
    return values
