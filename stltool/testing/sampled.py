"""Probabilities of randomised programs, tested on as few runs as possible.

How many runs a sequential test takes is random; its mean under a true probability p follows from Wald's identity
[Wald45]. With a = ln β, b = ln 1/α, and h(p) ≠ 0 such that E_p[e^{h z}] = 1 for the step z of the log likelihood ratio,

    P(ends at b) ≈ (1 − e^{h a}) / (e^{h b} − e^{h a}),   E_p[n] ≈ (a P(ends at a) + b P(ends at b)) / E_p[z]

and E_p[n] ≈ −a b / E_p[z²] where E_p[z] = 0, which is about where it is greatest.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from stltool.arguments import described, function, real
from stltool.checking.statistical import MOST_RUNS, SequentialTest, hypotheses, sprt_from
from stltool.display import Card, Displayed
from stltool.errors import ArgumentError, SettingsError, named
from stltool.randomness import Purpose, generator
from stltool.testing.assertions import StlAssertionError

_INDIFFERENCE = 0.01


class SampledViolation(StlAssertionError):
    """A sequential test has not confirmed a probability: `result` is the test."""

    def __init__(self, message: str, result: SequentialTest) -> None:
        super().__init__(message)
        self.result = result


@dataclass(frozen=True, repr=False)
class SamplingPlan(Displayed):
    """How many runs a sequential test of P >= at_least takes, on average.

    if_higher, if_lower   where P = at_least ± indifference; fewer the farther P is away
    at_worst              in between, where the test finds it hardest
    """

    at_least: float
    confidence: float
    indifference: float
    if_higher: int
    if_lower: int
    at_worst: int

    @property
    def statement(self) -> str:
        """The plan in words."""
        above, below = (min(max(self.at_least + d, 0), 1) for d in (self.indifference, -self.indifference))
        sure = f"P >= {self.at_least:.12g} with confidence {100 * self.confidence:.12g} %"
        return (
            f"{sure}: about {self.if_higher} runs if P = {above:.12g}, {self.if_lower} if P = {below:.12g}, up to "
            f"{self.at_worst} on average in between, fewer beyond"
        )

    def _card(self) -> Card:
        return Card(
            f"SamplingPlan: P >= {self.at_least!r}, at most {self.at_worst} runs on average",
            [{"confidence": self.confidence, "indifference": self.indifference},
             {"if higher": self.if_higher, "if lower": self.if_lower}],
        )  # fmt: skip

    def runs(self, p: float) -> float:
        """The runs that are expected if P = p."""
        p = float(real(p, "SamplingPlan.runs' p", "0.9"))
        if not 0 <= p <= 1:
            raise SettingsError(f"SamplingPlan.runs' p is {p:g}; give a probability")
        return _expected(p, self.at_least, self.indifference, 1 - self.confidence)


def sampling_plan(
    at_least: float | Fraction, *, confidence: float | Fraction = 0.99, indifference: float | Fraction | None = None
) -> SamplingPlan:
    """How many runs `assert_probability_sampled` takes with these settings, on average."""
    theta, delta, margin = _settings(at_least, confidence, indifference)
    above, below, worst = (
        math.ceil(_expected(p, theta, margin, delta))
        for p in (theta + margin, theta - margin, _drift_free(theta, margin))
    )
    return SamplingPlan(theta, float(confidence), margin, above, below, worst)


def assert_probability_sampled(
    run: Callable[..., bool],
    at_least: float | Fraction,
    *,
    confidence: float | Fraction = 0.99,
    indifference: float | Fraction | None = None,
    most_runs: int = MOST_RUNS,
    seed: int = 0,
    tell: Callable[[str], Any] | None = print,
) -> SequentialTest:
    """A program succeeds with probability `at_least`, by a sequential test (SPRT) on independent runs.

    run            returns True or False: whether the run succeeded. If it has a parameter, it is given a
                   numpy.random.Generator, which depends on the seed and on the number of the run
    confidence     at least this is the probability that the test passes if P >= at_least + indifference, and that it
                   fails if P <= at_least − indifference; in between either may come
    indifference   default: 0.01, or half of the way to 0 or 1 if that is less
    tell           is given the number of runs to expect, in words, before the first; None for silence
    most_runs      after as many, the test fails as undecided

    Raises SampledViolation, an AssertionError; returns the test if it passes.
    """
    __tracebackhide__ = True
    theta, delta, margin = _settings(at_least, confidence, indifference)
    if not callable(run):
        raise ArgumentError(f"assert_probability_sampled's run is {described(run)}, not a function; write one that "
                            "returns True or False")  # fmt: skip
    function(tell, "assert_probability_sampled's tell")
    hypotheses(theta, margin, delta, delta, most_runs)
    generator(seed, Purpose.SAMPLED)
    plan = sampling_plan(at_least, confidence=confidence, indifference=indifference)
    if tell is not None:
        tell(plan.statement)
    result = sprt_from(_verdicts(run, seed), theta, indifference=margin, alpha=delta, beta=delta, most_runs=most_runs)
    if result.verdict == "holds":
        return result
    share = f"{result.satisfied} of {result.runs} runs succeeded"
    raise SampledViolation(f"{result.statement}\n  {share} (seed {seed})\n  planned: {plan.statement}", result)


def _verdicts(run: Callable[..., bool], seed: int) -> Iterator[bool]:
    given = _takes_generator(run)
    number = 0
    while True:
        found = run(generator(seed, Purpose.SAMPLED, number)) if given else run()
        if not isinstance(found, bool | np.bool_):
            raise ArgumentError(f"run {number} returned {described(found)}; return True or False")
        yield bool(found)
        number += 1


def _takes_generator(run: Callable[..., bool]) -> bool:
    try:
        parameters = inspect.signature(run).parameters.values()
    except (TypeError, ValueError):  # some functions written in C have none
        return False
    needed = [
        one
        for one in parameters
        if one.default is one.empty and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
    ]
    return bool(needed)


def _settings(
    at_least: float | Fraction, confidence: float | Fraction, indifference: float | Fraction | None
) -> tuple[float, float, float]:
    """θ, δ and d, checked."""
    theta = float(real(at_least, "at_least", "0.95"))
    sure = real(confidence, "confidence", "0.99")
    if not 0 < theta < 1:
        raise SettingsError(f"{named('at_least')} is {theta:g}; give a probability above 0 and below 1, such as 0.95")
    if not 0.5 < sure < 1:
        raise SettingsError(
            f"{named('confidence')} is {float(sure):g}; give a number above 0.5 and below 1, such as 0.99"
        )
    room = min(theta, 1 - theta)
    margin = min(_INDIFFERENCE, room / 2) if indifference is None else float(real(indifference, "indifference", "0.01"))
    if not 0 < margin <= room:
        raise SettingsError(
            f"{named('indifference')} is {margin:g}; give a number above 0 and at most {room:.12g}, so that "
            f"{theta:g} ± it is a probability"
        )
    return theta, float(1 - Fraction(str(sure)) if isinstance(sure, float) else 1 - sure), margin


def _steps(theta: float, margin: float) -> tuple[float, float]:
    """What the log likelihood ratio moves by at a success, and at a failure."""
    above, below = theta + margin, theta - margin
    return (
        math.log(below / above) if below > 0 else -math.inf,
        math.log((1 - below) / (1 - above)) if above < 1 else math.inf,
    )


def _drift_free(theta: float, margin: float) -> float:
    """The p at which the log likelihood ratio has no drift."""
    down, up = _steps(theta, margin)
    if math.isinf(up):
        return 1 - 1e-12
    return up / (up - down) if not math.isinf(down) else 1e-12


def _expected(p: float, theta: float, margin: float, delta: float) -> float:
    """E_p[n] with α = β = δ."""
    from scipy.optimize import brentq

    down, up = _steps(theta, margin)
    if math.isinf(up) or math.isinf(down):  # one failure, or one success, decides
        chance = 1 - p if math.isinf(up) else p
        step, edge = (down, math.log(delta)) if math.isinf(up) else (up, -math.log(delta))
        runs = math.ceil(edge / step)
        return runs if chance == 0 else (1 - (1 - chance) ** runs) / chance
    a, b = math.log(delta), -math.log(delta)
    drift = p * down + (1 - p) * up
    if abs(drift) < 1e-9 * (up - down):
        return -a * b / (p * down**2 + (1 - p) * up**2)
    if p in (0.0, 1.0):
        return b / up if p == 0 else a / down

    def excess(h: float) -> float:
        return p * math.expm1(h * down) + (1 - p) * math.expm1(h * up)

    far = 1e-6 * math.copysign(1, -drift)  # beyond 0, where the other root is
    low, high = far, far
    while excess(high) < 0 and abs(high * (up - down)) < 700:
        high *= 2
    h = float(brentq(excess, low, high)) if excess(low) < 0 < excess(high) else far
    at_b = math.expm1(h * a) / (math.expm1(h * a) - math.expm1(h * b))
    return (a * (1 - at_b) + b * at_b) / drift
