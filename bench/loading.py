"""Grid files, `MDP.from_arrays` and the letters of a task: CPU seconds and memory, beside an older commit's.

Open floors of n × n cells (bench/floors.py). Load: the model file, read; rows are made when they are needed, all of
them where it says so. Letters: `build_product` on the loaded model,
with a task of one predicate, so that the automaton costs nothing. Arrays: `from_arrays` of nine sparse matrices of the
floor's size. Memory is what the process's peak rises by. Each in a process of its own.

The older commit takes minutes and gigabytes for 1000 × 1000: `python bench/loading.py 300` stops there.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from floors import open_floor
from older import COMMIT, older_sources

SIZES = (100, 300, 1000)
PARTS = ("load", "load, all rows", "letters", "arrays")


def measured(n: int, part: str) -> tuple[float, float]:
    """CPU seconds, and GB that the peak rises by."""
    import numpy as np
    from scipy import sparse

    import stltool as stl

    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder) / "small.toml", Path(folder) / "large.toml"
        small.write_text(open_floor(10))
        large.write_text(open_floor(n))
        phi = stl.parse("F[0,1] A")
        first = stl.load_model(small)  # which imports what it takes
        stl.build_product(first, phi)
        if part == "arrays":
            x, y = np.meshgrid(np.arange(n), np.arange(n))
            cell = {(dx, dy): (np.clip(y + dy, 0, n - 1) * n + np.clip(x + dx, 0, n - 1)).ravel()
                    for dx in (-1, 0, 1) for dy in (-1, 0, 1)}  # fmt: skip
            rows = np.arange(n * n + 1) * 4
            share = np.tile([0.7, 0.1, 0.1, 0.1], n * n)
            matrices = []
            for there in cell.values():
                ways = np.stack([there, cell[0, 0], cell[1, 0], cell[0, 1]], axis=1).ravel()
                matrices.append(sparse.csr_array((share, ways, rows), shape=(n * n, n * n)))
                matrices[-1].sum_duplicates()
        model = stl.load_model(large) if part == "letters" else None
        peak, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        if part.startswith("load"):
            loaded = stl.load_model(large)
            assert loaded.n_states == n * n
            assert part == "load" or len(loaded.target) == loaded.n_transitions
        elif part == "letters":
            assert model is not None
            stl.build_product(model, phi)
        else:
            assert stl.MDP.from_arrays(matrices, {"x": x.ravel() + 0.5}).n_states == n * n
        seconds = time.process_time() - started
        return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1e6


def cell(n: int, part: str, path: str | None) -> tuple[float, float]:
    """The same in a fresh process; `path` is where another stltool is."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    command = [sys.executable, __file__, "--cell", str(n), part]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    seconds, memory = json.loads(done.stdout)
    return seconds, memory


def table(quick: bool = False, most: int = max(SIZES)) -> list[str]:
    most = min(SIZES) if quick else most
    lines = [
        f"| cells | part | now: CPU s, GB | {COMMIT}: CPU s, GB | {COMMIT} / now: time, memory |",
        "|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        older = older_sources(folder)
        for n in SIZES:
            for part in PARTS if n <= most else ():
                (now, room), (before, its_room) = cell(n, part, None), cell(n, part, older)
                ratio = f"{its_room / room:.1f} ×" if room > 1e-3 else "–"
                lines.append(
                    f"| {n} × {n} | {part} | {now:.3f}, {room:.3f} | {before:.3f}, {its_room:.3f} | "
                    f"{before / now:.1f} ×, {ratio} |"
                )
                print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    if sys.argv[1:2] == ["--cell"]:
        print(json.dumps(measured(int(sys.argv[2]), sys.argv[3])))
    else:
        print("\n".join(table(False, *map(int, sys.argv[1:]))))
