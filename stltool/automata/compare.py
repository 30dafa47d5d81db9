"""A shortest trace on which two automata of one formula disagree: shows what the flags of [Wang24] get wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import UNDECIDED, TaskAutomaton
from stltool.automata.compile import all_valuations, atoms_of, compile_automaton
from stltool.errors import SizeError
from stltool.logic.feasible import leaves, tabulated
from stltool.logic.formula import Formula

_MOST_VISITED = 500_000


@dataclass(frozen=True)
class Disagreement:
    """A shortest trace on which an automaton and its formula disagree: the truth of each label and comparison at every
    step, and both verdicts."""

    steps: tuple[dict[Formula, bool], ...]
    encoding_says: bool
    formula_is: bool


def with_formula(automaton: TaskAutomaton) -> Disagreement | None:
    """Where an automaton disagrees with its formula; None if nowhere.

    Only valuations that the automaton accepts occur: with a model, those of its states. Without one, comparisons are
    treated as independent of each other. Raises SizeError if the search would be too large.
    """
    read = leaves(automaton.formula)
    valuations = all_valuations(len(read))
    truth = tabulated(automaton.atoms, read, valuations)
    exact_truth = tabulated(atoms_of(automaton.formula), read, valuations)
    occurring = {row.tobytes() for row in automaton.valuations}
    possible = np.array([row.tobytes() in occurring for row in truth])
    valuations, truth, exact_truth = valuations[possible], truth[possible], exact_truth[possible]
    exact = compile_automaton(automaton.formula, "exact", np.unique(exact_truth, axis=0))
    letters = exact.letters_at(exact_truth)
    trace = disagreement(automaton, exact, automaton.letters_at(truth), letters)
    if trace is None:
        return None
    judged = exact.judge(letters[trace].tolist())
    assert judged is not None
    steps: list[dict[Formula, bool]] = [dict(zip(read, row, strict=True)) for row in valuations[trace].tolist()]
    return Disagreement(tuple(steps), not judged[0], judged[0])


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
