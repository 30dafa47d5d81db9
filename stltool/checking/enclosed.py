"""Bounds asked of an enclosure, or of the exact value where it is known."""

from __future__ import annotations

from fractions import Fraction

from stltool.arguments import real
from stltool.numbers import fraction_text
from stltool.product import Product

_LONGEST = 60  # characters of a fraction in a short description


def is_at_least(lower: float | Fraction, upper: float | Fraction, bound: float | Fraction) -> bool | None:
    """Whether what lies in [lower, upper] is at least `bound`; None if the bound lies inside."""
    return True if lower >= bound else False if upper < bound else None


def is_at_most(lower: float | Fraction, upper: float | Fraction, bound: float | Fraction) -> bool | None:
    """Whether it is at most `bound`; None if the bound lies inside."""
    return True if upper <= bound else False if lower > bound else None


def enclosed_rows(product: Product, lower: float, upper: float, fraction: Fraction | None) -> list[dict[str, object]]:
    """What a short description of an enclosed answer says of it, its task and its model."""
    return [
        {
            "bounds": f"[{lower!r}, {upper!r}]",
            "exactly": fraction_text(fraction, _LONGEST) if fraction is not None else None,
        },
        {"task": f"{product.task_name} := {product.formula}", "model": product.model.name},
    ]


class Enclosed:
    """What has `lower` ≤ exact value ≤ `upper`, and the value itself as a `fraction`, or None."""

    lower: float
    upper: float
    fraction: Fraction | None

    def at_least(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at least `bound`; None if the bound lies inside the enclosure."""
        return is_at_least(*self.ends, real(bound, "at_least's bound"))

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at most `bound`; None if the bound lies inside the enclosure."""
        return is_at_most(*self.ends, real(bound, "at_most's bound"))

    @property
    def ends(self) -> tuple[float | Fraction, float | Fraction]:
        """The enclosure, or the exact value twice where it is known."""
        return (self.lower, self.upper) if self.fraction is None else (self.fraction, self.fraction)
