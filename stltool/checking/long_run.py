"""`long_run`: a bounded task that repeats for ever, judged at every step of an endless run.

With w_t = whether Φ holds at step t, four questions on products that judge every step (automata/running.py):

    share        E[lim 1/n Σ_{t<n} w_t], the long-run share of the steps at which Φ holds
    always       P(w_t for every t), of G Φ
    recurrence   P(w_t for infinitely many t), of G F Φ
    persistence  P(w_t for every t from some step on), of F G Φ

What a run visits infinitely often is an end component (recurrent.py), so each is the greatest probability of reaching
maximal end components, weighted by what a policy can have in them:

    share        the greatest average of w, the same from everywhere in a component [Puterman94, §9.5]
    recurrence   1 if w holds anywhere in it                                        [Alfaro97, ch. 4]
    persistence  1 if it contains an end component in which w holds everywhere
    always       as persistence, where runs end as soon as w fails; the components are then all or nothing

and least values are 1 − the greatest of the opposite: of ¬w, with recurrence and persistence exchanged. In each
component a policy can stay or leave, so once components are merged into vertices where one may stop, every policy ends
with probability 1, and averages.py finds the optimum. It is one over all policies, history-dependent ones included: a
stationary policy on the product attains it. If the share of a run has no limit, its upper limit counts for the
greatest, its lower one for the least.
"""

from __future__ import annotations

import itertools
import math
import time
import warnings
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, one_of
from stltool.automata import Encoding
from stltool.checking.averages import Game, Row, exact_average, exact_total, greatest_average, greatest_total
from stltool.checking.bounds import defect, row_defect
from stltool.checking.enclosed import Enclosed, enclosed_rows
from stltool.checking.rational import require_exact
from stltool.checking.recurrent import (
    Bools,
    Components,
    Recurrent,
    columns,
    end_components,
    recurrent,
    surely,
    towards,
)
from stltool.display import Card, Displayed
from stltool.errors import InexactEncodingWarning, PolicyError
from stltool.numbers import round_down, round_up
from stltool.policy import Policy, require_door
from stltool.product import JointProduct, Product, build_product

Question: TypeAlias = Literal["share", "always", "recurrence", "persistence"]
QUESTIONS: tuple[Question, ...] = get_args(Question)
_OPPOSITE: dict[Question, Question] = {"share": "share", "recurrence": "persistence", "persistence": "recurrence"}


@dataclass(frozen=True, eq=False, repr=False)
class LongRun(Displayed, Enclosed):
    """An answer about endless runs: lower ≤ exact value ≤ upper, rounding included, for the model as given.

    product   the running product, or for "always" that of the safety automaton: `policy` is defined on it
    asked     "share" | "always" | "recurrence" | "persistence"
    question  "minimum" | "maximum" (over all policies) | "policy"
    policy    a stationary policy that attains the optimum, up to rounding; or the given one
    pairs     how many pairs of model and automaton states runs can reach, and how many maximal end `components`
    fraction  the exact value, if it was asked for; lower and upper are then the doubles next to it
    seconds   wall time
    """

    product: Product
    asked: Question
    question: Literal["minimum", "maximum", "policy"]
    value: float
    lower: float
    upper: float
    policy: Policy
    pairs: int
    components: int
    seconds: float
    fraction: Fraction | None = None

    def _card(self) -> Card:
        asked = "of the policy" if self.question == "policy" else f"{self.question} over all policies"
        return Card(
            f"LongRun: {self.asked} = {self.value!r}, {asked}",
            enclosed_rows(self.product, self.lower, self.upper, self.fraction),
        )


def long_run(
    product: Product,
    asked: Question = "share",
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    exact: bool = False,
    memory_limit: int | None = None,
) -> LongRun:
    """The long-run share of the steps at which the task holds, or the probability that it holds again and again: under
    `policy`, or the greatest (least) over all policies.

    `asked` is "share", "always" (at every step, for ever), "recurrence" (at infinitely many steps) or "persistence" (at
    every step from some step on). The task itself is bounded, and judged anew at every step; windows of the past reach
    back to step 0. `product` may have any encoding: it is built again with the one that the question needs, "running"
    or, for "always", "safety". A policy must not depend on the step. `exact=True` adds the exact fraction.

    Raises PolicyError if the policy depends on the step, belongs to another task or model, or defines no action where
    it is needed; SettingsError if the probabilities are unknown, intervals or parameters; SizeError before allocating
    more memory than is available; ModelError if an exact answer is asked for and rows do not sum to 1.
    """
    require_door("long_run", product, policy)
    one_of(asked, "asked", QUESTIONS)
    flag(maximize, "long_run's maximize")
    flag(exact, "long_run's exact")
    return Forever(product, policy, memory_limit).ask(asked, maximize, exact)


