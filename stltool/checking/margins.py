"""`robustness_distribution`: by how much a task holds. P(ρ ≥ r) for every margin r that runs can have.

ρ(Φ) ≥ r is itself a task (logic/margins.py), whose predicates are read from the margins of the model's states. There
are finitely many, so ρ takes finitely many values, and between two of them P(ρ ≥ r) does not change. One automaton
serves all r; only the letters of states depend on r, and values with equal letters share one check. Each is an ordinary
check, with its enclosure. A policy is evaluated on the join of that automaton with its own.

The mean follows from the distribution, with values r_0 < … < r_n, where ρ is finite:

    E[ρ] = r_0 + Σ_{j ≥ 1} (r_j − r_{j−1}) · P(ρ ≥ r_j)

Over all policies, the greatest sum is that of all these tasks tracked together, by their joint automaton. Where it is
too large: different thresholds have different best policies, so the sum of maxima is an upper bound on max E[ρ]; the
policy that is best for r_j alone has a mean of at least r_0 + (r_j − r_0) · max P(ρ ≥ r_j). Minimum:
likewise.
"""

from __future__ import annotations

import bisect
import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, real, require, whole
from stltool.automata import compile_automaton, join_automata
from stltool.automata.compile import atoms_of
from stltool.checking.check import CheckResult, check
from stltool.checking.induction import Engine, Progress
from stltool.checking.weighted import Criteria, greatest
from stltool.choices import Through
from stltool.display import Card, Displayed, probability_text
from stltool.errors import FragmentError, PolicyError, SettingsError, SizeError, named
from stltool.logic.formula import Formula, Not, bounded_formula_of
from stltool.logic.margins import thresholded
from stltool.logic.shifts import has_delays
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.monitoring.states import margins, truth
from stltool.numbers import round_down, round_up
from stltool.policy import Policy
from stltool.product import JointProduct, Product, joined, require_names

Floats: TypeAlias = NDArray[np.float64]

_SHOWN = 10  # rows in a notebook
_LOADING = 2.0  # seconds of checks after which the faster engine is loaded, which takes about as long


@dataclass(frozen=True, eq=False, repr=False)
class RobustnessDistribution(Displayed):
    """How the robustness ρ of a task is distributed.

    values    (n,) margins, ascending: all that ρ may have, +inf only if it may; or those that were asked for
    lower     (n,) bounds on P(ρ ≥ value), for each value's own best policy unless a policy was given
    upper     (n,)
    mean      (lower, upper) bounds on E[ρ], of the optimum on its greatest (least) over all policies; None if ρ may
              be infinite (under some policy), as where labels decide, or if margins were asked for
    question  "maximum" | "minimum" (over all policies) | "policy"
    """

    task_name: str
    formula: Formula
    model: MDP
    horizon: int
    question: Literal["maximum", "minimum", "policy"]
    values: Floats
    lower: Floats
    upper: Floats
    mean: tuple[float, float] | None
    complete: bool
    policy: Policy | None
    seconds: float

    @property
    def survival(self) -> tuple[Floats, Floats]:
        """(lower, upper) bounds on P(ρ ≥ value)."""
        return self.lower, self.upper

    def at(self, margin: float) -> tuple[float, float]:
        """(lower, upper) bounds on P(ρ ≥ margin). Raises SettingsError if another margin was asked for."""
        asked = float(real(margin, "at's margin", "0.1"))
        place = int(np.searchsorted(self.values, asked))
        if not self.complete and (place == len(self.values) or self.values[place] != asked):
            raise SettingsError(f"the margin {asked:g} was not asked for; leave margins out, or add it")
        return (float(self.lower[place]), float(self.upper[place])) if place < len(self.values) else (0.0, 0.0)

    def largest(self, at_least: float | Fraction) -> float:
        """The largest of the values whose probability is proved to be at least `at_least`; −inf if there is none."""
        bound = probability_of(at_least, "largest's at_least")
        kept = [r for r, lower in zip(self.values.tolist(), self.lower.tolist(), strict=True) if lower >= bound]
        return max(kept, default=-math.inf)

    def steps(self) -> list[tuple[float, float, float]]:
        """(value, lower, upper) of the values after which the probability changes; the last that is not 0 ends them."""
        rows = list(zip(self.values.tolist(), self.lower.tolist(), self.upper.tolist(), strict=True))
        last = [row for row, after in itertools.zip_longest(rows, rows[1:]) if after is None or row[1:] != after[1:]]
        return [row for row in last if row[2] > 0] or last

    def _card(self) -> Card:
        asked = {"maximum": "the maximum", "minimum": "the minimum", "policy": "of the policy"}[self.question]
        steps = self.steps()
        rows = [(f"{r:g}", probability_text(low), probability_text(high)) for r, low, high in steps[:_SHOWN]]
        return Card(
            f"RobustnessDistribution: P(robustness >= r), {asked}, {len(self.values)} values",
            [
                {"mean": "between {:.6g} and {:.6g}".format(*self.mean) if self.mean is not None else None,
                 "more": len(steps) - _SHOWN if len(steps) > _SHOWN else None},
                {"task": f"{self.task_name} := {self.formula}", "model": self.model.name},
            ],
            (("r", "P at least", "P at most"), rows),
        )  # fmt: skip


