"""What a task file expects of its tasks: `expect Pmax(patrolling) >= 0.95`; judged by `verify` (stltool/gate.py)."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, TypeAlias

from stltool.logic.formula import Formula
from stltool.numbers import number_text
from stltool.source import Span

Asked: TypeAlias = Literal["Pmax", "Pmin", "P", "holds"]
Relation: TypeAlias = Literal[">=", "<=", ">", "<"]

ASKED: tuple[Asked, ...] = ("Pmax", "Pmin", "P", "holds")
RELATIONS: tuple[Relation, ...] = (">=", "<=", ">", "<")
_TRIVIAL: dict[tuple[Relation | None, int], str] = {
    (">=", 0): "always holds", ("<=", 1): "always holds", ("<", 0): "never holds", (">", 1): "never holds",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Expectation:
    """One `expect` line of a task file. Its text, `str(expectation)`, parses back to it.

    question    "Pmax", "Pmin": over all policies;  "P": of `policy`;  "holds": on `trace`
    formula     what is judged;  name  the definition of it, if it is one
    relation, bound   of a probability, exactly; None for "holds"
    robust      what is guaranteed whatever the probabilities are in their intervals
    policy, trace     the file as written; its path is relative to the task file
    written     the text of the file on one line, with its names of definitions and params
    """

    question: Asked
    formula: Formula
    name: str | None = None
    relation: Relation | None = None
    bound: Fraction | None = None
    robust: bool = False
    policy: str | None = None
    trace: str | None = None
    written: str = field(default="", compare=False, repr=False)
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def subject(self) -> str:
        """The definition, or the formula, that is judged."""
        return self.name if self.name is not None else str(self.formula)

    @property
    def asked(self) -> str:
        """The question without the bound: robust Pmax(patrolling)."""
        files = (("policy", self.policy), ("trace", self.trace))
        named = "".join(f', {word} "{file}"' for word, file in files if file is not None)
        return f"{'robust ' if self.robust else ''}{self.question}({self.subject}{named})"

    @property
    def trivial(self) -> str | None:
        """Why the bound decides the expectation whatever the model is; None if it does not."""
        if self.bound is None or (self.relation, int(self.bound)) not in _TRIVIAL or self.bound not in (0, 1):
            return None
        limit = "from 0 up" if self.bound == 0 else "at most 1"
        return f"every probability is {limit}, so this {_TRIVIAL[self.relation, int(self.bound)]}"

    def __str__(self) -> str:
        bound = f" {self.relation} {number_text(self.bound)}" if self.bound is not None else ""
        return f"expect {self.asked}{bound}"
