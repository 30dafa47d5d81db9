"""Frontiers of a task's params as data."""

from __future__ import annotations

from stltool.checking.frontier import Frontier, Probe
from stltool.logic.quantities import quantity_text
from stltool.reporting.records import FrontierOutput, ProbeRecord


def frontier_data(found: Frontier) -> FrontierOutput:
    """The result, flat; values are as a task file writes them."""
    return {
        "task": found.task.name,
        "formula": str(found.task.formula),
        "model": found.model.name,
        "model_digest": found.model.digest(),
        "question": found.question,
        "bound": float(found.at_least),
        "params": [
            {"name": param.name, "values": list(map(quantity_text, param.values)), "direction": param.direction}
            for param in found.params
        ],
        "method": found.method,
        "steps": [
            {
                "others": list(map(quantity_text, step.others)),
                "tightest": None if step.tightest is None else quantity_text(step.tightest),
                "probe": _probe_data(step.probe),
            }
            for step in found.steps
        ],
        "probes": list(map(_probe_data, found.probes)),
        "seconds": found.seconds,
    }


def _probe_data(probe: Probe) -> ProbeRecord:
    return {
        "values": list(map(quantity_text, probe.values)),
        "P": probe.probability,
        "lower": probe.lower,
        "upper": probe.upper,
        "holds": probe.holds,
    }
