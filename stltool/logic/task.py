"""A parsed task file: its formula, params and definitions, and the path of its model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from stltool.display import Card
from stltool.errors import SettingsError
from stltool.logic.expectation import Expectation
from stltool.logic.formula import Composable, Formula, Term, horizon, is_bounded, is_temporal
from stltool.logic.quantities import Duration, ParamValue, Quantity, Ticks, ticks

if TYPE_CHECKING:
    from stltool.logic.syntax import Document


@dataclass(frozen=True, slots=True, repr=False)
class Task(Composable):
    """One definition of a task file, chosen as the task. It is accepted wherever a formula is.

    `params` holds the values after overrides, as exact fractions or times; `definitions` holds all definitions in file
    order, each a formula or an arithmetic term; `model` is the path of the model file, already resolved against the
    folder of the task file, or None if the file names none; `step` is the duration of a step, and `unit` what a plain
    number in a bound is (a time, or a step), if the file declares them; `expectations` are the `expect` lines of the
    file, about any of its definitions; `document` is the text as read.
    """

    KIND: ClassVar[str] = "Task"

    name: str
    formula: Formula
    model: Path | None = None
    params: Mapping[str, Quantity] = field(default_factory=dict)
    definitions: Mapping[str, Formula | Term] = field(default_factory=dict)
    path: Path | None = None
    step: Duration | None = None
    unit: Duration | None = None
    expectations: tuple[Expectation, ...] = ()
    document: Document | None = field(default=None, compare=False, repr=False)
    rebuild: Callable[[Mapping[str, ParamValue]], Task] | None = field(default=None, compare=False, repr=False)

    def with_params(self, **params: ParamValue) -> Task:
        """The same task with other values for some of its params; the text is not parsed again.

        Raises StlSyntaxError if the file has no such param or the formula does not allow the value, and SettingsError
        if a value is not a number or the task was not parsed from text.
        """
        if self.rebuild is None:
            raise SettingsError("this task was not parsed from text, so it has no params to change; use stl.parse_task")
        return self.rebuild(params)

    @property
    def folder(self) -> Path:
        """Where the files are that the task file names, relative to it."""
        return self.path.parent if self.path is not None else Path()

    @property
    def formulas(self) -> dict[str, Formula]:
        """The definitions that are formulas."""
        return {name: phi._formula() for name, phi in self.definitions.items() if isinstance(phi, Composable)}

    @property
    def predicates(self) -> dict[str, Formula]:
        """The definitions that are formulas without temporal operators."""
        return {name: phi for name, phi in self.formulas.items() if not is_temporal(phi)}

    @property
    def ticks(self) -> Ticks | None:
        """Steps as times, in the declared unit; None if the duration of a step is not declared."""
        return ticks(self.step, self.unit)

    def _formula(self) -> Formula:
        return self.formula

    def __str__(self) -> str:
        return f"{self.name} := {self.formula}"

    def _card(self) -> Card:
        params = ", ".join(f"{name} = {value}" for name, value in self.params.items())
        steps = horizon(self.formula) if is_bounded(self.formula) else "none: an interval has no end"
        model = self.model if self.model is not None else "none named"
        return Card(f"Task {self}", [{"horizon": steps, "params": params or None, "model": model}])
