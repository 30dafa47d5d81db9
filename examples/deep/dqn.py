"""DQN on a task, with and without counterfactual transitions in its replay buffer, judged exactly.

    python -m examples.deep.dqn                  ten seeds of each, all shown; some minutes
    python -m examples.deep.dqn --episodes 40 --seeds 2
    python -m examples.deep.dqn --sb3            the same with Stable-Baselines3's DQN, where it and torch are installed

The learner sees what `stl.to_gymnasium(product)` shows: the model's state, the automaton's memory, and the time to go,
one-hot each; its return is the task's verdict. The buffer stores every real transition, and k counterfactual ones: what
it would have been with another memory at another time. `ReplayBuffer.add` stores one row an environment, here as in
Stable-Baselines3, so these are k calls. The greedy policy is a function of the situation, and `stl.check` judges it.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

import stltool as stl
from stltool.asked import Situations
from stltool.envs.product import ProductEnv

_HERE = Path(__file__).resolve().parent
FLOOR = next(path for path in (_HERE / "floor-5x5.toml", _HERE.parent / "factory" / "floor-5x5.toml") if path.exists())
TASK = "G[0,5) (F[0,5) A & F[0,5) (x < 0.4 & y > 0.6))"
DISCOUNT, BATCH, UPDATES, RENEW, CAPACITY = 1.0, 64, 4, 100, 50_000


class Network:
    """A multilayer perceptron with two hidden layers, and Adam on the Huber loss of chosen outputs."""

    def __init__(self, inputs: int, outputs: int, rng: np.random.Generator, hidden: int = 64, rate: float = 1e-3):
        sizes = [inputs, hidden, hidden, outputs]
        self.layers = [
            [rng.standard_normal((a, b)) * np.sqrt(2 / a), np.zeros(b)] for a, b in itertools.pairwise(sizes)
        ]
        self.moments = [[np.zeros_like(p), np.zeros_like(p)] for layer in self.layers for p in layer]
        self.rate, self.steps = rate, 0

    def outputs(self, x: np.ndarray) -> list[np.ndarray]:
        """(n, inputs) → the values of every layer; the last is (n, outputs)."""
        values = [x]
        for i, (w, b) in enumerate(self.layers):
            x = x @ w + b
            x = np.maximum(x, 0) if i + 1 < len(self.layers) else x
            values.append(x)
        return values

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return self.outputs(x)[-1]

    def fit(self, x: np.ndarray, chosen: np.ndarray, target: np.ndarray) -> None:
        """One step towards `target` (n,) of the outputs `chosen` (n,)."""
        values = self.outputs(x)
        gradient = np.zeros_like(values[-1])
        rows = np.arange(len(x))
        gradient[rows, chosen] = np.clip(values[-1][rows, chosen] - target, -1, 1) / len(x)
        gradients = []
        for i in reversed(range(len(self.layers))):
            gradients = [values[i].T @ gradient, gradient.sum(axis=0), *gradients]
            gradient = (gradient @ self.layers[i][0].T) * (values[i] > 0)
        self.steps += 1
        parameters = [p for layer in self.layers for p in layer]
        for p, g, (m, v) in zip(parameters, gradients, self.moments, strict=True):
            m += 0.1 * (g - m)
            v += 0.001 * (g * g - v)
            p -= self.rate * (m / (1 - 0.9**self.steps)) / (np.sqrt(v / (1 - 0.999**self.steps)) + 1e-8)

    def copy_from(self, other: Network) -> None:
        self.layers = [[p.copy() for p in layer] for layer in other.layers]


class ReplayBuffer:
    """The last transitions; `add` takes one row, with the arguments of Stable-Baselines3's buffer."""

    def __init__(self, capacity: int, inputs: int) -> None:
        self.before, self.after = (np.zeros((capacity, inputs), dtype=np.float32) for _ in range(2))
        self.action = np.zeros(capacity, dtype=np.int64)
        self.reward, self.done = np.zeros(capacity), np.zeros(capacity, dtype=np.bool_)
        self.added = 0

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: list[dict[str, Any]]) -> None:
        row = self.added % len(self.action)
        self.before[row], self.after[row], self.action[row] = obs[0], next_obs[0], action[0, 0]
        self.reward[row], self.done[row] = reward[0], done[0]
        self.added += 1

    def sample(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        rows = rng.integers(min(self.added, len(self.action)), size=n)
        return self.before[rows], self.action[rows], self.reward[rows], self.after[rows], self.done[rows]


def store(buffer: Any, space: spaces.Dict, told: list[Any]) -> None:
    """Add transitions of info["crm-experience"] to a buffer, one by one: the real one, and the counterfactual ones."""
    for before, action, reward, after, done in told:
        rows = (spaces.flatten(space, one)[None].astype(np.float32) for one in (before, after))
        buffer.add(*rows, np.array([[action]]), np.array([reward]), np.array([done]), [{}])


def one_hot(env: ProductEnv, here: Situations) -> np.ndarray:
    """The flattened observations (n, inputs) of situations."""
    observed = {"memory": here.memory, "state": here.state, "to_go": np.full(len(here), here.to_go)}
    parts = [np.eye(part.n, dtype=np.float32)[observed[name]] for name, part in env.observation_space.spaces.items()]
    return np.concatenate(parts, axis=1)


def train(product: stl.Product, episodes: int, counterfactuals: int, seed: int) -> stl.Policy:
    """The greedy policy of a network trained for so many episodes, with so many counterfactual transitions a step."""
    rng = np.random.default_rng(seed)
    env = stl.to_gymnasium(product, counterfactuals=max(counterfactuals, 1))
    space = env.observation_space
    inputs, actions = spaces.flatdim(space), product.model.n_actions
    network, target = Network(inputs, actions, rng), Network(inputs, actions, rng)
    buffer = ReplayBuffer(CAPACITY, inputs)
    for episode in range(episodes):
        explore = max(0.05, 1 - episode / (0.6 * episodes))
        observation, _ = env.reset(seed=seed if not episode else None)
        over = False
        while not over:
            values = network(spaces.flatten(space, observation)[None])[0]
            greedy = int(np.where(env.action_masks(), values, -np.inf).argmax())
            action = int(rng.choice(np.flatnonzero(env.action_masks()))) if rng.random() < explore else greedy
            observation, _, over, _, info = env.step(action)
            store(buffer, space, info["crm-experience"][: 1 + counterfactuals])
            for _ in range(UPDATES if buffer.added > BATCH else 0):
                before, taken, reward, after, done = buffer.sample(BATCH, rng)
                ahead = np.clip(target(after).max(axis=1), 0, 1)  # values are probabilities
                network.fit(before, taken, reward + DISCOUNT * np.where(done, 0, ahead))
                if network.steps % RENEW == 0:
                    target.copy_from(network)

    def act(here: Situations) -> np.ndarray:
        return np.where(here.available, network(one_hot(env, here)), -np.inf).argmax(axis=1)

    return stl.Policy.from_function(product, act, batched=True)


def train_sb3(product: stl.Product, episodes: int, counterfactuals: int, seed: int) -> stl.Policy:
    """The same with Stable-Baselines3's DQN, whose rollouts store through `_store_transition`."""
    import torch
    from gymnasium.wrappers import FlattenObservation
    from stable_baselines3 import DQN

    torch.set_num_threads(1)  # so small a network takes several times as long on more
    env = stl.to_gymnasium(product, counterfactuals=max(counterfactuals, 1))
    space = env.observation_space

    class Counterfactual(DQN):
        def _store_transition(self, buffer: Any, action: Any, obs: Any, reward: Any, done: Any, infos: Any) -> None:
            super()._store_transition(buffer, action, obs, reward, done, infos)
            if counterfactuals:  # the real one, the first of the list, is stored above
                store(buffer, space, infos[0]["crm-experience"][1:])

    learner = Counterfactual(
        "MlpPolicy", FlattenObservation(env), gamma=DISCOUNT, batch_size=BATCH, gradient_steps=UPDATES, train_freq=1,
        learning_starts=BATCH, target_update_interval=RENEW, exploration_fraction=0.6, buffer_size=CAPACITY, seed=seed,
        learning_rate=1e-3,
    )  # fmt: skip
    learner.learn(episodes * product.horizon)

    def act(here: Situations) -> np.ndarray:
        return np.asarray(learner.predict(one_hot(env, here), deterministic=True)[0])

    return stl.Policy.from_function(product, act, batched=True)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="DQN with and without counterfactual transitions, judged exactly.")
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--counterfactuals", type=int, default=16)
    parser.add_argument("--sb3", action="store_true", help="with Stable-Baselines3's DQN")
    given = parser.parse_args(arguments)
    product = stl.build_product(stl.load_model(FLOOR), stl.parse(TASK))
    print(f"optimum  {stl.check(product).probability:.3f}")
    learn = train_sb3 if given.sb3 else train
    for k in (0, given.counterfactuals):
        found = [stl.check(product, learn(product, given.episodes, k, seed)).probability for seed in range(given.seeds)]
        shown = " ".join(f"{p:.3f}" for p in found)
        print(f"{k:2} counterfactual transitions a step: {shown}  median {np.median(found):.3f}", flush=True)


if __name__ == "__main__":
    main()
