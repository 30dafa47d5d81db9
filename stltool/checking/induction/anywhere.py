"""Layers in which any state may follow any other: for learned models, which may be incomplete.

    F_t = {(s, q) : q undecided after step t, δ(L(s), ·) reached it from some undecided state of step t−1}

They do not depend on the rows, so `Anywhere` makes them once for all plans over one automaton; none of them is
classified as certain. Plans may start at any step: `Later` counts an automaton's steps from there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TRUE, UNDECIDED
from stltool.checking.induction.allowed import EVERYTHING
from stltool.checking.induction.graph import I32, I64, Automaton, Game
from stltool.checking.induction.layers import Budget, Layers
from stltool.checking.induction.nodes import Nodes
from stltool.checking.induction.words import Layer, Sets, Words
from stltool.models.rows import starts


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


class Anywhere:
    """F_0 … F_{h−1} of an automaton over states with these letters, any of which may follow any other.

    `choices` is the dtype of the choices that plans keep.
    """

    def __init__(self, automaton: Automaton, letter: I32, choices: type[np.unsignedinteger]) -> None:
        self.automaton, self.letter, self.choices = automaton, letter, choices
        self._layers: dict[int, Layer] = {}
        letters = np.unique(letter)
        # by step: the automaton states reached on reading each letter, if it occurs
        after = np.zeros((int(letter.max()) + 1, automaton.n_states), dtype=np.bool_)
        after[letters, automaton.enter(letters)] = True
        self._reached: list[NDArray[np.bool_]] = []
        for t in range(automaton.horizon):
            here = after & (automaton.verdicts(t) == UNDECIDED)
            self._reached.append(here if not self._same(here) else self._reached[-1])
            moves, after = automaton.moves(t), np.zeros_like(after)
            for q in np.flatnonzero(here.any(axis=0)).tolist():
                after[letters, moves[letters, q]] = True

    def layers(self, kind: type[Layers[Any, Any]], game: Game, since: int, budget: Budget) -> Layers[Any, Any]:
        """The layers of steps from `since` on, for a game over `Later`, as Nodes or as Words, on one thread."""
        return _Nodes(self, game, since, budget) if kind is Nodes else _Words(self, game, since, budget)

    def codes(self, t: int) -> I64:
        """F_t as s·|Q| + q."""
        found: I64 = np.flatnonzero(self._reached[t][self.letter])
        return found

    def layer(self, t: int) -> Layer:
        """F_t as words, all of them open."""
        here = self._reached[t]
        if id(here) not in self._layers:
            n_words = -(-here.shape[1] // 64)
            padded = np.zeros((len(here), 64 * n_words), dtype=np.bool_)
            padded[:, : here.shape[1]] = here
            rows = np.packbits(padded, axis=1, bitorder="little").view(np.uint64)[self.letter]
            s, word = np.nonzero(rows)
            states, first = np.unique(s, return_index=True)
            start, bits = np.append(first, len(s)).astype(np.int64), rows[s, word]
            tiles = starts((bits.view(np.uint8) != 0).reshape(-1, 8).sum(axis=1))[start]
            none = np.empty(0, dtype=self.choices)
            self._layers[id(here)] = Layer(
                states.astype(np.int32), start, word.astype(np.int32), bits, np.zeros_like(bits), tiles, none
            )
        return self._layers[id(here)]

    def _same(self, here: NDArray[np.bool_]) -> bool:
        return bool(self._reached) and np.array_equal(here, self._reached[-1])


class _Nodes(Nodes):
    def __init__(self, anywhere: Anywhere, game: Game, since: int, budget: Budget) -> None:
        self._anywhere, self._since = anywhere, since
        super().__init__(game, TRUE, EVERYTHING, live=False, sure=False, budget=budget)

    def _initial(self) -> I64:
        return self._anywhere.codes(self._since)

    def _after(self, layer: I64, t: int) -> I64:
        return self._anywhere.codes(self._since + t + 1)


class _Words(Words):
    def __init__(self, anywhere: Anywhere, game: Game, since: int, budget: Budget) -> None:
        self._anywhere, self._since = anywhere, since
        choices = anywhere.choices
        super().__init__(game, TRUE, EVERYTHING, live=False, sure=False, budget=budget, choices=choices, threads=1)

    def _initial(self) -> Sets:
        return self._anywhere.layer(self._since).open_sets

    def _after(self, layer: Sets, t: int) -> Sets:
        after = self._anywhere.layer(self._since + t + 1).open_sets
        return layer if after.bits is layer.bits else after

    def _settled(self, layer: Sets, ahead: Layer, t: int) -> Layer:
        return self._anywhere.layer(self._since + t)

    def _same_settled(self, one: Layer, other: Layer) -> bool:
        return one is other
