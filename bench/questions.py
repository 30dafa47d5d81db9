"""By how much, and for which parameter: `make bench ONLY=questions`, or `python bench/questions.py`.

check    one check of the task with the engine that all of them use, CPU seconds; kernels are loaded before
seconds  the whole answer, from the task: every margin of the larger floor's patrolling (T = τ = 15) for the best
         policies and for the one that is best for P; P of patrolling (T = τ = 10) over a parameter, within a tolerance
checks   seconds / check: how many checks the answer costs

Answers are compared before they are timed: the smallest positive margin with P, the ends of the range with two checks.
CPU seconds of the fastest of some runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import stltool as stl

FACTORY = Path(__file__).resolve().parent.parent / "examples" / "factory"


def fastest(n: int, action: Callable[[], object]) -> float:
    """CPU seconds of the fastest of n runs."""
    times = []
    for _ in range(n):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def row(question: str, answer: str, one: Callable[[], object], all_of_it: Callable[[], object], runs: int) -> str:
    check, seconds = fastest(runs, one), fastest(runs, all_of_it)
    return f"| {question} | {answer} | {check:.3g} | {seconds:.3g} | {seconds / check:.1f} |"


def over_a_parameter(family: stl.Product, low: Fraction, high: Fraction, tol: float, runs: int) -> str:
    """P over the success of moves."""
    over = {"success": (low, high)}
    found = stl.parametric(family, over=over, tol=tol)
    assert found.status == "complete"
    members = {p: replace(family, model=family.model.at(success=p)) for p in (low, high)}
    for p, member in members.items():
        assert abs(found.at(p)[0] - stl.check(member, engine="words").lower) < tol
    return row(
        f"P over the success in [{float(low):g}, {float(high):g}], within {tol:g}",
        f"{len(found.pieces)} pieces",
        lambda: stl.check(members[low], engine="words", keep_policy=False),
        lambda: stl.parametric(family, over=over, tol=tol),
        runs,
    )


def table(quick: bool = False) -> list[str]:
    size, runs = (5, 1) if quick else (15, 5)
    task = stl.load_task(FACTORY / "margins.stl", params={"T": size, "tau": size})
    model = stl.load_model(FACTORY / "floor-10x10.toml")
    product = stl.build_product(model, task)
    best = stl.check(product, engine="words")
    found = stl.robustness_distribution(model, task)
    assert abs(found.at(1e-9)[0] - best.lower) < 1e-9
    lines = ["| question | answer | check, s | seconds | checks |", "|---|---|---:|---:|---:|"]

    def one() -> object:
        return stl.check(product, engine="words", keep_policy=False)

    answer = f"{len(found.values)} margins"
    lines.append(
        row("every margin, the best policies", answer, one, lambda: stl.robustness_distribution(model, task), runs)
    )
    own = "every margin, the policy that is best for P"
    lines.append(row(own, answer, one, lambda: stl.robustness_distribution(model, task, best.policy), runs))
    small = stl.load_task(FACTORY / "patrolling.stl", params={"T": 4, "tau": 4} if quick else {"T": 10, "tau": 10})
    family = stl.build_product(stl.load_model(FACTORY / "floor-10x10.toml"), small)
    lines.append(over_a_parameter(family, Fraction(9, 10), Fraction(19, 20), 1e-9, runs))
    lines.append(over_a_parameter(family, Fraction(1, 2), Fraction(1), 1e-3, runs))
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
