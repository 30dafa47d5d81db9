"""The names that strategies use unless told otherwise, and draws that are made once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from hypothesis import strategies as st

from stltool.logic.regions import Draw
from stltool.testing.ranges import Limits

LABELS = ("a", "b", "c")
SIGNALS = ("x", "y")
VALUES = (-2.0, -1.0, 0.0, 0.5, 1.0, 2.0)  # of signals without a range: few, so that comparisons reach equality

Signals: TypeAlias = "Sequence[str] | Mapping[str, Limits]"
"""Names, or names with their ranges: a pair (lowest, highest), or Hypothesis' floats(lowest, highest)."""


def by(draw: Callable[[st.SearchStrategy[int]], int]) -> Draw:
    """Draws of one of n."""
    return lambda n: draw(below(n)) if n > 1 else 0


@functools.cache
def below(n: int) -> st.SearchStrategy[int]:
    return st.integers(0, n - 1)


@functools.cache
def many(values: tuple[Any, ...], n: int) -> st.SearchStrategy[list[Any]]:
    return st.lists(st.sampled_from(values), min_size=n, max_size=n)
