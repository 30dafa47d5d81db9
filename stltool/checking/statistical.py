"""Statistical checks: the probability that a policy satisfies the task, estimated from sampled runs alone.

n runs, fixed beforehand, k of them satisfied; δ = 1 − confidence. The Clopper–Pearson interval [l, u] of any p:

    l = the p with P(X ≥ k) = δ/2,  u = the p with P(X ≤ k) = δ/2,   X binomial(n, p);   P(l ≤ p ≤ u) ≥ 1 − δ

(δ instead of δ/2 for a one-sided bound). It is contained in Hoeffding's k/n ± √(ln(2/δ) / 2n), so Okamoto's number of
runs ⌈ln(2/δ) / 2ε²⌉ is always enough for |k/n − p| ≤ ε; `runs_needed` finds a smaller one.

Sequential probability ratio test, H₀: p ≥ p₀ = θ + d against H₁: p ≤ p₁ = θ − d, after n runs with k satisfied:

    λ = k · ln(p₁/p₀) + (n − k) · ln((1−p₁)/(1−p₀));   stop with H₁ when λ ≥ ln(1/α), with H₀ when λ ≤ ln β

Wald's usual bounds (1−β)/α and β/(1−α) respect the errors only approximately; these, slightly wider, guarantee them:
e^λ is a martingale under p₀, so P(ever λ ≥ ln(1/α)) ≤ α, also for p > p₀ and when the test is cut short; likewise for
β.

Watching the interval while runs come in, and stopping when it looks good, would invalidate its confidence: there is no
such option. Sources: [Clopper34] [Hoeffding63] [Okamoto58] [Wald45] [Younes06].
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, function, one_of, real, require, whole
from stltool.checking.check import or_optimal
from stltool.checking.induction import Progress
from stltool.checking.rollouts import Rollouts, Verdicts
from stltool.display import Card, Displayed
from stltool.errors import SettingsError, named
from stltool.models.environment import BlackBox, require_environment
from stltool.numbers import ceiling_text, exact, floor_text
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.randomness import Purpose, require_seed
from stltool.sizes import require_time

Side: TypeAlias = Literal["both", "lower", "upper"]

RUNS, MOST_RUNS = 10_000, 10_000_000
_SHARPEST = Fraction(1, 10**9)  # half-width; a smaller one takes impracticably many runs
_RATE = 1e7  # runs per second at best, each decided after a few steps
_GRID = 64  # outcomes examined at a time when runs are planned


@dataclass(frozen=True, repr=False)
class Estimate(Displayed):
    """How many runs satisfied the task, and what follows for the probability.

    probability   satisfied / runs, the maximum likelihood estimate
    lower, upper  with `confidence` the probability lies between them (a one-sided bound leaves 0 or 1 on its other
                  side). The confidence belongs to the method: of many estimates with fresh seeds, at least this share
                  contain the probability.
    steps, seed   steps of all runs, and the seed of their random numbers, if they were sampled here
    """

    runs: int
    satisfied: int
    probability: float
    lower: float
    upper: float
    confidence: float
    side: Side = "both"
    method: str = "Clopper-Pearson"
    steps: int | None = None
    seed: int | None = None
    seconds: float = 0.0

    def _card(self) -> Card:
        return Card(
            f"Estimate: P = {self.probability!r}, {self.satisfied} of {self.runs} runs satisfied",
            [
                {
                    "interval": f"[{floor_text(self.lower)}, {ceiling_text(self.upper)}]",
                    "confidence": f"{100 * self.confidence:.12g} %",
                },
                {"method": self.method, "side": self.side, "steps": self.steps, "seed": self.seed},
            ],
        )

    @property
    def statement(self) -> str:
        """What was found, in words; bounds are rounded outwards."""
        lower = floor_text(self.lower)
        upper = ceiling_text(self.upper)
        found = {
            "both": f"lies in [{lower}, {upper}]",
            "lower": f"is at least {lower}",
            "upper": f"is at most {upper}",
        }
        return f"with confidence {100 * self.confidence:.12g} % the probability {found[self.side]}"


@dataclass(frozen=True, repr=False)
class SequentialTest(Displayed):
    """How a sequential probability ratio test of P ≥ `at_least` ended.

    verdict   "holds" | "does not hold" | "undecided" (`runs` reached the limit; no claim is made)
    alpha     bounds the probability of "does not hold" where P ≥ at_least + indifference
    beta      bounds the probability of "holds" where P ≤ at_least − indifference
    log_likelihood_ratio   ln(P(runs | at_least − indifference) / P(runs | at_least + indifference)); the test stops
                           when it leaves (accept_below, reject_above) = (ln β, ln 1/α)
    seed      of the runs' random numbers, if they were sampled here
    """

    verdict: Literal["holds", "does not hold", "undecided"]
    at_least: float
    indifference: float
    alpha: float
    beta: float
    runs: int
    satisfied: int
    log_likelihood_ratio: float
    accept_below: float
    reject_above: float
    seed: int | None = None
    seconds: float = 0.0

    def _card(self) -> Card:
        return Card(
            f"SequentialTest: P >= {self.at_least!r} {self.verdict if self.verdict != 'undecided' else 'is undecided'}",
            [
                {"runs": self.runs, "satisfied": self.satisfied, "seed": self.seed},
                {"indifference": self.indifference, "alpha": self.alpha, "beta": self.beta},
            ],
        )

    @property
    def statement(self) -> str:
        """The verdict, with the meaning of its error probability."""
        above, below = (f"{self.at_least + margin:.12g}" for margin in (self.indifference, -self.indifference))
        ends = {
            "holds": f"holds; if P were at most {below}, this result would have probability at most {self.beta:g}",
            "does not hold": f"does not hold; if P were at least {above}, this result would have probability at most "
            f"{self.alpha:g}",
            "undecided": f"is undecided after {self.runs} runs; no claim is made",
        }
        return f"P >= {self.at_least!r} {ends[self.verdict]}"


# ------------------------------------------------------------------------------------------------ runs of a policy


def estimate(
    product: Product,
    policy: Policy | None = None,
    *,
    runs: int | None = None,
    epsilon: float | Fraction | None = None,
    confidence: float | Fraction = 0.99,
    side: Side = "both",
    seed: int = 0,
    environment: BlackBox | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """The probability that the task holds under `policy` (default: the optimal one), with an interval, from independent
    runs.

    runs          how many, fixed beforehand (10 000), or
    epsilon       as many as ensure that neither bound is farther than this from the estimate, whatever the outcome
    side          "both" bounds, or all the confidence for a "lower" or an "upper" one
    seed          an integer from 0; every random choice made here comes from it: same seed, same result. The runs are
                  independent of a training under the same seed
    environment   anything whose `reset()` and `step(i)` (the i-th available action of the current state) return the
                  index of a state in the model's order, or one that takes many runs at once
                  (`stltool.models.environment.Batched`); the model's probabilities are then not read. Default: the
                  model itself, all runs at once.
    progress      called with (runs done, runs)

    Raises PolicyError if the policy defines no action in a state that a run reaches, ModelError if the environment does
    not return a state, SettingsError for settings out of range, SizeError if the runs would take more than a week.
    """
    require_door("estimate", product, policy)
    require_environment(environment, "estimate's environment")
    function(progress, "estimate's progress")
    n = planned_runs(runs, epsilon, confidence, side)
    require_seed(seed)
    policy = or_optimal("estimate", product, policy)
    rollouts = Rollouts(product, policy, n, seed, environment)
    result = estimate_from(rollouts, n, confidence=confidence, side=side, progress=progress)
    return replace(result, steps=rollouts.steps, seed=rollouts.seed)


def sprt(
    product: Product,
    policy: Policy | None = None,
    at_least: float | Fraction | None = None,
    *,
    indifference: float | Fraction = 0.01,
    alpha: float | Fraction = 0.01,
    beta: float | Fraction = 0.01,
    most_runs: int = MOST_RUNS,
    seed: int = 0,
    environment: BlackBox | None = None,
    progress: Progress | None = None,
) -> SequentialTest:
    """Test whether the task holds under `policy` (default: the optimal one) with probability `at_least`, a number
    between 0 and 1, with as few runs as possible.

    If P lies within `indifference` of `at_least`, either answer is acceptable. `alpha` bounds the probability of a
    wrong "does not hold", `beta` that of a wrong "holds"; "undecided" after `most_runs` makes no claim. `progress` is
    called with (runs done, most_runs); the rest as for `estimate`.
    """
    require_door("sprt", product, policy)
    require_environment(environment, "sprt's environment")
    function(progress, "sprt's progress")
    hypotheses(at_least, indifference, alpha, beta, most_runs)
    most_runs = int(most_runs)
    assert at_least is not None  # as just checked
    require_seed(seed)
    policy = or_optimal("sprt", product, policy)
    rollouts = Rollouts(product, policy, most_runs, seed, environment, Purpose.SPRT)
    result = sprt_from(
        rollouts, at_least, indifference=indifference, alpha=alpha, beta=beta, most_runs=most_runs, progress=progress
    )
    return replace(result, seed=rollouts.seed)


# --------------------------------------------------------------------------------------- verdicts from anywhere


def estimate_from(
    verdicts: Iterable[bool | Verdicts],
    runs: int,
    *,
    confidence: float | Fraction = 0.99,
    side: Side = "both",
    progress: Progress | None = None,
) -> Estimate:
    """`estimate` from the first `runs` verdicts of independent runs, one by one or in arrays (n,) bool, in their order.

    `runs` must not depend on the verdicts.
    """
    start = time.perf_counter()
    runs = planned_runs(runs, None, confidence, side)
    done = satisfied = 0
    for some in _batches(verdicts):
        batch = some[: runs - done]
        done, satisfied = done + len(batch), satisfied + int(batch.sum())
        if progress is not None:
            progress(done, runs)
        if done == runs:
            break
    if done < runs:
        raise SettingsError(f"the verdicts ended after {done} of {runs} runs; give {runs} of them")
    seconds = time.perf_counter() - start
    lower, upper = clopper_pearson(satisfied, runs, confidence, side)
    return Estimate(runs, satisfied, satisfied / runs, lower, upper, float(confidence), side, seconds=seconds)


def sprt_from(
    verdicts: Iterable[bool | Verdicts],
    at_least: float | Fraction,
    *,
    indifference: float | Fraction = 0.01,
    alpha: float | Fraction = 0.01,
    beta: float | Fraction = 0.01,
    most_runs: int = MOST_RUNS,
    progress: Progress | None = None,
) -> SequentialTest:
    """The sequential test on verdicts of independent runs, one by one or in arrays (n,) bool, in the order of the runs.

    It reads no more than it needs; "undecided" after `most_runs`, or if the verdicts end before.
    """
    start = time.perf_counter()
    p0, p1 = hypotheses(at_least, indifference, alpha, beta, most_runs)
    most_runs = int(most_runs)
    per_success = math.log1p(float((p1 - p0) / p0)) if p1 > 0 else -math.inf
    per_failure = math.log1p(float((p0 - p1) / (1 - p0))) if p0 < 1 else math.inf
    accept, reject = math.log(float(beta)), -math.log(float(alpha))
    done = satisfied = 0
    ratio = 0.0
    for some in _batches(verdicts):
        batch = some[: most_runs - done]
        if not len(batch):
            continue
        k = satisfied + np.cumsum(batch)
        n = done + np.arange(1, len(batch) + 1)
        with np.errstate(invalid="ignore"):  # both infinite: the first verdict decides, later values are not used
            ratios = _times(k, per_success) + _times(n - k, per_failure)
        stops = (ratios <= accept) | (ratios >= reject)
        last = int(stops.argmax()) if stops.any() else len(batch) - 1
        done, satisfied, ratio = int(n[last]), int(k[last]), float(ratios[last])
        if progress is not None:
            progress(done, most_runs)
        if stops.any() or done == most_runs:
            break
    verdict: Literal["holds", "does not hold", "undecided"] = (
        "holds" if ratio <= accept else "does not hold" if ratio >= reject else "undecided"
    )
    return SequentialTest(
        verdict, float(at_least), float(indifference), float(alpha), float(beta), done, satisfied, ratio, accept,
        reject, seconds=time.perf_counter() - start,
    )  # fmt: skip


def _batches(verdicts: Iterable[bool | Verdicts]) -> Iterator[Verdicts]:
    require(verdicts, Iterable, "the verdicts", "give True or False for each run, or arrays of them")
    for given in [verdicts] if isinstance(verdicts, np.ndarray) else verdicts:
        batch = np.atleast_1d(np.asarray(given))
        if batch.dtype != np.bool_ or batch.ndim != 1:
            raise SettingsError(f"a verdict is {described(given)}; give True or False, or an array (n,) of them")
        yield batch


def _times(count: NDArray[np.int64], value: float) -> NDArray[np.float64]:
    """count · value, with 0 · ∞ = 0."""
    return np.multiply(count, value, out=np.zeros(len(count)), where=count > 0)


# ------------------------------------------------------------------------------------------------- mathematics


def clopper_pearson(
    satisfied: int, runs: int, confidence: float | Fraction = 0.99, side: Side = "both"
) -> tuple[float, float]:
    """(lower, upper) around the probability of which `satisfied` of `runs` independent runs are a sample."""
    planned_runs(runs, None, confidence, side)
    if not 0 <= satisfied <= runs:
        raise SettingsError(f"{satisfied} of {runs} runs satisfied; give counts with 0 <= satisfied <= runs")
    # quantiles of the beta distribution, those of scipy.stats, which takes half a second to load; the intervals of its
    # binomtest are only accurate to an absolute 1e-12
    from scipy.special import betainccinv, betaincinv

    tail = _tail(confidence, side)
    lower = float(betaincinv(satisfied, runs - satisfied + 1, tail)) if side != "upper" and satisfied > 0 else 0.0
    upper = float(betainccinv(satisfied + 1, runs - satisfied, tail)) if side != "lower" and satisfied < runs else 1.0
    return lower, upper


def okamoto_runs(epsilon: float | Fraction, confidence: float | Fraction = 0.99, side: Side = "both") -> int:
    """⌈ln(1/tail) / 2ε²⌉ with tail δ/2, or δ for one side: Okamoto's (Chernoff's, Hoeffding's) number of runs."""
    require_confidence(confidence, side)
    if not _SHARPEST <= _decimal(epsilon, "epsilon", "0.01") < Fraction(1, 2):
        raise SettingsError(f"{named('epsilon')} is {epsilon}; give a half-width between 1e-9 and 0.5, such as 0.01")
    return math.ceil(-math.log(_tail(confidence, side)) / (2 * float(epsilon) ** 2))


