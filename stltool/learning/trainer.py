"""The one training loop: episodes, the learner's updates, evaluation of its policy at intervals.

Between two episodes everything that a run is made of is in `Progress`, the learner's and the counts' arrays, and two
generators: what a checkpoint holds. Evaluations never follow exploring traces: they judge the policy table.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.learning.counts import Counts
from stltool.learning.learner import Learner, Path
from stltool.learning.problem import Problem
from stltool.learning.schedule import epsilon
from stltool.learning.settings import Settings
from stltool.models.environment import Environment, require_state


@dataclass(frozen=True)
class Point:
    """One evaluation: after so many episodes and environment steps, the policy's exact probability.

    None where the model is not known. `time` is when it was evaluated, in seconds since 1970; runs that differ in it
    alone are equal.
    """

    episode: int
    steps: int
    probability: float | None
    time: float = field(default=0.0, compare=False)


@dataclass
class Progress:
    """How far a run is."""

    episode: int = 0
    steps: int = 0
    history: list[Point] = field(default_factory=list)
    finished: bool = False


@dataclass(frozen=True, eq=False)
class Trainer:
    """A run of episodes of at most `episode_length` steps.

    to_the_end   as published: s₀ is not read, and episodes go on after the verdict. Else they end when the task is
                 satisfied; when it is violated, they end, or explore to the horizon (`Learner.explores_on`)
    evaluate     the exact probability of a policy table; None where it cannot be known
    enough       whether that probability ends the run
    The learner never sees more than the states that `environment` reports.
    """

    problem: Problem
    environment: Environment
    learner: Learner
    settings: Settings
    rng: np.random.Generator
    counts: Counts
    episode_length: int
    to_the_end: bool
    evaluate: Callable[[NDArray[Any]], float | None]
    enough: Callable[[float], bool]

    def run(
        self,
        progress: Progress,
        *,
        shown: Callable[[int, int, int, float | None], None] | None = None,
        between: Callable[[Progress], None] | None = None,
    ) -> None:
        """Go on to `settings.episodes`. shown(episode, episodes, steps, probability) and between(progress) are called
        after every episode."""
        settings, choice_start = self.settings, np.cumsum(self.problem.n_choices) - self.problem.n_choices
        while not self.ends(progress):
            path = self._episode(progress.episode)
            self.learner.end_episode(path)
            self.counts.add(choice_start[path.states[:-1]] + path.actions, path.states[1:].astype(np.int64))
            progress.episode += 1
            progress.steps += len(path.actions)
            progress.finished = self._over(progress)
            if progress.episode % settings.evaluate_every == 0 or self.ends(progress):
                value = self.evaluate(self.learner.policy_table())
                progress.history.append(Point(progress.episode, progress.steps, value, time.time()))
                progress.finished |= value is not None and self.enough(value)
            if shown is not None:
                value = progress.history[-1].probability if progress.history else None
                shown(progress.episode, settings.episodes, progress.steps, value)
            if between is not None:
                between(progress)

    def ends(self, progress: Progress) -> bool:
        """Whether that was the last episode."""
        return progress.finished or progress.episode >= self.settings.episodes

    def _over(self, progress: Progress) -> bool:
        """Whether another episode could take more steps than there may be."""
        most = self.settings.most_steps
        return most is not None and progress.steps + self.episode_length > most

    def _episode(self, number: int) -> Path:
        explore = self.rng.random((self.episode_length, 2))
        self.learner.begin_episode(epsilon(self.settings, number), self.episode_length)
        if self.learner.compiled and self.environment.tables is not None:
            return self.learner.play(self.environment, explore)
        return self._step_by_step(explore)

    def _step_by_step(self, explore: NDArray[np.float64]) -> Path:
        automaton, letter, learner = self.problem.automaton, self.problem.letter, self.learner
        s = self._state(self.environment.reset(), "reset()")
        q = automaton.initial if self.to_the_end else int(automaton.delta[letter[s], automaton.initial])
        states, actions, failed = [s], [], False
        for t, (u, chance) in enumerate(explore.tolist()):
            if not self.to_the_end and not failed:
                verdict = automaton.verdicts(t)[q]
                failed = verdict == FALSE
                if verdict == TRUE or (failed and not learner.explores_on):
                    break
            if failed:
                u = -1.0
            a = learner.act(t, s, q, u, chance)
            s2 = self._state(self.environment.step(a), f"step({a}) in state {s}")
            q2 = int(automaton.delta[letter[s2], q])
            learner.observe(t, s, q, a, s2, q2)
            states.append(s2)
            actions.append(a)
            s, q = s2, q2
        return Path(np.array(states, dtype=np.int32), np.array(actions, dtype=np.int32))

    def _state(self, answer: object, call: str) -> int:
        return require_state(answer, call, self.problem.n_states, "the model")
