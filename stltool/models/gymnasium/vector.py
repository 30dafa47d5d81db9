"""Gymnasium's vector environments as black boxes that take many runs at once (`Batched`).

Run i is sub-environment i. One that has ended stays in its last state here, whatever its autoreset mode makes of it:
the last observation is the answer itself, or with AutoresetMode.SAME_STEP what `info` keeps of it. With
AutoresetMode.DISABLED, those that have ended are reset before the next step, since none may be stepped then.

Every reset seeds each sub-environment with a number of the run's generator, so that generator is the only state kept
between two of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.models.gymnasium.episodes import SEEDS, Shared, too_short
from stltool.models.gymnasium.spaces import Observations

_FINAL = ("final_obs", "final_observation")  # names of the last observation in infos, since and before version 1.1


def is_vector(env: object) -> bool:
    """Whether an environment is a vector environment."""
    return isinstance(env, VectorEnv)


@dataclass(frozen=True)
class Single:
    """A sub-environment's spaces, and the name of all, as functions of spaces take them."""

    env: Any

    @property
    def observation_space(self) -> Any:
        return self.env.single_observation_space

    @property
    def action_space(self) -> Any:
        return self.env.single_action_space

    @property
    def spec(self) -> Any:
        return self.env.spec

    @property
    def unwrapped(self) -> Any:
        return self.env.unwrapped


@dataclass(eq=False)
class Vectors:
    """Runs of a vector environment, side by side. `steps`: the length of the episodes, if known."""

    shared: Shared
    observations: Observations
    generator: np.random.Generator
    steps: int | None
    batch: int = field(init=False)

    def __post_init__(self) -> None:
        env = self.shared.env
        self.batch = int(env.num_envs)
        longest = getattr(getattr(env, "spec", None), "max_episode_steps", None)
        if self.steps is not None and longest is not None and longest < self.steps:
            raise too_short(self.shared.title, longest, self.steps)

    def reset(self, n: int) -> NDArray[np.int64]:
        shared = self.shared
        seeds = self.generator.integers(SEEDS, size=self.batch).tolist()
        answer = self._call("reset(seed=[…])", lambda: shared.env.reset(seed=seeds), 2, "(observations, infos)")
        shared.running = self
        self._t, self._done = 0, np.zeros(self.batch, dtype=np.bool_)
        self._ended = np.zeros(self.batch, dtype=np.bool_)
        self._states = self._read(answer[0], range(n))
        self._note(self._states, np.zeros(n, dtype=np.bool_))
        return self._states.copy()

    def step(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        shared, n = self.shared, len(self._states)
        if shared.running is not self:
            raise ModelError(
                f"{shared.title}: another run has reset this environment in the middle of an episode; runs that take "
                "place at the same time need separate environments; call from_gymnasium for each"
            )
        live = (actions >= 0) & ~self._ended[:n]
        cut_off = live & self._done[:n]
        if cut_off.any():
            raise too_short(shared.title, self._t, self.steps)
        if self._done.any() and self._disabled:
            self._call("reset(options={'reset_mask': …})", self._reset_done, 2, "(observations, infos)")
        given = np.full(self.batch, shared.first_action)
        given[:n][live] += actions[live]
        self._t += 1
        answer = self._call("step(actions)", lambda: shared.env.step(given), 5,
                            "(observations, rewards, terminations, truncations, infos)")  # fmt: skip
        terminated, truncated = (np.asarray(flags, dtype=np.bool_) for flags in answer[2:4])
        which = np.flatnonzero(live)
        after = self._read(answer[0], which, self._last(answer[4], which, terminated | truncated))
        over = terminated[which]
        if shared.apart:
            after = np.where(over, after + shared.size, after)
        else:
            self._note(after, over)
        self._states[which] = after
        self._ended[which] |= over
        self._done = terminated | truncated
        return self._states.copy()

    @property
    def _disabled(self) -> bool:
        mode = (getattr(self.shared.env, "metadata", None) or {}).get("autoreset_mode")
        return getattr(mode, "value", mode) == "Disabled"

    def _reset_done(self) -> Any:
        return self.shared.env.reset(options={"reset_mask": self._done})

    def _last(self, infos: Any, which: Sequence[int] | NDArray[np.int64], done: NDArray[np.bool_]) -> dict[int, Any]:
        """The last observations that `infos` keeps, by run, where the answer has the first ones of new episodes."""
        kept = next((infos[key] for key in _FINAL if key in infos), None) if isinstance(infos, dict) else None
        if kept is None:
            return {}
        return {int(i): kept[i] for i in which if done[i] and kept[i] is not None}

    def _read(
        self, answers: Any, which: Sequence[int] | NDArray[np.int64], last: dict[int, Any] | None = None
    ) -> NDArray[np.int64]:
        """The states of these runs in an answer."""
        try:
            each = list(iterate(self.shared.env.observation_space, answers))
            found = [last[i] if last and i in last else each[i] for i in map(int, which)]
        except (TypeError, ValueError, LookupError):
            raise ModelError(
                f"{self.shared.title}: its observations at step {self._t} are not those of {self.batch} environments; "
                "correct the vector environment or its observation_space"
            ) from None
        states = [self.observations.index(observation) for observation in found]
        if -1 in states:
            raise ModelError(
                f"{self.shared.title}: an environment returned the observation {found[states.index(-1)]!r} at step "
                f"{self._t}, which is not in its space {self.shared.space}; correct it or its observation_space"
            )
        return np.array(states, dtype=np.int64)

    def _note(self, states: NDArray[np.int64], over: NDArray[np.bool_]) -> None:
        self.shared.note(set(states[~over].tolist()), set(states[over].tolist()))

    def _call(self, call: str, method: Callable[[], Any], length: int, needed: str) -> Any:
        try:
            answer = method()
        except Exception as error:  # any fault in there is the environment's
            what = f"{type(error).__name__}: {error}"
            raise ModelError(f"{self.shared.title}: {call} raised {what}") from error
        if not (isinstance(answer, tuple) and len(answer) == length):
            raise ModelError(f"{self.shared.title}: {call} did not return {needed}; correct the vector environment")
        return answer
