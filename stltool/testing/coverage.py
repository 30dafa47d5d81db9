"""How much judged traces say about a formula: premises that held, windows that closed, parts that mattered.

A trace on which no request comes satisfies `G[0,12] (request -> F[0,4] level > 3)`, and says nothing about the level:
it passes *vacuously*. `Coverage` counts that, trace by trace; `collect_coverage` does so for every formula that
assertions, recorders and machines judge while it is open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import currently_in_test_context, event
from numpy.typing import ArrayLike

from stltool.arguments import require, whole
from stltool.display import Card, Displayed, counted, cut
from stltool.errors import TraceError
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
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.monitoring import monitor
from stltool.monitoring.samples import End
from stltool.testing.assertions import StlAssertionError
from stltool.testing.judged import LISTENERS

MOST_PARTS = 64  # each is judged three times a trace
_WIDTH = 48

_Path = tuple[int, ...]


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
    """

    def __init__(self, phi: Formula | Task) -> None:
        self.formula: Formula = formula_of(phi, "Coverage's formula")
        found = list(_occurrences(self.formula))
        self.more = max(len(found) - MOST_PARTS, 0)
        self._found = found[:MOST_PARTS]
        self.traces = self.passed = self.vacuous = 0
        self.parts = [PartCoverage(str(part), premise) for _, part, _, _, premise in self._found]

    def _card(self) -> Card:
        columns = ("part", "premise", "held", "failed", "open", "mattered")
        rows = [(p.text, p.premise, p.held, p.failed, p.open, p.mattered) for p in self.parts]
        title = f"Coverage: {cut(str(self.formula), _WIDTH)}"
        return Card(title, [{"traces": self.traces, "passed": self.passed, "vacuous": self.vacuous}], (columns, rows))

    def add(self, signals: Mapping[str, ArrayLike], t: int = 0, *, end: End | None = None) -> list[str]:
        """Count a trace, judged at step t; returns the premises that held nowhere, if it passes.

        `end` as in `stl.monitor`; default: "error", or "cut" for a formula with an interval without end.
        """
        t = whole(t, "add's step t", least=0)
        end = end if end is not None else "error" if is_bounded(self.formula) else "cut"
        found = monitor(self.formula, signals, end, "boolean", at=t)
        assert found.verdicts is not None  # asked for
        verdict, n_steps = bool(found.verdicts[0]), found.n_steps
        empty = []
        for (path, part, first, last, premise), counts in zip(self._found, self.parts, strict=True):
            low = max(t + first, 0)
            high = max(n_steps - 1 if last is None else t + last, low - 1)
            decided = _decided(part, signals, end)[low : high + 1]
            held = int(decided.sum())
            counts.held += held
            counts.failed += len(decided) - held
            counts.open += high + 1 - low - len(decided)
            if premise and not held:
                empty.append(counts.text)
            counts.mattered += _matters(self.formula, path, signals, t, end, verdict)
        self.traces += 1
        self.passed += verdict
        self.vacuous += verdict and bool(empty)
        return empty if verdict else []

    def report(self, at_least: int = 1) -> str:
        """A table of the parts, and in words what the traces do not say, as in `gaps`."""
        vacuously = f", {self.vacuous} of them vacuously (a premise held nowhere)" if self.vacuous else ""
        lines = [str(self.formula), f"  {counted(self.traces, 'trace')}: {self.passed} passed{vacuously}"]
        texts = [cut(part.text, _WIDTH) + (" (premise)" if part.premise else "") for part in self.parts]
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


class CoverageReport(dict[str, Coverage]):
    """The coverage of every formula that was judged, by its text."""

    def note(self, phi: Formula | Task, signals: Mapping[str, ArrayLike], t: int, end: End) -> None:
        """Count a trace; in a test of Hypothesis also as an event, which its statistics and observations show."""
        formula = formula_of(phi, "the formula")
        text = str(formula)
        if text not in self:
            self[text] = Coverage(formula)
        empty = self[text].add(signals, t, end=end)
        if currently_in_test_context():
            for premise in empty:
                event(f"{cut(text, _WIDTH)} passes vacuously: {cut(premise, _WIDTH)} never holds")

    def merge(self, counts: Mapping[str, Sequence[Sequence[int]]]) -> None:
        """Add what another process counted: of each formula `Coverage.counts`."""
        for text, numbers in counts.items():
            if text not in self:
                self[text] = Coverage(parse(text, unbounded=True))
            self[text].merge(numbers)

    def report(self) -> str:
        """The reports of all formulas."""
        return "\n\n".join(coverage.report() for coverage in self.values())


@contextmanager
def collect_coverage() -> Iterator[CoverageReport]:
    """While it is open, whatever `assert_trace`, recorders and machines judge is counted, formula by formula."""
    found = CoverageReport()
    LISTENERS.append(found.note)
    try:
        yield found
    finally:
        LISTENERS.remove(found.note)


def assert_covered(coverage: Coverage, at_least: int = 1) -> None:
    """Every premise held at `at_least` steps, and every part mattered in as many traces; otherwise CoverageGap."""
    __tracebackhide__ = True
    require(coverage, Coverage, "assert_covered's coverage", "stl.testing.Coverage(phi)")
    at_least = whole(at_least, "assert_covered's at_least", least=1)
    if coverage.gaps(at_least):
        raise CoverageGap(f"traces do not test enough of {coverage.report(at_least)}")


class CoverageGap(StlAssertionError):
    """Traces do not say enough about a formula."""


def _times(count: int, what: str) -> str:
    """at no step, at 1 step, at 2 steps"""
    where = {"step": "at", "trace": "in"}[what]
    return f"{where} {counted(count, what)}" if count else f"{where} no {what}"


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


def _verdict(phi: Formula, signals: Mapping[str, ArrayLike], t: int, end: End) -> bool:
    found = monitor(phi, signals, end, "boolean", at=t).verdicts
    assert found is not None  # asked for
    return bool(found[0])


def _matters(phi: Formula, path: _Path, signals: Mapping[str, ArrayLike], t: int, end: End, verdict: bool) -> bool:
    """Whether a constant in place of a part changes the verdict."""
    for value in (False, True):
        try:
            if _verdict(_with(phi, path, Constant(value)), signals, t, end) is not verdict:
                return True
        except TraceError:  # a comparison without a value, such as 1/0, which the part kept from being asked
            continue
    return False


def _decided(part: Formula, signals: Mapping[str, ArrayLike], end: End) -> Any:
    """The verdicts of a part at the steps at which it has one."""
    read = {name: signals[name] for name in {**variables(part), **label_names(part)}}
    try:
        verdicts = monitor(part, read or signals, end, "boolean").verdicts
    except TraceError:  # too short for a single step, or without a value
        return np.zeros(0, bool)
    return verdicts
