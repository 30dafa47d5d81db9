"""Checking and learning: `make bench` writes the figures to bench/results.md. Results are compared before timing.

check     backward induction on words against lists of pairs in numpy, on the paper's largest floor and windows
updates   Q updates a second of corrected cfer against the same updates pair by pair in a Python loop
rollouts  steps a second of runs in lock step against runs sampled one by one in plain Python
memory    peak of a whole `stltool run` of that scenario
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import stltool as stl
from stltool import kernels
from stltool.checking import estimate_from
from stltool.learning.optimism import Doubt
from stltool.learning.problem import Problem
from stltool.learning.tables import ClockedTable, Entries

ROOT = Path(__file__).resolve().parent.parent
FACTORY = ROOT / "examples" / "factory"


def best_of(n: int, action: Callable[[], object]) -> float:
    """The shortest of n timed runs, seconds."""
    times = []
    for _ in range(n):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def p4() -> stl.Product:
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 15, "tau": 15})
    return stl.build_product(stl.load_model(FACTORY / "floor-10x10.toml"), task)


def check_ratio(product: stl.Product) -> str:
    fast, slow = stl.check(product, engine="words"), stl.check(product, engine="nodes")
    assert fast.probability == slow.probability
    seconds = [best_of(7, lambda e=e: stl.check(product, engine=e)) for e in ("words", "nodes")]
    return f"| check, 10 × 10 floor, T = τ = 15 | lists of pairs in numpy | {seconds[1] / seconds[0]:.1f} × faster |"


def update_ratio(product: stl.Product) -> str:
    problem, rng = Problem.of(product), np.random.default_rng(0)
    rows = np.stack([rng.integers(n, size=2000) for n in (problem.n_states, 9, problem.n_states)], axis=1)
    rows = rows.astype(np.int32)
    entries = Entries(problem)
    visits = np.full(entries.shape[:2], 10)
    tables = [ClockedTable(entries, visits, Doubt(0.1), 0.02) for _ in range(2)]
    trust = 1 - float(Doubt(0.1).share(visits, 10)[0, 0])

    def one_by_one(some: np.ndarray) -> None:
        """As it is written down: an update a pair (t, q), the best next value looked up in the Q-table."""
        Q, E, alpha = tables[1].Q, entries.E, 0.1
        for s, a, s2 in some.tolist():
            letter, after = problem.letter[s], entries.successor[problem.letter[s], problem.letter[s2]]
            for e in range(entries.numbers[letter]):
                value = Q[s2, :, after[e]].max() if after[e] < E else float(after[e] == E + 1)
                Q[s, a, e] += alpha * (trust * value - Q[s, a, e])

    def updates(some: np.ndarray) -> int:
        return int(entries.numbers[problem.letter[some[:, 0]]].sum())

    few = rows[:20]
    tables[0].update_all(few)
    one_by_one(few)
    assert np.array_equal(tables[0].Q, tables[1].Q)
    fast = updates(rows) / best_of(7, lambda: tables[0].update_all(rows))
    slow = updates(few) / best_of(3, lambda: one_by_one(few))
    return f"| Q updates a second ({fast:.3g}) | a loop over (t, q) with numpy ({slow:.3g}) | {fast / slow:.0f} × |"


def rollout_ratio() -> str:
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), task)
    best = stl.check(product)
    assert best.policy is not None
    policy = best.policy
    few = [stl.sample_run(product, policy, seed) for seed in range(3000)]
    slowly = estimate_from([run.satisfied for run in few], len(few), confidence=0.9999)
    quickly = stl.estimate(product, policy, runs=3_000_000, confidence=0.9999)
    assert all(result.lower <= best.probability <= result.upper for result in (slowly, quickly))
    seconds = best_of(3, lambda: [stl.sample_run(product, policy, seed) for seed in range(3000)])
    slow = sum(len(run.actions) for run in few) / seconds
    assert quickly.steps is not None
    fast = quickly.steps / min(stl.estimate(product, policy, runs=quickly.runs).seconds for _ in range(7))
    return f"| rollout steps a second ({fast:.3g}) | `sample_run`, one by one ({slow:.3g}) | {fast / slow:.0f} × |"


def memory() -> str:
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, "-m", "stltool", "run", str(FACTORY / "patrolling.stl"), "-p", "T=15", "-p", "tau=15",
            "--model", str(FACTORY / "floor-10x10.toml"), "--episodes", "500", "--out", folder,
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1000
    return f"| peak memory of `stltool run`, 10 × 10 floor, T = τ = 15, 500 episodes | – | {peak:.0f} MB |"


def table(quick: bool = False) -> list[str]:
    """It takes seconds in any case."""
    kernels.warm_up("published", "clocked", "rollouts")
    product = p4()
    lines = ["| what | against | figure |", "|---|---|---|"]
    return [*lines, check_ratio(product), update_ratio(product), rollout_ratio(), memory()]


if __name__ == "__main__":
    print("\n".join(table()))
