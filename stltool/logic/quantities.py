"""Exact constants of a text: plain numbers, and times with a unit.

A decimal means that decimal, as a fraction. A time becomes a number of steps only through the file's step (0.1s, say),
so times and plain numbers add up with their own kind alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from typing import TypeAlias

from stltool.errors import SettingsError

UNITS = {
    "ns": Fraction(1, 10**9), "us": Fraction(1, 10**6), "µs": Fraction(1, 10**6), "μs": Fraction(1, 10**6),
    "ms": Fraction(1, 1000), "s": Fraction(1), "min": Fraction(60), "h": Fraction(3600),
}  # fmt: skip
LONGEST_NUMBER = 60  # characters; a longer literal is a slip, and its exact value would fill memory
LARGEST_EXPONENT = 64

ParamValue: TypeAlias = "int | float | str | Fraction | Duration"


@dataclass(frozen=True, slots=True, order=True)
class Duration:
    """A time, in seconds."""

    seconds: Fraction

    def __str__(self) -> str:
        number, bar, divisor = decimal_text(self.seconds).partition("/")
        return f"{number}s{bar}{divisor}"


Quantity: TypeAlias = Fraction | Duration


def decimal_text(value: Fraction) -> str:
    """The decimal that a fraction is, or the fraction."""
    rest, places = value.denominator, 0
    for factor in (2, 5):
        count = 0
        while rest % factor == 0:
            rest, count = rest // factor, count + 1
        places = max(places, count)
    if rest != 1 or places == 0:
        return str(value)
    digits = str(int(abs(value) * 10**places)).zfill(places + 1)
    return f"{'-' if value < 0 else ''}{digits[:-places]}.{digits[-places:]}"


def number(text: str) -> Fraction | None:
    """The exact value of a decimal or a fraction `3/4`; None where it is none, or out of range."""
    try:
        parts = [Decimal(part) for part in text.split("/", 1)]
        if (
            not text.isascii()
            or len(text) > LONGEST_NUMBER
            or any(abs(part.adjusted()) > LARGEST_EXPONENT for part in parts)
        ):
            return None
        return Fraction(text)
    except (ValueError, InvalidOperation, ZeroDivisionError):
        return None


def duration(text: str) -> Duration | None:
    """The time that `0.1s` or `5min` spells; None where it spells none."""
    found = re.fullmatch(r"(-?[\d.eE+-]*[\d.])\s*([a-zµμ]+)", text.strip())
    value = number(found[1]) if found is not None else None
    if found is None or value is None or found[2] not in UNITS:
        return None
    return Duration(value * UNITS[found[2]])


def quantity(name: str, value: ParamValue) -> Quantity:
    """The exact value of a param given from outside; SettingsError where it is none."""
    if isinstance(value, Duration):
        return value
    for read in (number, duration):
        exact = read(str(value))
        if exact is not None:
            return exact
    raise SettingsError(f"param {name}: {value!r} is not a number; write for example {name}=20")
