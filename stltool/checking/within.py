"""P(the task holds and the cost until its verdict is at most c), for every budget c up to a largest one.

The model with an allowance: its states are pairs (s, b) of a state and what is left of the budget, in units of which
every step's cost is a whole number, and for each s one more state, in which the budget is exceeded.

    (s, b)  —c, p→  (s', b − cost(s, c, s'))       if that is not below 0; else the budget is exceeded in s'

What is exceeded stays so, and decides the task as violated. So P in this model is P(Φ and cost ≤ b) in the given one,
over all policies that know what they have spent, with everything that a question about tasks has: its enclosure, its
fraction, nature's choice. A step is paid when its action is taken; nothing is paid after the verdict. One induction
serves all budgets: a run with budget b starts in (s₀, b). Costs have to be nonnegative: what is left could grow without
end otherwise. Source: the unfolding in [Andova03].
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of, real
from stltool.automata import FALSE
from stltool.checking.check import CheckResult, check
from stltool.checking.induction import Engine, Progress
from stltool.checking.paid import CostFunction, Paid
from stltool.checking.robust import Nature, robust_check
from stltool.checking.values import StateValues
from stltool.choices import FromStates, Through
from stltool.display import Card, Displayed, StateNames, probability_text
from stltool.errors import SettingsError, named
from stltool.models import MDP, Intervals
from stltool.models.fractions import Shares, over_one
from stltool.models.rows import Stored, spans, starts
from stltool.numbers import number_text, round_down, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product, with_early_verdicts
from stltool.sizes import require_memory

_SHOWN = 10  # rows in a notebook


@dataclass(frozen=True, eq=False, repr=False)
class CostDistribution(Displayed):
    """P(the task holds and its cost is at most c), for every budget c that costs can add up to.

    cost          its name, or that of the function
    question      "maximum" | "minimum" (over all policies, for each budget by itself) | "policy"
    at_most       the largest budget that was asked for
    budgets       (n,) ascending from 0, multiples of the unit of which every step's cost is a whole number
    lower, upper  (n,): lower ≤ P ≤ upper, rounding included
    fractions     the exact values, if they were asked for
    product       the task on the model with an allowance, whose runs start with the largest budget
    policy        the policy that attains the values there, by what is left of the budget; or the given one
    """

    product: Product
    cost: str
    question: Literal["maximum", "minimum", "policy"]
    nature: Nature | None
    at_most: Fraction
    budgets: tuple[Fraction, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    fractions: tuple[Fraction, ...] | None
    policy: Policy
    seconds: float

    def at(self, budget: float | Fraction) -> tuple[float, float]:
        """(lower, upper) bounds on P(the task holds and its cost is at most `budget`).

        Raises SettingsError for budgets above the largest.
        """
        place = self._place(budget)
        return (float(self.lower[place]), float(self.upper[place])) if place >= 0 else (0.0, 0.0)

    def exactly(self, budget: float | Fraction) -> Fraction | None:
        """The same as a fraction, if that was asked for."""
        place = self._place(budget)
        return None if self.fractions is None else self.fractions[place] if place >= 0 else Fraction(0)

    def smallest(self, at_least: float | Fraction) -> Fraction | None:
        """The smallest budget with which P is proved to be at least `at_least`; None if none of these suffices."""
        bound = real(at_least, "smallest's at_least", "0.9")
        ends = self.lower.tolist() if self.fractions is None else self.fractions
        return next((c for c, lower in zip(self.budgets, ends, strict=True) if lower >= bound), None)

    def steps(self) -> list[tuple[Fraction, float, float]]:
        """(budget, lower, upper) of the budgets at which P changes, and of the largest."""
        rows = list(zip(self.budgets, self.lower.tolist(), self.upper.tolist(), strict=True))
        return [row for before, row in zip([None, *rows], rows, strict=False) if _changed(before, row)] or rows[:1]

    def _place(self, budget: float | Fraction) -> int:
        given = _decimal(real(budget, "the budget", "12"))
        if given > self.at_most:
            raise SettingsError(
                f"the budget {number_text(given)} is above the largest that was asked for, "
                f"{number_text(self.at_most)}; raise {named('at_most')}"
            )
        unit = self.budgets[1] if len(self.budgets) > 1 else Fraction(1)
        return min(math.floor(given / unit), len(self.budgets) - 1)

    def _card(self) -> Card:
        asked = {"maximum": "the maximum", "minimum": "the minimum", "policy": "of the policy"}[self.question]
        steps = self.steps()
        rows = [(number_text(c), probability_text(low), probability_text(high)) for c, low, high in steps[:_SHOWN]]
        return Card(
            f"CostDistribution: P(task and {self.cost} <= c), {asked}, {len(self.budgets)} budgets",
            [
                {"largest budget": number_text(self.at_most), "P at least": probability_text(self.lower[-1])},
                {"task": f"{self.product.task_name} := {self.product.formula}", "model": self.product.model.name},
            ],
            (("c", "P at least", "P at most"), rows),
            more=max(0, len(steps) - _SHOWN),
        )


def _changed(before: tuple[Fraction, float, float] | None, row: tuple[Fraction, float, float]) -> bool:
    return before is None or before[1:] != row[1:]


def cost_distribution(
    product: Product,
    cost: str | CostFunction,
    at_most: float | Fraction,
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    exact: bool = False,
    nature: Nature = "against",
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> CostDistribution:
    """P(the task holds and the cost until its verdict is at most c), for every c up to `at_most`.

    Under `policy`, or the maximum (minimum) over all policies for each c by itself; these know what they have spent.
    `cost` is as in `expected_cost`, and must be nowhere negative; fractions are brought over one denominator. `exact`
    adds fractions; `nature` is for interval probabilities. Memory and time grow with `at_most` over the unit of costs.

    Raises SettingsError for a negative cost or budget, NameLookupError for a cost that the model does not have,
    PolicyError as `check`, SizeError before allocating more memory than is available.
    """
    began = time.perf_counter()
    require_door("cost_distribution", product, policy)
    flag(maximize, "cost_distribution's maximize")
    flag(exact, "cost_distribution's exact")
    one_of(nature, "nature", get_args(Nature))
    one_of(engine, "engine", get_args(Engine))
    function(progress, "cost_distribution's progress")
    most = _decimal(real(at_most, "cost_distribution's at_most", "12"))
    if most < 0:
        raise SettingsError(f"cost_distribution's at_most is {number_text(most)}; give a budget of at least 0")
    product.model.require_probabilities()
    if product.model.parameters:
        product.model.require_points()
    judge, judged = policy.on(product) if policy is not None else (product, None)
    judge = with_early_verdicts(judge)
    allowance = Allowance.of(judge, cost, most, memory_limit)
    every = allowance.product(judge, every_budget=True)
    largest = allowance.product(judge, every_budget=False)
    lifted = allowance.lifted(every, judged) if judged is not None else None
    found: CheckResult
    if product.model.uncertain:
        found = robust_check(
            every, lifted, maximize=maximize, nature=nature, exact=exact, values="initial", engine=engine,
            memory_limit=memory_limit, progress=progress,
        )  # fmt: skip
    else:
        found = check(
            every, lifted, maximize=maximize, exact=exact, values="initial", engine=engine, memory_limit=memory_limit,
            progress=progress,
        )  # fmt: skip
    assert found.values is not None
    lower, upper, fractions = _mean(found.values, judge.model, allowance.n_budgets)
    if policy is None:
        assert found.policy is not None
        policy = Policy(largest, found.policy.form)
    budgets = tuple(allowance.unit * k for k in range(allowance.n_budgets))
    return CostDistribution(
        largest, allowance.paid.name, found.question, found.nature, most, budgets, lower, upper, fractions, policy,
        time.perf_counter() - began,
    )  # fmt: skip


def _decimal(value: float | Fraction) -> Fraction:
    return value if isinstance(value, Fraction) else Fraction(repr(float(value)))


def _mean(
    values: StateValues, model: MDP, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[Fraction, ...] | None]:
    """The bounds for each budget: means over the model's initial states."""
    shares = [model.initial_share(s) for s in np.flatnonzero(model.initial).tolist()]
    if values.fractions is not None:
        table = [values.fractions[i * n : (i + 1) * n] for i in range(len(shares))]
        exact = tuple(
            sum((share * row[k] for share, row in zip(shares, table, strict=True)), Fraction(0)) for k in range(n)
        )
        return np.array(list(map(round_down, exact))), np.array(list(map(round_up, exact))), exact
    if shares == [1]:
        return values.lower, values.upper, None
    missing = model.initial_defect
    sums = [
        [sum((share * Fraction(x) for share, x in zip(shares, column, strict=True)), Fraction(0)) for column in rows]
        for rows in (ends.reshape(-1, n).T.tolist() for ends in (values.lower, values.upper))
    ]
    lower = [round_down(max(total - missing, Fraction(0))) for total in sums[0]]
    upper = [round_up(min(total + missing, Fraction(1))) for total in sums[1]]
    return np.array(lower), np.array(upper), None


