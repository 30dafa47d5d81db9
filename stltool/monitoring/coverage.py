"""How much judged traces say about a formula: premises that held, windows that closed, parts that mattered.

A trace on which no request comes satisfies `G[0,12] (request -> F[0,4] level > 3)`, and says nothing about the level:
it passes *vacuously*. `Coverage` counts that, trace by trace; `expect cover(…)` lines of task files ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import flag, whole
from stltool.display import Card, Displayed, counted, cut
from stltool.errors import NameLookupError, TraceError
from stltool.logic.expectation import Expectation, Measure
from stltool.logic.formula import (
    Always,
    Constant,
    Eventually,
    Formula,
    Historically,
    Implies,
    Interval,
    Once,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    formula_of,
    is_bounded,
    label_names,
    variables,
    with_children,
)
from stltool.logic.task import Task
from stltool.monitoring.offline import monitor
from stltool.monitoring.samples import End

MOST_PARTS = 64  # each is judged three times a trace
WIDTH = 48

_Path = tuple[int, ...]
_OF_A_PART: dict[str, Callable[[PartCoverage], int]] = {
    "held": lambda part: part.held, "failed": lambda part: part.failed, "mattered": lambda part: part.mattered,
    "closed": lambda part: part.held + part.failed,
}  # fmt: skip


@dataclass
class PartCoverage:
    """What traces say about a part of a formula: an occurrence of a sub-formula.

    premise   whether it is the left side of an implication
    held, failed   the steps at which it did, of those that the formula looks at, over all traces
    open      those at which it is not decided, since its window does not close before the end of the trace
    mattered  the traces whose verdict would be another one with a constant in its place
    """

    text: str
    premise: bool
    held: int = 0
    failed: int = 0
    open: int = 0
    mattered: int = 0


class Coverage(Displayed):
    """What traces say about a formula: `add` each of them; `print(coverage.report())`.

    traces, passed   their number, and the number of those that satisfy it
    vacuous          of these, those on which a premise held at no step that the formula looks at
    parts            outside in, without the whole; of a formula with many, the first 64 (`more` counts the others)
    last             of the last trace, for each part: its text, whether it is a premise, the steps at which it held,
                     whether it mattered
    """

    def __init__(self, phi: Formula | Task) -> None:
        self.formula: Formula = formula_of(phi, "Coverage's formula")
        found = list(_occurrences(self.formula))
        self.more = max(len(found) - MOST_PARTS, 0)
        self._found = found[:MOST_PARTS]
        self.traces = self.passed = self.vacuous = 0
        self.last: tuple[tuple[str, bool, int, bool], ...] = ()
        self.parts = [PartCoverage(str(part), premise) for _, part, _, _, premise in self._found]

    def _card(self) -> Card:
        columns = ("part", "premise", "held", "failed", "open", "mattered")
        rows = [(p.text, p.premise, p.held, p.failed, p.open, p.mattered) for p in self.parts]
        title = f"Coverage: {cut(str(self.formula), WIDTH)}"
        return Card(title, [{"traces": self.traces, "passed": self.passed, "vacuous": self.vacuous}], (columns, rows))

    def add(
        self, signals: Mapping[str, ArrayLike], t: int = 0, *, end: End | None = None, every: bool = False
    ) -> list[str]:
        """Count a trace, judged at step t; returns the premises that held nowhere, if it passes.

        end     as in `stl.monitor`; default: "error", or "cut" for a formula with an interval without end
        every   judge every step at which there is a verdict, as `stltool monitor` does: the trace passes if all hold
        """
        t = whole(t, "add's step t", least=0)
        flag(every, "add's every")
        end = end if end is not None else "error" if is_bounded(self.formula) else "cut"
        at = None if every else t
        found = monitor(self.formula, signals, end, "boolean", at=at)
        assert found.verdicts is not None  # asked for
        verdicts, n_steps = found.verdicts, found.n_steps
        start, stop = (0, len(verdicts) - 1) if every else (t, t)
        empty, events = [], []
        for (path, part, first, last, premise), counts in zip(self._found, self.parts, strict=True):
            low = max(start + first, 0)
            high = max(n_steps - 1 if last is None else stop + last, low - 1)
            decided = _decided(part, signals, end)[low : high + 1]
            held = int(decided.sum())
            counts.held += held
            counts.failed += len(decided) - held
            counts.open += high + 1 - low - len(decided)
            if premise and not held:
                empty.append(counts.text)
            mattered = _matters(self.formula, path, signals, at, end, verdicts)
            counts.mattered += mattered
            events.append((counts.text, premise, held, mattered))
        passed = bool(verdicts.all())
        self.traces += 1
        self.passed += passed
        self.vacuous += passed and bool(empty)
        self.last = tuple(events)
        return empty if passed else []

    def add_all(
        self, signals: Mapping[str, ArrayLike], t: int = 0, *, end: End | None = None, every: bool = False
    ) -> None:
        """Count each trace of a batch, or the only one."""
        for one in _each(signals):
            self.add(one, t, end=end, every=every)

    def count(self, expectation: Expectation) -> int:
        """What an `expect cover(…)` line compares with its bound.

        A part that occurs several times counts where it is covered least (of bounds from above: most).
        """
        measure, part = expectation.measure, expectation.part
        assert measure is not None
        if part is None or part == self.formula:
            numbers: dict[Measure, list[int]] = {
                "held": [self.passed], "failed": [self.traces - self.passed], "vacuous": [self.vacuous],
                "premises": [p.held for p in self.parts if p.premise], "parts": [p.mattered for p in self.parts],
            }  # fmt: skip
            found = numbers[measure]
        else:
            places = [p for (_, one, *_), p in zip(self._found, self.parts, strict=True) if one == part]
            found = [_OF_A_PART[measure](place) for place in places]
        if not found:
            raise NameLookupError(
                f"{expectation.asked}: {'nothing' if self.more == 0 else 'none of the first 64 parts'} is counted; "
                "write cover with a part of the formula"
            )
        return min(found) if expectation.relation in (">=", ">") else max(found)

    def report(self, at_least: int = 1) -> str:
        """A table of the parts, and in words what the traces do not say, as in `gaps`."""
        vacuously = f", {self.vacuous} of them vacuously (a premise held nowhere)" if self.vacuous else ""
        lines = [str(self.formula), f"  {counted(self.traces, 'trace')}: {self.passed} passed{vacuously}"]
        texts = [cut(part.text, WIDTH) + (" (premise)" if part.premise else "") for part in self.parts]
        width = max(map(len, texts), default=0)
        lines.append(f"  {'part':{width}}     held   failed     open  mattered")
        for text, part in zip(texts, self.parts, strict=True):
            lines.append(f"  {text:{width}} {part.held:8} {part.failed:8} {part.open:8} {part.mattered:9}")
        if self.more:
            lines.append(f"  and {counted(self.more, 'part')} more")
        return "\n".join([*lines, *(f"  {gap}" for gap in self.gaps(at_least))])

    def gaps(self, at_least: int = 1) -> list[str]:
        """What the traces do not say: premises that held at too few steps, parts that mattered in too few traces."""
        told = []
        for part in self.parts:
            if part.premise and part.held < at_least:
                told.append(f"the premise {part.text} held {_times(part.held, 'step')}")
            if part.mattered < at_least:
                told.append(f"{part.text} mattered {_times(part.mattered, 'trace')}")
        return told

    # ------------------------------------------------------------------------------- between processes

    def counts(self) -> list[list[int]]:
        """The numbers alone, to be added to those of another process."""
        return [[self.traces, self.passed, self.vacuous], *([p.held, p.failed, p.open, p.mattered] for p in self.parts)]

    def merge(self, counts: Sequence[Sequence[int]]) -> None:
        """Add the counts of the same formula."""
        traces, passed, vacuous = counts[0]
        self.traces, self.passed, self.vacuous = self.traces + traces, self.passed + passed, self.vacuous + vacuous
        for part, (held, failed, unknown, mattered) in zip(self.parts, counts[1:], strict=True):
            part.held, part.failed = part.held + held, part.failed + failed
            part.open, part.mattered = part.open + unknown, part.mattered + mattered


def _times(count: int, what: str) -> str:
    """at no step, at 1 step, at 2 steps"""
    where = {"step": "at", "trace": "in"}[what]
    return f"{where} {counted(count, what)}" if count else f"{where} no {what}"


def idle_premises(phi: Formula, signals: Mapping[str, ArrayLike]) -> list[str]:
    """The premises of φ, judged at step 0, that hold at no step of any trace of a batch (or of the only one)."""
    end: End = "error" if is_bounded(phi) else "cut"
    idle = []
    for _, part, first, last, premise in _occurrences(phi):
        if not premise:
            continue
        low, high = max(first, 0), None if last is None else last + 1
        if not any(_decided(part, one, end)[low:high].any() for one in _each(signals)):
            idle.append(str(part))
    return idle


def _each(signals: Mapping[str, ArrayLike]) -> Iterator[Mapping[str, ArrayLike]]:
    """The traces of a batch, or the only one."""
    columns = {name: np.asarray(values) for name, values in signals.items()}
    rows = [len(values) for values in columns.values() if values.ndim == 2]
    if not rows:
        yield columns
    for row in range(max(rows, default=0)):
        yield {name: values[row] for name, values in columns.items()}


# ------------------------------------------------------------------------------------------------------------- parts


def _occurrences(phi: Formula) -> Iterator[tuple[_Path, Formula, int, int | None, bool]]:
    """Every part below the root, outside in: its place, itself, the steps at which it is looked at, whether a premise.

    The steps are counted from the one at which φ is judged; a last step of None is the end of the trace.
    """
    stack: list[tuple[_Path, Formula, int, int | None, bool]] = [((), phi, 0, 0, False)]
    while stack:
        path, node, first, last, premise = stack.pop()
        if path and not isinstance(node, Constant):
            yield path, node, first, last, premise
        below = []
        for i, child in enumerate(children(node)):
            low, high = _looked_at(node, i, first, last)
            below.append(((*path, i), child, low, high, isinstance(node, Implies) and i == 0))
        stack += reversed(below)


def _looked_at(node: Formula, operand: int, first: int, last: int | None) -> tuple[int, int | None]:
    """The steps at which an operand is looked at, of an operator that is looked at from `first` to `last`."""
    match node:
        case Eventually(interval, _) | Always(interval, _):
            return first + interval.a, _sum(last, interval.b)
        case Until(interval, _, _) | Release(interval, _, _):
            return (first + interval.a, _sum(last, interval.b)) if operand else (first, _sum(last, interval.b, -1))
        case Once(interval, _) | Historically(interval, _):
            return first - _back(interval), _sum(last, -interval.a)
        case Since(interval, _, _) | Trigger(interval, _, _):
            return (
                (first - _back(interval), _sum(last, -interval.a)) if operand else (first - _back(interval) + 1, last)
            )
        case Rise():
            return first - 1, last
        case _:
            return first, last


def _sum(*steps: int | None) -> int | None:
    """None is the end of the trace."""
    known = [step for step in steps if step is not None]
    return sum(known) if len(known) == len(steps) else None


def _back(interval: Interval) -> int:
    return interval.b if interval.b is not None else 10**9  # steps before the trace do not count


def _with(phi: Formula, path: _Path, part: Formula) -> Formula:
    if not path:
        return part
    below = list(children(phi))
    below[path[0]] = _with(below[path[0]], path[1:], part)
    return with_children(phi, tuple(below))


def _matters(
    phi: Formula, path: _Path, signals: Mapping[str, ArrayLike], at: int | None, end: End, verdicts: NDArray[np.bool_]
) -> bool:
    """Whether a constant in place of a part changes a verdict."""
    for value in (False, True):
        try:
            found = monitor(_with(phi, path, Constant(value)), signals, end, "boolean", at=at).verdicts
        except TraceError:  # a comparison without a value, such as 1/0, which the part kept from being asked
            continue
        assert found is not None  # asked for
        if not np.array_equal(found[: len(verdicts)], verdicts):  # without the part more steps may be decided
            return True
    return False


def _decided(part: Formula, signals: Mapping[str, ArrayLike], end: End) -> Any:
    """The verdicts of a part at the steps at which it has one."""
    read = {name: signals[name] for name in {**variables(part), **label_names(part)}}
    try:
        verdicts = monitor(part, read or signals, end, "boolean").verdicts
    except TraceError:  # too short for a single step, or without a value
        return np.zeros(0, bool)
    return verdicts
