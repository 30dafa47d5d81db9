"""Formula → canonical text: `parse(str(f)) == f`, with the parentheses put in wherever tools read differently."""

from __future__ import annotations

from typing import assert_never

from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    Call,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Iff,
    Implies,
    Label,
    Negate,
    Not,
    Number,
    Or,
    Term,
    Until,
    Variable,
)

# binding strength of arithmetic, loosest first
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "negate": 3, "^": 4, "atom": 5}


def to_text(phi: Formula) -> str:
    """The canonical text of a formula."""
    match phi:
        case Constant(value):
            return "true" if value else "false"
        case Label(name):
            return name
        case Comparison(op, left, right):
            return f"{term_text(left)} {op} {term_text(right)}"
        case Not(arg):
            return f"!{_operand(arg, prefix=True)}"
        case And(args):
            return " & ".join(_operand(arg) for arg in args)
        case Or(args):
            return " | ".join(_operand(arg) for arg in args)
        case Implies(left, right):
            return f"{_operand(left)} -> {_operand(right)}"
        case Iff(left, right):
            return f"{_operand(left)} <-> {_operand(right)}"
        case Eventually(interval, arg):
            return f"F{interval} {_operand(arg, prefix=True)}"
        case Always(interval, arg):
            return f"G{interval} {_operand(arg, prefix=True)}"
        case Until(interval, left, right):
            return f"{_operand(left)} U{interval} {_operand(right)}"
        case _:
            assert_never(phi)


def _operand(phi: Formula, prefix: bool = False) -> str:
    """An operand, in parentheses unless it binds tighter beyond doubt.

    Under a prefix operator a further prefix chain needs none; between binary operators a comparison needs none.
    """
    text = to_text(phi)
    match phi:
        case Constant() | Label() | Not():
            return text
        case Eventually() | Always():
            return text if prefix else f"({text})"
        case Comparison():
            return f"({text})" if prefix else text
        case _:
            return f"({text})"


def term_text(term: Term) -> str:
    """The canonical text of an arithmetic term."""
    match term:
        case Number(value):
            return str(int(value)) if value.is_integer() and value < 1e16 else repr(value)
        case Variable(name):
            return name
        case Negate(arg):
            return f"-{_tight(arg, _STRENGTH['negate'])}"
        case Arithmetic("^", left, right):
            return f"{_tight(left, _STRENGTH['atom'])}^{_tight(right, _STRENGTH['negate'])}"
        case Arithmetic(op, left, right):
            strength = _STRENGTH[op]
            return f"{_tight(left, strength)} {op} {_tight(right, strength + 1)}"
        case Call(function, args):
            return f"{function}({', '.join(term_text(arg) for arg in args)})"
        case _:
            assert_never(term)


def _tight(term: Term, least: int) -> str:
    """The term's text, in parentheses if it binds looser than `least`."""
    match term:
        case Negate():
            own = _STRENGTH["negate"]
        case Arithmetic(op, _, _):
            own = _STRENGTH[op]
        case _:
            own = _STRENGTH["atom"]
    return term_text(term) if own >= least else f"({term_text(term)})"
