"""How few environment steps learning takes: exact P of the learned policy against the optimum, ten seeds a scenario.

The paper's scenarios with its environment steps (episodes × (T + τ)); the model-based learner may use 1/50 of them, the
model-free one 1/20. Run alone (`python bench/goals.py`), or by `make bench`.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import stltool as stl

FACTORY = Path(__file__).resolve().parent.parent / "examples" / "factory"
SEEDS = 10
SHARE = {"model-based": 50, "cfer": 20}
# id → task, cells a side, T, τ, the paper's episodes
SCENARIOS = {
    "R1": ("reaching", 5, 10, 5, 4000), "R2": ("reaching", 5, 10, 10, 4000),
    "R3": ("reaching", 10, 10, 5, 4000), "R4": ("reaching", 10, 10, 10, 4000),
    "C1": ("charging", 5, 10, 5, 4000), "C2": ("charging", 5, 10, 10, 4000),
    "C3": ("charging", 10, 10, 5, 10000), "C4": ("charging", 10, 10, 10, 10000),
    "P1": ("patrolling", 5, 10, 10, 4000), "P2": ("patrolling", 5, 15, 15, 10000),
    "P3": ("patrolling", 10, 10, 10, 10000), "P4": ("patrolling", 10, 15, 15, 10000),
    "10 × 10, T = τ = 20": ("patrolling", 10, 20, 20, 10000),
}  # fmt: skip


def product_of(scenario: str) -> stl.Product:
    name, cells, T, tau, _ = SCENARIOS[scenario]
    task = stl.load_task(FACTORY / f"{name}.stl", params={"T": T, "tau": tau})
    return stl.build_product(stl.load_model(FACTORY / f"floor-{cells}x{cells}.toml"), task)


def learned(scenario: str, method: str, seed: int) -> tuple[float, int]:
    """Exact P of the learned policy and the environment steps it took."""
    _, _, T, tau, episodes = SCENARIOS[scenario]
    budget = episodes * (T + tau) // SHARE[method]
    run = stl.learn(product_of(scenario), method, seed=seed, episodes=budget, evaluate_every=budget, most_steps=budget)
    assert run.environment_steps <= budget
    probability = run.history[-1].probability
    assert probability is not None
    return probability, run.environment_steps


def row(scenario: str, pool: ProcessPoolExecutor, seeds: int = SEEDS) -> str:
    best = stl.check(product_of(scenario)).probability
    _, _, T, tau, episodes = SCENARIOS[scenario]
    jobs = {m: [pool.submit(learned, scenario, m, seed) for seed in range(seeds)] for m in SHARE}
    cells = [f"{best:.6f}", str(episodes * (T + tau))]
    for method in SHARE:
        results = [job.result() for job in jobs[method]]
        ratios = sorted(p / best for p, _ in results)
        reached = sum(ratio >= 0.99 for ratio in ratios)
        cells.append(f"{max(n for _, n in results)}: {ratios[0]:.4f} … {ratios[-1]:.4f}, {reached}/{seeds}")
    return f"| {scenario} | " + " | ".join(cells) + " |"


def table(quick: bool = False, scenarios: list[str] | None = None) -> list[str]:
    lines = [
        "| scenario | P* | paper's steps | model-based: steps, P / P*, seeds ≥ 0.99 | cfer: the same |",
        "|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for scenario in ["R1"] if quick else scenarios or SCENARIOS:
            lines.append(row(scenario, pool, 2 if quick else SEEDS))
            print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    print("\n".join(table(scenarios=sys.argv[1:])))
