"""Blocks judged by one kernel (kernels/passes.py), which takes a third of the time of blocks.py with the same results.

Loading the compiler takes as long as judging some hundred million samples does. So a process judges in numpy until it
has loaded the compiler for another reason, or has judged that many.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Constant, Label
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.program import PAST, Program, Same

if TYPE_CHECKING:
    from stltool.monitoring.blocks import Block, BlockEnd
    from stltool.monitoring.samples import End, Traces

Array: TypeAlias = NDArray[Any]

SAMPLES = 1 << 16  # of a block: whole blocks are checked, and comparisons with arithmetic judged, at once
_MANY = 1 << 28
_KEPT = 1 << 20  # bytes
_seen = 0  # samples that this process has judged in numpy


def worthwhile(samples: int) -> bool:
    """Whether so many samples are to be judged compiled."""
    global _seen
    _seen += samples
    return "numba" in sys.modules or _seen > _MANY


def within(samples: Array, limit: float) -> bool:
    """Whether doubles, which lie together, are all between −limit and limit: no NaN, either."""
    if "numba" in sys.modules:
        from stltool.kernels import passes

        return bool(passes.within(samples.reshape(-1), limit))
    return not samples.size or bool(-limit < samples.min() <= samples.max() < limit)


def compiled(program: Program) -> Compiled | None:
    """The tables of a program, None if it is not `compilable`; those of the last few are kept."""
    return _compiled(Same(program))


@lru_cache(maxsize=8)
def _compiled(key: Same[Program]) -> Compiled | None:
    return Compiled(key.thing) if compilable(key.thing) else None


class Compiled:
    """A program as the kernel reads it. None of its instructions looks back."""

    def __init__(self, program: Program) -> None:
        from stltool.kernels import passes as k
        from stltool.monitoring.stream import BEYOND, OPERATORS

        self._kernel = k
        self._program = program
        names = dict.fromkeys((*program.variables, *program.labels))
        self._given: list[Predicate] = []  # comparisons with arithmetic, whose values are columns after those of names
        self._names = {name: i for i, name in enumerate(names)}
        self._bytes = np.array([8 if name in program.variables else 1 for name in names], dtype=np.int64)
        registers, free, owner = 0, list[int](), dict[int, int]()
        rows, numbers = [], []
        for i, now in enumerate(program.instructions):
            if not free:
                free, registers = [registers], registers + 1
            owner[i] = free.pop()
            args = [owner[arg] for arg in now.args] or [0]
            wait = max((program.instructions[arg].horizon or 0 for arg in now.args), default=0)
            atom, pair = self._atom(i)
            bounds = [min(bound, BEYOND) for bound in (now.a, BEYOND if now.b is None else now.b, wait)]
            rows.append([OPERATORS[now.op], owner[i], args[0], args[-1], *bounds, *atom])
            numbers.append(pair)
            free += [owner[ended] for ended in now.ends]
        self._rows = np.array(rows, dtype=np.int64)
        self._numbers = np.array(numbers, dtype=np.float64).ravel()
        self._registers = registers
        self._spare: list[Array] = []  # what was computed in

    def judged(self, block: Block, truth: bool, margins: bool) -> list[tuple[Array | None, Array | None]] | None:
        """Truth and margins, as asked for, of the comparisons with arithmetic; None if one of them does not exist."""
        found = []
        for predicate in self._given:
            shape = block.columns[next(iter(predicate.names))].shape
            values = np.empty(shape, np.bool_) if truth else None, np.empty(shape) if margins else None
            with np.errstate(all="ignore"):
                unknown, far = predicate.judge(block.columns, *values, block.wide)
            if unknown is not None or far:
                return None
            found.append(values)
        return found

    def run(
        self, block: Block, judged: Sequence[Array | None], truth: bool, out: Array, row: int, first: int,
        above: Array | None = None,
    ) -> int:  # fmt: skip
        """Write truth, or margins, of a block's decided steps to `out` (n_traces, n_decided), from a row and step on.

        Also whether margins are above 0 to `above`, which is like `out`; returns then how many are 0. `judged` are the
        same of the comparisons with arithmetic.
        """
        kept = [np.ascontiguousarray(block.columns[name]) for name in self._names]  # alive while the kernel reads them
        kept += [values for values in judged if values is not None]
        at = row * out.shape[1] + first
        return self._run(_addresses(kept), block.rows, block.steps, block.end, truth, out, at, above, 0.0)

    def whole(self, traces: Traces, end: End, outs: Sequence[Array], truth: bool, margins: bool, limit: float) -> bool:
        """Write truth and margins, as asked for, of all decided steps to `outs`, samples being checked on the way.

        False if the arrays cannot be read as they lie, or some sample is not between −limit and limit: then all is to
        be written again.
        """
        arrays = [traces.arrays[name] for name in self._names]
        if traces.n_steps == 0 or self._given or not all(map(self._lies, self._names, arrays)):
            return False
        return self.at(_addresses(arrays), traces.n_traces, traces.n_steps, end, outs, truth, margins, limit)

    def at(
        self, addresses: Array, rows: int, n: int, end: End, outs: Sequence[Array], truth: bool, margins: bool,
        limit: float,
    ) -> bool:  # fmt: skip
        """`whole`, of arrays at the addresses that `_addresses` finds; samples of variables are doubles, of labels
        Booleans."""
        h = self._program.horizon
        parts: list[tuple[int, BlockEnd]] = [(0, "open")]
        if end != "error" and h != 0:
            # steps near the end apart from others; but short traces at once
            parts = [(0, end)] if h is None or n <= h or n + h <= 2 * self._tile(truth) else [*parts, (n - h, end)]
        for first, how in parts:
            columns, signs = addresses, False  # whether the signs of the margins are the truth
            if first > 0:
                columns = addresses.copy()
                columns[::2] += first * self._bytes
            if margins:
                above = outs[0] if truth else None
                zeros = self._run(columns, rows, n - first, how, False, outs[-1], first, above, limit)
                if zeros < 0:
                    return False
                limit, signs = 0.0, zeros == 0  # the first part reads every sample
            if truth and not signs:
                if self._run(columns, rows, n - first, how, True, outs[0], first, None, limit) < 0:
                    return False
                limit = 0.0
        return True

    def _lies(self, name: str, array: Array) -> bool:
        """Whether the kernel can read a signal's rows where they are."""
        wanted = np.float64 if name in self._program.variables else np.bool_
        return array.dtype == wanted and array.strides[1] == array.itemsize

    def _tile(self, truth: bool) -> int:
        return self._kernel.TILE * (4 if truth else 1)

    def _run(
        self, columns: Array, n_rows: int, steps: int, end: BlockEnd, truth: bool, out: Array, at: int,
        above: Array | None, limit: float,
    ) -> int:  # fmt: skip
        k = self._kernel
        rows, tile = self._rows, self._tile(truth)
        lanes, decided, size = 0, steps, 0
        if end == "open":
            decided = steps - (self._program.horizon or 0)
            if steps > 2 * tile:  # in parts, which reach into the next one
                size = min(max(tile, 4 * (steps - decided)), decided) + steps - decided
            else:
                size = steps * max(1, min(tile // steps, n_rows))
        else:
            rows = rows.copy()
            rows[:, 4:6] = np.minimum(rows[:, 4:6], steps)  # from there on, windows begin after the end
            lanes = k.LANES if steps <= tile and n_rows >= k.LANES else 1
            size = steps * lanes
        values = out.view(np.uint8) if truth else out
        signs = (above if above is not None else np.empty(0, np.bool_)).view(np.uint8)
        least, greatest = (0, 1) if truth else (-np.inf, np.inf)
        with self._scratch((self._registers + k.SPARE) * size, 2 * size, values.dtype) as (scratch, sides):
            zeros: int = k.run(
                rows.ravel(), self._numbers, columns, n_rows, steps, lanes, end == "hold", truth, least, greatest,
                scratch, sides, size, decided, values.reshape(-1), at, out.shape[1], signs.reshape(-1), limit,
            )  # fmt: skip
        return zeros

    @contextmanager
    def _scratch(self, n: int, n_sides: int, dtype: Any) -> Iterator[tuple[Array, Array]]:
        """Arrays to compute in, which begin where a line of the cache does: the last ones, unless a thread has them."""
        try:
            room = self._spare.pop()
        except IndexError:
            room = np.empty(0)
        needed = n * dtype.itemsize + 64
        if room.nbytes < needed + 8 * n_sides:
            room = np.empty(needed // 8 + 9 + n_sides)
            room = room[-room.ctypes.data // 8 % 8 :]
        yield room[: needed // 8].view(dtype)[:n], room[needed // 8 : needed // 8 + n_sides]
        if room.nbytes <= _KEPT:
            self._spare.append(room)

    def _atom(self, i: int) -> tuple[list[int], tuple[float, float]]:
        from stltool.monitoring.stream import COMPARATORS, is_plain, number_of, side_of

        k, atom = self._kernel, self._program.instructions[i].atom
        nothing = [-1, 1, -1, 1]
        match atom:
            case None:
                return [0, 0, *nothing], (0.0, 0.0)
            case Constant(value):
                return [k.FIXED_ATOM, 0, *nothing], (np.inf, 1.0) if value else (-np.inf, 0.0)
            case Label(name):
                return [k.LABEL_ATOM, 0, self._names[name], *nothing[1:]], (0.0, 0.0)
            case Predicate(node=node) if is_plain(atom):
                sides = [side_of(side, [*self._names]) for side in (node.left, node.right)]
                return [k.PLAIN_ATOM, COMPARATORS[node.op], *sides[0], *sides[1]], (
                    number_of(node.left),
                    number_of(node.right),
                )
            case Predicate():
                number = len(self._names) + len(self._given)
                self._given.append(atom)
                return [k.GIVEN_ATOM, 0, number, *nothing[1:]], (0.0, 0.0)


def _addresses(arrays: Sequence[Array]) -> Array:
    """What the kernel reads of arrays (n_traces, n_steps): address, and bytes from row to row, of each. They are to be
    kept alive meanwhile."""
    columns = np.zeros((len(arrays), 2), dtype=np.int64)
    for number, values in enumerate(arrays):
        columns[number] = values.ctypes.data, values.strides[0]
    return columns.ravel()


def compilable(program: Program) -> bool:
    """Whether the kernel knows all its instructions, and every comparison reads a signal."""
    if any(now.op in PAST for now in program.instructions):
        return False
    labels = program.labels.keys() & program.variables.keys()  # read as numbers there
    atoms = [now.atom for now in program.instructions]
    return not labels and all(bool(atom.names) for atom in atoms if isinstance(atom, Predicate))
