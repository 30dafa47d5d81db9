"""Formula → canonical text: `parse(str(f)) == f`, with parentheses wherever tools disagree about precedence.

The rules for parentheses and spaces are defined here only; the formatter of task files (format.py) uses them, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal, TypeAlias, assert_never

from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    ArithmeticOperator,
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
    with_children,
)
from stltool.logic.names import written
from stltool.logic.quantities import Ticks

Kind: TypeAlias = Literal["atom", "not", "temporal", "comparison", "binary"]
"""The form of an operand: a name or constant, `!…`, `F… …`, `once… …` or `!G… …`, `… < …`, or a binary operator."""

# binding strength of arithmetic, loosest first
STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "negate": 3, "^": 4, "atom": 5}
_TermText: TypeAlias = tuple[str, int]

Text: TypeAlias = Callable[[Formula], str]
"""How a formula is written; `str`, unless definitions are to keep their names."""


def to_text(phi: Formula) -> str:
    """The canonical text of a formula."""
    match phi:
        case Constant(value):
            return "true" if value else "false"
        case Label(name):
            return written(name)
        case Comparison(op, left, right):
            return f"{term_text(left)} {op} {term_text(right)}"
        case Not(arg):
            return f"!{_operand(arg, prefix=True)}"
        case And(args):
            return _joined("&", args)
        case Or(args):
            return _joined("|", args)
        case Implies(left, right):
            return _joined("->", (left, right))
        case Iff(left, right):
            return _joined("<->", (left, right))
        case Eventually(interval, arg):
            return f"F{interval} {_operand(arg, prefix=True)}"
        case Always(interval, arg):
            return f"G{interval} {_operand(arg, prefix=True)}"
        case Until(interval, left, right):
            return _joined(f"U{interval}", (left, right))
        case Release(interval, left, right):
            return _joined(f"release{interval}", (left, right))
        case Once(Interval(1, 1), arg):
            return f"prev {_operand(arg, prefix=True)}"
        case Once(interval, arg):
            return f"once{_past(interval)} {_operand(arg, prefix=True)}"
        case Historically(interval, arg):
            return f"historically{_past(interval)} {_operand(arg, prefix=True)}"
        case Since(interval, left, right):
            return _joined(f"since{_past(interval)}", (left, right))
        case Trigger(interval, left, right):
            return _joined(f"trigger{_past(interval)}", (left, right))
        case Rise(Not(arg)):
            return f"fall {_operand(arg, prefix=True)}"
        case Rise(arg):
            return f"rise {_operand(arg, prefix=True)}"
        case _:
            assert_never(phi)


def _past(interval: Interval) -> str:
    return "" if interval == Interval(0, None) else str(interval)


def _joined(sign: str, args: Iterable[Formula]) -> str:
    return f" {sign} ".join(_operand(arg) for arg in args)


def _operand(phi: Formula, prefix: bool = False) -> str:
    text = to_text(phi)
    return f"({text})" if needs_parentheses(_kind(phi), prefix) else text


def needs_parentheses(kind: Kind, prefix: bool) -> bool:
    """Whether an operand is put in parentheses: always, unless it binds tighter beyond doubt.

    Under a prefix operator another prefix chain needs none; between binary operators a comparison needs none.
    """
    match kind:
        case "atom" | "not":
            return False
        case "temporal":
            return not prefix
        case "comparison":
            return prefix
        case "binary":
            return True
        case _:
            assert_never(kind)


def _kind(phi: Formula) -> Kind:
    match phi:
        case Constant() | Label():
            return "atom"
        case Not(arg):
            return "temporal" if _kind(arg) == "temporal" else "not"
        case Eventually() | Always() | Once() | Historically() | Rise():
            return "temporal"
        case Comparison():
            return "comparison"
        case _:
            return "binary"


@dataclass(frozen=True, slots=True)
class _Timed(Interval):
    """An interval that is written in time: [0,2.5s]."""

    ticks: Ticks

    def __str__(self) -> str:
        a, b = (None if end is None else self.ticks.text(end).replace(" ", "") for end in (self.a, self.b))
        return f"[{a if self.a else 0},inf)" if b is None else f"[{a if self.a else 0},{b if self.b else 0}]"


def with_names(definitions: Mapping[str, Formula], ticks: Ticks | None = None) -> Text:
    """A writer of formulas that calls those of `definitions` by their names; with `ticks`, bounds are times."""
    named = {phi: name for name, phi in definitions.items()}

    def replaced(phi: Formula) -> Formula:
        if phi in named:
            return Label(named[phi])
        found = with_children(phi, tuple(map(replaced, children(phi))))
        if ticks is None or isinstance(found, Constant | Label | Comparison | Not | And | Or | Implies | Iff | Rise):
            return found
        return replace(found, interval=_Timed(found.interval.a, found.interval.b, ticks))

    @cache
    def text(phi: Formula) -> str:
        return str(replaced(phi))

    return text


def term_text(term: Term) -> str:
    """The canonical text of an arithmetic term."""
    return _term(term)[0]


def _term(term: Term) -> _TermText:
    match term:
        case Number(value):
            return (str(int(value)) if value.is_integer() and value < 1e16 else repr(value)), STRENGTH["atom"]
        case Variable(name, delay):
            read = f"[t{-delay:+d}]" if delay else ""
            return f"{written(name)}{read}", STRENGTH["atom"]
        case Negate(arg):
            return negated(_term(arg)), STRENGTH["negate"]
        case Arithmetic(op, left, right):
            return computed(op, _term(left), _term(right)), STRENGTH[op]
        case Call(function, args):
            return f"{function}({', '.join(term_text(arg) for arg in args)})", STRENGTH["atom"]
        case _:
            assert_never(term)


def negated(term: _TermText) -> str:
    """`-term`, given its text and binding strength."""
    return f"-{_tight(term, STRENGTH['negate'])}"


def computed(op: ArithmeticOperator, left: _TermText, right: _TermText) -> str:
    """`left op right`, given their texts and binding strengths."""
    if op == "^":
        exponent = f"({right[0]})" if right[1] == STRENGTH["^"] else _tight(right, STRENGTH["negate"])
        return f"{_tight(left, STRENGTH['atom'])}^{exponent}"
    return f"{_tight(left, STRENGTH[op])} {op} {_tight(right, STRENGTH[op] + 1)}"


def _tight(term: _TermText, least: int) -> str:
    """The term's text, in parentheses if it binds less tightly than `least`."""
    text, strength = term
    return text if strength >= least else f"({text})"
