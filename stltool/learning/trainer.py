"""The training loop: episodes, with evaluations of the learner's policy at intervals.

Between two episodes, the state of a run consists of `Progress`, the counts, the arrays that the learner keeps, and two
generators: the content of a checkpoint. Evaluations do not use exploratory traces: they judge the policy table.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.choices import Form
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.gap import Certifier, due
from stltool.learning.learner import Learner
from stltool.learning.problem import Problem
from stltool.learning.settings import Budget
from stltool.learning.side_by_side import MOST, play
from stltool.models.environment import Environment

_TOGETHER = 32  # episodes between two looks at the clock and at interrupts

Status: TypeAlias = Literal["complete", "within the gap", "gap certified", "out of steps", "nothing to learn"]


@dataclass(frozen=True)
class Point:
    """One evaluation: the policy's exact probability after a number of episodes and environment steps.

    The probability is None if the model is not known. `time` is when it was evaluated, in seconds since 1970; runs that
    differ only in it are equal. `gap`: the bound on the distance to the optimum that the transitions so far prove, if
    asked for (`until_gap`).
    """

    episode: int
    steps: int
    probability: float | None
    time: float = field(default=0.0, compare=False)
    gap: float | None = None


@dataclass
class Progress:
    """The progress of a run. `status` states how it ended; None while it can continue."""

    episode: int = 0
    steps: int = 0
    history: list[Point] = field(default_factory=list)
    status: Status | None = None


@dataclass(frozen=True, eq=False)
class Trainer:
    """A run of episodes of at most `length` steps.

    state      the state of the learner; None if there is nothing to learn
    evaluate   the exact probability of a policy table; None if it cannot be known, that is, unless `knows`
    enough     whether that probability ends the run
    certifier  with `until_gap`: what the transitions prove about the distance to the optimum
    The learner never sees more than the states that `environment` reports.
    """

    problem: Problem
    environment: Environment
    learner: Learner[Any]
    state: Any
    budget: Budget
    rng: np.random.Generator
    counts: Counts
    length: int
    knows: bool
    evaluate: Callable[[NDArray[Any] | Form], float | None]
    enough: Callable[[float], bool]
    certifier: Certifier | None = None

    def run(
        self,
        progress: Progress,
        *,
        shown: Callable[[int, int, int, float | None], None] | None = None,
        between: Callable[[Progress], None] | None = None,
    ) -> None:
        """Continue to the end of the budget. After every episode, or every batch of them side by side, shown(episode,
        episodes, steps, probability) and between(progress) are called."""
        budget, learner, state = self.budget, self.learner, self.state
        while progress.status is None and progress.episode < budget.episodes:
            played = self._play(progress, 1 if shown is not None else _TOGETHER)
            before, progress.episode = progress.episode, progress.episode + sum(episode.played for episode in played)
            progress.steps += sum(episode.t for episode in played)
            if self._out_of_steps(progress):
                progress.status = "out of steps"
            last = progress.status is not None or progress.episode == budget.episodes
            now = last or progress.episode // budget.evaluate_every > before // budget.evaluate_every
            certifier, gap = self.certifier, None
            if certifier is not None and (now or any(map(due, range(before + 1, progress.episode + 1)))):
                now, gap = True, certifier(lambda: learner.policy(state))
            if now:
                value = self.evaluate(learner.policy(state) if gap is None else gap.policy.form)
                bound = gap.upper if gap is not None else None
                progress.history.append(Point(progress.episode, progress.steps, value, time.time(), bound))
                if certifier is not None and bound is not None and bound <= certifier.until:
                    progress.status = "gap certified"
                elif value is not None and self.enough(value):
                    progress.status = "within the gap"
            if shown is not None:
                value = progress.history[-1].probability if progress.history else None
                shown(progress.episode, budget.episodes, progress.steps, value)
            if between is not None:
                between(progress)

    def _play(self, progress: Progress, most: int) -> list[Episode]:
        """The next episode, which may stand for at most so many, until one is evaluated; where the environment takes
        many runs at once, and the learner can, so many of them."""
        runs, number, every = self.environment.runs, progress.episode, self.budget.evaluate_every
        if runs is None or not self.learner.side_by_side:
            unevaluated = 1 if self.certifier is not None else every - number % every
            together = self._affordable(progress, min(most, unevaluated))
            episode = self._begin(self.environment, number, together=together)
            self.learner.episode(self.state, episode)
            return [episode]
        n = self._affordable(progress, min(runs.batch, MOST))
        batch = range(number, number + n)
        begin = partial(self._begin, batch=batch if n > 1 else None)
        return play(runs, begin, partial(self.learner.episode, self.state), batch)

    def _affordable(self, progress: Progress, most: int) -> int:
        """How many of the next `most` episodes may be played, whatever number of steps each takes; at least one."""
        n = min(most, self.budget.episodes - progress.episode)
        if self.budget.most_steps is not None:
            n = min(n, (self.budget.most_steps - progress.steps) // max(self.length, 1))
        return max(1, n)

    def _begin(self, environment: Environment, number: int, batch: range | None = None, together: int = 1) -> Episode:
        return Episode(self.problem, environment, self.counts, self.rng, number, self.length, batch, together)

    def ends(self, progress: Progress) -> bool:
        """Whether that was the last episode."""
        return progress.status is not None or progress.episode >= self.budget.episodes

    def _out_of_steps(self, progress: Progress) -> bool:
        """Whether another episode could exceed the allowed number of steps."""
        most = self.budget.most_steps
        return most is not None and progress.steps + self.length > most
