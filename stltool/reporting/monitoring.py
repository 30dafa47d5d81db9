"""Monitored traces as plain data and as the terminal's tables; as a picture by `monitor_figure`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from stltool.display import counted
from stltool.errors import SettingsError
from stltool.files import write_result
from stltool.gate import Verified
from stltool.logic.quantities import Ticks
from stltool.logic.task import Task
from stltool.monitoring.coverage import Coverage
from stltool.monitoring.offline import MonitorResult
from stltool.reporting.records import CoverageRecord, MonitorRecord, Robustness, TraceRecord
from stltool.reporting.tradeoffs import require_picture

PICTURES = (".png", ".svg", ".pdf")
_RANGES, _TRACES = 5, 20  # rows of the terminal's tables


def monitor_data(
    result: MonitorResult, task: Task, trace: str | Path, at: int | None = None, clock: str | None = None
) -> MonitorRecord:
    """Verdicts and robustness of all judged steps, or only of step `at`, with a summary.

    For a batch, `verdicts` and `robustness` are lists of lists, the other figures are over all traces, and `each` has
    them trace by trace. `clock` says what was done with the trace's times. Raises SettingsError if `at` is not a judged
    step.
    """
    whole = both(result)
    judged = whole[0].shape[-1]
    if at is not None and not 0 <= at < judged:
        longer = "" if result.end != "error" else "; --end cut or hold judges every step of the trace"
        raise SettingsError(f"--at {at}: steps 0 … {judged - 1} of these {result.n_steps} samples are judged{longer}")
    start, stop = (0, judged) if at is None else (at, at + 1)
    verdicts, robustness = (np.atleast_2d(values)[:, start:stop] for values in whole)
    ticks = task.ticks
    each = [_figures(*rows, start, ticks) for rows in zip(verdicts, robustness, strict=True)]
    batch = whole[0].ndim == 2
    total = _totals(each, ticks) if batch else each[0]
    data: MonitorRecord = {
        "task": task.name if task.path is not None else None,
        "formula": str(task.formula),
        "trace": str(trace),
        "traces": len(each) if batch else None,
        "samples": result.n_steps,
        "horizon": result.horizon,
        "end": result.end,
        "at": at,
        "unit": ticks.unit if ticks is not None else None,
        "step": ticks.number(1) if ticks is not None else None,
        "clock": clock,
        "judged": stop - start,
        "verdict": total["verdict"],
        "holds": total["holds"],
        "violations": total["violations"],
        "first_violation": total["first_violation"],
        "first_violation_time": total["first_violation_time"],
        "least_robustness": total["least_robustness"],
        "least_robustness_at": total["least_robustness_at"],
        "least_robustness_time": total["least_robustness_time"],
        "verdicts": verdicts.tolist() if batch else verdicts[0].tolist(),
        "robustness": [jsonable(row) for row in robustness] if batch else list(jsonable(robustness[0])),
    }
    if batch:
        data["violating_traces"] = sum(not figures["holds"] for figures in each)
        data["each"] = each
    return data


def coverage_data(coverage: Coverage, expected: Sequence[Verified]) -> CoverageRecord:
    """What traces say about a formula, and whether that is as much as the task file expects."""
    return {
        "traces": coverage.traces,
        "passed": coverage.passed,
        "vacuous": coverage.vacuous,
        "parts": [
            {"part": part.text, "premise": part.premise, "held": part.held, "failed": part.failed, "open": part.open,
             "mattered": part.mattered}
            for part in coverage.parts
        ],
        "more": coverage.more,
        "gaps": coverage.gaps(),
        "expectations": [
            {"text": one.expectation.written, "count": one.count or 0, "verdict": one.verdict} for one in expected
        ],
    }  # fmt: skip


def coverage_content(data: CoverageRecord) -> dict[str, Any]:
    """What a page shows of it: a sentence, and the rows of two tables."""
    vacuously = f", {data['vacuous']} of them vacuously (a premise held nowhere)" if data["vacuous"] else ""
    rows = [
        {
            "part": one["part"] + (" (premise)" if one["premise"] else ""),
            "held": str(one["held"]), "failed": str(one["failed"]), "open": str(one["open"]),
            "mattered": str(one["mattered"]),
        }
        for one in data["parts"]
    ]  # fmt: skip
    lead = f"{counted(data['traces'], 'trace')}: {data['passed']} passed{vacuously}."
    return {"lead": lead, "rows": rows, "counted": counted_rows(data)}


def counted_rows(data: CoverageRecord) -> list[dict[str, str]]:
    """The rows of the terminal's table of expectations."""
    return [
        {"verdict": one["verdict"], "expectation": one["text"].removeprefix("expect "), "counted": str(one["count"])}
        for one in data["expectations"]
    ]


