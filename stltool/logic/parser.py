"""Text → Formula / Task: the only module that imports lark.

The grammar (grammars/stl.lark) puts truth values and numbers on one ladder of operators; the builder here tells them
apart, substitutes params and definitions, and turns every interval into closed whole steps. No token is dropped or
guessed at: a tree node without a builder is an error, and so is a number where a truth value must stand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import NoReturn, TypeVar, cast, get_args

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedInput, UnexpectedToken

from stltool.errors import SettingsError, StlSyntaxError, near_misses
from stltool.files import read_text
from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    ArithmeticOperator,
    Call,
    Comparator,
    Comparison,
    Constant,
    Eventually,
    Formula,
    FunctionName,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Or,
    Term,
    Until,
    Variable,
    children,
    walk,
)
from stltool.logic.grammar import grammar_text
from stltool.logic.printer import term_text
from stltool.logic.source import Source, Span
from stltool.logic.task import Task

ParamValue = int | float | str | Fraction

_COMPARATOR_SPELLINGS = {"≤": "<=", "≥": ">=", "≠": "!="}
_FORMULAS = get_args(Formula)
_LONGEST_NUMBER = 60  # characters; a longer literal is a slip, and its exact value would fill memory
_LARGEST_EXPONENT = 64
_LARGEST_BITS = 4000
_LARGEST_BOUND = 10**15
_MOST_NODES = 50_000
_DEEPEST = 200
_EQUAL_HINT = "write == to compare, := to define"

# What the parser expected, in words. A test holds that every terminal of the grammar stands here.
_OPERATORS = (
    "_IFF",
    "_XOR",
    "_IMPLIES",
    "_OR",
    "_AND",
    "_UNTIL",
    "COMPARATOR",
    "PLUS",
    "MINUS",
    "TIMES",
    "DIVIDE",
    "POWER",
)
_FORMULA_STARTS = ("NAME", "NUMBER", "TRUE", "FALSE", "FUNCTION", "LPAR", "MINUS", "_NOT", "_EVENTUALLY", "_ALWAYS")
_TERM_STARTS = ("NAME", "NUMBER", "FUNCTION", "LPAR", "MINUS")
_STATEMENT_STARTS = ("_MODEL", "_PARAM")
TERMINAL_WORDS = {
    **dict.fromkeys(_OPERATORS, "an operator"),
    **dict.fromkeys(_FORMULA_STARTS, "a formula"),
    "NAME": "a name",
    "NUMBER": "a number",
    "FUNCTION": "a function",
    "LPAR": "'('",
    "MINUS": "'-'",
    "RPAR": "')'",
    "LSQB": "'['",
    "RSQB": "']'",
    "COMMA": "','",
    "COLON": "':'",
    "DOTS": "'..'",
    "ASSIGN": "':='",
    "EQUAL": "'='",
    "SEMICOLON": "';'",
    "STRING": 'a file name in quotes ("floor.toml")',
    "_MODEL": "a model line",
    "_PARAM": "a param line",
    "COMMENT": "a comment",
    "$END": "the end",
}


@cache
def _lark(start: str) -> Lark:
    # the basic lexer: a word means the same wherever it stands; one start a parser: sharper expectations
    return Lark(
        grammar_text("stl.lark"),
        parser="lalr",
        lexer="basic",
        start=start,
        propagate_positions=True,
        maybe_placeholders=False,
    )


def parse(text: str, params: Mapping[str, ParamValue] | None = None, name: str = "formula") -> Formula:
    """The formula that `text` spells; `params` gives values to the names its bounds and predicates use.

    `name` stands for the text in messages. Raises StlSyntaxError with line, column and a caret.
    """
    source = Source(name, text)
    builder = _Builder(source, _exact_params(params))
    tree = _parse_tree(source, "formula")
    with_limit = _guard_depth(builder.formula, source)
    return with_limit(cast(Tree[Token], tree.children[0]))


def parse_task(
    text: str,
    params: Mapping[str, ParamValue] | None = None,
    task: str | None = None,
    name: str = "task",
    path: Path | None = None,
) -> Task:
    """The task that a task file's text describes; see `load_task`."""
    source = Source(name, text)
    builder = _Builder(source, {}, overrides=_exact_params(params))
    _guard_depth(builder.statements, source)(_parse_tree(source, "task"))
    if not builder.definitions:
        raise StlSyntaxError(f"{name}: no task in this file; write one such as: reach := F[0,10] A")
    if builder.overrides.keys() - builder.params.keys():
        unknown = min(builder.overrides.keys() - builder.params.keys())
        raise StlSyntaxError(f"{name}: no param {unknown} to override; {near_misses(unknown, builder.params)}")
    chosen = task if task is not None else list(builder.definitions)[-1]
    if chosen not in builder.definitions:
        raise StlSyntaxError(f"{name}: no definition {chosen}; {near_misses(chosen, builder.definitions)}")
    formula = builder.definitions[chosen]
    if isinstance(formula, _FORMULAS):
        _require_shallow(cast(Formula, formula), source)
    if not isinstance(formula, _FORMULAS):
        raise StlSyntaxError(
            f"{name}: {chosen} is a number, not a task; end the file with a formula or choose one by name"
        )
    folder = path.parent if path is not None else Path()
    model = folder / builder.model if builder.model is not None else None
    return Task(chosen, cast(Formula, formula), model, builder.params, builder.definitions, path)


