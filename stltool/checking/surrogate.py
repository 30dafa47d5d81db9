"""What the paper's surrogate objective achieves after perfect learning: its optimal policies, and their exact P.

With χ_t ∈ {0, 1} the inner formula's truth that the flags show after step t [Wang24, eq. 11], two readings of eq. 9:

    discounted   max E Σ_{t ≥ 1} γ^(t−1) r(χ_t)                 eq. 12 and 5 as published: stationary, infinite horizon
    episode      max E Σ_{t = τ−1}^{T+τ−2} r(χ_t)               eq. 9: start k is judged at t = k + τ − 1

r is e^{βχ} under an outer F and −e^{−βχ} under an outer G, of which the paper takes r − 0.9 (−1.9 or −0.9); the
published runs use 2χ − 1 and χ − 0.5. All are a + bχ with b > 0, which does not change the maximisers of either sum, so
r = χ here: neither β, nor the scale, nor the outer operator changes which policies are optimal. The episode reading
maximises the expected *number* of starts at which the inner formula holds, while the task asks for the probability of
*at least one* (F) or of *all* (G).

discounted   value iteration V ← L V on (s, q), L V(s,q) = max_c Σ_s' p(s'|c) (χ(q') + γ V(s',q')), q' = δ(L(s'),q).
             With Δ = L V − V, V* lies within L V + γ/(1−γ)·[min Δ, max Δ] [Puterman94, Prop. 6.6.5 and Th. 6.6.6],
             so a choice c of (s, q) with
                 L V(s,q) − Σ_s' p(s'|c) (χ(q') + γ V(s',q')) > γ/(1−γ)·(max Δ − min Δ)
             is in no optimal policy (action elimination, §6.7). It stops when the right-hand side is below a tolerance;
             the span of Δ shrinks at least by γ per sweep. Constants added to V change nothing and are subtracted, so
             that rounding stays small compared with differences.
episode      backward induction over (t, s, q); choices are eliminated beyond the rounding of its sums.

A policy is optimal for the surrogate if and only if it takes only remaining choices wherever it goes, so P is reported
three times: with ties broken at random, as the published learners do, and the least and the greatest P over all
policies of the remaining choices, history-dependent ones included. If rounding or the tolerance leaves a choice too
many, that range is wider than the true one, never narrower.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, one_of, real
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.bounds import row_defect
from stltool.checking.check import CheckResult, Floats, check
from stltool.checking.induction import (
    Among,
    Budget,
    Doubles,
    Edges,
    Engine,
    Game,
    Probabilities,
    Progress,
    Single,
    Values,
    layers_of,
    solve,
)
from stltool.checking.induction.arithmetic import select
from stltool.choices import Form, Mixed, Mixtures, Table, Through, mixed
from stltool.display import Card, Displayed
from stltool.errors import SettingsError, named
from stltool.logic.fragment import check_fragment
from stltool.policy import Policy, require_door, with_flags
from stltool.product import Product, build_product, joined
from stltool.sizes import require_memory, require_time

Reading = Literal["discounted", "episode"]
READINGS: tuple[Reading, ...] = ("discounted", "episode")
Indices: TypeAlias = NDArray[np.int64]
Left: TypeAlias = NDArray[np.bool_]
"""(choices, Q): whether a choice of the model may be in an optimal policy at (s, q)."""

_RATE = 2e8  # multiply-adds per second, roughly
_EPSILON = 2.0**-52


@dataclass(frozen=True, eq=False, repr=False)
class SurrogateResult(Displayed):
    """The surrogate's optimum, judged by the task.

    product    the product that judges: exact verdicts of the task
    policy     uniform over the remaining choices; of (s, q), or of (t, s, q) in the episode reading, q the flags
    at_random  its check
    least, greatest  over all policies that take only remaining choices, with a policy that attains each
    optimum    the best of all policies for the task itself
    tolerance  a choice remains if it costs the surrogate's value no more than this
    sweeps     the number of sweeps of value iteration, or the horizon
    """

    product: Product
    reading: Reading
    gamma: float | None
    policy: Policy
    at_random: CheckResult
    least: CheckResult
    greatest: CheckResult
    optimum: CheckResult
    tolerance: float
    sweeps: int
    seconds: float
    status: str = "complete"

    def _card(self) -> Card:
        return Card(
            f"SurrogateResult: P = {self.at_random.probability!r} by the surrogate's optimum, {self.status}",
            [
                {
                    "least": self.least.probability,
                    "greatest": self.greatest.probability,
                    "the task's optimum": self.optimum.probability,
                },
                {
                    "reading": self.reading,
                    "gamma": self.gamma,
                    "task": f"{self.product.task_name} := {self.product.formula}",
                },
            ],
        )

    @property
    def gap(self) -> float:
        """P of the task's optimum minus P of the surrogate's, ties broken at random."""
        return self.optimum.probability - self.at_random.probability


def surrogate_optimum(
    product: Product,
    reading: Reading = "discounted",
    *,
    gamma: float = 0.999,
    tolerance: float = 1e-9,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> SurrogateResult:
    """The surrogate's optimal policies on the paper's flags, and the exact probability that they satisfy the task.

    reading    "discounted" as published, or "episode", eq. 9 (see the module's text)
    gamma      of the discounted reading, between 0 and 1; the published runs have 0.999, the paper prints 0.9999
    tolerance  a choice that costs the surrogate's value no more than this counts as optimal, in the discounted reading

    Raises FragmentError for a task that has no flags, SettingsError for an invalid setting, SizeError before allocating
    more memory than is available.
    """
    start = time.perf_counter()
    require_door("surrogate_optimum", product)
    one_of(reading, "reading", READINGS)
    gamma, tolerance = float(real(gamma, "gamma", "0.999")), float(real(tolerance, "tolerance", "1e-9"))
    for value, name in ((gamma, "gamma"), (tolerance, "tolerance")):
        if not 0 < value < 1:
            raise SettingsError(f"{named(name)} is {value!r}; it must be between 0 and 1, both excluded")
    function(progress, "surrogate_optimum's progress")
    check_fragment(product.formula)
    home = replace(with_flags(product), task_name=product.task_name)
    product.model.require_points()
    model = home.model
    if reading == "discounted":
        require_memory(
            8 * home.automaton.n_states * (4 * model.n_choices + model.n_states * model.most_choices),
            f"value iteration on {home.n_states} product states",
            "shorten the windows",
            memory_limit,
        )
        left, reached, sweeps = _discounted(home, gamma, tolerance, progress)
        form: Form = _uniform(home, left)
    else:
        budget = Budget(f"the surrogate's optimal choices on {home.n_states} product states", memory_limit, progress)
        form, reached = _episode(home, budget)
        sweeps = home.horizon
    policy = Policy(home, form)
    judge = home
    if not home.automaton.exact:
        judge = product if product.automaton.exact else build_product(product.model, product.formula)
    both, memory = (home, np.arange(home.automaton.n_states)) if judge is home else joined(judge, home)
    at_random = check(judge, policy, memory_limit=memory_limit)
    allowed = form if both is home else Through(form, memory)
    least, greatest = (
        check(both, _extreme(both, allowed, maximize, memory_limit), memory_limit=memory_limit)
        for maximize in (False, True)
    )
    status = "complete"
    if reading == "discounted" and reached > tolerance:
        status = f"limited by rounding: choices that lose up to {reached:.2g} cannot be distinguished from optimal ones"
    return SurrogateResult(
        product=judge,
        reading=reading,
        gamma=gamma if reading == "discounted" else None,
        policy=policy,
        at_random=at_random,
        least=least,
        greatest=greatest,
        optimum=check(judge, keep_policy=False, memory_limit=memory_limit),
        tolerance=reached,
        sweeps=sweeps,
        seconds=time.perf_counter() - start,
        status=status,
    )


def _discounted(home: Product, gamma: float, tolerance: float, progress: Progress | None) -> tuple[Left, float, int]:
    """(remaining choices, the tolerance reached, sweeps) of value iteration."""
    asked = tolerance * (1 - gamma) / gamma / 2  # the span to stop at; half is left for rounding
    most = 1 + max(1, math.ceil(math.log(asked) / math.log(gamma)))  # Δ₁ spans at most 1
    work = most * home.model.n_transitions * home.automaton.n_states
    require_time(work, _RATE, f"value iteration of {most} sweeps", "take a smaller gamma, or shorten the windows")
    chi, unit, matrix, start = _chi(home), _unit(home), home.model.matrix(), home.model.choice_start[:-1]
    state, after = np.arange(home.model.n_states)[:, None], home.automaton.delta[home.letter]
    values = np.zeros(home.shape)
    for sweeps in range(1, most + 1):
        W = (gamma * values + chi)[state, after]
        options = matrix @ W
        out = np.maximum.reduceat(options, start, axis=0)
        change = out - values
        span, error = float(change.max() - change.min()), unit * float(np.abs(W).max())
        threshold = gamma / (1 - gamma) * (span + 2 * error) + 2 * error
        if progress is not None:
            progress(sweeps, most)
        if span <= max(asked, 4 * error):
            break
        values = out - (out.max() + out.min()) / 2
    left: Left = np.repeat(out, np.diff(home.model.choice_start), axis=0) - options <= threshold
    return left, threshold, sweeps


class _Starts(Single):
    """The flags' automaton: nothing is decided before the horizon, and the verdict there is whether χ holds."""

    def __init__(self, home: Product) -> None:
        super().__init__(home.automaton)
        self._nothing = np.full(self.n_states, UNDECIDED, dtype=np.int8)

    def verdicts(self, t: int) -> NDArray[np.int8]:
        return self._automaton.verdicts(t) if t == self.horizon else self._nothing

    def alike(self, t: int) -> tuple[int, int]:
        return (t, t) if t == self.horizon else (0, self.horizon - 1)


class _Counted(Probabilities):
    """The expected number of steps with χ from step `first` on, inclusive; `layers` collects the remaining choices."""

    repeats = False

    def __init__(self, home: Product, first: int, within: Callable[[Indices, Indices], Indices]) -> None:
        super().__init__(True)
        self._first, self._chi, self._unit, self._most = first, _chi(home), _unit(home), home.model.most_choices
        self._within = within
        self._at, self._parts, self.error = -1, list[tuple[Indices, Floats]](), 0.0
        self.layers: list[Mixed] = []
        self._n_states = home.automaton.n_states

    def back(self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool) -> tuple[Values, None]:
        if t != self._at:
            self._at, self._parts = t, []
            self.error += self._unit * float(ahead.max())
        sums = self.sums(t, edges, ahead)
        values, _ = select(sums, edges, True, False)
        count = np.diff(edges.choices)
        owner = np.repeat(np.arange(len(edges)), count)
        left = values[owner] - sums <= 2 * self.error
        weights = np.zeros((len(edges), self._most))
        weights[owner, self._within(edges.s[owner], edges.choice)] = left
        weights /= weights.sum(axis=1, keepdims=True)
        self._parts.append((edges.s * self._n_states + edges.q, weights))
        return (values + self._chi[edges.q] if t >= self._first else values), None

    def layer(self, t: int, values: Sequence[Values]) -> Values:
        if self._parts:
            codes, weights = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
            found = mixed(self.layers[-1] if self.layers else None, t, codes, weights)
            if found.last > t:
                self.layers[-1] = found
            else:
                self.layers.append(found)
        return super().layer(t, values)


def _episode(home: Product, budget: Budget, engine: Engine = "auto") -> tuple[Form, float]:
    """(uniform over the remaining choices, the tolerance); χ counts from the first full window on."""
    game = replace(Game.of(home), automaton=_Starts(home), kept={})
    layers = layers_of(game, TRUE, engine=engine, live=False, sure=False, budget=budget)
    first = max(part.tau for part in check_fragment(home.formula).parts) - 1
    counted = _Counted(home, first, layers.within)
    solve(layers, counted, True)
    everything = np.ones((home.model.n_choices, 1), dtype=np.bool_)
    elsewhere = Through(_uniform(home, everything), np.zeros(home.automaton.n_states, dtype=np.int64))
    return Mixtures(home.shape, counted.layers[::-1], elsewhere, home.model.most_choices), 2 * counted.error


def _chi(home: Product) -> Floats:
    """(Q,) the truth of the inner formula that the flags show: the verdict at the horizon."""
    chi: Floats = (home.automaton.verdict_rows[-1] == TRUE).astype(np.float64)
    return chi


def _unit(home: Product) -> float:
    """How far a computed step may be from the exact one, including the defects of rows, relative to the largest
    value."""
    kinds = home.model.kinds if home.model.kinds is not None else home.model.rows
    return (kinds.longest + 5) * _EPSILON + float(row_defect(kinds))


def _uniform(home: Product, left: Left) -> Table:
    """Uniform over the remaining choices, (choices, Q)."""
    model = home.model
    owner = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    weights = np.zeros((model.n_states, left.shape[1], model.most_choices))
    weights[owner, :, np.arange(model.n_choices) - model.choice_start[owner]] = left
    weights /= weights.sum(axis=-1, keepdims=True)
    return Table(weights)


def _extreme(
    judge: Product, form: Form, maximize: bool, memory_limit: int | None = None, engine: Engine = "auto"
) -> Policy:
    """The policy of (t, s, q) with the greatest (least) P among those that take only choices that `form` may take."""
    budget = Budget(f"the choices left on {judge.n_states} product states", memory_limit)
    keep, goal = judge.model.unsigned_choice_type, TRUE if maximize else FALSE
    # where no choice changes anything, one of the remaining ones must still be taken: so it is listed
    layers = layers_of(Game.of(judge), goal, Among(form), engine=engine, live=False, keep=keep, budget=budget)
    choices = solve(layers, Doubles(maximize), maximize, keep).choices
    assert choices is not None
    return Policy(judge, choices)