def runs_needed(epsilon: float | Fraction, confidence: float | Fraction = 0.99, side: Side = "both") -> int:
    """Runs after which no Clopper–Pearson bound can be farther than `epsilon` from the estimate, whatever the outcome.

    Never more than Okamoto's number; about 40 % fewer for common confidences.
    """
    enough, too_few = okamoto_runs(epsilon, confidence, side), 0
    what = (
        f"an interval of ±{float(epsilon):g} at confidence {float(confidence):g} takes up to {enough:.3g} runs; these"
    )
    _runs(enough, "runs", what)
    tail = _tail(confidence, side)
    while enough - too_few > 1:
        n = (enough + too_few) // 2
        if _excess(n, tail) <= epsilon:
            enough = n
        else:
            too_few = n
    return enough


def _excess(runs: int, tail: float) -> float:
    """The largest upper − k/n over all outcomes k (by symmetry also of k/n − lower): it rises with k, then falls."""
    from scipy.special import betainccinv

    first, last = 0, runs - 1  # k = n has the trivial upper bound 1
    while True:
        k = np.unique(np.linspace(first, last, min(_GRID, last - first + 1)).round().astype(np.int64))
        excess = betainccinv(k + 1, runs - k, tail) - k / runs
        top = int(excess.argmax())
        if last - first < _GRID:
            return float(excess[top])
        first, last = int(k[max(top - 1, 0)]), int(k[min(top + 1, len(k) - 1)])


