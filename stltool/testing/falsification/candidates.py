"""Points of the unit cube that are worth a try without knowing anything of the system, and variations of known ones.

Requirements are mostly violated at extremes, held for long or switched a few times, rather than by noise. So a signal
is drawn as a few pieces, most of them at an end of the range; and variations change runs of control points, not single
ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from stltool.testing.falsification.inputs import F64, Inputs

_CORNERS = 8
_EXTREME = 0.6  # share of pieces that are at an end of their range
_EXTREME_NUMBER = 0.15


class Candidates:
    def __init__(self, inputs: Inputs, rng: np.random.Generator) -> None:
        self.inputs, self._rng = inputs, rng
        self._numbers = slice(inputs.dimension - len(inputs.numbers), inputs.dimension)

    def corners(self) -> list[F64]:
        """All inputs constant at ends of their ranges: all such points in random order, or the first few."""
        inputs, rng = self.inputs, self._rng
        n = len(inputs.places) + len(inputs.numbers)
        ends = list(itertools.product((0.0, 1.0), repeat=n)) if n <= 3 else rng.integers(0, 2, (_CORNERS, n)).tolist()
        found = []
        for i in rng.permutation(len(ends))[:_CORNERS]:
            x = np.empty(inputs.dimension)
            for (a, b), end in zip(inputs.places, ends[i], strict=False):
                x[a:b] = end
            x[self._numbers] = ends[i][len(inputs.places) :]
            found.append(x)
        return found

    def uniform(self, n: int = 1) -> F64:
        return self._rng.random((n, self.inputs.dimension))

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

    def varied(self, x: F64) -> F64:
        """Each row with one change or a few: a run of a signal's points, or a number, set or moved."""
        rng, found = self._rng, x.copy()
        spans = [*self.inputs.places, *((i, i + 1) for i in range(self._numbers.start, self._numbers.stop))]
        for row in found:
            for _ in range(int(rng.geometric(0.6))):
                a, b = spans[int(rng.integers(len(spans)))]
                first = int(rng.integers(a, b))
                run = slice(first, min(first + int(rng.geometric(0.4)), b))
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

    def drawn(self, rows: Sequence[F64] | F64, n: int) -> F64:
        """n of the rows, the first of them more often."""
        ranks = np.minimum(self._rng.geometric(max(2 / (len(rows) + 1), 0.2), n) - 1, len(rows) - 1)
        return np.asarray(rows)[ranks]

    def _levels(self, n: int, extreme: float) -> F64:
        rng = self._rng
        found: F64 = np.where(rng.random(n) < extreme, rng.integers(0, 2, n), rng.random(n))
        return found
