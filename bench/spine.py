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
from stltool.learning.problem import Problem
from stltool.learning.swept import CautiousTable, Transitions
from stltool.learning.tables import Entries

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
    problem, rng, caution = Problem.of(product), np.random.default_rng(0), 0.1
    entries, model = Entries(problem), product.model

    def table_of(n: int) -> tuple[CautiousTable, Transitions, Callable[[], None], int]:
        """A table, n transitions of the model, what replays them from the beginning, and how many updates that is."""
        choice = rng.integers(model.n_choices, size=n)
        counts = stl.Counts(model.n_choices, problem.n_states)
        counts.add(choice, model.target[rng.integers(model.row_start[choice], model.row_start[choice + 1])])
        table, transitions = CautiousTable(entries, caution), Transitions(problem, counts)

        def again() -> None:
            table.visits[:] = 0
            table.sweep(transitions)

        tried = (transitions.stored.visits > 0).sum(axis=1)
        return table, transitions, again, int(tried @ entries.numbers[problem.letter])

    few, transitions, again, updates = table_of(30)
    plain = CautiousTable(entries, caution)

    def one_by_one() -> None:
        """As it is written down: an update a pair (t, q), the best next values looked up in the Q-table."""
        Q, E, stored = plain.Q, entries.E, transitions.stored
        rows = [(divmod(row, Q.shape[1]), np.flatnonzero(stored.row[: stored.size[0]] == row)) for row in
                np.unique(stored.row[: stored.size[0]]).tolist()]  # fmt: skip
        for t in range(problem.automaton.horizon - 1, -1, -1):
            for (s, a), which in rows:
                letter, n = problem.letter[s], stored.visits[s, a]
                for e in range(entries.bounds[letter, t + 1], entries.bounds[letter, t]):
                    value = 0.0
                    for i in which:
                        s2 = stored.target[i]
                        after = entries.successor[letter, problem.letter[s2], e]
                        value += stored.seen[i] / n * (Q[s2, :, after].max() if after < E else float(after == E + 1))
                    Q[s, a, e] = (1 - caution / (n + caution)) * value + caution / (n + caution) * plain.worth[
                        letter, e
                    ]

    again()
    one_by_one()
    assert np.allclose(few.Q, plain.Q, rtol=0, atol=1e-12)
    slow = updates / best_of(3, one_by_one)
    _, _, again, updates = table_of(2000)
    fast = updates / best_of(7, again)
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
