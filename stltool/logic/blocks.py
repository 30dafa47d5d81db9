"""A program over a block of traces: every instruction one pass, or O(log w) passes, over flat arrays.

A block holds whole rows, sample t of row r at r·stride + t. F[a,b] and G[a,b] double the window: from

    x_s(t) = max of x over t … t+s−1        x_{s+d}(t) = max(x_s(t), x_s(t+d))      for any d ≤ s

and φ U[0,w−1] ψ = B_w doubles the pair of A_s(t) = min of φ over t … t+s−1 and B_s(t) = φ U[0,s−1] ψ:

    B_{s+d}(t) = max(B_s(t), min(A_s(t), B_s(t+d)))     A_{s+d}(t) = min(A_s(t), A_s(t+d))
    φ U[a,b] ψ at t = min(A_a(t), B_{b−a+1}(t+a))

Without an end the rows touch (stride = steps): a window that leaves its row spoils only steps that nobody decides. With
end "cut" or "hold" the rows have padding that each windowed operand fills for its reader: with the neutral element, or
with the row's last value, which is the operand's value at every later step, since all samples are held there. Bounds
beyond the row are the row's length n: windows are in the padding from there on.

Truth runs on Booleans. Where a predicate has no value (1/0), the block runs again on −1, 0, 1 for false, unknown, true:
the same lattice, so a verdict is unknown only if it hangs on what has no value (Kleene). In margins NaN spreads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.logic.comparisons import Predicate
from stltool.logic.formula import Constant, Label
from stltool.logic.program import Instruction, Program

Array: TypeAlias = NDArray[Any]
BlockEnd = Literal["open", "cut", "hold"]


@dataclass(frozen=True, slots=True)
class Block:
    """`columns` maps names to arrays (rows, steps), float64 for variables, Booleans for labels."""

    columns: Mapping[str, Array]
    rows: int
    steps: int
    end: BlockEnd = "open"


@dataclass(frozen=True, slots=True)
class Algebra:
    """Values that min and max apply to."""

    dtype: type
    negate: Callable[..., Any]
    least: Any
    greatest: Any


BOOLEANS = Algebra(np.bool_, np.logical_not, False, True)
KLEENE = Algebra(np.int8, np.negative, -1, 1)
MARGINS = Algebra(np.float64, lambda x, out: np.subtract(0.0, x, out=out), -np.inf, np.inf)  # never −0.0


class _Unknown(Exception):
    """A predicate has no value somewhere."""


class Machine:
    """Runs one program over blocks, in truth, in margins or both. `gaps`: some predicate had no value so far."""

    def __init__(self, program: Program, truth: bool = True, margins: bool = True) -> None:
        self.program = program
        self.gaps = False
        self._asked = (truth, margins)
        self._pools: dict[type, _Pool] = {}

    def run(self, block: Block) -> list[Array]:
        """Truth, then margins, of what was asked: arrays (rows, decided steps), valid until the next run.

        Truth is of Booleans, or of −1, 0, 1 where `gaps` has become true.
        """
        truth, margins = self._asked
        with np.errstate(all="ignore"):
            if truth and not self.gaps:
                try:
                    return self._run(block, BOOLEANS, MARGINS if margins else None)
                except _Unknown:
                    self.gaps = True
            return self._run(block, KLEENE if truth else None, MARGINS if margins else None)

    def _run(self, block: Block, truth: Algebra | None, margins: Algebra | None) -> list[Array]:
        tapes = [_Tape(self, block, algebra) if algebra else None for algebra in (truth, margins)]
        for number, instruction in enumerate(self.program.instructions):
            if instruction.op == "atom":
                self._load(instruction, number, block, *tapes)
            for tape in tapes:
                if tape is not None:
                    tape.step(number, instruction)
        return [tape.result() for tape in tapes if tape]

    def _load(self, now: Instruction, number: int, block: Block, truth: _Tape | None, margins: _Tape | None) -> None:
        tapes = [(tape, tape.fresh(number)) for tape in (truth, margins) if tape is not None]
        match now.atom:
            case Constant(value):
                for tape, view in tapes:
                    view[...] = tape.algebra.greatest if value else tape.algebra.least
            case Label(name):
                for tape, view in tapes:
                    view[...] = np.where(block.columns[name], tape.algebra.greatest, tape.algebra.least)
            case Predicate() as predicate:
                distance = tapes[-1][1] if margins is not None else None
                if truth is None:
                    undefined = predicate.judge(block.columns, None, distance)
                elif truth.algebra is BOOLEANS:
                    undefined = predicate.judge(block.columns, tapes[0][1], distance)
                    if undefined is not None:
                        raise _Unknown
                else:
                    booleans = np.empty((block.rows, block.steps), dtype=np.bool_)
                    undefined = predicate.judge(block.columns, booleans, distance)
                    tapes[0][1][...] = np.where(booleans, 1, -1)
                    if undefined is not None:
                        tapes[0][1][undefined] = 0
                self.gaps |= undefined is not None
            case None:
                raise ValueError("an atom instruction without its atom")

    def pool(self, dtype: type, size: int) -> _Pool:
        pool = self._pools.get(dtype)
        if pool is None or pool.size < size:
            pool = self._pools[dtype] = _Pool(dtype, size)
        return pool


class _Pool:
    """Buffers of one size, used again."""

    __slots__ = ("dtype", "free", "size")

    def __init__(self, dtype: type, size: int) -> None:
        self.dtype, self.size = dtype, size
        self.free: list[Array] = []

    def take(self) -> Array:
        return self.free.pop() if self.free else np.zeros(self.size, dtype=self.dtype)


class _Tape:
    """The values of a program's instructions over one block, in one algebra; a value's buffer is free after its end."""

    def __init__(self, machine: Machine, block: Block, algebra: Algebra) -> None:
        self.algebra, self.block = algebra, block
        bounds = [i.b if i.b is not None else block.steps for i in machine.program.instructions]
        self.stride = block.steps + (0 if block.end == "open" else min(max(bounds), block.steps))
        self.length = block.rows * self.stride
        self.pool = machine.pool(algebra.dtype, self.length)
        self.program = machine.program
        self.values: dict[int, Array] = {}

    def fresh(self, number: int) -> Array:
        """A new value's samples, (rows, steps), to be written."""
        self.values[number] = buffer = self.pool.take()
        return self._rows(buffer)[:, : self.block.steps]

    def result(self) -> Array:
        last = len(self.program.instructions) - 1
        buffer = self.values.pop(last)
        self.pool.free.append(buffer)
        steps = self.block.steps
        if self.block.end == "open":
            steps -= self.program.instructions[last].horizon or 0
        return self._rows(buffer)[:, :steps]

    def _rows(self, buffer: Array) -> Array:
        return buffer[: self.length].reshape(self.block.rows, self.stride)

    def _valid(self, number: int) -> int:
        """How many leading places of a value have one."""
        return self.length - (self.program.instructions[number].horizon or 0 if self.block.end == "open" else 0)

    def step(self, number: int, now: Instruction) -> None:
        if now.op != "atom":
            self.values[number] = self._operator(now)
        for ended in now.ends:
            self.pool.free.append(self.values.pop(ended))

    def _operator(self, now: Instruction) -> Array:
        valid = min(self._valid(arg) for arg in now.args)
        operands = [self.values[arg] for arg in now.args]
        match now.op:
            case "not":
                out = self.pool.take()
                self.algebra.negate(operands[0][:valid], out=out[:valid])
                return out
            case "and" | "or":
                out = self.pool.take()
                _FOLD[now.op](operands[0][:valid], operands[1][:valid], out=out[:valid])
                return out
            case "iff":
                return self._iff(operands[0][:valid], operands[1][:valid])
            case "eventually" | "always":
                fold = _FOLD[now.op]
                neutral = self.algebra.least if fold is np.maximum else self.algebra.greatest
                self._fill(operands[0], neutral)
                a, b = self._bounds(now)
                return self._window(fold, operands[0], valid, a, b - a + 1)
            case "until":
                self._fill(operands[0], self.algebra.greatest)
                self._fill(operands[1], self.algebra.least)
                return self._until(operands[0], operands[1], valid, *self._bounds(now))
            case "atom":
                raise ValueError("atoms are loaded")
            case _:
                assert_never(now.op)

    def _bounds(self, now: Instruction) -> tuple[int, int]:
        if self.block.end == "open":
            assert now.b is not None
            return now.a, now.b
        n = self.block.steps
        return min(now.a, n), n if now.b is None else min(now.b, n)

    def _fill(self, buffer: Array, neutral: Any) -> None:
        n = self.block.steps
        if self.stride > n:
            rows = self._rows(buffer)
            rows[:, n:] = neutral if self.block.end == "cut" else rows[:, n - 1 : n]

    def _iff(self, left: Array, right: Array) -> Array:
        outs = self.pool.take(), self.pool.take()
        one, other = (out[: len(left)] for out in outs)
        self.algebra.negate(left, out=one)
        np.maximum(one, right, out=one)
        self.algebra.negate(right, out=other)
        np.maximum(left, other, out=other)
        np.minimum(one, other, out=one)
        self.pool.free.append(outs[1])
        return outs[0]

    def _window(self, fold: np.ufunc, source: Array, valid: int, a: int, width: int) -> Array:
        """out[i] = fold of source[i+a … i+a+width−1]; `source` is left as it is."""
        out, spare = self.pool.take(), self.pool.take()
        count = valid - a
        np.copyto(out[:count], source[a:valid])
        span = 1
        while span < width:
            step = min(span, width - span)
            count -= step
            fold(out[:count], out[step : step + count], out=spare[:count])
            out, spare, span = spare, out, span + step
        self.pool.free.append(spare)
        return out

    def _until(self, left: Array, right: Array, valid: int, a: int, b: int) -> Array:
        width, count, span = b - a + 1, valid - a, 1
        A, B, spare, moved = (self.pool.take() for _ in range(4))
        np.copyto(A[:count], left[a:valid])
        np.copyto(B[:count], right[a:valid])
        while span < width:
            step = min(span, width - span)
            count -= step
            np.minimum(A[:count], B[step : step + count], out=spare[:count])
            np.maximum(B[:count], spare[:count], out=moved[:count])
            B, moved = moved, B
            np.minimum(A[:count], A[step : step + count], out=spare[:count])
            A, spare, span = spare, A, span + step
        self.pool.free += [A, spare, moved]
        if a > 0:
            before = self._window(np.minimum, left, valid, 0, a)
            np.minimum(before[:count], B[:count], out=B[:count])
            self.pool.free.append(before)
        return B


_FOLD: dict[str, np.ufunc] = {
    "and": np.minimum, "or": np.maximum, "always": np.minimum, "eventually": np.maximum,
}  # fmt: skip
