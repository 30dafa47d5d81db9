"""Truth and robustness at every step of whole batches of traces: what `satisfies` and `robustness` say, fast.

A step t is decided by the samples t … t + horizon(φ). With n steps:

    end "error"   the n − horizon(φ) decided steps
    end "cut"     all n steps; windows are cut at the end of the trace, an empty one is the neutral element (F false,
                  G true, U without witness)
    end "hold"    all n steps; the last sample is held

Formulas look ahead only: the steps before n − horizon(φ) are the same for all three, and the others depend on the last
horizon(φ) samples alone. So both parts are judged on their own (blocks.py), in blocks that fit the cache.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.errors import NameLookupError, SettingsError, TraceError, near_misses
from stltool.logic import semantics as oracle
from stltool.logic.blocks import Block, BlockEnd, Machine
from stltool.logic.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Until,
    children,
    horizon,
)
from stltool.logic.program import Program, compile_formula
from stltool.logic.source import Span
from stltool.logic.task import Task

End = Literal["error", "cut", "hold"]
Semantics = Literal["both", "boolean", "robustness"]

_BLOCK = 1 << 13  # samples a block: buffers stay in the cache
_WHOLE = 2**53  # whole numbers up to here are doubles


@dataclass(frozen=True, eq=False)
class MonitorResult:
    """Truth and robustness at the decided steps.

    verdicts     Booleans (n_decided,) for one trace, (n_traces, n_decided) for a batch; None if not asked
    robustness   float64 of the same shape; None if not asked
    horizon      steps after a step that can matter; None for a formula with an interval without end
    n_steps      samples of each trace
    """

    formula: Formula
    end: End
    n_steps: int
    horizon: int | None
    verdicts: NDArray[np.bool_] | None
    robustness: NDArray[np.float64] | None

    @property
    def first_violation(self) -> int | NDArray[np.int64] | None:
        """The first step with verdict false: None for none; of a batch an array (n_traces,), with -1 for none.

        SettingsError where verdicts were not asked.
        """
        if self.verdicts is None:
            raise SettingsError('there are no verdicts; monitor with semantics="both" or "boolean"')
        if self.verdicts.shape[-1] == 0:
            return None if self.verdicts.ndim == 1 else np.full(len(self.verdicts), -1)
        first, all_true = self.verdicts.argmin(axis=-1), self.verdicts.all(axis=-1)
        if self.verdicts.ndim == 1:
            return None if all_true else int(first)
        return np.where(all_true, -1, first)


def monitor(
    phi: Formula | Task, signals: Mapping[str, ArrayLike], end: End = "error", semantics: Semantics = "both"
) -> MonitorResult:
    """Truth and robustness of φ at every decided step of one trace or of a batch.

    `signals` maps every name of φ to an array (n_steps,) or (n_traces, n_steps), all of one shape: reals for variables,
    Booleans (or 0 / 1) for labels. What is decided at the end: see the module's text. Verdicts are those of
    `satisfies`, exactly; robustness is in doubles, within a few units in the last place of the numbers compared, and
    its sign is right: > 0 implies true, < 0 implies false.

    Raises TraceError where traces are too short, unequal, not numbers, not finite, or give a predicate no value (naming
    trace and step; in verdicts alone, only where one hangs on it), NameLookupError where a name is missing,
    StlSyntaxError where an interval has no end and `end` is "error".
    """
    formula = phi.formula if isinstance(phi, Task) else phi
    program = compile_formula(formula)
    _require("end", end, get_args(End))
    _require("semantics", semantics, get_args(Semantics))
    if end == "error":
        horizon(formula)  # refuses an interval without end, with its place
    traces = read_traces(program, signals)
    verdicts, margins = judge(formula, program, traces, end, semantics != "robustness", semantics != "boolean")
    if not traces.batch:
        verdicts = None if verdicts is None else verdicts[0]
        margins = None if margins is None else margins[0]
    return MonitorResult(formula, end, traces.n_steps, program.horizon, verdicts, margins)


def _require(what: str, given: str, known: tuple[str, ...]) -> None:
    if given not in known:
        raise SettingsError(f"there is no {what} {given!r}; choose {', '.join(known)}")


# ------------------------------------------------------------------------------------------- reading the traces


@dataclass(frozen=True, slots=True)
class Traces:
    """The arrays of the names that a formula reads, (n_traces, n_steps) each, as they were given."""

    arrays: Mapping[str, NDArray[Any]]
    labels: frozenset[str]
    variables: frozenset[str]
    n_traces: int
    n_steps: int
    batch: bool
    first_step: int = 0  # of the first sample, for messages

    def place(self, row: int, step: int) -> str:
        step += self.first_step
        return f"trace {row}, step {step}" if self.batch else f"step {step}"

    def block(self, rows: slice, steps: slice, end: BlockEnd) -> Block:
        """A part of the traces, its samples checked."""
        columns = {name: self._column(name, rows, steps) for name in self.arrays}
        return Block(columns, rows.stop - rows.start, steps.stop - steps.start, end)

    def _column(self, name: str, rows: slice, steps: slice) -> NDArray[Any]:
        given = self.arrays[name][rows, steps]
        if given.dtype.kind in "iu" and name in self.variables:
            self._refuse(name, rows, steps, (given > _WHOLE) | (given < -_WHOLE), "a whole number beyond 2^53, which a "
                         "double may not hold; give it as a float")  # fmt: skip
        if given.dtype.kind == "f":
            self._refuse(name, rows, steps, ~np.isfinite(given), "not finite; monitors judge finite samples")
        if name in self.labels:
            self._refuse(name, rows, steps, (given != 0) & (given != 1), "used as a label, which is true or false (1 "
                         f"or 0); compare it, as in {name} > 0")  # fmt: skip
        return given.astype(np.float64) if name in self.variables else given != 0

    def _refuse(self, name: str, rows: slice, steps: slice, bad: NDArray[np.bool_], why: str) -> None:
        if bad.any():
            row, step = (int(i) for i in np.argwhere(bad)[0])
            row, step = row + rows.start, step + steps.start
            value = self.arrays[name][row, step]
            raise TraceError(f"signal {name} is {value} at {self.place(row, step)}: {why}")


def read_traces(program: Program, signals: Mapping[str, ArrayLike]) -> Traces:
    names: dict[str, Span | None] = {**program.variables, **program.labels}
    arrays: dict[str, NDArray[Any]] = {}
    for name, span in names.items():
        if name not in signals:
            message = f"the traces have no signal {name}; {near_misses(name, signals)}"
            raise NameLookupError(span.show(message) if span else message)
        arrays[name] = _as_array(name, signals[name])
    # a formula without names still has steps, those of whatever traces there are
    shapes = {name: array.shape for name, array in arrays.items()} or {
        name: _as_array(name, values).shape for name, values in signals.items()
    }
    if not shapes:
        raise TraceError("there is no signal to take the number of steps from; give one")
    first, shape = next(iter(shapes.items()))
    for name, other in shapes.items():
        if other != shape:
            raise TraceError(f"signal {first} has shape {shape}, signal {name} {other}; give all signals one shape")
    batch = len(shape) == 2
    n_traces, n_steps = shape if batch else (1, *shape)
    rows = {name: array.reshape(n_traces, n_steps) for name, array in arrays.items()}
    return Traces(rows, frozenset(program.labels), frozenset(program.variables), n_traces, n_steps, batch)


def _as_array(name: str, values: ArrayLike) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise TraceError(f"the traces of signal {name} have unequal lengths; monitor each on its own") from None
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        raise TraceError(f"signal {name} holds {array.dtype}, not numbers that fit a double; give floats or Booleans")
    if array.ndim not in (1, 2):
        raise TraceError(f"signal {name} has shape {array.shape}; give (n_steps,) or (n_traces, n_steps)")
    return array


# ------------------------------------------------------------------------------------------- judging them


def judge(
    phi: Formula, program: Program, traces: Traces, end: End, truth: bool, margins: bool
) -> tuple[NDArray[np.bool_] | None, NDArray[np.float64] | None]:
    """Truth and margins (n_traces, decided steps); None for what is not asked."""
    n, h = traces.n_steps, program.horizon
    decided = n if h is None or end != "error" else n - h
    if decided <= 0 and end == "error":
        raise TraceError(
            f"the traces have {n} samples; this formula needs {n - decided + 1} (its horizon is {h}): give longer "
            'ones, or end="cut" to cut windows at the end of the trace, or end="hold" to hold the last sample'
        )
    verdicts = np.empty((traces.n_traces, decided), dtype=np.bool_) if truth else None
    robustness = np.empty((traces.n_traces, decided)) if margins else None
    machine = Machine(program, truth, margins)
    for rows, steps, block_end, first in _parts(traces, h, end):
        results = machine.run(traces.block(rows, steps, block_end))
        for result, out in zip(results, (out for out in (verdicts, robustness) if out is not None), strict=True):
            if machine.gaps:
                for row, step in np.argwhere(_unknown(result))[:1].tolist():
                    _blame(phi, traces, rows.start + row, first + step, end, result.dtype == np.float64)
            out[rows, first : first + result.shape[1]] = result > 0 if result.dtype == np.int8 else result
    return verdicts, robustness


def _parts(traces: Traces, h: int | None, end: End) -> Iterator[tuple[slice, slice, BlockEnd, int]]:
    """Blocks: their rows, their samples, how they end, and the first step that they decide."""
    n, rows = traces.n_steps, traces.n_traces
    if h is not None and n > h:
        width = max(_BLOCK, 4 * h)
        if n <= width + h:
            some = max(1, width // n)
            for row in range(0, rows, some):
                yield slice(row, min(row + some, rows)), slice(0, n), "open", 0
        else:
            for row, step in itertools.product(range(rows), range(0, n - h, width)):
                yield slice(row, row + 1), slice(step, min(step + width + h, n)), "open", step
    tail = n if h is None else min(h, n)
    if end != "error" and tail > 0:
        some = max(1, _BLOCK // (2 * tail))
        for row in range(0, rows, some):
            yield slice(row, min(row + some, rows)), slice(n - tail, n), "cut" if end == "cut" else "hold", n - tail


def _unknown(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Where there is no truth (in Booleans, −1, 0, 1) or no margin."""
    unknown: NDArray[np.bool_] = np.isnan(values) if values.dtype == np.float64 else values == 0
    return unknown if values.dtype != np.bool_ else np.zeros_like(values)


