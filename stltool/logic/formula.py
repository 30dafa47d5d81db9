"""The abstract syntax: frozen nodes, the closed unions `Formula` and `Term`.

    φ ::= true | false | label | term ⋈ term | ¬φ | φ ∧ … ∧ φ | φ ∨ … ∨ φ | φ → φ | φ ↔ φ
        | F[a,b] φ | G[a,b] φ | φ U[a,b] φ | φ release[a,b] φ                (0 ≤ a ≤ b integer steps, or no b)
        | once[a,b] φ | historically[a,b] φ | φ since[a,b] φ | φ trigger[a,b] φ | rise φ

The second line looks ahead, the third back, never further than step 0. `prev φ` is once[1,1] φ, `fall φ` is rise ¬φ,
and φ weak_until[a,b] ψ is (φ U[a,b] ψ) ∨ G[0,b] φ. Intervals are closed and in integer steps, whatever the text said.
Functions over formulas are one `match` that ends in `assert_never`, so the type checker finds a forgotten case. A node
keeps its position in the text (`span`), which is ignored by equality.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal, NoReturn, TypeAlias, TypeVar, assert_never

from stltool.arguments import described, kind_name, require
from stltool.display import Card, Displayed, cut
from stltool.errors import ArgumentError, StlSyntaxError
from stltool.source import Span

if TYPE_CHECKING:
    from stltool.logic.task import Task

Comparator = Literal["<", "<=", ">", ">=", "==", "!="]
ArithmeticOperator = Literal["+", "-", "*", "/", "^"]
FunctionName = Literal["abs", "min", "max", "sqrt"]

MOST_NODES = 50_000
LARGEST_BOUND = 10**15  # steps
DEEPEST = 200  # levels of operators: most traversals recurse

COMPARATORS: tuple[Comparator, ...] = ("<", "<=", ">", ">=", "==", "!=")
_LONGEST_REPR = 290

FUNCTION_ARITY: dict[FunctionName, tuple[int, int | None]] = {
    "abs": (1, 1), "sqrt": (1, 1), "min": (2, None), "max": (2, None),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Node:
    """What all nodes share: the position in the text, if any, and the size, once computed."""

    span: Span | None = field(default=None, compare=False, repr=False, kw_only=True)
    _size: tuple[int, int] | None = field(default=None, compare=False, repr=False, init=False)


# ------------------------------------------------------------------------------------------- terms (real values)


@dataclass(frozen=True, slots=True)
class Number(Node):
    """A non-negative finite constant; a negative one is `Negate(Number(…))`, as in a text."""

    value: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or math.copysign(1.0, self.value) < 0:
            raise StlSyntaxError(f"Number({self.value}) must be finite and not negative; use Negate(Number(…))")


@dataclass(frozen=True, slots=True)
class Variable(Node):
    """The value of a named signal, `delay` steps before the evaluation step.

    A comparison is false at steps that lie before those it reads (logic/shifts.py).
    """

    name: str
    delay: int = 0


@dataclass(frozen=True, slots=True)
class Negate(Node):
    arg: Term


@dataclass(frozen=True, slots=True)
class Arithmetic(Node):
    op: ArithmeticOperator
    left: Term
    right: Term


@dataclass(frozen=True, slots=True)
class Call(Node):
    """abs, sqrt (one argument), min, max (two or more)."""

    function: FunctionName
    args: tuple[Term, ...]

    def __post_init__(self) -> None:
        least, most = FUNCTION_ARITY[self.function]
        if len(self.args) < least or (most is not None and len(self.args) > most):
            wanted = "one argument" if most == 1 else f"at least {least} arguments"
            raise StlSyntaxError(f"{self.function} takes {wanted}, not {len(self.args)}")


Term: TypeAlias = Number | Variable | Negate | Arithmetic | Call

# ------------------------------------------------------------------------------------------- formulas (truth values)


@dataclass(frozen=True, slots=True)
class Interval:
    """The steps a, a+1, …, b; without b, without end: for monitors and `check --for-ever`."""

    a: int
    b: int | None

    def __post_init__(self) -> None:
        for name, end in (("a", self.a), ("b", self.b)):
            if end is not None and type(end) is not int:  # numpy's narrow integers overflow in sums
                object.__setattr__(self, name, operator.index(end))
        if self.a < 0 or (self.b is not None and self.a > self.b):
            raise StlSyntaxError(f"the interval {self} is empty; write 0 <= a <= b")

    @property
    def last(self) -> int:
        """b; StlSyntaxError if there is none. Callers that ask `horizon` first get a message with a position."""
        if self.b is None:
            raise StlSyntaxError(f"the interval {self} has no end; write one, such as [{self.a},{self.a + 10}]")
        return self.b

    def __len__(self) -> int:
        return self.last - self.a + 1

    def __str__(self) -> str:
        return f"[{self.a},inf)" if self.b is None else f"[{self.a},{self.b}]"


class Composable(Displayed):
    """What `&`, `|`, `~` and `>>` (implication) combine: formulas, and tasks, which stand for their formula.

    `and`, `or`, `not` and chained comparisons ask for a truth value, which a formula does not have: a TypeError.
    Beware of Python's precedence: `>>` binds tighter than `&`, and `&` tighter than comparisons; use parentheses.
    """

    __slots__ = ()
    KIND: ClassVar[str] = "Formula"
    __array_ufunc__: ClassVar[None] = None  # numpy's numbers defer to the operators here

    def _formula(self) -> Formula:
        raise NotImplementedError

    def __and__(self, other: Formula | Task) -> And:
        return _joined(And, self._formula(), operand(other, "&"))

    def __or__(self, other: Formula | Task) -> Or:
        return _joined(Or, self._formula(), operand(other, "|"))

    def __rshift__(self, other: Formula | Task) -> Implies:
        return fitting(Implies(self._formula(), operand(other, ">>")))

    def __invert__(self) -> Not:
        return fitting(Not(self._formula()))

    def __rand__(self, other: object) -> NoReturn:
        refuse_operand(other, "&")

    def __ror__(self, other: object) -> NoReturn:
        refuse_operand(other, "|")

    def __rrshift__(self, other: object) -> NoReturn:
        refuse_operand(other, ">>")

    def __lt__(self, other: object) -> NoReturn:
        raise ArgumentError(
            f"{cut(str(self._formula()), 60)} is Boolean and cannot be compared; for a signal, write "
            "stl.signal('x') > 0.5, in parentheses next to & and |: (x > 0.5) & phi"
        )

    __le__ = __gt__ = __ge__ = __lt__

    def __bool__(self) -> NoReturn:
        raise ArgumentError(
            "a formula has no truth value by itself; write phi & psi, phi | psi, ~phi for and, or, not, "
            "(0.2 < x) & (x < 0.6) for 0.2 < x < 0.6, and stl.satisfies(phi, signals) to judge a trace"
        )


class _Printed(Composable):
    """Formulas print as text that parses back to them."""

    __slots__ = ()

    def _formula(self) -> Formula:
        return self  # type: ignore[return-value]  # only the members of `Formula` inherit this

    def __str__(self) -> str:
        from stltool.logic.printer import to_text

        return to_text(self)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        return f"stl.parse({cut(str(self), _LONGEST_REPR)!r})"

    def _card(self) -> Card:
        phi = self._formula()
        return Card(str(self), [{"horizon": horizon(phi) if is_bounded(phi) else "none: an interval has no end"}])


@dataclass(frozen=True, slots=True, repr=False)
class Constant(_Printed, Node):
    value: bool


@dataclass(frozen=True, slots=True, repr=False)
class Label(_Printed, Node):
    """A named Boolean signal: a label of the model."""

    name: str


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(_Printed, Node):
    """A predicate `left ⋈ right` over signal values; strictness is preserved."""

    op: Comparator
    left: Term
    right: Term


@dataclass(frozen=True, slots=True, repr=False)
class Not(_Printed, Node):
    arg: Formula


@dataclass(frozen=True, slots=True, repr=False)
class And(_Printed, Node):
    args: tuple[Formula, ...]

    def __post_init__(self) -> None:
        _at_least_two(self.args, "And")


@dataclass(frozen=True, slots=True, repr=False)
class Or(_Printed, Node):
    args: tuple[Formula, ...]

    def __post_init__(self) -> None:
        _at_least_two(self.args, "Or")


@dataclass(frozen=True, slots=True, repr=False)
class Implies(_Printed, Node):
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Iff(_Printed, Node):
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Eventually(_Printed, Node):
    """F[a,b] φ: φ at some step t+a … t+b."""

    interval: Interval
    arg: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Always(_Printed, Node):
    """G[a,b] φ: φ at every step t+a … t+b."""

    interval: Interval
    arg: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Until(_Printed, Node):
    """φ U[a,b] ψ: ψ at some u in t+a … t+b, and φ at every step of [t, u)."""

    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Release(_Printed, Node):
    """φ release[a,b] ψ = ¬(¬φ U[a,b] ¬ψ): at every u in t+a … t+b, ψ, unless φ at some step of [t, u)."""

    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Once(_Printed, Node):
    """once[a,b] φ: φ at some step t−b … t−a, of those from 0 on; `prev φ` is once[1,1] φ."""

    interval: Interval
    arg: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Historically(_Printed, Node):
    """historically[a,b] φ: φ at every step t−b … t−a, of those from 0 on."""

    interval: Interval
    arg: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Since(_Printed, Node):
    """φ since[a,b] ψ: ψ at some u in t−b … t−a, u ≥ 0, and φ at every step of (u, t]."""

    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Trigger(_Printed, Node):
    """φ trigger[a,b] ψ = ¬(¬φ since[a,b] ¬ψ): at every u in t−b … t−a, u ≥ 0: ψ, unless φ at some step of (u, t]."""

    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True, repr=False)
class Rise(_Printed, Node):
    """rise φ = φ ∧ ¬prev φ, which is φ at step 0; `fall φ` is rise ¬φ."""

    arg: Formula


Formula: TypeAlias = (
    Constant | Label | Comparison | Not | And | Or | Implies | Iff | Eventually | Always | Until | Release
    | Once | Historically | Since | Trigger | Rise
)  # fmt: skip

FUTURE = (Eventually, Always, Until, Release)
PAST = (Once, Historically, Since, Trigger, Rise)


def _at_least_two(args: tuple[Formula, ...], name: str) -> None:
    if len(args) < 2:
        raise StlSyntaxError(f"{name} needs at least two operands, not {len(args)}")


# ------------------------------------------------------------------------------------------- questions about formulas


def formula_of(phi: object, what: str) -> Formula:
    """The formula itself, or that of a task; for anything else an ArgumentError that says what to write."""
    if isinstance(phi, Composable):
        return phi._formula()
    require(phi, Composable, what)
    raise AssertionError


def bounded_formula_of(phi: object, what: str) -> Formula:
    """The same, for callers that need a horizon; StlSyntaxError if an interval has no end."""
    formula = formula_of(phi, what)
    horizon(formula)
    return formula


def children(phi: Formula) -> tuple[Formula, ...]:
    """The operands, left to right."""
    match phi:
        case Constant() | Label() | Comparison():
            return ()
        case Not(arg) | Eventually(_, arg) | Always(_, arg) | Once(_, arg) | Historically(_, arg) | Rise(arg):
            return (arg,)
        case And(args) | Or(args):
            return args
        case Implies(left, right) | Iff(left, right) | Until(_, left, right) | Release(_, left, right):
            return (left, right)
        case Since(_, left, right) | Trigger(_, left, right):
            return (left, right)
        case _:
            assert_never(phi)


def with_children(phi: Formula, new: tuple[Formula, ...]) -> Formula:
    """The same operator with other operands (the same number of them)."""
    match phi:
        case Constant() | Label() | Comparison():
            return phi
        case Not():
            return Not(new[0], span=phi.span)
        case And():
            return And(new, span=phi.span)
        case Or():
            return Or(new, span=phi.span)
        case Implies():
            return Implies(new[0], new[1], span=phi.span)
        case Iff():
            return Iff(new[0], new[1], span=phi.span)
        case Eventually(interval, _) | Always(interval, _) | Once(interval, _) | Historically(interval, _):
            return type(phi)(interval, new[0], span=phi.span)
        case Until(interval, _, _) | Release(interval, _, _) | Since(interval, _, _) | Trigger(interval, _, _):
            return type(phi)(interval, new[0], new[1], span=phi.span)
        case Rise():
            return Rise(new[0], span=phi.span)
        case _:
            assert_never(phi)


def walk(phi: Formula) -> Iterator[Formula]:
    """Every sub-formula, outside in, left to right."""
    stack = [phi]
    while stack:
        node = stack.pop()
        yield node
        stack.extend(reversed(children(node)))


def distinct(phi: Formula) -> Iterator[Formula]:
    """Every sub-formula object once, outside in: in formulas composed in Python, objects can be shared."""
    stack, seen = [phi], set[int]()
    while stack:
        node = stack.pop()
        if id(node) not in seen:
            seen.add(id(node))
            yield node
            stack.extend(reversed(children(node)))


def horizon(phi: Formula | Task) -> int:
    """The number of steps after the evaluation step that can affect the truth value (docs/semantics.md §1).

    A trace needs `horizon(φ) + 1` samples to decide φ at step 0. Raises StlSyntaxError if an operator's interval has no
    end.
    """
    return _horizon(formula_of(phi, "horizon's formula"))


def _horizon(phi: Formula) -> int:
    below = [_horizon(child) for child in children(phi)]
    match phi:
        case Eventually(interval, _) | Always(interval, _) | Until(interval, _, _) | Release(interval, _, _):
            if interval.b is None:
                message = (
                    f"{_OPERATOR_WORDS[type(phi)]} has no interval with an end, hence no horizon; write one, such as "
                    f"[{interval.a},{interval.a + 10}] (as it is, only monitors of whole traces judge it, with end cut "
                    "or hold, and check --for-ever)"
                )
                raise StlSyntaxError(phi.span.show(message) if phi.span is not None else message)
            return interval.b + max(below)
        case Once(interval, _) | Historically(interval, _):
            return max(below[0] - interval.a, 0)
        case Since(interval, _, _) | Trigger(interval, _, _):
            return max(below[0] if interval.b != 0 else 0, below[1] - interval.a, 0)
        case Not() | And() | Or() | Implies() | Iff() | Rise():
            return max(below)
        case Constant() | Label() | Comparison():
            return 0
        case _:
            assert_never(phi)


_OPERATOR_WORDS: dict[type, str] = {
    Eventually: "eventually", Always: "always", Until: "until", Release: "release"
}  # fmt: skip


def lookback(phi: Formula | Task) -> int | None:
    """The number of steps before the evaluation step that can affect the truth value; None if there is no limit.

    Operators of the past count (docs/semantics.md §1); those of the future, outside them, make up for it: F[2,3] prev a
    has lookback 0. No window reaches further back than step 0.
    """
    return _lookback(formula_of(phi, "lookback's formula"))


def _lookback(phi: Formula) -> int | None:
    below = [_lookback(child) for child in children(phi)]
    match phi:
        case Eventually(interval, _) | Always(interval, _):
            return _back(below[0], -interval.a)
        case Until(interval, _, _) | Release(interval, _, _):
            return _furthest(below[0] if interval.b != 0 else 0, _back(below[1], -interval.a))
        case Once(interval, _) | Historically(interval, _):
            return None if interval.b is None else _back(below[0], interval.b)
        case Since(interval, _, _) | Trigger(interval, _, _):
            if interval.b is None:
                return None
            return _furthest(_back(below[0], interval.b - 1) if interval.b else 0, _back(below[1], interval.b))
        case Rise():
            return _back(below[0], 1)
        case Not() | And() | Or() | Implies() | Iff():
            return _furthest(*below)
        case Comparison():
            return delay(phi)
        case Constant() | Label():
            return 0
        case _:
            assert_never(phi)


def _back(steps: int | None, more: int) -> int | None:
    return None if steps is None else max(steps + more, 0)


def _furthest(*steps: int | None) -> int | None:
    known = [n for n in steps if n is not None]
    return max(known) if len(known) == len(steps) else None


def is_bounded(phi: Formula) -> bool:
    """Whether every interval of the future has an end, so that the formula has a horizon."""
    return all(node.interval.b is not None for node in walk(phi) if isinstance(node, FUTURE))


def is_temporal(phi: Formula) -> bool:
    """Whether the formula contains a temporal operator, or a comparison that reads earlier steps."""
    return any(
        isinstance(node, FUTURE + PAST) or (isinstance(node, Comparison) and delay(node) > 0) for node in walk(phi)
    )


def has_past(phi: Formula) -> bool:
    """Whether the formula contains an operator of the past."""
    return any(isinstance(node, PAST) for node in walk(phi))


def temporal_depth(phi: Formula) -> int:
    """The nesting depth of temporal operators: 0 for a Boolean formula over predicates."""
    below = max((temporal_depth(child) for child in children(phi)), default=0)
    return below + isinstance(phi, FUTURE + PAST)


def atoms(phi: Formula) -> tuple[Formula, ...]:
    """The largest sub-formulas without temporal operators, negations or constants, left to right, each once."""
    found: dict[Formula, None] = {}
    stack = [phi]
    while stack:
        node = stack.pop()
        while isinstance(node, Not):
            node = node.arg
        if is_temporal(node):
            stack.extend(reversed(children(node)))
        elif not isinstance(node, Constant):
            found[node] = None
    return tuple(found)


def boolean_value(phi: Formula, value: Callable[[Formula], bool | None]) -> bool:
    """The truth of φ, given the truth `value` of those sub-formulas that it knows (None: descend)."""
    known = value(phi)
    if known is not None:
        return known
    match phi:
        case Constant(truth):
            return truth
        case Not(arg):
            return not boolean_value(arg, value)
        case And(args):
            return all(boolean_value(arg, value) for arg in args)
        case Or(args):
            return any(boolean_value(arg, value) for arg in args)
        case Implies(left, right):
            return not boolean_value(left, value) or boolean_value(right, value)
        case Iff(left, right):
            return boolean_value(left, value) == boolean_value(right, value)
        case Label() | Comparison() | Eventually() | Always() | Until() | Release():
            raise ValueError(f"no truth value for {phi}")
        case Once() | Historically() | Since() | Trigger() | Rise():
            raise ValueError(f"no truth value for {phi}")
        case _:
            assert_never(phi)


def variables(phi: Formula) -> dict[str, Span | None]:
    """The real-valued signals the formula reads, each with its first position in the text."""
    found: dict[str, Span | None] = {}
    for node in distinct(phi):
        if isinstance(node, Comparison):
            for variable in read_by(node):
                found.setdefault(variable.name, variable.span)
    return found


def delay(phi: Comparison) -> int:
    """How many steps before the evaluation step a comparison reads, at most."""
    return max((variable.delay for variable in read_by(phi)), default=0)


def label_names(phi: Formula) -> dict[str, Span | None]:
    """The Boolean labels the formula reads, each with its first position in the text."""
    found: dict[str, Span | None] = {}
    for node in distinct(phi):
        if isinstance(node, Label):
            found.setdefault(node.name, node.span)
    return found


def read_by(phi: Comparison) -> list[Variable]:
    """The signals of a comparison, left to right, repeated ones too."""
    return term_variables(phi.left) + term_variables(phi.right)


def term_variables(term: Term) -> list[Variable]:
    """The signals of a term, left to right, repeated ones too."""
    match term:
        case Number():
            return []
        case Variable():
            return [term]
        case Negate(arg):
            return term_variables(arg)
        case Arithmetic(_, left, right):
            return term_variables(left) + term_variables(right)
        case Call(_, args):
            return [variable for arg in args for variable in term_variables(arg)]
        case _:
            assert_never(term)


# ------------------------------------------------------------------------------------------- composed formulas


def operand(value: object, sign: str) -> Formula:
    """A valid operand of an operator; for anything else an ArgumentError with what was probably meant."""
    if not isinstance(value, Composable):
        refuse_operand(value, sign)
    return value._formula()


def refuse_operand(value: object, sign: str) -> NoReturn:
    kind = kind_name(type(value))
    if isinstance(value, bool) or type(value).__name__ == "bool":
        remedy = "== and != between formulas give True or False; for a constant formula, write stl.parse('true')"
    elif isinstance(value, int | float) or kind == "Expression":
        remedy = f"put the comparison in parentheses: phi {sign} (x > 0.5)"
    elif isinstance(value, str):
        remedy = "parse it: stl.parse(text)"
    else:
        remedy = "give formulas or tasks"
    raise ArgumentError(f"an operand of {sign} is {described(value)}, not a Formula; {remedy}")


_J = TypeVar("_J", And, Or)
_N = TypeVar("_N", bound=Node)


def _joined(kind: type[_J], left: Formula, right: Formula) -> _J:
    """a & b & c in one level, in whatever order it is composed."""
    args: tuple[Formula, ...] = ()
    nodes = levels = 1
    for phi in (left, right):
        n, deep = _measure(phi)
        inside = isinstance(phi, kind)
        args += phi.args if isinstance(phi, And | Or) and inside else (phi,)
        nodes, levels = nodes + n - inside, max(levels, deep + 1 - inside)
    result = kind(args)
    object.__setattr__(result, "_size", (nodes, levels))
    return fitting(result)


def fitting(phi: _N) -> _N:
    """The node itself; StlSyntaxError if it is too deep or too large for recursive traversals."""
    nodes, levels = _measure(phi)
    if levels > DEEPEST:
        raise StlSyntaxError(
            f"operators are nested too deeply (over {DEEPEST} levels); simplify the formula, or write a & b & c in one "
            "level"
        )
    if nodes > MOST_NODES:
        raise StlSyntaxError(f"the formula has more than {MOST_NODES} operators; simplify it")
    return phi


def _measure(root: Node) -> tuple[int, int]:
    """(nodes, levels), cached in every node: composing formulas does not traverse them again each time."""
    stack = [root] if root._size is None else []
    while stack:
        node = stack[-1]
        below = operands(node)
        unknown = [child for child in below if child._size is None]
        if unknown:
            stack.extend(unknown)
            continue
        sizes = [child._size for child in below if child._size is not None]
        size = 1 + sum(n for n, _ in sizes), 1 + max((levels for _, levels in sizes), default=0)
        object.__setattr__(node, "_size", size)
        stack.pop()
    assert root._size is not None
    return root._size


def operands(node: Node) -> tuple[Formula | Term, ...]:
    """The sub-formulas and terms directly below, left to right."""
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
            return children(node)  # type: ignore[arg-type]  # terms are done
