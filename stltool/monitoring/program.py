"""A formula as a flat list of instructions, without repeated sub-formulas; monitors run it over arrays or streams.

Instruction i computes the value of one sub-formula at every step from the values of earlier ones:

    atom                   a constant, a label or a predicate
    not i                  −i
    and i j, or i j        min, max                      an operand list is folded from the left
    iff i j                min(max(−i, j), max(i, −j))
    eventually[a,b] i      max of i over t+a … t+b       always: min
    until[a,b] i j         max over u in t+a … t+b of min(j at u, min of i over t … u−1)
    once[a,b] i            max of i over t−b … t−a, from step 0 on     historically: min
    since[a,b] i j         max over u in t−b … t−a, u ≥ 0, of min(j at u, min of i over u+1 … t)

with −1 < 1 for false and true, or with signed margins: both are lattices, so one program serves both. `ends` lists the
values that are not read later; their memory can be reused.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Generic, Literal, NamedTuple, TypeAlias, TypeVar, assert_never

from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    delay,
)
from stltool.logic.shifts import Delayed, delayed
from stltool.monitoring.comparisons import Predicate
from stltool.source import Span

_T = TypeVar("_T")
Op = Literal["atom", "not", "and", "or", "iff", "eventually", "always", "until", "once", "historically", "since"]
PAST = ("once", "historically", "since")
Atom: TypeAlias = Constant | Label | Predicate


def formula_of_atom(atom: Atom) -> Formula:
    return atom.node if isinstance(atom, Predicate) else atom


class Instruction(NamedTuple):
    """One operator; `args` are numbers of earlier instructions.

    horizon   None above an interval of the future without end
    lookback  None above an interval of the past without end
    """

    op: Op
    args: tuple[int, ...]
    horizon: int | None
    lookback: int | None
    a: int
    b: int | None
    atom: Atom | None = None
    ends: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Program:
    """The instructions, the last one being the formula itself, and the names it reads with their first positions.

    earlier  signals that hold earlier samples of others: how many steps before
    """

    instructions: tuple[Instruction, ...]
    variables: Mapping[str, Span | None]
    labels: Mapping[str, Span | None]
    earlier: Mapping[str, int] = field(default_factory=dict)

    @property
    def horizon(self) -> int | None:
        return self.instructions[-1].horizon

    @property
    def lookback(self) -> int | None:
        return self.instructions[-1].lookback

    @property
    def has_past(self) -> bool:
        return any(now.op in PAST for now in self.instructions)

    def reach(self, names: Iterable[str]) -> tuple[int, int]:
        """How many steps before the latest, and the earliest, of the samples are that these signals hold."""
        steps = [self.earlier.get(name, 0) for name in names]
        return min(steps, default=0), max(steps, default=0)

    @property
    def settling(self) -> int:
        """The number of steps after which no value changes any more, if all samples are the same."""
        steps: list[int] = []
        for now in self.instructions:
            more = 0 if now.op not in PAST else now.a if now.b is None else now.b
            steps.append(max((steps[arg] for arg in now.args), default=0) + more)
        return steps[-1]


def compile_formula(phi: Formula) -> Program:
    """The program of a formula; those of the last few formula objects are kept."""
    return _compile(Same(phi))


def compile_delayed(phi: Formula, once: bool = True) -> tuple[Delayed, Program]:
    """A formula that may read earlier samples as the monitors read it (`delayed`), and its program; kept likewise."""
    return _compile_delayed(Same(phi), once)


class Same(Generic[_T]):
    """A key that compares the object: hashing a formula's nodes, say, would cost more than compiling them."""

    __slots__ = ("thing",)

    def __init__(self, thing: _T) -> None:
        self.thing = thing

    def __hash__(self) -> int:
        return id(self.thing)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.thing is other.thing


@lru_cache(maxsize=8)
def _compile_delayed(key: Same[Formula], once: bool) -> tuple[Delayed, Program]:
    made = delayed(key.thing, once=once)
    earlier = {name: steps for name, (_, steps) in made.signals.items()}
    return made, replace(compile_formula(made.formula), earlier=earlier)


@lru_cache(maxsize=8)
def _compile(key: Same[Formula]) -> Program:
    compiler = _Compiler()
    compiler.visit(key.thing)
    return compiler.program()


