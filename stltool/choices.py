"""How a policy stores its choices at (t, s, q): several forms with one interface.

    Table    a dense table: choices (S, Q), or (h, S, Q) by step, negative where there is none; weights (…, C) of a
             mixture
    Choices  choices by step, kept only where they matter: the result of `check`
    Mixtures weights by step of the listed pairs, another form's choices elsewhere
    ByLayer  another form's, for automaton states that are numbered layer by layer and so determine the step
    Through  another form with its own automaton: memory (Q,) maps each automaton state to one of its own
    FromStates another form of another model: state (S,) maps each model state to one of its own
    Rules    of listed situations, and none elsewhere: a policy that was written as text (stltool/written.py)
    Asked    a function of the situation (stltool/asked.py)
    Elsewhere another model's (stltool/transfer.py)

Choices are indices within their state: i is its i-th available action.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from stltool.arrays import read_only
from stltool.display import Card, Displayed
from stltool.sizes import IntegerType

I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.signedinteger[Any]]
Words: TypeAlias = tuple[I64, NDArray[np.uint64], I64, NDArray[np.unsignedinteger]]


@runtime_checkable
class Form(Protocol):
    """What a policy does; t is a step, s and q are arrays of model and automaton states."""

    @property
    def deterministic(self) -> bool: ...

    @property
    def stationary(self) -> bool: ...

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        """(n,) int64 choices, negative where there is none; for a mixture (n, C) float64 weights."""

    def row(self, t: int) -> NDArray[Any]:
        """(S, Q) choices, or (S, Q, C) weights, of one step."""

    def alike(self, t: int) -> tuple[int, int]:
        """The first and the last of the steps around t at which the choices are known to be the same."""

    def mixtures(self) -> F64:
        """(k, C) the distinct weights, each mixture's in ascending order; only for mixtures."""


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

    def mixtures(self) -> F64:
        return distinct(np.sort(self.table.reshape(-1, self.table.shape[-1]), axis=1))[0]


@dataclass(frozen=True, eq=False, repr=False)
class _Seen(Displayed):
    """Another form's choices, elsewhere."""

    form: Form

    def _card(self) -> Card:
        return Card(f"{type(self).__name__}: {self.form!r}"[:100])

    @property
    def deterministic(self) -> bool:
        return self.form.deterministic

    @property
    def stationary(self) -> bool:
        return self.form.stationary

    def alike(self, t: int) -> tuple[int, int]:
        return self.form.alike(t)

    def mixtures(self) -> F64:
        return self.form.mixtures()


