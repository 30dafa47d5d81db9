"""A check on a dask cluster of this machine's processes, beside the same on one thread: `python bench/cluster.py`.

seconds   wall time of the check, the fastest of three, blocks sent included, a kept policy brought back
bytes     what workers received from each other for each step (forward and back), by dask's own count

Results are compared to the bit before they are timed. Worker processes share this machine's cores and its loopback
network, so that more of them than cores show what the exchange costs, not what more machines would bring.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster
from floors import open_floor, task

import stltool as stl
from stltool.policy import Policy

FLOORS = ((30, 40), (60, 50), (100, 60))
WORKERS = (1, 2, 4)


def received(dask_worker: Any) -> int:
    return sum(int(entry["total"]) for entry in dask_worker.transfer_incoming_log)


def forget(dask_worker: Any) -> None:
    dask_worker.transfer_incoming_log.clear()


def timed(product: stl.Product, **settings: Any) -> tuple[float, stl.CheckResult]:
    stl.check(product, **settings)
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        result = stl.check(product, **settings)
        seconds.append(time.perf_counter() - start)
    return min(seconds), result


def same(one: stl.CheckResult, other: stl.CheckResult) -> bool:
    first, second = one.policy, other.policy
    assert isinstance(first, Policy)
    assert isinstance(second, Policy)
    steps = np.unique(np.linspace(0, one.product.horizon - 1, 9).astype(int)).tolist()
    return (one.probability, one.lower, one.upper) == (other.probability, other.lower, other.upper) and all(
        np.array_equal(first.row(t), second.row(t)) for t in steps
    )


def table(quick: bool = False) -> list[str]:
    lines = [
        "| open floor (n, τ) | here, one thread | " + " | ".join(f"{n} worker{'s' * (n > 1)}" for n in WORKERS)
        + " | bytes a step, 2 workers | 4 workers |",
        "|---|" + "---|" * (len(WORKERS) + 3),
    ]  # fmt: skip
    for n, tau in FLOORS[: 1 if quick else None]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "floor.toml"
            file.write_text(open_floor(n), encoding="utf-8")
            product = stl.build_product(stl.load_model(file), stl.parse(task(tau)))
        alone, here = timed(product, engine="words", threads=1)
        cells, sent = [], []
        for workers in WORKERS:
            with (
                LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
                Client(cluster) as client,
            ):
                seconds, there = timed(product, cluster=cluster.scheduler_address)
                assert same(here, there), (n, tau, workers)
                cells.append(f"{seconds:.2f} s")
                client.run(forget)
                result = stl.check(product, cluster=cluster.scheduler_address)
                if workers > 1:
                    sent.append(f"{sum(client.run(received).values()) / (product.horizon + result.sweeps):,.0f}")
        lines.append(f"| ({n}, {tau}) | {alone:.2f} s | {' | '.join(cells + sent)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smallest floor only")
    print("\n".join(table(parser.parse_args().quick)))
