"""Two methods of the literature on the same product and counts, to be compared with ours (bench/goals.py).

PosteriorSampling   one model an episode, drawn from the counts; half a pseudo-count is on a paradise, so that an
                    untried choice leads there [Strens00]
Ucbvi               optimism in the values: Q = min(1, P̂V + √(2 Var/n) + 7/(3n)), an empirical Bernstein bonus, without
                    the logarithm that its theory needs, which would make it slower still

Both act otherwise than the model-based learner, until the task is violated, and are judged by its cautious plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.learning import Counts, Episode, Problem
from stltool.learning.aftermath import aftermath
from stltool.learning.learner import Learner
from stltool.learning.model_based import Planner

_LEAST = 1e-300


@dataclass(frozen=True, kw_only=True)
class PosteriorSampling(stl.ModelBased):
    """Posterior sampling."""

    name: ClassVar[str] = "posterior sampling"

    def episode(self, state: Planner, episode: Episode) -> None:
        counts, chances = state.counts, episode.rng.random(episode.length).tolist()
        visits = counts.visits
        drawn = np.maximum(episode.rng.standard_gamma(counts.seen.astype(np.float64)), _LEAST)
        paradise = episode.rng.standard_gamma(0.5, size=len(visits))
        share = paradise / (paradise + np.bincount(counts.choice, drawn, len(visits)))
        learned, plan = state.learned(drawn, share), None
        if episode.verdict is None:
            state.starts[episode.s] += 1
        while not episode.over and episode.verdict is not True:
            t, s, q = episode.t, episode.s, episode.q
            first, after = state.problem.first_choice[s : s + 2].tolist()
            if episode.verdict is False:
                a = aftermath(episode, visits[first:after], chances[t])
                if a < 0:
                    break
            else:
                if plan is None or plan(t, s, q) < 0:
                    plan = state.plan_from(learned, t, s, q)
                a = plan(t, s, q)
            episode.step(a)
            visits[first + a] += 1


@dataclass(frozen=True, kw_only=True)
class Ucbvi(stl.ModelBased):
    """UCBVI with Bernstein bonuses."""

    name: ClassVar[str] = "UCBVI"

    def episode(self, state: Planner, episode: Episode) -> None:
        chances = episode.rng.random(episode.length).tolist()
        visits = state.counts.visits
        if episode.verdict is None:
            state.starts[episode.s] += 1
            plan = optimistic(state.problem, state.counts)
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            first, after = state.problem.first_choice[s : s + 2].tolist()
            if episode.verdict is False:
                a = aftermath(episode, visits[first:after], chances[t])
                if a < 0:
                    break
            else:
                a = int(plan[t, s, episode.q])
            episode.step(a)
            visits[first + a] += 1


def optimistic(problem: Problem, counts: Counts) -> NDArray[np.int16]:
    """(h, S, Q) the choices of UCBVI's plan; of equals the first."""
    automaton, visits = problem.automaton, counts.visits
    n = np.maximum(visits, 1)[:, None]
    shape = (counts.n_choices, counts.n_states)
    frequency = sp.csr_array((counts.seen / visits[counts.choice], (counts.choice, counts.target)), shape=shape)
    after, start = automaton.delta[problem.letter], problem.first_choice[:-1]
    values = np.tile(automaton.verdicts(automaton.horizon) == TRUE, (problem.n_states, 1)).astype(np.float64)
    plan = np.zeros(problem.shape, dtype=np.int16)
    owner = np.repeat(np.arange(problem.n_states), problem.n_choices)
    for t in range(automaton.horizon - 1, -1, -1):
        ahead = np.take_along_axis(values, after, axis=1)
        mean, square = frequency @ ahead, frequency @ ahead**2
        bonus = np.sqrt(2 * np.maximum(square - mean**2, 0) / n) + 7 / (3 * n)
        Q = np.where(visits[:, None] > 0, np.minimum(mean + bonus, 1.0), 1.0)
        best = np.maximum.reduceat(Q, start, axis=0)
        number = np.where(best[owner] == Q, np.arange(len(owner))[:, None], len(owner))
        plan[t] = np.minimum.reduceat(number, start, axis=0) - start[:, None]
        verdicts = automaton.verdicts(t)
        values = np.where(verdicts == UNDECIDED, best, verdicts == TRUE)
    return plan


METHODS: dict[str, Learner[Any]] = {
    "model-based": stl.ModelBased(), "cfer": stl.Cfer(), "posterior sampling": PosteriorSampling(), "UCBVI": Ucbvi(),
}  # fmt: skip
