"""Formulas whose predicates are replaced by what depends on their polarity: positive under an even number of negations.

Operators stay what they are, except those that use an operand in both polarities, which are expanded:

    φ → ψ  =  ¬φ ∨ ψ        φ ↔ ψ  =  (¬φ ∨ ψ) ∧ (φ ∨ ¬ψ)        rise φ  =  φ ∧ ¬prev φ
"""

from __future__ import annotations

from collections.abc import Callable

from stltool.logic.formula import (
    And,
    Comparison,
    Constant,
    Formula,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Rise,
    children,
    fitting,
    with_children,
)


def with_predicates(phi: Formula, leaf: Callable[[Comparison | Label, bool], Formula]) -> Formula:
    """φ with `leaf(predicate, positive)` in place of its predicates. Raises StlSyntaxError if ↔ makes it too large."""
    known: dict[tuple[int, bool], Formula] = {}

    def rewritten(psi: Formula, positive: bool) -> Formula:
        found = known.get((id(psi), positive))
        if found is None:
            found = known[id(psi), positive] = fitting(node(psi, positive))
        return found

    def node(psi: Formula, positive: bool) -> Formula:
        match psi:
            case Constant():
                return psi
            case Comparison() | Label():
                return leaf(psi, positive)
            case Not(arg):
                return Not(rewritten(arg, not positive), span=psi.span)
            case Implies(left, right):
                return Or((Not(rewritten(left, not positive)), rewritten(right, positive)), span=psi.span)
            case Iff(left, right):
                return And(
                    (
                        Or((Not(rewritten(left, not positive)), rewritten(right, positive))),
                        Or((rewritten(left, positive), Not(rewritten(right, not positive)))),
                    ),
                    span=psi.span,
                )
            case Rise(arg):
                before = Once(Interval(1, 1), rewritten(arg, not positive))
                return And((rewritten(arg, positive), Not(before)), span=psi.span)
            case _:
                return with_children(psi, tuple(rewritten(child, positive) for child in children(psi)))

    return rewritten(phi, True)
