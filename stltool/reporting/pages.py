"""Fronts, monitored traces and estimates as reports: what is added to their data, and what their pages say."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from importlib import metadata
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from stltool.checking import Front
from stltool.logic.formula import is_bounded
from stltool.logic.printer import with_names
from stltool.logic.task import Task
from stltool.numbers import bound_texts, ceiling_text, floor_text, probability_text, within_text
from stltool.product import Product
from stltool.reporting.diagnosis import subformulas_data
from stltool.reporting.headline import positions, verdict_chip
from stltool.reporting.monitoring import (
    beside,
    coverage_content,
    monitor_facts,
    range_rows,
    robustness_text,
    shown_trace,
    trace_rows,
)
from stltool.reporting.records import MonitorRecord
from stltool.reporting.tradeoffs import front_data
from stltool.reporting.words import SentenceRecord, sentences

FRONT_FORMAT, MONITOR_FORMAT = "stltool-front-1", "stltool-monitor-1"
ESTIMATE_FORMAT, TEST_FORMAT = "stltool-estimate-1", "stltool-test-1"  # an interval, a sequential test
_LONGEST_CHART = 20_000  # steps that are drawn


def _about(format_name: str, command: str | None) -> dict[str, Any]:
    return {"format": format_name, "version": metadata.version("stltool"), "command": command}


# --------------------------------------------------------------------------------------------------------------- fronts


def front_report(front: Front, command: str | None = None) -> dict[str, Any]:
    """Everything that a front's page shows."""
    words = {task.task_name: sentences(task.formula, with_names(task.definitions)) for task in front.joint.tasks}
    return {**_about(FRONT_FORMAT, command), **front_data(front), "words": words}


def front_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the template front.html needs, next to the data."""
    from stltool.reporting.figures import pareto_front

    names = list(data["tasks"])
    best = {
        name: max((corner["probabilities"][name] for corner in data["corners"]), key=lambda figure: figure["value"])
        for name in names
    }
    alone = " and ".join(
        f"{within_text(best[name]['value'], best[name]['lower'], best[name]['upper'], 6)} for {name}" for name in names
    )
    lead = f"The best probabilities are {alone}, each for itself. "
    if len(data["corners"]) == 1:
        lead += "One policy reaches both."
    else:
        lead += "Along the front, more of the one costs some of the other."
    return {"names": names, "lead": lead, "picture": pareto_front(dict(data), "svg"), "bound_texts": bound_texts}


# ------------------------------------------------------------------------------------------------------------- monitors


def monitor_report(
    data: Mapping[str, Any], signals: Mapping[str, ArrayLike], task: Task, command: str | None = None
) -> dict[str, Any]:
    """Everything that a monitored trace's page shows; `data` as made by `monitor_data`, `signals` what was judged: all
    traces of a batch, or the one that is shown.
    """
    words = sentences(task.formula, with_names(task.predicates)) if is_bounded(task.formula) else None
    shown = _shown(cast(MonitorRecord, data))
    arrays = {name: np.asarray(values) for name, values in signals.items()}
    one = {name: array if array.ndim == 1 else array[shown] for name, array in arrays.items()}
    parts, more = subformulas_data(one, task, data["end"])
    return {**_about(MONITOR_FORMAT, command), **data, "words": words, "subformulas": parts, "more_subformulas": more}


def _shown(data: MonitorRecord) -> int | None:
    """Which trace of a batch the page shows: the explained one, if there is one."""
    return shown_trace(data, data["why"]["trace"] if "why" in data and data["traces"] is not None else None)


def monitor_content(given: Mapping[str, Any]) -> dict[str, Any]:
    """What the template monitor.html needs, next to the data."""
    data = cast(MonitorRecord, given)
    from stltool.reporting.figures import line_chart
    from stltool.reporting.monitor_figure import lane_picture

    shown = _shown(data)
    rows, more = range_rows(data) if shown is None else trace_rows(data)
    robustness: Any = data["robustness"] if shown is None else data["robustness"][shown]
    chart = None
    if 1 < len(robustness) <= _LONGEST_CHART:
        ys = [float(value) for value in robustness]
        step, x = (data["step"], f"time [{data['unit']}]") if data["step"] is not None else (1, "step")
        line = {
            "name": "robustness",
            "x": [i * step for i in range(len(ys))],
            "y": [y if abs(y) < float("inf") else None for y in ys],
        }
        zero = {"name": "0", "x": [0, (len(ys) - 1) * step], "y": [0.0, 0.0]}
        chart = line_chart({"x": x, "y": "robustness", "lines": [line, zero]}, "robustness")
    facts = monitor_facts(data)
    verdicts: Any = data["verdicts"] if shown is None else data["verdicts"][shown]
    lanes = None
    if 1 < data["samples"] <= _LONGEST_CHART and (data["at"] is None or given["subformulas"] or "why" in data):
        lanes = lane_picture(given, np.array(verdicts, dtype=np.bool_) if data["at"] is None else None)
    return {
        "lanes": lanes,
        "lead": _monitor_lead(data),
        "beside": beside,
        "horizon": f"Horizon {facts['horizon']}; judged: {facts['judged']}",
        "chart": chart,
        "shown": shown,
        "rows": rows if data["at"] is None else [],
        "more": more,
        "coverage": coverage_content(data["coverage"]) if "coverage" in data else None,
    }


def _monitor_lead(data: MonitorRecord) -> str:
    least, least_at = robustness_text(data["least_robustness"]), data["least_robustness_at"]
    if data["traces"] is not None:
        kept = data["traces"] - data["violating_traces"]
        return f"It holds for {kept} of {data['traces']} traces. The least robustness is {least}."
    if data["at"] is not None:
        at = f"At step {data['at']}{beside(data, data['at'])}"
        return f"{at} it {'holds' if data['holds'] else 'is violated'}, with robustness {least}."
    at = f"; the least robustness is {least}, at step {least_at}{beside(data, least_at)}."
    if data["holds"]:
        return f"It holds at each of the {data['judged']} judged steps{at}"
    first = f"first at step {data['first_violation']}{beside(data, data['first_violation'])}"
    return f"It is violated at {data['violations']} of {data['judged']} judged steps, {first}{at}"


# ------------------------------------------------------------------------------------------------------------ estimates


def estimate_report(data: Mapping[str, Any], product: Product, command: str | None = None) -> dict[str, Any]:
    """Everything that an estimate's page shows; `data` as made by `estimate_data`."""
    words: SentenceRecord = sentences(product.formula, with_names(product.definitions))
    return {**_about(TEST_FORMAT if "verdict" in data else ESTIMATE_FORMAT, command), **data, "words": words}


