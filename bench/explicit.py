"""PRISM's and Storm's explicit files, beside Storm's reader: CPU seconds and memory, models compared first.

Random models of n / 5 states with two choices each, of three and of two successors. In `few`, five probabilities; in
`full`, doubles as Python prints them, all different. Storm reads its own dialect, without action names; stltool reads
it, too, and the same model as PRISM writes it, with action names and comments. Compared are the numbers of states,
choices and transitions, the states of the label, and the probability to reach it within ten steps.

Each reading is in a process of its own: the CPU seconds of the call, and what the process's peak rises by above what
the imports (and for stltool, a small model) took.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SIZE, FEW = 5_000_000, 100_000  # transitions
_STEPS = 10


def write(folder: Path, kind: str, n_transitions: int) -> None:
    """storm.tra, storm.lab, prism.tra, prism.lab"""
    rng, n = np.random.default_rng(0), n_transitions // 5
    s = np.arange(n)[:, None]
    first = np.sort((s + np.array([1, 7, 100]) + rng.integers(0, 3, (n, 3))) % n, axis=1).tolist()
    second = np.sort((s + np.array([2, 50]) + rng.integers(0, 3, (n, 2))) % n, axis=1).tolist()
    if kind == "few":
        p, q = [[0.9, 0.05, 0.05]] * n, [[0.75, 0.25]] * n
    else:
        two, one = rng.random((n, 2)) / 2, rng.random((n, 1))
        p = np.column_stack([two, 1 - two.sum(axis=1)]).tolist()
        q = np.column_stack([one, 1 - one]).tolist()
    with (folder / "storm.tra").open("w") as storm, (folder / "prism.tra").open("w") as prism:
        storm.write("mdp\n")
        prism.write(f"# Transitions (MDP)\n{n} {2 * n} {5 * n}\n")
        for i in range(n):
            rows = [f"{i} 0 {t} {x!r}" for t, x in zip(first[i], p[i], strict=True)]
            others = [f"{i} 1 {t} {x!r}" for t, x in zip(second[i], q[i], strict=True)]
            storm.write("\n".join([*rows, *others]) + "\n")
            prism.write(" go\n".join(rows) + " go\n" + " wait\n".join(others) + " wait\n")
    goal = range(5, n, 10)
    (folder / "storm.lab").write_text("#DECLARATION\ninit goal\n#END\n0 init\n" + "".join(f"{i} goal\n" for i in goal))
    (folder / "prism.lab").write_text(
        '# Labels\n0="init" 1="deadlock" 2="goal"\n0: 0\n' + "".join(f"{i}: 2\n" for i in goal)
    )


def measured(reader: str, path: str, small: str, judged: str) -> dict[str, Any]:
    """A reading: seconds, GB, and what was read; `judged`: "yes" also checks the model."""
    if reader == "storm":
        import stormpy
    else:
        import stltool as stl
        from stltool.models.formats import explicit, lines

        size, lines.LARGE, explicit.LARGE = lines.LARGE, 0, 0
        stl.load_model(small)  # which loads the kernels
        lines.LARGE = explicit.LARGE = size
    peak, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    if reader == "storm":
        read = stormpy.build_model_from_explicit(path, path.replace(".tra", ".lab"))
    else:
        read = stl.load_model(path)
    seconds = time.process_time() - started
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1e6
    value = 0.0
    if reader == "storm":
        if judged == "yes":
            asked = stormpy.parse_properties(f'Pmax=? [F<={_STEPS} "goal"]')[0]
            value = stormpy.model_checking(read, asked).get_value(read.initial_states[0])
        content = [read.nr_states, read.nr_choices, read.nr_transitions, len(list(read.labeling.get_states("goal")))]
    else:
        if judged == "yes":
            value = stl.check(stl.build_product(read, stl.parse(f"F[0,{_STEPS}] goal"))).probability
        content = [read.n_states, read.n_choices, read.n_transitions, int(read.labels["goal"].sum())]
    return {"seconds": seconds, "memory": memory, "content": content, "value": value}


def reading(reader: str, path: Path, small: Path, judged: bool) -> dict[str, Any]:
    """The same in a fresh process."""
    command = [sys.executable, __file__, "--cell", reader, str(path), str(small), "yes" if judged else "no"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def rows(kind: str, n: int, runs: int) -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        folder, small = Path(name), Path(name) / "small"
        small.mkdir()
        for where, size in ((small, 1000), (folder, n)):  # a child's peak is at least what its parent had at the fork
            subprocess.run([sys.executable, __file__, "--write", str(where), kind, str(size)], check=True)
        lines = []
        for dialect in ("storm", "prism"):
            mine, theirs = [], []
            for first in [True, *[False] * (runs - 1)]:
                mine.append(reading("stltool", folder / f"{dialect}.tra", small / f"{dialect}.tra", first))
                theirs.append(reading("storm", folder / "storm.tra", small / "storm.tra", first))
            assert mine[0]["content"] == theirs[0]["content"]
            assert abs(mine[0]["value"] - theirs[0]["value"]) < 1e-9
            ours, storm = (
                {key: min(one[key] for one in found) for key in ("seconds", "memory")} for found in (mine, theirs)
            )
            size = (folder / f"{dialect}.tra").stat().st_size / 1e6
            (time_, room), (its_time, its_room) = (one.values() for one in (ours, storm))
            ratio = f"{room / its_room:.2f}" if its_room > 1e-3 else "–"  # too little to tell
            lines.append(
                f"| {kind}, as {'Storm' if dialect == 'storm' else 'PRISM'} writes it, {size:.3g} MB | "
                f"{time_:.2f} s, {room:.3f} GB | {its_time:.2f} s, {its_room:.3f} GB | "
                f"{time_ / its_time:.2f} × its time, {ratio} × its memory |"
            )
        return lines


def table(quick: bool = False, n: int = SIZE, runs: int = 3) -> list[str]:
    n, runs = (FEW, 1) if quick else (n, runs)
    head = [f"{n:,} transitions", "", "| file | stltool | Storm | ratio |", "|---|---|---|---|"]
    try:
        import stormpy  # noqa: F401
    except ImportError:
        return [*head, "| all | not measured: stormpy is not installed | | |"]
    return [*head, *(line for kind in ("few", "full") for line in rows(kind, n, runs))]


if __name__ == "__main__":
    if sys.argv[1:2] == ["--cell"]:
        print(json.dumps(measured(*sys.argv[2:6])))
    elif sys.argv[1:2] == ["--write"]:
        write(Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
    else:
        print("\n".join(table(False, *map(int, sys.argv[1:]))))
