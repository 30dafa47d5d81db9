"""`make bench`: every table, measured part by part in processes of their own, and kept in bench/results.md.

    python bench/run.py                  all parts, hours in all: leave the machine alone
    python bench/run.py --only A,B       these parts alone          (make bench ONLY=A,B)
    python bench/run.py --skip A,B       all but these              (make bench SKIP=A,B)
    python bench/run.py --quick          the smallest size of each part, in minutes: shows that every program runs; its
                                         figures are printed, and not kept           (make bench QUICK=1)
    python bench/run.py --list           the parts, and how long each took last

Each table says when, at which commit and on which machine it was measured. A part's table is replaced as soon as it is
measured; one that fails leaves the table as it was, and the others go on (exit code 1 at the end). Storm, RTAMT and
SENTIL come with the extra `peers`; parts that compare with an older commit need git and its history.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import os
import platform
import re
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.md"
HEAD = """# Benchmark results

`make bench` writes these tables part by part; each says when and where it was measured. bench/NAME.py says what its
columns are.
"""


class Part(NamedTuple):
    """function: of the module `module`, called with whether it shall be quick; `below`: what stands under its table."""

    title: str
    module: str
    function: str = "table"
    below: str = ""


PARTS = {
    "floors": Part("Growing floors, beside Storm and an older commit", "floors"),
    "scaling": Part(
        "Time and memory over product states", "floors", "scaling",
        "![CPU seconds and memory over product states](scaling.svg)",
    ),
    "kernels": Part("A backward step on dense rows, beside a micro-kernel", "kernels"),
    "graphs": Part("Random graphs, beside an older commit", "graphs"),
    "rigour": Part("Enclosures, intervals and exact fractions", "rigour"),
    "spine": Part("Checking and learning", "spine"),
    "questions": Part("By how much, and for which parameter: in checks", "questions"),
    "certificates": Part(
        "Certificates written and re-checked, CPU seconds and bytes, beside an older commit", "certificates"
    ),
    "parsing": Part("Reading formulas", "parsing"),
    "loading": Part("Model files: CPU seconds and memory, beside an older commit", "loading"),
    "formats": Part("Model files in UMB and DRN, beside umbi and Storm", "formats"),
    "explicit": Part("PRISM's and Storm's explicit files, beside Storm's reader", "explicit"),
    "monitors": Part("Monitors", "monitors"),
    "logs": Part("Reading logs in CSV, beside pyarrow", "logs"),
    "borders": Part("Monitors: every sample on a comparison's border", "borders"),
    "automata": Part(
        "Automata: states by encoding, seconds to compile the exact one", "automata",
        below="`*`: the flags are not the formula there.",
    ),
    "windows": Part("Automata: long windows, CPU seconds to compile them, beside an older commit", "windows"),
    "falsify": Part(
        "Falsification: executions to a violation, beside uniform points, Hypothesis and PSY-TaLiRo", "falsify"
    ),
    "shielded": Part("Deep agents trained under a shield, judged exactly", "shielded"),
    "cluster": Part("A dask cluster of this machine's processes", "cluster"),
    "goals": Part("Environment steps to a good policy, twenty new seeds", "goals"),
    "beyond": Part("Learning beyond the paper's floor, beside posterior sampling and UCBVI", "goals", "beyond"),
    "steps": Part("CPU time of an environment step of the default learner, beside an older commit", "steps"),
    "largest": Part("A billion product states, killed and resumed", "largest"),
}  # fmt: skip
_SECTION = re.compile(r"^## ", flags=re.MULTILINE)
_TOOK = re.compile(r"^Measured on .* in ([\d.]+ (?:s|min)):", flags=re.MULTILINE)


def sections(text: str) -> dict[str, str]:
    """By title, each without it."""
    return dict(part.split("\n", 1) for part in _SECTION.split(text)[1:])


def together(found: dict[str, str]) -> str:
    """Sections of the parts in their order; what is no part's is left out."""
    bodies = ((part.title, found.get(part.title)) for part in PARTS.values())
    return HEAD + "".join(f"\n## {title}\n\n{body.strip()}\n" for title, body in bodies if body is not None)


def measured(name: str, quick: bool) -> str:
    """A section's text. Raises CalledProcessError if the part fails."""
    part, start = PARTS[name], time.perf_counter()
    commit = revision()
    command = [sys.executable, str(HERE / "run.py"), "--part", name, *(["--quick"] if quick else [])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    lines = json.loads(done.stdout.splitlines()[-1])
    took = shown(time.perf_counter() - start)
    where = f"Measured on {datetime.date.today()} at {commit} in {took}: {machine()}. Columns: bench/{part.module}.py."
    return "\n".join([where, "", *lines, *(["", part.below] if part.below else [])])


def shown(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def revision() -> str:
    """The commit, and whether the sources have changed since; the bench's own results do not count."""
    try:
        asked = [["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--", "stltool", "bench/*.py"]]
        commit, changed = (
            subprocess.run(["git", *words], cwd=HERE.parent, capture_output=True, text=True, check=True).stdout.strip()
            for words in asked
        )
    except (OSError, subprocess.CalledProcessError):
        return "an unknown commit"
    return f"{commit}, changed" if changed else commit


def machine() -> str:
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("stltool", "numpy", "numba", "scipy"))
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, {versions}"


def names(given: str) -> list[str]:
    found = [name.strip() for name in given.split(",") if name.strip()]
    if unknown := [name for name in found if name not in PARTS]:
        raise argparse.ArgumentTypeError(f"no part {', '.join(unknown)}; the parts are {', '.join(PARTS)}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=names, default=list(PARTS), metavar="A,B")
    parser.add_argument("--skip", type=names, default=[], metavar="A,B")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.part:
        part = PARTS[asked.part]
        print(json.dumps(getattr(importlib.import_module(part.module), part.function)(asked.quick)))
        return
    found = sections(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    took = {name: _TOOK.search(found.get(part.title, "")) for name, part in PARTS.items()}
    wanted = [name for name in PARTS if name in asked.only and name not in asked.skip]
    if asked.list:
        for name in wanted:
            print(f"{name:<14}{took[name][1] if took[name] else 'not measured yet':<18}{PARTS[name].title}")
        return
    failed = []
    for i, name in enumerate(wanted, start=1):
        last = f", {took[name][1]} last time" if took[name] and not asked.quick else ""
        print(f"[{i}/{len(wanted)}] {name}{last}", file=sys.stderr, flush=True)
        try:
            body = measured(name, asked.quick)
        except (subprocess.CalledProcessError, IndexError, ValueError) as error:
            print(f"{name} failed: {error}", file=sys.stderr, flush=True)
            failed.append(name)
            continue
        print(f"\n## {PARTS[name].title}\n\n{body}", flush=True)
        if not asked.quick:
            if RESULTS.exists():  # as others may have changed it meanwhile
                found = sections(RESULTS.read_text(encoding="utf-8"))
            found[PARTS[name].title] = body
            beside = RESULTS.with_suffix(".new")
            beside.write_text(together(found), encoding="utf-8")
            beside.replace(RESULTS)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; again: python bench/run.py --only {','.join(failed)}")


if __name__ == "__main__":
    main()
