"""Coverage of whatever tests judge: collected formula by formula, with events for Hypothesis, and as an assertion.

What is counted, and how, is in stltool/monitoring/coverage.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from hypothesis import currently_in_test_context, event
from numpy.typing import ArrayLike

from stltool.arguments import require, whole
from stltool.display import cut
from stltool.logic.formula import Formula, formula_of
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.monitoring.coverage import WIDTH, Coverage
from stltool.monitoring.samples import End
from stltool.testing.assertions import StlAssertionError
from stltool.testing.judged import LISTENERS


class CoverageReport(dict[str, Coverage]):
    """The coverage of every formula that was judged, by its text."""

    def note(self, phi: Formula | Task, signals: Mapping[str, ArrayLike], t: int, end: End) -> None:
        """Count a trace; in a test of Hypothesis also as events, which its statistics and observations show."""
        formula = formula_of(phi, "the formula")
        text = str(formula)
        if text not in self:
            self[text] = Coverage(formula)
        empty = self[text].add(signals, t, end=end)
        if not currently_in_test_context():
            return
        whole = cut(text, WIDTH)
        for premise in empty:
            event(f"{whole} passes vacuously: {cut(premise, WIDTH)} never holds")
        for part, is_premise, held, mattered in self[text].last:
            if is_premise:
                event(f"{whole}: steps at which the premise {cut(part, WIDTH)} held", held)
            if mattered:
                event(f"{whole}: {cut(part, WIDTH)} mattered")

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
