"""The most probable runs of a policy that violate, or satisfy, a task: the k best paths through the unfolded product.

A run ends where its verdict is decided, so no run is a prefix of another, runs are disjoint events, and their
probabilities

    P(run) = ι(s₀) Π_t π_t(c_t|s_t,q_t) p(s_{t+1}|c_t)

add up to the probability of the verdict. One backward induction (max-product) gives the best completion of every pair
(s, q) at every step

    B_t(s,q) = 0 / −∞                                               if the verdict is the one asked for / the other
             = max_{c,s'} log(π_t(c|s,q) p(s'|c)) + B_{t+1}(s', δ(L(s'), q))     otherwise

and thereby the loss of every edge against the best edge of its source: ≥ 0, and 0 for the best. A run's loss is the sum
over its edges. Best first: the heap holds the deviations from the runs found so far, each ranked by its own best
completion ([Eppstein98]: sidetracks; an acyclic graph and a perfect heuristic make his heaps of heaps unnecessary).
Order and probabilities are exact up to rounding, about 1e−15 per step.

Why not a library's routine: scipy's `yen` and networkx's `shortest_simple_paths` search again for every deviation and
need the whole graph, without parallel edges (two actions to one successor) or edges of length 0 (p = 1); `yen` needs
the number of paths beforehand, which is not known when a mass is asked for. 1000 violating runs of patrolling on the 10
× 10 floor, without building the graph: T = τ = 10 in 0.04 s, yen likewise, networkx 4.4 s; T = τ = 15 in 0.06 s, yen
0.9 s; under a uniform mixture 0.3 s, yen 7 s.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of, real, whole
from stltool.automata import FALSE, TRUE
from stltool.checking.check import or_optimal
from stltool.checking.induction import SURE, Arithmetic, Edges, Engine, Progress, Values
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.sampling import Run
from stltool.checking.unfold import Unfolding
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError, named
from stltool.models.rows import Rows
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import require_time

MOST_RUNS = 10_000
_SHOWN = 10  # runs in a notebook
_ROUNDING = 1e-12  # a shortfall below this share counts as rounding

_RATE = 1e6  # steps of runs a second, roughly
_REST_OR_SURE = np.array([[0.0, -np.inf, 0.0], [1.0, 0.0, -np.inf]])

_Pair: TypeAlias = tuple[int, int, int]
"""Model state, automaton state, and the slot of both (checking/induction/edges.py)."""
_Trail: TypeAlias = "tuple[_Trail | None, int, _Pair, float, float]"
"""A run, last step first: the run before it, choice (−1 at the start), the pair it led to, probability and its log."""
_Move: TypeAlias = tuple[float, int, _Pair, float, float]
"""The loss of an edge, then the fields of a trail."""


@dataclass(frozen=True, repr=False)
class LikelyRun(Run):
    """A run with its probability under the policy; `log_probability` stays finite if that underflows.

    `certain` is the first step from which on the policy makes no other verdict possible; the verdict itself is decided
    there or later. Under a mixed policy the actions are part of the run: the same states with other actions are a
    different run.
    """

    probability: float
    log_probability: float
    certain: int

    @property
    def step(self) -> int:
        """The step at which the verdict was decided."""
        return len(self.actions)


@dataclass(frozen=True, eq=False, repr=False)
class LikelyRuns(Displayed):
    """The most probable runs of one verdict, in descending order of probability.

    product, policy   what the runs belong to; for a policy with its own automaton, the product with both automata
    satisfied         the verdict asked for
    runs              most probable first; of equal ones the shorter first, then by states
    probability       of the verdict, all runs together; exactly 0 if no run of positive probability has it
    mass, covered     the total probability of `runs`, and its share of `probability` (1 if that is 0)
    exhausted         whether `runs` are all runs with this verdict
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
        share = math.floor(1e4 * self.covered) / 100  # 100 only if all are covered
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
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> LikelyRuns:
    """The `count` most probable runs under `policy` (default: the optimal one) that violate, or satisfy, the task.

    With `mass` in (0, 1] instead: the smallest set of runs that has at least this share of the verdict's probability,
    or its first `most` runs. Raises PolicyError if the policy defines no action in a pair that it reaches or belongs to
    another task, SettingsError for numbers out of range, SizeError before allocating more memory than is available.
    """
    require_door("likely_runs", product, policy)
    flag(satisfied, "likely_runs' satisfied")
    count, most = whole(count, "count", least=1), whole(most, "most", least=1)
    one_of(engine, "engine", get_args(Engine))
    function(progress, "likely_runs' progress")
    if mass is not None:
        mass = float(real(mass, "mass", "0.9"))
        if not 0 < mass <= 1:
            raise SettingsError(
                f"{named('mass')} is {mass}; give a share of the probability, above 0 and at most 1, such as 0.9"
            )
    product, policy = or_optimal("likely_runs", product, policy, memory_limit).on(product)
    wanted = TRUE if satisfied else FALSE
    unfolding = Unfolding(
        product, policy, _Completions(), wanted,
        live=True, kept=_kept, engine=engine, limit=memory_limit, progress=progress,
    )  # fmt: skip
    probability = math.fsum(unfolding.start * unfolding.entry[:, 0])
    limit = count if mass is None else most
    goal = math.inf if mass is None else mass * probability * (1 - _ROUNDING)
    below = probability == 0 and bool(np.isfinite(unfolding.entry[:, 1]).any())  # there are runs; their sum underflows
    if below and mass is not None:
        raise SettingsError(
            f"{named('mass')} {mass:g}: all runs together have less than 1e-300, too little for shares; ask for a "
            "number of runs instead"
        )
    what = f"runs of up to {unfolding.steps} steps, {limit} of them"
    require_time(float(limit) * unfolding.steps, _RATE, what, "ask for fewer, or shorten the windows")
    # Of all sets of n runs the n most probable have the largest mass. So the first n that reach the goal are a smallest
    # set: if any n − 1 runs reached it, the n − 1 most probable would.
    runs: list[LikelyRun] = []
    covered, exhausted = 0.0, False
    search = _by_probability(unfolding, limit)
    while len(runs) < limit and covered < goal:
        trail = next(search, None)
        if trail is None:
            exhausted = True
            break
        runs.append(_run(unfolding, trail, satisfied))
        covered += runs[-1].probability
        if progress is not None and mass is not None:
            progress(len(runs), limit)
    runs.sort(key=lambda run: (-run.log_probability, run.step, run.states, run.actions))
    exhausted = exhausted or next(search, None) is None
    total = math.fsum(run.probability for run in runs)
    share = 1.0 if exhausted else 0.0 if below else min(total / probability, 1.0)
    status = "complete"
    if mass is not None and covered < goal and not exhausted:
        status = f"covered {share:.3g} of the requested {mass:g} with {len(runs)} runs; raise most to continue"
    return LikelyRuns(product, policy, satisfied, tuple(runs), probability, total, share, exhausted, status)


