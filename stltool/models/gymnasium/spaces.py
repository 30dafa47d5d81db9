"""Spaces of finitely many values ↔ integers; labels and signals as users give them for observations."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import described
from stltool.display import cut
from stltool.errors import ModelError, SizeError
from stltool.models.fractions import floats

MOST_OBSERVATIONS = 1 << 25
"""As states of a model: functions of observations and tables of learners are evaluated in every one of them."""

LabelGiven: TypeAlias = Callable[[Any], bool] | Iterable[Any]
SignalGiven: TypeAlias = Callable[[Any], float] | ArrayLike


def env_name(env: Any) -> str:
    """The id if the environment was made from one, else the name of its class."""
    spec = getattr(env, "spec", None)
    return str(spec.id) if spec is not None else type(getattr(env, "unwrapped", env)).__name__


@dataclass(frozen=True, eq=False)
class Observations:
    """An observation space of finitely many values ↔ states 0 … S−1; the last component varies fastest.

    sizes, starts   (components,): the number of values of each component, and the least one
    """

    space: Any
    title: str
    sizes: tuple[int, ...]
    starts: tuple[int, ...]

    @classmethod
    def of(cls, env: Any) -> Observations:
        title = env_name(env)
        space = getattr(env, "observation_space", None)
        found = _components(space)
        if found is None:
            raise ModelError(
                f"{title}: its observations are {cut(str(space), 200)}, which are not finitely many; divide them into "
                "cells, such as cells={'x': 0.2} of a signal x, or wrap it in a gymnasium.ObservationWrapper that "
                "numbers what can be observed"
            )
        sizes = tuple(size for size, _ in found)
        digits = sum(map(math.log10, sizes))
        if digits > math.log10(MOST_OBSERVATIONS) + 1e-9:
            count = math.prod(sizes) if digits < 18 else f"about 10^{digits:.0f}"
            raise SizeError(
                f"{title}: its space {cut(str(space), 60)} has {count} observations, and at most {MOST_OBSERVATIONS} "
                "can be the states of a model; wrap it in a gymnasium.ObservationWrapper that observes less, or use "
                "stl.MDP.black_box with states of your own"
            )
        return cls(space, title, sizes, tuple(start for _, start in found))

    @property
    def plain(self) -> bool:
        """Whether an observation is one number."""
        return hasattr(self.space, "n") and hasattr(self.space, "start")

    @property
    def n_states(self) -> int:
        return math.prod(self.sizes)

    def observation(self, s: int) -> int | tuple[int, ...]:
        """The observation of state s."""
        values = []
        for size, start in zip(reversed(self.sizes), reversed(self.starts), strict=True):
            s, digit = divmod(s, size)
            values.append(start + digit)
        return values[0] if self.plain else tuple(reversed(values))

    def index(self, observation: object) -> int:
        """The state of an observation as returned by the environment; −1 if the space does not contain it."""
        try:
            values = _values(self.space, observation)
        except (TypeError, ValueError):
            return -1
        return self._index(values)

    def _index(self, values: Sequence[int]) -> int:
        s = 0
        for value, size, start in zip(values, self.sizes, self.starts, strict=True):
            if not 0 <= value - start < size:
                return -1
            s = s * size + value - start
        return s

    def label(self, name: str, given: LabelGiven) -> NDArray[np.bool_]:
        """(S,) Booleans from a function, from the observations where the label holds, or from S Booleans."""
        if callable(given):
            found = [given(self.observation(s)) for s in range(self.n_states)]
            for s, value in enumerate(found):
                if not isinstance(value, bool | np.bool_):
                    raise ModelError(
                        f"label {name} is {described(value)} for observation {self.observation(s)}; return True or "
                        "False, or make it a signal"
                    )
            return np.array(found, dtype=np.bool_)
        if isinstance(given, str | bytes | Mapping) or not isinstance(given, Iterable):
            raise ModelError(
                f"label {name} is {described(given)}; give a function of an observation, the observations where it "
                f"holds, or {self.n_states} Booleans"
            )
        items = given.tolist() if isinstance(given, np.ndarray) else list(given)
        if items and all(isinstance(item, bool | np.bool_) for item in items):
            if isinstance(given, set | frozenset) or len(items) != self.n_states:
                raise ModelError(
                    f"label {name} has {len(items)} Booleans; give {self.n_states} in the order of the states, or the "
                    "observations where it holds"
                )
            return np.array(items, dtype=np.bool_)
        holds = np.zeros(self.n_states, dtype=np.bool_)
        for item in items:
            s = self._index(self._listed(item))
            if isinstance(item, bool | np.bool_) or s < 0:
                raise ModelError(
                    f"label {name}: {described(item)} is not an observation of {self.title}, which has {self.space}"
                )
            if holds[s]:
                raise ModelError(
                    f"label {name} lists {described(item)} twice; to give one value per state, write True and "
                    "False, not 1 and 0; to list observations, write each only once"
                )
            holds[s] = True
        like_values = self.plain and 0 < len(items) == self.n_states <= 2 and set(items) <= {0, 1}
        if like_values and not isinstance(given, set | frozenset | range):
            raise ModelError(
                f"label {name} is {items}, which can be a list of observations or of values; write a set of "
                "observations, or True and False"
            )
        return holds

    def _listed(self, item: Any) -> Sequence[int]:
        """The components of an observation that a user gave; values outside the space if it is not one."""
        parts = [item] if self.plain else item
        try:
            values = [operator.index(part) for part in parts]
        except TypeError:
            values = []
        return values if len(values) == len(self.sizes) else [start - 1 for start in self.starts]

    def signal(self, name: str, given: SignalGiven) -> NDArray[np.float64]:
        """(S,) reals from a function, or from S reals."""
        values = [given(self.observation(s)) for s in range(self.n_states)] if callable(given) else given
        try:
            if isinstance(values, str | bytes | set | frozenset | Mapping):
                raise ModelError(f"signal {name} does not contain numbers")
            column = floats(values, f"signal {name}")
        except ModelError as error:
            raise ModelError(
                f"{error}; give {self.n_states} of them in the order of the states, or a function of an observation"
            ) from None
        if column.shape != (self.n_states,):
            raise ModelError(f"signal {name} has shape {column.shape}; one number for each of {self.n_states} states")
        return column


def _components(space: Any) -> list[tuple[int, int]] | None:
    """(size, start) of each component, nested ones in order; None if one of them is not discrete."""
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        return [(int(space.n), int(space.start))]
    if isinstance(space, spaces.MultiDiscrete):
        starts = getattr(space, "start", np.zeros_like(space.nvec))
        return [(int(n), int(start)) for n, start in zip(space.nvec.ravel(), np.ravel(starts), strict=True)]
    if isinstance(space, spaces.MultiBinary):
        return [(2, 0)] * math.prod(space.shape)
    if isinstance(space, spaces.Box) and space.dtype.kind in "iu":
        ends = zip(space.low.ravel().tolist(), space.high.ravel().tolist(), strict=True)
        return [(high - low + 1, low) for low, high in ends]
    if isinstance(space, spaces.Tuple | spaces.Dict):
        found: list[tuple[int, int]] = []
        for part in space.spaces.values() if isinstance(space, spaces.Dict) else space.spaces:
            inner = _components(part)
            if inner is None:
                return None
            found += inner
        return found or None
    return None


def _values(space: Any, observation: Any) -> list[int]:
    """The components of an observation; TypeError or ValueError if its form is not that of the space."""
    nested = getattr(space, "spaces", None)
    if isinstance(nested, Mapping):
        if not isinstance(observation, Mapping) or set(observation) != set(nested):
            raise TypeError
        return [v for key, part in nested.items() for v in _values(part, observation[key])]
    if nested is not None:
        if not isinstance(observation, tuple | list):
            raise TypeError
        return [v for part, item in zip(nested, observation, strict=True) for v in _values(part, item)]
    shape = space.shape
    if not shape:
        return [operator.index(observation)]
    array = np.asarray(observation)
    if array.shape != shape or array.dtype.kind not in "iu":
        raise ValueError
    return [int(value) for value in array.ravel()]


def actions_of(env: Any, title: str) -> tuple[int, int]:
    """(the first action, the number of actions)"""
    from gymnasium import spaces

    space = getattr(env, "action_space", None)
    if not isinstance(space, spaces.Discrete):
        raise ModelError(
            f"{title}: its actions are {space}; a Discrete space is needed: wrap it in a gymnasium.ActionWrapper that "
            "numbers the actions to choose from"
        )
    if space.n > MOST_OBSERVATIONS:
        raise SizeError(
            f"{title}: its space {space} has more than {MOST_OBSERVATIONS} actions, too many to number; wrap it in a "
            "gymnasium.ActionWrapper that offers fewer"
        )
    return int(space.start), int(space.n)


def observation_text(observation: int | tuple[int, ...]) -> str:
    return str(observation) if isinstance(observation, int) else f"({','.join(map(str, observation))})"