def robustness_distribution(
    model: MDP,
    task: Formula | Task,
    policy: Policy | None = None,
    *,
    margins: Sequence[float] | None = None,
    maximize: bool = True,
    most_values: int = 1000,
    mean_states: int = 10_000,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> RobustnessDistribution:
    """P(ρ ≥ r) for every margin r: under `policy`, or the maximum (minimum) over all policies for each r by itself.

    `policy` may be for this task, or any other on the same model whose horizon is not shorter. `margins`: only these r.
    `most_values` limits how many values are computed. The greatest (least) mean over all policies is computed by the
    joint automaton of all values, up to `mean_states` states of it; beyond, its bounds are those of single values.

    Raises FragmentError for comparisons of several steps, SizeError if ρ may have too many values, PolicyError if the
    policy does not fit, and what `build_product` and `check` raise.
    """
    start = time.perf_counter()
    flag(maximize, "robustness_distribution's maximize")
    function(progress, "robustness_distribution's progress")
    most = whole(most_values, "robustness_distribution's most_values", 1)
    joint_states = whole(mean_states, "robustness_distribution's mean_states", 0)
    asked = Thresholds("robustness_distribution", model, task, policy, maximize, memory_limit)
    if margins is not None:
        require(margins, (list, tuple, np.ndarray), "robustness_distribution's margins", "give a list, such as [0.1]")
        if len(margins) == 0:
            raise SettingsError("robustness_distribution's margins are empty; give one or more, or leave them out")
        endless = [isinstance(r, float) and r == math.inf for r in margins]
        given = [math.inf if e else float(real(r, "one of the margins")) for e, r in zip(endless, margins, strict=True)]
        values = np.unique(given)
    else:
        values = np.append(asked.values, np.inf)
    if len(values) > most:
        raise SizeError(
            f"the robustness of {asked.name} may have {len(values)} values, more than {most}; ask for one of them: "
            f"{named('margin', 'margins=[0.1]')}{named('most_values', ', or raise most_values')}"
        )
    products = asked.products(values)
    question: Literal["maximum", "minimum", "policy"]
    question = "policy" if policy is not None else "maximum" if maximize else "minimum"
    lower, upper = _survival(asked, products, progress)
    mean = None
    if margins is None:
        finite = len(values) > 1 and upper[-1] == 0 and lower[0] == 1
        if finite and policy is None:  # whatever the policy
            finite = asked.check(products[0], not maximize).lower == 1 and asked.check(products[-1], True).upper == 0
        if finite:
            mean = _mean(values[:-1].tolist(), lower.tolist(), upper.tolist(), question)
            if policy is None and mean[0] < mean[1]:
                mean = _within(mean, _joint_mean(model, asked, maximize, upper, joint_states, memory_limit))
        if upper[-1] == 0:
            values, lower, upper = values[:-1], lower[:-1], upper[:-1]
    return RobustnessDistribution(
        asked.name, asked.formula, model, products[0].horizon, question, values, lower, upper, mean,
        margins is None, policy, time.perf_counter() - start,
    )  # fmt: skip


def largest_margin(
    model: MDP,
    task: Formula | Task,
    at_least: float | Fraction,
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    memory_limit: int | None = None,
) -> tuple[float, CheckResult | None]:
    """The largest margin r for which P(ρ ≥ r) ≥ `at_least` is proved, of `policy` or of the best policy for that r.

    `maximize=False` asks for the largest that every policy keeps. Returns it with the check of ρ ≥ r, whose `policy`
    attains it; (−inf, None) if there is none. By bisection over the values that ρ may have, since P(ρ ≥ r) falls in r.
    Raises as `robustness_distribution`, and SettingsError unless 0 < `at_least` ≤ 1.
    """
    bound = probability_of(at_least, "largest_margin's at_least")
    flag(maximize, "largest_margin's maximize")
    asked = Thresholds("largest_margin", model, task, policy, maximize, memory_limit)
    values = np.append(asked.values, np.inf)
    best: tuple[float, CheckResult | None] = (-math.inf, None)
    first, last = 0, len(values)  # the answer is values[first - 1]
    while first < last:
        middle = (first + last) // 2
        [product] = asked.products(values[middle : middle + 1])
        found = asked.check(product, keep_policy=True)
        if found.lower >= bound:
            best, first = (float(values[middle]), found), middle + 1
        else:
            last = middle
    return best


def _survival(asked: Thresholds, products: Sequence[Product], progress: Progress | None) -> tuple[Floats, Floats]:
    """Bounds on P(ρ ≥ r) for each of the products, in ascending order of r.

    P falls in r: up to an r that has 1, and from one that has 0, nothing need be checked. Where these begin is found by
    bisection.
    """
    n = len(products)
    lower, upper = np.ones(n), np.zeros(n)
    known: dict[bytes, CheckResult] = {}

    def bounds(j: int) -> tuple[float, float]:
        key = products[j].letter.tobytes()
        if key not in known:
            known[key] = asked.check(products[j])
        lower[j], upper[j] = known[key].lower, known[key].upper
        if progress is not None:
            progress(len(known), n)
        return lower[j], upper[j]

    first = bisect.bisect_left(range(n), True, key=lambda j: bounds(j)[0] < 1)  # that is not certain
    last = bisect.bisect_left(range(n), True, lo=first, key=lambda j: bounds(j)[1] == 0)  # that is impossible
    for j in range(first, last):
        bounds(j)
    upper[:first], lower[last:] = 1.0, 0.0
    if progress is not None:
        progress(n, n)
    return lower, upper


def _mean(values: list[float], lower: list[float], upper: list[float], question: str) -> tuple[float, float]:
    """Bounds on E[ρ], from bounds on P(ρ ≥ value) of all finite values (longer lists are cut)."""
    r = [Fraction(value) for value in values]
    below, above = ([Fraction(p) for p in bounds[: len(r)]] for bounds in (lower, upper))
    gaps = [b - a for a, b in itertools.pairwise(r)]
    least = r[0] + sum((gap * p for gap, p in zip(gaps, below[1:], strict=True)), Fraction(0))
    most = r[0] + sum((gap * p for gap, p in zip(gaps, above[1:], strict=True)), Fraction(0))
    if question == "maximum":  # of one value's best policy: ρ ≥ that value, or else ρ ≥ r_0
        least = max(r[0] + (value - r[0]) * p for value, p in zip(r, below, strict=True))
    elif question == "minimum":  # ρ is below that value, so at most the one before it, or else at most the last
        most = min([r[-1], *(a + (r[-1] - a) * p for a, p in zip(r, above[1:], strict=False))])
    return round_down(least), round_up(most)


def _within(bounds: tuple[float, float], others: tuple[float, float] | None) -> tuple[float, float]:
    return bounds if others is None else (max(bounds[0], others[0]), min(bounds[1], others[1]))


def _joint_mean(
    model: MDP, asked: Thresholds, maximize: bool, most: Floats, most_states: int, memory_limit: int | None
) -> tuple[float, float] | None:
    """Bounds on the greatest (least) E[ρ] over all policies, where ρ is finite; None if that takes too many states.

    The weighted sum of the tasks ρ ≥ r_j, which a policy has to track together; the least is minus the greatest
    E[ρ(¬Φ)]. `most`: upper bounds on P(ρ ≥ value), if for the greatest.
    """
    if not maximize:
        asked = Thresholds("robustness_distribution", model, Not(asked.formula), None, True, memory_limit)
    values = asked.values
    kept: dict[bytes, Product] = {}
    weights: dict[bytes, Fraction] = {}
    base = Fraction(float(values[0]))
    products = asked.products(values)
    least, _ = _survival(Thresholds("", model, asked.formula, None, False, memory_limit), products, None)
    if not maximize:
        _, most = _survival(asked, products, None)
    for j in range(1, len(values)):
        gap = Fraction(float(values[j])) - Fraction(float(values[j - 1]))
        if least[j] == 1:
            base += gap
        elif most[j] > 0:
            key = products[j].letter.tobytes()
            kept.setdefault(key, products[j])
            weights[key] = weights.get(key, Fraction(0)) + gap
    if not kept:
        return round_down(base), round_up(base)
    tasks = tuple(replace(each, task_name=str(number)) for number, each in enumerate(kept.values()))
    letters, letter = np.unique(np.stack([each.letter for each in tasks], axis=1), axis=0, return_inverse=True)
    try:
        automaton = join_automata([each.automaton for each in tasks], letters, memory_limit, most_states)
        joint = JointProduct(model, tasks, automaton, letter.ravel().astype(np.int32))
        found = greatest(Criteria(joint), [float(weight) for weight in weights.values()])
    except SizeError:
        return None
    rounded = Fraction(1, 2**52)  # of the weights
    lower, upper = Fraction(found.lower) * (1 - rounded), Fraction(found.upper) * (1 + rounded)
    bounds = round_down(base + lower), round_up(base + upper)
    return bounds if maximize else (-bounds[1], -bounds[0])


def probability_of(given: float | Fraction, what: str) -> float | Fraction:
    """A bound on a probability that says something; SettingsError for any other."""
    bound = real(given, what, "0.95")
    if not 0 < bound <= 1:
        raise SettingsError(f"{what} is {float(bound):g}; give a probability above 0 and at most 1, such as 0.95")
    return bound


class Thresholds:
    """A task's products for ρ ≥ r, whatever r: one structure over labels whose truth in a state depends on r."""

    def __init__(
        self,
        caller: str,
        model: MDP,
        task: Formula | Task,
        policy: Policy | None,
        maximize: bool,
        memory_limit: int | None,
    ) -> None:
        require(model, MDP, f"{caller}'s model")
        self.formula = bounded_formula_of(task, f"{caller}'s task")
        require(policy, Policy, f"{caller}'s policy", optional=True)
        if model.sensing is not None:
            raise SettingsError(
                f"{model.name} is a black box with real signals, so its margins are not known beforehand; monitor "
                "traces of it instead"
            )
        model.require_points()
        self.name = task.name if isinstance(task, Task) else "formula"
        self._task = task if isinstance(task, Task) else None
        require_names(model, self.formula, self._task, ())
        if has_delays(self.formula):
            raise FragmentError(
                f"{self.name} compares several steps, such as x[t+1] - x[t] > 0; its distribution of robustness is not "
                "supported; record the difference as a signal of the model"
            )
        self._model, self._policy = model, policy
        self._engine: Engine = "auto"
        self._seconds = 0.0  # that checks took without the engine that has to be loaded
        self._maximize, self._memory_limit = maximize, memory_limit
        rewritten = thresholded(self.formula)
        self._formula, self._labels = rewritten.formula, rewritten.labels
        self._atoms = atoms_of(self._formula)
        read = {psi: margins(psi, model.signals, model.labels, model.n_states) for psi, _ in self._labels.values()}
        self._margins = {name: read[psi] for name, (psi, _) in self._labels.items()}
        signed = [self._margins[name] * (1 if positive else -1) for name, (_, positive) in self._labels.items()]
        every = np.unique(np.concatenate([np.empty(0), *signed])) + 0.0  # no -0.0
        self.values: Floats = every[np.isfinite(every)]

    def _truth(self, r: float) -> NDArray[np.bool_]:
        """(n_states, n_atoms): the truth of the structure's atoms in every state."""
        n = self._model.n_states
        known = {
            name: self._margins[name] >= r if positive else self._margins[name] > -r
            for name, (_, positive) in self._labels.items()
        }
        columns = [truth(psi, {}, known, n) for psi in self._atoms]
        return np.stack(columns, axis=1) if columns else np.empty((n, 0), dtype=np.bool_)

    def products(self, values: Floats) -> list[Product]:
        """The products for ρ ≥ r, for each r; they share one automaton."""
        truths = [self._truth(r) for r in values.tolist()]
        distinct = [np.unique(rows, axis=0, return_inverse=True) for rows in truths]
        valuations, which = np.unique(np.concatenate([rows for rows, _ in distinct]), axis=0, return_inverse=True)
        automaton = compile_automaton(self._formula, "exact", valuations, self._memory_limit)
        ends = np.cumsum([len(rows) for rows, _ in distinct])[:-1]
        letters = np.split(automaton.letter_of[which.ravel()], ends)
        return [
            Product(self._model, automaton, own[inverse.ravel()].astype(np.int32), f"robustness({self.name}) >= {r:g}")
            for r, own, (_, inverse) in zip(values.tolist(), letters, distinct, strict=True)
        ]

    def check(self, product: Product, maximize: bool | None = None, keep_policy: bool = False) -> CheckResult:
        """The check of ρ ≥ r: of the policy, or over all policies."""
        better = self._maximize if maximize is None else maximize
        if self._policy is None:
            found = check(
                product, maximize=better, keep_policy=keep_policy, engine=self._engine, memory_limit=self._memory_limit
            )
            self._seconds += found.seconds if found.engine == "nodes" else 0.0
            if self._seconds > _LOADING:  # many of these checks: to load the faster engine pays
                self._engine = "words"
            return found
        return check_along(product, self._policy, self._memory_limit)


def check_along(product: Product, policy: Policy, memory_limit: int | None = None) -> CheckResult:
    """The check of a policy that was made for another task on the same model: it follows its own automaton.

    Raises PolicyError if it is for another model, or ends before the task does.
    """
    home = policy.home
    if home.model is not product.model and policy.binding.model_digest != product.model.nominal().digest():
        raise PolicyError(
            f"the policy is for the model {home.model.name}, not for {product.model.name}; give one for this model"
        )
    if not policy.stationary and home.horizon < product.horizon:
        raise PolicyError(
            f"the policy ends after {home.horizon} steps, the task after {product.horizon}; give a policy for as many "
            "steps"
        )
    both, memory = joined(product, home)
    judged = check(both, Policy(both, Through(policy.form, memory)), memory_limit=memory_limit)
    return replace(judged, policy=policy)
