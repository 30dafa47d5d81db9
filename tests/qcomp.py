"""Models of the QComp benchmark set, written anew from what they describe, as PRISM's explicit files.

resource_gathering  A robot on 5 × 5 cells fetches gold and gems from their mines and carries them home; on two cells
                    it is attacked with probability 1/10, loses what it carries and starts again at home. `success`
                    holds once it has brought home 15 of each.
consensus           The shared coin of Aspnes and Herlihy for two processes: each flips a coin, moves a common counter
                    up or down and checks it, until it is far enough on one side. `finished_ones`: both are done
                    and found 1; `finished_disagree`: both are done and found different values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from examples import explicit

State = Any
Choice = list[tuple[Fraction, State]]

_HALF = Fraction(1, 2)


def resource_gathering(folder: Path, wanted: int = 15) -> Path:
    home, gold_mine, gem_mine, dangerous = (3, 1), (3, 5), (5, 4), {(3, 4), (4, 5)}
    attacked = Fraction(1, 10)

    def arrive(cell: tuple[int, int], gold: bool, gem: bool, golds: int, gems: int) -> State:
        gold, gem = gold or cell == gold_mine, gem or cell == gem_mine
        if cell == home:
            return (cell, False, False, False, min(golds + gold, wanted), min(gems + gem, wanted))
        return (cell, gold, gem, False, golds, gems)

    def choices(state: State) -> Iterator[Choice]:
        (x, y), gold, gem, _, golds, gems = state
        for cell in ((x - 1, y), (x + 1, y), (x, y + 1), (x, y - 1)):
            if min(cell) >= 1 and max(cell) <= 5:
                there = arrive(cell, gold, gem, golds, gems)
                robbed = (home, False, False, True, golds, gems)  # told apart from home in peace, as in the original
                yield [(1 - attacked, there), (attacked, robbed)] if cell in dangerous else [(Fraction(1), there)]

    labels = {"success": lambda state: state[4] == state[5] == wanted}
    return write(folder / "resource_gathering", (home, False, False, False, 0, 0), choices, labels)


def consensus(folder: Path, K: int, processes: int = 2) -> Path:
    top = 2 * (K + 1) * processes
    left, right = processes, top - processes

    def step(counter: int, program: int, coin: int) -> Iterator[tuple[Fraction, int, int, int]]:
        """Where one process goes: (probability, counter, its place in its program, its coin)."""
        if program == 0:  # flip
            yield from ((_HALF, counter, 1, face) for face in (0, 1))
        elif program == 1:  # move the counter
            yield Fraction(1), counter + (1 if coin else -1), 2, 0
        elif program == 2:  # check it
            far = counter <= left or counter >= right
            yield Fraction(1), counter, 3 if far else 0, int(counter >= right)

    def choices(state: State) -> Iterator[Choice]:
        counter, *each = state
        for i, (program, coin) in enumerate(each):
            choice = []
            for probability, moved, after, face in step(counter, program, coin):
                choice.append((probability, (moved, *each[:i], (after, face), *each[i + 1 :])))
            if choice:
                yield choice
        if all(program == 3 for program, _ in each):
            yield [(Fraction(1), state)]

    def finished(state: State) -> bool:
        return all(program == 3 for program, _ in state[1:])

    labels = {
        "finished_ones": lambda state: finished(state) and all(coin for _, coin in state[1:]),
        "finished_disagree": lambda state: finished(state) and len({coin for _, coin in state[1:]}) > 1,
    }
    return write(folder / f"consensus-{K}", (top // 2, *((0, 0),) * processes), choices, labels)


def write(
    stem: Path,
    initial: State,
    choices: Callable[[State], Iterator[Choice]],
    labels: Mapping[str, Callable[[State], bool]],
) -> Path:
    """The reachable part as .tra and .lab; the path of the .tra."""
    return explicit.write(stem, initial, lambda state: ((None, row) for row in choices(state)), labels)
