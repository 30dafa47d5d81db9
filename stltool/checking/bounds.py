"""An enclosure of a backward induction's value that rounding cannot break (docs/semantics.md §3) [Higham02, §3.1].

All terms are nonnegative, so a value computed with n roundings along every path has V̂ = V·(1 + δ) + ε with

    |δ| ≤ γ = n·u / (1 − n·u),   u = 2⁻⁵³,        |ε| ≤ n·2⁻¹⁰⁷³ (underflow)

and max, min and verdicts add none. Hence V ∈ [(V̂ − ε)/(1 + γ), (V̂ + ε)/(1 − γ)], evaluated here in fractions and
rounded outwards. One rounding for each row entry is counted for reading decimals and fractions into doubles. Rows given
as doubles seldom sum to 1 exactly: what a row lacks or exceeds, the *defect*, may belong to any successor, so every
sweep widens the enclosure by the largest defect; then it can be cut to [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction

from stltool.models.rows import READ_EXACTLY, Rows
from stltool.numbers import round_down, round_up

_U = Fraction(1, 2**53)
_UNDERFLOW = Fraction(1, 2**1073)
_ANYTHING = Fraction(2**1100)  # more than any double


def roundings(sweeps: int, row_length: int, choices_mixed: int = 0) -> int:
    """The largest number of roundings on a path from the horizon to the result.

    A row has at most `row_length` entries: as many roundings for the dot product, and one for the entry as given. A
    mixture of `choices_mixed` choices adds a product and the additions. The initial distribution's sum counts three.
    """
    return sweeps * (row_length + 1 + choices_mixed) + 3


def defect(rows: Iterable[Iterable[float]]) -> Fraction:
    """The largest |Σ row − 1|, exactly."""
    return max((abs(sum(map(Fraction, row), Fraction(0)) - 1) for row in rows), default=Fraction(0))


def row_defect(rows: Rows) -> Fraction:
    """The largest defect of a row; an upper bound where exact sums would take long."""
    if sums_exactly(rows):
        return rows.defect
    rounding = _U * rows.longest * 2  # of summing, in any order, terms whose sum is below 2
    return Fraction(rows.missing) + rounding


def compounded(amount: Fraction, growth: Fraction) -> Fraction:
    """The total effect of errors that add up to `amount`, where the sums that carry them on exceed 1 by `growth` in
    total.

    Π(1 + g_i) ≤ e^g ≤ 1/(1 − g); where g reaches 1, nothing is known about the value.
    """
    return amount / (1 - growth) if growth < 1 else _ANYTHING


def sums_exactly(rows: Rows) -> bool:
    """Whether rows are known as fractions, or are all of a model's rows and few enough to convert at once.

    For only some of a model's doubles, the common denominator would depend on which ones they are.
    """
    return rows.given_exactly or (rows.parts is None and len(rows.target) <= READ_EXACTLY)


def can_underflow(steps: int, smallest: float) -> bool:
    """Whether a product of `steps` factors, each at least `smallest`, can leave the normal doubles (2⁻¹⁰²²)."""
    return steps * math.log2(smallest) < -1000


def enclose(
    value: float, n_roundings: int, missing: Fraction = Fraction(0), underflow: bool = True
) -> tuple[float, float]:
    """(lower, upper) around the exact value, within [0, 1]; `missing` is the defects' sum along a path."""
    lower, upper = around(value, n_roundings, missing, underflow)
    none, all_of_it = Fraction(0), Fraction(1)  # cut first: a bound on an unknown value exceeds all doubles
    return round_down(min(max(none, lower), all_of_it)), round_up(max(min(all_of_it, upper), none))


def around(
    value: float, n_roundings: int, missing: Fraction = Fraction(0), underflow: bool = True
) -> tuple[Fraction, Fraction]:
    """The same for any sum of nonnegative terms, in fractions and not cut to [0, 1]."""
    if 2 * n_roundings * _U > 1:  # nothing is known about it
        return -_ANYTHING, _ANYTHING
    gamma = n_roundings * _U / (1 - n_roundings * _U)
    slack = n_roundings * _UNDERFLOW if underflow else Fraction(0)
    return (Fraction(value) - slack) / (1 + gamma) - missing, (Fraction(value) + slack) / (1 - gamma) + missing
