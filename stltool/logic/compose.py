"""Formulas composed in Python instead of written as text.

    x, at_A = stl.signal("x"), stl.label("A")
    phi = stl.G(stl.F(at_A, 0, 9) & (x + 0.1 <= 0.5), 0, 20)        # G[0,20] ((F[0,9] A) & x + 0.1 <= 0.5)

`str` of the result parses back to it. Numbers mean what they mean in a text: a double stands for the shortest decimal
that identifies it. `&`, `|`, `~` and `>>` are operators of the formulas themselves (formula.py); comparisons and
implications next to them must be put in parentheses.
"""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from numbers import Integral, Real
from typing import TYPE_CHECKING, ClassVar, NoReturn, TypeAlias

from stltool.arguments import described, real, require, whole
from stltool.display import Card, Displayed
from stltool.errors import ArgumentError, SettingsError, StlSyntaxError
from stltool.logic.formula import (
    LARGEST_BOUND,
    Always,
    Arithmetic,
    ArithmeticOperator,
    Call,
    Comparator,
    Comparison,
    Eventually,
    Formula,
    Historically,
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
    fitting,
    formula_of,
    refuse_operand,
)
from stltool.logic.names import can_be_written
from stltool.logic.shifts import moved, settled
from stltool.logic.task import Task
from stltool.numbers import exact, shortest

if TYPE_CHECKING:
    Operand: TypeAlias = "Expression | int | float | Fraction | Decimal"


def F(phi: Formula | Task, a: int, b: int | None) -> Eventually:
    """F[a,b] φ: φ at some step t+a … t+b, both included. `b=None`: to the end of the trace, for monitors only."""
    return fitting(Eventually(_interval("F", a, b), formula_of(phi, "F's formula")))


def G(phi: Formula | Task, a: int, b: int | None) -> Always:
    """G[a,b] φ: φ at every step t+a … t+b, both included. `b=None`: to the end of the trace, for monitors only."""
    return fitting(Always(_interval("G", a, b), formula_of(phi, "G's formula")))


def U(phi: Formula | Task, psi: Formula | Task, a: int, b: int | None) -> Until:
    """φ U[a,b] ψ: ψ at some step u of t+a … t+b, both included, and φ at every step of [t, u). `b` as for `F`."""
    return fitting(Until(*_joined("U", phi, psi, a, b)))


def release(phi: Formula | Task, psi: Formula | Task, a: int, b: int | None) -> Release:
    """φ release[a,b] ψ = ¬(¬φ U[a,b] ¬ψ): ψ at every step u of t+a … t+b, unless φ at some step of [t, u)."""
    return fitting(Release(*_joined("release", phi, psi, a, b)))


def weak_until(phi: Formula | Task, psi: Formula | Task, a: int, b: int | None) -> Or:
    """φ weak_until[a,b] ψ = (φ U[a,b] ψ) ∨ G[0,b] φ: until, but ψ need not come if φ stays."""
    interval, left, right = _joined("weak_until", phi, psi, a, b)
    return fitting(Or((Until(interval, left, right), Always(Interval(0, interval.b), left))))


def once(phi: Formula | Task, a: int = 0, b: int | None = None) -> Once:
    """once[a,b] φ: φ at some step t−b … t−a, of those from 0 on. `b=None`: from the start of the trace on."""
    return fitting(Once(_interval("once", a, b), formula_of(phi, "once's formula")))


def historically(phi: Formula | Task, a: int = 0, b: int | None = None) -> Historically:
    """historically[a,b] φ: φ at every step t−b … t−a, of those from 0 on. `b` as for `once`."""
    return fitting(Historically(_interval("historically", a, b), formula_of(phi, "historically's formula")))


def since(phi: Formula | Task, psi: Formula | Task, a: int = 0, b: int | None = None) -> Since:
    """φ since[a,b] ψ: ψ at some step u of t−b … t−a, of those from 0 on, and φ at every step of (u, t]."""
    return fitting(Since(*_joined("since", phi, psi, a, b)))


def trigger(phi: Formula | Task, psi: Formula | Task, a: int = 0, b: int | None = None) -> Trigger:
    """φ trigger[a,b] ψ = ¬(¬φ since[a,b] ¬ψ): ψ at every step u of t−b … t−a, unless φ at some step of (u, t]."""
    return fitting(Trigger(*_joined("trigger", phi, psi, a, b)))


def prev(phi: Formula | Task) -> Once:
    """prev φ = once[1,1] φ: φ at the step before; false at step 0."""
    return fitting(Once(Interval(1, 1), formula_of(phi, "prev's formula")))


def rise(phi: Formula | Task) -> Rise:
    """rise φ = φ ∧ ¬prev φ: φ now, but not at the step before; φ at step 0."""
    return fitting(Rise(formula_of(phi, "rise's formula")))


def fall(phi: Formula | Task) -> Rise:
    """fall φ = rise ¬φ: not φ now, but at the step before; ¬φ at step 0."""
    return fitting(Rise(Not(formula_of(phi, "fall's formula"))))


def label(name: str) -> Label:
    """A label: true or false at every step. StlSyntaxError if the name could not be used in a text."""
    require(name, str, "label's name")
    _require_readable(name)
    return Label(name)


def signal(name: str) -> Expression:
    """A signal, to be compared: `stl.signal("x") > 0.4`. StlSyntaxError if the name could not be used in a text."""
    require(name, str, "signal's name")
    _require_readable(name)
    return Expression(Variable(name))


