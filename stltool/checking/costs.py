"""Expected costs: E Σ g(s_t, c_t, s_{t+1}) until the verdict is decided or until the horizon, by backward induction.

    V_t(s,q) = 0                                                              once the sum ends
             = opt_c g(s) + g(c) + Σ_s' P(s'|c) (g(s,c,s') + V_{t+1}(s', δ(L(s'),q)))      otherwise

The sum ends where the verdict is decided, which no sequence of states can change then, or only after h steps (`until`).
Its optimum over all policies is reached by a deterministic policy of (t, s, q) [Puterman94, ch. 4].

**Enclosure.** With G ≥ |g| and n roundings along every path, the computed value of each policy misses its exact one by
at most γ_n·h·G, whatever the signs, and so does the optimum, for rounding is monotone: the computed optimum is that of
the computed values [Higham02, §3.1]. Where no step costs less than 0, the error is also at most γ_n times the value
(bounds.py). Rows that do not sum to 1 add their defects times h·G.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.bounds import around, can_underflow, compounded, defect, roundings, row_defect
from stltool.checking.check import undefined
from stltool.checking.enclosed import enclosed_rows
from stltool.checking.induction import (
    EVERYTHING,
    Arithmetic,
    Budget,
    Edges,
    Engine,
    Following,
    Game,
    Integers,
    Progress,
    Silent,
    Single,
    Values,
    layers_of,
    solve,
)
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.paid import CostFunction, Paid
from stltool.checking.rational import require_exact, require_room
from stltool.display import Card, Displayed
from stltool.errors import PolicyError, SettingsError
from stltool.models.rows import Rows, least_positive
from stltool.numbers import round_down, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product, with_early_verdicts

Until: TypeAlias = Literal["verdict", "horizon"]
_LARGEST = 1e100  # over the horizon
_U, _UNDERFLOW = Fraction(1, 2**53), Fraction(1, 2**1073)
_SUMMED = 1 + Fraction(1, 2**50)  # the largest cost of a step is a sum of doubles, itself rounded


@dataclass(frozen=True, eq=False, repr=False)
class ExpectedCost(Displayed):
    """An expected cost: lower ≤ exact value ≤ upper, rounding included, for the model as given.

    cost      its name, or that of the function
    question  "minimum" | "maximum" (over all policies) | "policy"
    until     "verdict": the sum ends when the task's verdict is decided; "horizon": after `product.horizon` steps
    policy    the policy that attains the value, or the given one
    fraction  the exact value, if it was asked for; lower and upper are then the doubles next to it
    seconds   wall time
    """

    product: Product
    cost: str
    question: Literal["minimum", "maximum", "policy"]
    until: Until
    value: float
    lower: float
    upper: float
    policy: Policy
    seconds: float
    fraction: Fraction | None = None

    def _card(self) -> Card:
        asked = "of the policy" if self.question == "policy" else f"{self.question} over all policies"
        ends = "until the verdict" if self.until == "verdict" else f"over {self.product.horizon} steps"
        return Card(
            f"ExpectedCost: E[{self.cost}] = {self.value!r}, {asked}, {ends}",
            enclosed_rows(self.product, self.lower, self.upper, self.fraction),
        )


def expected_cost(
    product: Product,
    cost: str | CostFunction,
    policy: Policy | None = None,
    *,
    maximize: bool = False,
    exact: bool = False,
    until: Until = "verdict",
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> ExpectedCost:
    """The expected sum of a cost along a run: under `policy`, or the least (greatest) over all policies.

    `cost` is the name of a cost of the model, of a signal or of a label (1 where it holds), or a function of a state's
    and an action's name; its numbers may be negative. A step is paid when its action is taken: the state in which the
    sum ends costs nothing. `until="verdict"` stops paying as soon as no sequence of the model's states can change the
    verdict, so a policy may pay less by deciding the task sooner, for or against; `until="horizon"` pays for all
    `product.horizon` steps. After the verdict, a policy of `check` takes the first action of every state. `exact=True`
    adds the exact fraction: numbers in decimals and fractions mean exactly that.

    Raises NameLookupError for a cost that the model does not have; PolicyError if the policy belongs to another task or
    model, or defines no action where it is needed (after the verdict too, until the horizon); SizeError before
    allocating more memory than is available; ModelError if an exact answer is asked for and rows do not sum to 1.
    """
    began = time.perf_counter()
    require_door("expected_cost", product, policy)
    flag(maximize, "expected_cost's maximize")
    flag(exact, "expected_cost's exact")
    one_of(until, "until", get_args(Until))
    one_of(engine, "engine", get_args(Engine))
    function(progress, "expected_cost's progress")
    product.model.require_points()
    judge, judged = policy.on(product) if policy is not None else (product, None)
    if until == "verdict":
        judge = with_early_verdicts(judge)
    paid = Paid.of("expected_cost", judge.model, cost)
    most = Fraction(paid.largest) * judge.horizon
    if most > _LARGEST:
        raise SettingsError(f"cost {paid.name} is up to {paid.largest:g} per step; scale it to numbers below 1e90")
    game = replace(Game.of(judge), rows=judge.model.rows, kept={})  # its edges are numbered as in the model
    if until == "horizon":
        game = replace(game, automaton=_ToTheEnd(game.automaton))
    allowed = EVERYTHING if judged is None else Following(judged.form)
    keep = judge.model.unsigned_choice_type if judged is None else None
    budget = Budget(f"the expected cost over {judge.n_states} product states", memory_limit, progress)
    try:
        layers = layers_of(game, TRUE, allowed, engine=engine, live=False, sure=False, keep=keep, budget=budget)
        if exact:
            require_exact(judge.model, layers.kinds)
            require_room(layers, 64, memory_limit=memory_limit)
        arithmetic = _ExactSums(layers.rows.denominator, paid) if exact else _Sums(paid)
        found = solve(layers, arithmetic, maximize, keep)
    except Silent:
        assert judged is not None
        if until == "verdict":
            raise undefined(judge, judged) from None
        raise PolicyError(
            "the policy defines no action in some pair that it reaches before the horizon, perhaps where the verdict "
            "is decided already; use until='verdict', or give it actions there"
        ) from None
    fraction = None
    if isinstance(arithmetic, _ExactSums):
        shares = (judge.model.initial_share(s) for s in game.first.tolist())
        entries = (arithmetic.fraction(value) for value in found.entry.tolist())
        fraction = sum((share * value for share, value in zip(shares, entries, strict=True)), Fraction(0))
        value, lower, upper = float(fraction), round_down(fraction), round_up(fraction)
    else:
        value = math.fsum(judge.model.initial[game.first] * found.entry)
        mixtures = judged.form.mixtures() if judged is not None and not judged.deterministic else None
        lower, upper = _enclosure(judge, layers.kinds, paid, value, most, mixtures)
    if found.choices is not None:
        policy = Policy(product, found.choices)
    assert policy is not None  # given, or found
    question: Literal["minimum", "maximum", "policy"]
    question = "policy" if judged is not None else "maximum" if maximize else "minimum"
    seconds = time.perf_counter() - began
    return ExpectedCost(product, paid.name, question, until, value, lower, upper, policy, seconds, fraction)


class _ToTheEnd:
    """A task's automaton whose states stay undecided before the horizon, so that every run goes on until then."""

    def __init__(self, automaton: Any) -> None:
        self._automaton: Single = automaton
        self.horizon, self.n_states = automaton.horizon, automaton.n_states
        self.enter, self.moves, self.keeps_numbers = automaton.enter, automaton.moves, automaton.keeps_numbers

    def verdicts(self, t: int) -> NDArray[np.int8]:
        return np.full(self.n_states, UNDECIDED if t < self.horizon else FALSE, dtype=np.int8)

    def alike(self, t: int) -> tuple[int, int]:
        return (0, self.horizon - 1) if t < self.horizon else (t, t)


