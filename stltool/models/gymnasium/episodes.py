"""A Gymnasium environment as a black box: reset and step over state indices, with errors that name the cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stltool.errors import ModelError

SEEDS = 2**31  # every environment accepts seeds below this


@dataclass(eq=False)
class Shared:
    """An environment, and what all runs of it share.

    space      of its observations;  read  an observation → its state, −1 if the space does not contain it
    name       of the observation of a state;  size  the number of states
    running    the run whose episode is in progress
    before, at_end   states from which runs continued, and in which they ended; disjoint unless ends are kept apart
    """

    env: Any
    title: str
    space: Any
    read: Callable[[Any], int]
    name: Callable[[int], str]
    size: int
    first_action: int
    apart: bool
    running: object | None = None
    before: set[int] = field(default_factory=set)
    at_end: set[int] = field(default_factory=set)

    def note(self, goes_on: set[int], ends: set[int]) -> None:
        """Note states from which runs continue, and in which they end; ModelError if one is both, as then observations
        form no MDP."""
        self.before |= goes_on
        self.at_end |= ends
        both = (goes_on & self.at_end) | (ends & self.before)
        if both and not self.apart:
            raise ModelError(
                f"{self.title}: the observation {self.name(min(both))} occurred both during an episode and at its end, "
                "so observations are not states of an MDP; use ends='apart' (in a model file: ends = \"apart\")"
            )


class Episodes:
    """Episodes of an environment as runs of states: `reset()` and `step(i)` return a state's index.

    `steps` is the length of the episodes, if known: an environment known to cut them off earlier is refused.
    """

    def __init__(self, shared: Shared, rng: np.random.Generator, steps: int | None) -> None:
        self._shared, self._rng, self._steps = shared, rng, steps
        self._env, self._title = shared.env, shared.title
        self._state, self._t = -1, 0
        self._terminated = self._truncated = False
        longest = getattr(getattr(shared.env, "spec", None), "max_episode_steps", None)
        if steps is not None and longest is not None and longest < steps:
            raise self._too_short(longest)

    def reset(self) -> int:
        answer = self._call("reset(seed=…)", self._env.reset, seed=int(self._rng.integers(SEEDS)))
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise old_api(self._title, "reset(seed=…)", answer, "(observation, info)")
        self._shared.running = self
        self._t, self._terminated, self._truncated = 0, False, False
        self._state = self._read(answer, "reset(seed=…)", None)
        self._shared.note({self._state}, set())
        return self._state

    def step(self, action: int) -> int:
        if self._shared.running is not self:
            raise ModelError(
                f"{self._title}: another run has reset this environment in the middle of an episode; runs that "
                "take place at the same time need separate environments; call from_gymnasium for each"
            )
        if self._terminated:
            return self._state
        if self._truncated:
            raise self._too_short(self._t)
        self._t += 1
        call = f"step({self._shared.first_action + action})"
        answer = self._call(call, self._env.step, self._shared.first_action + action)
        if not (isinstance(answer, tuple) and len(answer) == 5):
            raise old_api(self._title, call, answer, "(observation, reward, terminated, truncated, info)")
        self._state = self._read(answer, call, action)
        if not all(isinstance(flag, bool | np.bool_) for flag in answer[2:4]):
            raise ModelError(
                f"{self._title}: {call} returned terminated = {answer[2]!r} and truncated = {answer[3]!r} at step "
                f"{self._t}; return Booleans"
            )
        self._terminated, self._truncated = bool(answer[2]), bool(answer[3])
        if self._terminated and self._shared.apart:
            self._state += self._shared.size
        elif self._terminated:
            self._shared.note(set(), {self._state})
        else:
            self._shared.note({self._state}, set())
        return self._state

    def _call(self, call: str, method: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        try:
            return method(*arguments, **named)
        except Exception as error:  # any fault in there is the environment's
            what = f"{type(error).__name__} at step {self._t}: {error}"
            raise ModelError(f"{self._title}: {call} raised {what}") from error

    def _read(self, answer: Sequence[Any], call: str, action: int | None) -> int:
        """The state in an answer to `step(action)`, or to a reset."""
        s = self._shared.read(answer[0])
        if s < 0:
            raise self._outside(answer[0], call)
        return s

    def _outside(self, observation: object, call: str) -> ModelError:
        return ModelError(
            f"{self._title}: {call} returned the observation {observation!r} at step {self._t}, which is not in "
            f"its space {self._shared.space}; correct the environment or its observation_space"
        )

    def _too_short(self, length: int) -> ModelError:
        return too_short(self._title, length, self._steps)


def too_short(title: str, length: int, steps: int | None) -> ModelError:
    """For an environment whose episodes are cut off before the task is decided, after `steps` at the latest."""
    needed, option = ("more", "…") if steps is None else (str(steps), str(steps))
    return ModelError(
        f"{title}: its episodes are cut off (truncated) after {length} steps, and the task needs {needed}; make it "
        f"with gymnasium.make(…, max_episode_steps={option}), in a model file under [options], or shorten the task's "
        "windows"
    )


def old_api(title: str, call: str, answer: object, needed: str) -> ModelError:
    """For an environment whose `reset` or `step` answers as in the older gym package."""
    shown = f"{len(answer)} values" if isinstance(answer, tuple) else f"{type(answer).__name__} {answer!r}"
    return ModelError(
        f"{title}: {call} returned {shown}, not {needed}; it follows the older gym API; port it to gymnasium"
    )