def files_data(parts: Sequence[MonitorRecord], task: Task) -> MonitorRecord:
    """Several files' data, each made by `monitor_data`, as those of a batch, whose traces may differ in length."""
    each: list[TraceRecord] = []
    verdicts: list[Any] = []
    robustness: list[Any] = []
    for part in parts:
        batch = part["traces"] is not None
        verdicts += part["verdicts"] if batch else [part["verdicts"]]
        robustness += part["robustness"] if batch else [part["robustness"]]
        for number, figures in enumerate(part["each"] if batch else [_only(part)]):
            each.append({
                **figures,
                "file": f"{part['trace']}, trace {number}" if batch else part["trace"],
                "samples_there": part["samples"], "judged_there": part["judged"], "clock_there": part["clock"],
            })  # fmt: skip
    clocks = {part["clock"] for part in parts}
    totals = _totals(each, task.ticks)
    return {
        **parts[0],
        **totals,
        "trace": f"{len(parts)} files",
        "traces": len(each),
        "samples": max(part["samples"] for part in parts),
        "judged": max(part["judged"] for part in parts),
        "clock": parts[0]["clock"] if len(clocks) == 1 else "differs from file to file; --json has it for each",
        "verdicts": verdicts,
        "robustness": robustness,
        "violating_traces": sum(not figures["holds"] for figures in each),
        "each": each,
    }


def _only(data: MonitorRecord) -> TraceRecord:
    """The figures of a single trace."""
    return {
        "verdict": data["verdict"],
        "holds": data["holds"],
        "violations": data["violations"],
        "first_violation": data["first_violation"],
        "first_violation_time": data["first_violation_time"],
        "least_robustness": data["least_robustness"],
        "least_robustness_at": data["least_robustness_at"],
        "least_robustness_time": data["least_robustness_time"],
    }


def both(result: MonitorResult) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Verdicts and robustness; SettingsError if only one of them was requested."""
    if result.verdicts is None or result.robustness is None:
        raise SettingsError('verdicts and robustness are both needed; monitor with semantics="both"')
    return result.verdicts, result.robustness


def _figures(
    verdicts: NDArray[np.bool_], robustness: NDArray[np.float64], start: int, ticks: Ticks | None
) -> TraceRecord:
    """A summary of the judged steps of one trace, which are counted from `start`."""
    violations = np.flatnonzero(~verdicts)
    least = int(robustness.argmin())
    first = start + int(violations[0]) if len(violations) else None
    return {
        "verdict": bool(verdicts[0]),
        "holds": not len(violations),
        "violations": len(violations),
        "first_violation": first,
        "first_violation_time": _time(first, ticks),
        "least_robustness": jsonable(robustness[least : least + 1])[0],
        "least_robustness_at": start + least,
        "least_robustness_time": _time(start + least, ticks),
    }


def _time(step: int | None, ticks: Ticks | None) -> float | None:
    return ticks.number(step) if step is not None and ticks is not None else None


def _totals(each: list[TraceRecord], ticks: Ticks | None) -> TraceRecord:
    violated = [first for figures in each if (first := figures["first_violation"]) is not None]
    least = min(each, key=lambda figures: float(figures["least_robustness"]))
    return {
        "verdict": all(figures["verdict"] for figures in each),
        "holds": not violated,
        "violations": sum(figures["violations"] for figures in each),
        "first_violation": min(violated, default=None),
        "first_violation_time": _time(min(violated, default=None), ticks),
        "least_robustness": least["least_robustness"],
        "least_robustness_at": least["least_robustness_at"],
        "least_robustness_time": least["least_robustness_time"],
    }


def jsonable(values: NDArray[np.float64]) -> list[Robustness]:
    """JSON has no infinity: "inf" and "-inf" stand for it."""
    if np.isfinite(values).all():
        return values.tolist()  # type: ignore[no-any-return]
    return [value if math.isfinite(value) else "inf" if value > 0 else "-inf" for value in values.tolist()]


# ------------------------------------------------------------------------------------------------------------ tables


def monitor_facts(data: MonitorRecord) -> dict[str, str]:
    """The terminal's first lines: what was judged, and the result."""
    judged, at, traces = data["judged"], data["at"], data["traces"]
    horizon = "none: an interval has no end" if data["horizon"] is None else f"{data['horizon']}"
    if data["horizon"]:
        horizon += beside(data, data["horizon"])
    facts = {
        "task": f"{data['task']} := {data['formula']}" if data["task"] is not None else data["formula"],
        "trace": f"{data['trace']}, {_samples_text(data)}",
        "clock": data["clock"] or "",
        "horizon": horizon + _ENDS[data["end"]],
        "judged": f"step {at}{beside(data, at)}" if at is not None else _judged_text(data),
    }
    if data["clock"] is None:
        del facts["clock"]
    if traces is not None:
        kept = traces - data["violating_traces"]
        facts["holds"] = f"for {kept} of {_count(traces, 'trace')}" + ("" if at is not None else " at every step")
        if at is None:
            steps = sum(figures.get("judged_there", judged) for figures in data["each"])
            facts["violated"] = f"at {data['violations']} of {steps} steps"
    else:
        facts[f"step {at or 0}"] = _verdict(data["verdict"])
        if at is None:
            facts["violated"] = "at no step"
            if not data["holds"]:
                facts["violated"] = (
                    f"at {data['violations']} of {judged} steps, first at step {data['first_violation']}"
                    f"{beside(data, data['first_violation'])}"
                )
    facts["robustness"] = robustness_text(data["least_robustness"])
    if at is None:
        least = data["least_robustness_at"]
        facts["robustness"] += f" at step {least}{beside(data, least)}, the least"
    return facts


