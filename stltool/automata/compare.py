"""A shortest trace on which two automata of one formula disagree: shows what the flags of [Wang24] get wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import UNDECIDED, TaskAutomaton
from stltool.errors import SizeError

_MOST_VISITED = 500_000


def disagreement(
    left: TaskAutomaton, right: TaskAutomaton, left_letters: NDArray[np.int32], right_letters: NDArray[np.int32]
) -> list[int] | None:
    """The shortest sequence of symbols after which both are decided, differently; None if they always agree.

    Raises SizeError if the search would visit too many pairs of states.

    `left_letters` and `right_letters` (n_symbols,) give each automaton's letter for a symbol (a valuation, say).
    """
    # breadth first over (state of each, verdict of each so far; UNDECIDED until the first decision), as codes
    n_symbols, width = len(left_letters), right.n_states
    shape = (left.n_states, width, 3, 3)
    codes = np.ravel_multi_index(([left.initial], [right.initial], [0], [0]), shape)
    layers: list[
        NDArray[np.int64]
    ] = []  # for each code of a layer: its position in the previous layer · n_symbols + the symbol
    visited = 0
    for t in range(max(left.horizon, right.horizon) + 1):
        p, q, v, w = np.unravel_index(codes, shape)
        after_p, after_q = left.delta[left_letters][:, p].T, right.delta[right_letters][:, q].T  # (n_codes, n_symbols)
        found_v, found_w = left.verdicts(min(t, left.horizon))[after_p], right.verdicts(min(t, right.horizon))[after_q]
        v, w = (np.where(was[:, None] != 0, was[:, None], now - UNDECIDED) for was, now in ((v, found_v), (w, found_w)))
        after = np.ravel_multi_index((after_p, after_q, v, w), shape).ravel()
        _, came_from = np.unique(after, return_index=True)
        came_from.sort()  # in order of discovery
        visited += len(came_from)
        if visited > _MOST_VISITED:
            raise SizeError(
                f"no disagreement searched for: over {_MOST_VISITED} pairs of states would have to be visited"
            )
        v, w = v.ravel()[came_from], w.ravel()[came_from]
        different = np.flatnonzero((v != 0) & (w != 0) & (v != w))
        if different.size:
            return _path([*layers, came_from], int(different[0]), n_symbols)
        open_still = (v == 0) | (w == 0)
        layers.append(came_from[open_still])
        codes = after[came_from[open_still]]
    return None


def _path(layers: list[NDArray[np.int64]], place: int, n_symbols: int) -> list[int]:
    symbols = []
    for came_from in reversed(layers):
        place, symbol = divmod(int(came_from[place]), n_symbols)
        symbols.append(symbol)
    return symbols[::-1]
