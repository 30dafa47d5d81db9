"""Layers as bits of 64-bit words (kernels/words.py): for large products. Threads share the states."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.arrays import read_only
from stltool.automata import UNDECIDED
from stltool.checking.induction.allowed import Allowed
from stltool.checking.induction.edges import OPEN, REST, SURE, Edges
from stltool.checking.induction.graph import I32, I64, U64, Automaton, Game
from stltool.checking.induction.layers import Budget, Layers
from stltool.choices import Listed
from stltool.models.rows import Demand, ReadOnly, Rows

Pieces: TypeAlias = tuple[I64, U64, NDArray[np.bool_], I64]
Maps: TypeAlias = tuple[I32, NDArray[np.bool_], I32, I32, NDArray[np.uint8]]

T = TypeVar("T")

_MOST_WORDS = 2**17  # in a range of states: 64 MB of next values
_PART = 4_000_000  # edges made at a time
_KEPT = 1_000_000  # largest number of row entries of a graph that is kept for other questions
_PIECES = 4  # of a graph, to see how far its states lead
_WORTH_WORDS = 2**13  # with fewer, starting threads costs more than they save


@dataclass(frozen=True, eq=False)
class Graph(ReadOnly):
    """The part of a model that runs can visit before the horizon, its states renumbered in order.

    states       (n,) int32: their numbers in the model         first  (k,) int32: the first ones
    choice_start, row_start, target  as in an MDP; target −1 where runs are over by then
    rows         the rows that its choices and entries belong to: the model's, or these alone
    choice, entry  int64: their numbers there
    near_start, near, position   neighbours (kernels/words.py)  letter (n,) int32
    """

    states: I32
    first: I32
    choice_start: I64
    row_start: I64
    target: I32
    choice: I64
    entry: I64
    rows: Rows
    near_start: I64
    near: I32
    position: I32
    letter: I32

    @classmethod
    def of(cls, game: Game, need: Callable[[int], None]) -> Graph:
        """`need` is called with the number of bytes about to be allocated."""
        from stltool.kernels import words

        starts, rows = game.first.astype(np.int32), game.rows
        if isinstance(rows, Demand):
            rows = rows.source.within(game.first, game.horizon, need)
            assert rows.states is not None
            states, number = rows.states.astype(np.int32), np.full(game.n_states, -1, dtype=np.int32)
            number[states] = np.arange(len(states), dtype=np.int32)
            structure = (rows.choice_start, rows.row_start, read_only(number[rows.target]))
        else:
            need(8 * len(rows.target) + 60 * len(rows))
            structure = (rows.choice_start, rows.row_start, rows.target)
            states = np.sort(words.reachable_states(*structure, starts, game.horizon))
        if len(states) == len(rows):
            choice, entry = np.arange(len(rows.row_start) - 1), np.arange(len(rows.target))
        else:
            choices, of_rows, target, choice, entry = words.submodel(*structure, states)
            structure = (read_only(choices), read_only(of_rows), read_only(target))
        near = words.neighbours(*structure)
        where = np.searchsorted(states, starts).astype(np.int32)
        return cls(states, where, *structure, choice, entry, rows, *near, game.letter[states])


@dataclass(frozen=True, eq=False)
class Sets:
    """One layer: sets of automaton states by model state (kernels/words.py)."""

    states: I32
    start: I64
    word: I32
    bits: U64

    def copy(self) -> Sets:
        return Sets(self.states.copy(), self.start.copy(), self.word.copy(), self.bits.copy())

    def pairs(self, graph: Graph) -> tuple[I64, I64]:
        """(s, q) of all pairs, in order."""
        where, bit = np.nonzero(np.unpackbits(self.bits.view(np.uint8), bitorder="little").reshape(-1, 64))
        owner = np.repeat(graph.states[self.states], np.diff(self.start))
        return owner[where].astype(np.int64), 64 * self.word[where].astype(np.int64) + bit


@dataclass(frozen=True, eq=False)
class Layer:
    """The open and sure pairs after a step; `tiles` (n+1,) numbers the nonempty tiles of eight automaton states.

    sure_choice   the first choice that makes each sure pair sure, in order (None if choices are not kept)
    """

    states: I32
    start: I64
    word: I32
    open: U64
    sure: U64
    tiles: I64
    sure_choice: NDArray[np.unsignedinteger] | None
    _keys: I64 | None = field(default=None, init=False)

    @property
    def n_tiles(self) -> int:
        return int(self.tiles[-1])

    @cached_property
    def rank(self) -> I64:
        """(words,) the number of open pairs before each word."""
        counts = np.bitwise_count(self.open)
        return np.cumsum(counts, dtype=np.int64) - counts

    def keys(self, n_words: int) -> I64:
        """(words,) ascending: each word's number among the n_words of every state."""
        keys = self._keys
        if keys is None:
            keys = np.repeat(self.states.astype(np.int64), np.diff(self.start)) * n_words + self.word
            object.__setattr__(self, "_keys", keys)
        return keys

    @property
    def open_sets(self) -> Sets:
        return Sets(self.states, self.start, self.word, self.open)


