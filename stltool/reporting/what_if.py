"""What would have become of a run, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stltool.checking import Alternative, Counterfactual
from stltool.numbers import fraction_text
from stltool.reporting.records import AlternativeRecord, NoiseRecord, WhatIfRecord


def what_if_data(found: Counterfactual) -> WhatIfRecord:
    """A run and its alternatives, in the user's names."""
    return {
        "satisfied": found.satisfied,
        "visited": [found.product.model.state_name(s) for s in found.states],
        "actions": list(found.actions),
        "coupling": found.coupling,
        "assumption": found.assumption,
        "noise": [[{"name": name, "share": float(share)} for name, share in step.items()] for step in found.noise],
        "alternatives": list(map(_alternative, found.alternatives)),
    }


def _alternative(one: Alternative) -> AlternativeRecord:
    data: AlternativeRecord = {
        "step": one.step,
        "state": one.state,
        "action": one.action,
        "taken": one.taken,
        "probability": one.probability,
        "lower": one.lower,
        "upper": one.upper,
    }
    if one.fraction is not None:
        data["fraction"] = fraction_text(one.fraction)
    return data


def best_of_steps(alternatives: Sequence[AlternativeRecord]) -> list[dict[str, Any]]:
    """For each step what was done there, and what would have been best: the first of equals, as it was if that is one
    of them."""
    found: dict[int, list[AlternativeRecord]] = {}
    for one in alternatives:
        found.setdefault(one["step"], []).append(one)
    rows = []
    for step, listed in found.items():
        taken = next((one for one in listed if one["taken"]), None)
        best = max(listed, key=lambda one: (one["probability"], one["taken"]))
        rows.append({"step": step, "state": listed[0]["state"], "taken": taken, "best": best})
    return rows


def chance_text(noise: Sequence[NoiseRecord]) -> str:
    """What may have happened at a step: left; stay or right, by the names of the model; nothing where it has none."""
    return " or ".join(one["name"] for one in noise if one["name"] is not None)
