"""Cells of real observations, and what is sensed in them: signals, labels, also from `info` or the step."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from stltool.arguments import described, whole
from stltool.errors import ModelError, SizeError
from stltool.models.gymnasium.episodes import Episodes, Shared
from stltool.models.gymnasium.spaces import MOST_OBSERVATIONS, Observations, env_name


class Step(NamedTuple):
    """A step of an environment as labels may read it; after a reset, `before` and `action` are None."""

    before: Any
    action: int | None
    observation: Any
    reward: float
    terminated: bool
    info: Mapping[str, Any]


@dataclass(frozen=True)
class OfStep:
    """A label that is a function of the `Step` that led to an observation: OfStep(lambda step: step.reward < 0)."""

    holds: Callable[[Step], bool]


_INFO = "info."


def of_step(label: object) -> bool:
    """Whether a label is read from more than an observation."""
    return isinstance(label, OfStep) or (isinstance(label, str) and label.startswith(_INFO) and label != _INFO)


@dataclass(frozen=True, eq=False)
class Cells:
    """A division of observations. `of` an observation and its signals: the number of its cell, below `n`."""

    n: int
    of: Callable[[Any, Mapping[str, float]], int]
    name: Callable[[int], str]


@dataclass(frozen=True, eq=False)
class Senses:
    """How observations are read: signals name → function of an observation, labels name → function of a step."""

    title: str
    space: Any
    signals: Mapping[str, Callable[[Any], float]]
    labels: Mapping[str, Callable[[Step], bool]]
    cells: Cells

    @classmethod
    def of(
        cls,
        env: Any,
        signals: Mapping[str, Any],
        labels: Mapping[str, Any],
        cells: Mapping[str, Any] | Callable[[Any], int] | None,
        n_cells: int | None,
    ) -> Senses:
        """Raises ModelError if something given does not fit the environment's space."""
        title, space = env_name(env), env.observation_space
        finite = Observations.of(env) if cells is None else None
        if finite is not None:
            divided = Cells(
                finite.n_states, lambda observation, _: finite.index(observation), lambda s: str(finite.observation(s))
            )
        elif callable(cells):
            if n_cells is None:
                raise ModelError(f"{title}: cells is a function; give the number of its cells, too: n_cells=")
            divided = _by_function(title, cells, whole(n_cells, "n_cells", 1, MOST_OBSERVATIONS))
        else:
            divided = _by_edges(title, space, signals, cells)
        read = {name: _signal(title, space, name, given, finite) for name, given in signals.items()}
        hold = {name: _label(title, name, given, finite) for name, given in labels.items()}
        return cls(title, space, read, hold, divided)

    def contains(self, observation: Any) -> bool:
        """Whether it is an observation. Bounds are not held against real ones, whose rounding may leave them."""
        if not isinstance(self.space, spaces.Box):
            return bool(self.space.contains(observation))
        try:
            values = np.asarray(observation, dtype=np.float64)
        except (TypeError, ValueError):
            return False
        return values.shape == self.space.shape and bool(np.isfinite(values).all())


def _signal(title: str, space: Any, name: str, given: Any, finite: Observations | None) -> Callable[[Any], float]:
    """A function of an observation, or the number of a component of a Box; where they are finite, as ever."""
    if finite is not None:
        column = finite.signal(name, given)
        return lambda observation: float(column[finite.index(observation)])
    if callable(given):
        function: Callable[[Any], float] = given
        return function
    component = _component(title, space, name, given)
    return lambda observation: float(np.asarray(observation).ravel()[component])


def _component(title: str, space: Any, name: str, given: Any) -> int:
    size = math.prod(space.shape) if isinstance(space, spaces.Box) else 0
    if isinstance(given, bool) or not isinstance(given, int | np.integer) or not 0 <= given < size:
        numbers = f", or the number of a component, 0 … {size - 1}" if size else ""
        raise ModelError(f"{title}: signal {name} is {described(given)}; give a function of an observation{numbers}")
    return int(given)


def _label(title: str, name: str, given: Any, finite: Observations | None) -> Callable[[Step], bool]:
    """A function of an observation; `OfStep`; or the text "info.KEY", which is false where `info` has no such key."""
    if isinstance(given, OfStep):
        return given.holds
    if of_step(given):
        key = str(given).removeprefix(_INFO)
        return lambda step: bool(step.info.get(key, False))
    if callable(given):
        holds: Callable[[Any], bool] = given
        return lambda step: holds(step.observation)
    if finite is not None:
        column = finite.label(name, given)
        return lambda step: bool(column[finite.index(step.observation)])
    raise ModelError(
        f'{title}: label {name} is {described(given)}; for real observations give a function of one, "info.KEY", or '
        "OfStep(function of a step)"
    )


def _by_function(title: str, cells: Callable[[Any], int], n: int) -> Cells:
    def of(observation: Any, _: Mapping[str, float]) -> int:
        found = cells(observation)
        if isinstance(found, bool) or not isinstance(found, int | np.integer) or not 0 <= found < n:
            raise ModelError(
                f"{title}: cells returned {described(found)} for an observation; return a number of a cell, 0 … {n - 1}"
            )
        return int(found)

    return Cells(n, of, lambda cell: f"cell {cell}")


