"""The next point by a response surface of the scores: an interpolation by radial basis functions [Regis13].

Candidates vary the best points so far. Of them that one is next whose predicted score and whose distance from all
points tried are best together, with weights that go in turn from the distance to the score. Every second time the
surface is a local one, through the points nearest to the best, and candidates vary that point alone: where a score has
edges, what is far away says nothing of what is near.
"""

from __future__ import annotations

import numpy as np

from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.inputs import F64
from stltool.testing.falsification.tried import Tried

_CANDIDATES = 300
_WEIGHTS = (0.5, 0.8, 0.95, 1.0)
_SPREADS = (0.3, 0.1, 0.03)
_MOVED = 10  # coordinates that change, about
_LATEST = 200  # points that the surface goes through

_NEAR = 200  # candidates that vary the best point by runs
_CLOSE = 60  # and by single coordinates, for each of
_CLOSE_SPREADS = (0.2, 0.06, 0.02)
_LEAST_APART = 1e-4
_BOLD = 0.3  # standard deviations of the scores that are worth one median distance


def by_surface(candidates: Candidates, tried: Tried, turn: int) -> F64 | None:
    """The next point (dimension,); None if there is no surface."""
    try:
        return _anywhere(candidates, tried, turn // 2) if turn % 2 == 0 else _nearby(candidates, tried)
    except np.linalg.LinAlgError:
        return None


def _nearby(candidates: Candidates, tried: Tried) -> F64:
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial.distance import cdist

    x, scores = tried.points, tried.scores.values
    first = int(np.argmin(scores))
    dimension, best = x.shape[1], x[first]
    near = np.argsort(np.linalg.norm(x - best, axis=1), kind="stable")[: max(2 * dimension, 20)]
    surface = RBFInterpolator(x[near], scores[near], kernel="linear", degree=0, smoothing=1e-8)
    close = np.repeat(best[None], _CLOSE, axis=0)
    parts = [candidates.nearby(close, s, n / dimension) for s in _CLOSE_SPREADS for n in (1, min(4, dimension))]
    new = np.concatenate(
        [*parts, candidates.varied(*(np.repeat(a[first][None], _NEAR, axis=0) for a in (x, tried.relevant)))]
    )
    distance = cdist(new, x[near]).min(axis=1)
    bold = _BOLD * scores[near].std() / max(float(np.median(distance)), _LEAST_APART)
    merit = surface(new) - bold * distance
    merit[tried.settled(new) | (distance < _LEAST_APART)] = np.inf
    found: F64 = new[int(np.argmin(merit))]
    return found


def _anywhere(candidates: Candidates, tried: Tried, turn: int) -> F64:
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial.distance import cdist

    x, scores, order = tried.points, tried.scores.values, tried.best
    kept = np.sort(order[:_LATEST])
    dimension = x.shape[1]
    heights = np.minimum(scores[kept], np.median(scores[kept]))  # how high the heights are does not matter
    cubic = np.linalg.matrix_rank(x[kept] - x[kept[0]]) == dimension  # its linear part is determined
    surface = RBFInterpolator(
        x[kept], heights, kernel="cubic" if cubic else "linear", degree=1 if cubic else 0, smoothing=1e-8
    )
    chance = min(1.0, _MOVED / dimension)
    parts = [candidates.uniform(_CANDIDATES // 10), candidates.pieces(_CANDIDATES // 10)]
    parents = order[candidates.drawn(min(len(x), 10), _CANDIDATES // 2)]
    parts.append(candidates.varied(x[parents], tried.relevant[parents]))
    few = _CANDIDATES // 10
    parts += [candidates.nearby(x[order[candidates.drawn(min(len(x), 3), few)]], s, chance) for s in _SPREADS]
    new = np.concatenate(parts)
    predicted, distance = surface(new), cdist(new, x).min(axis=1)
    weight = _WEIGHTS[turn % len(_WEIGHTS)]
    merit = weight * _unit(predicted) + (1 - weight) * (1 - _unit(distance))
    merit[tried.settled(new) | (distance < 1e-6)] = np.inf
    best: F64 = new[int(np.argmin(merit))]
    return best


def _unit(values: F64) -> F64:
    low, high = values.min(), values.max()
    found: F64 = (values - low) / (high - low) if high > low else np.zeros_like(values)
    return found
