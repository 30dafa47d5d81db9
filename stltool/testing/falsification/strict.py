"""How near a trace is to a violation in time, for requirements whose margins do not say it.

A requirement over gears, modes or labels is as far from a violation while a mode lasts for three seconds as while it
lasts for three hours, if two are asked for. So its inner windows are made stricter, step by step: what must hold
throughout [a, b] must hold throughout [a, a + λ (b − a)], and what must hold sometime in [a, b] must hold sometime in
[a, a + (b − a) / λ]. The least λ that a trace violates is how near it is. [Donze10] has time robustness by shifting
signals, of which this is a relative.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stltool.errors import SizeError
from stltool.logic.formula import Always, Eventually, Formula, Interval, Release, Until, children, with_children
from stltool.logic.rewrite import negation_normal_form
from stltool.monitoring import monitor
from stltool.testing.falsification.inputs import F64

_FACTORS = 1.15 ** np.arange(1, 21)  # up to sixteen times as strict


class Strictness:
    def __init__(self, phi: Formula) -> None:
        try:
            plain = negation_normal_form(phi)
        except SizeError:
            self._ladder: list[Formula] = []
            return
        ladder = dict.fromkeys(_stricter(plain, factor, inner=False) for factor in _FACTORS)
        self._ladder = [one for one in ladder if one != plain]

    def __bool__(self) -> bool:
        return bool(self._ladder)

    def of(self, traces: Mapping[str, F64]) -> F64:
        """Shares (n,) of the ladder that traces (n, h + 1) satisfy: in [0, 1], small if nearly a violation."""
        found = [monitor(one, traces, "hold", "boolean", at=0).verdicts for one in self._ladder]
        shares: F64 = np.mean(np.array(found, np.float64), axis=0)[:, 0]
        return shares


def _stricter(phi: Formula, factor: float, inner: bool) -> Formula:
    """Of a formula in negation normal form. The outermost windows stay: a trace ends with them."""
    below = inner or isinstance(phi, Always | Eventually | Until | Release)
    kept = (
        with_children(phi, tuple(_stricter(child, factor, below) for child in children(phi))) if children(phi) else phi
    )
    if not inner or not isinstance(kept, Always | Eventually | Until | Release):
        return kept
    start, width = kept.interval.a, kept.interval.last - kept.interval.a
    if isinstance(kept, Always | Release):
        changed = Interval(start, start + round(width * factor))
    else:
        changed = Interval(start, start + int(width / factor))
    return kept.__class__(changed, *children(kept))