def _judged_text(data: MonitorRecord) -> str:
    """The steps that were judged; of files of several lengths, of how many at least and at most."""
    last = data["judged"] - 1
    text = f"{_count(data['judged'], 'step')}, 0 … {last}{beside(data, 0, last)}"
    least = min((figures.get("judged_there", last + 1) for figures in data.get("each", [])), default=last + 1)
    return text if least == last + 1 else f"{text} at most, {_count(least, 'step')} at least"


def _samples_text(data: MonitorRecord) -> str:
    """How many samples were judged: 251 samples, of a batch 251 samples × 3 traces, of files 101 to 251 samples."""
    if data["traces"] is None:
        return _count(data["samples"], "sample")
    lengths = {figures.get("samples_there", data["samples"]) for figures in data["each"]}
    if len(lengths) > 1:
        return f"{data['traces']} traces of {min(lengths)} to {max(lengths)} samples"
    return f"{_count(data['samples'], 'sample')} × {data['traces']} traces"


def trace_name(data: MonitorRecord, shown: int) -> str:
    """A trace of a batch: its number, or its file."""
    return data["each"][shown].get("file") or f"trace {shown}"


def step_time(data: MonitorRecord, step: int) -> str | None:
    """The time of a step, such as 13.2 s; None if the duration of a step is not declared."""
    return f"{step * data['step']:.12g} {data['unit']}" if data["step"] is not None else None


def beside(data: MonitorRecord, *steps: int | None) -> str:
    """The times of steps in brackets, to stand behind them; empty if they have none."""
    if data["step"] is None or None in steps:
        return ""
    times = [step_time(data, step) or "" for step in steps if step is not None]
    return f" ({' … '.join(times)})"


_ENDS = {
    "error": "",
    "cut": "; windows are cut at the end of the trace",
    "hold": "; the last sample is held at the end of the trace",
}


def range_rows(data: MonitorRecord) -> tuple[list[dict[str, Any]], int]:
    """The first ranges of steps that one trace violates, and how many more there are."""
    robustness = np.array(data["robustness"], dtype=np.float64)
    ranges = true_ranges(~np.array(data["verdicts"], dtype=np.bool_))
    rows = []
    for first, stop in ranges[:_RANGES].tolist():
        least = first + int(robustness[first:stop].argmin())
        one = stop == first + 1
        ends = [first] if one else [first, stop - 1]
        time = {"time": beside(data, *ends)[2:-1]} if data["step"] is not None else {}
        rows.append({
            "violated": f"step {first}" if one else f"steps {first} … {stop - 1}",
            **time,
            "steps": stop - first,
            "least_robustness": robustness_text(robustness[least]),
            "at_step": least,
        })  # fmt: skip
    return rows, len(ranges) - len(rows)


