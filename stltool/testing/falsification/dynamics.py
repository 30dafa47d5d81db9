"""The next point by a learned model of the system: the input that violates the requirement most in prediction.

A score is one number for each execution, but an execution is a whole trace. From all of them the change of the signals
from one model step to the next is fitted, as a function of signals, their last changes, inputs and time, by ridge
regression on random Fourier features [Rahimi07]:

    y_{k+1} − y_k ≈ C φ(z_k),   z_k = (y_k, y_k − y_{k−1}, y_k − y_{k−2}, u_k, k),   φ(z) = (1, z, cos(W z + b))

Some systems are smooth and some are not, so there are several settings of ridge and features; that one is used which
best predicts executions that it was not fitted to, from their inputs alone. Candidates are then executed in the model,
hundreds at a time, scored by the requirement itself, and bred for a few generations. What scores of executions differed
by from their predictions is taken into account (`Surprise`). [Menghi20] and [Bak24] falsify with fitted models, too:
linear ones, and Koopman operators.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stltool.errors import StlToolError
from stltool.logic.formula import (
    Always,
    Eventually,
    Formula,
    Release,
    Until,
    children,
    label_names,
    variables,
)
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.inputs import F64
from stltool.testing.falsification.tried import Tried

_STEPS = 64  # of the model, at most, unless the formula asks about shorter times
_MOST_STEPS = 160
_WITHIN = 10  # steps of the model within the shortest of the inner windows
_FEATURES, _MOST_FEATURES = 120, 240
_ROWS_A_FEATURE = 8  # where that makes more than the least number of features
_LINEAR_RIDGE = 1e-6  # on the linear part of a setting that has a ridge for the other part alone
_ROWS = 5000  # transitions that are fitted
_EXECUTIONS = 25  # the best ones
_POPULATION = 96
_GENERATIONS = 4
_LAGS = (1, 2)
_FEW = 12  # a signal of no more values is discrete
_FEWEST = 4  # executions from which a setting is chosen
_CHOSEN = 1.25  # and chosen again when there are so many times more
_HIGHEST = 3.0  # a score beyond it is as bad as that
_BOLD = (0.0, 0.5, 1.0)  # standard deviations by which a prediction may be better than it seems, in turn
_NOISE = 1e-3  # of scores that are predicted
_WORST = 2.0  # an error beyond so many standard deviations is as bad as that


class Setting(NamedTuple):
    """Ridge; whether it is on the nonlinear part alone; widths of the random frequencies; whether changes are known."""

    ridge: float
    nonlinear: bool
    widths: tuple[float, ...]
    lagged: bool


_WIDE, _NARROW = (0.5, 1.5, 3.0), (0.5, 1.5)
_SETTINGS = (
    Setting(1e-4, False, _WIDE, True),
    Setting(1e-3, True, _WIDE, True),
    Setting(1e-2, True, _NARROW, True),
    Setting(1e-1, True, _WIDE, True),
    Setting(1e-3, True, _WIDE, False),
    Setting(1e-2, True, _WIDE, False),
)


class ByDynamics:
    """Proposals by a model that is fitted again for each of them."""

    def __init__(self, candidates: Candidates, rng: np.random.Generator) -> None:
        self._candidates, self._rng = candidates, rng
        self._setting, self._chosen_at = _SETTINGS[0], 0
        self._turn = 0

    def proposal(self, tried: Tried) -> F64 | None:
        """The next point (dimension,); None if the traces give no model to go by."""
        first = tried.scores.traces([0])
        names, length = list(first), next(iter(first.values())).shape[-1]
        if length < 4:
            return None
        try:
            return self._proposal(tried, names, length)
        except (StlToolError, np.linalg.LinAlgError):  # what is predicted gives some term no value; or there is no fit
            return None

    def _proposal(self, tried: Tried, names: list[str], length: int) -> F64 | None:
        inputs, candidates, rng = self._candidates.inputs, self._candidates, self._rng
        x, scores, order = tried.points, tried.scores, tried.best
        used = order[:_EXECUTIONS].tolist()
        every = -(-length // _steps(scores.phi, length))
        at = np.arange(0, length, every)
        traces = scores.traces(used)
        numbers = slice(inputs.dimension - len(inputs.numbers), inputs.dimension)
        signals = np.stack([traces[name][:, at] for name in names], axis=2)
        given = inputs.unit_samples(x[used], np.minimum(at, inputs.steps - 1))
        needed = [i for i, name in enumerate(names) if name in {**variables(scores.phi), **label_names(scores.phi)}]
        spread = _positive(signals.std(axis=(0, 1)))[needed]
        if len(used) >= max(_FEWEST, self._chosen_at * _CHOSEN):
            errors = [_error(given, signals, x[used, numbers], needed, one, rng) for one in _SETTINGS]
            self._setting, self._chosen_at = _SETTINGS[int(np.argmin(errors))], len(used)
        model = Dynamics(given, signals, x[used, numbers], rng, self._setting)
        judged = {names[i]: i for i in needed}
        levels = {name: found for name in judged if len(found := np.unique(traces[name])) <= _FEW}
        position = np.minimum(np.arange(length) / every, len(at) - 1)
        left = np.minimum(position.astype(np.int64), len(at) - 2)
        share = position - left

        def executed(points: F64) -> tuple[F64, F64]:
            y = model.executed(inputs.unit_samples(points, np.minimum(at, inputs.steps - 1)), points[:, numbers])
            columns = {name: y[:, left, i] * (1 - share) + y[:, left + 1, i] * share for name, i in judged.items()}
            worth = scores.of({name: _nearest(one, levels.get(name)) for name, one in columns.items()})
            return np.clip(worth, -_HIGHEST, _HIGHEST), (y[:, :, needed] / spread).reshape(len(y), -1)

        worth, traced = executed(x)
        surprise = Surprise(traced, np.clip(scores.values, -_HIGHEST, _HIGHEST) - worth)
        bold = _BOLD[self._turn % len(_BOLD)]
        self._turn += 1

        def predicted(points: F64) -> F64:
            worth, traced = executed(points)
            mean, deviation = surprise.at(traced)
            promise: F64 = np.where(tried.settled(points), np.inf, worth + mean - bold * deviation)
            return promise

        part = _POPULATION // 3
        kept = order[candidates.drawn(min(len(x), 8), part)]
        varied = candidates.varied(x[kept], tried.relevant[kept])
        population = np.concatenate([candidates.pieces(part), candidates.impulses(part), varied])
        worth = predicted(population)
        for _ in range(_GENERATIONS):
            best = np.argsort(worth, kind="stable")[: _POPULATION // 4]
            parents = population[best]
            pairs = parents[rng.integers(0, len(parents), (2, _POPULATION))]
            spliced = np.where((rng.random(_POPULATION) < 0.5)[:, None], candidates.spliced(*pairs), pairs[0])
            children = candidates.varied(spliced)
            population = np.concatenate([parents, children])
            worth = np.concatenate([worth[best], predicted(children)])
        for i in np.argsort(worth, kind="stable").tolist():
            if np.abs(x - population[i]).max(axis=1).min() > 1e-3:
                proposed: F64 = population[i]
                return proposed
        return None


class Dynamics:
    """Fitted on inputs (n, steps, inputs), signals (n, steps, signals) and numbers (n, numbers)."""

    def __init__(
        self, inputs: F64, signals: F64, numbers: F64, rng: np.random.Generator, setting: Setting = _SETTINGS[0]
    ) -> None:
        self._lags = _LAGS if setting.lagged else ()
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
        n = int(np.clip(len(z) // _ROWS_A_FEATURE, _FEATURES, _MOST_FEATURES))
        widths = rng.choice(setting.widths, n) / np.sqrt(z.shape[1])
        self._w, self._b = rng.normal(size=(z.shape[1], n)) * widths, rng.uniform(0, 2 * np.pi, n)
        phi = self._lifted(z)
        ridge = np.full(phi.shape[1], setting.ridge)
        if setting.nonlinear:
            ridge[: z.shape[1] + 1] = _LINEAR_RIDGE
        self._c = np.linalg.solve(phi.T @ phi + len(phi) * np.diag(ridge), phi.T @ target)

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
        parts += [(y[:, k] - y[:, max(k - lag, 0)]) / (lag * self._change) for lag in self._lags]
        parts += [2 * inputs[:, k] - 1, np.full((n, 1), 2 * k / inputs.shape[1] - 1)]
        return np.concatenate(parts, axis=1)

    def _lifted(self, z: F64) -> F64:
        """φ(z); the cosines, which take most of the time, in single precision."""
        return np.concatenate([_with_one(z), np.cos((z @ self._w + self._b).astype(np.float32))], axis=1)


class Surprise:
    """What scores differ by from their predictions, as a Gaussian process over predicted traces (n, …).

    Its kernel is exp(−d/ℓ), where d is the mean square distance of two traces, and ℓ the median of those.
    """

    def __init__(self, traced: F64, surprise: F64) -> None:
        self._traced = traced
        distance = self._distance(traced)
        positive = distance[distance > 0]
        self._length = float(np.median(positive)) if len(positive) else 1.0
        kernel = np.exp(-distance / self._length) + _NOISE * np.eye(len(traced))
        self._inverse = np.linalg.inv(kernel)
        self._weights = self._inverse @ surprise
        self._size = float(np.sqrt(np.mean(surprise**2)))

    def at(self, traced: F64) -> tuple[F64, F64]:
        """Mean and standard deviation (m,) for predicted traces (m, …)."""
        kernel = np.exp(-self._distance(traced) / self._length)
        variance = 1 + _NOISE - np.einsum("ij,jk,ik->i", kernel, self._inverse, kernel)
        return kernel @ self._weights, self._size * np.sqrt(np.maximum(variance, 0))

    def _distance(self, traced: F64) -> F64:
        from scipy.spatial.distance import cdist

        found: F64 = cdist(traced, self._traced) / np.sqrt(traced.shape[1])
        return found


def _steps(phi: Formula, length: int) -> int:
    """Of the model: as many as it takes to see the shortest inner window."""
    widths = [width for child in _below(phi) for width in _widths(child)]
    return int(np.clip(_WITHIN * length / min(widths, default=length), _STEPS, _MOST_STEPS))


def _below(phi: Formula) -> list[Formula]:
    """What is under the outermost windows."""
    if isinstance(phi, Always | Eventually | Until | Release):
        return list(children(phi))
    return [one for child in children(phi) for one in _below(child)]


def _widths(phi: Formula) -> list[int]:
    """Of all windows of more than one step."""
    own = []
    if isinstance(phi, Always | Eventually | Until | Release) and phi.interval.last > phi.interval.a:
        own = [phi.interval.last - phi.interval.a]
    return own + [width for child in children(phi) for width in _widths(child)]


def _error(
    inputs: F64, signals: F64, numbers: F64, needed: list[int], setting: Setting, rng: np.random.Generator
) -> float:
    """Of predictions of each half of the executions by a model of the other half, in standard deviations."""
    spread, errors = _positive(signals.std(axis=(0, 1))), []
    for half in (0, 1):
        fitted = np.arange(len(inputs)) % 2 == half
        try:
            model = Dynamics(inputs[fitted], signals[fitted], numbers[fitted], rng, setting)
        except np.linalg.LinAlgError:
            return _WORST
        predicted = model.executed(inputs[~fitted], numbers[~fitted])
        error = np.abs(predicted - signals[~fitted]) / spread
        errors.append(np.minimum(error[:, :, needed], _WORST).mean())
    return float(np.mean(errors))


def _nearest(signal: F64, levels: F64 | None) -> F64:
    """Each sample as the nearest of the ascending levels, if there are any."""
    if levels is None:
        return signal
    found: F64 = levels[np.searchsorted((levels[1:] + levels[:-1]) / 2, signal)]
    return found


def _with_one(z: F64) -> F64:
    return np.concatenate([np.ones((len(z), 1)), z], axis=1)


def _least_squares(z: F64, y: F64) -> F64:
    return np.asarray(np.linalg.lstsq(_with_one(z), y, rcond=None)[0], dtype=np.float64)


def _positive(spread: F64) -> NDArray[np.float64]:
    return np.where(spread > 0, spread, 1.0)
