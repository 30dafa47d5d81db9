"""`stationary`: the best policy that does not know the step, its exact P, and what that costs against the optimum.

The optimum over all policies knows the step t as well as (s, q). A *stationary* policy picks its action by the pair
(s, q) alone, a *memoryless* one by the model state s alone: tables that fit on a small controller. Finding the best of
them is not a dynamic programme (one choice serves several steps, and what helps at one may harm at another), so there
are two answers:

    candidates   policies made in several ways, each with its exact P by backward induction; the best is reported
    a bound      no deterministic policy of this kind has a higher P

The bound comes from branch and bound. Below, a *place* is (s, q), or s. A node restricts the choices of each place; its
relaxation lets the policy depend on the step again and is one backward induction over the remaining choices. If the
relaxation's optimum takes only one choice in each place, it is itself such a policy and the node is solved. Otherwise
the search branches on the place whose choice varies most over the steps: its most frequent choice alone, or all the
others. The node with the greatest bound comes first, so the search may stop at any time: the greatest open bound is the
result. When nothing is above the best policy found, it is *proved* to be the best.

Candidates, with x_t(s,q,c) the probability that the optimum is in (s, q) at step t and takes c, and V_t its values:

    votes     argmax_c Σ_t x_t(s,q,c)
    values    argmax_c Σ_t x_t(s,q) Σ_s' p(s'|c) V_{t+1}(s', q')
    step t    the optimum's choices at step t
    mean m    value iteration with a geometric horizon of mean m instead of h: discounting
    search    local search from the best of these: for a policy π the derivative of P towards choice c in a place is
              ∂P = Σ_{t} x_t(s,q) (Σ_s' p(s'|c) V_{t+1}(s', q') − V_t(s,q)), x and V those of π; places with a positive
              derivative switch, all or the best of them, while P grows
    branch    the votes of a relaxation

Mixed policies may be better than every deterministic one; the bound does not cover them.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of, real, whole
from stltool.automata import FALSE, TRUE
from stltool.checking.check import CheckResult, Floats, check, double_bounds
from stltool.checking.induction import (
    EVERYTHING,
    Allowed,
    Among,
    Budget,
    Doubles,
    Edges,
    Engine,
    Following,
    Game,
    Layers,
    Probabilities,
    Progress,
    Values,
    layers_of,
    solve,
)
from stltool.checking.unfold import flows
from stltool.choices import Choices, Form, Table, Through
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError, named
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import require_memory

Memory: TypeAlias = Literal["automaton", "none"]
KINDS: dict[Memory, str] = {"automaton": "stationary", "none": "memoryless"}
Chosen: TypeAlias = NDArray[np.int64]
"""(places,) the index of a choice within its state."""

_STEPS = 6  # steps of the optimum that are candidates
_STARTS = 3  # candidates from which local search starts
_CLIMBS = 40  # steps of one local search
_SINGLES = 8  # places that are switched one by one, after larger groups
_RISE = 1e-13  # a smaller increase is rounding
_EQUAL = 1e-12  # smaller differences are not reported
_CELLS = 5_000_000  # numbers that value iteration may hold
_SWEEPS = 3_000


@dataclass(frozen=True)
class Candidate:
    """An evaluated deterministic policy: how it was made, and its P."""

    made: str
    probability: float


@dataclass(frozen=True, eq=False, repr=False)
class StationaryResult(Displayed):
    """The best policy found that does not depend on the step.

    memory      "automaton": its action depends on (s, q), "none": on the model state alone
    best        the check of the best policy found, with its enclosure; `policy` is that policy
    optimum     the check over all policies, which may depend on the step
    candidates  the evaluated policies, the best first
    bound       no deterministic policy of this kind is above it (for a minimum: below it), rounding included
    proved      whether the best policy found reaches the bound, within the tolerance asked for
    nodes the number of relaxations solved
    status      how it ended, in words
    seconds     wall time
    """

    product: Product
    memory: Memory
    best: CheckResult
    optimum: CheckResult
    candidates: tuple[Candidate, ...]
    bound: float
    proved: bool
    nodes: int
    status: str
    seconds: float

    @property
    def policy(self) -> Policy:
        assert self.best.policy is not None
        return self.best.policy

    @property
    def probability(self) -> float:
        """P of the best policy found."""
        return self.best.probability

    @property
    def gap(self) -> float:
        """The difference between it and the optimum over all policies."""
        return abs(self.optimum.probability - self.best.probability)

    @property
    def kind(self) -> str:
        """ "stationary" or "memoryless"."""
        return KINDS[self.memory]

    def _card(self) -> Card:
        return Card(
            f"StationaryResult: P = {self.probability!r}, {self.kind}, {self.status}",
            [
                {"optimum": probability_text(self.optimum.probability), "gap": f"{self.gap:.3g}"},
                {"task": f"{self.product.task_name} := {self.product.formula}", "model": self.product.model.name},
            ],
            (("made by", "P"), [(found.made, probability_text(found.probability)) for found in self.candidates[:8]]),
            more=max(0, len(self.candidates) - 8),
        )


def stationary(
    product: Product,
    *,
    memory: Memory = "automaton",
    maximize: bool = True,
    most: int = 200,
    tolerance: float = 1e-9,
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> StationaryResult:
    """The best deterministic policy found that does not depend on the step, its exact P, and a bound on all others.

    memory     "automaton": one choice for each (s, q); "none": one for each model state
    maximize   False: the least P instead
    most       the most relaxations that branch and bound may solve; 0: only candidates
    tolerance  the best policy found counts as proved within this tolerance of P

    `best.lower` ≤ P of the best such policy ≤ `bound`. Raises SettingsError for settings out of range, SizeError before
    allocating more memory than is available.
    """
    started = time.perf_counter()
    require_door("stationary", product)
    one_of(memory, "memory", get_args(Memory))
    flag(maximize, "stationary's maximize")
    most = whole(most, "most", least=0)
    tolerance = float(real(tolerance, "tolerance", "1e-9"))
    if not 0 < tolerance < 1:
        raise SettingsError(f"{named('tolerance')} is {tolerance!r}; it must be between 0 and 1, both excluded")
    one_of(engine, "engine", get_args(Engine))
    function(progress, "stationary's progress")
    product.model.require_points()
    optimum = check(product, maximize=maximize, engine=engine, memory_limit=memory_limit)
    assert optimum.policy is not None
    asked = _Asked(product, memory, maximize, engine, memory_limit)
    field = _Field(asked)
    for made, chosen in _candidates(asked, optimum.policy.form):
        field.add(made, chosen)
    for made, chosen in list(itertools.islice(field.ranked(), _STARTS)):
        field.climb(f"search from {made}", chosen)
    open_, nodes = _branch_and_bound(asked, field, optimum.probability, most, tolerance, progress)
    best = check(product, asked.policy(field.best), maximize=maximize, engine=engine, memory_limit=memory_limit)
    bound = asked.beyond(open_, optimum)
    missing = bound - best.lower if maximize else best.upper - bound
    proved = missing <= 3 * tolerance
    found = tuple(Candidate(made, asked.sign * p) for made, p in field.found())
    status = f"best of {counted(len(found), 'candidate')}; the best {KINDS[memory]} policy may be {missing:.2g} better"
    if proved:
        about = f", up to {missing:.1g}" if missing > _EQUAL else ""
        status = f"proved to be the best deterministic {KINDS[memory]} policy{about}"
    return StationaryResult(
        product, memory, best, optimum, found, bound, proved, nodes, status, time.perf_counter() - started
    )


# ------------------------------------------------------------------------------------------------- one question


class _Asked:
    """A product with the places that share a choice: s·|Q| + q, or s; `sign` makes every question a maximum."""

    def __init__(
        self, product: Product, memory: Memory, maximize: bool, engine: Engine, memory_limit: int | None
    ) -> None:
        self.product, self.maximize, self.engine, self.limit = product, maximize, engine, memory_limit
        model = product.model
        self.width = product.automaton.n_states if memory == "automaton" else 1
        self.n_places, self.most = model.n_states * self.width, model.most_choices
        self.n_choices: Chosen = np.repeat(np.diff(model.choice_start), self.width)
        self.sign = 1.0 if maximize else -1.0
        require_memory(
            8 * self.n_places * (3 * self.most + 4),
            f"policies over {self.n_places} places with up to {self.most} choices",
            "shorten the windows, or coarsen the grid",
            memory_limit,
        )

    def place(self, s: NDArray[np.int64], q: NDArray[np.int64]) -> NDArray[np.int64]:
        return s if self.width == 1 else s * self.width + q

    @property
    def goal(self) -> int:
        return TRUE if self.maximize else FALSE

    @cached_property
    def layers(self) -> Layers[Any, Any]:
        """Everything that policies may reach, and where each choice leads."""
        return self._layers(EVERYTHING)

    def form(self, table: NDArray[Any]) -> Form:
        """By place: choices (places,), or weights (places, C)."""
        rows = table.reshape(self.product.model.n_states, self.width, *table.shape[1:])
        if rows.dtype.kind == "i":
            rows = rows.astype(self.product.model.choice_type)
        if self.width > 1 or self.product.automaton.n_states == 1:
            return Table(rows)
        return Through(Table(rows), np.zeros(self.product.automaton.n_states, dtype=np.int64))

    def policy(self, chosen: Chosen) -> Policy:
        return Policy(self.product, self.form(chosen))

    def relaxed(self, left: NDArray[np.bool_]) -> tuple[float, Choices]:
        """The best P, and its choices, over policies that may depend on the step and use only `left` (places, C)."""
        layers = self._layers(Among(self.form(left / left.sum(axis=1, keepdims=True))), keep=True)
        found = solve(layers, Doubles(self.maximize), self.maximize, self.product.model.unsigned_choice_type)
        assert found.choices is not None
        return self.sign * self.at_start(found.entry), found.choices

    def votes(self, form: Form) -> Floats:
        """(places, C): the expected number of times that a policy takes each choice while undecided."""
        layers = self._layers(Following(form))
        found = np.zeros((self.n_places, self.most))
        for _, edges, _, flow in flows(layers, [*layers.backwards()][::-1], self.shares):
            np.add.at(found, (self._owner(edges), self._number(layers, edges)), flow)
        return found

    def judge(self, form: Form) -> tuple[float, Floats]:
        """(P · sign, (places, C): its derivative towards each choice · sign) of a deterministic policy."""
        reach: dict[int, list[Floats]] = {}
        for t, _, here, _ in flows(self.layers, self._stretches, self.shares, form):
            reach.setdefault(t, []).append(here)
        judged = _Judged(self, form, {t: np.concatenate(parts) for t, parts in reach.items()})
        found = solve(self.layers, judged, self.maximize)
        return self.sign * self.at_start(found.entry), self.sign * judged.gain

    def first_best(self, votes: Floats, left: NDArray[np.bool_] | None = None) -> Chosen:
        """The choice with the most votes in each place, among all those available, or among `left`."""
        left = np.arange(self.most) < self.n_choices[:, None] if left is None else left
        best: Chosen = np.where(left, votes, -np.inf).argmax(axis=1)
        return best

    def beyond(self, value: float, optimum: CheckResult) -> float:
        """A bound on the exact value of an induction whose result, times sign, is `value`."""
        lower, upper = double_bounds(self.product, self.layers.kinds, min(max(self.sign * value, 0.0), 1.0))
        return min(upper, optimum.upper) if self.maximize else max(lower, optimum.lower)

    def at_start(self, entry: Values) -> float:
        return float(self.shares @ entry)

    @property
    def shares(self) -> Floats:
        model = self.product.model
        shares: Floats = model.initial[np.flatnonzero(model.initial)]
        return shares

    @cached_property
    def _stretches(self) -> list[Any]:
        return [*self.layers.backwards()][::-1]

    def _layers(self, allowed: Allowed, keep: bool = False) -> Layers[Any, Any]:
        budget = Budget(f"policies on {self.product.n_states} product states", self.limit)
        kept = self.product.model.unsigned_choice_type if keep else None
        return layers_of(
            Game.of(self.product), self.goal, allowed, engine=self.engine, sure=keep, keep=kept, budget=budget
        )

    def _owner(self, edges: Edges) -> NDArray[np.int64]:
        """(m,) the place of each choice."""
        return np.repeat(self.place(edges.s, edges.q), np.diff(edges.choices))

    def _number(self, layers: Layers[Any, Any], edges: Edges) -> NDArray[np.int64]:
        return layers.within(np.repeat(edges.s, np.diff(edges.choices)), edges.choice)


class _Judged(Probabilities):
    """A policy's values on everything that any policy may reach, and what switching would gain where this policy
    goes."""

    repeats = False

    def __init__(self, asked: _Asked, form: Form, reach: dict[int, Floats]) -> None:
        super().__init__(asked.maximize)
        self._asked, self._form, self._reach = asked, form, reach
        self._at, self._done = -1, 0
        self.gain = np.zeros((asked.n_places, asked.most))

    def back(self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool) -> tuple[Values, None]:
        if t != self._at:
            self._at, self._done = t, 0
        sums, place = self.sums(t, edges, ahead), self._asked.place(edges.s, edges.q)
        values: Values = sums[edges.choices[:-1] + self._form.at(t, edges.s, edges.q)]
        here = self._reach[t][self._done : self._done + len(edges)]
        self._done += len(edges)
        count = np.diff(edges.choices)
        number = np.arange(len(sums)) - np.repeat(edges.choices[:-1], count)
        np.add.at(
            self.gain, (np.repeat(place, count), number), np.repeat(here, count) * (sums - np.repeat(values, count))
        )
        return values, None


class _Field:
    """The policies evaluated so far: each once, identified by its choices in all places."""

    def __init__(self, asked: _Asked) -> None:
        self._asked = asked
        self._known: dict[bytes, tuple[float, str]] = {}
        self._of: dict[bytes, Chosen] = {}
        self.value, self.best = -np.inf, np.empty(0, dtype=np.int64)

    def add(self, made: str, chosen: Chosen) -> tuple[float, Floats]:
        p, gain = self._asked.judge(self._asked.form(chosen))
        key = chosen.tobytes()
        if key not in self._known:
            self._known[key], self._of[key] = (p, made), chosen
        if p > self.value:
            self.value, self.best = p, chosen
        return p, gain

    def ranked(self) -> Iterator[tuple[str, Chosen]]:
        for key, (_, made) in sorted(self._known.items(), key=lambda item: -item[1][0]):
            yield made, self._of[key]

    def found(self) -> list[tuple[str, float]]:
        return sorted(((made, p) for p, made in self._known.values()), key=lambda row: -row[1])

    def climb(self, made: str, chosen: Chosen) -> None:
        """Local search: see the module's text."""
        p, gain = self.add(made, chosen)
        for _ in range(_CLIMBS):
            better = gain.max(axis=1)
            places = np.flatnonzero(better > _RISE)
            order = places[np.argsort(-better[places], kind="stable")]
            for some in _portions(order):
                switched = chosen.copy()
                switched[some] = gain[some].argmax(axis=1)
                found, after = self.add(made, switched)
                if found > p + _RISE:
                    p, gain, chosen = found, after, switched
                    break
            else:
                return


