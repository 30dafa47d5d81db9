"""How much of the processor a backward step uses where every row is dense: `make bench`, or `python bench/kernels.py`.

micro    y = max(y, p0·a + p1·b + p2·c + p3·d) on rows in the first-level cache, in the same kind of numbers: what the
         processor can do with such rows at best; the faster of numba's own vectors and of `Lanes`
sweep    the backward step of kernels/tiles.py, the best choice included (in fixed point the rounded division as well);
         nature's choice: that of kernels/nature.py, which sorts every row, counted alike

n × n cells of the open floor (bench/floors.py), nine choices of up to four entries a cell, 512 automaton states, all of
them open, so that all is computed and nothing is decided at once. Rates are 1e9 multiply-adds a second of one thread:
row entries times automaton states for the sweep, four a number for micro. CPU seconds of the fastest of some runs,
taken in turn. The results are compared with numpy's first.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from floors import open_floor
from numba import njit

import stltool as stl
from stltool.checking.fixed import fixed_point
from stltool.checking.induction import Budget, Game
from stltool.checking.induction.words import Graph, prepared
from stltool.kernels import nature, tiles
from stltool.kernels.lanes import add, greater, load, mul, select, splat_at, store
from stltool.models.rows import Rows

WORDS = 8  # of 64 automaton states
SIZES = (10, 30)
ROW = 512  # numbers: five rows are 20 KB


@njit  # not with the package's cache, which does not know this file
def micro_loop(p: Any, a: Any, b: Any, c: Any, d: Any, y: Any, times: int) -> None:
    p0, p1, p2, p3 = p[0], p[1], p[2], p[3]
    for _ in range(times):
        for i in range(len(y)):
            y[i] = max(y[i], p0 * a[i] + p1 * b[i] + p2 * c[i] + p3 * d[i])


@njit
def micro_lanes(p: Any, a: Any, b: Any, c: Any, d: Any, y: Any, times: int) -> None:
    p0, p1, p2, p3 = splat_at(p, 0), splat_at(p, 1), splat_at(p, 2), splat_at(p, 3)
    for _ in range(times):
        for i in range(0, len(y), 8):
            x = add(add(mul(p0, load(a, i)), mul(p1, load(b, i))), add(mul(p2, load(c, i)), mul(p3, load(d, i))))
            old = load(y, i)
            store(y, i, select(greater(x, old), x, old))


class Dense:
    """A backward step in which every automaton state of every cell is open."""

    def __init__(self, graph: Graph, rows: Rows, dtype: type[np.generic]) -> None:
        n = len(graph.states)
        self.graph, self.rows, self.dtype = graph, rows, dtype
        self.entries = len(graph.target)
        self.start, self.tiles = WORDS * np.arange(n + 1), 8 * WORDS * np.arange(n + 1)
        self.word = np.tile(np.arange(WORDS, dtype=np.int32), n)
        self.open = np.full(n * WORDS, 2**64 - 1, dtype=np.uint64)
        self.slot, self.block = np.arange(n, dtype=np.int32), np.arange(n * WORDS, dtype=np.int32)
        draw = np.random.default_rng(0)
        self.W = draw.random(n * WORDS * 64) if dtype is np.float64 else draw.integers(0, 2**40, n * WORDS * 64)
        self.values, self.best = np.empty(len(self.W), dtype), np.empty(len(self.W), np.uint8)

    def layer(self) -> tuple[Any, ...]:
        graph = self.graph
        return (
            np.arange(len(graph.states), dtype=np.int32), self.start, self.word, self.open, np.zeros_like(self.open),
            self.tiles, 0, len(graph.states), self.slot, self.block, self.W, graph.near_start, graph.near,
            graph.choice_start, graph.row_start, graph.position,
        )  # fmt: skip

    def rest(self) -> tuple[Any, ...]:
        nothing = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint64)
        worst, sure, rest = (self.dtype(x) for x in (-1, 1, 0))
        return True, False, *nothing, worst, sure, rest, WORDS, True, self.values, self.best

    def sums(self, p: np.ndarray) -> np.ndarray:
        """(choices, automaton states), by numpy."""
        ahead = self.W.reshape(len(self.graph.states), -1)
        return np.add.reduceat(p[:, None] * ahead[self.graph.target], self.graph.row_start[:-1])

    def compare(self, wanted: np.ndarray) -> None:
        """With the best of the choices' values."""
        best = np.maximum.reduceat(wanted, self.graph.choice_start[:-1])
        found = self.values.reshape(best.shape)
        assert np.array_equal(found, best) if self.dtype is np.int64 else np.allclose(found, best, rtol=0, atol=1e-14)
        taken = np.take_along_axis(wanted, self.graph.choice_start[:-1, None] + self.best.reshape(best.shape), axis=0)
        assert np.array_equal(taken, best) if self.dtype is np.int64 else np.allclose(taken, best, rtol=0, atol=1e-14)