def load_task(path: str | Path, params: Mapping[str, ParamValue] | None = None, task: str | None = None) -> Task:
    """Read a task file.

    `params` overrides param lines of the file; `task` chooses a definition (default: the last). Raises FileError when
    the file cannot be read as text, StlSyntaxError when it does not parse.
    """
    path = Path(path)
    return parse_task(read_text(path, "task file"), params, task, name=str(path), path=path)


def _exact_params(params: Mapping[str, ParamValue] | None) -> dict[str, Fraction]:
    values = {}
    for name, value in (params or {}).items():
        try:
            text = str(value)
            parts = [Decimal(part) for part in text.split("/", 1)]
            if len(text) > _LONGEST_NUMBER or any(abs(part.adjusted()) > _LARGEST_EXPONENT for part in parts):
                raise ValueError
            values[name] = Fraction(text)
        except (ValueError, InvalidOperation, ZeroDivisionError):
            raise SettingsError(f"param {name}: {value!r} is not a number; write for example {name}=20") from None
    return values


# --------------------------------------------------------------------------------------------------- trees


class _Builder:
    """Turns lark's tree into nodes, with the params and definitions read so far."""

    def __init__(
        self, source: Source, params: dict[str, Fraction], overrides: dict[str, Fraction] | None = None
    ) -> None:
        self.source = source
        self.params = params
        self.overrides = overrides or {}
        self.definitions: dict[str, Formula | Term] = {}
        self.model: str | None = None
        self.names_used: dict[str, Span] = {}  # labels and signals, where first
        self.budget = _MOST_NODES

    # ------------------------------------------------------------------------------------------ statements

    def statements(self, tree: Tree[Token]) -> None:
        for statement in cast(list[Tree[Token]], tree.children):
            match statement.data:
                case "model":
                    if self.model is not None:
                        self.fail(statement, "a second model line; a task file has one")
                    self.model = str(statement.children[0])[1:-1]
                    if not self.model:
                        self.fail(statement, 'the model line names no file; write model "floor.toml"')
                case "params":
                    for param in cast(list[Tree[Token]], statement.children):
                        self.param(param)
                case "definition":
                    self.definition(statement)
                case other:
                    raise AssertionError(f"the grammar's rule {other} has no builder")

    def param(self, tree: Tree[Token]) -> None:
        token, expression = cast(tuple[Token, Tree[Token]], tuple(tree.children))
        self.claim(token, "param")
        value = self.constant(expression)  # checked even where it is overridden
        self.params[str(token)] = self.overrides.get(str(token), value)

    def definition(self, tree: Tree[Token]) -> None:
        token, body = cast(tuple[Token, Tree[Token]], tuple(tree.children))
        body = cast(Tree[Token], body.children[0])
        node = self.term(body) if self.is_term(body) else self.formula(body)
        self.claim(token, "definition")
        self.definitions[str(token)] = node

    def claim(self, token: Token, what: str) -> None:
        name = str(token)
        if name in self.params or name in self.definitions:
            self.fail(token, f"{name} is defined twice; give this {what} another name")
        if name in self.names_used:
            place = self.names_used[name]
            self.fail(
                token,
                f"{name} is a label or signal on line {place.line} and would be a {what} from here on; "
                f"give this {what} another name, or move it up if line {place.line} means it",
            )

    # ------------------------------------------------------------------------------------------ truth values

    def spend(self, tree: Tree[Token], nodes: int) -> None:
        self.budget -= nodes
        if self.budget < 0:
            self.fail(tree, f"definitions used many times make this formula larger than {_MOST_NODES} operators")

    def formula(self, tree: Tree[Token]) -> Formula:
        span = self.span(tree)
        parts = cast(list[Tree[Token]], tree.children)
        match tree.data:
            case "true" | "false":
                return Constant(tree.data == "true", span=span)
            case "name":
                return self.named_formula(tree)
            case "not":
                return Not(self.formula(parts[0]), span=span)
            case "and":
                return And(tuple(self.formula(part) for part in parts), span=span)
            case "or":
                return Or(tuple(self.formula(part) for part in parts), span=span)
            case "implies":
                return Implies(self.formula(parts[0]), self.formula(parts[1]), span=span)
            case "iff":
                return Iff(self.formula(parts[0]), self.formula(parts[1]), span=span)
            case "xor":
                return Not(Iff(self.formula(parts[0]), self.formula(parts[1]), span=span), span=span)
            case "eventually":
                return Eventually(self.interval(parts[0]), self.formula(parts[1]), span=span)
            case "always":
                return Always(self.interval(parts[0]), self.formula(parts[1]), span=span)
            case "until":
                return Until(self.interval(parts[1]), self.formula(parts[0]), self.formula(parts[2]), span=span)
            case "comparison":
                left, op, right = parts
                return Comparison(self.comparator(op), self.term(left), self.term(right), span=span)
            case "chained":
                self.fail(tree, f"comparisons do not chain; write {self.unchained(tree)}")
            case "number" | "binary" | "negate" | "call":
                self.fail(tree, f"a number where a truth value must stand; compare it, as in {span.text()} > 0")
            case other:
                raise AssertionError(f"the grammar's rule {other} has no builder")

    def named_formula(self, tree: Tree[Token]) -> Formula:
        name, span = str(tree.children[0]), self.span(tree)
        if name in self.definitions:
            node = self.definitions[name]
            if isinstance(node, _FORMULAS):
                self.spend(tree, sum(1 for _ in walk(cast(Formula, node))))
                return cast(Formula, node)
            self.fail(tree, f"{name} is a number here, not a truth value; compare it, as in {name} > 0")
        if name in self.params:
            self.fail(tree, f"{name} is a param, a number, not a truth value; compare something with it")
        self.names_used.setdefault(name, span)
        return Label(name, span=span)

    def comparator(self, token: Tree[Token] | Token) -> Comparator:
        return cast(Comparator, _COMPARATOR_SPELLINGS.get(str(token), str(token)))

    def unchained(self, tree: Tree[Token]) -> str:
        """`2 < x < 4` → `x > 2 & x < 4`."""
        mirror = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
        terms = [self.term(cast(Tree[Token], part)) for part in tree.children[::2]]
        ops = [self.comparator(cast(Token, part)) for part in tree.children[1::2]]
        pairs = []
        for left, op, right in zip(terms, ops, terms[1:], strict=False):
            flip = isinstance(left, Number) and not isinstance(right, Number)
            a, o, b = (right, mirror[op], left) if flip else (left, op, right)
            pairs.append(f"{term_text(a)} {o} {term_text(b)}")
        return " & ".join(pairs)

    def interval(self, tree: Tree[Token]) -> Interval:
        opening, lower, upper, closing = cast(tuple[Token, Tree[Token], Tree[Token], Token], tuple(tree.children))
        a, b = self.whole_steps(lower), self.whole_steps(upper)
        if a < 0:
            self.fail(lower, f"the interval starts at step {a}; steps count from 0")
        first, last = a + (opening == "("), b - (closing == ")")
        if last < first:
            example = f"[{a},{max(a, b) + 1})" if closing == ")" else f"[{a},{max(a, b)}]"
            shown = f"{opening}{a},{b}{closing}"
            self.fail(tree, f"the interval {shown} is empty: it holds no step; write for example {example}")
        return Interval(first, last)

    def whole_steps(self, tree: Tree[Token]) -> int:
        value = self.constant(tree)
        if value.denominator != 1:
            self.fail(
                tree,
                f"the bound {float(value):g} is not a whole number of steps; "
                f"write {math.floor(value)} or {math.ceil(value)}",
            )
        if abs(value) > _LARGEST_BOUND:
            self.fail(tree, "this bound is out of range; count in larger steps")
        return value.numerator

    # ------------------------------------------------------------------------------------------ numbers

    def is_term(self, tree: Tree[Token]) -> bool:
        if tree.data == "name":
            name = str(tree.children[0])
            known = self.definitions.get(name)
            return name in self.params or (known is not None and not isinstance(known, _FORMULAS))
        return tree.data in ("number", "binary", "negate", "call")

    def term(self, tree: Tree[Token]) -> Term:
        span = self.span(tree)
        parts = tree.children
        match tree.data:
            case "number":
                return Number(self.literal_float(cast(Token, parts[0])), span=span)
            case "name":
                return self.named_term(tree)
            case "negate":
                return Negate(self.term(cast(Tree[Token], parts[0])), span=span)
            case "binary":
                left, op, right = cast(tuple[Tree[Token], Token, Tree[Token]], tuple(parts))
                return Arithmetic(cast(ArithmeticOperator, str(op)), self.term(left), self.term(right), span=span)
            case "call":
                args = tuple(self.term(cast(Tree[Token], part)) for part in parts[1:])
                return self.wrapped(tree, lambda: Call(cast(FunctionName, str(parts[0])), args, span=span))
            case "comparison" | "chained" | "true" | "false" | "not" | "and" | "or":
                self.fail(tree, "a truth value where a number must stand; check the parentheses")
            case "implies" | "iff" | "xor" | "until" | "eventually" | "always":
                self.fail(tree, "a truth value where a number must stand; check the parentheses")
            case other:
                raise AssertionError(f"the grammar's rule {other} has no builder")

    def named_term(self, tree: Tree[Token]) -> Term:
        name, span = str(tree.children[0]), self.span(tree)
        if name in self.params:
            value = self.param_value(tree, self.params[name])
            number = Number(abs(value), span=span)
            return Negate(number, span=span) if value < 0 else number
        if name in self.definitions:
            node = self.definitions[name]
            if isinstance(node, _FORMULAS):
                self.fail(tree, f"{name} is a truth value, not a number; it cannot be compared or computed with")
            return cast(Term, node)
        self.names_used.setdefault(name, span)
        return Variable(name, span=span)

    def param_value(self, tree: Tree[Token], value: Fraction) -> float:
        try:
            return float(value)
        except OverflowError:
            self.fail(tree, "the value of this param is too large to compare with")

    def literal_float(self, token: Token) -> float:
        value = float(str(token))
        if not math.isfinite(value) or (value == 0 and Decimal(str(token)) != 0):
            self.fail(token, f"{token} is too {'small' if value == 0 else 'large'} for a double")
        return value

    def constant(self, tree: Tree[Token]) -> Fraction:
        """The exact value of an expression over numbers and params."""
        parts = cast(list[Tree[Token]], tree.children)
        match tree.data:
            case "number":
                text = str(parts[0])
                if len(text) > _LONGEST_NUMBER or abs(Decimal(text).adjusted()) > _LARGEST_EXPONENT:
                    self.fail(tree, "this number is out of range for a param or a bound")
                return Fraction(text)
            case "name":
                name = str(parts[0])
                if name not in self.params:
                    known = near_misses(name, self.params) if self.params else f"give it a value: param {name} = 10"
                    self.fail(tree, f"{name} is not a param; {known}")
                return self.params[name]
            case "negate":
                return -self.constant(parts[0])
            case "call":
                return self.constant_call(tree)
            case "binary":
                return self.constant_binary(tree)
            case _:
                self.fail(tree, "a truth value where a number must stand")

    def constant_call(self, tree: Tree[Token]) -> Fraction:
        function, *args = cast(list[Tree[Token]], tree.children)
        values = [self.constant(arg) for arg in args]
        self.wrapped(tree, lambda: Call(cast(FunctionName, str(function)), (Number(0.0),) * len(values)))
        match str(function):
            case "abs":
                return abs(values[0])
            case "min":
                return min(values)
            case "max":
                return max(values)
            case other:
                self.fail(tree, f"{other} has no exact value; give the number itself")

    def constant_binary(self, tree: Tree[Token]) -> Fraction:
        left, op, right = cast(tuple[Tree[Token], Token, Tree[Token]], tuple(tree.children))
        a, b = self.constant(left), self.constant(right)
        match str(op):
            case "+":
                return a + b
            case "-":
                return a - b
            case "*":
                return a * b
            case "/":
                if b == 0:
                    self.fail(tree, "division by zero")
                return a / b
            case "^":
                large = max(a.numerator.bit_length(), a.denominator.bit_length()) * abs(b) > _LARGEST_BITS
                if b.denominator != 1 or abs(b) > _LARGEST_EXPONENT or (a == 0 and b < 0) or large:
                    self.fail(tree, f"this power is out of range: whole exponents up to {_LARGEST_EXPONENT} only")
                return a**b.numerator
            case other:
                raise AssertionError(f"the grammar's operator {other} has no meaning")

    # ------------------------------------------------------------------------------------------ places

    def span(self, item: Tree[Token] | Token) -> Span:
        if isinstance(item, Token):
            return Span(self.source, item.start_pos or 0, item.end_pos or 0)
        return Span(self.source, item.meta.start_pos, item.meta.end_pos)

    def fail(self, item: Tree[Token] | Token, message: str) -> NoReturn:
        raise StlSyntaxError(self.span(item).show(message))

    def wrapped(self, tree: Tree[Token], build: Callable[[], _T]) -> _T:
        """A node constructor's complaint, with its place."""
        try:
            return build()
        except StlSyntaxError as error:
            self.fail(tree, str(error))