def _portions(order: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """All, the better half, its better half, … one; then others one by one."""
    n = len(order)
    while n > 1:
        yield order[:n]
        n = (n + 1) // 2 if n > 2 else 1
    for i in range(min(_SINGLES, len(order))):
        yield order[i : i + 1]


# ---------------------------------------------------------------------------------------------------- candidates


def _candidates(asked: _Asked, optimum: Form) -> Iterator[tuple[str, Chosen]]:
    votes = asked.votes(optimum)
    yield "votes of the optimum", asked.first_best(votes)
    gain = asked.judge(optimum)[1]  # votes break ties: the first choice might never move
    tied = gain >= gain.max(axis=1, keepdims=True) - _RISE
    yield "values of the optimum", asked.first_best(np.where(tied, votes, -1.0))
    h = asked.product.horizon
    for t in np.unique(np.linspace(0, max(h - 1, 0), _STEPS).astype(int)).tolist() if h else []:
        s, q = np.divmod(np.arange(asked.n_places), asked.width)
        if asked.width > 1 or asked.product.automaton.n_states == 1:
            yield f"step {t} of the optimum", optimum.at(t, s, q)
    if asked.width > 1:
        for mean in sorted({max(h // 2, 1), max(h, 1), 2 * max(h, 1)}):
            found = _geometric(asked, 1 - 1 / (mean + 1))
            if found is not None:
                yield f"mean horizon {mean}", found


def _geometric(asked: _Asked, gamma: float) -> Chosen | None:
    """Value iteration in which each step is the last with probability 1 − γ; None if it would take too long.

    Automaton states whose verdict is the same at all steps end a run; a run that ends in another one gets its verdict
    at the horizon.
    """
    product = asked.product
    model, automaton = product.model, product.automaton
    if model.n_choices * automaton.n_states > _CELLS or model.n_transitions * automaton.n_states > _CELLS:
        return None
    rows = automaton.verdict_rows
    ended = (rows == rows[-1]).all(axis=0)
    worth = (rows[-1] == TRUE).astype(np.float64)
    state, after = np.arange(model.n_states)[:, None], automaton.delta[product.letter]
    matrix, start = model.matrix(), model.choice_start[:-1]
    best: Callable[..., Floats] = np.maximum.reduceat if asked.maximize else np.minimum.reduceat
    values, options = np.zeros(product.shape), np.zeros((model.n_choices, automaton.n_states))
    for _ in range(_SWEEPS):
        options = matrix @ np.where(ended, worth, gamma * values + (1 - gamma) * worth)[state, after]
        new = best(options, start, axis=0)
        change, values = float(np.abs(new - values).max()), new
        if change < 1e-10:
            break
    attained = options == np.repeat(values, np.diff(model.choice_start), axis=0)
    number = np.arange(model.n_choices) - np.repeat(start, np.diff(model.choice_start))
    chosen = np.minimum.reduceat(np.where(attained, number[:, None], asked.most), start, axis=0)
    found: Chosen = chosen.astype(np.int64).ravel()
    return found


# ---------------------------------------------------------------------------------------------- branch and bound


def _branch_and_bound(
    asked: _Asked, field: _Field, root: float, most: int, tolerance: float, progress: Progress | None
) -> tuple[float, int]:
    """(a bound on every policy's P · sign, up to rounding; the relaxations solved); see the module's text."""
    everything = np.arange(asked.most) < asked.n_choices[:, None]
    count = itertools.count()
    heap: list[tuple[float, int, NDArray[np.bool_]]] = [(-asked.sign * root, next(count), everything)]
    closed, nodes = -np.inf, 0
    while heap and nodes < most:
        bound, _, left = heapq.heappop(heap)
        if -bound <= field.value + tolerance:  # as are all others
            heapq.heappush(heap, (bound, next(count), left))
            break
        value, choices = asked.relaxed(left)
        nodes += 1
        if progress is not None:
            progress(nodes, most)
        votes = asked.votes(choices)
        field.add("branch", asked.first_best(votes, left))
        divided = np.flatnonzero((votes > 0).sum(axis=1) > 1)
        if not len(divided):  # it is itself such a policy: the one just evaluated
            closed = max(closed, value)
            continue
        if value <= field.value + tolerance:
            closed = max(closed, value)
            continue
        among = votes[divided]
        place = int(divided[(among.sum(axis=1) - among.max(axis=1)).argmax()])
        choice = int(votes[place].argmax())
        for alone in (True, False):
            part = left.copy()
            part[place] = False if alone else left[place]
            part[place, choice] = alone
            heapq.heappush(heap, (-value, next(count), part))
    return max([closed, field.value, *(-bound for bound, _, _ in heap[:1])]), nodes