class Moves:
    """An automaton's moves and verdicts as rows of words, all of one width."""

    def __init__(self, automaton: Automaton, alike: Moves | None = None) -> None:
        """`alike`: an automaton with the same moves, whose preparations are reused."""
        self.automaton = automaton
        self.n_words = -(-automaton.n_states // 64)
        self.shift = 3  # groups of eight words, as `Lanes` take them, or of more, so that 64 bits number them all
        while self.n_words + 2 > 64 << self.shift:
            self.shift += 1
        self.width = -(-(self.n_words + 2) >> self.shift) << self.shift
        self._pieces: dict[int, Pieces] = {} if alike is None else alike._pieces
        self._maps: dict[int, Maps] = {} if alike is None else alike._maps
        self._rows: dict[tuple[int, int], U64] = {}

    def pieces(self, t: int) -> Pieces:
        """The verdicts and moves of states after step t (kernels/words.py)."""
        from stltool.kernels import words

        delta = self.automaton.moves(t)
        if id(delta) not in self._pieces:
            self._pieces[id(delta)] = words.pieces(delta, self.n_words)
        return self._pieces[id(delta)]

    def by_tiles(self, t: int) -> Maps:
        """δ after step t (letters · 64·n_words,), and its maps by tiles (kernels/tiles.py)."""
        from stltool.kernels import tiles

        delta = self.automaton.moves(t)
        if id(delta) not in self._maps:
            padded = np.zeros((len(delta), 64 * self.n_words), dtype=np.int32)
            padded[:, : delta.shape[1]] = delta
            self._maps[id(delta)] = (padded.ravel(), *tiles.tile_maps(delta, self.n_words))
        return self._maps[id(delta)]

    def where(self, t: int, verdict: int) -> U64:
        """The row of states that have this verdict after step t."""
        first = self.automaton.alike(t)[0]
        if (first, verdict) not in self._rows:
            found = self.automaton.verdicts(t) == verdict
            bits = np.zeros(64 * self.width, dtype=np.bool_)
            bits[64 : 64 + len(found)] = found
            self._rows[first, verdict] = np.packbits(bits, bitorder="little").view(np.uint64)
        return self._rows[first, verdict]


def prepared(game: Game, budget: Budget) -> tuple[Graph, Moves]:
    """What is prepared once for all questions about a game; a large graph is not kept."""
    found: tuple[Graph, Moves] | None = game.kept.get("words")
    if found is None:
        graph = Graph.of(game, lambda n_bytes: budget.take(n_bytes, 0, game.horizon))
        found = graph, Moves(game.automaton, game.kept.get("moves"))
        if len(graph.target) <= _KEPT:
            game.kept["words"] = found
    return found


class Words(Layers[Sets, Layer]):
    """See layers.py. `choices` is the dtype of the choices that are kept, or None."""

    def __init__(
        self,
        game: Game,
        goal: int,
        allowed: Allowed,
        live: bool = True,
        sure: bool = True,
        budget: Budget | None = None,
        choices: type[np.unsignedinteger] | None = None,
        threads: int | None = None,
    ) -> None:
        from stltool.kernels import words

        super().__init__(game, goal, allowed, live, sure, budget or Budget("pairs that are reached"))
        self.choices = choices
        self.graph, self.moves = prepared(game, self.budget)
        game.kept["moves"] = self.moves
        self.mode = words.PLAIN if allowed.everything else words.MIXED if allowed.mixed else words.RESTRICTED
        self.crew = Crew(self, threads)
        n = len(self.graph.states)
        self._states, self._start = np.empty(n, dtype=np.int32), np.empty(n + 1, dtype=np.int64)
        self._word, self._bits = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint64)

    @property
    def asked(self) -> Rows:
        return self.graph.rows

    def acting(self) -> I64:
        found = np.zeros(len(self.graph.states), dtype=np.bool_)
        for _, _, layer in self.reached:
            found[layer.states] = True
        return self.graph.states[found].astype(np.int64)

    # --------------------------------------------------------------------------------------------- forward

    def _initial(self) -> Sets:
        graph, q = self.graph, self.game.entry
        undecided = self.game.automaton.verdicts(0)[q] == UNDECIDED
        states, q = graph.first[undecided], q[undecided]
        bits = np.uint64(1) << (q % 64).astype(np.uint64)
        return Sets(states, np.arange(len(states) + 1, dtype=np.int64), (q // 64).astype(np.int32), bits)

    def _after(self, layer: Sets, t: int) -> Sets:
        from stltool.kernels import words

        graph, moves, scratch = self.graph, self.moves, self.crew.first
        if self.allowed.everything:
            n = scratch.unite(layer, 0, len(layer.states))
        else:
            n = scratch.unite_allowed(layer, self.allowed.masks(t, graph, layer))
        found = words.ascending(scratch.found, n, scratch.slot)
        if len(self._word) < n * moves.n_words:
            self._word = np.empty(n * moves.n_words, dtype=np.int32)
            self._bits = np.empty(n * moves.n_words, dtype=np.uint64)
        k = words.push(
            found, scratch.slot, scratch.rows, scratch.groups, graph.letter, *moves.pieces(t),
            moves.where(t + 1, UNDECIDED), moves.n_words, moves.width, moves.shift, self._states, self._start,
            self._word, self._bits,
        )  # fmt: skip
        scratch.forget(n)
        m = int(self._start[k])
        after = Sets(self._states[:k], self._start[: k + 1], self._word[:m], self._bits[:m])
        return layer if self._same_reached(layer, after) else after.copy()

    def _count(self, layer: Sets) -> int:
        return int(np.bitwise_count(layer.bits).sum(dtype=np.int64))

    def _bytes(self, layer: Sets) -> int:
        return 12 * (len(layer.states) + len(layer.word))

    def _work(self, layer: Sets) -> int:
        return 64 * len(layer.word) * self.game.widest

    def _empty(self, layer: Sets) -> bool:
        return not len(layer.states)

    def _same_reached(self, one: Sets, other: Sets) -> bool:
        return one is other or (
            np.array_equal(one.states, other.states)
            and np.array_equal(one.start, other.start)
            and np.array_equal(one.word, other.word)
            and np.array_equal(one.bits, other.bits)
        )

    # -------------------------------------------------------------------------------------------- backward

    def nothing(self) -> Layer:
        words, places = np.empty(0, dtype=np.uint64), np.zeros(1, dtype=np.int64)
        chosen = None if self.choices is None else np.empty(0, dtype=self.choices)
        return Layer(np.empty(0, dtype=np.int32), places, np.empty(0, dtype=np.int32), words, words, places, chosen)

    def _settled(self, layer: Sets, ahead: Layer, t: int) -> Layer:
        from stltool.kernels import words

        graph, moves, width, keep = self.graph, self.moves, self.moves.width, self.choices is not None
        masks, goal = self.allowed.masks(t, graph, layer), moves.where(t + 1, self.goal)
        slot, pieces = self.crew.turn(ahead), moves.pieces(t)

        def unite(scratch: Scratch, lo: int, hi: int) -> int:
            return scratch.unite(layer, lo, hi, sets=True)

        def pull(scratch: Scratch, a: int, b: int) -> None:
            of = slice(a * width, b * width)
            words.pull(
                scratch.found[a:b], b - a, scratch.rows[of], scratch.groups[a:b], slot, ahead.start, ahead.word,
                ahead.open, ahead.sure, goal, graph.letter, *pieces, moves.n_words, width, moves.shift,
                scratch.possible[of], scratch.certain[of], scratch.somewhere[a:b],
            )  # fmt: skip

        def part(scratch: Scratch, lo: int, hi: int) -> tuple[NDArray[Any], ...]:
            k = int(layer.start[hi] - layer.start[lo])
            states, word = np.empty(hi - lo, dtype=np.int32), np.empty(k, dtype=np.int32)
            start, tiles = np.empty((2, hi - lo + 1), dtype=np.int64)
            between, sure = np.empty((2, k), dtype=np.uint64)
            chosen = np.empty(64 * k if keep else 0, dtype=self.choices or np.uint8)
            m, n_sure = words.decide(
                layer.states, layer.start, layer.word, layer.bits, lo, hi, scratch.slot, graph.choice_start,
                graph.row_start, graph.position, graph.near_start, graph.near, width, scratch.possible,
                scratch.certain, scratch.somewhere, self.mode, *masks, self.live, self.sure, keep, states, start, word,
                between, sure, tiles, chosen,
            )  # fmt: skip
            k = int(start[m])
            return (
                states[:m], np.diff(start[: m + 1]), word[:k], between[:k], sure[:k], np.diff(tiles[: m + 1]),
                chosen[:n_sure],
            )  # fmt: skip

        parts = self.crew.share(layer, unite, pull, part)
        states, n_words, word, between, sure, n_tiles, chosen = (
            arrays[0].copy() if len(arrays) == 1 else np.concatenate(arrays) for arrays in zip(*parts, strict=True)
        )
        start, tiles = (np.concatenate([[0], np.cumsum(counts)]) for counts in (n_words, n_tiles))
        return Layer(states, start, word, between, sure, tiles, chosen if keep else None)

    def require(self, layer: Layer, values: NDArray[Any]) -> None:
        """ValueError unless a layer read from a file belongs to this game, with its values by tiles."""
        n, n_words = len(self.graph.states), self.moves.n_words
        kinds = (np.int32, np.int64, np.int32, np.uint64, np.uint64, np.int64)
        arrays: list[NDArray[Any]] = [layer.states, layer.start, layer.word, layer.open, layer.sure, layer.tiles]
        fits = all(array.ndim == 1 and array.dtype == kind for array, kind in zip(arrays, kinds, strict=True))
        fits = fits and len(layer.start) == len(layer.tiles) == len(layer.states) + 1
        fits = fits and len(layer.word) == len(layer.open) == len(layer.sure) == layer.start[-1]
        if not fits or layer.start[0] or layer.tiles[0]:
            raise ValueError
        first = np.zeros(len(layer.word), dtype=np.bool_)
        first[layer.start[:-1]] = True
        both = layer.open | layer.sure
        tiles = np.concatenate([[0], np.cumsum((both.view(np.uint8) != 0).reshape(-1, 8).sum(axis=1))])
        fits = bool(
            (np.diff(layer.states, prepend=-1) > 0).all()
            and (layer.states < n).all()
            and (np.diff(layer.start) > 0).all()
            and ((np.diff(layer.word, prepend=-1) > 0) | first).all()
            and (layer.word >= 0).all()
            and (layer.word < n_words).all()
            and not (layer.open & layer.sure).any()
            and np.array_equal(tiles[layer.start], layer.tiles)
            and values.shape == (8 * layer.n_tiles,)
            and values.dtype in (np.float64, np.int64)
            and (values >= 0).all()
            and (values.dtype == np.int64 or (values <= 1 + 1e-9).all())
        )
        sure = layer.sure_choice
        n_sure = int(np.bitwise_count(layer.sure).sum(dtype=np.int64))
        if self.choices is None:
            fits = fits and sure is None
        else:
            fits = fits and sure is not None and sure.dtype == self.choices and sure.shape == (n_sure,)
        if not fits:
            raise ValueError

    def _same_settled(self, one: Layer, other: Layer) -> bool:
        return (
            np.array_equal(one.states, other.states)
            and np.array_equal(one.start, other.start)
            and np.array_equal(one.word, other.word)
            and np.array_equal(one.open, other.open)
            and np.array_equal(one.sure, other.sure)
        )

    # --------------------------------------------------------------------------------------------- numbers

    def n_open(self, layer: Layer) -> int:
        return int(np.bitwise_count(layer.open).sum(dtype=np.int64))

    def n_bytes(self, layer: Layer) -> int:
        arrays = (layer.states, layer.start, layer.word, layer.open, layer.sure, layer.tiles)
        return sum(array.nbytes for array in arrays) + 16 * len(layer.word)  # plus its keys and ranks, once used

    def parts(self, layer: Layer) -> list[tuple[int, int]]:
        graph, n = self.graph, len(layer.states)
        if self.allowed.mixed:  # mixtures use one denominator per step
            return [(0, n)]
        if n and 64 * len(layer.word) * self.game.widest <= _PART:
            return [(0, n)]
        per_word = np.bitwise_count(layer.open).astype(np.int64)
        rows = graph.row_start[graph.choice_start]
        per_state = np.add.reduceat(np.append(per_word, 0), layer.start[:-1]) if n else per_word
        total = np.cumsum(per_state * (rows[layer.states + 1] - rows[layer.states]))
        cuts = np.unique(np.searchsorted(total, np.arange(_PART, total[-1] if n else 0, _PART)))
        return [(lo, hi) for lo, hi in itertools.pairwise([0, *cuts.tolist(), n]) if hi > lo]

    def listed(self, first: int, last: int, layer: Layer, choice: NDArray[Any]) -> Listed:
        """`choice`: of open pairs, or by the layer's tiles."""
        from stltool.kernels import words

        assert layer.sure_choice is not None
        both = layer.open | layer.sure
        chosen = np.empty(int(np.bitwise_count(both).sum(dtype=np.int64)), dtype=self.choices)
        by_tile = len(choice) == 8 * layer.n_tiles
        words.merge_choices(layer.open, layer.sure, by_tile, choice, layer.sure_choice, chosen)
        keys = np.repeat(self.graph.states[layer.states].astype(np.int64), np.diff(layer.start)) * self.moves.n_words
        return Listed(first, last, keys + layer.word, both, chosen)

    def pairs(self, layer: Layer) -> tuple[I64, I64]:
        return layer.open_sets.pairs(self.graph)

    def pairs_reached(self, layer: Sets) -> tuple[I64, I64]:
        return layer.pairs(self.graph)

    def sure_pairs(self, layer: Layer) -> tuple[I64, I64, I64]:
        """(s, q, choice) of the sure pairs, in order; choices are 0 if they are not kept."""
        s, q = Sets(layer.states, layer.start, layer.word, layer.sure).pairs(self.graph)
        choice = np.zeros(len(s)) if layer.sure_choice is None else layer.sure_choice
        return s, q, choice.astype(np.int64)

    def slots(self, layer: Layer, t: int, s: I64, q: I64) -> I64:
        verdicts, n_words = self.game.automaton.verdicts(t)[q], self.moves.n_words
        slots = np.where(verdicts == self.goal, SURE, REST)
        if len(layer.word):
            keys = layer.keys(n_words)
            states = self.graph.states
            number = np.minimum(np.searchsorted(states, s), len(states) - 1)
            wanted = number * n_words + q // 64
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            there = (keys[place] == wanted) & (states[number] == s) & (verdicts == UNDECIDED)
            bit = np.uint64(1) << (q % 64).astype(np.uint64)
            is_open, is_sure = (there & ((sets[place] & bit) != 0) for sets in (layer.open, layer.sure))
            below = np.bitwise_count(layer.open[place] & (bit - np.uint64(1))).astype(np.int64)
            slots = np.where(is_open, OPEN + layer.rank[place] + below, np.where(is_sure, SURE, slots))
        return slots

    def edges(self, here: Layer, ahead: Layer, t: int, lo: int, hi: int) -> Edges:
        """lo and hi are positions among the layer's states."""
        from stltool.kernels import words

        graph, moves = self.graph, self.moves
        masks = self.allowed.masks(t, graph, here.open_sets)
        which = (here.states, here.start, here.word, here.open, lo, hi, graph.choice_start, graph.row_start)
        n, m, e = words.count_edges(*which, self.mode, *masks)
        s, q = np.empty((2, n), dtype=np.int64)
        choices, choice = np.empty(n + 1, dtype=np.int64), np.empty(m, dtype=np.int64)
        start, entry, child = np.empty(m + 1, dtype=np.int64), *np.empty((2, e), dtype=np.int64)
        words.list_edges(
            *which, graph.target, self.mode, *masks, self.crew.turn(ahead), ahead.start, ahead.word, ahead.open,
            ahead.sure, ahead.rank, moves.where(t + 1, UNDECIDED), moves.where(t + 1, self.goal), graph.letter,
            self.game.automaton.moves(t), graph.entry, graph.choice, s, q, choices, choice, start, entry, child,
        )  # fmt: skip
        s, weight = graph.states[s].astype(np.int64), None
        if self.allowed.mixed:
            owner = np.repeat(np.arange(n), np.diff(choices))
            weight = self.allowed.weights(t, s[owner], q[owner], self.within(s[owner], choice))
        return Edges(s, q, choices, choice, weight, start, entry, child)


def lanes_of(layer: Layer, sets: U64) -> NDArray[np.bool_]:
    """(8 · n_tiles,) whether each lane of the layer's tiles is in `sets`, words of the layer."""
    listed = (layer.open | layer.sure).view(np.uint8) != 0
    return np.unpackbits(sets.view(np.uint8)[listed], bitorder="little").astype(np.bool_)


class Scratch:
    """Buffers of one thread, reused since fresh memory is slow."""

    def __init__(self, engine: Words) -> None:
        self._graph, self._moves = engine.graph, engine.moves
        n = len(self._graph.states)
        self.slot, self.found = np.full(n, -1, dtype=np.int32), np.empty(n, dtype=np.int32)
        self.rows = self.possible = self.certain = np.empty(0, dtype=np.uint64)
        self.groups, self.somewhere = np.empty(n, dtype=np.uint64), np.empty(n, dtype=np.bool_)
        self.block = np.empty(0, dtype=np.int32)
        self.W: NDArray[Any] = np.empty(0)

    def unite(self, layer: Sets, lo: int, hi: int, sets: bool = False) -> int:
        """The rows that the layer's states lo … hi−1 lead to, and buffers for what is computed from them."""
        from stltool.kernels import words

        graph, width = self._graph, self._moves.width
        n = self._room(layer.states[lo:hi])
        if sets and len(self.possible) < n * width:
            self.possible, self.certain = np.empty(n * width, dtype=np.uint64), np.empty(n * width, dtype=np.uint64)
        found: int = words.unite(
            layer.states, layer.start, layer.word, layer.bits, lo, hi, graph.near_start, graph.near,
            self.slot, self.found, self.rows, self.groups, width, self._moves.shift,
        )  # fmt: skip
        return found

    def unite_allowed(self, layer: Sets, masks: tuple[I64, U64]) -> int:
        """The rows that the layer's states lead to by the choices allowed."""
        from stltool.kernels import words

        graph = self._graph
        self._room(layer.states)
        found: int = words.unite_allowed(
            layer.states, layer.start, layer.word, layer.bits, *masks, graph.choice_start, graph.row_start,
            graph.target, self.slot, self.found, self.rows, self.groups, self._moves.width, self._moves.shift,
        )  # fmt: skip
        return found

    def blocks(self, n: int, dtype: type[np.generic]) -> None:
        """Number the blocks of W that n rows need, and allocate them."""
        from stltool.kernels import tiles

        moves = self._moves
        if len(self.block) < n * moves.n_words:
            self.block = np.empty(n * moves.n_words, dtype=np.int32)
        needed = 64 * tiles.blocks(n, self.rows, self.groups, moves.n_words, moves.width, moves.shift, self.block)
        if self.W.dtype != dtype or len(self.W) < needed:
            self.W = np.empty(needed + needed // 4, dtype=dtype)

    def forget(self, n: int) -> None:
        from stltool.kernels import words

        words.forget(self.slot, self.found, n)

    def _room(self, states: I32) -> int:
        graph = self._graph
        n = len(self.slot)
        if len(self.rows) < n * self._moves.width:  # until there is room for all
            n = min(int((graph.near_start[states + 1] - graph.near_start[states]).sum()), n)
        if len(self.rows) < n * self._moves.width:
            self.rows = np.empty(n * self._moves.width, dtype=np.uint64)
        return n


class Crew:
    """Threads that share a layer's states, each with its own buffers."""

    def __init__(self, engine: Words, threads: int | None) -> None:
        self._engine, self.threads = engine, threads or os.cpu_count() or 1
        self._slot = np.full(len(engine.graph.states), -1, dtype=np.int32)
        self._ahead = np.empty(0, dtype=np.int32)
        self.first = Scratch(engine)
        self._idle, self._pool = [self.first], None if self.threads == 1 else ThreadPoolExecutor(self.threads)

    def turn(self, ahead: Layer) -> I32:
        """(n,) the position of each state in the layer ahead, −1 if it is not listed."""
        if self._ahead is not ahead.states:
            self._slot[self._ahead] = -1
            self._slot[ahead.states] = np.arange(len(ahead.states), dtype=np.int32)
            self._ahead = ahead.states
        return self._slot

    def share(
        self,
        layer: Sets | Layer,
        unite: Callable[[Scratch, int, int], int],
        prepare: Callable[[Scratch, int, int], None],
        part: Callable[[Scratch, int, int], T],
    ) -> list[T]:
        """part(scratch, lo, hi) over ranges of the layer's states, in order.

        Before it, unite(scratch, lo, hi) makes the rows that a range leads to and returns their number, and
        prepare(scratch, a, b) fills rows a … b−1: for every range its own, or, if ranges lead to mostly the same
        states, for all ranges the same; not for more ranges than threads need, whose rows might take too much memory.
        """
        ranges = self._ranges(layer)

        def alone(scratch: Scratch, lo: int, hi: int) -> T:
            n = unite(scratch, lo, hi)
            prepare(scratch, 0, n)
            found = part(scratch, lo, hi)
            scratch.forget(n)
            return found

        if len(ranges) == 1 or len(ranges) > 2 * self.threads or not self.far:
            return self._each(alone, ranges)
        n, scratch = unite(self.first, 0, len(layer.states)), self.first
        cuts = np.linspace(0, n, 2 * self.threads + 1).astype(int).tolist()
        self._each(lambda _, a, b: prepare(scratch, a, b), [*itertools.pairwise(cuts)])
        found = self._each(lambda _, lo, hi: part(scratch, lo, hi), ranges)
        scratch.forget(n)
        return found

    def _ranges(self, layer: Sets | Layer) -> list[tuple[int, int]]:
        total, n = int(layer.start[-1]), len(layer.states)
        if total < min(_WORTH_WORDS if self.threads > 1 else _MOST_WORDS, _MOST_WORDS):
            return [(0, n)]
        wanted = min(2 * self.threads, total // _WORTH_WORDS) if self.threads > 1 else 1
        cuts = np.searchsorted(layer.start, np.linspace(0, total, max(wanted, -(-total // _MOST_WORDS), 1) + 1))
        ranges = [(lo, hi) for lo, hi in itertools.pairwise([0, *cuts[1:-1].tolist(), n]) if hi > lo]
        return ranges or [(0, n)]

    @cached_property
    def far(self) -> bool:
        """Whether ranges of states lead to mostly the same ones, as in a random graph: not near each other."""
        graph, n = self._engine.graph, len(self._engine.graph.states)
        cuts, led_to = np.linspace(0, n, _PIECES + 1).astype(int).tolist(), 0
        for lo, hi in itertools.pairwise(cuts):
            seen = np.zeros(n, dtype=np.bool_)
            seen[graph.near[graph.near_start[lo] : graph.near_start[hi]]] = True
            led_to += int(seen.sum())
        return led_to > _PIECES / 2 * n

    def _each(self, task: Callable[[Scratch, int, int], T], ranges: list[tuple[int, int]]) -> list[T]:
        """For every range, by the threads; buffers are lent to one at a time."""
        if self._pool is None or len(ranges) == 1:
            return [task(self.first, lo, hi) for lo, hi in ranges]
        while len(self._idle) < self.threads:
            self._idle.append(Scratch(self._engine))

        def lent(lo: int, hi: int) -> T:
            scratch = self._idle.pop()
            try:
                return task(scratch, lo, hi)
            finally:
                self._idle.append(scratch)

        return [future.result() for future in [self._pool.submit(lent, lo, hi) for lo, hi in ranges]]