class Expression(Displayed):
    """Arithmetic over signals and numbers: `+ - * / **` and abs; `< <= > >= == !=` turn it into a formula.

    `x.at(1)` is x one step later, `x.at(-1)` one step earlier.
    """

    __slots__ = ("term",)
    __array_ufunc__: ClassVar[None] = None  # numpy's numbers defer to the operators here
    __hash__ = None  # type: ignore[assignment]  # == makes a formula

    def __init__(self, term: Term) -> None:
        self.term = term

    def __str__(self) -> str:
        from stltool.logic.printer import term_text

        return term_text(self.term)

    def __repr__(self) -> str:
        return f"Expression({str(self)!r})"

    def _card(self) -> Card:
        return Card(str(self))

    def __add__(self, other: Operand) -> Expression:
        return _computed("+", self, other)

    def __radd__(self, other: Operand) -> Expression:
        return _computed("+", other, self)

    def __sub__(self, other: Operand) -> Expression:
        return _computed("-", self, other)

    def __rsub__(self, other: Operand) -> Expression:
        return _computed("-", other, self)

    def __mul__(self, other: Operand) -> Expression:
        return _computed("*", self, other)

    def __rmul__(self, other: Operand) -> Expression:
        return _computed("*", other, self)

    def __truediv__(self, other: Operand) -> Expression:
        return _computed("/", self, other)

    def __rtruediv__(self, other: Operand) -> Expression:
        return _computed("/", other, self)

    def __pow__(self, other: Operand) -> Expression:
        return _computed("^", self, other)

    def __rpow__(self, other: Operand) -> Expression:
        return _computed("^", other, self)

    def __neg__(self) -> Expression:
        return Expression(fitting(Negate(self.term)))

    def __pos__(self) -> Expression:
        return self

    def __abs__(self) -> Expression:
        return Expression(fitting(Call("abs", (self.term,))))

    def at(self, steps: int) -> Expression:
        """The same expression some steps later, or earlier if `steps` is negative: x[t+1] is `x.at(1)`."""
        steps = whole(steps, "at's steps", -LARGEST_BOUND, LARGEST_BOUND)
        return Expression(moved(self.term, -steps))

    def __lt__(self, other: Operand) -> Formula:
        return _compared("<", self, other)

    def __le__(self, other: Operand) -> Formula:
        return _compared("<=", self, other)

    def __gt__(self, other: Operand) -> Formula:
        return _compared(">", self, other)

    def __ge__(self, other: Operand) -> Formula:
        return _compared(">=", self, other)

    def __eq__(self, other: Operand) -> Formula:  # type: ignore[override]
        return _compared("==", self, other)

    def __ne__(self, other: Operand) -> Formula:  # type: ignore[override]
        return _compared("!=", self, other)

    def __and__(self, other: object) -> NoReturn:
        refuse_operand(self, "&")

    def __or__(self, other: object) -> NoReturn:
        refuse_operand(self, "|")

    def __rshift__(self, other: object) -> NoReturn:
        refuse_operand(self, ">>")

    def __invert__(self) -> NoReturn:
        refuse_operand(self, "~")

    __rand__, __ror__, __rrshift__ = __and__, __or__, __rshift__

    def __bool__(self) -> NoReturn:
        raise ArgumentError(f"{self} is a number at every step, not true or false; compare it, as in {self} > 0.5")


def _joined(
    operator: str, phi: Formula | Task, psi: Formula | Task, a: object, b: object
) -> tuple[Interval, Formula, Formula]:
    """The interval and the formulas of an operator of two."""
    left, right = formula_of(phi, f"{operator}'s first formula"), formula_of(psi, f"{operator}'s second formula")
    return _interval(operator, a, b), left, right


def _interval(operator: str, a: object, b: object) -> Interval:
    first = whole(a, f"{operator}'s first step a", 0, LARGEST_BOUND)
    return Interval(first, None if b is None else whole(b, f"{operator}'s last step b", 0, LARGEST_BOUND))


def _require_readable(name: str) -> None:
    """StlSyntaxError unless a text can name it."""
    if not can_be_written(name):
        raise StlSyntaxError(
            f"{described(name)} cannot be the name of a label or signal, which is neither empty nor longer than a "
            "line; use another name"
        )


def _compared(op: Comparator, left: Operand, right: Operand) -> Formula:
    return fitting(settled(Comparison(op, _term(left, op), _term(right, op))))


def _computed(op: ArithmeticOperator, left: Operand, right: Operand) -> Expression:
    return Expression(fitting(Arithmetic(op, _term(left, op), _term(right, op))))


def _term(value: object, sign: str) -> Term:
    if isinstance(value, Expression):
        return value.term
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        raise ArgumentError(
            f"an operand of {sign} is {described(value)}, which is neither a number nor a signal; put comparisons "
            "next to & and | in parentheses: (x > 0.5) & phi"
        )
    number = real(value, f"an operand of {sign}")
    if not isinstance(value, Integral | Fraction | Decimal | float):  # a short float of numpy's
        number = exact(value)
    return _number(Fraction(int(value)) if isinstance(value, Integral) else number)


def _number(value: float | Fraction) -> Term:
    """The term with which a text writes this number: -0.1, 1 / 3."""
    if value < 0:
        return Negate(_number(-value))
    if isinstance(value, float):
        return Number(abs(value))  # no negative zero
    double = float(value)
    if shortest(double) == value:
        return Number(double)
    if value.denominator == 1 or shortest(float(value.numerator)) != value.numerator:
        raise SettingsError(f"{described(value)} cannot be written exactly; the nearest number that can is {double!r}")
    return Arithmetic("/", _number(Fraction(value.numerator)), _number(Fraction(value.denominator)))