def _blame(phi: Formula, traces: Traces, row: int, step: int, end: End, margins: bool) -> NoReturn:
    """Raise the error of the predicate that left the formula without truth (or margin) at this step."""
    if isinstance(phi, Comparison):
        sample = {name: [float(array[row, step])] for name, array in traces.arrays.items()}
        try:
            (oracle.robustness if margins else oracle.satisfies)(phi, sample)
        except TraceError as error:
            raise TraceError(f"{traces.place(row, step)}: {error}") from None
    one = {name: array[row : row + 1, step:] for name, array in traces.arrays.items()}
    rest = replace(traces, arrays=one, n_traces=1, n_steps=traces.n_steps - step)
    for child, (a, b) in zip(children(phi), _looks(phi, rest.n_steps), strict=True):
        machine = Machine(compile_formula(child), not margins, margins)
        whole = rest.block(slice(0, 1), slice(0, rest.n_steps), "hold" if end == "hold" else "cut")
        unknown = _unknown(machine.run(whole)[0])
        if end == "hold":
            a, b = (min(bound, rest.n_steps - 1) for bound in (a, b))
        wrong = np.flatnonzero(unknown[0, a : b + 1])
        if len(wrong):
            _blame(child, traces, row, step + a + int(wrong[0]), end, margins)
    raise AssertionError(f"{phi} has a value at {traces.place(row, step)}")


def _looks(phi: Formula, n: int) -> list[tuple[int, int]]:
    """For every operand the first and the last step after the present one that it is looked at."""
    match phi:
        case Eventually(interval, _) | Always(interval, _):
            return [(interval.a, n if interval.b is None else interval.b)]
        case Until(interval, _, _):
            b = n if interval.b is None else interval.b
            return [(0, b - 1), (interval.a, b)]
        case _:
            return [(0, 0)] * len(children(phi))
