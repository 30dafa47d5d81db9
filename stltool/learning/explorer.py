"""Episodes for the model-based learner on products that are not large, one after the other; in a simulated model, many
of them are one call of a kernel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.kernels.tuples import (
    Chart,
    Room,
    Route,
    Rules,
    Tables,
    Walked,
    chart_of,
    draws_of,
    room_of,
    route_of,
    with_children,
    with_entries,
)
from stltool.learning.aftermath import ENOUGH
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.optimism import level, paradise
from stltool.learning.problem import Problem

FIRST = 3  # above the kernel's own marks, which are negative
_LEAST = 1e-300


class Held(NamedTuple):
    """A plan that is held for later episodes: what a checkpoint needs of an explorer, beside the counts.

    choices  (h, S, Q) int32: of each situation of the plan, as FIRST + the choice; 0 elsewhere
    limit    (choices,) int64: as long as none was taken more often, the plan is held
    begins   (3,) int64: whether there is one, and the state and memory where it begins
    """

    choices: NDArray[np.int32]
    limit: NDArray[np.int64]
    begins: NDArray[np.int64]

    @classmethod
    def none(cls, shape: tuple[int, int, int], n_choices: int) -> Held:
        return cls(np.zeros(shape, dtype=np.int32), np.zeros(n_choices, dtype=np.int64), np.zeros(3, dtype=np.int64))


def patient(visits: NDArray[np.int64]) -> NDArray[np.int64]:
    """How often choices may be taken until a plan made after so many visits is given up."""
    from stltool.kernels.exploring import PATIENCE

    return visits + visits // PATIENCE


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
        n = counts.n_choices
        known = np.zeros(S, dtype=np.bool_)
        known[counts.target] = True
        visits = counts.visits
        known[np.repeat(np.arange(S), problem.n_choices)[visits > 0]] = True
        start = np.concatenate([[0], np.cumsum(np.bincount(counts.choice, minlength=n))])
        self.walked = Walked(
            start, visits, counts.target.astype(np.int32), counts.seen.copy(), np.zeros(len(counts.seen)), known
        )
        self.route = route_of(h, S, Q, n)
        self.chart = chart_of(h, S, Q, len(self.rules.occurring))
        self.room = room_of(h, S, Q, automaton.n_letters, n)

    def episode(self, episode: Episode, optimism: float, starts: NDArray[np.int64]) -> None:
        """Play one, or all that it stands for, each by the belief that is held, or else by a new one.

        starts (S,): how many episodes started there, undecided
        """
        environment = episode.environment
        if environment.tables is not None and environment.generator is not None:
            self._together(episode, environment.tables, environment.generator, optimism, starts)
        else:
            self._step_by_step(episode, optimism, starts)
        self.total = self._counts.total

    def _together(
        self, episode: Episode, tables: Tables, world: np.random.Generator, optimism: float, starts: NDArray[np.int64]
    ) -> None:
        """Episodes in a simulated model at once: bit for bit the same as step by step."""
        from stltool.kernels import exploring

        n, draws = episode.together, draws_of(len(self.walked.target), episode.length)
        verdict = UNDECIDED if episode.verdict is None else TRUE if episode.verdict else FALSE
        here = np.array([n, -1, episode.s, episode.q, verdict, 0, 0, self._problem.automaton.initial])
        choice, context = np.empty((2, n * episode.length), dtype=np.int64)
        target = np.empty(n * episode.length, dtype=np.int32)
        while missing := exploring.episodes(
            tables, *self._all, episode.rng, world, optimism, ENOUGH, draws, here, starts, choice, target, context
        ):
            if missing == 1:
                self._make_room(episode.length)
                draws = draws._replace(normal=np.empty(len(self.walked.target)))
            else:
                self.chart = with_children(self.chart)
        taken = int(here[6])
        episode.record_all(choice[:taken], target[:taken], context[:taken])

    def _step_by_step(self, episode: Episode, optimism: float, starts: NDArray[np.int64]) -> None:
        """One with only reset and step."""
        from stltool.kernels import exploring

        rng, n = episode.rng, episode.length
        self._make_room(n)
        self.walked.known[episode.s] = True
        chances, weights = rng.random(n + 1), rng.standard_exponential(n)
        rules, walked, route = self.rules, self.walked, self.route

        def draw() -> None:
            hope = level(optimism, float(chances[n]))
            normal = rng.standard_normal(int(walked.start[-1]))
            exploring.believe(walked, route, normal, math.log(max(hope, _LEAST)))

        first_choice, stuck = self._problem.lists[2], False
        if episode.verdict is None:
            starts[episode.s] += 1
            if exploring.begins(route, episode.s, episode.q):
                draw()
                while not exploring.plan(*self._all, 0, episode.s, episode.q):
                    self.chart = with_children(self.chart)
        while not episode.over and episode.verdict is not True:
            t, s, chance = episode.t, episode.s, float(chances[episode.t])
            if episode.verdict is False:
                a = exploring.aftermath(rules, walked, s, stuck, ENOUGH, chance)
                if a < 0:
                    break
            else:
                while (a := exploring.choose(*self._all, t, s, episode.q, chance)) < 0:
                    if a == exploring.NO_BELIEF:
                        draw()
                    else:
                        self.chart = with_children(self.chart)
            episode.step(a)
            exploring.count(walked, route, first_choice[s] + a, episode.s, float(weights[t]))
            stuck = episode.s == s

    def held(self) -> Held:
        """The plan for later episodes."""
        from stltool.kernels.exploring import HELD

        route, found = self.route, Held.none(self._problem.shape, len(self.route.limit))
        if route.belief[0] != HELD:
            return found
        t, s = np.nonzero(route.group >= 0)
        first, after = (route.first[route.group[t, s] + k] for k in (0, 1))
        n = after - first
        at = np.repeat(first - (np.cumsum(n) - n), n) + np.arange(n.sum())
        found.choices[np.repeat(t, n), np.repeat(s, n), route.memory[at]] = FIRST + route.choice[at]
        found.limit[:], found.begins[:] = route.limit, (1, *route.belief[2:])
        return found

    def hold(self, held: Held) -> None:
        """Go on with a plan, of an explorer that knew the same transitions."""
        from stltool.kernels.exploring import HELD

        route = self.route
        t, s, q = np.nonzero(held.choices)
        n = len(q)
        begin = np.flatnonzero(np.diff(t * held.choices.shape[1] + s, prepend=-1))
        route.group[t[begin], s[begin]] = np.arange(len(begin))
        route.first[: len(begin)], route.first[len(begin)] = begin, n
        route.memory[:n], route.choice[:n] = q, held.choices[t, s, q] - FIRST
        route.limit[:], route.belief[:] = held.limit, (HELD, 0, *held.begins[1:])
        route.counter[0] = 1  # nothing was tried in its time, or it would not be held

    @property
    def _all(self) -> tuple[Rules, Walked, Route, Chart, Room]:
        return self.rules, self.walked, self.route, self.chart, self.room

    def _make_room(self, n: int) -> None:
        """For n more entries."""
        used, had = int(self.walked.start[-1]), len(self.walked.target)
        if used + n <= had and len(self.chart.slot) == had:
            return
        size = 2 * (used + n)
        walked, rest = self.walked, (0, size - had)
        self.walked = walked._replace(
            target=np.pad(walked.target, rest), seen=np.pad(walked.seen, rest), weight=np.pad(walked.weight, rest)
        )
        self.chart, self.room = with_entries(self.chart, self.room, size)
