"""Exact constants of a text: plain numbers (stltool/numbers.py), and times with a unit.

A time becomes a number of steps only through the step that the file declares (0.1s, say), so times can be added to
times only, and plain numbers to plain numbers.
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


@dataclass(frozen=True, slots=True, order=True)
class Duration:
    """A time, in seconds."""

    seconds: Fraction

    def __str__(self) -> str:
        number, bar, divisor = number_text(self.seconds).partition("/")
        return f"{number}s{bar}{divisor}"


Quantity: TypeAlias = Fraction | Duration


def duration(text: str) -> Duration | None:
    """The time written as `0.1s`, `5min` or `1s/3`; None if the text is not a time. Raises NumberError."""
    found = _TIME.fullmatch(text.strip())
    if found is None or found[2] not in UNITS:
        return None
    return Duration(read(found[1] + (found[3] or "")) * UNITS[found[2]])


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
