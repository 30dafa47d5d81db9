"""A robot that inspects a hall and must not run out of charge: `python -m examples.battery.robot` writes robot.tra.

The hall has 4 × 3 cells, the dock at the bottom left and the valve at the top right. A move takes one unit of charge,
and another one with probability 1/5, where the floor is wet; it ends where it should 19 times of 20, else the robot
stays. At the dock, `charge` loads three units of at most fourteen.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

from examples.explicit import Choice, State, write

WIDE, HIGH, FULL = 4, 3, 14
DOCK, VALVE = (0, 0), (3, 2)
MOVES = {"north": (0, 1), "south": (0, -1), "west": (-1, 0), "east": (1, 0)}
ARRIVES, WET = Fraction(19, 20), Fraction(1, 5)


def choices(state: State) -> Iterator[Choice]:
    x, y, charge = state
    yield "wait", [(Fraction(1), state)]
    if (x, y) == DOCK:
        yield "charge", [(Fraction(1), (x, y, min(charge + 3, FULL)))]
    if charge == 0:
        return
    for action, (dx, dy) in MOVES.items():
        there = min(max(x + dx, 0), WIDE - 1), min(max(y + dy, 0), HIGH - 1)
        row = []
        for cell, moved in ((there, ARRIVES), ((x, y), 1 - ARRIVES)):
            for used, wet in ((1, 1 - WET), (2, WET)):
                row.append((moved * wet, (*cell, max(charge - used, 0))))
        yield action, row


def main(folder: Path = Path(__file__).parent) -> Path:
    labels = {"dock": lambda s: s[:2] == DOCK, "valve": lambda s: s[:2] == VALVE}
    variables = {"x": lambda s: s[0], "y": lambda s: s[1], "charge": lambda s: s[2]}
    return write(folder / "robot", (*DOCK, FULL), choices, labels, variables)


if __name__ == "__main__":
    main()
