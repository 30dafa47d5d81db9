"""Robustness as a target of Hypothesis, and input signals as a strategy of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis import target
from numpy.typing import ArrayLike

from stltool.arguments import whole
from stltool.logic.formula import And, Formula, formula_of
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.monitoring import monitor
from stltool.monitoring.samples import End
from stltool.testing.falsification.inputs import Inputs, InputsGiven, Signal

_FARTHEST = 1e9  # Hypothesis' targets are finite


def steer(phi: Formula | Task | str, signals: Mapping[str, ArrayLike], *, end: End = "error") -> float:
    """Tell Hypothesis how near a trace is to violating φ, so that it looks for nearer ones; within a test, once.

    Each operand of an outermost `&` is a target of its own, with its formula as label, so that the margins of one do
    not hide the others. Returns the robustness of φ. Assert the verdict with `assert_trace`.
    """
    formula = formula_of(parse(phi) if isinstance(phi, str) else phi, "steer's formula")
    parts = formula.args if isinstance(formula, And) else (formula,)
    margins = [_margin(part, signals, end) for part in parts]
    for part, margin in zip(dict.fromkeys(parts), margins, strict=False):
        target(-max(min(margin, _FARTHEST), -_FARTHEST), label=f"robustness of {part}")
    return min(margins)


def _margin(phi: Formula, signals: Mapping[str, ArrayLike], end: End) -> float:
    found = monitor(phi, signals, end, "robustness", at=0).robustness
    assert found is not None  # asked for
    return float(found[0])


def input_signals(inputs: InputsGiven, steps: int) -> st.SearchStrategy[dict[str, Any]]:
    """A strategy for what `falsify` gives a system: name → array (steps,) for a `Signal`, a float for a range.

    It shrinks towards low ends of ranges, and constant signals.
    """
    cube = Inputs(inputs, whole(steps, "steps", least=1))

    def points(one: Signal | tuple[float, float]) -> st.SearchStrategy[Any]:
        low, high = (one.low, one.high) if isinstance(one, Signal) else one
        shares = st.floats(0, 1, allow_subnormal=False)
        if isinstance(one, Signal):
            return st.lists(shares, min_size=one.points, max_size=one.points).map(
                lambda found: one.samples(low + (high - low) * np.array(found), cube.steps)
            )
        return shares.map(lambda share: low + (high - low) * share)

    return st.fixed_dictionaries({name: points(one) for name, one in cube.given.items()})
