"""What a task file expects of its tasks: `expect Pmax(patrolling) >= 0.95`; judged by `verify` (stltool/gate.py)."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, TypeAlias

from stltool.logic.formula import Formula
from stltool.numbers import number_text
from stltool.source import Span

Asked: TypeAlias = Literal["Pmax", "Pmin", "P", "holds", "cover"]
Measure: TypeAlias = Literal["held", "failed", "closed", "mattered", "vacuous", "premises", "parts"]
Relation: TypeAlias = Literal[">=", "<=", ">", "<"]

ASKED: tuple[Asked, ...] = ("Pmax", "Pmin", "P", "holds", "cover")
OF_A_PART: tuple[Measure, ...] = ("held", "failed", "closed", "mattered")
OF_THE_WHOLE: tuple[Measure, ...] = ("held", "failed", "vacuous", "premises", "parts")
RELATIONS: tuple[Relation, ...] = (">=", "<=", ">", "<")
_TRIVIAL: dict[tuple[Relation | None, int], str] = {
    (">=", 0): "always holds", ("<=", 1): "always holds", ("<", 0): "never holds", (">", 1): "never holds",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Expectation:
    """One `expect` line of a task file. Its text, `str(expectation)`, parses back to it.

    question    "Pmax", "Pmin": over all policies;  "P": of `policy`;  "holds": on `trace`;  "cover": a count on traces
    formula     what is judged;  name  the definition of it, if it is one
    relation, bound   of a probability or a count, exactly; None for "holds"
    robust      what is guaranteed whatever the probabilities are in their intervals
    policy, trace     the file as written; its path is relative to the task file. A count without a trace is over those
                on which the file's other expectations judge the formula, or those that tests judge
    part, measure     what is counted, and how (monitoring/coverage.py): the formula itself, or a part of it
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
    part: Formula | None = None
    measure: Measure | None = None
    written: str = field(default="", compare=False, repr=False)
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def subject(self) -> str:
        """The definition, or the formula, that is judged; of a count, what is counted."""
        whole = self.name if self.name is not None else str(self.formula)
        return whole if self.part is None or self.part == self.formula else str(self.part)

    @property
    def asked(self) -> str:
        """The question without the bound: robust Pmax(patrolling)."""
        files = (("policy", self.policy), ("trace", self.trace))
        named = "".join(f', {word} "{file}"' for word, file in files if file is not None)
        if self.part is not None:
            named = f"{f', {self.measure}' if self.measure != 'held' else ''}, of {self.name}{named}"
        return f"{'robust ' if self.robust else ''}{self.question}({self.subject}{named})"

    @property
    def trivial(self) -> str | None:
        """Why the bound decides the expectation whatever the model is; None if it does not."""
        if self.question == "cover":
            told = _TRIVIAL.get((self.relation, 0)) if self.bound == 0 else None
            return f"every count is from 0 up, so this {told}" if told is not None else None
        if self.bound is None or (self.relation, int(self.bound)) not in _TRIVIAL or self.bound not in (0, 1):
            return None
        limit = "from 0 up" if self.bound == 0 else "at most 1"
        return f"every probability is {limit}, so this {_TRIVIAL[self.relation, int(self.bound)]}"

    def __str__(self) -> str:
        bound = f" {self.relation} {number_text(self.bound)}" if self.bound is not None else ""
        return f"expect {self.asked}{bound}"
