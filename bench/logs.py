"""Reading CSV logs, beside pyarrow's reader (its default, on all cores) and numpy.loadtxt: values compared first.

Five columns of 1e6 rows: the time and four signals. In `full` the signals are doubles as Python prints them; in
`rounded` three are decimals of three and six places, one is of truth values; in `quoted` one column is a note in quotes
with commas, which nobody asks for but pyarrow. Times are the shortest processor times, of all cores together, of some
runs taken in turn.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from monitors import shortest

import stltool as stl

ROWS, FEW = 1_000_000, 20_000


def write(path: Path, kind: str, n: int) -> list[str]:
    """A log of that kind; the names of its signals."""
    rng = np.random.default_rng(0)
    a, b, c = rng.normal(size=(3, n)).tolist()
    last = {"full": rng.random(n).tolist(), "rounded": (rng.random(n) < 0.5).tolist()}.get(kind)
    with path.open("w") as file:
        file.write("t,a,b,c,d\n")
        for i in range(n):
            if kind == "full":
                file.write(f"{i / 100},{a[i]!r},{b[i]!r},{c[i]!r},{last[i]!r}\n")
            elif kind == "rounded":
                file.write(f"{i / 100},{a[i]:.3f},{b[i]:.6f},{c[i]:.3f},{str(last[i]).lower()}\n")
            else:
                file.write(f'{i / 100},{a[i]!r},{b[i]:.3f},{c[i]:.6f},"note {i}, by hand"\n')
    return ["t", "a", "b", "c", *(["d"] if kind != "quoted" else [])]


def rows(kind: str, n: int, runs: int) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        names = write(path, kind, n)
        size = path.stat().st_size

        def ours() -> dict[str, Any]:
            return stl.load_trace(path, names, time="none")

        first = time.perf_counter()
        found = ours()
        first = time.perf_counter() - first
        what = f"{kind}, {size / 1e6:.3g} MB"
        lines = [f"| {what}: the first reading in a process | | {first:.3g} s |"]
        try:
            from pyarrow import csv as arrow
        except ImportError:
            return [*lines, f"| {what} | pyarrow | not measured: it is not installed |"]
        theirs = arrow.read_csv(path)
        for name in names:
            assert np.array_equal(theirs.column(name).to_numpy(zero_copy_only=False), found[name]), name
        mine, other = shortest(runs, ours, lambda: arrow.read_csv(path))
        lines.append(f"| {what} ({mine:.3g} s) | pyarrow.csv ({other:.3g} s) | {mine / other:.3g} × its time |")
        if kind == "full":
            (once,) = shortest(1, lambda: np.loadtxt(path, delimiter=",", skiprows=1))
            lines.append(f"| {what} ({mine:.3g} s) | numpy.loadtxt ({once:.3g} s) | {mine / once:.2g} × its time |")
        return lines


def table(quick: bool = False) -> list[str]:
    n, runs = (FEW, 1) if quick else (ROWS, 7)
    found = [line for kind in ("full", "rounded", "quoted") for line in rows(kind, n, runs)]
    return [f"{n:,} rows × 5 columns", "", "| what | against | figure |", "|---|---|---|", *found]


if __name__ == "__main__":
    print("\n".join(table()))
