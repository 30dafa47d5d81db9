"""Model files in UMB and DRN, beside umbi and Storm: CPU seconds to read them, and GB that the peak rises by.

A random MDP with five actions a state and two branches a choice, a double and an integer as variables of its states, a
label and a reward; stltool writes the file. Before anything is timed, what the others read of the smallest file is
compared with what stltool reads: targets and probabilities, number by number. umbi reads files that are not compressed,
and is left out where it takes minutes; Storm reads no variables of states. Each cell in a process of its own, after
reading a small file of the same kind.
"""

from __future__ import annotations

import gzip
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

BRANCHES = (10_000, 100_000, 1_000_000)
KINDS = (".umb", "gzipped .umb", ".drn")
TOOLS = ("stltool", "umbi", "Storm")
_MOST_OF_UMBI = 100_000  # branches


def write_model(branches: int, path: Path, packed: bool) -> None:
    import numpy as np

    import stltool as stl
    from stltool.models.costs import Amounts, Cost
    from stltool.models.rows import Stored

    rng, states = np.random.default_rng(0), branches // 10
    target = np.sort(rng.integers(0, states // 2, (5 * states, 2)) + np.array([0, states // 2]), axis=1).astype(
        np.int32
    )
    share = rng.integers(1, 1000, 5 * states) / 1000
    first = np.zeros(states)
    first[0] = 1
    model = stl.MDP(
        Stored(
            np.arange(states + 1) * 5, np.tile(np.arange(5, dtype=np.int32), states), np.arange(5 * states + 1) * 2,
            target.ravel(), np.stack([share, 1 - share], axis=1).ravel(),
        ),
        initial=first, signals={"x": rng.random(states), "k": np.arange(states) * 1.0},
        labels={"goal": rng.random(states) < 0.1}, action_names=("a", "b", "c", "d", "e"),
        costs={"toll": Cost(Amounts(np.ones(states)))},
    )  # fmt: skip
    stl.save_model(model, path)
    if packed:
        path.write_bytes(gzip.compress(path.read_bytes(), 6))


def reader(tool: str, kind: str) -> Callable[[Path], Any]:
    if tool == "stltool":
        import stltool as stl

        return stl.load_model
    if tool == "umbi":
        import umbi

        return lambda path: umbi.umb.read(path)
    import stormpy

    read = stormpy.build_model_from_drn if kind == ".drn" else stormpy.build_model_from_umb
    return lambda path: read(str(path))


def rows_of(tool: str, read: Any) -> tuple[list[int], list[float]]:
    """Targets and probabilities, in order."""
    if tool == "stltool":
        return read.target.tolist(), read.probability.tolist()
    if tool == "umbi":
        return list(read.branch_to_target), [float(value) for value in read.branch_to_probability]
    matrix = read.transition_matrix
    entries = [(entry.column, entry.value) for c in range(matrix.nr_rows) for entry in matrix.get_row(c)]
    return [column for column, _ in entries], [value for _, value in entries]


def measured(tool: str, kind: str, path: Path, small: Path) -> tuple[float, float]:
    read = reader(tool, kind)
    read(small)
    peak, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    read(path)
    seconds = time.process_time() - started
    return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1e6


def compared(tool: str, kind: str, path: Path) -> None:
    """AssertionError unless the tool reads what stltool reads."""
    mine = rows_of("stltool", reader("stltool", kind)(path))
    its = rows_of(tool, reader(tool, kind)(path))
    assert mine == its, f"{tool} reads {path.name} differently"


def cell(*arguments: Any) -> tuple[float, float] | None:
    command = [sys.executable, __file__, "--cell", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return (found[0], found[1]) if found else None


def table(quick: bool = False, most: int = max(BRANCHES)) -> list[str]:
    most = min(BRANCHES) if quick else most
    lines = [
        "| file | branches | " + " | ".join(f"{tool}: CPU s, GB" for tool in TOOLS) + " |",
        "|---|---|" + "---|" * len(TOOLS),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for kind in KINDS:
            ending, packed = kind.split()[-1], kind.startswith("gzipped")
            small = Path(folder) / f"small{ending}"
            cell("write", 1000, small, packed)
            for n in BRANCHES:
                if n > most:
                    continue
                path = Path(folder) / f"m{ending}"
                path.unlink(missing_ok=True)
                cell("write", n, path, packed)
                shown = []
                for tool in TOOLS:
                    if tool == "umbi" and (kind != ".umb" or n > _MOST_OF_UMBI):
                        shown.append("–")
                        continue
                    if tool != "stltool" and n == min(BRANCHES):
                        cell("compare", tool, kind, path, small)
                    found = cell("time", tool, kind, path, small)
                    assert found is not None
                    shown.append(f"{found[0]:.3f}, {found[1]:.3f}")
                lines.append(f"| {kind} | {n} | {' | '.join(shown)} |")
                print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    if sys.argv[1:2] == ["--cell"]:
        what, tool, kind = sys.argv[2:5]
        if what == "write":  # in a process of its own, whose peak later ones do not inherit
            write_model(int(tool), Path(kind), sys.argv[5] == "True")
            print("null")
            sys.exit()
        path, small = map(Path, sys.argv[5:7])
        if what == "compare":
            compared(tool, kind, path)
            print("null")
        else:
            print(json.dumps(measured(tool, kind, path, small)))
    else:
        print("\n".join(table(False, *map(int, sys.argv[1:]))))
