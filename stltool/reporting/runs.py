"""Runs and sensitivities as plain data, and a run as one line of text."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from stltool.checking import LikelyRun, LikelyRuns, Sensitivity
from stltool.product import Product
from stltool.reporting.records import LikelyRecord, LikelyRunRecord, SensitivityRecord


def likely_data(result: LikelyRuns) -> LikelyRecord:
    """The most probable runs of a verdict, in the user's names; `share` is of the probability of the verdict."""
    return {
        "satisfied": result.satisfied,
        "verdict_probability": result.probability,
        "mass": result.mass,
        "covered": result.covered,
        "exhausted": result.exhausted,
        "status": result.status,
        "runs": [_run_data(result.product, run, result.probability) for run in result.runs],
    }


def _run_data(product: Product, run: LikelyRun, whole: float) -> LikelyRunRecord:
    """State i was left by action i; `remembered` describes the automaton state before the verdict, None at step 0."""
    model = product.model
    return {
        "probability": run.probability,
        "log_probability": run.log_probability,
        "share": run.probability / whole if whole else None,
        "satisfied": run.satisfied,
        "step": run.step,
        "certain_from": run.certain,
        "remembered": run.memory[-2] if run.step else None,
        "state_indices": list(run.states),
        "states": [model.state_name(s) for s in run.states],
        "labels": [[name for name, values in model.labels.items() if values[s]] for s in run.states],
        "actions": list(run.actions),
        "memory": list(run.memory),
    }


def trace_text(states: Sequence[str], labels: Sequence[Sequence[str]], actions: Sequence[str]) -> str:
    """A run in one line, each state with its labels and the action taken there: (1,0) N → 2 × (1,1) {A} E → (1,1)."""
    told = []
    for state, shown, action in itertools.zip_longest(states, labels, actions):
        told.append(" ".join(filter(None, [state, f"{{{', '.join(shown)}}}" if shown else "", action])))
    grouped = [(text, len(list(same))) for text, same in itertools.groupby(told)]
    return " → ".join(text if n == 1 else f"{n} × {text}" for text, n in grouped)


def verdict_text(run: Mapping[str, Any]) -> str:
    """When a run was decided: violated at step 7 (certain from step 3)."""
    verdict = "satisfied" if run["satisfied"] else "violated"
    early = f" (certain from step {run['certain_from']})" if run["certain_from"] < run["step"] else ""
    return f"{verdict} at step {run['step']}{early}"


def sensitivity_data(result: Sensitivity, count: int) -> list[SensitivityRecord]:
    """The `count` states whose success probability moves P most, with those actions; none that do not move it."""
    return [
        {
            "state": row.state,
            "name": row.name,
            "derivative": row.derivative,
            "steepest": row.steepest,
            "visits": row.visits,
            "actions": [
                {
                    "action": one.action,
                    "intended": one.intended,
                    "success": one.success,
                    "derivative": one.derivative,
                    "times": one.times,
                }
                for one in row.actions
                if one.derivative
            ],
        }
        for row in result.ranked(count)
        if row.derivative
    ]
