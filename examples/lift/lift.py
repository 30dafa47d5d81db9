"""A lift between three floors: `python -m examples.lift.lift` writes lift.tra.

A state is the floor of the cabin and who has called. With probability 1/5 somebody calls in a step, on each floor as
likely as on the others. The lift goes up, down, or opens its doors, which serves the floor.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

from examples.explicit import Choice, State, write

FLOORS = 3
CALL = Fraction(1, 5)


def choices(state: State) -> Iterator[Choice]:
    floor, called = state
    done = {
        "open": (floor, called - {floor}),
        "up": (min(floor + 1, FLOORS - 1), called),
        "down": (max(floor - 1, 0), called),
    }
    for action, (there, waiting) in done.items():
        row = [(1 - CALL, (there, waiting))]
        row += [(CALL / FLOORS, (there, waiting | {new})) for new in range(FLOORS)]
        yield action, row


def main(folder: Path = Path(__file__).parent) -> Path:
    labels = {f"call{floor}": lambda s, floor=floor: floor in s[1] for floor in range(FLOORS)}
    return write(folder / "lift", (0, frozenset()), choices, labels, {"floor": lambda s: s[0]})


if __name__ == "__main__":
    main()
