"""An MDP as a Gymnasium environment. With product.py the only module that imports gymnasium at import time."""

from __future__ import annotations

from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.errors import ModelError
from stltool.models.environment import Environment, sampler
from stltool.models.mdp import MDP


class Moves:
    """The model's moves by numbers of actions: what both environments share.

    state   the current state of the model; −1 before the first reset
    """

    def __init__(self, model: MDP, unavailable: Literal["error", "stay"], steps: int | None) -> None:
        self.model, self.state, self._unavailable = model, -1, unavailable
        self.actions: Any = spaces.Discrete(model.n_actions)
        self._sampler = sampler(model, steps)
        self._number = np.full((model.n_states, model.n_actions), -1)  # index of an action among the available ones
        state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
        self._number[state, model.choice_action] = np.arange(model.n_choices) - model.choice_start[state]
        self._environment: Environment | None = None

    def reset(self, rng: np.random.Generator, begin: bool) -> None:
        """Go to a first state; with `begin`, of new episodes that draw from `rng`."""
        if self._environment is None or begin:
            self._environment = self._sampler(rng)
        self.state = self._environment.reset()

    def step(self, action: Any) -> None:
        self.require(action)
        assert self._environment is not None
        number = int(self._number[self.state, action])
        if number >= 0:
            self.state = self._environment.step(number)
        elif self._unavailable == "error":
            names = [self.model.action_names[a] for a in np.flatnonzero(self.mask)]
            raise ModelError(
                f"action {self.model.action_names[action]} is not available in state "
                f"{self.model.state_name(self.state)}, which has {', '.join(names)}; follow info['action_mask'], or "
                "make the environment with unavailable='stay'"
            )

    @property
    def observed(self) -> Any:
        """What the environment of a model of cells observes now."""
        assert self._environment is not None
        assert self._environment.observed is not None
        return self._environment.observed()

    def require(self, action: Any) -> None:
        """ModelError unless there is an episode, and such an action."""
        if self._environment is None:
            raise ModelError("step was called before reset; call reset() first")
        if not self.actions.contains(action):
            raise ModelError(f"action {described(action)} is not one of 0 … {self.model.n_actions - 1}")

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(A,): the actions that are available in the current state."""
        has: NDArray[np.bool_] = self._number[self.state] >= 0
        return has

    def info(self) -> dict[str, Any]:
        return {"state": self.model.state_name(self.state), "action_mask": self.mask.astype(np.int8)}


class MDPEnv(gymnasium.Env[int, int]):
    """See `to_gymnasium`. `info` contains the name of the state and the mask (A,) int8 of its available actions."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - the base class declares it so

    def __init__(self, model: MDP, unavailable: Literal["error", "stay"] = "error") -> None:
        self.model = model
        self.observation_space: Any = spaces.Discrete(model.n_states)
        self._moves = Moves(model, unavailable, None)
        self.action_space: Any = self._moves.actions

    def action_masks(self) -> NDArray[np.bool_]:
        """(A,): the actions that are available in the current state."""
        return self._moves.mask

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self._moves.reset(self.np_random, begin=seed is not None)
        return self._moves.state, self._moves.info()

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self._moves.step(action)
        return self._moves.state, 0.0, False, False, self._moves.info()
