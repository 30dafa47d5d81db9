"""A task file, read: its formula, its params and definitions, and where its model is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from stltool.logic.formula import Formula, Term


@dataclass(frozen=True, slots=True)
class Task:
    """One definition of a task file, chosen as the task.

    `params` holds the values after overrides, as exact fractions; `definitions` all definitions in file order, each a
    formula or an arithmetic term; `model` the path of the model file, already relative to the task file's folder, or
    None where the file names none.
    """

    name: str
    formula: Formula
    model: Path | None = None
    params: Mapping[str, Fraction] = field(default_factory=dict)
    definitions: Mapping[str, Formula | Term] = field(default_factory=dict)
    path: Path | None = None

    def __str__(self) -> str:
        return f"{self.name} := {self.formula}"
