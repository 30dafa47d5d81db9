"""A task file, read: its formula, its params and definitions, and where its model is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from stltool.logic.formula import Formula, Term
from stltool.logic.quantities import Duration, ParamValue, Quantity

if TYPE_CHECKING:
    from stltool.logic.syntax import Document


@dataclass(frozen=True, slots=True)
class Task:
    """One definition of a task file, chosen as the task.

    `params` holds the values after overrides, as exact fractions, or times; `definitions` all definitions in file
    order, each a formula or an arithmetic term; `model` the path of the model file, already relative to the task file's
    folder, or None where the file names none; `step` how long a step takes, where the file says so; `document` the text
    as read.
    """

    name: str
    formula: Formula
    model: Path | None = None
    params: Mapping[str, Quantity] = field(default_factory=dict)
    definitions: Mapping[str, Formula | Term] = field(default_factory=dict)
    path: Path | None = None
    step: Duration | None = None
    document: Document | None = field(default=None, compare=False, repr=False)
    rebuild: Callable[[Mapping[str, ParamValue]], Task] | None = field(default=None, compare=False, repr=False)

    def with_params(self, **params: ParamValue) -> Task:
        """The same task with other values for some of its params; the text is not read again.

        Raises StlSyntaxError where the file has no such param, or the formula does not allow its value.
        """
        if self.rebuild is None:
            raise ValueError("this task was not read from a text, so it has no params to change")
        return self.rebuild(params)

    def __str__(self) -> str:
        return f"{self.name} := {self.formula}"
