"""Parameters of a model: probabilities that are linear in unknown numbers, as written and as arrays.

    success = "p"
    slip = "(1-p)/3"
    [parameters]
    p = [0.5, 1]                             the domain: p may be any number in it
    p = { domain = [0.5, 1], value = 0.93 }  the same, with the value that commands take which need one

An entry of a row is a + b·p. It is kept as its values at the two ends of the domain, `first` and `last`, exactly: at
p = lower + x·(upper − lower) it is (1 − x)·first + x·last. A row depends on at most one parameter.

Expressions are sums, differences and products of numbers and names (grammars/affine.lark), read by Lark and computed
in fractions; nothing is evaluated as code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.errors import ModelError, near_misses
from stltool.grammar import grammar_text
from stltool.models.fractions import Integers, over_one
from stltool.numbers import NumberError, exact, number_text

if TYPE_CHECKING:
    from lark import Lark, Token, Tree

Values: TypeAlias = Mapping[str, Fraction]

_LONGEST = 1000  # characters of an expression
_DEEPEST = 50  # parentheses


@dataclass(frozen=True)
class Parameter:
    """`name` lies in [lower, upper]; `value` is the one to use where one is needed (None: it was not given)."""

    name: str
    lower: Fraction
    upper: Fraction
    value: Fraction | None = None

    @property
    def domain(self) -> str:
        return f"[{number_text(self.lower)}, {number_text(self.upper)}]"

    def require(self, value: Fraction) -> Fraction:
        """ModelError unless the value lies in the domain."""
        if not self.lower <= value <= self.upper:
            raise ModelError(f"{self.name} = {number_text(value)} lies outside its domain {self.domain}")
        return value

    def within(self, lower: Fraction, upper: Fraction) -> Parameter:
        """The parameter on a part of its domain. ModelError unless it is one."""
        if lower > upper:
            raise ModelError(
                f"{self.name}: {number_text(lower)} is above {number_text(upper)}; the lower end of a range comes first"
            )
        return Parameter(self.name, self.require(lower), self.require(upper))

    def share(self, value: Fraction) -> Fraction:
        """x in [0, 1]: where in the domain a value lies."""
        width = self.upper - self.lower
        return (value - self.lower) / width if width else Fraction(0)


@dataclass(frozen=True, eq=False)
class Ties:
    """The entries of rows as functions of parameters.

    parameters   in order
    first, last  (e,) integers over `denominator`: each entry at the ends of its parameter's domain
    parameter    (e,) the number of the parameter; 0 where an entry depends on none (there first = last)
    """

    parameters: tuple[Parameter, ...]
    first: Integers = field(repr=False)
    last: Integers = field(repr=False)
    denominator: int
    parameter: NDArray[np.int16] = field(repr=False)

    @cached_property
    def _classes(self) -> tuple[list[tuple[int, int, int]], NDArray[np.int64]]:
        known: dict[tuple[int, int, int], int] = {}
        columns = zip(self.parameter.tolist(), self.first.tolist(), self.last.tolist(), strict=True)
        which = [known.setdefault(one, len(known)) for one in columns]
        return list(known), np.array(which, dtype=np.int64)

    @property
    def classes(self) -> list[tuple[int, Fraction, Fraction]]:
        """The distinct functions: (parameter, first, last)."""
        return [(k, Fraction(a, self.denominator), Fraction(b, self.denominator)) for k, a, b in self._classes[0]]

    @property
    def which(self) -> NDArray[np.int64]:
        """(e,) the class of each entry."""
        return self._classes[1]

    def at(self, values: Values) -> list[Fraction]:
        """The value of each class."""
        shares = [one.share(one.require(values[one.name])) for one in self.parameters]
        return [(1 - shares[k]) * a + shares[k] * b for k, a, b in self.classes]

    def doubles(self, values: Values) -> NDArray[np.float64]:
        """(e,) the entries, each the double nearest to its value."""
        return np.array([float(value) for value in self.at(values)])[self.which]

    def over(self, *values: Values) -> tuple[list[Integers], int]:
        """(e,) integers for each of these values, the entries, over one denominator, which comes last."""
        found = [value for point in values for value in self.at(point)]
        numerators, denominator = over_one(found)
        return [one[self.which] for one in np.split(numerators, len(values))], denominator

    def narrowed(self, parameters: tuple[Parameter, ...]) -> Ties:
        """The same functions on parts of the domains."""
        (first, last), denominator = self.over(
            *({one.name: end(one) for one in parameters} for end in (_lower, _upper))
        )
        return Ties(parameters, first, last, denominator, self.parameter)

    def text(self) -> str:
        """What identifies the functions, for a digest."""
        named = [(one.name, str(one.lower), str(one.upper)) for one in self.parameters]
        return f"{named} {self.classes} {self.which.tolist()}"


def _lower(parameter: Parameter) -> Fraction:
    return parameter.lower


def _upper(parameter: Parameter) -> Fraction:
    return parameter.upper


# ------------------------------------------------------------------------------------------------------- declarations


def read_parameters(table: object) -> dict[str, Parameter]:
    """The parameters that a table, or a mapping, declares. Raises ModelError."""
    if not isinstance(table, Mapping):
        raise ModelError(f"parameters is {described(table)}; write [parameters] with a line such as p = [0.5, 1]")
    return {str(name): read_parameter(name, given) for name, given in table.items()}


def read_parameter(name: object, given: Any) -> Parameter:
    """One declaration: a domain, or a table with `domain` and `value`. Raises ModelError."""
    if not isinstance(name, str) or not name.isidentifier() or not name.isascii():
        raise ModelError(f"parameter {name!r}: names consist of letters, digits and _, such as p or slip_2")
    domain, value = given, None
    if isinstance(given, Mapping):
        for key in given:
            if key not in ("domain", "value"):
                raise ModelError(f"parameter {name}: unknown key {key}; {near_misses(str(key), ('domain', 'value'))}")
        domain, value = given.get("domain"), given.get("value")
    if isinstance(domain, str) or not hasattr(domain, "__len__") or len(domain) != 2:
        shown = f" is {described(given)}" if not isinstance(given, Mapping) else " has no domain of two numbers"
        raise ModelError(
            f"parameter {name}{shown}; write its domain, {name} = [0.5, 1], or with a value "
            f"{name} = {{ domain = [0.5, 1], value = 0.93 }}"
        )
    lower, upper = (_number(name, end) for end in domain)
    if lower > upper:
        raise ModelError(
            f"parameter {name}: the domain is [{number_text(lower)}, {number_text(upper)}]; the lower end comes first"
        )
    found = Parameter(name, lower, upper, _number(name, value) if value is not None else None)
    if found.value is not None:
        found.require(found.value)
    return found


def _number(name: str, value: object) -> Fraction:
    try:
        return exact(value)
    except NumberError as error:
        raise ModelError(f"parameter {name}: {error}") from None


# -------------------------------------------------------------------------------------------------------- expressions


@dataclass(frozen=True)
class Affine:
    """constant + Σ slope[name] · name, exactly; slopes are not 0."""

    constant: Fraction
    slopes: Mapping[str, Fraction] = field(default_factory=dict)

    def at(self, values: Values) -> Fraction:
        return self.constant + sum((slope * values[name] for name, slope in self.slopes.items()), Fraction(0))

    def plus(self, other: Affine, factor: Fraction = Fraction(1)) -> Affine:
        names = [*self.slopes, *(name for name in other.slopes if name not in self.slopes)]
        slopes = {name: self.slopes.get(name, Fraction(0)) + factor * other.slopes.get(name, 0) for name in names}
        return Affine(self.constant + factor * other.constant, {name: x for name, x in slopes.items() if x})

    def times(self, factor: Fraction) -> Affine:
        return Affine(Fraction(0)).plus(self, factor)


def read_affine(value: object, parameters: Mapping[str, Parameter]) -> Affine:
    """The function of parameters that a number or a text stands for. Raises ModelError with the fault."""
    if not isinstance(value, str):
        return Affine(_exact(value))
    from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedInput

    depth = most = 0
    for character in value:
        depth += (character == "(") - (character == ")")
        most = max(most, depth)
    if len(value) > _LONGEST or most > _DEEPEST or value.count("-") > 10 * _DEEPEST:
        raise ModelError(f"this expression is too long: at most {_LONGEST} characters, {_DEEPEST} parentheses deep")
    try:
        tree = _parser().parse(value)
    except UnexpectedEOF:
        raise ModelError(f"{value!r} ends too early; write a number, or an expression such as (1-p)/3") from None
    except UnexpectedCharacters as fault:
        found = value[fault.pos_in_stream or 0]
        raise ModelError(
            f"{value!r}: {found!r} has no meaning here (column {fault.column}); expressions consist of numbers, "
            "parameters, + - * / and parentheses"
        ) from None
    except UnexpectedInput as fault:
        token = str(getattr(fault, "token", ""))
        where = f"unexpected {token!r} (column {fault.column})" if token else "it ends too early"
        remedy = "an operand is missing"
        if depth > 0:
            remedy = "a parenthesis is not closed"
        elif depth < 0:
            remedy = "a parenthesis was never opened"
        elif token and (token[0].isalnum() or token[0] in "_("):
            remedy = "write * between factors, as in 2*p"
        raise ModelError(f"{value!r}: {where}; {remedy}") from None
    return _affine(tree.children[0], value, parameters)


def _affine(tree: Tree[Token] | Token, text: str, parameters: Mapping[str, Parameter]) -> Affine:
    children: list[Any] = getattr(tree, "children", [])
    match getattr(tree, "data", None):
        case "number":
            return Affine(_exact(str(children[0])))
        case "name":
            name = str(children[0])
            if name not in parameters:
                declared = f"declare it at the end of the model file:\n  [parameters]\n  {name} = [0.5, 1]"
                hint = near_misses(name, parameters) if parameters else declared
                raise ModelError(f"{text!r}: there is no parameter {name}; {hint}")
            return Affine(Fraction(0), {name: Fraction(1)})
        case "negated":
            return _affine(children[0], text, parameters).times(Fraction(-1))
        case "plus" | "minus" | "times" | "over" as operation:
            left, right = (_affine(child, text, parameters) for child in children)
            if operation in ("plus", "minus"):
                return left.plus(right, Fraction(1 if operation == "plus" else -1))
            if operation == "over" and not right.slopes and right.constant == 0:
                raise ModelError(f"{text!r} divides by zero")
            if operation == "times" and not left.slopes:
                left, right = right, left
            if right.slopes:
                fault = "multiplies parameters" if operation == "times" else "divides by a parameter"
                raise ModelError(f"{text!r} {fault}; probabilities must be linear in them, such as (1-p)/3")
            return left.times(right.constant if operation == "times" else 1 / right.constant)
        case _:  # pragma: no cover - the grammar has no other rules
            raise AssertionError(tree)


def _exact(value: object) -> Fraction:
    try:
        return exact(value)
    except NumberError as error:
        raise ModelError(f'{error}; write a number, a fraction in quotes such as "7/300", or "(1-p)/3"') from None


@cache
def _parser() -> Lark:
    from lark import Lark

    return Lark(grammar_text("affine.lark"), parser="lalr")