class _Sums(Arithmetic):
    """The expected cost to come, in doubles."""

    def __init__(self, paid: Paid) -> None:
        self._paid = paid

    def ends(self, t: int) -> tuple[float, float]:
        return 0.0, 0.0

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        to_come = ahead[edges.child]
        if self._paid.along is not None:
            to_come = to_come + self._paid.along[edges.entry]
        return self._paid.before[edges.choice] + row_sums(self.rows.probability[edges.entry] * to_come, edges.start)


class _ExactSums(Integers):
    """The same without any rounding: A_t = V_t·K·D^(h−t), for costs over the denominator K."""

    def __init__(self, denominator: int, paid: Paid) -> None:
        super().__init__(denominator, maximize=True)
        self._before, self._along, self._unit = paid.exact
        self._ahead = 1

    def ends(self, t: int) -> tuple[int, int]:
        return 0, 0

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        if self._made != t:
            self._ahead = self.one
        return super().back(t, edges, ahead, maximize, keep)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        to_come = ahead[edges.child]
        if self._along is not None:
            to_come = to_come + self._along[edges.entry] * self._ahead
        sums: Values = np.add.reduceat(self._numerator[edges.entry] * to_come, edges.start[:-1])
        sums += self._before[edges.choice] * (self._ahead * self.denominator)
        return sums

    def fraction(self, value: int) -> Fraction:
        return Fraction(value, self.one * self._unit)


def _enclosure(
    product: Product, kinds: Rows, paid: Paid, value: float, most: Fraction, mixtures: NDArray[np.float64] | None
) -> tuple[float, float]:
    if not paid.largest:
        return 0.0, 0.0
    h, initial = product.horizon, product.model.initial
    mixed, weight_defect, least = 0, Fraction(0), min(kinds.least, least_positive(initial))
    if mixtures is not None:
        mixed, weight_defect = mixtures.shape[1], defect(mixtures.tolist())
        least = min(least, least_positive(mixtures))
    missing = h * (row_defect(kinds) + weight_defect) + product.model.initial_defect
    missing = most * compounded(missing, missing)
    # a sweep also adds two costs, each of them read, one of them a sum of two
    n_roundings = roundings(h, kinds.longest + 5, mixed)
    underflow = can_underflow((2 if mixed else 1) * h + 2, min(least, *(least_positive(abs(p)) for p in paid.arrays)))
    if paid.nowhere_negative:
        lower, upper = around(value, n_roundings, missing, underflow)
        return round_down(max(lower, Fraction(0))), round_up(max(upper, Fraction(0)))
    gamma = n_roundings * _U / (1 - n_roundings * _U) if 2 * n_roundings * _U < 1 else Fraction(2**60)
    error = gamma * _SUMMED * (most + missing) + missing + n_roundings * _UNDERFLOW
    return round_down(Fraction(value) - error), round_up(Fraction(value) + error)