class _Completions(Arithmetic):
    """Three columns: the probability of the goal; B; 0 if another verdict is possible, else −∞."""

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        self._log = np.log(rows.probability)

    def ends(self, t: int) -> tuple[Values, Values]:
        rest, sure = _REST_OR_SURE
        return rest, sure

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        return row_sums(self.rows.probability[edges.entry] * ahead[edges.child, 0], edges.start)

    def back(self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool) -> tuple[Values, None]:
        first, logs = edges.start[edges.choices[:-1]], self._log[edges.entry]
        values, sums = np.empty((len(edges), 3)), self.sums(t, edges, ahead)
        if edges.weight is not None:
            sums = np.add.reduceat(edges.weight * sums, edges.choices[:-1])
            logs += np.repeat(np.log(edges.weight), np.diff(edges.start))
        values[:, 0] = sums
        values[:, 1] = np.maximum.reduceat(logs + ahead[edges.child, 1], first)
        values[:, 2] = np.maximum.reduceat(ahead[edges.child, 2], first)
        return values, None


def _kept(values: Values) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """B by slots, and whether another verdict is possible."""
    return values[:, 1].copy(), values[:, 2] == 0


def _by_probability(unfolding: Unfolding, limit: int) -> Iterator[_Trail]:
    """Runs by descending probability; at most `limit` will be asked for (and one more, to detect the end)."""
    layers, game = unfolding.layers, unfolding.layers.game
    choice_start = unfolding.product.model.choice_start

    def moves(t: int, pair: _Pair) -> list[_Move]:
        """The outgoing edges of a pair, the best one first."""
        if t < 0:  # before the first state, which no choice leads to
            factor, logs = unfolding.start, np.log(unfolding.start)
            choice, s, q = np.full(len(factor), -1), game.first, game.entry
        elif pair[2] == SURE:
            return []
        else:
            fan = layers.fan(t, *np.array([[pair[0]], [pair[1]]]))
            length = np.diff(fan.start)
            weight = np.repeat(np.ones(len(length)) if fan.weight is None else fan.weight, length)
            probability = layers.rows.probability[fan.entry]
            factor, logs = weight * probability, np.log(weight) + np.log(probability)
            number = layers.within(np.full(len(fan.choice), pair[0]), fan.choice)
            choice, s, q = np.repeat(choice_start[pair[0]] + number, length), fan.s_ahead, fan.q_ahead
        slot = layers.slots(unfolding.layer(t + 1), t + 1, s, q)
        gain = logs + unfolding.values(t + 1)[0][slot]
        order = [k for k in np.argsort(-gain, kind="stable").tolist() if gain[k] > -np.inf]
        pairs = zip(s.tolist(), q.tolist(), slot.tolist(), strict=True)
        found = list(zip(choice.tolist(), pairs, factor.tolist(), logs.tolist(), strict=True))
        return [(float(gain[order[0]] - gain[k]), *found[k]) for k in order]

    known: dict[tuple[int, int], list[_Move]] = {}
    tie = itertools.count()
    heap: list[tuple[float, int, _Trail | None, int, _Pair]] = [(0.0, next(tie), None, -1, (-1, -1, -1))]
    left = limit + 1
    while heap and left:
        loss, _, trail, t, pair = heapq.heappop(heap)
        while True:
            if (t, pair[2]) not in known:
                known[t, pair[2]] = moves(t, pair)
            options = known[t, pair[2]]
            if not options:
                break
            for extra, choice, after, factor, log in options[1:]:
                heapq.heappush(heap, (loss + extra, next(tie), (trail, choice, after, factor, log), t + 1, after))
            _, choice, pair, factor, log = options[0]
            t += 1
            trail = (trail, choice, pair, factor, log)
        if trail is not None:
            yield trail
        left -= 1
        if len(heap) > 2 * left + 1000:  # at most `left` can still be asked for; a sorted list is a heap
            heap = heapq.nsmallest(left, heap)


def _run(unfolding: Unfolding, trail: _Trail | None, satisfied: bool) -> LikelyRun:
    model, automaton = unfolding.product.model, unfolding.product.automaton
    steps = []
    while trail is not None:
        trail, *step = trail
        steps.append(step)
    choices, pairs, factors, logs = zip(*reversed(steps), strict=True)
    return LikelyRun(
        states=tuple(s for s, _, _ in pairs),
        actions=tuple(model.action_names[model.choice_action[c]] for c in choices[1:]),
        memory=tuple(automaton.describe(q) for _, q, _ in pairs),
        satisfied=satisfied,
        probability=math.prod(factors),
        log_probability=math.fsum(logs),
        certain=next(t for t, (_, _, slot) in enumerate(pairs) if not unfolding.values(t)[1][slot]),
    )
