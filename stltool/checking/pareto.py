"""The Pareto front of two tasks: the pairs of probabilities that no policy can improve in one without losing in the
other.

The pairs that policies achieve are a polygon. For w ≥ 0, w₁ + w₂ = 1, one weighted backward induction (weighted.py)
gives a corner p(w) of it and a line that no policy crosses:

    w·p ≤ U(w)   for every achievable p,          w·p(w) = U(w) up to rounding

The search starts from the two corners that are best for one task alone. A segment between neighbours A, B is closed if
its normal weights find nothing above it (within the tolerance); otherwise the corner they find divides it. The segment
with the largest possible gap to the front, given the lines at its ends, is tried first. Source: [Forejt12].
"""

from __future__ import annotations

import heapq
import itertools
import time
from dataclasses import dataclass
from fractions import Fraction

from stltool.arguments import function, real, require, whole
from stltool.checking.induction import Progress
from stltool.checking.weighted import Criteria, Figure, best, probability
from stltool.choices import ByLayer
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError, named
from stltool.numbers import round_up
from stltool.policy import Policy
from stltool.product import JointProduct

_SHOWN = 10  # corners in a notebook
_SAME = 1e-12  # probabilities with a smaller relative difference count as equal


@dataclass(frozen=True, eq=False)
class Corner:
    """A deterministic policy's probabilities, best for `weights`: weights·p ≤ `bound` for every policy, rounding
    included. `policy` is over the joint product: it can be checked on the product of each task.
    """

    probabilities: tuple[Figure, Figure]
    weights: tuple[float, float]
    bound: float
    policy: Policy

    @property
    def point(self) -> tuple[float, float]:
        return self.probabilities[0].value, self.probabilities[1].value


@dataclass(frozen=True, eq=False, repr=False)
class Front(Displayed):
    """The front, from the best corner for the first task to the best for the second; mixed policies lie between
    corners.

    corners     undominated, in that order
    lines       (w₁, w₂, U): w·p ≤ U for every policy, rounding included
    gap         how far at most the true front is above the segments between corners, measured along their normals
    inductions  backward inductions taken
    status      "complete", or that the requested number of corners was reached first
    """

    joint: JointProduct
    corners: tuple[Corner, ...]
    lines: tuple[tuple[float, float, float], ...]
    gap: float
    inductions: int
    status: str
    seconds: float

    def _card(self) -> Card:
        first, second = self.joint.names
        points = [corner.point for corner in self.corners]
        ends = [f"({probability_text(p)}, {probability_text(q)})" for p, q in (points[0], points[-1])]
        rows = [(probability_text(p), probability_text(q)) for p, q in points[:_SHOWN]]
        return Card(
            f"Front: {first} and {second}, {counted(len(points), 'corner')}, {self.status}",
            [{"from": ends[0], "to": ends[1], "gap": f"{self.gap:.2g}"}, {"model": self.joint.model.name}],
            ((f"P({first})", f"P({second})"), rows),
            more=max(0, len(points) - _SHOWN),
        )

    @property
    def policies(self) -> tuple[Policy, ...]:
        """The policy of each corner, in their order."""
        return tuple(corner.policy for corner in self.corners)

    def at_least(self, second: float) -> tuple[float, float] | None:
        """(achieved by mixing corners, upper bound on) P(first) where P(second) >= `second`; None if out of reach."""
        second = float(real(second, "at_least's bound", "0.9"))
        if not 0 <= second <= 1:
            raise SettingsError(f"P({self.joint.names[1]}) >= {second}: give a probability between 0 and 1")
        points = [corner.point for corner in self.corners]
        if second > self.corners[-1].probabilities[1].upper:
            return None
        bounds = [(Fraction(u) - Fraction(w2) * Fraction(second)) / Fraction(w1) for w1, w2, u in self.lines if w1 > 0]
        above = round_up(min(*bounds, Fraction(1))) if bounds else 1.0
        second = min(second, points[-1][1])
        if second <= points[0][1]:
            return points[0][0], above
        (a1, a2), (b1, b2) = next((a, b) for a, b in itertools.pairwise(points) if a[1] <= second <= b[1])
        return (b1 if a2 == b2 else b1 + (a1 - b1) * (b2 - second) / (b2 - a2)), above