def estimate_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the template estimate.html needs, next to the data."""
    share = data["satisfied"] / data["runs"] if data["runs"] else 0.0
    rows: list[dict[str, Any]] = []
    chip = None
    if data.get("verdict"):
        chip = verdict_chip(data["verdict"], f"P ≥ {data['at_least']:g}")
        rows.append({"what": "Share of satisfied runs", "sure": "", "kind": "ours", "values": [share],
                     "text": probability_text(share)})  # fmt: skip
        rows.append({"what": "The bound asked for", "sure": "", "kind": "optimum", "values": [data["at_least"]],
                     "text": f"{data['at_least']:g}"})  # fmt: skip
    else:
        sure = f"{100 * data['confidence']:.12g} %"
        bounds = [data["lower"], data["upper"]]
        text = f"{floor_text(bounds[0], 4)} … {ceiling_text(bounds[1], 4)}"
        rows.append({"what": "Share of satisfied runs", "sure": "", "kind": "ours", "values": [data["probability"]],
                     "text": probability_text(data["probability"])})  # fmt: skip
        rows.append({"what": "P, from the runs", "sure": sure, "kind": "range", "values": bounds, "text": text})
    if data["exact"] is not None:
        rows.append({"what": "P", "sure": "exactly", "kind": "optimum", "values": [data["exact"]],
                     "text": within_text(data["exact"], data["exact_lower"], data["exact_upper"], 6)})  # fmt: skip
    ticks = positions(rows)
    value = f"{data['satisfied']} of {data['runs']} runs" if chip else f"P ≈ {probability_text(data['probability'])}"
    return {"rows": rows, "ticks": ticks, "chip": chip, "value": value, "bound_texts": bound_texts}


def certificate_bounds(record: Mapping[str, Any]) -> tuple[str, str]:
    """The bounds of a certificate in 17 digits, rounded outwards."""
    return bound_texts(Fraction(record["lower"]), Fraction(record["upper"]))
