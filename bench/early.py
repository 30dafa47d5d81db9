"""Random formulas with long windows, whose predicates occur in two polarities and depend on each other: how many of
them an online monitor decides exactly, by its automaton, by three-valued truth, and with the search.

A formula counts as exact with the search if no search was cut off in its run over one random trace.
"""

from __future__ import annotations

import argparse

import numpy as np

import stltool as stl
from stltool.logic.formula import (
    Always,
    And,
    Eventually,
    Formula,
    Iff,
    Implies,
    Interval,
    Or,
    Release,
    Until,
    horizon,
)  # fmt: skip

ATOMS = [stl.parse(text) for text in ("p", "q", "x > 3", "x > 2", "x <= 3", "y < 1 & p", "x > 2 & q")]


def random_formula(rng: np.random.Generator, depth: int, longest: int) -> Formula:
    if depth == 0:
        return ATOMS[rng.integers(len(ATOMS))]

    def below() -> Formula:
        return random_formula(rng, depth - 1, longest)

    b = int(rng.integers(1, longest + 1))
    interval = Interval(int(rng.integers(0, b)) if rng.random() < 0.3 else 0, b)
    match rng.integers(8):
        case 0 | 1:
            return Eventually(interval, below())
        case 2 | 3:
            return Always(interval, below())
        case 4:
            return (Until, Release)[rng.integers(2)](interval, below(), below())
        case 5:
            return And((below(), below()))
        case 6:
            return Or((below(), below()))
        case _:
            return (Implies, Iff)[rng.integers(2)](below(), below())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--formulas", type=int, default=200)
    parser.add_argument("--longest", type=int, default=60, help="the longest window")
    parser.add_argument("--samples", type=int, default=200)
    given = parser.parse_args()
    rng = np.random.default_rng(0)
    automaton = structure = searched = exact = 0
    for _ in range(given.formulas):
        phi = random_formula(rng, int(rng.integers(2, 5)), given.longest)
        online = stl.OnlineMonitor(phi)
        automaton += online.early.engine == "automaton" or horizon(phi) == 0
        structure += online.early.engine == "structure" and online.early.exact
        if online.early.engine != "search":
            continue
        searched += 1
        n = given.samples
        trace = {
            "p": rng.random(n) < 0.9, "q": rng.random(n) < 0.1, "x": np.repeat(rng.choice([1, 2.5, 3.5], n), 3)[:n],
            "y": rng.choice([0.0, 2.0], n),
        }  # fmt: skip
        for t in range(n):
            online.feed({name: values[t] for name, values in trace.items()})
        exact += online.early.exact
    print(f"{given.formulas} formulas: {automaton} by automaton, {structure} by structure", end="; ")
    print(f"of {searched} others, {exact} by search, {automaton + structure + exact} in all")


if __name__ == "__main__":
    main()
