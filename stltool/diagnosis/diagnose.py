"""Why a trace satisfies a formula at a step, or violates it: the samples that force it, and what they decide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import function, one_of, whole
from stltool.diagnosis.causes import Progress, find_cause
from stltool.diagnosis.knowledge import Knowledge, knowledge_of, names_of
from stltool.diagnosis.sentences import Reason, sentences, steps_text
from stltool.diagnosis.sheet import Sheet, Steps
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError, TraceError, named
from stltool.logic.formula import (
    Comparison,
    Constant,
    Eventually,
    Formula,
    Label,
    Once,
    Since,
    Until,
    children,
    formula_of,
    is_temporal,
    lookback,
)
from stltool.logic.names import written
from stltool.logic.printer import Text, with_names
from stltool.logic.quantities import Ticks
from stltool.logic.shifts import Delayed
from stltool.logic.task import Task
from stltool.monitoring.blocks import BlockEnd
from stltool.monitoring.offline import monitor, prepare
from stltool.monitoring.program import compile_delayed
from stltool.monitoring.samples import End, Traces

_CUT, _HOLD = named("end", 'end="cut"'), named("end", 'end="hold"')


class Sample(NamedTuple):
    """One sample of a trace."""

    signal: str
    step: int
    value: float | bool


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Displayed):
    """What decided a verdict. `print(diagnosis)` tells it in sentences.

    step, verdict   the step that was judged, and whether the formula holds there
    causes          the samples that force the verdict: for each signal its steps, (n,) int64 in ascending order. With
                    them fixed, every other sample may change freely
    doubt           None if the causes are minimal: no sample of them can be left out. Otherwise why some might
    reason          the sub-formulas, each with the steps at which it decided, as a tree
    by_cases        whether no single sub-formula decides, as with `a | !a`: the reason is then one of several, and not
                    from the causes alone
    ticks           steps as times, if the duration of a step is declared
    text            how formulas are written: with the names of a task file's definitions
    """

    formula: Formula
    step: int
    verdict: bool
    end: End
    causes: Mapping[str, NDArray[np.int64]]
    values: Mapping[str, NDArray[Any]]
    doubt: str | None
    reason: Reason
    by_cases: bool = False
    ticks: Ticks | None = None
    text: Text = str

    @property
    def minimal(self) -> bool:
        """Whether no sample of the causes can be left out."""
        return self.doubt is None

    @property
    def samples(self) -> list[Sample]:
        """The causes one by one, in order of time."""
        found = [
            Sample(name, step, value)
            for name, steps in self.causes.items()
            for step, value in zip(steps.tolist(), self.values[name].tolist(), strict=True)
        ]
        return sorted(found, key=lambda sample: (sample.step, sample.signal))

    @property
    def n_causes(self) -> int:
        """The number of samples in the causes."""
        return sum(map(len, self.causes.values()))

    @property
    def sentences(self) -> list[str]:
        """The reason, outside in; operands are indented by two spaces."""
        return sentences(self.reason, self.ticks, self.text)

    @property
    def summary(self) -> str:
        """The causes in one line."""
        told = ", ".join(f"{name} {steps_text(steps, self.ticks)}" for name, steps in self.causes.items() if len(steps))
        if not told:
            return "none: the verdict is the same on every trace"
        how = "a minimal set" if self.minimal else "sufficient, perhaps not minimal"
        return f"{told} ({counted(self.n_causes, 'sample')}, {how})"

    def __str__(self) -> str:
        return "\n".join([*self.sentences, f"causes: {self.summary}"])

    def _card(self) -> Card:
        return Card(
            f"Diagnosis: {'holds' if self.verdict else 'fails'} at step {self.step}, {counted(self.n_causes, 'cause')}",
            [{"formula": self.formula}, {"because": self.sentences[-1].strip(), "doubt": self.doubt}],
        )


def diagnose(
    phi: Formula | Task,
    signals: Mapping[str, ArrayLike],
    t: int = 0,
    *,
    end: End = "error",
    progress: Progress | None = None,
) -> Diagnosis:
    """Why one trace satisfies or violates φ at step t.

    `signals` maps every name of φ to an array (n_steps,), and `end` is that of `monitor`. The causes are the
    colexicographically least minimal set (stltool/diagnosis/causes.py): its latest sample is as early as possible.
    Where neither Kleene's evaluation nor an automaton is exact, it may be another minimal set, or one with a `doubt`.
    `progress(done, total)` is called while they are sought, if that takes more than half a second.

    Raises what `monitor` raises, SettingsError if step t is not judged, and TraceError if the verdict depends on a
    term without a value.
    """
    one_of(end, "end", get_args(End))
    t = whole(t, "diagnose's step t", least=0)
    function(progress, "diagnose's progress")
    formula, traces, beyond = prepare(phi, signals, end, "diagnose")
    if traces.batch:
        raise TraceError("diagnose explains one trace, (n_steps,); give one row of the batch, as in {'x': x[3]}")
    given = formula_of(phi, "diagnose's formula")
    made = compile_delayed(given)[0]
    first, knowledge, real = _around(formula, traces, t, end, beyond, made)
    everything = np.ones((knowledge.block.steps, len(knowledge.names)), dtype=np.bool_)
    whole_sheet = Sheet(knowledge, everything)
    at = t - first
    value = int(whole_sheet[formula][at])
    if value == 0:
        monitor(given, signals, end, "boolean", t)  # raises
        raise TraceError(f"step {t}: the verdict depends on a term without a value")
    held = real < knowledge.block.steps
    cause = find_cause(knowledge, at, value > 0, real - 1 if held else None, progress)
    sheet = Sheet(knowledge, cause.kept)
    by_cases = int(sheet[formula][at]) == 0
    root = np.zeros(knowledge.block.steps, dtype=np.bool_)
    root[at] = True
    kept = cause.kept[:real]
    story = _Story(whole_sheet if by_cases else sheet, traces, first, end)
    steps = {name: first + np.flatnonzero(column) for name, column in zip(knowledge.names, kept.T, strict=True)}
    values = {name: traces.arrays[name][0, found] for name, found in steps.items()}
    doubt, text = cause.doubt, with_names(phi.formulas, phi.ticks) if isinstance(phi, Task) else str
    if made.starts or made.signals:
        steps = _read_at(made, steps, traces.n_steps - beyond)
        values = {name: np.asarray(signals[name])[found] for name, found in steps.items()}
        text = _unquoted(text, made)
        read = [made.signals.get(name, (name, 0))[0] for name in knowledge.names if name not in made.starts]
        if doubt is None and len(set(read)) < len(read):
            doubt = "comparisons read several steps, whose samples were taken for independent ones"
    return Diagnosis(
        given,
        t,
        value > 0,
        end,
        steps,
        values,
        doubt,
        story.tell(formula, root, value),
        by_cases,
        phi.ticks if isinstance(phi, Task) else None,
        text,
    )


def _unquoted(text: Text, made: Delayed) -> Text:
    """A writer to which earlier samples are no names in quotes."""

    def told(phi: Formula) -> str:
        found = text(phi)
        for name in (*made.signals, *made.starts):
            found = found.replace(written(name), name)
        return found

    return told


def _read_at(made: Delayed, steps: Mapping[str, NDArray[np.int64]], n: int) -> dict[str, NDArray[np.int64]]:
    """The samples themselves, given those of signals that hold earlier ones; n samples are not held."""
    found: dict[str, set[int]] = {}
    for name, at in steps.items():
        if name not in made.starts:
            base, back = made.signals.get(name, (name, 0))
            found.setdefault(base, set()).update(np.clip(at - back, 0, n - 1).tolist())
    return {name: np.array(sorted(at), dtype=np.int64) for name, at in sorted(found.items())}


def _around(
    formula: Formula, traces: Traces, t: int, end: End, beyond: int, made: Delayed
) -> tuple[int, Knowledge, int]:
    """The part of the trace on which the verdict at t depends: its first step, what is known there, and its length.

    If samples are held for operators of the past, the block is longer than that.
    """
    h, n = traces.program.horizon, traces.n_steps
    judged = n - beyond if end != "error" or h is None else n - h
    if t >= judged:
        advice = f", or {_CUT} or {_HOLD}" if end == "error" else ""
        raise SettingsError(
            f"step {t} is not judged: the trace has {n - beyond} samples, and the horizon is {h}; give one of the "
            f"steps 0 … {judged - 1}, or a longer trace{advice}"
        )
    stop = n if h is None else min(t + h + 1, n)
    whole_windows = h is not None and t + h < n
    kind: BlockEnd = "open" if whole_windows else "hold" if end == "hold" else "cut"
    back, held = lookback(formula), 0
    first = max(t - back, 0) if back is not None else 0
    if kind == "hold" and traces.program.has_past:  # the past of held samples changes until they fill its windows
        held = traces.program.settling
        traces = traces.held(held)
    block = traces.block(slice(0, 1), slice(first, stop + held), kind)
    return first, knowledge_of(formula, block, made.starts), stop - first


class _Story:
    """The reason of a value, from the values that a sheet knows."""

    def __init__(self, sheet: Sheet, traces: Traces, first: int, end: End) -> None:
        self.sheet, self.traces, self.first, self.end = sheet, traces, first, end

    def tell(self, phi: Formula, steps: Steps, value: int) -> Reason:
        """Why φ has this value at these steps."""
        needed = self.sheet.decisive(phi, steps, value)
        covered = np.zeros_like(steps)
        for part in needed:
            covered |= part.steps
        if not is_temporal(phi) and not (covered[steps].all() and needed):
            return self._leaf(phi, steps, value)
        operands = children(phi)
        parts = []
        for part in needed:
            told = self.tell(operands[part.operand], part.steps, part.value)
            if value == -1 and part.value == -1 and _awaits(phi, part.operand):
                told = told.between(*self._neighbours(operands[part.operand], told.steps))
            parts.append(told)
        return Reason(phi, value > 0, self.first + np.flatnonzero(steps), tuple(parts))

    def _leaf(self, phi: Formula, steps: Steps, value: int) -> Reason:
        where = np.unique(np.minimum(self.first + np.flatnonzero(steps), self.traces.n_steps - 1))  # some may be held
        values = {name: self.traces.arrays[name][0, where] for name in names_of(phi)}
        known = isinstance(phi, Constant | Label | Comparison)
        return Reason(phi, value > 0, where, (), values if known else {})

    def _neighbours(self, phi: Formula, steps: NDArray[np.int64]) -> tuple[int | None, int | None, tuple[bool, bool]]:
        """The last step before and the first after `steps` at which φ holds, and whether either is decided."""
        read = {name: self.traces.arrays[name][0] for name in names_of(phi)}
        try:
            verdicts = monitor(phi, read, self.end, "boolean").verdicts
        except TraceError:  # a term without a value somewhere
            return None, None, (False, False)
        assert verdicts is not None  # asked for
        before, after = np.flatnonzero(verdicts[: steps[0]]), np.flatnonzero(verdicts[steps[-1] + 1 :])
        return (
            int(before[-1]) if len(before) else None,
            int(steps[-1]) + 1 + int(after[0]) if len(after) else None,
            (True, len(verdicts) == self.traces.n_steps),
        )


def _awaits(phi: Formula, operand: int) -> bool:
    """Whether the operator fails because this operand does not come."""
    return isinstance(phi, Eventually | Once) or (isinstance(phi, Until | Since) and operand == 1)