_T = TypeVar("_T")
_Result = TypeVar("_Result")


def _guard_depth(build: Callable[[Tree[Token]], _Result], source: Source) -> Callable[[Tree[Token]], _Result]:
    """The builder walks trees by recursion; a text nested deeper than that allows is refused in words."""

    def guarded(tree: Tree[Token]) -> _Result:
        try:
            result = build(tree)
        except RecursionError:
            raise _too_deep(source) from None
        if isinstance(result, _FORMULAS):
            _require_shallow(cast(Formula, result), source)
        return result

    return guarded


def _require_shallow(phi: Formula, source: Source) -> None:
    """Later walks recurse; a depth that they all bear is the limit."""
    level: list[Formula | Term] = [phi]
    for _ in range(_DEEPEST):
        level = [child for node in level for child in _operands(node)]
        if not level:
            return
    raise _too_deep(source)


def _operands(node: Formula | Term) -> tuple[Formula | Term, ...]:
    match node:
        case Comparison(_, left, right) | Arithmetic(_, left, right):
            return (left, right)
        case Negate(arg):
            return (arg,)
        case Call(_, args):
            return args
        case Number() | Variable():
            return ()
        case _:
            return children(node)


def _too_deep(source: Source) -> StlSyntaxError:
    return StlSyntaxError(
        f"{source.name}: operators are nested too deeply, over {_DEEPEST} levels; simplify the formula, or write "
        "a & b & c in one level"
    )