@dataclass(frozen=True, eq=False)
class Allowance:
    """A model with what is left of a budget (see the module's text).

    unit       every step's cost is a whole number of these
    n_budgets  0, 1, … units
    base       (n,) the given model's state of each state: first the exceeded one, then by what is left
    """

    model: MDP
    paid: Paid
    unit: Fraction
    n_budgets: int
    base: NDArray[np.int64]

    @classmethod
    def of(cls, product: Product, cost: str | CostFunction, most: Fraction, memory_limit: int | None) -> Allowance:
        model = product.model
        paid = Paid.of("cost_distribution", model, cost)
        if not paid.nowhere_negative:
            raise SettingsError(
                f"cost {paid.name} is negative somewhere, so what is left of a budget could grow; shift it"
            )
        before, along, denominator = paid.exact
        common = math.gcd(*map(int, before.tolist()), *(map(int, along.tolist()) if along is not None else ()))
        unit = Fraction(common, denominator) if common else most if most else Fraction(1)
        n = math.floor(most / unit) + 1
        rows, width = model.rows, n + 1
        n_entries = width * (len(rows.target) + model.n_states)
        require_memory(
            100 * n_entries + 50 * width * (model.n_choices + model.n_states * (1 + len(model.signals))),
            f"a budget of {n - 1} units of {number_text(unit)} in each of {model.n_states} states",
            "round the costs to a larger unit, or take a smaller budget",
            memory_limit,
        )
        most_units = n * common  # so that what exceeds every budget fits into 64 bits
        spent = [np.minimum(part, most_units) // max(common, 1) for part in (before, along) if part is not None]
        before, along = spent[0].astype(np.int64), spent[1].astype(np.int64) if len(spent) > 1 else None
        base = np.repeat(np.arange(model.n_states), width)
        left = np.tile(np.arange(-1, n), model.n_states)
        over = left < 0
        first, count = rows.choice_start[base], np.where(over, 1, np.diff(rows.choice_start)[base])
        choice = spans(first, first + count)
        of_choice = np.repeat(np.arange(len(base)), count)
        length = np.where(over[of_choice], 1, np.diff(rows.row_start)[choice])
        entry = spans(rows.row_start[choice], rows.row_start[choice] + length)
        of_entry = np.repeat(np.arange(len(choice)), length)
        rest = left[of_choice[of_entry]] - before[choice[of_entry]]
        if along is not None:
            rest -= along[entry]
        target = rows.target[entry].astype(np.int64) * width + np.maximum(rest, -1) + 1
        stays = over[of_choice[of_entry]]
        target[stays] = of_choice[of_entry][stays]
        exact, intervals = None, None
        if rows.given_exactly:
            exact = Shares(np.where(stays, rows.denominator, rows.numerator[entry]), rows.denominator)
        if rows.intervals is not None:
            known = rows.intervals.at(entry)
            given = known.given
            if given is not None:
                first_end, last_end = (
                    Shares(np.where(stays, each.denominator, each.numerator), each.denominator) for each in given
                )
                given = first_end, last_end
            lower, upper = (np.where(stays, 1.0, end) for end in (known.lower, known.upper))
            intervals = Intervals(lower, upper, given, known.rounded)
        source = Stored(
            starts(count), model.choice_action[choice], starts(length), target.astype(np.int32),
            np.where(stays, 1.0, rows.probability[entry]), exact, intervals,
        )  # fmt: skip

        def name(state: int) -> str:
            s, k = divmod(state, width)
            left = f"{number_text(unit * (k - 1))} of {paid.name} left" if k else f"{paid.name} exceeded"
            return f"{model.state_name(s)}; {left}"

        nothing = np.zeros(len(base))
        nothing[n] = 1.0
        with_budget = MDP(
            source, nothing,
            signals={name: values[base] for name, values in model.signals.items()},
            labels={name: values[base] for name, values in model.labels.items()},
            action_names=model.action_names, state_names=StateNames(len(base), name),
            name=f"{model.name} with {number_text(unit * (n - 1))} of {paid.name}", notes=model.notes,
        )  # fmt: skip
        return cls(with_budget, paid, unit, n, base)

    def product(self, product: Product, every_budget: bool) -> Product:
        """The product with runs that start with the largest budget, or with each at equal shares."""
        first = np.flatnonzero(product.model.initial)
        width = self.n_budgets + 1
        budgets = np.arange(1, width) if every_budget else np.array([width - 1])
        places = (first[:, None] * width + budgets).ravel()
        shares = [product.model.initial_share(int(s)) / len(budgets) for s in first.tolist()]
        numerator, denominator = over_one(shares)
        exact = np.zeros(len(self.base), dtype=numerator.dtype)
        exact[places] = np.repeat(numerator, len(budgets))
        initial = np.zeros(len(self.base))
        initial[places] = np.repeat([float(share) for share in shares], len(budgets))
        model = replace(self.model, initial=initial, exact_initial=Shares(exact, denominator))
        automaton = product.automaton.with_outcome(FALSE)
        exceeded = np.arange(len(self.base)) % width == 0
        letter = np.where(exceeded, product.automaton.n_letters, product.letter[self.base]).astype(np.int32)
        return replace(product, model=model, automaton=automaton, letter=letter)

    def lifted(self, product: Product, policy: Policy) -> Policy:
        """A policy that ignores what is left of the budget."""
        n = product.automaton.n_states
        memory = np.minimum(np.arange(n), n - 2)  # after the budget is exceeded, nothing is asked
        return Policy(product, Through(FromStates(policy.form, self.base), memory))
