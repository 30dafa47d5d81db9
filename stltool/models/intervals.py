"""Transition probabilities known up to intervals, and a distribution inside them.

Row c of an interval MDP is the polytope

    P(c) = { p :  lower_k ≤ p_k ≤ upper_k for every entry k,  Σ_k p_k = 1 },       not empty: Σ lower ≤ 1 ≤ Σ upper

with one polytope per choice, independent of the others: (s,a)-rectangular uncertainty. In its nominal distribution,
every entry lies the same fraction r of its width above its lower end:

    p_k = lower_k + r·(upper_k − lower_k),        r = (1 − Σ lower) / Σ width.

Source: [Givan00].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.models.fractions import Integers, Shares, decimals_of, doubles_of

Floats: TypeAlias = NDArray[np.float64]

_UNITS = 10**15
_TOLERANCE = 1e-9  # by how much ends read as doubles may violate Σ lower ≤ 1 ≤ Σ upper


@dataclass(frozen=True, eq=False)
class Intervals:
    """lower, upper (n_transitions,): the ends of each entry of a model's rows, in the order of its `target`.

    A lower end may be 0: nature can then avoid that successor. The model built from the intervals validates them.

    given    the same ends as given in fractions or decimals; None: in doubles, which mean their shortest decimals
    rounded  whether the ends as given were not kept, so that nothing can be computed with them exactly
    """

    lower: Floats = field(repr=False)
    upper: Floats = field(repr=False)
    given: tuple[Shares, Shares] | None = field(default=None, repr=False)
    rounded: bool = False

    @classmethod
    def of_shares(cls, lower: Shares, upper: Shares) -> Intervals:
        """Ends that are known exactly."""
        low, high = (doubles_of(each.numerator, each.denominator) for each in (lower, upper))
        return cls(low, high, (lower, upper))

    @cached_property
    def exact(self) -> tuple[Integers, Integers, int]:
        """(lower, upper, denominator): the ends exactly, as integers over one denominator.

        Raises ModelError if they were rounded when they were read.
        """
        if self.rounded:
            raise ModelError(
                "the ends of the intervals were rounded when they were read, so there is no exact answer or "
                "certificate; write them in at most 15 digits, or load them from a .drn or .umb file"
            )
        lower, upper = self.given or map(decimals_of, (self.lower, self.upper))
        denominator = math.lcm(lower.denominator, upper.denominator)
        scaled = [each.numerator.astype(object) * (denominator // each.denominator) for each in (lower, upper)]
        return scaled[0], scaled[1], denominator

    def at(self, index: NDArray[Any]) -> Intervals:
        """Those of the entries with these indices, or where a mask is true."""
        given = self.given
        if given is not None:
            lower, upper = (Shares(each.numerator[index], each.denominator) for each in given)
            given = lower, upper
        return Intervals(self.lower[index], self.upper[index], given, self.rounded)

    def nominal(self, row_start: NDArray[np.int64]) -> Floats:
        """The nominal distribution of every row (n_transitions,); entries that must be 0 are 0.

        In decimals of 15 digits whose rows sum to 1 exactly, so that the nominal model has exact answers too.
        """
        width = self.upper - self.lower
        total = np.add.reduceat(width, row_start[:-1])
        missing = 1 - np.add.reduceat(self.lower, row_start[:-1])
        with np.errstate(invalid="ignore"):  # NaN ends are refused by the model, which can name them
            share = np.clip(np.divide(missing, total, out=np.zeros_like(total), where=total > 0), 0, 1)
        inside = self.lower + np.repeat(share, np.diff(row_start)) * width
        return _in_decimals(np.nan_to_num(inside), np.nan_to_num(self.upper - inside), row_start)

    def validate(
        self, row_start: NDArray[np.int64], nominal: Floats, at: Callable[[int], str], to: Callable[[int], str]
    ) -> None:
        """ModelError, naming state and action, unless every row contains a distribution and `nominal` lies inside.

        `at` and `to` name a choice and the successor of an entry, in the user's names.
        """

        def choice_of(entry: int) -> int:
            return int(np.searchsorted(row_start, entry, side="right")) - 1

        shape = (int(row_start[-1]),)
        for what, ends in (("lower", self.lower), ("upper", self.upper)):
            if ends.shape != shape:
                raise ModelError(
                    f"the {what} ends have shape {ends.shape}; one for each of {shape[0]} entries is needed"
                )
        bad = np.flatnonzero(~((self.lower >= 0) & (self.lower <= self.upper) & (self.upper <= 1) & (self.upper > 0)))
        if bad.size:
            k = int(bad[0])
            raise ModelError(
                f"{at(choice_of(k))}: [{self.lower[k]:.12g}, {self.upper[k]:.12g}] to state {to(k)} is not an interval "
                "of probabilities; write 0 <= lower <= upper <= 1, and leave out what cannot happen"
            )
        for ends, wrong, says in (
            (self.lower, 1, "lower ends sum to {:.12g}, more than 1; lower one of them"),
            (self.upper, -1, "upper ends sum to {:.12g}, less than 1; raise one of them"),
        ):
            sums = np.add.reduceat(ends, row_start[:-1])
            empty = np.flatnonzero((sums - 1) * wrong > _TOLERANCE)
            if empty.size:
                raise ModelError(f"{at(int(empty[0]))}: the {says.format(sums[empty[0]])}")
        outside = np.flatnonzero(~((self.lower - _TOLERANCE <= nominal) & (nominal <= self.upper + _TOLERANCE)))
        if outside.size:
            k = int(outside[0])
            raise ModelError(
                f"{at(choice_of(k))}: the probability {nominal[k]:.12g} to state {to(k)} is outside "
                f"[{self.lower[k]:.12g}, {self.upper[k]:.12g}]; compute a model's probabilities with Intervals.nominal"
            )


def _in_decimals(values: Floats, room: Floats, row_start: NDArray[np.int64]) -> Floats:
    """Rounded down to 15 digits; what a row then lacks of 1 is added to the entry with the most room above it."""
    units = np.floor(values * _UNITS + 1e-3).astype(np.int64)  # an integer up to rounding stays
    length = np.diff(row_start)
    first = np.flatnonzero(room == np.repeat(np.maximum.reduceat(room, row_start[:-1]), length))
    first = first[np.searchsorted(first, row_start[:-1])]
    units[first] += _UNITS - np.add.reduceat(units, row_start[:-1])
    decimals: Floats = units / _UNITS
    return decimals
