"""Random graphs: the best policy beside an older commit's, results compared first: `python bench/graphs.py`.

n states with four choices of up to eight successors each, drawn evenly from all states, so that no order of the states
brings neighbours together; a holds in one state of `rare`, b in as many; runs begin in the first state. The task is
G[0,14] ((F[0,14] a) & (F[0,14] b)). CPU seconds of `check` with its policy, the fastest of some, in a process of its
own for each cell. Each commit's policy is checked again by its own `check`, and must attain the optimum; the optima
must be the same. `open`: product states strictly between 0 and 1, all steps together, among those of a dense sweep.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

import numpy as np
from older import COMMIT, older_sources

CELLS = ((300, 10), (2000, 10), (20_000, 10), (20_000, 5), (20_000, 30))
"""(states, rare)"""
TASK = "G[0,14] ((F[0,14] a) & (F[0,14] b))"


def measured(n: int, rare: int, repeat: int, count: bool) -> dict[str, float]:
    """One cell, in this process."""
    from scipy import sparse

    import stltool as stl

    draw = np.random.default_rng(n)
    matrices = []
    for _ in range(4):
        length = draw.integers(1, 9, n)
        shares = draw.integers(1, 10, length.sum()).astype(float)
        row = np.repeat(np.arange(n), length)
        shares /= np.bincount(row, weights=shares)[row]
        matrices.append(sparse.csr_array((shares, (row, draw.integers(0, n, len(row)))), shape=(n, n)))
    labels = {name: draw.random(n) < 1 / rare for name in "ab"}
    model = stl.MDP.from_arrays(matrices, {}, initial=0, labels=labels)
    product = stl.build_product(model, stl.parse(TASK))
    seconds = []
    for _ in range(repeat + 1):  # the first loads what is compiled
        start = time.process_time()
        best = stl.check(product)
        seconds.append(time.process_time() - start)
    again = stl.check(product, best.policy).probability
    found = {"P": best.probability, "again": again, "seconds": min(seconds[1:]), "n": product.n_states}
    if count:
        from stltool.automata import TRUE
        from stltool.checking.induction import Game, layers_of

        layers = layers_of(Game.of(product), TRUE, engine="words")
        found["open"] = sum(layers.n_open(x.layer) * (x.last + 1 - x.first) for x in layers.backwards())
        found["open"] /= product.n_states * product.horizon
    return found


def cell(n: int, rare: int, repeat: int, path: str | None = None) -> dict[str, float]:
    """The same in a fresh process; `path` is where another stltool is."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    command = [sys.executable, __file__, "--cell", str(n), str(rare), str(repeat), *([] if path else ["--count"])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=environment, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def table(quick: bool = False) -> list[str]:
    lines = [
        f"| states | rare | product states | open | P | now, CPU s | {COMMIT}, CPU s | {COMMIT} / now |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = older_sources(folder)
        for n, rare in CELLS[: 1 if quick else None]:
            now, before = cell(n, rare, 1 if quick else 5), cell(n, rare, 1 if quick else 2, path)
            assert abs(now["P"] - before["P"]) < 1e-12, (now, before)
            for found in (now, before):
                assert abs(found["again"] - found["P"]) < 1e-12, found
            lines.append(
                f"| {n} | {rare} | {now['n']:,.0f} | {now['open']:.1%} | {now['P']:.12g} | {now['seconds']:.3g} | "
                f"{before['seconds']:.3g} | {before['seconds'] / now['seconds']:.3g} × |"
            )
            print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smallest graph, fewer runs")
    parser.add_argument("--cell", nargs=3, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--count", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.cell:
        print(json.dumps(measured(*given.cell, given.count)))
    else:
        print("\n".join(table(given.quick)))
