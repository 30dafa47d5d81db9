"""Executions to the first violation of ARCH-COMP's requirements on the systems of bench/plants.py, of ten seeds.

    stltool      `stl.testing.falsify` as it is
    uniform      independent uniform control points
    Hypothesis   @given control points as floats of their ranges, and an assertion; no targets
    PSY-TaLiRo   its dual annealing, on stltool's robustness; a run ends with the first violation

All of them choose the same control points, within the same budget. Cells are the median over the seeds and how many of
them found a violation; where half or more found none, the median is above the budget. The factor is that of the best of
the others over stltool; with medians above the budget the budget counts, so that it is a lower bound.
"""

from __future__ import annotations

import contextlib
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np
from plants import AHEAD, PIECE, REQUIREMENTS

import stltool as stl
from stltool.logic.parser import formula_task
from stltool.randomness import Purpose, generator
from stltool.testing.falsification.inputs import Inputs, Signal
from stltool.testing.falsification.run import executed
from stltool.testing.falsification.run import falsify as stl_falsify

BUDGET = 300
SEEDS = range(1000, 1010)  # which nothing was developed on
QUICK = ("AT2", "CC1")


class Problem:
    def __init__(self, name: str) -> None:
        self.plant, text = REQUIREMENTS[name]
        self.phi = formula_task(text, {}, step=self.plant.step).formula
        self.needed = stl.horizon(self.phi) + 1
        points = -(-self.needed // round(PIECE / AHEAD))
        self.inputs = {name: Signal(*ends, points=points) for name, ends in self.plant.signals.items()}
        self.inputs |= self.plant.numbers
        self.cube = Inputs(self.inputs, self.needed)

    def robustness(self, x: np.ndarray) -> tuple[bool, float]:
        trace = executed(self.plant.run, self.phi, self.cube, x, self.needed)
        found = stl.monitor(self.phi, trace, at=0)
        return bool(found.verdicts[0]), float(found.robustness[0])


def stltool(problem: Problem, budget: int, seed: int) -> int:
    found = stl_falsify(problem.plant.run, problem.phi, problem.inputs, budget=budget, seed=seed)
    return found.executions if found else budget + 1


def uniform(problem: Problem, budget: int, seed: int) -> int:
    rng = generator(seed, Purpose.FALSIFY, 1)
    for i in range(budget):
        if not problem.robustness(rng.random(problem.cube.dimension))[0]:
            return i + 1
    return budget + 1


def by_hypothesis(problem: Problem, budget: int, given_seed: int) -> int:
    from hypothesis import HealthCheck, Phase, given, seed, settings
    from hypothesis import strategies as st

    runs = 0
    first = budget + 1

    @seed(given_seed)
    @settings(max_examples=budget, phases=[Phase.generate], database=None, deadline=None, report_multiple_bugs=False,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(st.lists(st.floats(0, 1), min_size=problem.cube.dimension, max_size=problem.cube.dimension))
    def holds(points: list[float]) -> None:
        nonlocal runs, first
        runs += 1
        if not problem.robustness(np.array(points))[0]:
            first = min(first, runs)
            raise AssertionError

    with contextlib.suppress(AssertionError):
        holds()
    return first


class _Found(Exception):
    pass


def psy_taliro(problem: Problem, budget: int, seed: int) -> int:
    import staliro
    from staliro import optimizers

    runs = 0

    def evaluate(sample: Any) -> Any:
        nonlocal runs
        runs += 1
        holds, robustness = problem.robustness(np.asarray(sample.values if hasattr(sample, "values") else sample))
        if not holds:
            raise _Found
        return robustness

    class Function(optimizers.ObjFunc):  # type: ignore[misc,type-arg]
        def eval_sample(self, sample: Any) -> Any:
            return evaluate(sample)

    bounds = staliro.TestOptions(static_inputs={str(i): (0.0, 1.0) for i in range(problem.cube.dimension)}).intervals()
    parameters = optimizers.Optimizer.Params(seed=seed + 1, budget=budget, input_bounds=bounds)
    try:
        optimizers.DualAnnealing(min_cost=0.0).optimize(Function(), parameters)
    except _Found:
        return runs
    return budget + 1


def has_psy_taliro() -> bool:
    try:
        import staliro  # noqa: F401
    except ImportError:
        return False
    return True


METHODS: dict[str, Callable[[Problem, int, int], int]] = {
    "stltool": stltool,
    "uniform": uniform,
    "Hypothesis": by_hypothesis,
    "PSY-TaLiRo": psy_taliro,
}


def table(quick: bool = False) -> list[str]:
    budget, seeds = (30, SEEDS[:2]) if quick else (BUDGET, SEEDS)
    methods = [name for name in METHODS if name != "PSY-TaLiRo" or has_psy_taliro()]
    lines = [
        f"Budget {budget}, seeds {seeds[0]} to {seeds[-1]}."
        + ("" if has_psy_taliro() else " PSY-TaLiRo is not installed."),
        "",
    ]
    lines += ["| | " + " | ".join(methods) + " | factor |", "|---|" + "---:|" * (len(methods) + 1)]
    factors, slower = [], list[str]()
    for name in QUICK if quick else REQUIREMENTS:
        problem, medians, cells = Problem(name), [], []
        for method in methods:
            found = [METHODS[method](problem, budget, seed) for seed in seeds]
            medians.append(min(statistics.median(found), budget))
            shown = f"{medians[-1]:g}" if statistics.median(found) <= budget else f"> {budget}"
            cells.append(f"{shown} ({sum(one <= budget for one in found)}/{len(seeds)})")
        factors.append(min(medians[1:]) / medians[0])
        lines.append(f"| {name} | {' | '.join(cells)} | {shown_factor(factors[-1])} |")
        slower += [name] * (factors[-1] < 1)
    other = f" Another method is faster on {', '.join(slower)}." if slower else ""
    return [*lines, "", f"The median of the factors is {statistics.median(factors):.3g}.{other}"]


def shown_factor(factor: float) -> str:
    return f"{factor:.0f}" if factor >= 10 else f"{factor:.2g}"


if __name__ == "__main__":
    print("\n".join(table()))
