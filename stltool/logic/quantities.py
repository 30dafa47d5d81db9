"""Exact constants of a text: plain numbers (stltool/numbers.py), and times with a unit.

A time becomes a number of steps only through the step that the file declares (0.1s, say), so times can be added to
times only, and plain numbers to plain numbers, unless the file declares the unit of plain numbers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from stltool.errors import SettingsError
from stltool.numbers import Exactable, NumberError, exact, number_text, read

UNITS = {
    "ns": Fraction(1, 10**9), "us": Fraction(1, 10**6), "µs": Fraction(1, 10**6), "μs": Fraction(1, 10**6),
    "ms": Fraction(1, 1000), "s": Fraction(1), "min": Fraction(60), "h": Fraction(3600),
}  # fmt: skip
_TIME = re.compile(r"(.*[0-9.])\s*([a-zµμ]+)\s*(/.*)?")

ParamValue: TypeAlias = "Exactable | Duration"


@dataclass(frozen=True, slots=True)
class Duration:
    """A time: seconds, and steps, whose length a file may declare."""

    seconds: Fraction
    steps: Fraction = Fraction(0)

    def __str__(self) -> str:
        parts = []
        if self.seconds or not self.steps:
            number, bar, divisor = number_text(self.seconds).partition("/")
            parts = [f"{number}s{bar}{divisor}"]
        if self.steps:
            number, bar, divisor = number_text(self.steps).partition("/")
            parts.append(f"{number} step{'' if self.steps == 1 else 's'}{bar}{divisor}")
        return " + ".join(parts)

    def __add__(self, other: Duration) -> Duration:
        return Duration(self.seconds + other.seconds, self.steps + other.steps)

    def times(self, factor: Fraction) -> Duration:
        """The time `factor` times as long."""
        return Duration(self.seconds * factor, self.steps * factor)

    def in_steps(self, step: Duration | None) -> Fraction | None:
        """The number of steps, each `step` long; None if that is needed and not known."""
        if self.seconds and step is None:
            return None
        return self.steps + (self.seconds / step.seconds if step is not None else 0)


STEP = Duration(Fraction(0), Fraction(1))


@dataclass(frozen=True, slots=True)
class Ticks:
    """Steps as times: how long each is, and the unit in which times are told."""

    step: Duration
    unit: str = "s"

    def number(self, step: int) -> float:
        """The time of a step in the unit."""
        return float(step * self.step.seconds / UNITS[self.unit])

    def text(self, step: int) -> str:
        """The time of a step: 13.2 s."""
        return f"{self.number(step):.12g} {self.unit}"


def ticks(step: Duration | None, unit: Duration | None) -> Ticks | None:
    """Steps as times in a declared unit, or in seconds; None if the duration of a step is not declared."""
    if step is None:
        return None
    return Ticks(step, next((name for name, scale in UNITS.items() if unit == Duration(scale)), "s"))


Quantity: TypeAlias = Fraction | Duration


def duration(text: str) -> Duration | None:
    """The time written as `0.1s`, `5min`, `1s/3` or `5 steps`; None if the text is not a time. Raises NumberError."""
    found = _TIME.fullmatch(text.strip())
    unit = one(found[2]) if found is not None else None
    return unit.times(read(found[1] + (found[3] or ""))) if found is not None and unit is not None else None


def one(unit: str) -> Duration | None:
    """The time that a unit, or `step`, stands for; None if there is no such unit."""
    if unit in ("step", "steps"):
        return STEP
    return Duration(UNITS[unit]) if unit in UNITS else None


def quantity(name: str, value: ParamValue) -> Quantity:
    """The exact value of a param given from outside; SettingsError if it has none."""
    if isinstance(value, Duration):
        return value
    try:
        time = duration(value) if isinstance(value, str) else None
        return exact(value) if time is None else time
    except NumberError as error:
        raise SettingsError(f"param {name}: {error}; write, for example, {name}=20") from None


def quantity_text(value: Quantity) -> str:
    """As a task file would write it."""
    return str(value) if isinstance(value, Duration) else number_text(value)
