"""Models of PRISM's own tests, written anew from what they describe; tests/data/prism.toml has the published values.

line    five states in a line, one step each; the last one stays
skips   a walk through 0 … 7: from each state before 6 on with probability 1/2, or skip, and skip on with 1/2
levels  climb from 0 to 5, or try: from level n, t becomes 1 with probability (n + 1)/10, else 2, where it stays
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import stltool as stl

State = tuple[int, ...]
Row = dict[State, Fraction]


def made(rows: dict[State, list[Row]], names: tuple[str, ...], first: State) -> stl.MDP:
    """The MDP of these choices; the numbers in a state's tuple are its signals."""
    states = list(rows)
    most = max(map(len, rows.values()))
    transitions = np.zeros((most, len(states), len(states)), dtype=object)
    for s, state in enumerate(states):
        for a, row in enumerate(rows[state]):
            for after, probability in row.items():
                transitions[a, s, states.index(after)] = probability
    signals = dict(zip(names, np.array(states, dtype=float).T, strict=True))
    return stl.MDP.from_arrays(transitions, signals, states.index(first))


def line() -> stl.MDP:
    return made({(s,): [{(min(s + 1, 4),): Fraction(1)}] for s in range(5)}, ("s",), (0,))


def skips() -> stl.MDP:
    half = Fraction(1, 2)
    rows: dict[State, list[Row]] = {}
    for s in range(6):
        rows[s, 0] = [{(s + 1, 0): half, (s, 1): half}]
        rows[s, 1] = [{(s + 1, 0): half, (s, 1): half}]
    rows[6, 0] = rows[7, 0] = [{(7, 0): Fraction(1)}]
    return made(rows, ("s", "skip"), (0, 0))


def levels() -> stl.MDP:
    one = Fraction(1)
    rows: dict[State, list[Row]] = {}
    for s in range(5):
        caught, back = Fraction(s + 1, 10), 1 if s == 2 else 0
        rows[s, 0] = [{(s + 1, 0): one}, {(back, 1): caught, (back, 2): 1 - caught}]
    rows[5, 0] = [{(0, 1): one}]
    rows |= {(s, t): [{(s, t): one}] for s in (0, 1) for t in (1, 2)}
    return made(rows, ("s", "t"), (0, 0))
