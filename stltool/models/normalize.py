"""Rows that miss 1 only by rounding → rows that sum to 1 exactly, so that exact answers exist.

Fractions and decimals are taken as given, doubles as their shortest decimals. A row that sums to 1 is kept. In others,
with d = |1 − Σ| and δ = max(d, 2⁻⁵⁰),

    1. each entry becomes the fraction of denominator at most N = min(1000, ⌊1/√(2δ)⌋) that lies within δ of it (there
       is at most one), if all entries have one and these sum to 1: 0.3333333333333333 becomes 1/3;
    2. otherwise, each is divided by Σ and rounded down to 18 decimals (more if the smallest entry needs them), and the
       remainder is added to the largest entry.

A row that misses 1 by more than `MOST_MISSING` is not a matter of rounding, and is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.models.fractions import Integers, over_one
from stltool.numbers import number_text

MOST_MISSING = Fraction(1, 1000)
HINT = (
    "rows that miss 1 only by rounding are rescaled on request: normalize=True (on the command line --normalize, in a "
    "model file normalize = true)"
)
_ROUNDING = Fraction(1, 2**50)
_LARGEST_DENOMINATOR = 1000
_DIGITS, _LEAST_DIGITS = 18, 6  # decimals, and significant digits of the smallest entry


NOTHING = "normalize changed nothing: the model's probabilities are {}"  # intervals, unknown


@dataclass(frozen=True)
class Rescaled:
    """What was done to a model: how many of its rows were rescaled, and the largest change of an entry."""

    rows: int
    of: int
    largest: Fraction

    def __add__(self, other: Rescaled) -> Rescaled:
        return Rescaled(self.rows + other.rows, self.of + other.of, max(self.largest, other.largest))

    def __str__(self) -> str:
        if not self.rows:
            return "normalize changed nothing: all probabilities sum to 1 exactly"
        return (
            f"normalize rescaled {self.rows} of {self.of} distributions to sum to 1 exactly; no probability changed by "
            f"more than {float(self.largest):.2g}"
        )


def rescale(
    shares: tuple[Integers, int], row_start: NDArray[np.int64], place: Callable[[int], str]
) -> tuple[tuple[Integers, int], Rescaled]:
    """The entries (integers over one denominator) with every row summing to 1, and what was done.

    `place` names a row. Raises ModelError for the first row that misses 1 by more than rounding.
    """
    numerator, denominator = shares
    sums = np.add.reduceat(numerator, row_start[:-1])
    wrong = np.flatnonzero(sums != denominator).tolist()
    if not wrong:
        return shares, Rescaled(0, len(sums), Fraction(0))
    entries = [Fraction(n, denominator) for n in numerator.tolist()]
    known: dict[tuple[int, ...], list[Fraction]] = {}
    largest = Fraction(0)
    for row in wrong:
        part = slice(int(row_start[row]), int(row_start[row + 1]))
        given = tuple(numerator[part].tolist())
        if given not in known:
            known[given] = rescaled(given, denominator, place(row))
            largest = max(largest, *(abs(a - b) for a, b in zip(entries[part], known[given], strict=True)))
        entries[part] = known[given]
    return over_one(entries), Rescaled(len(wrong), len(sums), largest)


def rescaled(row: Sequence[int], one: int, where: str) -> list[Fraction]:
    """The entries of a row, given over the denominator `one`, changed to sum to 1; entries 0 stay 0."""
    total = sum(row)
    missing = Fraction(abs(one - total), one)
    if missing > MOST_MISSING:
        raise ModelError(
            f"{where}: the probabilities sum to {total / one:.12g}, not 1; normalize rescales rows that miss 1 by at "
            f"most {number_text(MOST_MISSING)}, as by rounding; correct this row"
        )
    positive = [entry for entry in row if entry]
    found = iter(_small([Fraction(entry, one) for entry in positive], max(missing, _ROUNDING)) or _decimals(positive))
    return [next(found) if entry else Fraction(0) for entry in row]


def _small(row: list[Fraction], within: Fraction) -> list[Fraction] | None:
    """Fractions of small denominators near the entries; None unless there are some that sum to 1."""
    most = min(_LARGEST_DENOMINATOR, math.isqrt(math.floor(1 / (2 * within))))
    near: list[Fraction] = []
    for entry in row:
        near.append(entry.limit_denominator(most))
        if near[-1] <= 0 or abs(near[-1] - entry) > within:
            return None
    return near if sum(near) == 1 else None


def _decimals(row: list[int]) -> list[Fraction]:
    total = sum(row)
    one = 10 ** max(_DIGITS, len(str(total // min(row))) + _LEAST_DIGITS)
    units = [entry * one // total for entry in row]
    units[row.index(max(row))] += one - sum(units)
    return [Fraction(unit, one) for unit in units]
