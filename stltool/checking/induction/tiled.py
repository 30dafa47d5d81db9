"""Numbers by tiles (kernels/tiles.py): doubles and fixed point on words, for the optimum or a deterministic policy."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.checking.induction.edges import REST, SURE
from stltool.checking.induction.words import Layer, Scratch, Words, lanes_of

Values: TypeAlias = NDArray[Any]
Arguments: TypeAlias = tuple[Any, ...]


class Tiles:
    """The backward steps of one question; `share` of the engine's rows and `denominator` as in kernels/tiles.py.

    ends   the values of unlisted pairs, and of sure pairs
    """

    def __init__(
        self,
        engine: Words,
        share: NDArray[Any],
        denominator: int,
        ends: tuple[float | int, float | int],
        maximize: bool,
    ) -> None:
        self._engine, self._denominator, self._maximize = engine, denominator, maximize
        self.share = share[engine.graph.entry]
        self.dtype = share.dtype.type
        self.ends = (self.dtype(ends[REST]), self.dtype(ends[SURE]))
        worst = np.iinfo(np.int64).max if self.dtype is np.int64 else np.inf  # of sums, before they are divided
        self._worst = self.dtype(-1) if maximize else self.dtype(worst)
        self._decided: dict[int, Values] = {}

    def start(self) -> Values:
        return np.empty(0, dtype=self.dtype)

    def back(self, t: int, here: Layer, ahead: Layer, values: Values, keep: bool) -> tuple[Values, NDArray[Any] | None]:
        """The tiles of step t, and their choices if kept."""
        from stltool.kernels import tiles

        engine, graph, moves = self._engine, self._engine.graph, self._engine.moves
        sets, slot = here.open_sets, engine.crew.turn(ahead)
        masks = engine.allowed.masks(t, graph, sets)
        decided, undecided, maps = self.decided(t + 1), moves.where(t + 1, UNDECIDED), moves.by_tiles(t)
        out = np.empty(8 * here.n_tiles, dtype=self.dtype)
        best = np.empty(8 * here.n_tiles if keep else 0, dtype=engine.choices or np.uint8)
        rest, sure = self.ends

        def unite(scratch: Scratch, lo: int, hi: int) -> int:
            n = scratch.unite(sets, lo, hi)
            scratch.blocks(n, self.dtype)
            return n

        def gather(scratch: Scratch, a: int, b: int) -> None:
            tiles.gather(
                scratch.found[a:b], b - a, scratch.rows[a * moves.width :], scratch.groups[a:b],
                scratch.block[a * moves.n_words :], scratch.W.view(np.int64), slot, ahead.start, ahead.word,
                ahead.open, ahead.sure, ahead.tiles, values.view(np.int64), decided.view(np.int64), undecided,
                graph.letter, *maps, moves.n_words, moves.width, moves.shift,
            )  # fmt: skip

        def part(scratch: Scratch, lo: int, hi: int) -> None:
            layer = (
                here.states, here.start, here.word, here.open, here.sure, here.tiles, lo, hi, scratch.slot,
                scratch.block, scratch.W, graph.near_start, graph.near, graph.choice_start, graph.row_start,
                graph.position,
            )  # fmt: skip
            self._sweep(layer, (
                self._maximize, not engine.allowed.everything, *masks, self._worst, sure, rest, moves.n_words, keep,
                out, best,
            ))  # fmt: skip

        engine.crew.share(sets, unite, gather, part)
        return out, best if keep else None

    def _sweep(self, layer: Arguments, rest: Arguments) -> None:
        """kernels/tiles.py's, or one that takes the same layer and the same rest of arguments."""
        from stltool.kernels import tiles

        arguments = (*layer, self.share, self._denominator, *rest)
        tiles.sweep(*arguments)

    def values(self, layer: Layer, values: Values) -> Values:
        """The layer's values by slots, as an arithmetic holds them."""
        return np.concatenate([np.array(self.ends, dtype=self.dtype), values[lanes_of(layer, layer.open)]])

    def at(self, row: Values) -> Values:
        """A row of `decided` by automaton state, without the padding on its sides."""
        from stltool.kernels import tiles

        return row[tiles.PAD :]

    def decided(self, t: int) -> Values:
        """The value of each automaton state that is not listed after step t, with padding on both sides."""
        from stltool.kernels import tiles

        automaton = self._engine.game.automaton
        first = automaton.alike(t)[0]
        if first not in self._decided:
            row = np.full(2 * tiles.PAD + 64 * self._engine.moves.n_words, self.ends[REST], dtype=self.dtype)
            verdicts = automaton.verdicts(t)
            row[tiles.PAD : tiles.PAD + len(verdicts)][verdicts == self._engine.goal] = self.ends[SURE]
            self._decided[first] = row
        return self._decided[first]


class NaturesTiles(Tiles):
    """The same for interval probabilities, with nature's choice (kernels/nature.py); `minimal`: nature minimises."""

    def __init__(self, engine: Words, ends: tuple[float, float], minimal: bool, maximize: bool) -> None:
        graph, rows = engine.graph, engine.rows
        assert rows.intervals is not None
        super().__init__(engine, rows.intervals.lower, 1, ends, maximize)
        self._minimal, self._width, self._budget = minimal, rows.width[graph.entry], rows.budget[graph.choice]
        self._longest = int(np.diff(graph.row_start).max(initial=1))

    def _sweep(self, layer: Arguments, rest: Arguments) -> None:
        from stltool.kernels import nature

        arguments = (*layer, self.share, self._width, self._budget, self._longest, self._minimal, *rest)
        nature.sweep(*arguments)
