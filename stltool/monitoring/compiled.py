"""Blocks judged by one kernel (kernels/passes.py), which takes a third of the time of blocks.py with the same results.

Loading the compiler takes as long as judging some hundred million samples does. So a process judges in numpy until it
has loaded the compiler for another reason, or has judged that many.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Constant, Label
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.program import PAST, Program, Same

if TYPE_CHECKING:
    from stltool.monitoring.blocks import Block

Array: TypeAlias = NDArray[Any]

SAMPLES = 1 << 16  # of a block: whole blocks are checked, and comparisons with arithmetic judged, at once
_MANY = 1 << 28
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


def compiled(program: Program) -> Compiled:
    """The tables of a program; those of the last few are kept."""
    return _compiled(Same(program))


@lru_cache(maxsize=8)
def _compiled(key: Same[Program]) -> Compiled:
    return Compiled(key.thing)


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
        self._windows = np.isin(self._rows[:, 0], k.WINDOWS)
        self._registers = registers
        self._columns = len(self._names) + len(self._given)

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
        k, steps = self._kernel, block.steps
        open_ = block.end == "open"
        rows = self._rows
        if open_:
            padding, decided = -1, steps - (self._program.horizon or 0)
        else:
            rows, decided = rows.copy(), steps
            rows[:, 4:6] = np.minimum(rows[:, 4:6], steps)  # from there on, windows are in the padding
            padding = int(np.where(self._windows & (rows[:, 5] == steps), rows[:, 4], rows[:, 5]).max())
        columns = np.zeros((self._columns, 2), dtype=np.int64)
        kept = [np.ascontiguousarray(block.columns[name]) for name in self._names]  # alive while the kernel reads them
        kept += [values for values in judged if values is not None]
        for number, values in enumerate(kept):
            columns[number] = values.__array_interface__["data"][0], values.strides[0] if values.ndim == 2 else 0
        tile, stride = 4 * k.TILE if truth else k.TILE, steps + max(padding, 0)
        if open_ and stride > 2 * tile:  # in parts, which reach into the next one
            size = min(max(tile, 4 * (steps - decided)), decided) + steps - decided
        else:
            size = stride * max(1, min(tile // stride, block.rows))
        values = out.view(np.uint8) if truth else out
        signs = (above if above is not None else np.empty(0, np.bool_)).view(np.uint8)
        scratch = np.empty((self._registers + k.SPARE) * size, values.dtype)
        least, greatest = (0, 1) if truth else (-np.inf, np.inf)
        zeros: int = k.run(
            rows.ravel(), self._numbers, columns.ravel(), block.rows, steps, padding, block.end == "hold", truth, least,
            greatest, scratch, np.empty(2 * size), size, decided, values.reshape(-1), row * out.shape[1] + first,
            out.shape[1], signs.reshape(-1),
        )  # fmt: skip
        return zeros

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


def compilable(program: Program) -> bool:
    """Whether the kernel knows all its instructions, and every comparison reads a signal."""
    if any(now.op in PAST for now in program.instructions):
        return False
    labels = program.labels.keys() & program.variables.keys()  # read as numbers there
    atoms = [now.atom for now in program.instructions]
    return not labels and all(bool(atom.names) for atom in atoms if isinstance(atom, Predicate))