# --------------------------------------------------------------------------------------------------- syntax errors


def _parse_tree(source: Source, start: str) -> Tree[Token]:
    if start == "formula" and not source.text.strip():
        raise StlSyntaxError(f"{source.name}: the text is empty; write a formula such as F[0,10] A")
    try:
        return _lark(start).parse(source.text)
    except UnexpectedInput as error:
        raise StlSyntaxError(_explain(error, source, _lark(start))) from None


def _explain(error: UnexpectedInput, source: Source, lark: Lark) -> str:
    """What stands there, what was expected, and what to write instead."""
    if not isinstance(error, UnexpectedToken):
        position = error.pos_in_stream or 0
        character = source.text[position]
        shown = repr(character) if character.isprintable() else f"U+{ord(character):04X}"
        if character.isdigit() or character == ".":
            message = "this number is glued to letters; put an operator or a space between"
        elif character == "=":
            message = f"'=' cannot stand here; {_EQUAL_HINT}"
        else:
            message = f"the character {shown} has no meaning here; remove it or spell the operator in words"
        return Span(source, position, position + 1).show(message)
    token = error.token
    at_end = token.type == "$END"
    start = len(source.text.rstrip()) if at_end else token.start_pos or 0
    span = Span(source, start, start + 1 if at_end else token.end_pos or start + 1)
    accepted = set(error.accepts or error.expected) or {"$END"}
    earlier = itertools.takewhile(lambda t: (t.end_pos or 0) <= start, lark.lex(source.text))
    hint = _hint(token, [None, None, *earlier][-2:], accepted)
    found = "the text ends here" if at_end else f"{str(token)!r} cannot stand here"
    return span.show(f"{found}; {hint or 'expected ' + _expected(accepted)}")