def _tail(confidence: float | Fraction, side: Side) -> float:
    """The probability with which one bound may fail."""
    missing = 1 - _decimal(confidence, "confidence")
    return float(missing / 2 if side == "both" else missing)


# --------------------------------------------------------------------------------------------- checks of settings


def planned_runs(
    runs: int | None = None,
    epsilon: float | Fraction | None = None,
    confidence: float | Fraction = 0.99,
    side: Side = "both",
) -> int:
    """How many runs `estimate` makes with these settings; SettingsError or SizeError if they are not valid."""
    require_confidence(confidence, side)
    if runs is not None and epsilon is not None:
        raise SettingsError(
            f"{named('runs')} and {named('epsilon')} are both given, but epsilon determines the number of runs; give "
            "one of the two"
        )
    if epsilon is not None:
        return runs_needed(epsilon, confidence, side)
    return RUNS if runs is None else _runs(runs, "runs")


def hypotheses(
    at_least: float | Fraction | None,
    indifference: float | Fraction = 0.01,
    alpha: float | Fraction = 0.01,
    beta: float | Fraction = 0.01,
    most_runs: int = MOST_RUNS,
) -> tuple[Fraction, Fraction]:
    """p₀ and p₁ of `sprt` with these settings, as the decimals they were written as; SettingsError if they are not
    valid."""
    _runs(most_runs, "most_runs")
    theta, margin = _decimal(at_least, "at_least", "0.9"), _decimal(indifference, "indifference", "0.01")
    if not 0 < theta < 1:
        raise SettingsError(f"{named('at_least')} is {at_least}; give a probability above 0 and below 1")
    if margin <= 0:
        raise SettingsError(
            f"{named('indifference')} is {indifference}; give a number above 0: no number of runs distinguishes "
            "equal probabilities"
        )
    p0, p1 = theta + margin, theta - margin
    if p0 > 1 or p1 < 0:
        raise SettingsError(
            f"the indifference region {float(p1):.12g} … {float(p0):.12g} is not within [0, 1]; "
            f"take an indifference of at most {float(min(theta, 1 - theta)):.12g}"
        )
    errors = _decimal(alpha, "alpha", "0.01"), _decimal(beta, "beta", "0.01")
    for value, name in zip(errors, ("alpha", "beta"), strict=True):
        if not 0 < value < 1:
            raise SettingsError(
                f"{named(name)} is {float(value)}; give an error probability between 0 and 1, exclusive"
            )
    if sum(errors) >= 1:
        raise SettingsError(
            f"{named('alpha')} + {named('beta')} is {float(sum(errors)):g}; choose them with a sum "
            "below 1: otherwise tossing a coin is as good"
        )
    return p0, p1


def _decimal(value: object, name: str, example: str = "0.99") -> Fraction:
    """A double as the decimal it was written as."""
    return exact(real(value, name, example))


def require_confidence(confidence: float | Fraction, side: str = "lower") -> None:
    """SettingsError unless 0 < confidence < 1 and `side` exists."""
    if not 0 < _decimal(confidence, "confidence") < 1:
        raise SettingsError(
            f"{named('confidence')} is {confidence}; give a number between 0 and 1, exclusive, such as 0.99"
        )
    one_of(side, "side", get_args(Side))


def _runs(given: int, name: str, what: str | None = None) -> int:
    """That many runs, unless they would take too long."""
    runs = whole(given, name, least=1)
    require_time(runs, _RATE, what or f"{runs} runs", "use a wider interval or fewer runs")
    return runs
