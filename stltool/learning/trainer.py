"""The one training loop: episodes of exploration, the learner's updates, exact evaluation at intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.learning.problem import Problem
from stltool.learning.schedule import epsilon
from stltool.learning.settings import Settings
from stltool.models.environment import Environment


class Learner(Protocol):
    """What a method is: values to act on, and what it does with a transition and with an episode's end."""

    def row(self, t: int, s: int, q: int) -> NDArray[np.float64]: ...
    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None: ...
    def end_episode(self) -> None: ...
    def policy_table(self) -> NDArray[Any]: ...


@dataclass(frozen=True)
class Point:
    """One evaluation: after so many episodes and environment steps, the greedy policy's exact probability."""

    episode: int
    steps: int
    probability: float


def train(
    problem: Problem,
    environment: Environment,
    learner: Learner,
    settings: Settings,
    rng: np.random.Generator,
    *,
    episode_length: int,
    read_first_state: bool,
    evaluate: Callable[[NDArray[Any]], float],
    progress: Callable[[int, int, float], None] | None = None,
) -> list[Point]:
    """Run `settings.episodes` episodes of `episode_length` steps; the history of exact evaluations.

    The learner never sees more than the states that `environment` reports. `evaluate` judges a policy table.
    """
    automaton, letter = problem.automaton, problem.letter
    delta, n_choices = automaton.delta, problem.n_choices
    history = []
    for episode in range(settings.episodes):
        explore = epsilon(settings, episode)
        random = rng.random((episode_length, 2)).tolist()
        s = environment.reset()
        q = int(delta[letter[s], automaton.initial]) if read_first_state else automaton.initial
        for t in range(episode_length):
            if random[t][0] < explore:
                a = int(random[t][1] * n_choices[s])
            else:
                a = _best(learner.row(t, s, q), random[t][1])
            s2 = environment.step(a)
            q2 = int(delta[letter[s2], q])
            learner.observe(t, s, q, a, s2, q2)
            s, q = s2, q2
        learner.end_episode()
        done = episode + 1
        if done % settings.evaluate_every == 0 or done == settings.episodes:
            value = evaluate(learner.policy_table())
            history.append(Point(done, done * episode_length, value))
        if progress is not None:
            progress(done, settings.episodes, history[-1].probability if history else 0.0)
    return history


def _best(values: NDArray[np.float64], chance: float) -> int:
    """The best choice, ties broken by `chance` in [0, 1)."""
    ties = np.flatnonzero(values == values.max())
    return int(ties[int(chance * len(ties))])
