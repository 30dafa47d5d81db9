"""A program over a block of traces: every instruction is one pass, or O(log w) passes, over flat arrays.

A block contains whole rows, sample t of row r at r·stride + t. F[a,b] and G[a,b] double the window: from

    x_s(t) = max of x over t … t+s−1        x_{s+d}(t) = max(x_s(t), x_s(t+d))      for any d ≤ s

and φ U[0,w−1] ψ = B_w doubles the pair A_s(t) = min of φ over t … t+s−1 and B_s(t) = φ U[0,s−1] ψ:

    B_{s+d}(t) = max(B_s(t), min(A_s(t), B_s(t+d)))     A_{s+d}(t) = min(A_s(t), A_s(t+d))
    φ U[a,b] ψ at t = min(A_a(t), B_{b−a+1}(t+a))

With end "error" the rows touch (stride = steps): a window that leaves its row affects only steps that are not decided.
With end "cut" or "hold" the rows have padding, which each windowed operand fills for its reader: with the neutral
element, or with the row's last value, which is the operand's value at every later step, since all samples are held
there. Bounds beyond the row are reduced to the row's length n, from where on windows are in the padding. Windows to the
end of the row are one pass over suffixes.

once[a,b] and historically[a,b] double their windows backwards, row by row, cut at its start; since is one pass
(kernels/past.py), and φ since[a,b] ψ at t = min(historically[0,a−1] φ at t, φ since[0,b−a] ψ at t−a).

Truth is computed in Booleans. If a predicate has no value (1/0), the block is run again on −1, 0, 1 for false, unknown,
true: the same lattice, so a verdict is unknown only if it depends on an undefined value (Kleene). In margins, NaN
propagates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Constant, Label
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.program import PAST, Instruction, Program

Array: TypeAlias = NDArray[Any]
BlockEnd = Literal["open", "cut", "hold"]


@dataclass(frozen=True, slots=True)
class Block:
    """`columns` maps names to arrays (rows, steps): finite float64 for variables, Booleans for labels.

    `wide`: some variable may be so large that a difference of two is beyond the range of doubles. The first `skip`
    steps are there for windows of the past only, and so are those after `decided` more, if it is given. `first` is the
    step of the trace at which the block begins.
    """

    columns: Mapping[str, Array]
    rows: int
    steps: int
    end: BlockEnd = "open"
    wide: bool = False
    skip: int = 0
    decided: int | None = None
    first: int = 0

    @property
    def results(self) -> slice:
        """The steps whose values are asked for, of those that are decided."""
        return slice(self.skip, None if self.decided is None else self.skip + self.decided)


@dataclass(frozen=True, slots=True)
class Algebra:
    """Values that min and max apply to."""

    dtype: type
    negate: Callable[..., Any]
    least: Any
    greatest: Any


def _negative(x: Array, out: Array) -> None:
    np.subtract(0.0, x, out=out)  # 0 for 0, never −0.0: extrema must not depend on the order of their operands


BOOLEANS = Algebra(np.bool_, np.logical_not, False, True)
KLEENE = Algebra(np.int8, np.negative, -1, 1)
MARGINS = Algebra(np.float64, _negative, -np.inf, np.inf)


class _Unknown(Exception):
    """A predicate has no value somewhere."""


class Machine:
    """Runs one program over blocks, in truth, in margins or both. `gaps`: a predicate had no value, or no margin."""

    def __init__(self, program: Program, truth: bool = True, margins: bool = True) -> None:
        self.program = program
        self.gaps = False
        self._kleene = False
        self._asked = (truth, margins)
        self._pools: dict[type, _Pool] = {}

    def run(self, block: Block) -> list[Array]:
        """Truth, then margins, as requested: arrays (rows, decided steps), valid until the next run.

        Truth is in Booleans, or in −1, 0, 1 from the first gap on; a margin that does not exist is NaN.
        """
        truth, margins = self._asked
        with np.errstate(all="ignore"):
            if truth and not self._kleene:
                try:
                    return self._run(block, BOOLEANS, MARGINS if margins else None)
                except _Unknown:
                    self._kleene = True
            return self._run(block, KLEENE if truth else None, MARGINS if margins else None)

    def _run(self, block: Block, truth: Algebra | None, margins: Algebra | None) -> list[Array]:
        tapes = [_Tape(self, block, algebra) if algebra else None for algebra in (truth, margins)]
        asked = [tape for tape in tapes if tape]
        for number, instruction in enumerate(self.program.instructions):
            if instruction.op == "atom":
                self._load(instruction, number, block, *tapes)
            for tape in asked:
                tape.step(number, instruction)
        return [tape.result() for tape in asked]

    def _load(self, now: Instruction, number: int, block: Block, truth: _Tape | None, margins: _Tape | None) -> None:
        views = [(tape.algebra, tape.fresh(number)) for tape in (truth, margins) if tape is not None]
        match now.atom:
            case Constant(value):
                for algebra, view in views:
                    view[...] = algebra.greatest if value else algebra.least
            case Label(name):
                for algebra, view in views:
                    view[...] = np.where(block.columns[name], algebra.greatest, algebra.least)
            case Predicate() as predicate:
                self._judge(predicate, block, views[0] if truth else None, views[-1][1] if margins else None)
            case None:
                raise ValueError("an atom instruction without an atom")

    def _judge(
        self, predicate: Predicate, block: Block, truth: tuple[Algebra, Array] | None, margins: Array | None
    ) -> None:
        booleans = None
        if truth is not None:
            booleans = truth[1] if truth[0] is BOOLEANS else np.empty(truth[1].shape, dtype=np.bool_)
        unknown, far = predicate.judge(block.columns, booleans, margins, block.wide)
        before = max(self.program.reach(predicate.names)[1] - block.first, 0)
        if before and (far or unknown is not None):  # samples do not exist that early: nobody looks
            if margins is not None:
                margins[:, :before] = MARGINS.least
            if unknown is not None:
                unknown[:, :before] = False
                unknown = unknown if unknown.any() else None
        self.gaps |= far or unknown is not None
        if truth is None or booleans is None:
            return
        if truth[0] is KLEENE:
            truth[1][...] = np.where(booleans, 1, -1)
            if unknown is not None:
                truth[1][unknown] = 0
        elif unknown is not None:
            raise _Unknown

    def pool(self, dtype: type, size: int) -> _Pool:
        pool = self._pools.get(dtype)
        if pool is None or pool.size < size:
            pool = self._pools[dtype] = _Pool(dtype, size)
        return pool


class _Pool:
    """Reusable buffers of one size."""

    __slots__ = ("dtype", "free", "size")

    def __init__(self, dtype: type, size: int) -> None:
        self.dtype, self.size = dtype, size
        self.free: list[Array] = []

    def take(self) -> Array:
        return self.free.pop() if self.free else np.zeros(self.size, dtype=self.dtype)


_Operand: TypeAlias = tuple[Array, bool]  # a value's buffer, and whether this is its last use


class _Tape:
    """The values of a program's instructions over one block, in one algebra; buffers are freed after the last use."""

    def __init__(self, machine: Machine, block: Block, algebra: Algebra) -> None:
        self.algebra, self.block, self.instructions = algebra, block, machine.program.instructions
        self.stride = block.steps
        if block.end != "open":
            self.stride += max(self._looks_past_the_end(now) for now in self.instructions if now.op not in PAST)
        self.length = block.rows * self.stride
        if block.end == "open" and machine.program.has_past:  # a part may look further ahead than the formula does
            self.length += max(now.horizon or 0 for now in self.instructions)
        self.pool = machine.pool(algebra.dtype, self.length)
        self.values: dict[int, Array] = {}

    def fresh(self, number: int) -> Array:
        """The samples (rows, steps) of a new value, to be written."""
        self.values[number] = buffer = self.pool.take()
        return self._rows(buffer)[:, : self.block.steps]

    def result(self) -> Array:
        buffer = self.values.pop(len(self.instructions) - 1)
        self.pool.free.append(buffer)
        steps = self.block.steps
        if self.block.end == "open":
            steps -= self.instructions[-1].horizon or 0
        return self._rows(buffer)[:, :steps][:, self.block.results]

    def _rows(self, buffer: Array) -> Array:
        return buffer[: self.block.rows * self.stride].reshape(self.block.rows, self.stride)

    def step(self, number: int, now: Instruction) -> None:
        """Compute the value of an operator, and free values after their last use."""
        if now.op == "atom":
            return
        same = len(now.args) == 2 and now.args[0] == now.args[1]
        operands = [(self.values[arg], arg in now.ends and not same) for arg in now.args]
        count = self.length
        if self.block.end == "open":
            count -= max(self.instructions[arg].horizon or 0 for arg in now.args)
        self.values[number] = self._operator(now, operands, count)
        for ended in now.ends:
            buffer = self.values.pop(ended)
            if same:
                self.pool.free.append(buffer)

    def _operator(self, now: Instruction, operands: list[_Operand], count: int) -> Array:
        """The operator's value; its operands have `count` entries. Operands used for the last time are freed."""
        match now.op:
            case "not":
                out = self._out(operands)
                self.algebra.negate(operands[0][0][:count], out=out[:count])
                return out
            case "and" | "or":
                out = self._out(operands)
                _FOLD[now.op](operands[0][0][:count], operands[1][0][:count], out=out[:count])
                return out
            case "iff":
                return self._iff(operands, count)
            case "eventually" | "always":
                eventually = now.op == "eventually"
                self._fill(operands[0][0], self.algebra.least if eventually else self.algebra.greatest)
                a, b = self._bounds(now)
                if self.block.end != "open" and b == self.block.steps:
                    return self._suffixes(_FOLD[now.op], operands[0], a)
                return self._window(_FOLD[now.op], operands[0], count, a, b - a + 1)
            case "until":
                for buffer, _ in operands:  # no witness beyond the end, whatever the left side is
                    self._fill(buffer, self.algebra.least)
                return self._until(operands, count, *self._bounds(now))
            case "once":
                return self._earlier(np.maximum, operands[0], now, self.algebra.least)
            case "historically":
                return self._earlier(np.minimum, operands[0], now, self.algebra.greatest)
            case "since":
                return self._since(operands, now)
            case "atom":
                raise ValueError("an atom has no operands")
            case _:
                assert_never(now.op)

    def _bounds(self, now: Instruction) -> tuple[int, int]:
        n = self.block.steps
        if self.block.end == "open":
            assert now.b is not None
            return now.a, now.b
        return min(now.a, n), n if now.b is None else min(now.b, n)

    def _looks_past_the_end(self, now: Instruction) -> int:
        """The padding that an operator needs; windows to the end of the row only have to start in it."""
        a, b = self._bounds(now)
        return a if b == self.block.steps and now.op in ("eventually", "always") else b

    def _fill(self, buffer: Array, neutral: Any) -> None:
        n = self.block.steps
        if self.stride > n:
            rows = self._rows(buffer)
            rows[:, n:] = neutral if self.block.end == "cut" else rows[:, n - 1 : n]

    def _out(self, operands: list[_Operand]) -> Array:
        """A buffer for the result: that of an operand used for the last time, if any; other such operands are freed."""
        ending = [buffer for buffer, ends in operands if ends]
        self.pool.free += ending[1:]
        return ending[0] if ending else self.pool.take()

    def _iff(self, operands: list[_Operand], count: int) -> Array:
        left, right = (buffer[:count] for buffer, _ in operands)
        one, other = self.pool.take(), self.pool.take()
        self.algebra.negate(left, out=one[:count])
        np.maximum(one[:count], right, out=one[:count])
        self.algebra.negate(right, out=other[:count])
        np.maximum(left, other[:count], out=other[:count])
        np.minimum(one[:count], other[:count], out=one[:count])
        self.pool.free += [other, *(buffer for buffer, ends in operands if ends)]
        return one

    def _window(self, fold: np.ufunc, operand: _Operand, count: int, a: int, width: int) -> Array:
        """out[i] = fold of source[i+a … i+a+width−1]."""
        (source, ends), span = operand, 1
        count -= a
        if width == 1:
            out = self.pool.take()
            np.copyto(out[:count], source[a : a + count])
            self.pool.free += [source] * ends
            return out
        spare = None
        while span < width:
            step = min(span, width - span)
            count -= step
            out = self.pool.take() if spare is None else spare
            fold(source[a : a + count], source[a + step : a + step + count], out=out[:count])
            spare = source if ends else None
            source, ends, a, span = out, True, 0, span + step
        if spare is not None:
            self.pool.free.append(spare)
        return source

    def _suffixes(self, fold: np.ufunc, operand: _Operand, a: int) -> Array:
        """out[t] = fold of source[t+a …] to the end of the row, padding included."""
        source, ends = operand
        out = self.pool.take()
        backwards = self._rows(source)[:, a:][:, ::-1]
        fold.accumulate(backwards, axis=1, out=self._rows(out)[:, : self.stride - a][:, ::-1])
        self.pool.free += [source] * ends
        return out

    def _earlier(self, fold: np.ufunc, operand: _Operand, now: Instruction, neutral: Any) -> Array:
        """out[t] = fold of source[t−b … t−a], as far as these are in the row."""
        source, ends = operand
        n = self.block.steps
        a, b = min(now.a, n), n if now.b is None else min(now.b, n)
        out = self._reaching_back(fold, source, b - a + 1)
        if a:
            rows = self._rows(out)
            rows[:, a:n] = rows[:, : n - a].copy()
            rows[:, :a] = neutral
        self.pool.free += [source] * ends
        return out

    def _reaching_back(self, fold: np.ufunc, source: Array, width: int) -> Array:
        """out[t] = fold of source[t−width+1 … t], as far as these are in the row."""
        n, span = self.block.steps, 1
        out, spare = self.pool.take(), self.pool.take()
        known = self._rows(source)[:, :n]
        if width >= n:
            fold.accumulate(known, axis=1, out=self._rows(out)[:, :n])
        elif width == 1:
            self._rows(out)[:, :n] = known
        else:
            while span < width:
                out, spare = spare, out
                step, target = min(span, width - span), self._rows(out)[:, :n]
                fold(known[:, step:], known[:, : n - step], out=target[:, step:])
                target[:, :step] = known[:, :step]
                known, span = target, span + step
        self.pool.free.append(spare)
        return out

    def _since(self, operands: list[_Operand], now: Instruction) -> Array:
        from stltool.kernels import past  # loads numba

        (left, left_ends), (right, right_ends) = operands
        n, rows, stride = self.block.steps, self.block.rows, self.stride
        a, b = min(now.a, n), n if now.b is None else min(now.b, n)
        out, n_rows = self.pool.take(), rows if n else 0
        arrays = [buffer.view(np.int8) if buffer.dtype == np.bool_ else buffer for buffer in (left, right, out)]
        if b - a >= n - 1:
            past.since_start(arrays[0], arrays[1], n_rows, stride, n, arrays[2])
        else:
            room = [np.empty(n, arrays[0].dtype) for _ in range(3)]
            past.since_within(arrays[0], arrays[1], n_rows, stride, n, b - a, arrays[2], *room)
        if a:
            stays = self._reaching_back(np.minimum, left, a)
            found, before = self._rows(out), self._rows(stays)
            np.minimum(found[:, : n - a].copy(), before[:, a:n], out=found[:, a:n])
            found[:, :a] = self.algebra.least
            self.pool.free.append(stays)
        self.pool.free += [*[left] * left_ends, *[right] * right_ends]
        return out

    def _until(self, operands: list[_Operand], count: int, a: int, b: int) -> Array:
        (left, left_ends), (right, right_ends) = operands
        before = self._window(np.minimum, (left, False), count, 0, a) if a > 0 else None
        count, span, width = count - a, 1, b - a + 1
        A, B, spare, next_B = (self.pool.take() for _ in range(4))
        np.copyto(A[:count], left[a : a + count])
        np.copyto(B[:count], right[a : a + count])
        while span < width:
            step = min(span, width - span)
            count -= step
            np.minimum(A[:count], B[step : step + count], out=spare[:count])
            np.maximum(B[:count], spare[:count], out=next_B[:count])
            np.minimum(A[:count], A[step : step + count], out=spare[:count])
            A, spare, B, next_B, span = spare, A, next_B, B, span + step
        if before is not None:
            np.minimum(before[:count], B[:count], out=B[:count])
            self.pool.free.append(before)
        self.pool.free += [A, spare, next_B, *[left] * left_ends, *[right] * right_ends]
        return B


_FOLD: dict[str, np.ufunc] = {
    "and": np.minimum, "or": np.maximum, "always": np.minimum, "eventually": np.maximum,
}  # fmt: skip
