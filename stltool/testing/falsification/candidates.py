"""Points of the unit cube that are worth a try without knowing anything of the system, and variations of known ones.

Requirements are mostly violated at extremes, held for long or switched a few times, rather than by noise. So a signal
is drawn as a few pieces, most of them at an end of the range; and variations change runs of control points, not single
ones.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from stltool.testing.falsification.inputs import F64, Inputs

_CORNERS = 8
_EXTREME = 0.6  # share of pieces that are at an end of their range
_EXTREME_NUMBER = 0.15
_MIXED = 0.4
_LEAST_MOVE, _MOST_MOVE = 0.06, 0.3  # standard deviations
_BY_PIECES = 0.5  # share of variations that respect the pieces a signal has
_GROWING = 0.3  # of those, how many move a change in time rather than a level


class Candidates:
    def __init__(self, inputs: Inputs, rng: np.random.Generator) -> None:
        self.inputs, self._rng = inputs, rng
        self._numbers = slice(inputs.dimension - len(inputs.numbers), inputs.dimension)

    def corners(self) -> list[F64]:
        """Constant inputs, as in a screening: all at rest, each alone at its far end, all there; then other corners."""
        inputs, rng, rest = self.inputs, self._rng, self.rest()
        far = np.where(rest < 0.5, 1.0, 0.0)
        alone = []
        for a, b in self._spans()[:_CORNERS]:
            x = rest.copy()
            x[a:b] = far[a:b]
            alone.append(x)
        found = [rest, *alone, far]
        n = len(inputs.places) + len(inputs.numbers)
        ends = list(itertools.product((0.0, 1.0), repeat=n)) if n <= 3 else rng.integers(0, 2, (_CORNERS, n)).tolist()
        for i in rng.permutation(len(ends)):
            x = np.empty(inputs.dimension)
            for (a, b), end in zip(self._spans(), ends[i], strict=True):
                x[a:b] = end
            found.append(x)
        distinct = {x.tobytes(): x for x in found}
        return list(distinct.values())[: max(_CORNERS, n + 2)]

    def rest(self) -> F64:
        """Every input at that value of its range that is nearest to zero: a system that nothing is done to."""
        inputs, found = self.inputs, np.empty(self.inputs.dimension)
        for (a, b), signal in zip(inputs.places, inputs.signals.values(), strict=True):
            found[a:b] = _resting(signal.low, signal.high)
        found[self._numbers] = [_resting(*ends) for ends in inputs.numbers.values()]
        return found

    def impulses(self, n: int = 1) -> F64:
        """One input differs from rest, or from constant ends, and only for a while, most often from the beginning."""
        rng, found = self._rng, np.repeat(self.rest()[None], n, axis=0)
        spans = self._spans()
        for row in found:
            if rng.random() < 0.5:
                for a, b in spans:
                    row[a:b] = float(rng.integers(0, 2))
            a, b = spans[int(rng.integers(len(spans)))]
            first = a if rng.random() < 0.5 else int(rng.integers(a, b))
            row[first : min(first + int(rng.geometric(0.5)), b)] = self._levels(1, 0.3)[0]
        return found

    def uniform(self, n: int = 1) -> F64:
        return self._rng.random((n, self.inputs.dimension))

    def mixed(self, n: int = 1) -> F64:
        """As uniform ones, of which some coordinates are at ends of their ranges."""
        x = self.uniform(n)
        found: F64 = np.where(self._rng.random(x.shape) < _MIXED, np.round(x), x)
        return found

    def pieces(self, n: int = 1) -> F64:
        """Signals of a few pieces."""
        rng, x = self._rng, self.uniform(n)
        for row in x:
            for a, b in self.inputs.places:
                cuts = min(int(rng.geometric(0.5)) - 1, b - a - 1)
                at = np.sort(rng.choice(np.arange(1, b - a), size=cuts, replace=False)) if cuts else np.empty(0, int)
                row[a:b] = np.repeat(self._levels(cuts + 1, _EXTREME), np.diff([0, *at, b - a]))
            row[self._numbers] = self._levels(len(self.inputs.numbers), _EXTREME_NUMBER)
        return x

    def varied(self, x: F64, relevant: NDArray[np.bool_] | None = None) -> F64:
        """Each row with one change or a few: a run of a signal's points, or a number, set or moved.

        Half of the runs are the pieces that a signal has already, or one of these grows at its neighbour's cost.

        relevant   (n, dimension): coordinates at which a run may begin; default: all
        """
        rng, found = self._rng, x.copy()
        whole = np.ones(self.inputs.dimension, np.bool_)
        for row, allowed in zip(found, [whole] * len(x) if relevant is None else relevant, strict=True):
            spans = [(a, b) for a, b in self._spans() if allowed[a:b].any()]
            for _ in range(int(rng.geometric(0.6))):
                a, b = spans[int(rng.integers(len(spans)))]
                first = int(rng.choice(a + np.flatnonzero(allowed[a:b])))
                run = slice(first, min(first + int(rng.geometric(0.4)), b))
                if rng.random() < _BY_PIECES:
                    run = _piece(row, a, b, first)
                    if run.start > a and rng.random() < _GROWING:
                        _grow(row, a, b, run.start, rng)
                        continue
                kind = rng.random()
                if kind < 0.35:
                    row[run] = float(rng.integers(0, 2))
                elif kind < 0.55:
                    row[run] = rng.random()
                else:
                    row[run] = np.clip(row[run] + rng.normal() * 10 ** rng.uniform(-2.5, -0.5), 0, 1)
        return found

    def spliced(self, first: F64, second: F64) -> F64:
        """Rows that follow `first` up to a random share of the time, then `second`."""
        rng, found = self._rng, first.copy()
        for row, other in zip(found, second, strict=True):
            share = rng.random()
            for a, b in self.inputs.places:
                cut = a + round(share * (b - a))
                row[cut:b] = other[cut:b]
            if rng.random() < 0.5:
                row[self._numbers] = other[self._numbers]
        return found

    def nearby(self, x: F64, spread: float, chance: float) -> F64:
        """Rows of which each coordinate has moved with some chance, at least one of them."""
        rng = self._rng
        moved = rng.random(x.shape) < chance
        moved[np.arange(len(x)), rng.integers(0, x.shape[1], len(x))] = True
        found: F64 = np.clip(x + moved * rng.normal(0, spread, x.shape), 0, 1)
        return found

    def moved(self, x: F64) -> F64:
        """Rows of which most coordinates have moved together, by little or by much."""
        rng = self._rng
        spread = _LEAST_MOVE * (_MOST_MOVE / _LEAST_MOVE) ** rng.random((len(x), 1))
        moves = rng.random(x.shape) < rng.uniform(0.4, 1, (len(x), 1))
        found: F64 = np.clip(x + moves * spread * rng.normal(size=x.shape), 0, 1)
        return found

    def drawn(self, rows: int, n: int) -> NDArray[np.int64]:
        """n indices of rows, the first ones more often."""
        return np.minimum(self._rng.geometric(max(2 / (rows + 1), 0.2), n) - 1, rows - 1)

    def _spans(self) -> list[tuple[int, int]]:
        """(first, end) coordinates of each input."""
        return [*self.inputs.places, *((i, i + 1) for i in range(self._numbers.start, self._numbers.stop))]

    def _levels(self, n: int, extreme: float) -> F64:
        rng = self._rng
        found: F64 = np.where(rng.random(n) < extreme, rng.integers(0, 2, n), rng.random(n))
        return found


def _piece(row: F64, a: int, b: int, at: int) -> slice:
    """The run of equal coordinates around `at`, within [a, b)."""
    changes = a + 1 + np.flatnonzero(np.diff(row[a:b]) != 0)
    i = int(np.searchsorted(changes, at, side="right"))
    ends = [a, *changes.tolist(), b]
    return slice(ends[i], ends[i + 1])


def _grow(row: F64, a: int, b: int, start: int, rng: np.random.Generator) -> None:
    """Move the change at `start` by a coordinate or a few."""
    n = int(rng.geometric(0.6))
    if rng.random() < 0.5:
        row[start : min(start + n, b)] = row[start - 1]
    else:
        row[max(start - n, a) : start] = row[start]


def _resting(low: float, high: float) -> float:
    """As a share of the range."""
    return (min(max(low, 0.0), high) - low) / (high - low)
