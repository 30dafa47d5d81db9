"""Reading formulas: time against length, and against RTAMT's reader where it is installed.

The formulas are Boolean combinations of windows, wide rather than deep; the slope is that of log time over log length
between the shortest and the longest (1 is linear).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import stltool as stl

LENGTHS = (150, 1_500, 15_000, 40_000)  # operators; RTAMT meets its recursion limit somewhere above the first


def text(operators: int) -> str:
    return " and ".join(f"(always[0,{k % 50}] (x > {k}))" for k in range(operators // 3))


def seconds(read: Callable[[str], object], given: str) -> float:
    best = math.inf
    for _ in range(3):
        start = time.perf_counter()
        read(given)
        best = min(best, time.perf_counter() - start)
    return best


def rtamt_reader() -> Callable[[str], object] | None:
    try:
        import rtamt
    except ImportError:
        return None

    def read(given: str) -> object:
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.declare_var("x", "float")
        spec.spec = given
        spec.parse()
        return spec

    return read


def table(quick: bool = False) -> list[str]:
    stl.parse("a")  # the grammar itself
    lengths = LENGTHS[: 2 if quick else None]
    ours = [seconds(stl.parse, text(n)) for n in lengths]
    slope = math.log(ours[-1] / ours[0]) / math.log(lengths[-1] / lengths[0])
    lines = ["| operators | seconds | against RTAMT |", "|---:|---:|---:|"]
    other = rtamt_reader()
    for n, our in zip(lengths, ours, strict=True):
        ratio = f"{seconds(other, text(n)) / our:.1f} × faster" if other is not None and n == LENGTHS[0] else "–"
        lines.append(f"| {n} | {our:.3f} | {ratio} |")
    return [*lines, f"| log-log slope | {slope:.2f} | |"]


if __name__ == "__main__":
    print("\n".join(table()))
