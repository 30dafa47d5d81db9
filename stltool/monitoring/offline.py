"""Truth and robustness at every step of whole batches of traces: the results of `satisfies` and `robustness`, fast.

Step t is decided by the samples t … t + horizon(φ). With n steps:

    end "error"   the n − horizon(φ) decided steps
    end "cut"     all n steps; windows are cut at the end of the trace, an empty one is the neutral element (F false,
                  G true, U without witness)
    end "hold"    all n steps; the last sample is held

The steps before n − horizon(φ) are the same in all three cases, and the others depend only on the last horizon(φ)
samples, and on lookback(φ) ones before these. So both parts are judged separately (blocks.py), in blocks that fit the
cache. Windows of the past are cut at step 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import mapping, one_of, whole
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError, TraceError, named
from stltool.logic import semantics as oracle
from stltool.logic.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Historically,
    Once,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    formula_of,
    has_past,
    horizon,
    is_bounded,
    label_names,
    lookback,
    variables,
)
from stltool.logic.semantics import samples_of
from stltool.logic.task import Task
from stltool.monitoring.blocks import Block, Machine
from stltool.monitoring.compiled import SAMPLES, Compiled, compiled, worthwhile
from stltool.monitoring.program import compile_delayed, compile_formula
from stltool.monitoring.samples import WIDE, End, Traces, read_traces, with_earlier

Semantics = Literal["both", "boolean", "robustness"]

_MARGINS = 1 << 14  # samples per block: the buffers of a few values stay in the L2 cache
_TRUTH = 1 << 17

_CUT, _HOLD = named("end", 'end="cut"'), named("end", 'end="hold"')


@dataclass(frozen=True, eq=False, repr=False)
class MonitorResult(Displayed):
    """Truth and robustness at the decided steps.

    verdicts     Booleans (n_decided,) for one trace, (n_traces, n_decided) for a batch; None if not requested
    robustness   float64 of the same shape; None if not requested
    horizon      number of later steps that a verdict depends on; None for a formula with an interval without end
    n_steps      samples of each trace
    first_step   the step of the first verdict: 0, or the one requested with `at`
    """

    formula: Formula
    end: End
    n_steps: int
    horizon: int | None
    verdicts: NDArray[np.bool_] | None
    robustness: NDArray[np.float64] | None
    first_step: int = 0

    def _card(self) -> Card:
        some = self.verdicts if self.verdicts is not None else self.robustness
        assert some is not None  # one of the two was requested
        traces = counted(len(some), "trace") if some.ndim == 2 else "1 trace"
        facts: dict[str, object] = {}
        if self.verdicts is not None:
            facts["holds at"] = f"{int(self.verdicts.sum())} of {self.verdicts.size} steps"
            violated = self.first_violation
            if isinstance(violated, np.ndarray):
                facts["traces with a violation"] = int((violated >= 0).sum())
            else:
                facts["first violation"] = "none" if violated is None else f"at step {violated}"
        if self.robustness is not None and self.robustness.size:
            facts["robustness"] = f"{self.robustness.min():.6g} to {self.robustness.max():.6g}"
        return Card(
            f"MonitorResult: {traces} of {counted(self.n_steps, 'sample')}, {counted(some.shape[-1], 'step')} decided",
            [facts, {"formula": self.formula, "end": self.end}],
        )

    @property
    def first_violation(self) -> int | NDArray[np.int64] | None:
        """The first step with verdict false: None if there is none; for a batch an array (n_traces,), with -1 for none.

        SettingsError if verdicts were not requested.
        """
        if self.verdicts is None:
            raise SettingsError('there are no verdicts; monitor with semantics="both" or "boolean"')
        violated = ~self.verdicts
        if violated.ndim == 1:
            return self.first_step + int(violated.argmax()) if violated.any() else None
        n = violated.shape[1]
        first = np.where(violated, np.arange(n), n).min(axis=1, initial=n)
        return np.where(first < n, self.first_step + first, -1)


def monitor(
    phi: Formula | Task,
    signals: Mapping[str, ArrayLike],
    end: End = "error",
    semantics: Semantics = "both",
    at: int | None = None,
) -> MonitorResult:
    """Truth and robustness of φ at every decided step of one trace or of a batch.

    `signals` maps every name of φ to an array (n_steps,) or (n_traces, n_steps), all of one shape: reals for variables,
    Booleans (or 0 / 1) for labels. For the end of the trace, see the module docstring. Verdicts are those of
    `satisfies`, exactly; robustness is in doubles, within a few units in the last place of the numbers compared, and
    its sign is right: > 0 implies true, < 0 implies false.

    With `at`, only that step is judged, and only the samples are read that it depends on: the time does not grow with
    the traces.

    Raises TraceError, naming trace and step, if traces are too short, of unequal lengths, not numbers, not finite, or
    give a predicate no value (if only verdicts are requested: if a verdict depends on it), NameLookupError if a name is
    missing, and StlSyntaxError if an interval has no end and `end` is "error".
    """
    one_of(semantics, "semantics", get_args(Semantics))
    read, start, n_steps = signals, 0, None
    if at is not None:
        read, start, n_steps = _around(phi, signals, end, whole(at, "monitor's step at", least=0))
    formula, traces, beyond = prepare(phi, read, end, "monitor")
    traces = replace(traces, first_step=start)
    truth, margins = semantics != "robustness", semantics != "boolean"
    asked = slice(traces.n_steps - beyond) if at is None else slice(at - start, at - start + 1)
    outs = [out[:, asked] for out in judge(formula, traces, end, truth, margins, asked)]
    outs = outs if traces.batch else [out[0] for out in outs]
    return MonitorResult(
        formula_of(phi, "monitor's formula"),
        end,
        traces.n_steps - beyond if n_steps is None else n_steps,
        traces.program.horizon,
        outs[0] if truth else None,
        outs[-1] if margins else None,
        at or 0,
    )


def _around(
    phi: Formula | Task, signals: Mapping[str, ArrayLike], end: End, at: int
) -> tuple[dict[str, ArrayLike], int, int]:
    """The samples that step `at` depends on, the step of the first, and the number of steps that there are."""
    formula = formula_of(phi, "monitor's formula")
    mapping(signals, "monitor's signals", oracle.SIGNALS)
    names = {**variables(formula), **label_names(formula)}
    arrays: dict[str, Any] = {}
    lengths: dict[str, int] = {}
    for name in names or signals:
        if name in signals:  # `prepare` reports what is missing
            array: Any = signals[name]
            arrays[name] = array = array if _is_plain_list(array) else samples_of(name, array)
            lengths[name] = len(array) if isinstance(array, list) else array.shape[-1] if array.ndim else 0
    if names and not lengths:
        return {name: signals[name] for name in signals.keys()}, 0, 0  # noqa: SIM118 - of a data frame, too
    for name, length in lengths.items():
        first = next(iter(lengths))
        if length != lengths[first]:
            raise TraceError(
                f"signal {first} has {lengths[first]} samples, signal {name} {length}; give all signals one shape"
            )
    n = next(iter(lengths.values()), 0)
    h = horizon(formula) if end == "error" or is_bounded(formula) else None
    if at >= n or (end == "error" and h is not None and at + h >= n):
        needed = at + 1 if end != "error" or h is None else at + h + 1
        raise TraceError(
            f"the traces have {n} samples; at step {at} this formula needs {needed}; give longer ones, or judge "
            "an earlier step"
        )
    back = lookback(formula)
    start = 0 if back is None else max(0, at - back)
    part = slice(start, n if h is None else min(n, at + h + 1))
    cut = {name: array[part] if isinstance(array, list) else array[..., part] for name, array in arrays.items()}
    return cut, start, n


def _is_plain_list(array: object) -> bool:
    """Whether slicing reads only the slice."""
    return isinstance(array, list) and bool(array) and not hasattr(array[0], "__len__")


def without_last(out: NDArray[Any], n: int) -> NDArray[Any]:
    """Steps (n_traces, n_steps) without the last n."""
    return out[:, : out.shape[1] - n]


def judge(
    formula: Formula, traces: Traces, end: End, truth: bool, margins: bool, asked: slice = slice(None)
) -> list[NDArray[Any]]:
    """Verdicts, then margins, (n_traces, n_decided) each, as requested; only the steps `asked` for need one."""
    decided = decided_steps(traces, end)
    begin, stop, _ = asked.indices(decided)
    outs: list[NDArray[Any]] = [np.empty((traces.n_traces, decided), np.bool_)] * truth
    outs += [np.empty((traces.n_traces, decided))] * margins
    quick, samples = None, _MARGINS if margins else _TRUTH
    if worthwhile(traces.n_traces * traces.n_steps) and (quick := compiled(traces.program)) is not None:
        samples = SAMPLES
        if quick.whole(traces, end, outs, truth, margins, 0.0 if traces.small else WIDE):
            return outs
    machine = Machine(traces.program, truth, margins)
    for block, rows, first in traces.blocks(end, samples):
        if quick is not None and not machine.gaps and judge_quickly(quick, block, outs, truth, margins, rows, first):
            continue
        for out, found in zip(outs, machine.run(block), strict=True):
            if machine.gaps:
                before = max(begin - first, 0)
                some = found[:, before : max(stop - first, 0)]
                refuse_unknown(some, formula, traces, rows.start, first + before, end)
            out[rows, first : first + found.shape[1]] = found > 0 if found.dtype == np.int8 else found
    return outs


def judge_quickly(
    quick: Compiled, block: Block, outs: list[NDArray[Any]], truth: bool, margins: bool, rows: slice, first: int
) -> bool:
    """Whether the kernel has judged a block; otherwise, what it has written is to be written again."""
    if block.wide or (judged := quick.judged(block, truth, margins)) is None:
        return False
    if margins:
        distances = [distance for _, distance in judged]
        zeros = quick.run(block, distances, False, outs[-1], rows.start, first, outs[0] if truth else None)
        truth = truth and zeros > 0  # else the signs of the margins are the truth
    if truth:
        quick.run(block, [true for true, _ in judged], True, outs[0], rows.start, first)
    return True


def prepare(
    phi: Formula | Task, signals: Mapping[str, ArrayLike], end: End, caller: str, once: bool = True
) -> tuple[Formula, Traces, int]:
    """The formula as it is judged, the traces it reads, and the number of their steps that were added to hold the last.

    `once`: once[k,k] of a comparison becomes one of earlier samples, for what computes no sum over operators.
    Raises what `monitor` raises, except for faults of single samples.
    """
    given = formula_of(phi, f"{caller}'s formula")
    mapping(signals, f"{caller}'s signals", oracle.SIGNALS)
    made, program = compile_delayed(given, once)
    formula = made.formula
    one_of(end, "end", get_args(End))
    if end == "error" and program.horizon is None:
        horizon(formula)  # raises, with the position of the interval without end
    held = end == "hold"
    return formula, read_traces(program, with_earlier(made, signals, held)), made.longest * held


def decided_steps(traces: Traces, end: End) -> int:
    """The number of decided steps; TraceError if there is none because the traces are too short."""
    if end != "error":
        return traces.n_steps
    h = traces.program.horizon
    assert h is not None
    if traces.n_steps <= h:
        raise TraceError(
            f"the traces have {traces.n_steps} samples; this formula needs {h + 1} (its horizon is {h}); give longer "
            f"ones, or {_CUT} to cut windows at the end of the trace, or {_HOLD} to hold the last sample"
        )
    return traces.n_steps - h


# ------------------------------------------------------------------------------------------- predicates without a value


def refuse_unknown(
    found: NDArray[Any], phi: Formula, traces: Traces, first_row: int, first_step: int, end: End
) -> None:
    """TraceError if the truth or margin at some step of a block does not exist."""
    if end == "hold" and traces.program.has_past:
        traces = traces.held(traces.program.settling)
    for row, step in np.argwhere(_unknown(found))[:1].tolist():
        _blame(phi, traces, first_row + row, first_step + step, end, margins=found.dtype == np.float64)


def _unknown(values: NDArray[Any]) -> NDArray[np.bool_]:
    """The entries without a margin, or without truth among −1, 0, 1."""
    if values.dtype == np.bool_:
        return np.zeros_like(values)
    unknown: NDArray[np.bool_] = np.isnan(values) if values.dtype == np.float64 else values == 0
    return unknown


def _blame(phi: Formula, traces: Traces, row: int, step: int, end: End, margins: bool) -> NoReturn:
    """Raise the error of a predicate because of which φ has no truth (or margin) at this step."""
    program = traces.program
    if isinstance(phi, Comparison):
        sample = {name: [float(array[row, step])] for name, array in traces.arrays.items()}
        latest, _ = program.reach(variables(phi))
        try:
            (oracle.robustness if margins else oracle.satisfies)(phi, sample)
        except TraceError as error:
            raise TraceError(f"{traces.place(row, step - latest)}: {error}") from None
    base = 0 if has_past(phi) else step
    rest = traces.row(row, base)
    for child, (a, b) in zip(children(phi), _looks(phi, rest.n_steps), strict=True):
        block = rest.block(slice(0, 1), slice(0, rest.n_steps), "hold" if end == "hold" else "cut")
        machine = Machine(replace(compile_formula(child), earlier=program.earlier), not margins, margins)
        unknown = _unknown(machine.run(block)[0])[0]
        first, last = max(step - base + a, 0), step - base + b
        if end == "hold":
            first, last = (min(bound, rest.n_steps - 1) for bound in (first, last))
        for at in np.flatnonzero(unknown[first : last + 1])[:1].tolist():
            _blame(child, traces, row, base + first + at, end, margins)
    raise AssertionError(f"{phi} has a value at {traces.place(row, step)}")


def _looks(phi: Formula, n: int) -> list[tuple[int, int]]:
    """For every operand, the first and the last step at which it is evaluated, of n, counted from now."""
    match phi:
        case Eventually(interval, _) | Always(interval, _):
            return [(interval.a, n if interval.b is None else interval.b)]
        case Until(interval, _, _) | Release(interval, _, _):
            b = n if interval.b is None else interval.b
            return [(0, b - 1), (interval.a, b)]
        case Once(interval, _) | Historically(interval, _):
            return [(-n if interval.b is None else -interval.b, -interval.a)]
        case Since(interval, _, _) | Trigger(interval, _, _):
            first = -n if interval.b is None else -interval.b
            return [(first + 1, 0), (first, -interval.a)]
        case Rise():
            return [(-1, 0)]
        case _:
            return [(0, 0)] * len(children(phi))