@dataclass(frozen=True, eq=False, repr=False)
class Through(_Seen):
    """Another form's choices, by its own automaton state for each automaton state (see the module's text)."""

    memory: I64

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        return self.form.at(t, s, self.memory[q])

    def row(self, t: int) -> NDArray[Any]:
        return np.take(self.form.row(t), self.memory, axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class FromStates(_Seen):
    """Another form's choices, by its own model state for each model state (see the module's text)."""

    state: I64

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        return self.form.at(t, self.state[s], q)

    def row(self, t: int) -> NDArray[Any]:
        return np.take(self.form.row(t), self.state, axis=0)


class Mixed(NamedTuple):
    """Steps first … last of a mixture: pairs' codes s·Q + q (n,) ascending, rows (k, C) of weights, and the row of each
    pair: which (n,)."""

    first: int
    last: int
    codes: I64
    rows: F64
    which: I64


class Mixtures(Displayed):
    """Weights by step of the listed pairs; in all other reachable pairs, the choices of `otherwise`.

    shape   (S, Q)
    layers  in ascending order of their steps, which do not overlap
    """

    deterministic = False
    stationary = False

    def __init__(self, shape: tuple[int, int], layers: Sequence[Mixed], otherwise: Form, n_choices: int) -> None:
        self.shape, self.layers, self.otherwise, self.n_choices = shape, tuple(layers), otherwise, n_choices
        self._first = np.array([layer.first for layer in layers], dtype=np.int64)

    def _card(self) -> Card:
        n = sum(len(layer.codes) for layer in self.layers)
        return Card(f"Mixtures: {n} in {len(self.layers)} layers")

    def at(self, t: int, s: Indices, q: Indices) -> F64:
        found: F64 = self.otherwise.at(t, s, q)
        if self.otherwise.deterministic:
            weights = np.zeros((len(s), self.n_choices))
            np.put_along_axis(weights, found[:, None].astype(np.int64), 1.0, axis=1)
            found = weights
        layer = self._layer(t)
        if layer is not None and len(layer.codes):
            wanted = np.asarray(s, dtype=np.int64) * self.shape[1] + q
            place = np.minimum(np.searchsorted(layer.codes, wanted), len(layer.codes) - 1)
            there = layer.codes[place] == wanted
            found[there] = layer.rows[layer.which[place[there]]]
        return found

    def row(self, t: int) -> F64:
        s, q = np.divmod(np.arange(self.shape[0] * self.shape[1]), self.shape[1])
        return self.at(t, s, q).reshape(*self.shape, self.n_choices)

    def alike(self, t: int) -> tuple[int, int]:
        layer = self._layer(t)
        first, last = (t, t) if layer is None else (layer.first, layer.last)
        other = self.otherwise.alike(t)
        return max(first, other[0]), min(last, other[1])

    def mixtures(self) -> F64:
        others = np.eye(1, self.n_choices) if self.otherwise.deterministic else self.otherwise.mixtures()
        return distinct(np.sort(np.concatenate([others, *(layer.rows for layer in self.layers)]), axis=1))[0]

    def _layer(self, t: int) -> Mixed | None:
        i = int(np.searchsorted(self._first, t, side="right")) - 1
        return self.layers[i] if i >= 0 and t <= self.layers[i].last else None


@dataclass(frozen=True, eq=False, repr=False)
class ByLayer(Displayed):
    """The choices of `form` at step t in automaton state q, for the joint automaton's state offsets[t] + q.

    Before the first offset and from the last layer on, where no action is taken, it is the first choice.
    """

    form: Form
    offsets: I64
    shape: tuple[int, int]

    stationary = True

    def _card(self) -> Card:
        return Card(f"ByLayer: {self.form!r}"[:100])

    @property
    def deterministic(self) -> bool:
        return self.form.deterministic

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        step = np.searchsorted(self.offsets, q, side="right") - 1
        none = self.form.at(0, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
        found = np.zeros((len(s), *none.shape[1:]), dtype=none.dtype)
        if not self.deterministic:
            found[:, 0] = 1.0
        for u in np.unique(step[(step >= 0) & (step < len(self.offsets) - 2)]).tolist():
            there = np.flatnonzero(step == u)
            found[there] = self.form.at(u, np.asarray(s)[there], np.asarray(q)[there] - self.offsets[u])
        return found

    def row(self, t: int) -> NDArray[Any]:
        s, q = np.divmod(np.arange(self.shape[0] * self.shape[1]), self.shape[1])
        found = self.at(t, s, q)
        return found.reshape(*self.shape, *found.shape[1:])

    def alike(self, t: int) -> tuple[int, int]:
        return 0, _ALWAYS

    def mixtures(self) -> F64:
        return self.form.mixtures()


def mixed(before: Mixed | None, t: int, codes: I64, weights: F64) -> Mixed:
    """The layer of step t, from pairs' weights (n, C); that of step t + 1, extended to t, if they are the same."""
    rows, which = distinct(weights)
    if (
        before is not None
        and np.array_equal(before.codes, codes)
        and np.array_equal(before.rows, rows)
        and np.array_equal(before.which, which)
    ):
        return before._replace(first=t)
    return Mixed(t, t, codes, rows, which)


def distinct(rows: F64) -> tuple[F64, I64]:
    """(the distinct rows of a matrix, the index of each row among them); fast if few are distinct."""
    # rows are compared by a hash, and in full only if hashes collide, which is much slower
    bits = np.ascontiguousarray(rows).view(np.uint64)
    number = bits @ (2 * np.arange(1, rows.shape[1] + 1, dtype=np.uint64) ** 9 + 1)
    _, first, which = np.unique(number, return_index=True, return_inverse=True)
    found, which = rows[first], which.ravel()
    if not np.array_equal(found[which], rows):
        found, which = np.unique(rows, axis=0, return_inverse=True)
    return found, which.ravel()


_ALWAYS = 2**62


class Rules(Displayed):
    """Choices or weights of listed situations; elsewhere no action, or no weight.

    shape        (S, Q);  horizon  the number of steps
    code         (n,) s·Q + q of each rule's pair;  first, last  (n,) its steps: of a pair, no two rules overlap
    values       (n,) int64 choices, or (n, C) float64 weights
    stationary   whether rules hold at every step; first and last are then 0
    """

    def __init__(
        self,
        shape: tuple[int, int],
        horizon: int,
        code: I64,
        first: I64,
        last: I64,
        values: NDArray[Any],
        stationary: bool = False,
        kind: IntegerType = np.int16,
    ) -> None:
        order = np.lexsort((first, code))
        self.shape, self.horizon, self.stationary, self.kind = shape, horizon, stationary, kind
        self.code, self.first, self.last, self.values = code[order], first[order], last[order], values[order]
        self.deterministic = values.ndim == 1
        self._span = horizon + 1
        self._keys = self.code * self._span + self.first
        self._changes = np.unique(np.concatenate([[0], self.first, self.last + 1]))

    def _card(self) -> Card:
        return Card(f"Rules: {len(self.code)} {'choices' if self.deterministic else 'mixtures'}")

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        t = 0 if self.stationary else t
        code = np.asarray(s, dtype=np.int64) * self.shape[1] + q
        found: NDArray[Any] = np.full(len(code), -1) if self.deterministic else np.zeros((len(code), self._width))
        if len(self.code):
            place = np.maximum(np.searchsorted(self._keys, code * self._span + t, side="right") - 1, 0)
            there = (self.code[place] == code) & (self.first[place] <= t) & (t <= self.last[place])
            found[there] = self.values[place[there]]
        return found

    def row(self, t: int) -> NDArray[Any]:
        t = 0 if self.stationary else t
        now = (self.first <= t) & (t <= self.last)
        n = self.shape[0] * self.shape[1]
        table: NDArray[Any] = np.full(n, -1, self.kind) if self.deterministic else np.zeros((n, self._width))
        table[self.code[now]] = self.values[now]
        return table.reshape(*self.shape, *table.shape[1:])

    def alike(self, t: int) -> tuple[int, int]:
        if self.stationary:
            return 0, _ALWAYS
        i = int(np.searchsorted(self._changes, t, side="right"))
        return int(self._changes[i - 1]), int(self._changes[i]) - 1 if i < len(self._changes) else _ALWAYS

    def mixtures(self) -> F64:
        return distinct(np.sort(self.values, axis=1))[0]

    @property
    def _width(self) -> int:
        return int(self.values.shape[1])


class Listed(NamedTuple):
    """A layer of steps first … last: keys (n,) int64 ascending, bits (n,) uint64, choice (set bits,) unsigned."""

    first: int
    last: int
    keys: I64
    bits: NDArray[np.uint64]
    choice: NDArray[np.unsignedinteger]


class Choices(Displayed):
    """Choices by step, where they matter: consecutive layers, each for a stretch of steps.

    A layer lists words of 64 automaton states by their key s·n_words + word, ascending; the set bits of a word are the
    automaton states that have their own choice, and choices are in order of (key, bit). In all other reachable pairs
    every choice is equally good: the first one, 0, is taken. Arrays may be views of a file.

    shape   (S, Q)          horizon the number of steps
    layers  in ascending order of their steps, which do not overlap
    kind    the dtype of a table of such choices
    """

    deterministic = True
    stationary = False

    def __init__(
        self, shape: tuple[int, int], horizon: int, layers: Sequence[Listed], kind: IntegerType = np.int16
    ) -> None:
        self.shape, self.horizon, self.layers, self.kind = shape, horizon, tuple(layers), kind
        self._first, self._last = [layer.first for layer in layers], [layer.last for layer in layers]
        self._words: tuple[int, Words] = (-1, _NONE)

    def _card(self) -> Card:
        n = sum(len(layer.choice) for layer in self.layers)
        return Card(f"Choices: {n} that matter, in {len(self.layers)} layers of {self.horizon} steps")

    @property
    def n_words(self) -> int:
        return -(-self.shape[1] // 64)

    @property
    def nbytes(self) -> int:
        return sum(layer.keys.nbytes + layer.bits.nbytes + layer.choice.nbytes for layer in self.layers)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored in files: first, last (k,) of each layer, start (k+1,) of its words, and keys, bits, choice of
        all."""
        kind = self.layers[0].choice.dtype if self.layers else np.dtype(np.uint8)
        start = np.cumsum([0, *(len(layer.keys) for layer in self.layers)], dtype=np.int64)
        keys = [np.empty(0, dtype=np.int64), *(layer.keys for layer in self.layers)]
        bits = [np.empty(0, dtype=np.uint64), *(layer.bits for layer in self.layers)]
        choice = [np.empty(0, dtype=kind), *(layer.choice for layer in self.layers)]
        joined = {"keys": np.concatenate(keys), "bits": np.concatenate(bits), "choice": np.concatenate(choice)}
        first, last = (np.array(steps, dtype=np.int64) for steps in (self._first, self._last))
        return {"first": first, "last": last, "start": start, **joined}

    @classmethod
    def of_arrays(
        cls, shape: tuple[int, int], horizon: int, arrays: Mapping[str, NDArray[Any]], kind: IntegerType
    ) -> Choices:
        """The inverse of `arrays`."""
        first, last, start = (arrays[name].tolist() for name in ("first", "last", "start"))
        counts = np.cumsum(np.bitwise_count(arrays["bits"]), dtype=np.int64)
        ends = [int(counts[n - 1]) if n else 0 for n in start]
        layers = [
            Listed(first[i], last[i], arrays["keys"][a:b], arrays["bits"][a:b], arrays["choice"][ends[i] : ends[i + 1]])
            for i, (a, b) in enumerate(itertools.pairwise(start))
        ]
        return cls(shape, horizon, layers, kind)

    def fits(self, n_choices: Indices) -> bool:
        """Whether layers, which may come from a file, are valid for states with these numbers of choices."""
        before = -1
        for layer in self.layers:
            if not before < layer.first <= layer.last < self.horizon:
                return False
            if not _fits(layer, n_choices, self.shape[1], self.n_words):
                return False
            before = layer.last
        return True

    def words(self, t: int) -> Words:
        """keys, bits, the number of choices before each word, and choices of step t; empty if none is listed."""
        i = bisect_right(self._first, t) - 1
        if i < 0 or t > self._last[i]:
            return _NONE
        number, words = self._words
        if number != i:
            layer = self.layers[i]
            counts = np.bitwise_count(layer.bits)
            rank = np.cumsum(counts, dtype=np.int64) - counts
            words = read_only(layer.keys), read_only(layer.bits), rank, read_only(layer.choice)
            self._words = i, words
        return words

    def alike(self, t: int) -> tuple[int, int]:
        i = bisect_right(self._first, t) - 1
        if i >= 0 and t <= self._last[i]:
            return self._first[i], self._last[i]
        before = self._last[i] + 1 if i >= 0 else 0
        after = self._first[i + 1] - 1 if i + 1 < len(self._first) else self.horizon - 1
        return before, after

    def one(self, t: int, s: int, q: int) -> int:
        """The choice of one pair; −1 if it is not listed."""
        keys, bits, rank, choice = self.words(t)
        wanted, bit = s * self.n_words + q // 64, 1 << q % 64
        i = int(keys.searchsorted(wanted))
        if i == len(keys) or keys[i] != wanted:
            return -1
        word = int(bits[i])
        return int(choice[rank[i] + (word & (bit - 1)).bit_count()]) if word & bit else -1

    def at(self, t: int, s: Indices, q: Indices) -> I64:
        place, there, bit = self._places(t, s, q)
        _, bits, rank, choice = self.words(t)
        found = np.zeros(len(s), dtype=np.int64)
        place, bit = place[there], bit[there]
        found[there] = choice[rank[place] + np.bitwise_count(bits[place] & (bit - np.uint64(1)))]
        return found

    def _places(self, t: int, s: Indices, q: Indices) -> tuple[I64, NDArray[np.bool_], NDArray[np.uint64]]:
        """The word of each pair in the layer of step t, whether it is listed there, and its bit."""
        keys, bits, _, _ = self.words(t)
        bit = np.uint64(1) << (np.asarray(q) % 64).astype(np.uint64)
        if not len(keys):
            return np.zeros(len(s), dtype=np.int64), np.zeros(len(s), dtype=np.bool_), bit
        wanted = np.asarray(s, dtype=np.int64) * self.n_words + np.asarray(q) // 64
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return place, (keys[place] == wanted) & (bits[place] & bit != 0), bit

    def mixtures(self) -> F64:
        raise NotImplementedError  # not a mixture

    def resized(self, shape: tuple[int, int]) -> Choices:
        """The same over more or fewer model or automaton states; listed pairs must still exist."""
        n_words, layers = -(-shape[1] // 64), []
        if n_words == self.n_words:
            return Choices(shape, self.horizon, self.layers, self.kind)
        for layer in self.layers:
            s, word = np.divmod(layer.keys, self.n_words)
            layers.append(layer._replace(keys=s * n_words + word))
        return Choices(shape, self.horizon, layers, self.kind)

    def row(self, t: int) -> NDArray[Any]:
        table = np.zeros((self.shape[0], 64 * self.n_words), dtype=self.kind)
        keys, bits, _, choice = self.words(t)
        if len(keys):
            set_bits = np.unpackbits(bits.view(np.uint8), bitorder="little").astype(np.bool_).reshape(-1, 64)
            block = np.zeros(set_bits.shape, dtype=table.dtype)
            block[set_bits] = choice
            table.reshape(-1, 64)[keys] = block
        return table[:, : self.shape[1]]


def _fits(layer: Listed, n_choices: Indices, n_memories: int, n_words: int) -> bool:
    keys, bits, choice = layer.keys, layer.bits, layer.choice
    if len(keys) != len(bits) or len(choice) != int(np.bitwise_count(bits).sum(dtype=np.int64)):
        return False
    if not len(keys):
        return True
    if (keys[1:] <= keys[:-1]).any() or keys[0] < 0 or keys[-1] >= len(n_choices) * n_words:
        return False
    states, word = np.divmod(keys, n_words)
    room = np.minimum(n_memories - 64 * word, 64).astype(np.uint64)
    beyond = np.where(room < 64, bits >> (room % np.uint64(64)), np.uint64(0))
    return not beyond.any() and bool((choice < np.repeat(n_choices[states], np.bitwise_count(bits))).all())


_NO_KEYS = np.empty(0, dtype=np.int64)
_NONE: Words = (
    read_only(_NO_KEYS), read_only(np.empty(0, dtype=np.uint64)), _NO_KEYS, read_only(np.empty(0, dtype=np.uint8))
)  # fmt: skip


def listed(first: int, last: int, n_words: int, s: I64, q: I64, choice: NDArray[np.unsignedinteger]) -> Listed:
    """A layer from pairs in ascending order of (s, q)."""
    keys = s * n_words + q // 64
    bit = np.uint64(1) << (q % 64).astype(np.uint64)
    begin = np.flatnonzero(np.diff(keys, prepend=-1))
    bits = np.bitwise_or.reduceat(bit, begin) if len(begin) else np.empty(0, dtype=np.uint64)
    return Listed(first, last, keys[begin], bits, choice)