def _by_edges(title: str, space: Any, signals: Mapping[str, Any], cells: Any) -> Cells:
    """Cells between edges of signals; the first signal varies slowest."""
    if not isinstance(cells, Mapping) or not cells:
        raise ModelError(
            f"{title}: cells is {described(cells)}; divide at least one signal, such as cells={{'x': 0.2}}, or give a "
            "function of an observation"
        )
    edges = {name: _edges(title, space, signals, name, given) for name, given in cells.items()}
    n = math.prod(len(found) + 1 for found in edges.values())
    if n > MOST_OBSERVATIONS:
        raise SizeError(f"{title}: {n} cells; at most {MOST_OBSERVATIONS} can be states of a model; use wider cells")

    def of(_: Any, values: Mapping[str, float]) -> int:
        cell = 0
        for name, found in edges.items():
            cell = cell * (len(found) + 1) + int(np.searchsorted(found, values[name], side="right"))
        return cell

    def name_of(cell: int) -> str:
        parts = []
        for name, found in reversed(edges.items()):
            cell, i = divmod(cell, len(found) + 1)
            low = f"{found[i - 1]:g} <= " if i else ""
            high = f" < {found[i]:g}" if i < len(found) else ""
            parts.append(f"{low}{name}{high}" if low or high else f"any {name}")
        return ", ".join(reversed(parts))

    return Cells(n, of, name_of)


def _edges(title: str, space: Any, signals: Mapping[str, Any], name: str, given: Any) -> NDArray[np.float64]:
    """The values at which one cell of a signal ends and the next begins, ascending; its bounds separate nothing."""
    if name not in signals:
        raise ModelError(f"{title}: cells divide {name}, which is not a signal; give it in signals, too")
    low, high = -math.inf, math.inf
    if not callable(signals[name]):
        component = _component(title, space, name, signals[name])
        low, high = (float(np.ravel(end)[component]) for end in (space.low, space.high))
    if isinstance(given, Real) and not isinstance(given, bool | np.bool_):  # type: ignore[unreachable]
        width = float(given)
        if not (width > 0 and math.isfinite(high - low) and (high - low) / width < MOST_OBSERVATIONS):
            raise ModelError(
                f"{title}: cells of width {given} for {name}, which lies in [{low:g}, {high:g}]; give a positive width "
                "for a component with bounds, or the edges of the cells"
            )
        count = math.ceil((high - low) / width - 1e-9)
        even: NDArray[np.float64] = low + width * np.arange(1, count, dtype=np.float64)
        return even
    try:
        found = np.asarray(given, dtype=np.float64)
        if found.ndim != 1 or not np.isfinite(found).all() or (np.diff(found) <= 0).any():
            raise ValueError
    except (TypeError, ValueError):
        raise ModelError(
            f"{title}: cells of {name} are {described(given)}; give a width, or ascending edges such as [0, 0.2, 0.4]"
        ) from None
    return found[(found > low) & (found < high)]


class Sensor(Episodes):
    """Episodes whose answers are cells, with what is sensed there. Where they have ended, cells count from `n` on."""

    def __init__(self, shared: Shared, senses: Senses, rng: np.random.Generator, steps: int | None) -> None:
        super().__init__(shared, rng, steps)
        self._senses = senses
        self.signals: dict[str, float] = {}
        self.labels: dict[str, bool] = {}
        self.observation: Any = None

    def _read(self, answer: Sequence[Any], call: str, action: int | None) -> int:
        senses, observation = self._senses, answer[0]
        if not senses.contains(observation):
            raise self._outside(observation, call)
        before, reward, terminated = None, 0.0, False
        if action is not None:
            before, reward, terminated = self.observation, float(answer[1]), bool(answer[2])
        step = Step(before, action, observation, reward, terminated, answer[-1])
        for name, read in senses.signals.items():
            value = float(self._asked(f"signal {name}", read, observation))
            if not math.isfinite(value):
                raise ModelError(f"{self._title}: signal {name} is {value} at step {self._t}; it must be finite")
            self.signals[name] = value
        for name, holds in senses.labels.items():
            found = self._asked(f"label {name}", holds, step)
            if not isinstance(found, bool | np.bool_):
                raise ModelError(
                    f"{self._title}: label {name} is {described(found)} at step {self._t}; return True or False, or "
                    "make it a signal"
                )
            self.labels[name] = bool(found)
        self.observation = observation
        return int(self._asked("cells", functools.partial(senses.cells.of, observation), self.signals))

    def _asked(self, what: str, function: Callable[[Any], Any], value: Any) -> Any:
        try:
            return function(value)
        except ModelError:
            raise
        except Exception as error:  # any fault in there is the user's function's
            raise ModelError(
                f"{self._title}: {what} raised {type(error).__name__} at step {self._t}: {error}"
            ) from error