def pareto(
    joint: JointProduct, *, points: int = 100, tolerance: float = 1e-9, progress: Progress | None = None
) -> Front:
    """The Pareto front of a joint product's two tasks.

    At most `points` backward inductions are taken; a segment is closed when nothing lies more than `tolerance` above
    it. Raises SettingsError if there are not exactly two tasks, or a setting is out of range.
    """
    started = time.perf_counter()
    require(joint, JointProduct, "pareto's joint product")
    function(progress, "pareto's progress")
    if len(joint.tasks) != 2:
        raise SettingsError(f"a Pareto front needs exactly two tasks, found {len(joint.tasks)}; choose two")
    points = whole(points, "points")
    if points < 2:
        raise SettingsError(f"{named('points')} is {points}; give at least 2, the best corner for each task")
    tolerance = float(real(tolerance, "tolerance", "1e-9"))
    if not 0 < tolerance < 1:
        raise SettingsError(f"{named('tolerance')} is {tolerance}; give a number between 0 and 1")
    criteria = Criteria(joint)
    found: list[Corner] = []

    def corner(w1: float, w2: float) -> Corner:
        top, each, choices = best(criteria, (w1, w2))
        first, second = map(probability, each)
        policy = Policy(joint, ByLayer(choices, joint.automaton.offsets, joint.shape))
        found.append(Corner((first, second), (w1, w2), top.upper, policy))
        if progress is not None:
            progress(len(found), points)
        return found[-1]

    left, right = corner(1.0, 0.0), corner(0.0, 1.0)
    number = itertools.count()  # of segments, to break ties
    open_ = [(-_hidden(left, right), next(number), left, right)]
    closed = 0.0  # the largest possible gap of a closed segment
    while -open_[0][0] > tolerance and len(found) < points:
        _, _, a, b = heapq.heappop(open_)
        middle = corner(*_normal(a, b))
        above = _above(middle, a)
        if above > tolerance:
            for segment in ((a, middle), (middle, b)):
                heapq.heappush(open_, (-_hidden(*segment), next(number), *segment))
        else:
            closed = max(closed, above)
            heapq.heappush(open_, (0.0, next(number), a, b))
    gap = max(closed, -open_[0][0])
    return Front(
        joint=joint,
        corners=_undominated(found),
        lines=tuple((*c.weights, c.bound) for c in found),
        gap=gap,
        inductions=len(found),
        status="complete" if gap <= tolerance else f"stopped after {points} points; raise points to continue",
        seconds=time.perf_counter() - started,
    )


def _normal(a: Corner, b: Corner) -> tuple[float, float]:
    """The weights for which a and b are equally good."""
    (a1, a2), (b1, b2) = a.point, b.point
    across, along = max(b2 - a2, 0.0), max(a1 - b1, 0.0)
    total = across + along
    return (across / total, along / total) if total > 0 else (0.5, 0.5)


def _above(c: Corner, a: Corner) -> float:
    """How far at most an achievable point is above a, in the direction of c's weights."""
    return c.bound - sum(w * figure.lower for w, figure in zip(c.weights, a.probabilities, strict=True))


def _hidden(a: Corner, b: Corner) -> float:
    """How far at most the front is above the segment from a to b: where the lines through its ends meet."""
    if all(abs(p - q) <= _SAME * max(p, q) for p, q in zip(a.point, b.point, strict=True)):
        return max(_above(a, a), _above(b, b))
    (w1, w2), (u1, u2), (v1, v2) = _normal(a, b), a.weights, b.weights
    det = u1 * v2 - u2 * v1
    if abs(det) < _SAME:  # parallel lines
        return max(_above(a, a), _above(b, b))
    meets = ((w1 * v2 - w2 * v1) * a.bound + (u1 * w2 - u2 * w1) * b.bound) / det
    return meets - w1 * a.probabilities[0].lower - w2 * a.probabilities[1].lower


def _undominated(corners: list[Corner]) -> tuple[Corner, ...]:
    """The undominated points without duplicates, the best for the first task first."""
    kept: list[Corner] = []
    for corner in sorted(corners, key=lambda c: (-c.point[0], -c.point[1])):
        # earlier ones are better for the first task, so this one must be better for the second
        if kept and corner.point[1] <= kept[-1].point[1] * (1 + _SAME):
            continue
        while kept and kept[-1].point[0] <= corner.point[0] * (1 + _SAME):
            kept.pop()
        kept.append(corner)
    return tuple(kept)