class Forever:
    """A product prepared for several questions: what runs can reach, under a policy or any."""

    def __init__(self, product: Product, policy: Policy | None = None, memory_limit: int | None = None) -> None:
        product.model.require_points()
        if policy is not None and (not policy.stationary or isinstance(policy.home, JointProduct)):
            raise PolicyError(
                f"the policy depends on the step and ends after {policy.home.horizon} steps, and this question is "
                "about runs that go on for ever; give a policy of the state, or of the state and what is remembered"
            )
        self.given, self.policy, self._limit = product, policy, memory_limit
        self.defect = float(row_defect(product.model.rows)) * (1 + 1e-9)
        if policy is not None and not policy.deterministic:
            self.defect += float(defect(policy.form.mixtures().tolist())) * (1 + 1e-9)

    def ask(self, asked: Question, maximize: bool = True, exact: bool = False) -> LongRun:
        """The answer to one question."""
        began = time.perf_counter()
        if exact:
            require_exact(self.given.model, self.given.model.rows)
        product, graph, parts = self.safe if asked == "always" else self.running
        opposite = not maximize and self.policy is None
        holds = ~graph.satisfied if opposite else graph.satisfied
        if asked == "always":
            goal = _Goal.of(graph.absorbing(~graph.satisfied), holds)
        else:
            goal = self._goal(_OPPOSITE[asked] if opposite else asked, holds, exact)
        found = _reached(goal, self.defect, exact)
        found = found.opposite() if opposite else found
        policy = self.policy if self.policy is not None else Policy(product, _table(product, graph, found))
        question: Literal["minimum", "maximum", "policy"]
        question = "policy" if self.policy is not None else "maximum" if maximize else "minimum"
        value, lower, upper = found.value, found.lower, found.upper
        if found.fraction is not None:
            value, lower, upper = float(found.fraction), round_down(found.fraction), round_up(found.fraction)
        seconds = time.perf_counter() - began
        return LongRun(
            product, asked, question, value, lower, upper, policy, graph.n, parts.count, seconds, found.fraction
        )

    @cached_property
    def running(self) -> tuple[Product, Recurrent, Components]:
        """The running product, what runs can reach of it, and its maximal end components."""
        return self._prepared("running")

    @cached_property
    def safe(self) -> tuple[Product, Recurrent, Components]:
        """The same for the safety automaton."""
        return self._prepared("safety")

    def _prepared(self, encoding: Encoding) -> tuple[Product, Recurrent, Components]:
        product = self.given
        if product.automaton.encoding != encoding:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InexactEncodingWarning)
                built = build_product(product.model, product.formula, encoding, self._limit)
            product = replace(built, task_name=product.task_name, definitions=product.definitions)
        judge, judged = self.policy.on(product) if self.policy is not None else (product, None)
        graph = recurrent(judge, judged, self._limit)
        return product, graph, end_components(graph)

    def _goal(self, asked: Question, holds: Bools, exact: bool) -> _Goal:
        """What a policy can have in each maximal end component, and its choices there."""
        _, graph, parts = self.running
        if asked == "share":
            return _averages(graph, parts, holds, self.defect, exact)
        if asked == "persistence":
            return _Goal(graph, parts, *_staying(graph, parts, holds))
        goals = holds & (parts.of >= 0)
        return _Goal(graph, parts, _with(parts, goals), _led(graph, parts, goals, _some_choice(graph, parts)))


def _table(product: Product, graph: Recurrent, found: _Found) -> NDArray[np.int64]:
    """(S, Q) the choices found; the first where runs come to only after the question is decided."""
    table = np.full(product.n_states, -1, dtype=np.int64)
    table[graph.code] = found.choice
    return table.reshape(product.shape)


# ------------------------------------------------------------------------------------------------- components


@dataclass(frozen=True, eq=False)
class _Goal:
    """What staying in each component is worth: (count,) bounds, or fractions, and the choices (n,) of who stays."""

    graph: Recurrent
    parts: Components
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    picks: NDArray[np.int64]
    fractions: list[Fraction] | None = None

    def __init__(
        self,
        graph: Recurrent,
        parts: Components,
        lower: NDArray[np.float64] | Bools,
        picks: NDArray[np.int64],
        upper: NDArray[np.float64] | None = None,
        fractions: list[Fraction] | None = None,
    ) -> None:
        for name, value in (
            ("graph", graph), ("parts", parts), ("lower", lower.astype(np.float64)), ("picks", picks),
            ("upper", lower.astype(np.float64) if upper is None else upper), ("fractions", fractions),
        ):  # fmt: skip
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, graph: Recurrent, good: Bools) -> _Goal:
        """1 in components of good vertices, all or none of whose vertices are good."""
        parts = end_components(graph)
        return cls(graph, parts, _with(parts, good), _some_choice(graph, parts))


