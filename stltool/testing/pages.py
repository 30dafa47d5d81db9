"""Pages of what a test found: of a trace that violates, of a probability out of its bound, of an expectation."""

from __future__ import annotations

from pathlib import Path

import stltool as stl
from stltool.errors import StlToolError
from stltool.gate import Verification, Verified
from stltool.logic.task import Task
from stltool.reporting import monitor_report, verification_data, write_report
from stltool.reporting.monitoring import monitor_data
from stltool.testing.assertions import ProbabilityViolation, TraceViolation


def write_expectation_page(found: Verified, path: Path) -> None:
    """The page that `stltool verify --report` writes, of one expectation. FileError if it cannot be written."""
    write_report(verification_data(Verification((found.path,), (found,), (), found.seconds)), path)


def write_failure_page(failure: BaseException, path: Path) -> bool:
    """A page about a failed assertion of stltool.testing; returns False for one that has none."""
    if isinstance(failure, ProbabilityViolation):
        stl.report([failure.result], None, path)
        return True
    if isinstance(failure, TraceViolation):
        found = failure.diagnosis
        task = Task("formula", found.formula)
        try:
            data = monitor_data(stl.monitor(found.formula, failure.signals, found.end), task, "trace", found.step)
        except StlToolError:  # a term without a value, such as 1/0, has no robustness to draw
            return False
        write_report(monitor_report(data, failure.signals, task), path)
        return True
    return False
