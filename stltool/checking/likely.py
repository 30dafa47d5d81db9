"""The most probable runs of a policy that violate, or satisfy, a task: k best paths through the unfolded product.

A run ends where its verdict falls, so no run is a prefix of another, runs are disjoint events, and their probabilities

    P(run) = ι(s₀) Π_t π_t(c_t|s_t,q_t) p(s_{t+1}|c_t)

add up to the probability of the verdict. One backward pass over the layers (max-product) gives every node's best
completion

    B_t(s,q) = 0 / −∞                                               if the verdict is the one asked for / the other
             = max_{c,s'} log(π_t(c|s,q) p(s'|c)) + B_{t+1}(s', δ(L(s'), q))     otherwise

and with it what any edge loses against the best one of its source: ≥ 0, and 0 for the best. A run loses what its edges
lose. Best first: the heap holds the deviations from the runs found so far, each told by its own best completion
([Eppstein98]: sidetracks; an acyclic graph and a perfect heuristic spare his heaps of heaps). Order and probabilities
hold up to rounding, some 1e−15 a step.

Why not a library's routine: scipy's `yen` and networkx's `shortest_simple_paths` search again for every deviation, want
the graph whole, without parallel edges (two actions to one successor) or edges of length 0 (p = 1), and `yen` the
number of paths beforehand, which a mass does not tell. 1000 violating runs of patrolling on the 10 × 10 floor, graph
apart: T = τ = 10 in 0.04 s, as yen, networkx 4.4 s; T = τ = 15 in 0.06 s, yen 0.9 s; under a uniform mixture 0.3 s,
yen 7 s.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from stltool.arguments import flag, function, real, whole
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.backward import Floats, Progress
from stltool.checking.check import or_optimal
from stltool.checking.sampling import Run
from stltool.checking.unfold import Unfolding
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError, named
from stltool.policy import Policy, require_door
from stltool.product import Product

MOST_RUNS = 10_000
_SHOWN = 10  # runs in a notebook
_ROUNDING = 1e-12  # a set that lacks less than this share of what it should cover, covers it

_Trail: TypeAlias = "tuple[_Trail | None, int, int, float, float]"
"""A run backwards: what came before, choice (−1 at the start), position in its layer, probability and its log."""


@dataclass(frozen=True, repr=False)
class LikelyRun(Run):
    """A run with its probability under the policy; `log_probability` stays finite where that underflows.

    `certain` is the first step from which the policy cannot end otherwise; the verdict falls there or later.
    In a mixture the actions are part of the run: the same states by other actions are another run.
    """

    probability: float
    log_probability: float
    certain: int

    @property
    def step(self) -> int:
        """The step at which the verdict fell."""
        return len(self.actions)


@dataclass(frozen=True, eq=False, repr=False)
class LikelyRuns(Displayed):
    """The most probable runs of one verdict, in order of falling probability.

    product, policy   where the runs live; with a policy that remembers otherwise than the task's automaton, their join
    satisfied         the verdict asked for
    runs              equally probable ones: the shorter first, then by states
    probability       of the verdict, all runs together; exactly 0 where no run of positive probability has it
    mass, covered     what `runs` have together, and its share of `probability` (1 where there is nothing to cover)
    exhausted         whether `runs` are all there are
    status            "complete", or what stopped the search, and the remedy
    """

    product: Product
    policy: Policy
    satisfied: bool
    runs: tuple[LikelyRun, ...]
    probability: float
    mass: float
    covered: float
    exhausted: bool
    status: str

    def _card(self) -> Card:
        verdict = "satisfying" if self.satisfied else "violating"
        rows = [
            (i, probability_text(run.probability), run.step, " ".join(map(self.product.model.state_name, run.states)))
            for i, run in enumerate(self.runs[:_SHOWN], start=1)
        ]
        best = probability_text(self.runs[0].probability) if self.runs else None
        share = math.floor(1e4 * self.covered) / 100  # 100 for all alone
        return Card(
            f"LikelyRuns: {counted(len(self.runs), f'{verdict} run')}, {share:g} % of "
            f"P = {probability_text(self.probability)}, {self.status}",
            [
                {"most probable": best, "all there are": "yes" if self.exhausted else "no"},
                {"task": f"{self.product.task_name} := {self.product.formula}", "policy": self.policy.kind},
            ],
            (("", "probability", "decided at step", "states"), rows),
            more=max(0, len(self.runs) - _SHOWN),
        )


def likely_runs(
    product: Product,
    policy: Policy | None = None,
    *,
    satisfied: bool = False,
    count: int = 10,
    mass: float | None = None,
    most: int = MOST_RUNS,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> LikelyRuns:
    """The `count` most probable runs under `policy` (default: the optimal one) that violate, or satisfy, the task.

    With `mass` in (0, 1] instead the smallest set of runs that has at least this share of the verdict's probability, or
    the first `most` of it. Raises PolicyError where the policy says nothing about a place it reaches or belongs to
    another task, SettingsError for numbers out of range, SizeError before taking memory that is not there.
    """
    require_door("likely_runs", product, policy)
    flag(satisfied, "likely_runs' satisfied")
    count, most = whole(count, "count", least=1), whole(most, "most", least=1)
    function(progress, "likely_runs' progress")
    if mass is not None:
        mass = float(real(mass, "mass", "0.9"))
        if not 0 < mass <= 1:
            raise SettingsError(
                f"{named('mass')} is {mass}; it is a share of the probability, above 0 and at most 1, such as 0.9"
            )
    product, policy = or_optimal("likely_runs", product, policy, memory_limit).on(product)
    unfolding = Unfolding(product, policy, memory_limit, progress)
    wanted = TRUE if satisfied else FALSE
    probability = math.fsum(unfolding.start * unfolding.probabilities(wanted)[0])
    best, others = _completions(unfolding, wanted), _completions(unfolding, FALSE if satisfied else TRUE)
    limit = count if mass is None else most
    goal = math.inf if mass is None else mass * probability * (1 - _ROUNDING)
    below = probability == 0 and bool(np.isfinite(best[0]).any())  # there are runs, but their sum underflows
    if below and mass is not None:
        raise SettingsError(
            f"{named('mass')} {mass:g}: the runs have less than 1e-300 together, too little to tell shares; ask for a "
            "count of runs"
        )
    # Of all sets of n runs the n most probable have the largest mass. So the first n that reach the goal are a
    # smallest set: if n − 1 runs reached it, the n − 1 most probable would.
    runs: list[LikelyRun] = []
    covered, exhausted = 0.0, False
    search = _by_probability(unfolding, best, limit)
    while len(runs) < limit and covered < goal:
        trail = next(search, None)
        if trail is None:
            exhausted = True
            break
        runs.append(_told(unfolding, trail, others, satisfied))
        covered += runs[-1].probability
        if progress is not None and mass is not None:
            progress(len(runs), limit)
    runs.sort(key=lambda run: (-run.log_probability, run.step, run.states, run.actions))
    exhausted = exhausted or next(search, None) is None
    total = math.fsum(run.probability for run in runs)
    share = 1.0 if exhausted else 0.0 if below else min(total / probability, 1.0)
    status = "complete"
    if mass is not None and covered < goal and not exhausted:
        status = f"covered {share:.3g} of the asked {mass:g} with {len(runs)} runs; raise most to go on"
    return LikelyRuns(product, policy, satisfied, tuple(runs), probability, total, share, exhausted, status)


def _completions(unfolding: Unfolding, wanted: int) -> list[Floats]:
    """B of every node, layer by layer."""
    log_p = np.log(unfolding.product.model.probability)
    best: list[Floats] = []
    for t in range(len(unfolding.layers) - 1, -1, -1):
        here = np.where(unfolding.verdicts(t) == wanted, 0.0, -np.inf)
        nodes = unfolding.undecided(t)
        if len(nodes):
            edges = unfolding.edges(t)
            gain = np.log(edges.weight) + log_p[edges.entry] + best[-1][edges.child]
            here[nodes] = np.maximum.reduceat(gain, edges.start)
        best.append(here)
    return best[::-1]


def _by_probability(unfolding: Unfolding, best: list[Floats], limit: int) -> Iterator[_Trail]:
    """Runs by falling probability; `limit` is the most that will be asked for (and one more, to see an end)."""
    model, automaton = unfolding.product.model, unfolding.product.automaton

    def moves(t: int, i: int) -> list[tuple[float, int, int, float, float]]:
        """(loss, choice, position in layer t + 1, probability, its log) of node i's edges that lead on, best first."""
        if t < 0:  # before the first state, which is drawn by no choice
            factor, logs = unfolding.start, np.log(unfolding.start)
            choice, child = np.full(len(factor), -1), np.arange(len(factor))
        elif automaton.verdicts(t)[unfolding.layers[t][i] % automaton.n_states] != UNDECIDED:
            return []
        else:
            edges = unfolding.edges(t, np.array([i]))
            factor = edges.weight * model.probability[edges.entry]
            choice, child = edges.choice, edges.child
            logs = np.log(edges.weight) + np.log(model.probability[edges.entry])
        gain = logs + best[t + 1][child]
        order = [k for k in np.argsort(-gain, kind="stable").tolist() if gain[k] > -np.inf]
        told = list(zip(choice.tolist(), child.tolist(), factor.tolist(), logs.tolist(), strict=True))
        return [(float(gain[order[0]] - gain[k]), *told[k]) for k in order]

    known: dict[tuple[int, int], list[tuple[float, int, int, float, float]]] = {}
    tie = itertools.count()
    heap: list[tuple[float, int, _Trail | None, int, int]] = [(0.0, next(tie), None, -1, 0)]
    left = limit + 1
    while heap and left:
        loss, _, trail, t, i = heapq.heappop(heap)
        while True:
            if (t, i) not in known:
                known[t, i] = moves(t, i)
            options = known[t, i]
            if not options:
                break
            for extra, choice, child, factor, log in options[1:]:
                heapq.heappush(heap, (loss + extra, next(tie), (trail, choice, child, factor, log), t + 1, child))
            _, choice, i, factor, log = options[0]
            t += 1
            trail = (trail, choice, i, factor, log)
        if trail is not None:
            yield trail
        left -= 1
        if len(heap) > 2 * left + 1000:  # no more than `left` can still be asked for; a sorted list is a heap
            heap = heapq.nsmallest(left, heap)


def _told(unfolding: Unfolding, trail: _Trail | None, others: list[Floats], satisfied: bool) -> LikelyRun:
    model, automaton = unfolding.product.model, unfolding.product.automaton
    steps = []
    while trail is not None:
        trail, *step = trail
        steps.append(step)
    choices, positions, factors, logs = zip(*reversed(steps), strict=True)
    nodes = [int(unfolding.layers[t][i]) for t, i in enumerate(positions)]
    return LikelyRun(
        states=tuple(node // automaton.n_states for node in nodes),
        actions=tuple(model.action_names[model.choice_action[c]] for c in choices[1:]),
        memory=tuple(automaton.describe(node % automaton.n_states) for node in nodes),
        satisfied=satisfied,
        probability=math.prod(factors),
        log_probability=math.fsum(logs),
        certain=next(t for t, i in enumerate(positions) if others[t][i] == -np.inf),
    )
