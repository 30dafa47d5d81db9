"""Comparisons of which every sample is on the border, beside a plain one: `python bench/borders.py`.

10⁶ samples of signals with two decimals, or of doubles as a program computes them; ns a sample, the shortest processor
time of some runs taken in turn with `x <= y` on two of the signals. Truth and margin of a thousand samples are compared
with the slow semantics first.

  truth, both   ns a sample for the truth alone, for truth and margin
  ratio         to the plain comparison's
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from monitors import shortest

import stltool as stl

PLAIN = stl.parse("x <= y")


def cases(n: int) -> list[tuple[str, str, Mapping[str, Any]]]:
    """A text, what the samples are, and the samples."""
    rng = np.random.default_rng(0)
    x, y = np.round(rng.random((2, n)) * 100 + 0.01, 2)
    a, b, w = rng.random((3, n))
    k = np.arange(n) % 100_000 + 1
    right = {"x": np.round(0.03 * k, 2), "y": np.round(0.04 * k, 2), "z": np.round(0.05 * k, 2)}
    return [
        ("x + y <= z", "decimals", {"x": x, "y": y, "z": np.round(x + y, 2)}),
        ("x + y <= z", "computed", {"x": a, "y": b, "z": a + b}),
        ("x * y == z", "decimals", {"x": x, "y": y, "z": np.round(x * y, 4)}),
        ("x * y == z", "computed from decimals", {"x": x, "y": y, "z": x * y}),
        ("x * y == z", "computed", {"x": a, "y": b, "z": a * b}),
        ("x * y * w == z", "computed", {"x": a, "y": b, "w": w, "z": a * b * w}),
        ("sqrt(x^2 + y^2) <= z", "decimals", right),
        ("sqrt(x^2 + y^2) <= z", "computed", {"x": a, "y": b, "z": np.hypot(a, b)}),
        ("max(x, y) >= x", "decimals", {"x": x, "y": y}),
        ("x + y <= z", "decimals, none on the border", {"x": x, "y": y, "z": y}),
    ]


def row(text: str, what: str, trace: Mapping[str, Any]) -> str:
    phi, n = stl.parse(text), len(trace["x"])
    few = {name: values[:1000] for name, values in trace.items()}
    result = stl.monitor(phi, few, semantics="both")
    assert result.verdicts.tolist() == [stl.satisfies(phi, few, t) for t in range(len(few["x"]))]
    assert np.allclose(result.robustness, [stl.robustness(phi, few, t) for t in range(len(few["x"]))], 1e-9, 1e-12)
    cells = []
    for semantics in ("boolean", "both"):
        mine, plain = shortest(
            5,
            lambda kind=semantics: stl.monitor(stl.parse(text), trace, semantics=kind),  # nothing is remembered
            lambda kind=semantics: stl.monitor(PLAIN, trace, semantics=kind),
        )
        cells += [f"{mine / n * 1e9:.3g}", f"{mine / plain:.3g} ×"]
    return f"| `{text}` | {what} | {' | '.join(cells)} |"


def table(quick: bool = False) -> list[str]:
    lines = ["| comparison | samples | truth, ns | ratio | both, ns | ratio |", "|---|---|---|---|---|---|"]
    return [*lines, *(row(*case) for case in cases(2000 if quick else 1_000_000))]


if __name__ == "__main__":
    print("\n".join(table()))
