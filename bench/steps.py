"""CPU time of an environment step of the default learner beside an older commit: `make bench`, or bench/steps.py.

run       a whole `stltool.learn` of so many steps, without the exact check of its policy at the end, which is timed by
          itself: CPU milliseconds a step, over all seeds, of each the least of several runs; and P / P* of the policies
          of the longest runs, least and greatest
further   the steps after those: runs of three times as many, less those, which leaves out what a run does once

Both commits run in a process of their own, in turn, seed by seed, with kernels loaded. On the 5 × 5 and 10 × 10 floors,
the longest runs are long enough to learn the task; on the larger one the older learner would take an hour for that, so
both take the same few steps, and P is that of the present one alone after as many steps as it says.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from floors import open_floor
from floors import task as patrolling
from older import COMMIT, ROOT, older_sources

FACTORY = ROOT / "examples" / "factory"
SEEDS = range(1, 6)
REPEATS = 5


class Size(NamedTuple):
    """cells: of the paper's floor, unless `open`; enough: steps after which P is shown, where `steps` are few"""

    cells: int
    T: int
    tau: int
    steps: int
    open: bool = False
    enough: int | None = None


SIZES = {
    "P1": Size(5, 10, 10, 1600),
    "P3": Size(10, 10, 10, 4000),
    "10 × 10, T = τ = 20": Size(10, 20, 20, 2700),
    "20 × 20, T = τ = 40": Size(20, 40, 40, 300, open=True, enough=8000),
}


def product_of(size: Size, folder: str) -> Any:
    import stltool as stl

    if size.open:
        floor = Path(folder) / f"floor-{size.cells}.toml"
        floor.write_text(open_floor(size.cells), encoding="utf-8")
        return stl.build_product(stl.load_model(floor), stl.parse(patrolling(size.tau)))
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": size.T, "tau": size.tau})
    return stl.build_product(stl.load_model(FACTORY / f"floor-{size.cells}x{size.cells}.toml"), task)


def work(name: str) -> None:
    """Runs of one size in this process: a seed and a number of steps a line, an answer a line."""
    import stltool as stl

    with tempfile.TemporaryDirectory() as folder:
        product = product_of(SIZES[name], folder)
    best = stl.check(product).probability
    stl.learn(product, "model-based", episodes=2, evaluate_every=1, seed=0)
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        seed, steps = json.loads(line)
        # episodes of the older one take all their steps, and it has no `most_steps`
        new = "most_steps" in stl.learn.__kwdefaults__
        episodes = steps if new else steps // product.horizon
        limit = {"most_steps": steps} if new else {}
        start = time.process_time()
        run = stl.learn(product, "model-based", episodes=episodes, evaluate_every=episodes, seed=seed, **limit)
        seconds = time.process_time() - start
        start = time.process_time()
        stl.check(product, run.policy)
        seconds -= time.process_time() - start
        print(json.dumps([seconds, run.environment_steps, run.history[-1].probability / best]), flush=True)


class Worker:
    """`work` in a process of its own, with another package where `path` says so."""

    def __init__(self, name: str, path: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--work", name],
            env={**os.environ, "PYTHONPATH": path}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def run(self, seed: int, steps: int) -> tuple[float, int, float]:
        """CPU seconds, environment steps, P / P*."""
        assert self._process.stdin is not None
        print(json.dumps([seed, steps]), file=self._process.stdin, flush=True)
        seconds, taken, ratio = self._answer()
        return seconds, taken, ratio

    def end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def rows(name: str, now: Worker, before: Worker, quick: bool) -> list[str]:
    size = SIZES[name]
    seeds = list(SEEDS)[: 1 if quick or size.open else 3 if size.tau > 10 else None]
    factors = (1,) if quick or size.enough else (1, 3)
    found = {
        (which, factor, seed): min(worker.run(seed, factor * size.steps) for _ in range(1 if size.open else REPEATS))
        for seed in seeds for factor in factors for which, worker in (("now", now), ("before", before))
    }  # fmt: skip
    goods = {which: [found[which, factors[-1], seed][2] for seed in seeds] for which in ("now", "before")}
    shown = {which: f"{min(good):.4f} … {max(good):.4f}" for which, good in goods.items()}
    if size.enough:
        _, taken, ratio = now.run(seeds[0], size.steps if quick else size.enough)
        shown = {"now": f"{ratio:.4f} after {taken}", "before": "–"}
    spent = {
        (which, factor): [sum(found[which, factor, seed][i] for seed in seeds) for i in (0, 1)]
        for which in shown for factor in factors
    }  # fmt: skip
    a_step = {which: spent[which, 1][0] / spent[which, 1][1] for which in shown}
    lines = [line(name, "run", size.steps, a_step, shown)]
    if len(factors) > 1:
        for which in shown:
            (short, less), (long, more) = (spent[which, factor] for factor in factors)
            a_step[which] = (long - short) / (more - less)
        lines.append(line(name, "further", 2 * size.steps, a_step, shown))
    return lines


def line(name: str, what: str, steps: int, a_step: dict[str, float], shown: dict[str, str]) -> str:
    now, before = 1e3 * a_step["now"], 1e3 * a_step["before"]
    cells = [name, what, steps, f"{now:.4f}", shown["now"], f"{before:.4f}", shown["before"], f"{before / now:.1f} ×"]
    return f"| {' | '.join(map(str, cells))} |"


def table(quick: bool = False) -> list[str]:
    lines = [
        f"| size | of | steps | ms a step | P / P* | ms a step, {COMMIT} | P / P* | faster |",
        "|---|---|---:|---:|---|---:|---|---:|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        older = older_sources(folder)
        for name in ["P1"] if quick else SIZES:
            workers = [Worker(name, str(ROOT)), Worker(name, older)]
            found = rows(name, *workers, quick)
            for worker in workers:
                worker.end()
            lines += found
            print("\n".join(found), file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2])
    else:
        print("\n".join(table("--quick" in sys.argv)))