def true_ranges(truth: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The runs of consecutive true entries as rows (first, after the last), in order."""
    edges = np.diff(np.concatenate([[False], truth, [False]]).astype(np.int8))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def trace_rows(data: MonitorRecord) -> tuple[list[dict[str, Any]], int]:
    """The first traces of a batch, one per row, and how many more there are."""
    rows = []
    for number, figures in enumerate(data["each"][:_TRACES]):
        row: dict[str, Any] = {
            "trace": figures.get("file", number),
            f"step {data['at'] or 0}": _verdict(figures["verdict"]),
        }
        if data["at"] is None:
            first = figures["first_violation"]
            shown = "–" if first is None else f"{first}{beside(data, first)}" if data["step"] is not None else first
            row |= {"violated_at": _count(figures["violations"], "step"), "first": shown}
        row["least_robustness" if data["at"] is None else "robustness"] = robustness_text(figures["least_robustness"])
        rows.append(row | ({"at_step": figures["least_robustness_at"]} if data["at"] is None else {}))
    return rows, len(data["each"]) - len(rows)


def step_lines(data: MonitorRecord, trace: int | None) -> Iterator[str]:
    """Every judged step of one trace, one per line, below a heading."""
    verdicts, robustness = cast(Any, data["verdicts"]), cast(Any, data["robustness"])
    if trace is not None:
        verdicts, robustness = verdicts[trace], robustness[trace]
    first = data["at"] or 0
    last = first + len(verdicts) - 1
    width = max(len("step"), len(str(last)))
    timed = data["step"] is not None
    wide = max(len(step_time(data, step) or "") for step in (first, (first + last) // 2, last)) + 2
    yield f"{'step':<{width}}  " + (f"{'time':<{wide}}  " if timed else "") + "verdict   robustness"
    for step, (verdict, value) in enumerate(zip(verdicts, robustness, strict=True), start=first):
        time = f"{step_time(data, step):<{wide}}  " if timed else ""
        yield f"{step:<{width}}  {time}{_verdict(verdict):<8}  {robustness_text(value)}"


def shown_trace(data: MonitorRecord, asked: int | None) -> int | None:
    """Which trace of a batch to show: the requested one, else the first violating one, else the first. None: no batch.

    Raises SettingsError if there is no such trace.
    """
    traces = data["traces"]
    if traces is None:
        if asked is not None:
            raise SettingsError(f"--trace {asked}: {data['trace']} contains a single trace; leave out --trace")
        return None
    if asked is not None:
        if not 0 <= asked < traces:
            contains = "contain" if "file" in data["each"][0] else "contains"
            raise SettingsError(f"--trace {asked}: {data['trace']} {contains} traces 0 … {traces - 1}")
        return asked
    return next((number for number, figures in enumerate(data["each"]) if not figures["holds"]), 0)


def robustness_text(value: float | str) -> str:
    """Robustness in readable form; 0 has no sign."""
    return f"{float(value) + 0.0:.6g}"


def _verdict(holds: bool) -> str:
    return "holds" if holds else "violated"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s'[: n != 1]}"


# ----------------------------------------------------------------------------------------------------------- picture


def require_monitor_picture(path: Path) -> None:
    """Raise an error, before the work, if the picture could not be written after it."""
    require_picture(path, PICTURES)


def write_monitor_picture(
    result: MonitorResult,
    signals: dict[str, NDArray[Any]],
    task: Task,
    path: Path,
    trace: int | None = None,
    at: int | None = None,
    causes: Mapping[str, NDArray[np.int64]] | None = None,
) -> None:
    """Signals, robustness and verdicts over time, for a batch those of `trace`; written whole or not at all.

    `causes`, of a diagnosis, are marked.
    """
    from stltool.reporting.monitor_figure import monitored

    require_monitor_picture(path)
    write_result(path, monitored(result, signals, task, path.suffix.lower()[1:], trace, at, causes), "picture")
