"""Which inputs to execute next: a portfolio of proposals, since no single one is good at every system.

    corners     all inputs constant at ends of their ranges       pieces   signals of a few pieces
    uniform     points without any structure                      vary     variations of the best points
    surface     a response surface of the scores                  dynamics a learned model of the system

The corners are first, then a few pieces and uniform points. Then surface and dynamics come most often, the others
between them, so that no kind of violation is out of reach. Where most executions have the same score (a requirement
over labels or a signal of few values), scores lead nowhere: then points are drawn without them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stltool.logic.formula import Formula
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.dynamics import by_dynamics
from stltool.testing.falsification.inputs import F64, Inputs
from stltool.testing.falsification.score import Scores
from stltool.testing.falsification.surface import by_surface

_START = ("pieces", "uniform", "pieces", "uniform")
_CYCLE = (
    "surface", "dynamics", "surface", "vary", "surface", "dynamics", "surface", "vary", "surface", "pieces", "uniform"
)  # fmt: skip
_FLAT = ("uniform", "uniform", "uniform", "pieces", "uniform", "uniform")
_FLAT_FROM = 6  # executions


class Portfolio:
    """`ask` for the next point, `tell` what came of it. Both depend on the seed and on what was told only."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        self._rng, self._inputs = rng, inputs
        self._candidates = Candidates(inputs, rng)
        self._scores = Scores(phi)
        self._points: list[F64] = []
        self._corners = self._candidates.corners()
        self._asked = dict.fromkeys((*_START, *_CYCLE, *_FLAT), 0)
        self._turn = 0

    def ask(self) -> F64:
        n = len(self._points)
        if n < len(self._corners):
            return self._corners[n]
        if n < len(self._corners) + len(_START):
            return self._proposal(_START[n - len(self._corners)])
        cycle = _FLAT if self._is_flat() else _CYCLE
        kind = cycle[self._turn % len(cycle)]
        self._turn += 1
        return self._proposal(kind)

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._points.append(x)
        self._scores.add(trace)

    def close(self) -> None:
        pass

    def _is_flat(self) -> bool:
        values = np.round(self._scores.values, 9)
        return len(values) >= _FLAT_FROM and len(np.unique(values)) <= max(3, len(values) // 4)

    def _proposal(self, kind: str) -> F64:
        points, scores = np.array(self._points), self._scores.values
        best = points[np.argsort(scores, kind="stable")[:8]]
        found: F64 | None = None
        if kind == "surface":
            found = by_surface(self._candidates, points, scores, self._asked["surface"])
        elif kind == "dynamics":
            found = by_dynamics(self._candidates, points, self._scores, self._rng)
        elif kind == "pieces":
            found = self._candidates.pieces()[0]
        elif kind == "uniform":
            found = self._candidates.uniform()[0]
        self._asked[kind] += 1
        if found is None:
            found = self._candidates.varied(self._candidates.drawn(best, 1))[0]
        return found
