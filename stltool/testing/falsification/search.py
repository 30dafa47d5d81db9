"""Which inputs to execute next: a portfolio of proposals, since no single one is good at every system.

    corners     all inputs constant at ends of their ranges       pieces   signals of a few pieces
    impulses    one input differs from the others' rest a while   uniform  points without any structure
    dynamics    a learned model of the system                     surface  a response surface of the scores
    vary        the best points, with pieces changed              move     the best points, most coordinates moved
    random      uniform points, in turn with some at ends

The first ones are corners: all inputs at rest, each alone at its far end, all of them there. A uniform point is among
them, and from the fifth execution on most proposals are the model's. Later dynamics, surface, both kinds of variation
and random points share five turns of six. A kind comes the more often, the more of its proposals were better than four
fifths of the executions before them (Thompson sampling [Russo18]): a model can see through one system, in another only
small steps lead on, and where nothing does, as many points are random as of any other kind. The sixth turn is one of
the others', so that no kind of violation is out of reach.
Where most executions have the same score (a requirement over labels or a signal of few values), also with times
(strict.py), scores lead nowhere: then all points are random.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Formula
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.dynamics import ByDynamics
from stltool.testing.falsification.inputs import F64, Inputs
from stltool.testing.falsification.surface import by_surface
from stltool.testing.falsification.tried import Tried

_START = (
    "corner", "corner", "uniform", "corner", "learned", "learned", "corner", "learned", "impulse", "learned", "pieces",
)  # fmt: skip
_SHARING = ("dynamics", "surface", "vary", "move", "random")
_EXPLORING = ("pieces", "impulse", "uniform")
_EXPLORED = 6  # turns, of which one explores
_GOOD = 0.2  # share of the executions whose scores are good ones
_REMEMBERED = 0.95  # of what a kind has shown, from one of its turns to the next
_PARENTS = 3  # executions that are varied: the best ones
_PATIENCE = 40  # executions without a better one, after which others than the best are varied
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
        self._shown = {kind: np.ones(2) for kind in _SHARING}
        self._asked: str | None = None

    def ask(self) -> F64:
        while self._start:
            kind = self._start.pop(0)
            if kind == "learned":
                kind = "random" if self._tried.scores.flat else "dynamics"
            if kind != "corner":
                return self._proposal(kind)
            if self._corners:
                self._asked = None
                return self._corners.pop(0)
        turn, self._turn = self._turn, self._turn + 1
        if self._tried.scores.flat:
            return self._proposal("random")
        if turn % _EXPLORED == _EXPLORED - 1:
            return self._proposal(_EXPLORING[turn // _EXPLORED % len(_EXPLORING)])
        kind = max(_SHARING, key=lambda kind: self._rng.beta(*self._shown[kind]))
        return self._proposal(kind)

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._tried.add(x, trace)
        if self._asked is not None:
            scores = self._tried.scores.values
            good = scores[-1] < np.quantile(scores[:-1], _GOOD)
            self._shown[self._asked] = 1 + _REMEMBERED * (self._shown[self._asked] - 1) + (good, not good)

    def close(self) -> None:
        pass

    def _proposal(self, kind: str) -> F64:
        tried = self._tried
        found: F64 | None = None
        self._asked = kind if kind in _SHARING else None
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
        elif kind == "random":
            found = (self._candidates.mixed() if len(tried) % 2 else self._candidates.uniform())[0]
        if found is None:
            best = self._worth_varying()
            parents = best[self._candidates.drawn(min(len(best), _PARENTS), _VARIED)]
            points = tried.points[parents]
            if kind == "move":
                varied = self._candidates.moved(points)
            else:
                varied = self._candidates.varied(points, tried.relevant[parents])
            found = varied[int(np.argmin(tried.settled(varied)))]  # the first that is not
        return found

    def _worth_varying(self) -> NDArray[np.int64]:
        """Executions, the best first: of all, or, where these lead no further, of the latest alone: a fresh start."""
        tried = self._tried
        best, n = tried.best, len(tried)
        latest = best[best >= n // _PATIENCE * _PATIENCE]
        return latest if n - 1 - best[0] > _PATIENCE and len(latest) > 1 else best
