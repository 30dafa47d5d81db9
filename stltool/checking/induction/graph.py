"""What an induction runs on: a model's rows, an automaton, the first states, and which choices count."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, UNDECIDED, JointAutomaton, TaskAutomaton
from stltool.models.rows import Demand, Rows
from stltool.product import JointProduct, Product

I8: TypeAlias = NDArray[np.int8]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]


class Automaton(Protocol):
    """An automaton as seen by an induction; its states may be numbered differently after each step.

    horizon    h: after step h every state is decided
    n_states   the most states there are after any step
    """

    @property
    def horizon(self) -> int: ...
    @property
    def n_states(self) -> int: ...

    def enter(self, letters: I32) -> I32:
        """The states after step 0, by the letter read there."""

    def moves(self, t: int) -> I32:
        """(n_letters, n) int32: from each state after step t to that after step t + 1. Equal moves are the same
        array."""

    def verdicts(self, t: int) -> I8:
        """(n,): the verdict of each state after step t."""

    def alike(self, t: int) -> tuple[int, int]:
        """The first and the last of the steps around t with the same moves, verdicts and numbering of states."""

    def keeps_numbers(self, t: int) -> bool:
        """Whether states after step t + 1 are numbered as those after step t."""


class Single:
    """A task's automaton. Only its verdicts depend on the step."""

    def __init__(self, automaton: TaskAutomaton) -> None:
        self._automaton = automaton
        self.horizon, self.n_states = automaton.horizon, automaton.n_states

    def enter(self, letters: I32) -> I32:
        states: I32 = self._automaton.delta[letters, self._automaton.initial]
        return states

    def moves(self, t: int) -> I32:
        return self._automaton.delta

    def verdicts(self, t: int) -> I8:
        return self._automaton.verdicts(t)

    def alike(self, t: int) -> tuple[int, int]:
        return _around(self._automaton.verdict_starts, t, self.horizon)

    def keeps_numbers(self, t: int) -> bool:
        return True


class Joint:
    """The automaton of several tasks, layer by layer: false where every verdict is decided; with `paying`, not before
    h."""

    def __init__(self, automaton: JointAutomaton, paying: bool) -> None:
        self._automaton, self._paying = automaton, paying
        self.horizon = automaton.horizon
        layers = [automaton.start, *automaton.layers]
        self.n_states = max(len(layer.states) for layer in layers)
        new = [not layers[t - 1] is layers[t] is layers[t + 1] for t in range(1, self.horizon + 1)]
        self._starts = np.flatnonzero([True, *new])

    def enter(self, letters: I32) -> I32:
        states: I32 = self._automaton.start.delta[letters, 0]
        return states

    def moves(self, t: int) -> I32:
        return self._automaton.layers[t].delta

    def verdicts(self, t: int) -> I8:
        layer = self._automaton.layers[t]
        decided = layer.decided & (not self._paying or t == self.horizon)
        return np.where(decided, FALSE, UNDECIDED).astype(np.int8)

    def alike(self, t: int) -> tuple[int, int]:
        return _around(self._starts, t, self.horizon)

    def keeps_numbers(self, t: int) -> bool:
        return self._automaton.layers[t] is self._automaton.layers[t + 1]


def _around(starts: I64, t: int, last: int) -> tuple[int, int]:
    """The first and the last step of the range that t is in, given where ranges start."""
    i = int(starts.searchsorted(t, side="right"))
    return int(starts[i - 1]), int(starts[i]) - 1 if i < len(starts) else last


@dataclass(frozen=True, eq=False)
class Game:
    """A model's rows with an automaton that reads them.

    rows    all of them, or those needed: Demand makes them as runs reach them
    letter  (n_states,) int32: the automaton's letter of each model state
    first   (k,) int64: the states that runs start in, ascending
    kept    what engines prepare once and reuse for every question about the game
    """

    rows: Rows | Demand
    automaton: Automaton
    letter: I32
    first: I64
    kept: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, product: Product, everywhere: bool = False) -> Game:
        """The game of a product; with `everywhere`, runs may start in every state. The same object as long as the
        product lives."""
        games = _GAMES.setdefault(product, {})
        if everywhere not in games:
            model = product.model
            first = np.arange(model.n_states) if everywhere else np.flatnonzero(model.initial)
            games[everywhere] = cls(model.some_rows(), Single(product.automaton), product.letter, first)
        return games[everywhere]

    @classmethod
    def of_joint(cls, joint: JointProduct, paying: bool) -> Game:
        """The game of a joint product, its states numbered by layer; with `paying`, every run continues to the
        horizon."""
        model = joint.model
        return cls(model.some_rows(), Joint(joint.automaton, paying), joint.letter, np.flatnonzero(model.initial))

    @property
    def horizon(self) -> int:
        return self.automaton.horizon

    @property
    def n_states(self) -> int:
        """Model states."""
        return len(self.letter)

    @cached_property
    def entry(self) -> I64:
        """(k,) the automaton state after reading each first state."""
        entry: I64 = self.automaton.enter(self.letter[self.first]).astype(np.int64)
        return entry

    @property
    def widest(self) -> int:
        """The largest number of row entries of a state, all choices together."""
        return self.rows.widest


_GAMES: WeakKeyDictionary[Product, dict[bool, Game]] = WeakKeyDictionary()
