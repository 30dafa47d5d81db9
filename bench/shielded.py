"""Deep agents trained under a shield: MaskablePPO of sb3-contrib, each judged exactly.

The paper's P1 with c = 0.95 and a static mask. A third of the agents is rewarded for satisfying the task, a third for
violating it, a third at random. Each trained network is a policy by `Policy.from_function`, under the mask; `check`
says what it is worth. The last column counts the agents whose exact P is below c: the shield promises that there is
none.

sb3-contrib needs torch, whose wheels are too large for the extras: install both beside stltool.
"""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import stltool as stl

ROOT = Path(__file__).resolve().parent.parent
PROMISE = 0.95
AIMS = ("satisfy", "violate", "random")


class Aimed(gymnasium.RewardWrapper):
    """The environment with another aim; the masks stay."""

    def __init__(self, env: gymnasium.Env[Any, Any], aim: str, rng: np.random.Generator) -> None:
        super().__init__(env)
        self._aim, self._rng = aim, rng

    def reward(self, reward: Any) -> float:
        if self._aim == "random":
            return float(self._rng.standard_normal())
        return float(reward) if self._aim == "satisfy" else -float(reward)

    def action_masks(self) -> Any:
        return self.env.unwrapped.action_masks()


def agent(product: stl.Product, shield: stl.Shield, aim: str, seed: int, steps: int) -> stl.Policy:
    """A policy of a network that was trained for some steps under the shield."""
    from sb3_contrib import MaskablePPO

    env = stl.to_gymnasium(product, shield=shield)
    aimed = Aimed(env, aim, np.random.default_rng(seed))
    network = MaskablePPO("MultiInputPolicy", aimed, n_steps=128, batch_size=64, n_epochs=4, seed=seed, device="cpu")
    network.learn(steps)
    model = product.model

    def act(here: Any) -> int:
        observation = env.unwrapped.observation(here.step, here.state, here.memory)
        mask = np.zeros(len(model.action_names), dtype=bool)
        first, end = model.choice_start[here.state : here.state + 2]
        mask[model.choice_action[first:end]] = shield.allows(here.step, here.state, here.memory)
        action, _ = network.predict(observation, action_masks=mask, deterministic=True)
        return int(action)

    return stl.Policy.from_function(product, act)


def table(quick: bool = False) -> list[str]:
    agents, steps = (3, 128) if quick else (100, 512)
    task = stl.load_task(ROOT / "examples" / "factory" / "patrolling.stl", params={"T": 10, "tau": 10})
    product = stl.build_product(stl.load_model(task.model), task)
    shield, best = stl.shield(product, PROMISE), stl.check(product)
    lines = [
        f"P1, c = {PROMISE}; P* = {best.probability:.4f}; the worst that obeys has {shield.least.value:.4f}. "
        f"MaskablePPO, {steps} steps an agent.",
        "",
        f"| rewarded for | agents | least P | median P | greatest P | below {PROMISE} |",
        "|---|" + "---:|" * 5,
    ]
    for i, aim in enumerate(AIMS):
        found = [stl.check(product, agent(product, shield, aim, seed, steps)) for seed in range(i, agents, len(AIMS))]
        values = sorted(one.probability for one in found)
        below = sum(one.lower < PROMISE for one in found)
        figures = " | ".join(f"{value:.4f}" for value in (values[0], statistics.median(values), values[-1]))
        lines.append(f"| {aim} | {len(found)} | {figures} | {below} |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
