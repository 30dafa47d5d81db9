"""The arrays that users give to a monitor, checked: they have one shape, and samples are finite numbers or Booleans.

Samples are checked block by block, while they are in the cache for judging.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.errors import NameLookupError, TraceError
from stltool.logic.formula import label_names, variables
from stltool.logic.names import near_names
from stltool.logic.shifts import Delayed
from stltool.monitoring.blocks import Block, BlockEnd
from stltool.monitoring.compiled import within
from stltool.monitoring.program import Program
from stltool.sizes import require_memory

End = Literal["error", "cut", "hold"]

WHOLE = 2**53  # integers up to here are exact in doubles
WIDE = 2.0**969  # differences of samples below this, or of one and any double, do not overflow


@dataclass(frozen=True, slots=True)
class Traces:
    """The arrays of the names that a formula reads, (n_traces, n_steps) each, in the types given."""

    arrays: Mapping[str, NDArray[Any]]
    program: Program
    n_traces: int
    n_steps: int
    batch: bool
    first_step: int = 0  # the number of the first sample in messages
    small: bool = False  # all samples are known to be finite, and small enough for their differences to be, too

    def place(self, row: int, step: int) -> str:
        """`trace 3, step 17`, or without the trace if there is only one."""
        step += self.first_step
        return f"trace {row}, step {step}" if self.batch else f"step {step}"

    def row(self, row: int, first: int) -> Traces:
        """One trace from a step on."""
        arrays = {name: array[row : row + 1, first:] for name, array in self.arrays.items()}
        n_steps, first_step = self.n_steps - first, self.first_step + first
        return replace(self, arrays=arrays, n_traces=1, n_steps=n_steps, first_step=first_step)

    def held(self, steps: int) -> Traces:
        """With the last sample held for this many more steps."""
        require_memory(
            8.0 * len(self.arrays) * self.n_traces * (self.n_steps + steps),
            f"{self.n_traces} traces held for {steps} steps", "shorten the windows, or cut them",
        )  # fmt: skip
        arrays = {name: np.pad(array, ((0, 0), (0, steps)), mode="edge") for name, array in self.arrays.items()}
        return replace(self, arrays=arrays, n_steps=self.n_steps + steps)

    def blocks(self, end: End, samples: int) -> Iterator[tuple[Block, slice, int]]:
        """Blocks of about this many samples that decide every step once, each with its rows and its first decided step.

        Steps whose horizon is within the trace are in "open" blocks; if `end` is not "error", the others from the last
        horizon(φ) samples, cut or held.
        """
        if self.program.has_past:
            yield from self._blocks_of_the_past(end, samples)
            return
        n, rows, h = self.n_steps, self.n_traces, self.program.horizon
        tail = n if h is None or n <= samples else min(h, n)  # short traces are judged at once
        if h is not None and n > h and (end == "error" or tail < n):
            width = max(samples, 4 * h)
            if n <= width + h:
                for some in _groups(rows, max(1, width // n)):
                    yield self.block(some, slice(0, n), "open"), some, 0
            else:
                for row, first in itertools.product(range(rows), range(0, n - h, width)):
                    some = slice(row, row + 1)
                    yield self.block(some, slice(first, min(first + width + h, n)), "open"), some, first
        if end != "error" and tail > 0:
            for some in _groups(rows, max(1, samples // (2 * tail))):
                yield self.block(some, slice(n - tail, n), end), some, n - tail

    def _blocks_of_the_past(self, end: End, samples: int) -> Iterator[tuple[Block, slice, int]]:
        """The same for programs that look back: every block begins as far back as its steps can look.

        Held samples are appended until no value changes any more.
        """
        n, rows, h = self.n_steps, self.n_traces, self.program.horizon
        back = self.program.lookback
        back = n if back is None else min(back, n)
        tail = 0 if end == "error" else n if h is None or n <= samples else min(h, n)
        settled = 0 if h is None else max(n - h if end == "error" else n - tail, 0)  # decided by the samples there are
        reach = h or 0
        width = max(samples, 4 * (reach + back))
        if 0 < settled <= width:
            for some in _groups(rows, max(1, width // n)):
                block = self.block(some, slice(0, settled + reach), "open")
                yield replace(block, decided=settled), some, 0
        elif settled:
            for row, first in itertools.product(range(rows), range(0, settled, width)):
                some, start, last = slice(row, row + 1), max(first - back, 0), min(first + width, settled)
                block = self.block(some, slice(start, last + reach), "open")
                yield replace(block, skip=first - start, decided=last - first), some, first
        if tail:
            assert end != "error"
            first, start = n - tail, max(n - tail - back, 0)
            rest = replace(
                self,
                arrays={name: array[:, start:] for name, array in self.arrays.items()},
                n_steps=n - start,
                first_step=self.first_step + start,
            )
            if end == "hold":
                rest = rest.held(self.program.settling)
            for some in _groups(rows, max(1, samples // (2 * rest.n_steps))):
                block = rest.block(some, slice(0, rest.n_steps), end)
                yield replace(block, skip=first - start, decided=tail), some, first

    def block(self, rows: slice, steps: slice, end: BlockEnd) -> Block:
        """A part of the traces, its samples checked: TraceError names signal, trace, step and value."""
        columns, wide = {}, False
        for name, array in self.arrays.items():
            given = array[rows, steps]
            if name in self.program.labels:
                columns[name] = self._label(name, given, rows, steps)
            if name in self.program.variables:  # a name that is both is read as reals
                columns[name] = column = self._variable(name, given, rows, steps)
                if not self.small and not within(column, WIDE):
                    self._refuse(name, ~np.isfinite(column), rows, steps, "monitors judge finite samples")
                    wide = True
        n_rows, n_steps = rows.stop - rows.start, steps.stop - steps.start
        return Block(columns, n_rows, n_steps, end, wide, first=self.first_step + steps.start)

    def _label(self, name: str, given: NDArray[Any], rows: slice, steps: slice) -> NDArray[Any]:
        if given.dtype.kind == "b":
            return given
        why = f"it is used as a label, which is 0 or 1; compare it, as in {name} > 0"
        self._refuse(name, (given != 0) & (given != 1), rows, steps, why)
        truth: NDArray[np.bool_] = given != 0
        return truth

    def _variable(self, name: str, given: NDArray[Any], rows: slice, steps: slice) -> NDArray[np.float64]:
        if given.dtype.kind in "iu" and given.dtype.itemsize == 8:
            why = "integers beyond 2^53 may not be representable as doubles; give floats"
            self._refuse(name, (given > WHOLE) | (given < -WHOLE), rows, steps, why)
        return np.ascontiguousarray(given, dtype=np.float64)

    def _refuse(self, name: str, bad: NDArray[np.bool_], rows: slice, steps: slice, why: str) -> None:
        for row, step in np.argwhere(bad)[:1].tolist():
            value = self.arrays[name][rows.start + row, steps.start + step]
            raise TraceError(f"signal {name} is {value} at {self.place(rows.start + row, steps.start + step)}: {why}")


def _groups(rows: int, size: int) -> Iterator[slice]:
    for first in range(0, rows, size):
        yield slice(first, min(first + size, rows))


def read_traces(program: Program, signals: Mapping[str, ArrayLike], first_step: int = 0) -> Traces:
    """The arrays of a program's names, (n_steps,) or (n_traces, n_steps); their samples are checked in `blocks`.

    `first_step`: the number of the first sample in messages.

    Raises NameLookupError if a name is missing, TraceError if an array is not numeric, or shapes differ.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for name, span in {**program.variables, **program.labels}.items():
        if name not in signals:
            message = f"the traces have no signal {name}; {near_names(name, signals)}"
            raise NameLookupError(span.show(message) if span else message)
        arrays[name] = _as_array(name, signals[name])
    # a formula without names still has steps: those of any given trace
    shaped = arrays or {name: _as_array(name, values) for name, values in signals.items()}
    if not shaped:
        raise TraceError("there are no signals, so the number of steps is unknown; give one")
    first, shape = next((name, array.shape) for name, array in shaped.items())
    for name, array in shaped.items():
        if array.shape != shape:
            raise TraceError(
                f"signal {first} has shape {shape}, signal {name} {array.shape}; give all signals one shape, "
                "(n_steps,) or (n_traces, n_steps)"
            )
    batch = len(shape) == 2
    n_traces, n_steps = shape if batch else (1, *shape)
    rows = {name: array.reshape(n_traces, n_steps) for name, array in arrays.items()}
    return Traces(rows, program, n_traces, n_steps, batch, first_step)


