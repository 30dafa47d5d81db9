"""Boolean formulas over arrays: the truth of ψ at every state of a model, or every sample of a batch, at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.errors import TraceError
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

Reals: TypeAlias = NDArray[np.float64]
Booleans: TypeAlias = NDArray[np.bool_]

_COMPARE = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip
_COMPUTE = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "^": np.power}
_CALL = {"min": np.minimum, "max": np.maximum}


def truth(
    psi: Formula, signals: Mapping[str, Reals], labels: Mapping[str, Booleans], shape: tuple[int, ...]
) -> Booleans:
    """The truth of a formula without temporal operators, element by element.

    `signals` and `labels` hold arrays of the given shape for every name in ψ. Raises TraceError where a term has no
    value (division by zero, square root of a negative number, overflow).
    """
    match psi:
        case Constant(value):
            return np.full(shape, value)
        case Label(name):
            return labels[name]
        case Comparison(op, left, right):
            result: Booleans = _COMPARE[op](_values(left, signals, shape), _values(right, signals, shape))
            return result
        case Not(arg):
            return ~truth(arg, signals, labels, shape)
        case And(args):
            return _all([truth(arg, signals, labels, shape) for arg in args])
        case Or(args):
            return ~_all([~truth(arg, signals, labels, shape) for arg in args])
        case Implies(left, right):
            return ~truth(left, signals, labels, shape) | truth(right, signals, labels, shape)
        case Iff(left, right):
            return ~(truth(left, signals, labels, shape) ^ truth(right, signals, labels, shape))
        case Eventually() | Always() | Until():
            raise ValueError(f"{psi} is temporal; it has no truth at a single state")
        case _:
            assert_never(psi)


def _all(operands: list[Booleans]) -> Booleans:
    result: Booleans = np.logical_and.reduce(operands)
    return result


def _values(term: Term, signals: Mapping[str, Reals], shape: tuple[int, ...]) -> Reals:
    match term:
        case Number(value):
            return np.full(shape, value)
        case Variable(name):
            return signals[name]
        case Negate(arg):
            return -_values(arg, signals, shape)
        case Arithmetic(op, left, right):
            return _apply(term, _COMPUTE[op], _values(left, signals, shape), _values(right, signals, shape))
        case Call("abs" | "sqrt" as function, (arg,)):
            return _apply(term, np.abs if function == "abs" else np.sqrt, _values(arg, signals, shape))
        case Call(function, args):
            return _apply(term, _CALL[function].reduce, [_values(arg, signals, shape) for arg in args])
        case _:
            assert_never(term)


def _apply(term: Term, function: Callable[..., Any], *operands: object) -> Reals:
    try:
        with np.errstate(divide="raise", invalid="raise", over="raise", under="ignore"):
            result: Reals = function(*operands)
            return result
    except FloatingPointError as error:
        message = f"this has no value for some state or sample ({error}); guard it or change the predicate"
        raise TraceError(term.span.show(message) if term.span else message) from None
