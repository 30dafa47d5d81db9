"""Models written as PRISM's explicit files, from a function that gives the choices of a state.

For examples that are not floors: describe a state as a tuple and what can happen in it; what is reachable is written to
NAME.tra, NAME.lab and NAME.sta, which stltool and other model checkers read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

State = Any
Choice = tuple[str | None, Iterable[tuple[Fraction, State]]]
"""the action's name, and each successor with its probability"""


def write(
    stem: Path,
    initial: State,
    choices: Callable[[State], Iterable[Choice]],
    labels: Mapping[str, Callable[[State], bool]],
    variables: Mapping[str, Callable[[State], int]] | None = None,
) -> Path:
    """The states that can be reached from `initial`; the path of the .tra."""
    number, order, rows = {initial: 0}, [initial], []
    n_choices = 0
    for s, state in enumerate(order):
        for i, (action, row) in enumerate(choices(state)):
            n_choices += 1
            merged: dict[State, Fraction] = {}
            for probability, successor in row:
                merged[successor] = merged.get(successor, Fraction(0)) + probability
            for successor, probability in merged.items():
                if successor not in number:
                    number[successor] = len(order)
                    order.append(successor)
                rows.append(f"{s} {i} {number[successor]} {probability}" + (f" {action}" if action else ""))
    tra = stem.with_suffix(".tra")
    tra.write_text("\n".join([f"{len(order)} {n_choices} {len(rows)}", *rows]) + "\n", encoding="utf-8")
    names = ["init", "deadlock", *labels]
    lines = [" ".join(f'{i}="{name}"' for i, name in enumerate(names))]
    for s, state in enumerate(order):
        held = [str(i) for i, holds in enumerate(labels.values(), start=2) if holds(state)]
        if held or s == 0:
            lines.append(f"{s}: " + " ".join(["0", *held] if s == 0 else held))
    stem.with_suffix(".lab").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if variables:
        lines = ["(" + ",".join(variables) + ")"]
        lines += [
            f"{s}:(" + ",".join(str(of(state)) for of in variables.values()) + ")" for s, state in enumerate(order)
        ]
        stem.with_suffix(".sta").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return tra
