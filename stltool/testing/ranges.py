"""Ranges of signals as users give them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

from stltool.arguments import described, mapping
from stltool.errors import SettingsError
from stltool.logic.regions import Choices, Range, Span
from stltool.numbers import Exactable, NumberError, exact

Limits: TypeAlias = Any
"""A pair (lowest, highest) of numbers, None for no limit; or a Hypothesis strategy with ends, as st.floats(0, 9)."""

EXAMPLE = "{'x': (0, 9)}"


def ranges_of(signals: Mapping[str, Limits] | None, what: str) -> dict[str, Range]:
    """The range of each signal. SettingsError for anything else than pairs of numbers and floats(…)."""
    given = mapping(signals, what, EXAMPLE, optional=True)
    return {name: range_of(name, limits) for name, limits in given.items()}


def range_of(name: str, limits: Limits) -> Range:
    """One range."""
    if (pair := ends_of(limits)) is None:
        raise SettingsError(
            f"the range of {name} is {described(limits)}; give the lowest and the highest value, (0, 9), or a strategy "
            "that has them, floats(0, 9)"
        )
    low, high = (_end(name, end) for end in pair)
    if low is not None and high is not None and low > high:
        raise SettingsError(f"the range of {name} is empty: {pair[0]} is above {pair[1]}; write the lower end first")
    if Choices.within(Span(low, high)) is None:
        raise SettingsError(
            f"the range of {name}, {pair[0]} … {pair[1]}, has no value that a double can hold; widen it"
        )
    return low, high


def ends_of(limits: Limits) -> tuple[Any, Any] | None:
    """Both ends of a pair, or of Hypothesis' floats(…); None for anything else."""
    if isinstance(limits, tuple | list):
        return (limits[0], limits[1]) if len(limits) == 2 else None
    inner = getattr(limits, "wrapped_strategy", limits)  # what floats(…) stands for, once it is used
    low, high = getattr(inner, "min_value", None), getattr(inner, "max_value", None)
    return (low, high) if isinstance(low, float) and isinstance(high, float) else None


def _end(name: str, end: Exactable | None) -> Any:
    if end is None or (isinstance(end, float) and math.isinf(end)):
        return None
    try:
        return exact(end)
    except NumberError as error:
        raise SettingsError(f"the range of {name}: {error}; give two numbers, (0, 9)") from None
