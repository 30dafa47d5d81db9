"""Which inputs to execute next: a portfolio of proposals, since no single one is good at every system.

    corners     all inputs constant at ends of their ranges       pieces   signals of a few pieces
    impulses    one input differs from the others' rest a while   uniform  points without any structure
    dynamics    a learned model of the system                     surface  a response surface of the scores
    vary        variations of the best points

The first ones are corners, with a uniform point among them, and from the fifth execution on the model has every other
turn. Later dynamics and surface come most often, the others between them, so that no kind of violation is out of reach.
Where most executions have the same score (a requirement over labels or a signal of few values), also with times
(strict.py), scores lead nowhere: then points are drawn without them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stltool.logic.formula import Formula
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.dynamics import ByDynamics
from stltool.testing.falsification.inputs import F64, Inputs
from stltool.testing.falsification.surface import by_surface
from stltool.testing.falsification.tried import Tried

_START = ("corner", "corner", "uniform", "corner", "learned", "corner", "learned", "impulse", "learned", "pieces")
_CYCLE = (
    "dynamics", "surface", "dynamics", "surface", "dynamics", "vary", "dynamics", "surface", "pieces", "dynamics",
    "surface", "uniform",
)  # fmt: skip
_FLAT = ("uniform", "uniform", "uniform", "pieces", "uniform", "uniform")
_VARIED = 20  # variations, of which the first that may violate is executed


class Portfolio:
    """`ask` for the next point, `tell` what came of it. Both depend on the seed and on what was told only."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        self._rng, self._inputs = rng, inputs
        self._candidates = Candidates(inputs, rng)
        self._tried = Tried(phi, inputs)
        self._dynamics = ByDynamics(self._candidates, rng)
        self._corners = self._candidates.corners()
        more = max(len(self._corners) - _START.count("corner"), 0)
        self._start = [*_START, *("corner", "learned") * more]
        self._surfaces = 0
        self._turn = 0

    def ask(self) -> F64:
        while self._start:
            kind = self._start.pop(0)
            if kind == "learned":
                kind = "uniform" if self._tried.scores.flat else "dynamics"
            if kind != "corner":
                return self._proposal(kind)
            if self._corners:
                return self._corners.pop()
        cycle = _FLAT if self._tried.scores.flat else _CYCLE
        kind = cycle[self._turn % len(cycle)]
        self._turn += 1
        return self._proposal(kind)

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._tried.add(x, trace)

    def close(self) -> None:
        pass

    def _proposal(self, kind: str) -> F64:
        tried = self._tried
        found: F64 | None = None
        if kind == "surface":
            found = by_surface(self._candidates, tried, self._surfaces)
            self._surfaces += 1
        elif kind == "dynamics":
            found = self._dynamics.proposal(tried)
        elif kind == "pieces":
            found = self._candidates.pieces()[0]
        elif kind == "impulse":
            found = self._candidates.impulses()[0]
        elif kind == "uniform":
            found = self._candidates.uniform()[0]
        if found is None:
            parents = tried.best[self._candidates.drawn(min(len(tried), 8), _VARIED)]
            varied = self._candidates.varied(tried.points[parents], tried.relevant[parents])
            found = varied[int(np.argmin(tried.settled(varied)))]  # the first that is not
        return found
