"""Whether one formula implies another because its windows and numbers are the tighter ones: how parameters act.

Two formulas of the same shape, such as `G[0,T] F[0,τ] A` for two values of T, are compared operator by operator:

    F[I], U[I], once[I], since[I]                    true of more runs if I contains more steps
    G[I], release[I], historically[I], trigger[I]    true of fewer
    x > c                                            true of fewer if c is larger; other comparisons accordingly
    ¬, the left of →                                 the other way round
    ↔, rise                                          nothing follows, unless the operands are equal

Every rule is sound and holds for all runs; none looks at what formulas mean beyond that, so some implications are not
found. All windows begin at the step of evaluation (docs/semantics.md), also those of U[a,b], whose left operand must
hold from there on whatever a is.
"""

from __future__ import annotations

from typing import NamedTuple, assert_never

from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    Call,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Term,
    Trigger,
    Until,
    Variable,
    children,
)


class Order(NamedTuple):
    """What is proved of two formulas: that the first implies the second, and the converse. Of two terms: that the first
    is nowhere larger, and the converse."""

    up: bool
    down: bool

    @property
    def reverse(self) -> Order:
        return Order(self.down, self.up)


EQUAL, UNKNOWN = Order(True, True), Order(False, False)


def order(one: Formula, other: Formula) -> Order:
    """Which of two formulas is proved to imply which."""
    return _order(one, other, {})


def _order(one: Formula, other: Formula, known: dict[tuple[int, int], Order]) -> Order:
    key = (id(one), id(other))  # definitions that are used twice are compared once
    if key not in known:
        known[key] = _compared(one, other, known)
    return known[key]


def _compared(one: Formula, other: Formula, known: dict[tuple[int, int], Order]) -> Order:
    if type(one) is not type(other) or len(children(one)) != len(children(other)):
        return UNKNOWN
    parts = [_order(a, b, known) for a, b in zip(children(one), children(other), strict=True)]
    match one:
        case Constant() | Label():
            return EQUAL if one == other else UNKNOWN
        case Comparison():
            assert isinstance(other, Comparison)
            return _comparisons(one, other)
        case Not():
            return parts[0].reverse
        case And() | Or():
            return _all(*parts)
        case Implies():
            return _all(parts[0].reverse, parts[1])
        case Iff() | Rise():
            return EQUAL if all(part == EQUAL for part in parts) else UNKNOWN
        case Eventually() | Until() | Once() | Since():
            return _all(*parts, _inside(one.interval, other.interval))  # type: ignore[union-attr]  # of one type
        case Always() | Release() | Historically() | Trigger():
            return _all(*parts, _inside(one.interval, other.interval).reverse)  # type: ignore[union-attr]
        case _:
            assert_never(one)


def _all(*parts: Order) -> Order:
    return Order(all(part.up for part in parts), all(part.down for part in parts))


def _inside(one: Interval, other: Interval) -> Order:
    """Whether the first interval lies within the second, and the converse."""
    ends = [float("inf") if interval.b is None else interval.b for interval in (one, other)]
    return Order(other.a <= one.a and ends[0] <= ends[1], one.a <= other.a and ends[1] <= ends[0])


def _comparisons(one: Comparison, other: Comparison) -> Order:
    if one.op != other.op:
        return UNKNOWN
    left, right = terms(one.left, other.left), terms(one.right, other.right)
    match one.op:
        case "<" | "<=":
            return _all(left.reverse, right)
        case ">" | ">=":
            return _all(left, right.reverse)
        case "==" | "!=":
            return EQUAL if left == right == EQUAL else UNKNOWN


def terms(one: Term, other: Term) -> Order:
    """Which of two terms is proved to be nowhere larger, whatever the signals are. Rounding keeps these orders."""
    a, b = _number(one), _number(other)
    if a is not None and b is not None:
        return Order(a <= b, b <= a)
    if one == other:
        return EQUAL
    match one, other:
        case Negate(), Negate():
            return terms(one.arg, other.arg).reverse
        case Arithmetic(), Arithmetic() if one.op == other.op:
            left, right = terms(one.left, other.left), terms(one.right, other.right)
            match one.op:
                case "+":
                    return _all(left, right)
                case "-":
                    return _all(left, right.reverse)
                case "*" if left == EQUAL and _number(one.left) is not None:
                    return _scaled(right, _number(one.left))
                case "*" | "/" if right == EQUAL and _number(one.right) is not None:
                    return _scaled(left, _number(one.right))
        case Call(function="min" | "max"), Call() if one.function == other.function:
            if len(one.args) == len(other.args):
                return _all(*(terms(a, b) for a, b in zip(one.args, other.args, strict=True)))
    return UNKNOWN


def _scaled(of: Order, factor: float | None) -> Order:
    return UNKNOWN if not factor else of if factor > 0 else of.reverse


def _number(term: Term) -> float | None:
    """The value of a constant written as a number."""
    match term:
        case Number():
            return term.value
        case Negate(arg=Number(value=value)):
            return -value
        case Negate() | Variable() | Arithmetic() | Call():
            return None