def dense(n: int, uncertain: bool) -> tuple[stl.MDP, Graph, Rows]:
    text = open_floor(n)
    if uncertain:
        text = text.replace('"93/100"', "[0.9, 0.96]").replace('"7/300"', "[0.01, 0.04]")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "floor.toml"
        file.write_text(text, encoding="utf-8")
        model = stl.load_model(file)
    product = stl.build_product(model, stl.parse(f"F[0,{2 * n}] A"))  # long enough to reach every cell
    graph, _ = prepared(Game.of(product), Budget("the bench"))
    assert len(graph.states) == n * n
    return model, graph, graph.rows


def sweep(n: int, kind: str) -> tuple[Callable[[], None], float]:
    """The step, compared once, and its multiply-adds."""
    model, graph, rows = dense(n, kind == "nature's choice")
    if kind == "fixed point":
        scale, step = fixed_point(model), Dense(graph, rows, np.int64)
        assert scale is not None
        p = rows.numerator[graph.entry].astype(np.int64)
        wanted = -(-step.sums(p) // scale.denominator)

        def action() -> None:
            tiles.sweep(*step.layer(), p, scale.denominator, *step.rest())
    elif kind == "doubles":
        step = Dense(graph, rows, np.float64)
        p = rows.probability[graph.entry]
        wanted = step.sums(p)

        def action() -> None:
            tiles.sweep(*step.layer(), p, 1, *step.rest())
    else:
        step = Dense(graph, rows, np.float64)
        assert rows.intervals is not None
        ends = rows.intervals.lower[graph.entry], rows.width[graph.entry]
        budget = rows.budget[graph.choice]
        wanted = natures_values(step, *ends, budget)

        def action() -> None:
            nature.sweep(*step.layer(), *ends, budget, 4, True, *step.rest())

    action()
    step.compare(wanted)
    return action, float(step.entries * WORDS * 64)


def natures_values(step: Dense, lower: np.ndarray, width: np.ndarray, budget: np.ndarray) -> np.ndarray:
    """(choices, automaton states): the least value of each choice, row by row."""
    graph, ahead = step.graph, step.W.reshape(len(step.graph.states), -1)
    wanted = step.sums(lower)
    for c, left in enumerate(budget.tolist()):
        row = slice(*graph.row_start[c : c + 2].tolist())
        values = ahead[graph.target[row]]
        order = np.argsort(values, axis=0)
        before = np.cumsum(width[row][order], axis=0) - width[row][order]
        takes = np.clip(left - before, 0, width[row][order])
        wanted[c] += (takes * np.take_along_axis(values, order, axis=0)).sum(axis=0)
    return wanted


def micro(dtype: type[np.generic]) -> tuple[list[Callable[[], None]], float]:
    """Both ways of writing it, compared once, and the multiply-adds of one."""
    draw = np.random.default_rng(1)
    whole = dtype is np.int64
    p = draw.integers(1, 300, 4) if whole else draw.random(4)
    rows = [draw.integers(0, 2**40, ROW) if whole else draw.random(ROW) for _ in range(4)]
    wanted = np.maximum(0, sum(q * row for q, row in zip(p, rows, strict=True)))
    actions, times = [], 4000
    for function in (micro_loop, micro_lanes):
        y = np.zeros(ROW, dtype)
        function(p, *rows, y, 1)
        assert np.allclose(y, wanted, rtol=1e-15)
        actions.append(lambda function=function, y=y: function(p, *rows, y, times))
    return actions, 4.0 * ROW * times


def fastest(actions: list[Callable[[], None]], runs: int) -> list[float]:
    """CPU seconds of each, taken in turn."""
    times = [[] for _ in actions]
    for _ in range(runs):
        for action, taken in zip(actions, times, strict=True):
            start = time.process_time()
            action()
            taken.append(time.process_time() - start)
    return [min(taken) for taken in times]


def table(quick: bool = False) -> list[str]:
    lines = ["| numbers | cells | micro-kernel, 1e9 a s | sweep, 1e9 a s | share |", "|---|---|---:|---:|---:|"]
    for kind in ("doubles", "fixed point", "nature's choice"):
        for n in SIZES[:1] if quick else SIZES:
            both, work = micro(np.int64 if kind == "fixed point" else np.float64)
            action, swept = sweep(n, kind)
            *theirs, mine = fastest([*both, action], 5 if quick else 40)
            rates = work / min(theirs) / 1e9, swept / mine / 1e9
            lines.append(f"| {kind} | {n} × {n} | {rates[0]:.3g} | {rates[1]:.3g} | {rates[1] / rates[0]:.0%} |")
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smallest size, fewer runs")
    print("\n".join(table(parser.parse_args().quick)))
