"""Inputs of a system as points of a unit cube: a number is one coordinate, a signal one for each control point."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, mapping, one_of, real, whole
from stltool.display import Card, Displayed
from stltool.errors import SettingsError

F64: TypeAlias = NDArray[np.float64]
Shape: TypeAlias = Literal["constant", "linear"]

_EXAMPLE = '{"throttle": Signal(0, 100, points=6), "slope": (-0.1, 0.1)}'


@dataclass(frozen=True, repr=False)
class Signal(Displayed):
    """An input that changes over time: `points` control points between `low` and `high`.

    shape   "constant": each is held for an equal share of the samples; "linear": lines from one to the next, the first
            at the first sample, the last at the last
    """

    low: float
    high: float
    points: int = 5
    shape: Shape = "constant"

    def __post_init__(self) -> None:
        low, high = _range((self.low, self.high), "a signal")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        object.__setattr__(self, "points", whole(self.points, "points", least=1, most=10_000))
        one_of(self.shape, "shape", get_args(Shape))

    def _card(self) -> Card:
        return Card(f"Signal({self.low!r}, {self.high!r}, points={self.points}, shape={self.shape!r})")

    def samples(self, values: F64, steps: int) -> F64:
        """(…, steps) samples from control points (…, points)."""
        if self.shape == "constant" or self.points == 1:
            return values[..., np.arange(steps) * self.points // steps]
        at = np.linspace(0, self.points - 1, steps)
        left = np.minimum(at.astype(np.int64), self.points - 2)
        share = at - left
        found: F64 = values[..., left] * (1 - share) + values[..., left + 1] * share
        return found


InputsGiven: TypeAlias = Mapping[str, "Signal | tuple[float, float]"]


class Inputs:
    """The unit cube of a system's inputs.

    places   (first, end) coordinates of each signal, in order; numbers have the coordinates after the last signal
    """

    def __init__(self, given: InputsGiven, steps: int) -> None:
        checked = mapping(given, "falsify's inputs", _EXAMPLE)
        if not checked:
            raise SettingsError(f"falsify's inputs are empty; write, for example, {_EXAMPLE}")
        self.steps = steps
        self.given: dict[str, Signal | tuple[float, float]] = {
            name: one if isinstance(one, Signal) else _range(one, f"the input {name}") for name, one in checked.items()
        }
        self.signals = {name: one for name, one in self.given.items() if isinstance(one, Signal)}
        self.numbers = {name: one for name, one in self.given.items() if not isinstance(one, Signal)}
        ends = np.cumsum([0, *(signal.points for signal in self.signals.values())]).tolist()
        self.places: list[tuple[int, int]] = list(itertools.pairwise(ends))
        self.dimension = ends[-1] + len(self.numbers)

    def values(self, x: F64) -> dict[str, Any]:
        """What the system is given: an array (steps,) for a signal, a float for a number."""
        found: dict[str, Any] = {}
        points = self.points(x)
        for name, one in self.given.items():
            found[name] = one.samples(points[name], self.steps) if isinstance(one, Signal) else points[name]
        return found

    def points(self, x: F64) -> dict[str, Any]:
        """Control points of signals (points,), and numbers."""
        found: dict[str, Any] = {}
        for (name, signal), (a, b) in zip(self.signals.items(), self.places, strict=True):
            found[name] = signal.low + (signal.high - signal.low) * x[a:b]
        for (name, (low, high)), share in zip(
            self.numbers.items(), x[self.dimension - len(self.numbers) :], strict=True
        ):
            found[name] = float(low + (high - low) * share)
        return {name: found[name] for name in self.given}

    def unit_samples(self, x: F64, at: NDArray[np.int64]) -> F64:
        """(n, len(at), inputs): shares of the ranges at samples `at`, for points (n, dimension)."""
        columns = [
            signal.samples(x[:, a:b], self.steps)[:, at]
            for signal, (a, b) in zip(self.signals.values(), self.places, strict=True)
        ]
        first = self.dimension - len(self.numbers)
        columns += [np.repeat(x[:, i : i + 1], len(at), axis=1) for i in range(first, self.dimension)]
        return np.stack(columns, axis=2)

    @property
    def begins(self) -> NDArray[np.int64]:
        """Ascending: the samples from which another control point has a part; not the first."""
        parts = (signal.samples(np.eye(signal.points), self.steps) > 0 for signal in self.signals.values())
        firsts = [part.argmax(axis=1) for part in parts]
        found = np.unique(np.concatenate([np.empty(0, np.int64), *firsts]))
        return found[found > 0]

    def relevant(self, samples: int) -> NDArray[np.bool_]:
        """(dimension,): which coordinates have a part in the first samples; numbers always have."""
        found = np.ones(self.dimension, np.bool_)
        for signal, (a, b) in zip(self.signals.values(), self.places, strict=True):
            found[a:b] = signal.samples(np.eye(signal.points), self.steps)[:, :samples].any(axis=1)
        return found


def _range(given: object, what: str) -> tuple[float, float]:
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise SettingsError(
            f"{what} is {described(given)}; give its range, (low, high), or a Signal with control points"
        )
    low, high = (float(real(end, f"an end of the range of {what}")) for end in given)
    if not low < high or not math.isfinite(high - low):
        raise SettingsError(f"the range of {what} is ({low:g}, {high:g}); its low end must be below its high one")
    return low, high
