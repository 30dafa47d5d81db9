"""How near a trace is to a violation, with every comparison in units of its own spread.

Robustness takes the least of margins in different units: an implication over rpm and speed is as robust as whatever is
measured in the larger numbers, and the other comparison is not seen. So the margins of each comparison are divided by
their standard deviation over all samples so far; the sign, and with it the verdict, stays the same. [Zhang19] gives
sub-formulas of different scales to the arms of a bandit instead.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stltool.errors import StlToolError
from stltool.logic.formula import Arithmetic, Comparison, Formula, Number, children, with_children
from stltool.monitoring import monitor
from stltool.testing.falsification.inputs import F64
from stltool.testing.falsification.strict import Strictness

_FARTHEST = 10.0  # a score beyond it says no more; margins of labels are infinite
_IN_TIME = 1.0  # added to the score of a trace that satisfies even the strictest variant
_FLAT_FROM = 4  # executions
_RESCALED = 1.25  # scales are computed again when there are so many times more traces


class Scores:
    """The traces so far, (n, h + 1) each signal, and their scores: negative ones violate, small ones nearly."""

    def __init__(self, phi: Formula) -> None:
        self.phi = phi
        self._comparisons = list(dict.fromkeys(comparisons(phi)))
        self._scaled, self._scaled_at = phi, 0
        self._strictness = Strictness(phi)
        self._margins, self._values = np.empty(0), np.empty(0)
        self._rows: list[Mapping[str, F64]] = []
        self.by_time = False

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, trace: Mapping[str, F64]) -> None:
        self._rows.append(trace)
        if len(self._rows) >= max(self._scaled_at * _RESCALED, self._scaled_at + 1):
            self._scaled, self._scaled_at = _rescaled(self.phi, self._scales()), len(self._rows)
            traces = self.traces(range(len(self._rows)))
            self._margins = self._margins_of(traces)
            self.by_time = bool(self._strictness) and _few_differ(self._margins)
            self._values = self.of(traces)
        else:
            one = {name: row[None] for name, row in trace.items()}
            self._margins = np.append(self._margins, self._margins_of(one))
            self._values = np.append(self._values, self.of(one))

    def traces(self, rows: range | list[int]) -> dict[str, F64]:
        """Of the signals that every execution has."""
        names = [name for name in self._rows[0] if all(name in row for row in self._rows)]
        return {name: np.stack([self._rows[i][name] for i in rows]) for name in names}

    @property
    def values(self) -> F64:
        """(n,)"""
        return self._values

    @property
    def flat(self) -> bool:
        """Whether scores lead nowhere."""
        return _few_differ(self._values)

    def of(self, traces: Mapping[str, F64]) -> F64:
        """The scores (n,) of traces (n, h + 1)."""
        margins = self._margins_of(traces)
        if not self.by_time:
            return margins
        found: F64 = np.where(margins >= 0, margins + _IN_TIME * self._strictness.of(traces), margins)
        return found

    def _margins_of(self, traces: Mapping[str, F64]) -> F64:
        found = monitor(self._scaled, traces, semantics="robustness", at=0).robustness
        assert found is not None  # asked for
        clipped: F64 = np.clip(found[:, 0], -_FARTHEST, _FARTHEST)
        return clipped

    def _scales(self) -> dict[Formula, float]:
        traces = self.traces(range(len(self._rows)))
        found: dict[Formula, float] = {}
        for one in self._comparisons:
            try:
                margins = monitor(one, traces, semantics="robustness").robustness
            except StlToolError:  # a term without a value somewhere, which the formula does not look at
                continue
            assert margins is not None  # asked for
            spread = float(margins[np.isfinite(margins)].std()) if np.isfinite(margins).any() else 0.0
            if spread > 0 and np.isfinite(spread):
                found[one] = spread
        return found


def _few_differ(values: F64) -> bool:
    return len(values) >= _FLAT_FROM and len(np.unique(np.round(values, 9))) <= max(2, len(values) // 4)


def comparisons(phi: Formula) -> list[Comparison]:
    if isinstance(phi, Comparison):
        return [phi]
    return [one for child in children(phi) for one in comparisons(child)]


def _rescaled(phi: Formula, scales: Mapping[Formula, float]) -> Formula:
    if isinstance(phi, Comparison):
        if phi not in scales:
            return phi
        by = Number(1 / scales[phi])
        return Comparison(phi.op, Arithmetic("*", phi.left, by), Arithmetic("*", phi.right, by))
    if not children(phi):
        return phi
    return with_children(phi, tuple(_rescaled(child, scales) for child in children(phi)))
