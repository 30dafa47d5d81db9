"""Layers as lists of pairs, in numpy: for small products, and the slow twin of words.py. It compiles nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.checking.induction.allowed import Allowed
from stltool.checking.induction.edges import OPEN, REST, SURE, Edges
from stltool.checking.induction.graph import I64, Game
from stltool.checking.induction.layers import Budget, Layers
from stltool.checking.induction.reached import Reached, Stretch
from stltool.choices import Listed, listed
from stltool.models.rows import Demand, Rows

_KEPT = 2_000_000  # edges kept from pass to pass
_PART = 100_000  # pairs whose edges are made at a time if they are not kept


@dataclass(frozen=True, eq=False)
class Settled:
    """Pairs by their code s·|Q| + q, ascending.

    open         (n,) codes           edges  their edges, if kept
    sure         (m,) codes, and the index in its state of the first choice that makes each sure: sure_choice (m,)
    listed, slot all pairs, and the slot of each
    """

    open: I64
    sure: I64
    sure_choice: I64
    edges: Edges | None
    listed: I64
    slot: I64


class Nodes(Layers[I64, Settled]):
    """See layers.py. `count` is the number of pairs reached, `most` its limit (TooMany beyond)."""

    def __init__(
        self,
        game: Game,
        goal: int,
        allowed: Allowed,
        live: bool = True,
        sure: bool = True,
        budget: Budget | None = None,
        most: int | None = None,
    ) -> None:
        super().__init__(game, goal, allowed, live, sure, budget or Budget("pairs that are reached"))
        self.most, self.count = most, 0
        self._kept = 0

    @property
    def asked(self) -> Rows | Demand:
        return self.game.rows

    def acting(self) -> I64:
        found = np.zeros(self.game.n_states, dtype=np.bool_)
        for _, _, layer in self.reached:
            found[self._split(layer)[0]] = True
        return np.flatnonzero(found)

    def backwards(self, before: int | None = None, ahead: Settled | None = None) -> Iterator[Stretch]:
        self._kept = 0
        return super().backwards(before, ahead)

    def nothing(self) -> Settled:
        none = np.empty(0, dtype=np.int64)
        return Settled(none, none, none, None, none, none)

    def n_open(self, layer: Settled) -> int:
        return len(layer.open)

    def n_bytes(self, layer: Settled) -> int:
        arrays = (layer.open, layer.sure, layer.sure_choice, layer.listed, layer.slot)
        return sum(array.nbytes for array in arrays) + (layer.edges.nbytes if layer.edges is not None else 0)

    def pairs(self, layer: Settled) -> tuple[I64, I64]:
        return self._split(layer.open)

    def pairs_reached(self, layer: I64) -> tuple[I64, I64]:
        return self._split(layer)

    def parts(self, layer: Settled) -> list[tuple[int, int]]:
        n = len(layer.open)
        if layer.edges is not None or self.allowed.mixed:  # mixtures use one denominator per step
            return [(0, n)]
        return [(lo, min(lo + _PART, n)) for lo in range(0, n, _PART)]

    def listed(self, first: int, last: int, layer: Settled, choice: NDArray[Any]) -> Listed:
        codes = np.concatenate([layer.open, layer.sure])
        order = np.argsort(codes)
        chosen = np.concatenate([choice, layer.sure_choice.astype(choice.dtype)])[order]
        return listed(first, last, -(-self.game.automaton.n_states // 64), *self._split(codes[order]), chosen)

    def sure_pairs(self, layer: Settled) -> tuple[I64, I64, I64]:
        """(s, q, choice) of the sure pairs, in order."""
        return *self._split(layer.sure), layer.sure_choice

    def slots(self, layer: Settled, t: int, s: I64, q: I64) -> I64:
        verdicts = self.game.automaton.verdicts(t)[q]
        slots = np.where(verdicts == self.goal, SURE, REST)
        if len(layer.listed):
            codes = s * self.game.automaton.n_states + q
            place = np.minimum(np.searchsorted(layer.listed, codes), len(layer.listed) - 1)
            there = (layer.listed[place] == codes) & (verdicts == UNDECIDED)
            slots[there] = layer.slot[place[there]]
        return slots

    def edges(self, here: Settled, ahead: Settled, t: int, lo: int, hi: int) -> Edges:
        if here.edges is not None and lo == 0 and hi == len(here.open):
            return here.edges
        return self._edges(here.open[lo:hi], ahead, t)

    def _edges(self, codes: I64, ahead: Settled, t: int) -> Edges:
        fan = self.fan(t, *self._split(codes))
        return fan.edges(self.slots(ahead, t + 1, fan.s_ahead, fan.q_ahead))

    def _initial(self) -> I64:
        game = self.game
        undecided = game.automaton.verdicts(0)[game.entry] == UNDECIDED
        codes: I64 = (game.first * game.automaton.n_states + game.entry)[undecided]
        return codes

    def _after(self, layer: I64, t: int) -> I64:
        self.budget.need(40 * len(layer) * self.game.widest, t, self.game.horizon)
        fan, n_states = self.fan(t, *self._split(layer)), self.game.automaton.n_states
        child = np.unique(fan.s_ahead * n_states + fan.q_ahead)
        undecided = self.game.automaton.verdicts(t + 1)[child % n_states] == UNDECIDED
        after: I64 = child[undecided]
        return after

    def _settled(self, layer: I64, ahead: Settled, t: int) -> Settled:
        edges = self._edges(layer, ahead, t)
        choices, choice, start, slot = edges.choices, edges.choice, edges.start, edges.child
        live, sure = np.ones(len(layer), dtype=np.bool_), np.zeros(len(layer), dtype=np.bool_)
        makes_sure = np.logical_and.reduceat(slot == SURE, start[:-1])
        if self.live:
            possible = np.logical_or.reduceat(slot != REST, start[:-1])
            live = np.logical_or.reduceat(possible, choices[:-1])
        if self.sure:
            some_or_all = np.logical_and if self.allowed.mixed else np.logical_or
            sure = some_or_all.reduceat(makes_sure, choices[:-1])
        between = live & ~sure
        first = np.flatnonzero(makes_sure)
        owner = np.searchsorted(choices, first, side="right") - 1
        _, which = np.unique(owner, return_index=True)
        number = np.zeros(len(layer), dtype=np.int64)
        number[owner[which]] = self.within(edges.s[owner[which]], choice[first[which]])
        kept = None
        if self._kept + len(slot) <= _KEPT:
            self._kept += len(slot)
            kept = _only(edges, between)
        listed, codes = layer[live], layer[between]
        position = np.full(len(layer), SURE, dtype=np.int64)
        position[between] = OPEN + np.arange(len(codes))
        return Settled(codes, layer[sure], number[sure], kept, listed, position[live])

    def _split(self, codes: I64) -> tuple[I64, I64]:
        s, q = np.divmod(codes, self.game.automaton.n_states)
        return s, q

    def _add(self, found: Reached, first: int, last: int, layer: I64) -> None:
        super()._add(found, first, last, layer)
        self.count += len(layer)
        if self.most is not None and self.count > self.most:
            raise TooMany
        self.asked.at(self._split(layer)[0])  # also the last layer's rows

    def _count(self, layer: I64) -> int:
        return len(layer)

    def _bytes(self, layer: I64) -> int:
        return 8 * len(layer)

    def _work(self, layer: I64) -> int:
        return len(layer) * self.game.widest

    def _empty(self, layer: I64) -> bool:
        return not len(layer)

    def _same_reached(self, one: I64, other: I64) -> bool:
        return np.array_equal(one, other)

    def _same_settled(self, one: Settled, other: Settled) -> bool:
        return np.array_equal(one.open, other.open) and np.array_equal(one.sure, other.sure)


class TooMany(Exception):
    """More pairs are reached than allowed: the caller may use another engine."""


def _only(edges: Edges, pairs: NDArray[np.bool_]) -> Edges:
    """The edges of some of the pairs."""
    if pairs.all():
        return edges
    of_choice = np.repeat(pairs, np.diff(edges.choices))
    of_edge = np.repeat(of_choice, np.diff(edges.start))

    def starts(start: I64, kept: NDArray[np.bool_]) -> I64:
        return np.concatenate([[0], np.cumsum(np.diff(start)[kept])])

    weight = None if edges.weight is None else edges.weight[of_choice]
    return Edges(
        edges.s[pairs], edges.q[pairs], starts(edges.choices, pairs), edges.choice[of_choice], weight,
        starts(edges.start, of_choice), edges.entry[of_edge], edges.child[of_edge],
    )  # fmt: skip