def with_earlier(made: Delayed, signals: Mapping[str, ArrayLike], held: bool) -> Mapping[str, ArrayLike]:
    """The signals, and those made from them; with `held`, the last samples are held for as long as others look back."""
    if not made.signals:
        return signals
    bases = dict.fromkeys(name for name, _ in made.signals.values())
    names = {**variables(made.formula), **label_names(made.formula)}
    needed = {name: None for name in names if name not in made.signals and name not in made.starts} | bases
    arrays: dict[str, NDArray[Any]] = {}
    for name in needed:
        if name not in signals:
            raise NameLookupError(f"the traces have no signal {name}; {near_names(name, signals)}")
        array = _as_array(name, signals[name])
        edge = [(0, 0)] * (array.ndim - 1) + [(0, made.longest * held)]
        arrays[name] = np.pad(array, edge, mode="edge") if array.shape[-1] else array
    for name, (base, steps) in made.signals.items():
        array = arrays[base]
        n = array.shape[-1]
        arrays[name] = array[..., np.maximum(np.arange(n) - steps, 0)]  # where there is none, nobody looks
    for name, first in made.starts.items():
        arrays[name] = np.broadcast_to(np.arange(n) >= first, array.shape)
    return arrays


class Earlier:
    """What is made from a running trace's earlier samples, one sample after another."""

    def __init__(self, made: Delayed) -> None:
        self.made = made
        self.n_steps = 0
        self.kept: dict[str, deque[float]] = {}
        for base, steps in made.signals.values():
            longest = max(steps, self.kept[base].maxlen or 0) if base in self.kept else steps
            self.kept[base] = deque(maxlen=longest)

    def of(self, bases: Mapping[str, float]) -> dict[str, float]:
        """The signals and labels that are made, at the step of these samples of the signals they are made from."""
        found: dict[str, float] = {name: self.n_steps >= first for name, first in self.made.starts.items()}
        for name, (base, steps) in self.made.signals.items():
            kept = self.kept[base]
            # where there is none, nobody looks; next to 0 a margin is finite
            found[name] = kept[-steps] if len(kept) >= steps else 0.0
        return found

    def keep(self, bases: Mapping[str, float]) -> None:
        """These samples have been read."""
        for base, value in bases.items():
            self.kept[base].append(value)
        self.n_steps += 1

    def held(self) -> list[dict[str, float]]:
        """What is made while the last samples are held for as long as others look back."""
        ahead, last = Earlier(self.made), {base: kept[-1] for base, kept in self.kept.items()}
        ahead.n_steps, ahead.kept = self.n_steps, {base: kept.copy() for base, kept in self.kept.items()}
        rows = []
        for _ in range(self.made.longest):
            rows.append(ahead.of(last))
            ahead.keep(last)
        return rows


def _as_array(name: str, values: ArrayLike) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise TraceError(f"the traces of signal {name} have unequal lengths; monitor each on its own") from None
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        raise TraceError(f"signal {name} is of {array.dtype}, not numbers that fit a double; give floats or Booleans")
    if array.ndim not in (1, 2):
        raise TraceError(f"signal {name} has shape {array.shape}; give (n_steps,) or (n_traces, n_steps)")
    if isinstance(values, np.ndarray) and type(values) is not np.ndarray and np.ma.is_masked(values):
        raise TraceError(f"signal {name} has masked samples; fill them, or leave these traces out")
    if not isinstance(values, np.ndarray) and array.dtype.kind == "f" and (np.abs(array) >= WHOLE).any():
        for value in np.asarray(values, dtype=object).flat:  # numpy silently rounds integers among floats
            if isinstance(value, int) and abs(value) > WHOLE:
                why = "integers beyond 2^53 may not be representable as doubles"
                raise TraceError(f"signal {name} contains {value}: {why}")
    return array