def _with(parts: Components, vertices: Bools) -> Bools:
    """(count,) the components that contain one of these vertices."""
    found = np.zeros(parts.count, dtype=np.bool_)
    found[parts.of[(parts.of >= 0) & vertices]] = True
    return found


def _staying(graph: Recurrent, parts: Components, holds: Bools) -> tuple[Bools, NDArray[np.int64]]:
    """(count,) the components in which a policy can reach a set where w holds for ever, and its choices (n,)."""
    inner = end_components(graph, holds)
    kept = inner.of >= 0
    picks = np.where(kept, _some_choice(graph, inner), _some_choice(graph, parts))
    return _with(parts, kept), _led(graph, parts, kept, picks)


def _some_choice(graph: Recurrent, parts: Components) -> NDArray[np.int64]:
    """(n,) for each vertex of a component the first of its choices that stay; −1 elsewhere."""
    found = np.full(graph.n, -1, dtype=np.int64)
    inside = np.flatnonzero(parts.inside)
    found[graph.owner[inside][::-1]] = inside[::-1]
    return found


def _led(graph: Recurrent, parts: Components, goals: Bools, picks: NDArray[np.int64]) -> NDArray[np.int64]:
    """The choices, replaced within components by some that lead to the goals there."""
    nearer = towards(graph, goals, parts.inside)
    return np.where(nearer >= 0, nearer, picks)


def _averages(graph: Recurrent, parts: Components, holds: Bools, missing: float, exact: bool) -> _Goal:
    """The greatest average of each component."""
    lower, upper = np.zeros(parts.count), np.zeros(parts.count)
    fractions: list[Fraction] = []
    perfect, picks = _staying(graph, parts, holds)
    order = np.argsort(parts.of, kind="stable")
    bounds = np.searchsorted(parts.of[order], np.arange(parts.count + 1))
    number = np.full(graph.n, -1, dtype=np.int64)
    for c in range(parts.count):
        members = order[bounds[c] : bounds[c + 1]]
        among = holds[members]
        if perfect[c] or not among.any():
            lower[c] = upper[c] = float(perfect[c])
            fractions.append(Fraction(int(perfect[c])))
            continue
        number[members] = np.arange(len(members))
        choices = np.concatenate([np.arange(graph.choice_start[i], graph.choice_start[i + 1]) for i in members])
        choices = choices[parts.inside[choices]]
        game = _game(graph, choices, number[graph.owner[choices]], number, len(members), missing)
        lower[c], upper[c], best = greatest_average(game, among.astype(np.float64))
        if exact:
            rows = _by_vertex(graph, choices, game.start, number)
            fraction, within = exact_average(
                rows, [Fraction(int(one)) for one in among], (best - game.start[:-1]).tolist()
            )
            fractions.append(fraction)
            best = game.start[:-1] + np.array(within)
        picks[members] = choices[best]
    return _Goal(graph, parts, lower, picks, upper, fractions if exact else None)


def _game(
    graph: Recurrent,
    choices: NDArray[np.int64],
    owner: NDArray[np.int64],
    number: NDArray[np.int64],
    n: int,
    missing: float,
) -> Game:
    longest = int(np.diff(graph.row_start).max())
    start = np.searchsorted(owner, np.arange(n + 1))
    return Game(columns(graph, choices, number, n), start, longest, missing)


def _by_vertex(
    graph: Recurrent, choices: NDArray[np.int64], start: NDArray[np.int64], number: NDArray[np.int64]
) -> list[list[Row]]:
    rows = [[(int(number[j]), p) for j, p in row] for row in graph.exactly(choices)]
    return [rows[a:b] for a, b in zip(start[:-1].tolist(), start[1:].tolist(), strict=True)]


# -------------------------------------------------------------------------------------------------- reaching


@dataclass(frozen=True, eq=False)
class _Found:
    """A greatest value, and the index within its state (n,) of a policy's choice at each vertex."""

    value: float
    lower: float
    upper: float
    choice: NDArray[np.int64]
    fraction: Fraction | None

    def opposite(self) -> _Found:
        lower, upper = round_down(1 - Fraction(self.upper)), round_up(1 - Fraction(self.lower))
        fraction = 1 - self.fraction if self.fraction is not None else None
        return replace(self, value=1 - self.value, lower=lower, upper=upper, fraction=fraction)


