"""Situations in which any state may follow any other: for learned models, which may be incomplete.

    F_t = {(s, q) : q undecided after step t, δ(L(s), ·) reached it from some undecided state of step t−1}

They do not depend on the rows, so `Anywhere` finds them once for all plans over one automaton, each of which is one
call of a kernel. Where there are too many of them, `Known` has those that the rows lead to; plans may then start at any
step: `Later` counts an automaton's steps from there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TRUE, UNDECIDED, TaskAutomaton
from stltool.checking.induction.allowed import EVERYTHING
from stltool.checking.induction.graph import I32, I64, Automaton, Game
from stltool.checking.induction.layers import Budget
from stltool.checking.induction.words import Layer, Sets, Words
from stltool.choices import Choices, listed
from stltool.models.rows import starts
from stltool.sizes import IntegerType


@dataclass(frozen=True, eq=False)
class Later:
    """An automaton's steps from `since` on; `entered` is not available."""

    automaton: Automaton
    since: int

    @property
    def horizon(self) -> int:
        return self.automaton.horizon - self.since

    @property
    def n_states(self) -> int:
        return self.automaton.n_states

    def enter(self, letters: I32) -> I32:
        return self.automaton.enter(letters)

    def moves(self, t: int) -> I32:
        return self.automaton.moves(self.since + t)

    def verdicts(self, t: int) -> NDArray[np.int8]:
        return self.automaton.verdicts(self.since + t)

    def alike(self, t: int) -> tuple[int, int]:
        first, last = self.automaton.alike(self.since + t)
        return max(first - self.since, 0), last - self.since

    def keeps_numbers(self, t: int) -> bool:
        return self.automaton.keeps_numbers(self.since + t)


@dataclass(frozen=True, eq=False)
class From(Later):
    """A start in the middle of a run: the first automaton state is `q`, whatever is read."""

    q: int

    def enter(self, letters: I32) -> I32:
        return np.full(len(letters), self.q, dtype=np.int32)


class Known(Words):
    """The layers that runs from the game's first pairs reach along its rows, none of them classified as certain."""

    def __init__(self, game: Game, budget: Budget, choices: type[np.unsignedinteger]) -> None:
        super().__init__(game, TRUE, EVERYTHING, live=False, sure=False, budget=budget, choices=choices, threads=1)

    def _settled(self, layer: Sets, ahead: Layer, t: int) -> Layer:
        tiles = starts((layer.bits.view(np.uint8) != 0).reshape(-1, 8).sum(axis=1))[layer.start]
        none = np.empty(0, dtype=self.choices)
        return Layer(layer.states, layer.start, layer.word, layer.bits, np.zeros_like(layer.bits), tiles, none)


class Learned(NamedTuple):
    """Rows of a learned model: where each choice is believed to lead.

    start        (choices + 1,): the entries of each choice
    target       (entries,) successors, with probability (entries,)
    outside      (choices,): the rest of each row, which leads out of the model
    """

    start: I64
    target: I64
    probability: NDArray[np.float64]
    outside: NDArray[np.float64]


class Anywhere:
    """F_0 … F_{h−1} of an automaton over states with these letters, and the best plans over all of them.

    first_choice (S+1,): the choices of each state;  choices: the dtype of the choices that plans keep
    """

    def __init__(
        self, automaton: TaskAutomaton, letter: I32, first_choice: I64, choices: type[np.unsignedinteger]
    ) -> None:
        h, n = automaton.horizon, automaton.n_states
        self.shape = h, len(letter), n
        # copies, as a kernel is compiled for arrays that can be written to, or for others
        self._letter, self._first_choice = np.array(letter), np.array(first_choice)
        self._delta, self._choices = np.array(automaton.delta), choices
        at = np.searchsorted(automaton.verdict_starts, np.arange(h + 1), side="right") - 1
        self._verdicts = automaton.verdict_rows[at]
        letters = np.unique(letter)
        # by step: the automaton states reached on reading each letter, if it occurs
        after = np.zeros((automaton.n_letters, n), dtype=np.bool_)
        after[letters, automaton.delta[letters, automaton.initial]] = True
        self._reached = np.zeros((h, *after.shape), dtype=np.bool_)
        for t in range(h):
            here = self._reached[t] = after & (self._verdicts[t] == UNDECIDED)
            after = np.zeros_like(after)
            after[letters[:, None], automaton.delta[np.ix_(letters, np.flatnonzero(here.any(axis=0)))]] = True
        last = n - self._reached[:, :, ::-1].argmax(axis=2)
        self._spans = np.stack([self._reached.argmax(axis=2), last], axis=2)
        self._spans[~self._reached.any(axis=2)] = 0

    def codes(self, t: int) -> I64:
        """F_t as s·|Q| + q."""
        found: I64 = np.flatnonzero(self._reached[t][self._letter])
        return found

    def plan(self, rows: Learned, worth: NDArray[np.float64], since: int = 0) -> NDArray[np.unsignedinteger]:
        """(h, S, Q) the first best choices of F_since … F_{h−1}, being outside after step t worth `worth[t]`,
        but to a choice with successors no more than the best state."""
        from stltool.kernels import planning

        table = np.zeros(self.shape, dtype=self._choices)
        planning.plan(
            since, self._first_choice, *rows, worth, self._letter, self._delta, self._verdicts, self._spans, table
        )  # fmt: skip
        return table

    def listed(self, table: NDArray[np.unsignedinteger], kind: IntegerType) -> Choices:
        """A plan's choices in all of F_0 … F_{h−1}; `kind`: of a table of them."""
        h, S, Q = self.shape
        new = np.arange(h) == 0
        for by_step in (table, self._reached):
            new[1:] |= (by_step[1:] != by_step[:-1]).any(axis=(1, 2))
        first, layers = np.flatnonzero(new), []
        for t, last in zip(first.tolist(), [*(first[1:] - 1).tolist(), h - 1], strict=True):
            s, q = np.divmod(self.codes(t), Q)
            layers.append(listed(t, last, -(-Q // 64), s, q, table[t, s, q]))
        return Choices((S, Q), h, layers, kind)
