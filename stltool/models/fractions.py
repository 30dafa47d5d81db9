"""Probabilities as they were given: integers over one denominator, beside the doubles that approximate them.

A decimal or a fraction in a file means exactly that number, not its nearest double. A double handed over in an array
means its shortest decimal (0.1 is 1/10) where the rows then sum to 1; otherwise it means its binary value, and what a
row lacks or exceeds is the model's *defect*.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.numbers import shortest

Integers: TypeAlias = NDArray[Any]
"""int64 where numbers and their denominator are below 2^62, else Python integers in an object array."""

LARGEST_SUM = 2**62  # what sums in int64 may come to


@dataclass(frozen=True, eq=False)
class Fractions:
    """An MDP's probabilities, exactly: entry k is numerator[k] / denominator.

    numerator            (n_transitions,) integers      denominator          of all of them
    initial              (n_states,) integers           initial_denominator  of all of them
    """

    numerator: Integers = field(repr=False)
    denominator: int
    initial: Integers = field(repr=False)
    initial_denominator: int

    def defects(self, row_start: NDArray[np.int64]) -> tuple[Fraction, Fraction]:
        """The largest |Σ row − 1|, and the initial distribution's; 0 where they are distributions."""
        sums = np.add.reduceat(self.numerator, row_start[:-1])
        rows = max(abs(int(sums.max()) - self.denominator), abs(int(sums.min()) - self.denominator))
        start = abs(sum(self.initial.tolist()) - self.initial_denominator)
        return Fraction(rows, self.denominator), Fraction(start, self.initial_denominator)

    def initial_share(self, s: int) -> Fraction:
        return Fraction(int(self.initial[s]), self.initial_denominator)


def over_one(values: Iterable[Fraction]) -> tuple[Integers, int]:
    """Fractions as integers over their least common denominator."""
    known = list(values)
    denominator = math.lcm(*{value.denominator for value in known})
    found = [value.numerator * (denominator // value.denominator) for value in known]
    whole = all(abs(number) < LARGEST_SUM for number in (denominator, *found))  # so that rows can be summed
    return np.array(found, dtype=np.int64 if whole else object), denominator


def of_doubles(values: NDArray[np.float64], row_start: NDArray[np.int64]) -> tuple[Integers, int]:
    """Doubles as integers over one denominator: shortest decimals where every row of them sums to 1, else binary."""
    unique, which = np.unique(values, return_inverse=True)
    for exact in (shortest, Fraction):
        shares, denominator = over_one(exact(value) for value in unique.tolist())
        numerator = shares[which]
        if (np.add.reduceat(numerator, row_start[:-1]) == denominator).all():
            break
    return numerator, denominator
