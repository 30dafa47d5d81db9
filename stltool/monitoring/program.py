"""A formula as a flat list of instructions, without repeated sub-formulas; monitors run it over arrays or streams.

Instruction i computes the value of one sub-formula at every step from the values of earlier ones:

    atom                   a constant, a label or a predicate
    not i                  −i
    and i j, or i j        min, max                      an operand list is folded from the left
    iff i j                min(max(−i, j), max(i, −j))
    eventually[a,b] i      max of i over t+a … t+b       always: min
    until[a,b] i j         max over u in t+a … t+b of min(j at u, min of i over t … u−1)

with −1 < 1 for false and true, or with signed margins: both are lattices, so one program serves both. `ends` lists the
values that are not read later; their memory can be reused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, NamedTuple, TypeAlias, assert_never

from stltool.errors import FragmentError
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
)
from stltool.monitoring.comparisons import Predicate
from stltool.source import Span

Op = Literal["atom", "not", "and", "or", "iff", "eventually", "always", "until"]
Atom: TypeAlias = Constant | Label | Predicate


class Instruction(NamedTuple):
    """One operator; `args` are numbers of earlier instructions, `horizon` is None above an interval without end."""

    op: Op
    args: tuple[int, ...]
    horizon: int | None
    a: int
    b: int | None
    atom: Atom | None = None
    ends: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Program:
    """The instructions, the last one being the formula itself, and the names it reads with their first positions."""

    instructions: tuple[Instruction, ...]
    variables: Mapping[str, Span | None]
    labels: Mapping[str, Span | None]

    @property
    def horizon(self) -> int | None:
        return self.instructions[-1].horizon


def compile_formula(phi: Formula) -> Program:
    """The program of a formula; those of the last few formula objects are kept."""
    return _compile(_Same(phi))


class _Same:
    """A key for a formula that compares the object: hashing its nodes would cost more than compiling them."""

    __slots__ = ("phi",)

    def __init__(self, phi: Formula) -> None:
        self.phi = phi

    def __hash__(self) -> int:
        return id(self.phi)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.phi is other.phi


@lru_cache(maxsize=8)
def _compile(key: _Same) -> Program:
    compiler = _Compiler()
    compiler.visit(key.phi)
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
            case Once() | Historically() | Since() | Trigger() | Rise():
                raise FragmentError(f"{phi} looks back, which monitors do not support yet")
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
            self.instructions.append(Instruction("atom", (), 0, 0, 0, atom))
        return self.numbers[key]

    def _emit(self, op: Op, *args: int, a: int = 0, b: int | None = 0) -> int:
        key = (op, args, a, b)
        if key not in self.numbers:
            below = [h for h in (self.instructions[arg].horizon for arg in args) if h is not None]
            horizon = None if b is None or len(below) < len(args) else b + max(below)
            self.numbers[key] = len(self.instructions)
            self.instructions.append(Instruction(op, args, horizon, a, b))
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
