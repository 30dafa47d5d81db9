"""The paper's closing question: how many of the tuples that CFER replays should be factual ones?

`cfer` as published draws from one memory that counterfactual tuples fill; `factual_share` draws that share of every
batch from factual ones instead. Everything else is as published (Table I), ten seeds. P is the exact probability of the
greedy policy: at the end, and its mean over the run (the area under the learning curve), median and quartiles of seeds.

    python bench/ablation.py [--methods cfer,cfper] [--scenarios P1,P3,C2] [--seeds 10] [--workers 2] [--out FILE]
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import quantiles

from story import FACTORY, SCENARIOS, markdown

import stltool as stl

SHARES = (None, 0.25, 0.5, 0.75, 1.0)  # a share of 0 is None, to the bit
SMALL = {"decay": 400, "memory": 1000, "period": 4, "batch": 64}
LARGE = {"decay": 1000, "memory": 10000, "period": 4, "batch": 256}
SETTINGS = {"C2": {**SMALL, "episodes": 4000}, "P1": {**SMALL, "episodes": 4000}, "P3": {**LARGE, "episodes": 10000}}


def run(job: tuple[str, str, float | None, int]) -> tuple[float, float]:
    """(P at the end, its mean over the run)"""
    method, scenario, share, seed = job
    name, n, T, tau = SCENARIOS[scenario]
    task = stl.load_task(FACTORY / f"{name}.stl", params={"T": T, "tau": tau})
    product = stl.build_product(stl.load_model(FACTORY / f"floor-{n}x{n}.toml"), task)
    settings = {**SETTINGS[scenario], "factual_share": share, "evaluate_every": 100}
    points = stl.learn(product, method, faithful=True, seed=seed, **settings).history
    return points[-1].probability, sum(point.probability for point in points) / len(points)


def spread(values: list[float]) -> str:
    low, middle, high = quantiles(values, n=4, method="inclusive")
    return f"{middle:.3f} ({low:.3f} – {high:.3f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", default="cfer,cfper")
    parser.add_argument("--scenarios", default="P1,P3,C2")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=None)
    asked = parser.parse_args()
    cells = [(m, s, share) for s in asked.scenarios.split(",") for m in asked.methods.split(",") for share in SHARES]
    rows = []
    with ProcessPoolExecutor(asked.workers) as pool:
        done = pool.map(run, [(*cell, seed) for cell in cells for seed in range(asked.seeds)])
        for method, scenario, share in cells:
            results = [next(done) for _ in range(asked.seeds)]
            rows.append({
                "scenario": scenario,
                "method": method,
                "factual share": "0, as published" if share is None else f"{share:g}",
                "P at the end": spread([end for end, _ in results]),
                "mean P over the run": spread([mean for _, mean in results]),
            })  # fmt: skip
            print(*rows[-1].values(), flush=True)
    text = "\n".join(markdown(rows)) + "\n"
    print(text)
    if asked.out is not None:
        asked.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
