"""The paper's fragment [Wang24, eq. 1], and the decomposition that its flags need (docs/semantics.md §2).

    Φ ::= ¬Φ | F[0,T) φ | G[0,T) φ
    φ ::= ¬φ | φ∧φ | φ∨φ | φ→φ | φ↔φ | F[0,τ) ψ | G[0,τ) ψ
    ψ ::= Boolean over predicates

A Boolean root counts as the outer G[0,1), a bare ψ next to inner operators as the inner G[0,1). An error names the
smallest sub-formula at fault, its position, the reason, and the remedy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from stltool.arguments import require
from stltool.display import Card, Displayed
from stltool.errors import FragmentError, SettingsError
from stltool.logic.formula import (
    PAST,
    Always,
    Eventually,
    Formula,
    Not,
    Release,
    Until,
    boolean_value,
    bounded_formula_of,
    children,
    has_past,
    is_temporal,
    temporal_depth,
    walk,
    with_children,
)
from stltool.logic.shifts import delayed
from stltool.logic.task import Task

Operator = Literal["F", "G"]


@dataclass(frozen=True, slots=True)
class FragmentPart:
    """One φ_i = F[0,τ) ψ or G[0,τ) ψ, which one flag tracks. A bare ψ is G[0,1) ψ."""

    operator: Operator
    tau: int
    psi: Formula
    formula: Formula

    def __str__(self) -> str:
        return f"{self.operator}[0,{self.tau}) {self.psi}"


@dataclass(frozen=True, slots=True, repr=False)
class Fragment(Displayed):
    """Φ = `outer`[0,`T`) g(φ₁, …, φ_n), with g the Boolean structure of `body` over `parts`."""

    outer: Operator
    T: int
    parts: tuple[FragmentPart, ...]
    body: Formula

    def _card(self) -> Card:
        parts = "; ".join(str(part) for part in self.parts)
        return Card(
            f"Fragment: {self.outer}[0,{self.T}) of {self.body}",
            [{"parts": parts}, {"equal inner windows": "yes" if self.uniform else "no: flags are an approximation"}],
        )

    def combine(self, chi: Sequence[bool]) -> bool:
        """g(χ): the truth of the body if part i has truth χ_i."""
        require(chi, (list, tuple), "combine's truths", f"give {len(self.parts)} truth values, one for each part")
        if len(chi) != len(self.parts):
            raise SettingsError(f"combine got {len(chi)} truth values for {len(self.parts)} parts; give one each")
        known = {part.formula: bool(value) for part, value in zip(self.parts, chi, strict=True)}
        return boolean_value(self.body, known.get)

    @property
    def uniform(self) -> bool:
        """Whether all inner windows are equal: then, and only then, the paper's flags are exact."""
        return len({part.tau for part in self.parts}) <= 1


def check_fragment(phi: Formula | Task) -> Fragment:
    """Decompose φ according to the paper's fragment; FragmentError names what is outside it."""
    phi = delayed(bounded_formula_of(phi, "check_fragment's formula")).formula
    if has_past(phi):
        first = next(node for node in walk(phi) if isinstance(node, PAST))
        raise FragmentError(
            _at(first, f"past: {first} looks back, which the paper's fragment does not; use the exact encoding")
        )
    negated = False
    root = phi
    while isinstance(root, Not) and isinstance(root.arg, Not | Eventually | Always):
        root, negated = root.arg, not negated
    match root:
        case Eventually(interval, arg) | Always(interval, arg):
            _from_zero(root)
            operator: Operator = "F" if isinstance(root, Eventually) != negated else "G"
            body = Not(arg) if negated else arg
            size = len(interval)
        case _:
            operator, body, size = "G", phi, 1
    parts: dict[Formula, FragmentPart] = {}
    body = _collect(body, parts)
    return Fragment(operator, size, tuple(parts.values()), body)


def _collect(phi: Formula, parts: dict[Formula, FragmentPart]) -> Formula:
    """Find the inner operators and bare predicates of φ, left to right."""
    if not is_temporal(phi):
        parts.setdefault(phi, FragmentPart("G", 1, phi, phi))
        return phi
    match phi:
        case Eventually(interval, arg) | Always(interval, arg):
            if is_temporal(arg):
                raise FragmentError(
                    _at(
                        phi,
                        f"depth {1 + temporal_depth(phi)}: {phi} nests temporal operators under the outer one; "
                        "the paper's fragment allows two levels; use the exact encoding",
                    )
                )
            _from_zero(phi)
            operator: Operator = "F" if isinstance(phi, Eventually) else "G"
            parts.setdefault(phi, FragmentPart(operator, len(interval), arg, phi))
            return phi
        case Until() | Release():
            word = "until" if isinstance(phi, Until) else "release"
            raise FragmentError(_at(phi, f"{word}: {phi} is outside the paper's fragment; use the exact encoding"))
        case _:
            return with_children(phi, tuple(_collect(child, parts) for child in children(phi)))


def _from_zero(phi: Eventually | Always) -> None:
    if phi.interval.a > 0:
        raise FragmentError(
            _at(
                phi,
                f"the window {phi.interval} starts at step {phi.interval.a}; "
                "windows of the paper's fragment start at step 0; use the exact encoding",
            )
        )


def _at(phi: Formula, message: str) -> str:
    return phi.span.show(message) if phi.span is not None else message
