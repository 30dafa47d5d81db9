"""An MDP as a Gymnasium environment. The only module that imports gymnasium at import time."""

from __future__ import annotations

from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from stltool.arguments import described
from stltool.errors import ModelError
from stltool.models.environment import Environment, sampler
from stltool.models.mdp import MDP


class MDPEnv(gymnasium.Env[int, int]):
    """See `to_gymnasium`. `info` contains the name of the state and the mask (A,) int8 of its available actions."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - the base class declares it so

    def __init__(self, model: MDP, unavailable: Literal["error", "stay"] = "error") -> None:
        self.model = model
        self.observation_space: Any = spaces.Discrete(model.n_states)
        self.action_space: Any = spaces.Discrete(model.n_actions)
        self._unavailable = unavailable
        self._sampler = sampler(model)
        self._number = np.full((model.n_states, model.n_actions), -1)  # index of an action among the available ones
        state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
        self._number[state, model.choice_action] = np.arange(model.n_choices) - model.choice_start[state]
        self._environment: Environment | None = None
        self._state = -1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        if self._environment is None or seed is not None:
            self._environment = self._sampler(self.np_random)
        self._state = self._environment.reset()
        return self._state, self._info()

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        if self._environment is None:
            raise ModelError("step was called before reset; call reset() first")
        if not self.action_space.contains(action):
            raise ModelError(f"action {described(action)} is not one of 0 … {self.model.n_actions - 1}")
        number = int(self._number[self._state, action])
        if number >= 0:
            self._state = self._environment.step(number)
        elif self._unavailable == "error":
            names = [self.model.action_names[a] for a in np.flatnonzero(self._number[self._state] >= 0)]
            raise ModelError(
                f"action {self.model.action_names[action]} is not available in state "
                f"{self.model.state_name(self._state)}, which has {', '.join(names)}; follow info['action_mask'], or "
                "make the environment with unavailable='stay'"
            )
        return self._state, 0.0, False, False, self._info()

    def _info(self) -> dict[str, Any]:
        mask = (self._number[self._state] >= 0).astype(np.int8)
        return {"state": self.model.state_name(self._state), "action_mask": mask}