def _reached(goal: _Goal, missing: float, exact: bool) -> _Found:
    """The greatest expected worth of the component in which runs stay."""
    graph, parts = goal.graph, goal.parts
    node = parts.of.copy()  # components first, then all other vertices by themselves
    alone = np.flatnonzero(node < 0)
    n = parts.count + len(alone)
    node[alone] = np.arange(parts.count, n)
    leaving = np.flatnonzero(~parts.inside)
    owner = np.concatenate([np.arange(parts.count), node[graph.owner[leaving]]])  # one may stop in any component
    order = np.argsort(owner, kind="stable")
    choice = np.concatenate([np.full(parts.count, -1), leaving])[order]
    owner = owner[order]
    stops = choice < 0
    start = np.searchsorted(owner, np.arange(n + 1))
    away = columns(graph, choice[~stops], node, n)
    from scipy.sparse import csr_array

    indptr = np.zeros(len(choice) + 1, dtype=np.int64)
    lengths = np.zeros(len(choice), dtype=np.int64)
    lengths[~stops] = np.diff(away.indptr)
    np.cumsum(lengths, out=indptr[1:])
    matrix = csr_array((away.data, away.indices, indptr), shape=(len(choice), n))
    game = Game(matrix, start, int(np.diff(graph.row_start).max()), missing)
    worth = (goal.lower + goal.upper) / 2
    base = np.zeros(len(choice))
    base[stops] = worth[owner[stops]]
    found = greatest_total(game, base, start[:-1].copy())
    begun, share = graph.first, graph.share
    begins = node[begun]
    value = math.fsum(share * found.x[begins])
    model = graph.product.model
    halves = Fraction(float(np.abs(goal.upper - goal.lower).max(initial=0.0))) / 2 + Fraction(1, 2**50)
    more = halves + Fraction(1, 2**50) + model.initial_defect
    lower = round_down(max(Fraction(0), Fraction(value) - Fraction(math.fsum(share * found.below[begins])) - more))
    upper = round_up(min(Fraction(1), Fraction(value) + Fraction(math.fsum(share * found.above[begins])) + more))
    picks = found.picks
    fraction = None
    if exact:
        worths = goal.fractions if goal.fractions is not None else [Fraction(int(one)) for one in goal.lower]
        given = iter(graph.exactly(choice[~stops]))
        node_list = node.tolist()
        rows: list[Row] = [[] if stop else [(node_list[j], p) for j, p in next(given)] for stop in stops.tolist()]
        paid = [worths[i] if stop else Fraction(0) for i, stop in zip(owner.tolist(), stops.tolist(), strict=True)]
        ends = start.tolist()
        x, within = exact_total(
            [rows[a:b] for a, b in itertools.pairwise(ends)],
            [paid[a:b] for a, b in itertools.pairwise(ends)],
            (picks - start[:-1]).tolist(),
        )
        picks = start[:-1] + np.array(within)
        fraction = sum(
            (model.initial_share(s) * x[i] for s, i in zip(np.flatnonzero(model.initial).tolist(), begins.tolist(),
                                                           strict=True)),
            Fraction(0),
        )  # fmt: skip
    worthwhile = _vertices(parts, goal.upper > 0)
    if not (worthwhile | (towards(graph, worthwhile, np.ones(len(graph.choice), dtype=np.bool_)) >= 0))[begun].any():
        lower = upper = value = 0.0
    elif surely(graph, _vertices(parts, goal.lower == 1))[begun].all():
        lower = upper = value = 1.0
    return _Found(value, lower, upper, _choices(goal, node, choice[picks]), fraction)


def _vertices(parts: Components, good: Bools) -> Bools:
    found = np.zeros(len(parts.of), dtype=np.bool_)
    inside = parts.of >= 0
    found[inside] = good[parts.of[inside]]
    return found


def _choices(goal: _Goal, node: NDArray[np.int64], picks: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) the policy's choice at each vertex, within its state: those of who stays where it stays; elsewhere the way
    to the choice by which a component is left."""
    graph, parts = goal.graph, goal.parts
    leaves = picks >= 0
    chosen = goal.picks.copy()
    exits = np.zeros(graph.n, dtype=np.bool_)
    doors = picks[leaves]
    exits[graph.owner[doors]] = True
    to_door = towards(graph, exits, parts.inside)
    moving = leaves[node]
    chosen[moving] = to_door[moving]
    chosen[graph.owner[doors]] = doors
    assert (chosen >= 0).all()
    return graph.choice[chosen]
