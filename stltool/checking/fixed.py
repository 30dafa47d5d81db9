"""Enclosures from int64 fixed point, where the model's probabilities share a small denominator D.

Values are integers U in units of 1/one, every sweep rounded up: U_t = opt_c ⌈Σ n·U_{t+1} / D⌉, so U ≥ V always, and
as rows sum to 1 each sweep that rounds adds less than one unit:

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
from stltool.numbers import round_down, round_up

_LARGEST_DENOMINATOR = 2**31


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """numerator (n_transitions,) int64 over `denominator`; `one` is the unit; `exact_sweeps` is j."""

    numerator: NDArray[np.int64]
    denominator: int
    one: int
    exact_sweeps: int

    def roundings(self, horizon: int) -> int:
        """The most units by which a value can lie below its U."""
        return 0 if self.denominator == 1 else max(0, horizon - self.exact_sweeps)

    def enclose(self, model: MDP, horizon: int, entry: NDArray[np.int64]) -> tuple[float, float, float]:
        """(value, lower, upper) from U_0 at the initial states, in their order."""
        exact = model.exact()
        start = np.flatnonzero(model.initial).tolist()
        upper = sum(exact.initial_share(s) * int(u) for s, u in zip(start, entry, strict=True)) / Fraction(self.one)
        lower = max(upper - Fraction(self.roundings(horizon), self.one), Fraction(0))
        middle = upper if upper == 1 else (lower + upper) / 2
        return float(middle), round_down(lower), round_up(upper)


def fixed_point(model: MDP) -> FixedPoint | None:
    """The fixed point of a model, or None where its probabilities do not share a small denominator."""
    if not sums_exactly(model):
        return None
    exact = model.exact()
    if exact.denominator >= _LARGEST_DENOMINATOR or any(exact.defects(model.row_start)):
        return None
    one, exact_sweeps = 1, 0
    while exact.denominator > 1 and one * exact.denominator**2 <= LARGEST_SUM:
        one, exact_sweeps = one * exact.denominator, exact_sweeps + 1
    one *= LARGEST_SUM // (one * exact.denominator)
    return FixedPoint(exact.numerator.astype(np.int64), exact.denominator, one, exact_sweeps)
