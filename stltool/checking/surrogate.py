"""What the paper's surrogate leads to when nothing is left to learn: its optimal policies, and their exact P.

With χ_t ∈ {0, 1} the inner formula's truth that the flags show after step t [Wang24, eq. 11], two readings of eq. 9:

    discounted   max E Σ_{t ≥ 1} γ^(t−1) r(χ_t)                 eq. 12 and 5 as published: stationary, without an end
    episode      max E Σ_{t = τ−1}^{T+τ−2} r(χ_t)               eq. 9: start k is judged at t = k + τ − 1

r is e^{βχ} under an outer F and −e^{−βχ} under an outer G; the published runs use 2χ − 1 and χ − 0.5, the paper prints
χ − 0.9. All are a + bχ with b > 0, which moves no maximum of either sum, so r = χ here: neither β, nor the scale, nor
the outer operator tells optimal policies apart. The episode reading maximises the expected *number* of starts at which
the inner formula holds, where the task asks for the probability of *one* (F) or of *all* (G).

discounted   value iteration V ← L V on (s, q), L V(s,q) = max_c Σ_s' p(s'|c) (χ(q') + γ V(s',q')), q' = δ(L(s'),q).
             With Δ = L V − V, V* lies within L V + γ/(1−γ)·[min Δ, max Δ] [Puterman94, Prop. 6.6.5 and Th. 6.6.6],
             so a choice c of (s, q) with
                 L V(s,q) − Σ_s' p(s'|c) (χ(q') + γ V(s',q')) > γ/(1−γ)·(max Δ − min Δ)
             is in no optimal policy (action elimination, §6.7). It stops when the right side is below a tolerance; the
             span of Δ shrinks by γ a sweep at least. Constants added to V move nothing and are taken off, so that
             rounding stays small beside differences.
episode      backward induction over (t, s, q); choices are eliminated beyond the rounding of its sums.

A policy is optimal for the surrogate if and only if it takes choices that are left wherever it goes, so P is reported
three times: ties broken at random as the published learners do, and the least and the greatest P over all policies of
the choices left, history-dependent ones included. If rounding or the tolerance left a choice too many, that range is
wider than the true one, never narrower.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, one_of, real
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.backward import Floats, Progress, sweeper
from stltool.checking.bounds import model_defects
from stltool.checking.check import CheckResult, check
from stltool.display import Card, Displayed
from stltool.errors import SettingsError, named
from stltool.logic.fragment import check_fragment
from stltool.policy import Policy, require_door, with_flags
from stltool.product import Product, build_product, joined
from stltool.sizes import require_memory, require_time

Reading = Literal["discounted", "episode"]
READINGS: tuple[Reading, ...] = ("discounted", "episode")
Left: TypeAlias = NDArray[np.bool_]
"""(1 or h, choices, Q): whether a choice of the model may be in an optimal policy at (t, s, q)."""

_RATE = 2e8  # multiply-adds a second, roughly
_EPSILON = 2.0**-52


@dataclass(frozen=True, eq=False, repr=False)
class SurrogateResult(Displayed):
    """The surrogate's optimum, judged by the task.

    product    what judges: exact verdicts of the task
    policy     uniform over the choices left; of (s, q), or of (t, s, q) in the episode reading. It remembers flags
    at_random  its check
    least, greatest  of all policies that take only choices left, with a policy that attains each
    optimum    the best of all policies for the task itself
    tolerance  a choice is left where the surrogate's value loses no more than this by it
    sweeps     of value iteration, or of the horizon
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
        """P of the task's optimum less that of the surrogate's, ties broken at random."""
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
    tolerance  what the surrogate's value may lose by a choice that still counts as optimal, in the discounted reading

    Raises FragmentError for a task that has no flags, SettingsError for an impossible setting, SizeError before
    allocating what would not fit.
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
    layers = 1 if reading == "discounted" else home.horizon
    cells = layers * home.model.n_choices * home.automaton.n_states
    require_memory(
        2 * cells
        + 8 * layers * home.n_states * home.model.most_choices
        + 2 * np.dtype(home.model.choice_type).itemsize * home.horizon * home.n_states,
        f"the surrogate's optimal choices over {home.n_states} product states",
        "shorten the windows",
        memory_limit,
    )
    if reading == "discounted":
        left, reached, sweeps = _discounted(home, gamma, tolerance, progress)
    else:
        left, reached, sweeps = _episode(home, progress)
    policy = _uniform(home, left, reading == "discounted")
    judge = home
    if not home.automaton.exact:
        judge = product if product.automaton.exact else build_product(product.model, product.formula)
    both, memory = (home, np.arange(home.automaton.n_states)) if judge is home else joined(judge, home)
    at_random = check(judge, policy)
    least, greatest = (check(both, _extreme(both, left[:, :, memory], maximize)) for maximize in (False, True))
    status = "complete"
    if reading == "discounted" and reached > tolerance:
        status = f"rounding: choices that lose up to {reached:.2g} are not told apart from optimal ones"
    return SurrogateResult(
        product=judge,
        reading=reading,
        gamma=gamma if reading == "discounted" else None,
        policy=policy,
        at_random=at_random,
        least=least,
        greatest=greatest,
        optimum=check(judge, keep_policy=False),
        tolerance=reached,
        sweeps=sweeps,
        seconds=time.perf_counter() - start,
        status=status,
    )


