"""`time_distribution`: the probability that a task holds with time robustness of at least k, for k = 0, 1, 2, …

Both readings of the term are tasks themselves (logic/timing.py), so each k is an ordinary check with its enclosure: of
the best policy for that k, or of a given one. With a margin r it is P(ρ ≥ r) of these tasks: every predicate keeps a
margin of r for k steps.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of, real, require, whole
from stltool.checking.check import check
from stltool.checking.induction import Progress
from stltool.checking.margins import Thresholds, check_along, probability_of
from stltool.display import Card, Displayed, probability_text
from stltool.logic.formula import Formula, bounded_formula_of
from stltool.logic.task import Task
from stltool.logic.timing import READINGS, Reading, time_shifted
from stltool.models import MDP
from stltool.policy import Policy
from stltool.product import Product, build_product, require_names

Floats: TypeAlias = NDArray[np.float64]

_SHOWN = 10  # rows in a notebook


@dataclass(frozen=True, eq=False, repr=False)
class TimeDistribution(Displayed):
    """P(time robustness ≥ k), for k = 0 … most, in both readings; 0 stands for the task itself.

    bounds    by reading, "predicates" and "task": (lower, upper), each (most + 1,); for each k's own best policy unless
              a policy was given
    margin    None, or the robustness that is asked for as well
    question  "maximum" | "minimum" (over all policies) | "policy"
    """

    task_name: str
    formula: Formula
    model: MDP
    question: Literal["maximum", "minimum", "policy"]
    margin: float | None
    bounds: Mapping[Reading, tuple[Floats, Floats]]
    policy: Policy | None
    seconds: float

    @property
    def most(self) -> int:
        """The largest k that was asked about."""
        return len(self.bounds["task"][0]) - 1

    def at(self, steps: int, reading: Reading = "predicates") -> tuple[float, float]:
        """(lower, upper) bounds on P(time robustness ≥ steps)."""
        k = whole(steps, "at's steps", 0, self.most)
        lower, upper = self._of(reading)
        return float(lower[k]), float(upper[k])

    def largest(self, at_least: float | Fraction, reading: Reading = "predicates") -> int | None:
        """The largest k whose probability is proved to be at least `at_least`; None if not even 0 has it."""
        bound = probability_of(at_least, "largest's at_least")
        lower, _ = self._of(reading)
        return max((k for k, p in enumerate(lower.tolist()) if p >= bound), default=None)

    def _of(self, reading: Reading) -> tuple[Floats, Floats]:
        one_of(reading, "reading", READINGS)
        return self.bounds[reading]

    def _card(self) -> Card:
        asked = {"maximum": "the maximum", "minimum": "the minimum", "policy": "of the policy"}[self.question]
        rows = [
            (str(k), *(f"{probability_text(low)} … {probability_text(high)}" for low, high in pairs))
            for k, *pairs in zip(itertools.count(), *(zip(*self.bounds[one], strict=True) for one in READINGS))
        ]  # fmt: skip
        return Card(
            f"TimeDistribution: P(time robustness >= k), {asked}, k from 0 to {self.most}",
            [
                {"margin": f"at least {self.margin:g}" if self.margin is not None else None},
                {"task": f"{self.task_name} := {self.formula}", "model": self.model.name},
            ],
            (("k", *READINGS), rows[:_SHOWN]),
        )


def time_distribution(
    model: MDP,
    task: Formula | Task,
    most: int,
    policy: Policy | None = None,
    *,
    margin: float | None = None,
    maximize: bool = True,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> TimeDistribution:
    """P(time robustness ≥ k) for k = 0 … most, in both readings (`time_shifted`): under `policy`, or the maximum
    (minimum) over all policies for each k by itself.

    `margin`: that the robustness is at least this, too. `policy` may be for any task on the same model whose horizon is
    at least that of the task plus `most`. Raises what `build_product` and `check` raise, PolicyError if the policy does
    not fit, FragmentError for margins of comparisons of several steps.
    """
    start = time.perf_counter()
    require(model, MDP, "time_distribution's model")
    formula = bounded_formula_of(task, "time_distribution's task")
    most = whole(most, "time_distribution's most", 0)
    require(policy, Policy, "time_distribution's policy", optional=True)
    r = float(real(margin, "time_distribution's margin", "0.1")) if margin is not None else None
    flag(maximize, "time_distribution's maximize")
    function(progress, "time_distribution's progress")
    name = task.name if isinstance(task, Task) else "formula"
    require_names(model, formula, task if isinstance(task, Task) else None, ())

    def product_of(phi: Formula) -> Product:
        if r is None:
            return build_product(model, phi, memory_limit=memory_limit)
        [product] = Thresholds("time_distribution", model, phi, policy, maximize, memory_limit).products(np.array([r]))
        return product

    def found(k: int, reading: Reading) -> tuple[float, float]:
        product = product_of(time_shifted(formula, k, reading))
        if policy is None:
            result = check(product, maximize=maximize, keep_policy=False, memory_limit=memory_limit)
        else:
            result = check_along(product, policy, memory_limit)
        return result.lower, result.upper

    itself = found(0, "task")
    bounds: dict[Reading, tuple[Floats, Floats]] = {}
    for number, reading in enumerate(READINGS):
        rows = [itself]
        for k in range(1, most + 1):
            rows.append(found(k, reading))
            if progress is not None:
                progress(number * most + k, len(READINGS) * most)
        lower, upper = np.array(rows).T
        bounds[reading] = lower, upper
    question: Literal["maximum", "minimum", "policy"]
    question = "policy" if policy is not None else "maximum" if maximize else "minimum"
    seconds = time.perf_counter() - start
    return TimeDistribution(name, formula, model, question, r, bounds, policy, seconds)
