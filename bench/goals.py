"""How few environment steps learning takes: exact P of the learned policy against the optimum, twenty seeds a scenario.

table    the paper's scenarios with its environment steps (episodes × (T + τ)); the model-based learner may use 1/50 of
         them, the model-free one 1/20: the most steps taken, least … greatest P / P*, how many seeds reach 0.99
beyond   families beyond the paper's floor (bench/families.py), beside posterior sampling and UCBVI on the same product
         (bench/baselines.py): median and least P / P* of so many seeds, and for each of ours the mean difference to the
         better of the two, seed by seed, with its standard error

The seeds are drawn anew each time and printed; `--draw N` repeats a draw. `python bench/goals.py` prints the first
table, `python bench/goals.py beyond` the second; names of scenarios or families, and `--seeds N`, make it shorter.
"""

from __future__ import annotations

import argparse
import os
import secrets
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stltool as stl

FACTORY = Path(__file__).resolve().parent.parent / "examples" / "factory"
SEEDS = 20
BEYOND = 12  # of each family
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


def row(scenario: str, seeds: list[int], pool: ProcessPoolExecutor) -> str:
    best = stl.check(product_of(scenario)).probability
    _, _, T, tau, episodes = SCENARIOS[scenario]
    jobs = {m: [pool.submit(learned, scenario, m, seed) for seed in seeds] for m in SHARE}
    cells = [f"{best:.6f}", str(episodes * (T + tau))]
    for method in SHARE:
        results = [job.result() for job in jobs[method]]
        ratios = sorted(p / best for p, _ in results)
        reached = sum(ratio >= 0.99 for ratio in ratios)
        cells.append(f"{max(n for _, n in results)}: {ratios[0]:.4f} … {ratios[-1]:.4f}, {reached}/{len(seeds)}")
    return f"| {scenario} | " + " | ".join(cells) + " |"


def draw(n: int, entropy: int | None = None) -> tuple[list[int], str]:
    """n new seeds, and a line that says how to draw them again."""
    entropy = secrets.randbits(32) if entropy is None else entropy
    seeds = [int(seed) for seed in np.random.SeedSequence(entropy).generate_state(n)]
    return seeds, f"Seeds: drawn anew; `--draw {entropy}` repeats them."


def table(quick: bool = False, names: list[str] | None = None, n: int = SEEDS, entropy: int | None = None) -> list[str]:
    seeds, drawn = draw(2 if quick else n, entropy)
    lines = [
        "| scenario | P* | paper's steps | model-based: steps, P / P*, seeds ≥ 0.99 | cfer: the same |",
        "|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for scenario in names or (["R1", "P1"] if quick else SCENARIOS):
            lines.append(row(scenario, seeds, pool))
            print(lines[-1], file=sys.stderr, flush=True)
    return [*lines, "", drawn]


def ratio(family: str, method: str, seed: int) -> float:
    """Exact P of the learned policy over the optimum."""
    import baselines
    import families

    product, steps = families.FAMILIES[family].product(seed), families.FAMILIES[family].steps
    run = stl.learn(
        product, baselines.METHODS[method], seed=seed, episodes=steps, evaluate_every=steps, most_steps=steps
    )
    probability = run.history[-1].probability
    assert probability is not None
    return probability / stl.check(product).probability


def difference(by_seed: NDArray[np.float64]) -> str:
    """The mean and its standard error."""
    return f"{by_seed.mean():+.4f} ± {by_seed.std(ddof=1) / np.sqrt(len(by_seed)):.4f}".replace("-", "−")


def beyond(
    quick: bool = False, names: list[str] | None = None, n: int = BEYOND, entropy: int | None = None
) -> list[str]:
    import baselines
    import families

    seeds, drawn = draw(2 if quick else n, entropy)
    titles = [f"{method}: median, least" for method in baselines.METHODS]
    titles += [f"{method} − the better of the two" for method in SHARE]
    lines = ["| family | steps | seeds | " + " | ".join(titles) + " |", "|---|---|---|" + "---|" * len(titles)]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for family in names or (["three states", "random, 10 states"] if quick else families.FAMILIES):
            one = families.FAMILIES[family]
            methods = [method for method in baselines.METHODS if method not in one.without]
            jobs = {m: [pool.submit(ratio, family, m, seed) for seed in seeds[: one.seeds]] for m in methods}
            found = {method: np.array([job.result() for job in some]) for method, some in jobs.items()}
            cells = [
                f"{np.median(found[m]):.4f}, {found[m].min():.4f}" if m in found else "–" for m in baselines.METHODS
            ]
            better = max((ratios for m, ratios in found.items() if m not in SHARE), key=np.mean)
            cells += [difference(found[m] - better) if m in found else "–" for m in SHARE]
            lines.append(f"| {family} | {one.steps} | {min(len(seeds), one.seeds)} | " + " | ".join(cells) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    return [*lines, "", drawn]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="?", choices=["table", "beyond"], default="table")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--draw", type=int)
    given = parser.parse_args()
    function, seeds = {"table": (table, SEEDS), "beyond": (beyond, BEYOND)}[given.what]
    print("\n".join(function(False, given.names, given.seeds or seeds, given.draw)))
