"""Diagnoses, and where the parts of a formula hold, as plain data in which definitions keep their names."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from stltool.diagnosis import Diagnosis, Reason
from stltool.diagnosis.sentences import ranges_of
from stltool.logic.printer import Text, with_names
from stltool.logic.task import Task
from stltool.monitoring.parts import part_verdicts
from stltool.monitoring.samples import End
from stltool.reporting.records import CauseRecord, DiagnosisRecord, ReasonRecord, SubformulaRecord

PARTS = 12  # of a formula that are shown


def diagnosis_data(found: Diagnosis, trace: int | None = None) -> DiagnosisRecord:
    """Causes, the tree of reasons and its sentences; `trace` is the number of the trace in a batch."""
    causes: list[CauseRecord] = []
    for name, steps in found.causes.items():
        cause: CauseRecord = {"signal": name, "steps": steps.tolist(), "values": found.values[name].tolist()}
        if found.ticks is not None:
            cause["times"] = [found.ticks.number(step) for step in steps.tolist()]
        if len(steps):
            causes.append(cause)
    return {
        "trace": trace,
        "step": found.step,
        "verdict": found.verdict,
        "time": found.ticks.number(found.step) if found.ticks is not None else None,
        "unit": found.ticks.unit if found.ticks is not None else None,
        "sentences": found.sentences,
        "summary": found.summary,
        "causes": causes,
        "minimal": found.minimal,
        "doubt": found.doubt,
        "by_cases": found.by_cases,
        "reason": _reason_data(found.reason, found.text),
    }


def subformulas_data(signals: Mapping[str, ArrayLike], task: Task, end: End) -> tuple[list[SubformulaRecord], int]:
    """Where the first parts of a formula hold on one trace, and how many more there are."""
    found, more = part_verdicts(task.formula, signals, end, PARTS)
    text = with_names(task.formulas, task.ticks)
    parts: list[SubformulaRecord] = []
    for part in found:
        held = None if part.verdicts is None else ranges_of(np.flatnonzero(part.verdicts))
        parts.append({
            "formula": text(part.formula),
            "judged": 0 if part.verdicts is None else len(part.verdicts),
            "holds": None if held is None else [[first, last] for first, last in held],
        })  # fmt: skip
    return parts, more


def _reason_data(reason: Reason, text: Text) -> ReasonRecord:
    return {
        "formula": text(reason.formula),
        "holds": reason.holds,
        "steps": [[first, last] for first, last in ranges_of(reason.steps)],
        "parts": [_reason_data(part, text) for part in reason.parts],
        "awaited": reason.awaited,
        "last": reason.last,
        "next": reason.next,
    }


def diagnosis_lines(data: DiagnosisRecord) -> list[str]:
    """The terminal's lines."""
    lines = ["why", *(f"  {line}" for line in data["sentences"]), f"causes  {data['summary']}"]
    if data["doubt"] is not None:
        lines.append(f"        perhaps not minimal: {data['doubt']}")
    if data["by_cases"]:
        lines.append("        no single part decides: with other samples, other parts would")
    return lines
