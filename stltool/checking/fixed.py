"""Enclosures from int64 fixed point, if the model's probabilities have a small common denominator D.

Values are integers U in units of 1/one, rounded up in every sweep: U_t = opt_c ⌈Σ n·U_{t+1} / D⌉, so U ≥ V always. Rows
sum to 1, so each sweep that rounds adds less than one unit:

    U_0 − (h − j) ≤ one · V_0 ≤ U_0,      one = m·D^j with D·one ≤ 2^62

The first j sweeps do not round at all, since D^j divides `one`; with h ≤ j the value is the exact fraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from stltool.checking.bounds import sums_exactly
from stltool.models import MDP
from stltool.models.fractions import LARGEST_SUM
from stltool.models.rows import Rows
from stltool.numbers import round_down, round_up

_LARGEST_DENOMINATOR = 2**31


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """`denominator` of the rows' numerators; `one` is the unit; `exact_sweeps` is j."""

    denominator: int
    one: int
    exact_sweeps: int

    def roundings(self, horizon: int) -> int:
        """The largest number of units by which a value can be below its U."""
        return 0 if self.denominator == 1 else max(0, horizon - self.exact_sweeps)

    def enclose(self, model: MDP, horizon: int, entry: NDArray[np.int64]) -> tuple[float, float, float]:
        """(value, lower, upper) from U_0 at the initial states, in their order."""
        start = np.flatnonzero(model.initial).tolist()
        upper = sum(model.initial_share(s) * int(u) for s, u in zip(start, entry, strict=True)) / Fraction(self.one)
        lower = max(upper - Fraction(self.roundings(horizon), self.one), Fraction(0))
        middle = upper if upper == 1 else (lower + upper) / 2
        return float(middle), round_down(lower), round_up(upper)


def fixed_point(model: MDP, kinds: Rows | None = None) -> FixedPoint | None:
    """The fixed-point format for a model, or None if its probabilities have no small common denominator.

    kinds   rows that represent all relevant rows, if known
    """
    rows = kinds if kinds is not None else model.kinds if model.kinds is not None else model.rows
    if not sums_exactly(rows) or rows.denominator >= _LARGEST_DENOMINATOR or rows.defect or model.initial_defect:
        return None
    D = rows.denominator
    one, exact_sweeps = 1, 0
    while D > 1 and one * D**2 <= LARGEST_SUM:
        one, exact_sweeps = one * D, exact_sweeps + 1
    one *= LARGEST_SUM // (one * D)
    return FixedPoint(D, one, exact_sweeps)
