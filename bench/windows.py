"""Compiling long windows, beside an older commit: `make bench`, or `python bench/windows.py [--quick] [--no-older]`.

seconds   CPU, text to automaton, in a process of its own; `states` of a refusal: what was refused
peak      memory above what importing takes
pieces    per 64 states and letter, the fewest of (states that move by one distance) and (states that move to one state)
          that δ is made of, mean and largest: what a sweep gathers, what sets as words of bits are shifted by

The automata of both commits are compared first: states in the order that words meet them, letters by valuation.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter

import numpy as np
from numpy.typing import NDArray
from older import COMMIT, older_sources

FORMULAS = (
    "F[0,20000] a",
    "a U[0,20000] b",
    "F[0,20000) G[0,20000) a",
    "G[0,20000] F[0,20000] a",
    "G[0,20) F[0,20000) a",
    "F[0,10000) G[0,5) a",
    "G[0,20000] (a -> F[0,20000] b)",
    "G[0,20000] (a -> F[2,20000] b)",
    "G[0,20000] (a -> (a U[0,20000] b))",
    "a U[5000,20000] b",
    "G[0,20000] F[0,20000] a & F[0,20000] b & G[0,20000] c",
    "G[0,1000] (a -> F[0,1000] b)",
    "G[0,100] (a -> G[0,100] b)",
    "G[0,30) (F[0,30) a & F[0,30) b)",
    "G[0,60) (F[0,60) a & F[0,60) b)",
    "G[0,100) (F[0,100) a & F[0,100) b)",
    "G[0,10000] (F[0,10000] a & F[0,10000] b)",
)
PATIENCE = 100.0  # seconds


def cell(text: str) -> dict[str, float | str | int]:
    """One formula, in this process."""
    import stltool as stl

    stl.compile_automaton(stl.parse("G[0,9] F[0,3] a & F[0,2] b"))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    try:
        automaton = stl.compile_automaton(stl.parse(text))
    except stl.StlToolError as refusal:
        result: dict[str, float | str | int] = {
            "seconds": time.process_time() - start,
            "refused": type(refusal).__name__,
        }
    else:
        result = {"seconds": time.process_time() - start, "states": automaton.n_states}
    result["peak"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1000
    if "states" in result:
        result["digest"] = digest(automaton)
        result["mean"], result["most"] = pieces(automaton.delta)
    return result


def digest(automaton) -> str:
    """The same for automata that differ in the numbers of states and letters alone."""
    delta = automaton.delta[automaton.letter_of]
    met, number = [automaton.initial], {automaton.initial: 0}
    for q in met:
        for after in delta[:, q].tolist():
            if after not in number:
                number[after] = len(met)
                met.append(after)
    place = np.array([number[q] for q in range(automaton.n_states)])
    sha = hashlib.sha256(f"{automaton.horizon} {automaton.verdict_starts.tolist()}".encode())
    for table in (automaton.valuations, place[delta[:, met]], automaton.verdict_rows[:, met]):
        sha.update(np.ascontiguousarray(table).tobytes())
    return sha.hexdigest()


def pieces(delta: NDArray[np.int32]) -> tuple[float, int]:
    counts = []
    for row in delta.tolist():
        for first in range(0, len(row), 64):
            left = [(target - q, target) for q, target in enumerate(row[first : first + 64], first)]
            counts.append(0)
            while left:
                (shift, n), (target, m) = (Counter(column).most_common(1)[0] for column in zip(*left, strict=True))
                left = [pair for pair in left if (pair[0] != shift if n >= m else pair[1] != target)]
                counts[-1] += 1
    return float(np.mean(counts)), max(counts)


def measured(text: str, path: str | None = None) -> dict[str, float | str | int] | None:
    """`cell` in a process of its own, with another package where `path` says so; None where patience ends."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    try:
        done = subprocess.run(
            [sys.executable, __file__, "--cell", text],
            env=environment, capture_output=True, text=True, check=True, timeout=PATIENCE,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
    return dict(json.loads(done.stdout))


def table(quick: bool = False, older: bool = True) -> list[str]:
    lines = [
        f"| formula | states | seconds | peak, MB | pieces: mean, most | seconds, {COMMIT} | ratio |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = older_sources(folder) if older else None
        for text in FORMULAS[: 2 if quick else None]:
            now = measured(text)
            assert now is not None, text
            before = measured(text, path) if path else None
            if before is not None:
                assert {**before, **now}.keys() == now.keys(), (before, now)
                assert before.get("digest") == now.get("digest"), text
            states = now.get("states", "refused")
            made = f"{now['mean']:.2f}, {now['most']}" if "mean" in now else "–"
            was = f"{before['seconds']:.2f}" if before else f"> {PATIENCE:g}" if path else "–"
            ratio = f"{float(before['seconds']) / float(now['seconds']):.3g} ×" if before else "–"
            shown = text.replace("|", r"\|")
            lines.append(
                f"| `{shown}` | {states} | {now['seconds']:.2f} | {now['peak']:.0f} | {made} | {was} | {ratio} |"
            )
            print(lines[-1], file=sys.stderr, flush=True)
    return lines


if __name__ == "__main__":
    if sys.argv[1:2] == ["--cell"]:
        print(json.dumps(cell(sys.argv[2])))
    else:
        print("\n".join(table("--quick" in sys.argv, "--no-older" not in sys.argv)))
