"""How a policy holds what it does at (t, s, q): three forms with one access.

    Table    a dense table: choices (S, Q), or (h, S, Q) by step, negative where there is none; weights (…, C) of a
             mixture
    Choices  choices by step, kept only where they matter: what `check` finds
    Through  another form that remembers in its own way: memory (Q,) says as which automaton state of its own

Choices are numbers within their state: i is its i-th available action.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import Card, Displayed
from stltool.sizes import IntegerType, integer_type

I64: TypeAlias = NDArray[np.int64]
Indices: TypeAlias = NDArray[np.signedinteger[Any]]


class Form(Protocol):
    """What a policy does; t is a step, s and q are arrays of model and automaton states."""

    @property
    def deterministic(self) -> bool: ...

    @property
    def stationary(self) -> bool: ...

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        """(n,) int64 choices, negative where there is none; of a mixture (n, C) float64 weights."""

    def row(self, t: int) -> NDArray[Any]:
        """(S, Q) choices, or (S, Q, C) weights, of one step."""

    def alike(self, t: int) -> tuple[int, int]:
        """The first and the last step of those around t that surely do the same."""


@dataclass(frozen=True, eq=False, repr=False)
class Table(Displayed):
    """A dense table (see the module's text)."""

    table: NDArray[Any]

    def _card(self) -> Card:
        return Card(f"Table: {' x '.join(map(str, self.table.shape))}, {self.table.dtype}")

    @property
    def deterministic(self) -> bool:
        return bool(self.table.dtype.kind == "i")

    @property
    def stationary(self) -> bool:
        return self.table.ndim == (2 if self.deterministic else 3)

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        found: NDArray[Any] = self.row(t)[s, q]
        return found.astype(np.int64) if self.deterministic else found

    def row(self, t: int) -> NDArray[Any]:
        row: NDArray[Any] = self.table if self.stationary else self.table[t]
        return row

    def alike(self, t: int) -> tuple[int, int]:
        return (0, _ALWAYS) if self.stationary else (t, t)


@dataclass(frozen=True, eq=False, repr=False)
class Through(Displayed):
    """Another form's choices, by what it remembers in each automaton state (see the module's text)."""

    form: Form
    memory: I64

    def _card(self) -> Card:
        return Card(f"Through: {self.form!r}"[:100])

    @property
    def deterministic(self) -> bool:
        return self.form.deterministic

    @property
    def stationary(self) -> bool:
        return self.form.stationary

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        return self.form.at(t, s, self.memory[q])

    def row(self, t: int) -> NDArray[Any]:
        return np.take(self.form.row(t), self.memory, axis=1)

    def alike(self, t: int) -> tuple[int, int]:
        return self.form.alike(t)


_ALWAYS = 2**62


def own_table(form: Form) -> NDArray[Any]:
    """The dense table that a form is, or sees through: all that it ever does."""
    while isinstance(form, Through):
        form = form.form
    assert isinstance(form, Table)
    return form.table


class Listed(NamedTuple):
    """A layer of steps first … last: keys (n,) int64 ascending, bits (n,) uint64, choice (set bits,) unsigned."""

    first: int
    last: int
    keys: I64
    bits: NDArray[np.uint64]
    choice: NDArray[np.unsignedinteger]


@dataclass(frozen=True, eq=False, repr=False)
class Choices(Displayed):
    """Choices by step, where they matter: layers one after another, each of a stretch of steps.

    A layer lists words of 64 automaton states by their key s·n_words + word, ascending; the set bits of a word are the
    automaton states that have a choice of their own, and choices stand in order of (key, bit). Wherever else a run can
    be, every choice is as good as any other: the first one, 0.

    shape    (S, Q)                               horizon  steps in all
    first, last (k,) int64: the steps of each layer, ascending, without overlap
    start    (k+1,) int64: a layer's words are keys[start[i]] … keys[start[i+1]−1]
    keys, bits  (n,)                              choice   (set bits of all layers,)
    """

    shape: tuple[int, int]
    horizon: int
    first: I64
    last: I64
    start: I64
    keys: I64
    bits: NDArray[np.uint64]
    choice: NDArray[np.unsignedinteger]
    rank: I64 = field(init=False)

    deterministic = True
    stationary = False

    def _card(self) -> Card:
        return Card(f"Choices: {len(self.choice)} that matter, in {len(self.first)} layers of {self.horizon} steps")

    def __post_init__(self) -> None:
        counts = np.bitwise_count(self.bits)
        object.__setattr__(self, "rank", np.cumsum(counts, dtype=np.int64) - counts)

    @classmethod
    def of(cls, shape: tuple[int, int], horizon: int, layers: Sequence[Listed], kind: type[Any]) -> Choices:
        """From layers in ascending order of steps; `kind` is the type of choices."""
        first, last = (np.array([layer[i] for layer in layers], dtype=np.int64) for i in (0, 1))
        start = np.concatenate([[0], np.cumsum([len(layer.keys) for layer in layers])]).astype(np.int64)
        keys = np.concatenate([np.empty(0, dtype=np.int64), *(layer.keys for layer in layers)])
        bits = np.concatenate([np.empty(0, dtype=np.uint64), *(layer.bits for layer in layers)])
        choice = np.concatenate([np.empty(0, dtype=kind), *(layer.choice for layer in layers)])
        return cls(shape, horizon, first, last, start, keys, bits, choice)

    @property
    def kind(self) -> IntegerType:
        """The type of a table of such choices."""
        return integer_type(int(self.choice.max(initial=0)))

    @property
    def n_words(self) -> int:
        return -(-self.shape[1] // 64)

    @property
    def nbytes(self) -> int:
        return sum(array.nbytes for array in (self.first, self.last, self.start, self.keys, self.bits, self.choice))

    def layer(self, t: int) -> slice:
        """Where the words of step t are; empty where none is listed."""
        i = int(np.searchsorted(self.first, t, side="right")) - 1
        if i < 0 or t > self.last[i]:
            return slice(0, 0)
        return slice(int(self.start[i]), int(self.start[i + 1]))

    def alike(self, t: int) -> tuple[int, int]:
        i = int(np.searchsorted(self.first, t, side="right")) - 1
        if i >= 0 and t <= self.last[i]:
            return int(self.first[i]), int(self.last[i])
        before = int(self.last[i]) + 1 if i >= 0 else 0
        after = int(self.first[i + 1]) - 1 if i + 1 < len(self.first) else self.horizon - 1
        return before, after

    def at(self, t: int, s: Indices, q: Indices) -> I64:
        part = self.layer(t)
        keys, bits = self.keys[part], self.bits[part]
        found = np.zeros(len(s), dtype=np.int64)
        if len(keys):
            wanted = np.asarray(s, dtype=np.int64) * self.n_words + np.asarray(q) // 64
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            bit = np.uint64(1) << (np.asarray(q) % 64).astype(np.uint64)
            there = (keys[place] == wanted) & (bits[place] & bit != 0)
            place, bit = place[there], bit[there]
            rank = self.rank[part][place] + np.bitwise_count(bits[place] & (bit - np.uint64(1)))
            found[there] = self.choice[rank]
        return found

    def row(self, t: int) -> NDArray[Any]:
        table = np.zeros((self.shape[0], 64 * self.n_words), dtype=self.kind)
        part = self.layer(t)
        keys, bits = self.keys[part], self.bits[part]
        if len(keys):
            set_bits = np.unpackbits(bits.view(np.uint8), bitorder="little").astype(np.bool_).reshape(-1, 64)
            first = int(self.rank[part][0])
            rows = table.reshape(-1, 64)
            block = np.zeros(set_bits.shape, dtype=table.dtype)
            block[set_bits] = self.choice[first : first + int(np.bitwise_count(bits).sum(dtype=np.int64))]
            rows[keys] = block
        return table[:, : self.shape[1]]


def listed(first: int, last: int, n_words: int, s: I64, q: I64, choice: NDArray[np.unsignedinteger]) -> Listed:
    """A layer from pairs in ascending order of (s, q)."""
    keys = s * n_words + q // 64
    bit = np.uint64(1) << (q % 64).astype(np.uint64)
    begin = np.flatnonzero(np.diff(keys, prepend=-1))
    bits = np.bitwise_or.reduceat(bit, begin) if len(begin) else np.empty(0, dtype=np.uint64)
    return Listed(first, last, keys[begin], bits, choice)
