"""A shortest trace on which two automata of one formula disagree: what the flags of [Wang24] get wrong, shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import UNDECIDED, TaskAutomaton
from stltool.errors import SizeError

_MOST_VISITED = 300_000


def disagreement(
    left: TaskAutomaton, right: TaskAutomaton, left_letters: NDArray[np.int32], right_letters: NDArray[np.int32]
) -> list[int] | None:
    """The shortest sequence of symbols after which both have decided, differently; None if they always agree.

    Raises SizeError when the search would visit too many pairs of states.

    `left_letters` and `right_letters` (n_symbols,) give each automaton's letter for a symbol (a valuation, say).
    """
    # breadth first over (state of each, verdict of each so far); UNDECIDED until the first decision
    start = (left.initial, right.initial, UNDECIDED, UNDECIDED)
    came_from: dict[tuple[int, tuple[int, ...]], tuple[tuple[int, ...], int]] = {}
    frontier: list[tuple[int, int, int, int]] = [start]
    for t in range(max(left.horizon, right.horizon) + 1):
        verdicts = (left.verdicts(min(t, left.horizon)), right.verdicts(min(t, right.horizon)))
        following: dict[tuple[int, int, int, int], None] = {}
        for state in frontier:
            for symbol, (a, b) in enumerate(zip(left_letters.tolist(), right_letters.tolist(), strict=True)):
                p, q = int(left.delta[a, state[0]]), int(right.delta[b, state[1]])
                v = state[2] if state[2] != UNDECIDED else int(verdicts[0][p])
                w = state[3] if state[3] != UNDECIDED else int(verdicts[1][q])
                after = (p, q, v, w)
                if (t, after) in came_from:
                    continue
                came_from[(t, after)] = (state, symbol)
                if len(came_from) > _MOST_VISITED:
                    raise SizeError(f"no trace looked for: over {_MOST_VISITED} pairs of states to search")
                if UNDECIDED not in (v, w):
                    if v != w:
                        return _path(came_from, t, after)
                    continue
                following[after] = None
        frontier = list(following)
    return None


def _path(
    came_from: dict[tuple[int, tuple[int, ...]], tuple[tuple[int, ...], int]], t: int, state: tuple[int, ...]
) -> list[int]:
    symbols = []
    while t >= 0:
        state, symbol = came_from[(t, state)]
        symbols.append(symbol)
        t -= 1
    return symbols[::-1]
