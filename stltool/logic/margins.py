"""Questions about robustness as questions about truth: ρ(Φ) ≥ r is a formula whose predicates are those of margins.

With ge(φ, r) for ρ(φ) ≥ r and gt(φ, r) for ρ(φ) > r, and a predicate's margin m:

    ge(h, r) = (m ≥ r)                 gt(h, r) = (m > r)
    ge(¬φ, r) = ¬gt(φ, −r)             gt(¬φ, r) = ¬ge(φ, −r)
    ge(φ → ψ, r) = ¬gt(φ, −r) ∨ ge(ψ, r)
    ge(φ ↔ ψ, r) = (¬gt(φ, −r) ∨ ge(ψ, r)) ∧ (ge(φ, r) ∨ ¬gt(ψ, −r))
    ge(rise φ, r) = ge(φ, r) ∧ ¬prev gt(φ, −r)

and ∧ ∨ F G U and their relatives operand by operand, since min and max commute with ≥ r. So the predicates that stand
under an even number of negations ask m ≥ r, the others m > −r: the structure does not depend on r.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stltool.logic.formula import Comparison, Formula, Label
from stltool.logic.polarity import with_predicates


@dataclass(frozen=True, slots=True)
class Thresholded:
    """`formula`: ρ ≥ r over labels; each stands for (predicate, True): margin ≥ r, or (predicate, False): margin > −r.

    Constants have margin ±∞ and stay, for r = +∞ too.
    """

    formula: Formula
    labels: Mapping[str, tuple[Comparison | Label, bool]]


def thresholded(phi: Formula) -> Thresholded:
    """ρ(φ) ≥ r, for whatever r > −∞. Raises StlSyntaxError if ↔ makes the formula too large."""
    names: dict[tuple[Comparison | Label, bool], str] = {}

    def asked(psi: Comparison | Label, positive: bool) -> Formula:
        name = f"margin({psi}) {'>= r' if positive else '> -r'}"
        return Label(names.setdefault((psi, positive), name), span=psi.span)

    formula = with_predicates(phi, asked)
    return Thresholded(formula, {name: key for key, name in names.items()})
