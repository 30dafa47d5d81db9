"""Episodes on small products, for the model-based learner: in a simulated model, each is one call of a kernel."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.tuples import Rules, Walked, room_of, route_of, with_entries
from stltool.learning.aftermath import ENOUGH
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.optimism import level, paradise
from stltool.learning.problem import Problem
from stltool.models.environment import Environment

_LEAST = 1e-300
_ONE_BY_ONE = (np.random.PCG64, np.random.PCG64DXSM)  # a random number is one step of these, and can be taken back


class Explorer:
    """The transitions counted so far, in arrays that a kernel can plan on and add to, and its plan.

    total   how many transitions it knows
    """

    def __init__(self, problem: Problem, counts: Counts) -> None:
        automaton = problem.automaton
        h, S, Q = problem.shape
        self._problem, self._counts, self.total = problem, counts, counts.total
        at = np.searchsorted(automaton.verdict_starts, np.arange(h + 1), side="right") - 1
        # copies, as a kernel is compiled for arrays that can be written to, or for others
        self.rules = Rules(
            first_choice=np.array(problem.first_choice),
            letter=np.array(problem.letter),
            delta=np.array(automaton.delta),
            verdicts=np.array(automaton.verdict_rows[at]),
            worth=np.array([paradise(t, h) for t in range(h)]),
            occurring=np.unique(problem.letter).astype(np.int64),
        )
        n, letters = counts.n_choices, automaton.n_letters
        known = np.zeros(S, dtype=np.bool_)
        known[counts.target] = True
        visits = counts.visits
        known[np.repeat(np.arange(S), problem.n_choices)[visits > 0]] = True
        start = np.concatenate([[0], np.cumsum(np.bincount(counts.choice, minlength=n))])
        self.walked = Walked(
            start, visits, counts.target.astype(np.int32), counts.seen.copy(), np.zeros(len(counts.seen)), known
        )
        self.route = route_of(h, S, Q, n)
        self.room = room_of(h, S, Q, letters, n)

    def episode(self, episode: Episode, optimism: float) -> None:
        """Play one: a belief is drawn, and acted on."""
        from stltool.kernels import exploring

        rng, n = episode.rng, episode.length
        self._make_room(n)
        exploring.believe(self.walked, rng.standard_normal(int(self.walked.start[-1])))
        self.walked.known[episode.s] = True
        chances, weights = rng.random(n + 1), rng.standard_exponential(n)
        hope = math.log(max(level(optimism, float(chances[n])), _LEAST))
        environment = episode.environment
        if environment.tables is not None and _repeatable(environment):
            self._whole(episode, hope, chances, weights)
        else:
            self._step_by_step(episode, hope, chances, weights)
        self.total = self._counts.total

    def _whole(self, episode: Episode, hope: float, chances: NDArray[np.float64], weights: NDArray[np.float64]) -> None:
        """An episode in a simulated model at once: bit for bit the same as step by step."""
        from stltool.kernels import exploring

        n, generator = episode.length, episode.environment.generator
        assert generator is not None
        states, actions = np.empty(n + 1, dtype=np.int32), np.empty(n, dtype=np.int32)
        states[0] = episode.s
        taken = exploring.episode(
            episode.environment.tables, self.rules, self.walked, self.route, self.room, hope, ENOUGH, episode.q,
            generator.random(n), chances, weights, states, actions,
        )  # fmt: skip
        if taken < n:
            generator.bit_generator.advance(taken - n)  # type: ignore[attr-defined]
        episode.record(states[: taken + 1], actions[:taken])

    def _step_by_step(
        self, episode: Episode, hope: float, chances: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> None:
        """The same with only reset and step."""
        from stltool.kernels import exploring

        rules, walked, route, room = self.rules, self.walked, self.route, self.room
        first_choice, stuck = self._problem.lists[2], False
        if episode.verdict is None and not episode.over:
            exploring.plan(rules, walked, route, room, hope, 0, episode.s, episode.q)
        while not episode.over and episode.verdict is not True:
            t, s, chance = episode.t, episode.s, float(chances[episode.t])
            if episode.verdict is False:
                a = exploring.aftermath(rules, walked, s, stuck, ENOUGH, chance)
                if a < 0:
                    break
            else:
                a = exploring.choose(rules, walked, route, room, hope, t, s, episode.q, chance)
            episode.step(a)
            exploring.count(walked, route, first_choice[s] + a, episode.s, float(weights[t]))
            stuck = episode.s == s

    def _make_room(self, n: int) -> None:
        """For n more entries."""
        used, had = int(self.walked.start[-1]), len(self.walked.target)
        if used + n <= had and len(self.room.slot) == had:
            return
        size = 2 * (used + n)
        walked, rest = self.walked, (0, size - had)
        self.walked = walked._replace(
            target=np.pad(walked.target, rest), seen=np.pad(walked.seen, rest), weight=np.pad(walked.weight, rest)
        )
        self.room = with_entries(self.room, size)


def _repeatable(environment: Environment) -> bool:
    generator = environment.generator
    return generator is not None and isinstance(generator.bit_generator, _ONE_BY_ONE)
