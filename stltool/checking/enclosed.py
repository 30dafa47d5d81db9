"""Bounds asked of an enclosure, or of the exact value where it is known."""

from __future__ import annotations

from fractions import Fraction

from stltool.arguments import real


class Enclosed:
    """What has `lower` ≤ exact value ≤ `upper`, and the value itself as a `fraction`, or None."""

    lower: float
    upper: float
    fraction: Fraction | None

    def at_least(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at least `bound`; None if the bound lies inside the enclosure."""
        bound = real(bound, "at_least's bound")
        lower, upper = (self.lower, self.upper) if self.fraction is None else (self.fraction, self.fraction)
        return True if lower >= bound else False if upper < bound else None

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at most `bound`; None if the bound lies inside the enclosure."""
        bound = real(bound, "at_most's bound")
        lower, upper = (self.lower, self.upper) if self.fraction is None else (self.fraction, self.fraction)
        return True if upper <= bound else False if lower > bound else None
