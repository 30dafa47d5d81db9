"""What an induction runs on: a model's rows, an automaton, the first states, and which choices count."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TaskAutomaton
from stltool.product import Product

I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]


class Rows(Protocol):
    """An MDP's structure, or that of a learned or extended model."""

    @property
    def choice_start(self) -> I64: ...
    @property
    def row_start(self) -> I64: ...
    @property
    def target(self) -> I32: ...


@dataclass(frozen=True, eq=False)
class Game:
    """A model's rows with an automaton that reads them.

    letter  (n_states,) int32: the automaton's letter of each model state
    first   (k,) int64: the states that runs begin in, ascending
    kept    what engines prepare once and use for every question about the game
    """

    rows: Rows
    automaton: TaskAutomaton
    letter: I32
    first: I64
    kept: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, product: Product, everywhere: bool = False) -> Game:
        """A product's; with `everywhere`, runs may begin in every state. The same one as long as the product lives."""
        games = _GAMES.setdefault(product, {})
        if everywhere not in games:
            model = product.model
            first = np.arange(model.n_states) if everywhere else np.flatnonzero(model.initial)
            games[everywhere] = cls(model, product.automaton, product.letter, first)
        return games[everywhere]

    @property
    def horizon(self) -> int:
        return self.automaton.horizon

    @cached_property
    def entry(self) -> I64:
        """(k,) the automaton state after reading each first state."""
        entry: I64 = self.automaton.delta[self.letter[self.first], self.automaton.initial].astype(np.int64)
        return entry

    @cached_property
    def widest(self) -> int:
        """The most row entries that a state has, all choices together."""
        rows = self.rows.row_start[self.rows.choice_start]
        return int(np.diff(rows).max())

    def last_alike(self, t: int) -> int:
        """The last step whose verdicts are those of step t."""
        starts = self.automaton.verdict_starts
        i = int(np.searchsorted(starts, t, side="right"))
        return int(starts[i]) - 1 if i < len(starts) else self.horizon

    def first_alike(self, t: int) -> int:
        """The first step whose verdicts are those of step t."""
        starts = self.automaton.verdict_starts
        return int(starts[np.searchsorted(starts, t, side="right") - 1])


_GAMES: WeakKeyDictionary[Product, dict[bool, Game]] = WeakKeyDictionary()
