"""The next point by a learned model of the system: the input that violates the requirement most in prediction.

A score is one number for each execution, but an execution is a whole trace. From all of them the change of the signals
from one model step to the next is fitted, as a function of signals, their last changes, inputs and time, by ridge
regression on random Fourier features [Rahimi07]:

    y_{k+1} − y_k ≈ C φ(z_k),   z_k = (y_k, y_k − y_{k−1}, y_k − y_{k−2}, u_k, k),   φ(z) = (1, z, cos(W z + b))

Candidates are then executed in the model, hundreds at a time, scored by the requirement itself, and bred for a few
generations. [Menghi20] and [Bak24] falsify with fitted models, too: linear ones, and Koopman operators.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.errors import StlToolError
from stltool.logic.formula import label_names
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.inputs import F64
from stltool.testing.falsification.score import Scores

_STEPS = 64  # of the model, at most
_FEATURES = 120
_RIDGE = 1e-4
_ROWS = 3000  # transitions that are fitted
_EXECUTIONS = 25  # the best ones
_POPULATION = 96
_GENERATIONS = 4
_LAGS = (1, 2)


def by_dynamics(candidates: Candidates, x: F64, scores: Scores, rng: np.random.Generator) -> F64 | None:
    """The next point (dimension,); None if the traces give no model to go by."""
    inputs = candidates.inputs
    names = list(scores.traces([0]))
    length = scores.traces([0])[names[0]].shape[1]
    if length < 4:
        return None
    labels = label_names(scores.phi)
    order = np.argsort(scores.values, kind="stable")
    used = order[:_EXECUTIONS].tolist()
    every = -(-length // _STEPS)
    at = np.arange(0, length, every)
    traces = scores.traces(used)
    try:
        model = Dynamics(
            inputs.unit_samples(x[used], np.minimum(at, inputs.steps - 1)),
            np.stack([traces[name][:, at] for name in names], axis=2),
            x[used][:, inputs.dimension - len(inputs.numbers) :],
            rng,
        )
    except np.linalg.LinAlgError:
        return None
    position = np.minimum(np.arange(length) / every, len(at) - 1)
    left = np.minimum(position.astype(np.int64), len(at) - 2)
    share = (position - left)[None, :, None]

    def predicted(points: F64) -> F64:
        y = model.executed(
            inputs.unit_samples(points, np.minimum(at, inputs.steps - 1)),
            points[:, inputs.dimension - len(inputs.numbers) :],
        )
        full = y[:, left] * (1 - share) + y[:, left + 1] * share
        found = {name: np.ascontiguousarray(full[:, :, i]) for i, name in enumerate(names)}
        return scores.of({name: (one > 0.5).astype(float) if name in labels else one for name, one in found.items()})

    half = _POPULATION // 2
    population = np.concatenate([candidates.pieces(half), candidates.varied(candidates.drawn(x[order[:8]], half))])
    try:
        worth = predicted(population)
        for _ in range(_GENERATIONS):
            best = np.argsort(worth, kind="stable")[: _POPULATION // 4]
            parents = population[best]
            pairs = parents[rng.integers(0, len(parents), (2, _POPULATION))]
            spliced = np.where((rng.random(_POPULATION) < 0.5)[:, None], candidates.spliced(*pairs), pairs[0])
            children = candidates.varied(spliced)
            population = np.concatenate([parents, children])
            worth = np.concatenate([worth[best], predicted(children)])
    except StlToolError:  # what is predicted gives some term no value, or is not finite
        return None
    for i in np.argsort(worth, kind="stable").tolist():
        if np.abs(x - population[i]).max(axis=1).min() > 1e-3:
            found: F64 = population[i]
            return found
    return None


class Dynamics:
    """Fitted on inputs (n, steps, inputs), signals (n, steps, signals) and numbers (n, numbers)."""

    def __init__(self, inputs: F64, signals: F64, numbers: F64, rng: np.random.Generator) -> None:
        flat = signals.reshape(-1, signals.shape[2])
        self._mean, self._spread = flat.mean(axis=0), _positive(flat.std(axis=0))
        low, high = flat.min(axis=0), flat.max(axis=0)
        self._low, self._high = low - (high - low) / 2, high + (high - low) / 2
        changes = np.diff(signals, axis=1)
        self._change = _positive(changes.reshape(-1, signals.shape[2]).std(axis=0))
        self._start = _least_squares(numbers, signals[:, 0])
        steps = signals.shape[1] - 1
        z = np.concatenate([self._features(signals, k, inputs) for k in range(steps)])
        target = np.concatenate([changes[:, k] / self._change for k in range(steps)])
        if len(z) > _ROWS:
            kept = rng.choice(len(z), _ROWS, replace=False)
            z, target = z[kept], target[kept]
        widths = rng.choice([0.5, 1.5, 3.0], _FEATURES) / np.sqrt(z.shape[1])
        self._w, self._b = rng.normal(size=(z.shape[1], _FEATURES)) * widths, rng.uniform(0, 2 * np.pi, _FEATURES)
        phi = self._lifted(z)
        self._c = np.linalg.solve(phi.T @ phi + _RIDGE * len(phi) * np.eye(phi.shape[1]), phi.T @ target)

    def executed(self, inputs: F64, numbers: F64) -> F64:
        """(n, steps, signals)"""
        n, steps = inputs.shape[:2]
        y = np.empty((n, steps, len(self._mean)))
        y[:, 0] = _with_one(numbers) @ self._start
        for k in range(steps - 1):
            change = self._lifted(self._features(y, k, inputs)) @ self._c * self._change
            y[:, k + 1] = np.clip(y[:, k] + change, self._low, self._high)
        return y

    def _features(self, y: F64, k: int, inputs: F64) -> F64:
        n = len(y)
        parts = [(y[:, k] - self._mean) / self._spread]
        parts += [(y[:, k] - y[:, max(k - lag, 0)]) / (lag * self._change) for lag in _LAGS]
        parts += [2 * inputs[:, k] - 1, np.full((n, 1), 2 * k / inputs.shape[1] - 1)]
        return np.concatenate(parts, axis=1)

    def _lifted(self, z: F64) -> F64:
        return np.concatenate([_with_one(z), np.cos(z @ self._w + self._b)], axis=1)


def _with_one(z: F64) -> F64:
    return np.concatenate([np.ones((len(z), 1)), z], axis=1)


def _least_squares(z: F64, y: F64) -> F64:
    return np.asarray(np.linalg.lstsq(_with_one(z), y, rcond=None)[0], dtype=np.float64)


def _positive(spread: F64) -> NDArray[np.float64]:
    return np.where(spread > 0, spread, 1.0)