@dataclass(slots=True)
class _Compiler:
    instructions: list[Instruction] = field(default_factory=list)
    numbers: dict[object, int] = field(default_factory=dict)  # an instruction's key → its index
    visited: dict[int, int] = field(default_factory=dict)  # id of a node → number: hashing nodes would be quadratic
    variables: dict[str, Span | None] = field(default_factory=dict)
    labels: dict[str, Span | None] = field(default_factory=dict)

    def visit(self, phi: Formula) -> int:
        known = self.visited.get(id(phi))
        if known is None:
            known = self.visited[id(phi)] = self._visit(phi)
        return known

    def _visit(self, phi: Formula) -> int:
        match phi:
            case Constant():
                return self._atom(phi, phi)
            case Label(name):
                self.labels.setdefault(name, phi.span)
                return self._atom(phi, phi)
            case Comparison():
                if delay(phi):
                    raise ValueError(f"{phi} reads earlier samples; compile_delayed makes signals of them")
                if phi in self.numbers:
                    return self.numbers[phi]
                predicate = Predicate(phi)
                for name, span in predicate.names.items():
                    self.variables.setdefault(name, span)
                return self._atom(phi, predicate)
            case Not(arg):
                return self._emit("not", self.visit(arg))
            case And(args):
                return self._fold("and", args)
            case Or(args):
                return self._fold("or", args)
            case Implies(left, right):
                return self._emit("or", self._emit("not", self.visit(left)), self.visit(right))
            case Iff(left, right):
                return self._emit("iff", self.visit(left), self.visit(right))
            case Eventually(interval, arg):
                return self._emit("eventually", self.visit(arg), a=interval.a, b=interval.b)
            case Always(interval, arg):
                return self._emit("always", self.visit(arg), a=interval.a, b=interval.b)
            case Until(interval, left, right):
                return self._emit("until", self.visit(left), self.visit(right), a=interval.a, b=interval.b)
            case Release(interval, left, right):
                neither = (self._emit("not", self.visit(part)) for part in (left, right))
                return self._emit("not", self._emit("until", *neither, a=interval.a, b=interval.b))
            case Once(interval, arg):
                return self._emit("once", self.visit(arg), a=interval.a, b=interval.b)
            case Historically(interval, arg):
                return self._emit("historically", self.visit(arg), a=interval.a, b=interval.b)
            case Since(interval, left, right):
                return self._emit("since", self.visit(left), self.visit(right), a=interval.a, b=interval.b)
            case Trigger(interval, left, right):
                neither = (self._emit("not", self.visit(part)) for part in (left, right))
                return self._emit("not", self._emit("since", *neither, a=interval.a, b=interval.b))
            case Rise(arg):
                now = self.visit(arg)
                return self._emit("and", now, self._emit("not", self._emit("once", now, a=1, b=1)))
            case _:
                assert_never(phi)

    def _fold(self, op: Literal["and", "or"], args: tuple[Formula, ...]) -> int:
        so_far = self.visit(args[0])
        for arg in args[1:]:
            so_far = self._emit(op, so_far, self.visit(arg))
        return so_far

    def _atom(self, key: Formula, atom: Atom) -> int:
        if key not in self.numbers:
            self.numbers[key] = len(self.instructions)
            self.instructions.append(Instruction("atom", (), 0, 0, 0, 0, atom))
        return self.numbers[key]

    def _emit(self, op: Op, *args: int, a: int = 0, b: int | None = 0) -> int:
        key = (op, args, a, b)
        if key not in self.numbers:
            below = [self.instructions[arg] for arg in args]
            self.numbers[key] = len(self.instructions)
            self.instructions.append(Instruction(op, args, _horizon(op, below, a, b), _lookback(op, below, a, b), a, b))
        return self.numbers[key]

    def program(self) -> Program:
        """The instructions in order, each with the values last used there."""
        seen: set[int] = set()
        for i in reversed(range(len(self.instructions))):
            now = self.instructions[i]
            ends = tuple(arg for arg in dict.fromkeys(now.args) if arg not in seen)
            if ends:
                seen.update(ends)
                self.instructions[i] = now._replace(ends=ends)
        return Program(tuple(self.instructions), self.variables, self.labels)


def _horizon(op: Op, below: Sequence[Instruction], a: int, b: int | None) -> int | None:
    steps = [now.horizon for now in below]
    match op:
        case "eventually" | "always" | "until":
            known = _greatest(steps)
            return None if b is None or known is None else b + known
        case "once" | "historically" | "since":
            last = None if steps[-1] is None else max(steps[-1] - a, 0)
            return _greatest([last, steps[0] if op == "since" and b != 0 else 0])
        case _:
            return _greatest(steps)


def _lookback(op: Op, below: Sequence[Instruction], a: int, b: int | None) -> int | None:
    steps = [now.lookback for now in below]
    match op:
        case "eventually" | "always" | "until":
            last = None if steps[-1] is None else max(steps[-1] - a, 0)
            return _greatest([last, steps[0] if op == "until" and b != 0 else 0])
        case "once" | "historically" | "since":
            first = steps[0] if op == "since" and b != 0 else 0
            if b is None or first is None or steps[-1] is None:
                return None
            return max(b + steps[-1], b - 1 + first)
        case _:
            return _greatest(steps)


def _greatest(steps: Sequence[int | None]) -> int | None:
    known = [n for n in steps if n is not None]
    return max(known, default=0) if len(known) == len(steps) else None