def _hint(token: Token, earlier: list[Token | None], accepted: set[str]) -> str | None:
    """What to write instead, for the slips that people make; `earlier` holds the two tokens before."""
    types = [t.type if t is not None else "" for t in earlier]
    before = earlier[-1]
    temporal = ("_EVENTUALLY", "_ALWAYS", "_UNTIL")
    opened = types[0] in temporal and types[1] in ("LPAR", "LSQB")
    if types[1] in temporal or opened or "DOTS" in accepted:
        return (
            "a temporal operator needs an interval in whole steps, such as F[0,10] (a label with an operator's name, "
            "F, G or U, must be renamed)"
        )
    if token.type == "EQUAL":
        return _EQUAL_HINT
    if token.type == "_UNTIL" and "_AND" in accepted:
        return "until does not chain; put parentheses around one of them"
    if types[1] == "NAME" and token.type == "LPAR":
        return f"{before} is not a function (abs, min, max, sqrt are); put an operator before '('"
    if types[1] == "NAME" and token.type == "LSQB":
        return f"{before} is not an operator that takes an interval (F, G, U and their words are)"
    if token.type in ("NAME", "NUMBER") and types[1] in ("NAME", "NUMBER", "RPAR"):
        return f"expected an operator between {str(before)!r} and {str(token)!r}"
    return None


def _expected(accepted: set[str]) -> str:
    words: list[str] = []
    rest = set(accepted)
    if rest.issuperset(_STATEMENT_STARTS):
        rest -= {*_STATEMENT_STARTS, "NAME", "SEMICOLON"}
        words.append("the next line (model, param or name := formula)")
    if rest.issuperset(_FORMULA_STARTS):
        rest -= set(_FORMULA_STARTS)
        words.append("a formula")
    elif rest.issuperset(_TERM_STARTS):
        rest -= set(_FORMULA_STARTS)
        words.append("a number, a signal or an arithmetic expression")
    words += sorted({TERMINAL_WORDS[terminal] for terminal in rest})
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
