"""Certificates written and re-checked, beside an older commit: `make bench`, or `python bench/certificates.py`.

written     CPU seconds from a result to its certificate on disk, in a process of its own for each cell, the fastest of
            some: the first loads what is compiled
re-checked  CPU seconds of `stltool.certify`
size        bytes of the file, plain and packed (.gz)

The claimed enclosures are compared first: exact ones must be equal, rounded ones must overlap. Open floors are those of
bench/floors.py. A cell that takes the older commit longer than its patience is measured with the present one alone.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

from older import COMMIT, older_sources

ROOT = Path(__file__).resolve().parent.parent
PATIENCE = 900.0  # seconds that the older commit may take for a cell
CELLS = (
    "factory reaching 5x5", "factory charging 5x5", "factory patrolling 5x5", "factory patrolling 5x5 exact",
    "factory patrolling 5x5 least", "factory patrolling 5x5 policy", "factory patrolling 10x10",
    "factory patrolling 10x10 exact", "factory patrolling 10x10 policy", "floor 30 15", "floor 30 15 exact",
    "floor 30 15 policy", "floor 30 15 least", "floor 30 20", "floor 30 40",
)  # fmt: skip
"""task and model, then what is certified: the maximum, the minimum (least), the best policy's value (policy)"""


def result_of(cell: str) -> Any:
    import stltool as stl

    kind, *words = cell.split()
    if kind == "floor":
        from floors import open_floor, task

        n, tau, *asked = words
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "floor.toml"
            file.write_text(open_floor(int(n)))
            product = stl.build_product(stl.load_model(file), stl.parse(task(int(tau))))
    else:
        name, size, *asked = words
        factory = ROOT / "examples" / "factory"
        found = stl.load_task(factory / f"{name}.stl", params={"T": 15, "tau": 15})
        product = stl.build_product(stl.load_model(factory / f"floor-{size}.toml"), found)
    best = stl.check(product, maximize="least" not in asked, exact="exact" in asked)
    return stl.check(product, best.policy) if "policy" in asked else best


def measure(cell: str, repeat: int) -> dict[str, float | str]:
    """One cell, in this process."""
    import stltool as stl

    result = result_of(cell)
    with tempfile.TemporaryDirectory() as folder:
        found: dict[str, float | str] = {}
        for ending in ("", ".gz"):
            path = Path(folder) / f"c.jsonl{ending}"
            bounds, written = _fastest(lambda path=path: stl.write_certificate(result, path), repeat)
            told, rechecked = _fastest(lambda path=path: stl.certify(path), repeat)
            assert (str(bounds[0]), str(bounds[1])) == (told["lower"], told["upper"])
            found |= {
                f"written{ending}": written,
                f"rechecked{ending}": rechecked,
                f"bytes{ending}": path.stat().st_size,
            }
        found |= {"lower": told["lower"], "upper": told["upper"], "pairs": told["pairs"]}
    return found


def _fastest(what: Any, repeat: int) -> tuple[Any, float]:
    seconds = []
    for _ in range(repeat):
        start = time.process_time()
        found = what()
        seconds.append(time.process_time() - start)
        if sum(seconds) > 20:
            break
    return found, min(seconds)


def measured(cell: str, repeat: int, path: str | None = None) -> dict[str, Any] | None:
    """The same in a process of its own, with another package where `path` says so; None where patience ends."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    command = [sys.executable, __file__, "--cell", cell, "--repeat", str(repeat)]
    try:
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return None
    return dict(json.loads(done.stdout.splitlines()[-1]))


def compare(cell: str, now: dict[str, Any], before: dict[str, Any]) -> None:
    """AssertionError where the two do not claim the same."""
    (low, high), (old_low, old_high) = ((Fraction(of["lower"]), Fraction(of["upper"])) for of in (now, before))
    assert max(low, old_low) <= min(high, old_high), (cell, now, before)
    if "exact" in cell:
        assert low == old_low == old_high == high, (cell, now, before)


def table(
    quick: bool = False, older: bool = True, cells: tuple[str, ...] = CELLS, repeat: int = 3
) -> list[str]:  # fmt: skip
    cells, repeat = (cells[:1], 1) if quick else (cells, repeat)
    lines = [
        f"| certificate | enclosure's width, {COMMIT} / now | written, s | re-checked, s | KB, plain | KB, packed | "
        "times less: written | re-checked | plain | packed |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = older_sources(folder) if older else None
        for cell in cells:
            now = measured(cell, repeat)
            assert now is not None, cell
            before = measured(cell, repeat, path) if path else None
            if before is not None:
                compare(cell, now, before)
            width, old_width = (
                float(Fraction(of["upper"]) - Fraction(of["lower"])) if of else float("nan") for of in (now, before)
            )
            keys = ("written", "rechecked", "bytes", "bytes.gz")
            ratios = (f"{before[key] / now[key]:.3g} ×" if before else "–" for key in keys)
            lines.append(
                f"| {cell} | {old_width:.2g} / {width:.2g} | {now['written']:.3g} | {now['rechecked']:.3g} | "
                f"{now['bytes'] / 1000:.0f} | {now['bytes.gz'] / 1000:.0f} | {' | '.join(ratios)} |"
            )
            print(lines[-1], file=sys.stderr)
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cell")
    parser.add_argument("--only", nargs="*", default=CELLS)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--no-older", action="store_true")
    parser.add_argument("--quick", action="store_true", help="the first cell, one run")
    given = parser.parse_args()
    if given.cell:
        print(json.dumps(measure(given.cell, given.repeat)))
    else:
        print("\n".join(table(given.quick, not given.no_older, tuple(given.only), given.repeat)))
