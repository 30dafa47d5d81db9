"""What a method is to the trainer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.models.environment import Environment


@dataclass(frozen=True)
class Path:
    """The transitions of one episode: states (n+1,) and the choices taken (n,), both int32."""

    states: NDArray[np.int32]
    actions: NDArray[np.int32]

    def rows(self) -> NDArray[np.int32]:
        """(n, 3) int32: s, a, s'."""
        return np.stack([self.states[:-1], self.actions, self.states[1:]], axis=1)


class Learner(ABC):
    """A method: it acts, sees what happens, and has a policy at any time.

    Numbers that an episode needs are drawn when it begins, so that episodes run whole or step by step are the same.
    """

    compiled = False  # whether `play` runs whole episodes in simulated models

    explores_on = False  # whether, when the task is violated, it explores to the horizon (u < 0), or begins anew

    def begin_episode(self, epsilon: float, length: int) -> None:
        """A new episode of at most `length` steps, with this chance of a random action."""
        self.epsilon = epsilon

    @abstractmethod
    def act(self, t: int, s: int, q: int, u: float, chance: float) -> int:
        """The choice to take; u and chance are uniform in [0, 1): the first says whether to explore."""

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:  # noqa: B027 - not all need it
        """One transition, at once."""

    def play(self, environment: Environment, explore: NDArray[np.float64]) -> Path:
        """A whole episode in a simulated model: what acting and observing step by step would give, to the bit."""
        raise NotImplementedError

    def end_episode(self, path: Path) -> None:  # noqa: B027 - not all need it
        """All transitions of the episode that ends."""

    @abstractmethod
    def policy_table(self) -> NDArray[Any]:
        """The policy to be judged, which does not explore: a table as `Policy` takes it."""

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that learning has changed, for a checkpoint between two episodes."""

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take back what `arrays` gave."""
        for name, array in self.arrays().items():
            array[...] = arrays[name]


def rarest(visits: NDArray[Any], chance: float) -> int:
    """The choice taken least, ties broken by `chance` in [0, 1): count-based exploring."""
    least = np.flatnonzero(visits == visits.min())
    return int(least[int(chance * len(least))])