def _discounted(home: Product, gamma: float, tolerance: float, progress: Progress | None) -> tuple[Left, float, int]:
    """(choices left, the tolerance reached, sweeps) of value iteration."""
    asked = tolerance * (1 - gamma) / gamma / 2  # the span to stop at; half is left for rounding
    most = 1 + max(1, math.ceil(math.log(asked) / math.log(gamma)))  # Δ₁ spans at most 1
    work = most * home.model.n_transitions * home.automaton.n_states
    require_time(work, _RATE, f"value iteration of {most} sweeps", "take a smaller gamma, or shorten the windows")
    chi, unit, swept = _chi(home), _unit(home), sweeper(home, "numba")
    values, out, W = (np.zeros(home.shape) for _ in range(3))
    best = np.empty(home.shape, dtype=home.model.choice_type)
    sweeps, threshold = 0, math.inf
    for sweeps in range(1, most + 1):
        reward_to_go = gamma * values + chi
        swept.gather(reward_to_go, W)
        swept.optimum(W, True, out, best)
        change = out - values
        span, error = float(change.max() - change.min()), unit * float(np.abs(W).max())
        threshold = gamma / (1 - gamma) * (span + 2 * error) + 2 * error
        if progress is not None:
            progress(sweeps, most)
        if span <= max(asked, 4 * error):
            break
        values = out - (out.max() + out.min()) / 2
    return _left(home, W, out, threshold)[None], threshold, sweeps


def _episode(home: Product, progress: Progress | None) -> tuple[Left, float, int]:
    """The same of backward induction, layer by layer; χ counts from the first full window on."""
    h, fragment = home.horizon, check_fragment(home.formula)
    chi, unit, swept = _chi(home), _unit(home), sweeper(home, "numba")
    first = max(part.tau for part in fragment.parts) - 1
    values, W = np.zeros(home.shape), np.empty(home.shape)
    best = np.empty(home.shape, dtype=home.model.choice_type)
    left = np.empty((h, home.model.n_choices, home.automaton.n_states), dtype=np.bool_)
    error = 0.0
    for t in range(h - 1, -1, -1):
        swept.gather(values + chi if t + 1 >= first else values, W)
        values = np.empty(home.shape)
        swept.optimum(W, True, values, best)
        error += unit * float(W.max())
        left[t] = _left(home, W, values, 2 * error)
        if progress is not None:
            progress(h - t, h)
    return left, 2 * error, h


def _chi(home: Product) -> Floats:
    """(Q,) the truth of the inner formula that the flags show: the verdict at the horizon."""
    chi: Floats = (home.automaton.verdict_rows[-1] == TRUE).astype(np.float64)
    return chi


def _unit(home: Product) -> float:
    """How far a computed sweep of W may be from the exact one, the defects of rows included, as a share of max |W|."""
    longest = int(np.diff(home.model.row_start).max())
    return (longest + 4) * _EPSILON + float(model_defects(home.model)[0])


def _left(home: Product, W: Floats, best: Floats, threshold: float) -> Left:
    """(choices, Q): the choices whose value is within the threshold of the best one's."""
    owner = np.repeat(np.arange(home.model.n_states), np.diff(home.model.choice_start))
    left: Left = best[owner] - home.model.matrix() @ W <= threshold
    return left


def _uniform(home: Product, left: Left, stationary: bool) -> Policy:
    """The policy that is uniform over the choices left."""
    model = home.model
    owner = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    number = np.arange(model.n_choices) - model.choice_start[owner]
    weights = np.zeros((len(left), *home.shape, home.model.most_choices))
    for c, (s, i) in enumerate(zip(owner.tolist(), number.tolist(), strict=True)):
        weights[:, s, :, i] = left[:, c]
    weights /= weights.sum(axis=-1, keepdims=True)
    return Policy(home, weights[0] if stationary else weights)


def _extreme(judge: Product, left: Left, maximize: bool) -> Policy:
    """The policy of (t, s, q) with the greatest (least) P among those that take only choices left."""
    model, automaton = judge.model, judge.automaton
    matrix, start = model.matrix(), model.choice_start[:-1]
    owner = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    number = np.arange(model.n_choices) - model.choice_start[owner]
    state, after = np.arange(model.n_states)[:, None], automaton.delta[judge.letter]
    optimum: Callable[..., Floats] = np.maximum.reduceat if maximize else np.minimum.reduceat
    table = np.zeros((judge.horizon, *judge.shape), dtype=model.choice_type)
    values = np.zeros(judge.shape)
    values[:, automaton.verdicts(judge.horizon) == TRUE] = 1.0
    for t in range(judge.horizon - 1, -1, -1):
        options = matrix @ values[state, after]
        options[~left[min(t, len(left) - 1)]] = -1.0 if maximize else 2.0
        values = optimum(options, start, axis=0)
        attained = np.where(options == values[owner], number[:, None], model.n_choices)
        table[t] = np.minimum.reduceat(attained, start, axis=0)
        verdicts = automaton.verdicts(t)
        values[:, verdicts != UNDECIDED] = verdicts[verdicts != UNDECIDED]
    return Policy(judge, table)
