"""By how much a task holds, as plain data."""

from __future__ import annotations

from typing import Literal

import numpy as np

from stltool.checking import RobustnessDistribution, TimeDistribution
from stltool.logic.formula import horizon
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.reporting.monitoring import jsonable
from stltool.reporting.records import RobustnessRecord, TimingRecord


def robustness_data(
    task: Task,
    model: MDP,
    found: RobustnessDistribution | None,
    judged: Literal["policy"] | None = None,
    maximize: bool = True,
) -> RobustnessRecord:
    """The distribution, flat; None stands for one without values, as where no margin is asked for."""
    nothing = np.empty(0)
    values, lower, upper = (found.values, found.lower, found.upper) if found is not None else (nothing,) * 3
    return {
        "task": task.name,
        "formula": str(task.formula),
        "model": model.name,
        "model_digest": model.digest(),
        "horizon": horizon(task.formula),
        "question": judged or ("maximum" if maximize else "minimum"),
        "values": jsonable(values),
        "lower": lower.tolist(),
        "upper": upper.tolist(),
        "mean": list(found.mean) if found is not None and found.mean is not None else None,
        "seconds": found.seconds if found is not None else 0.0,
    }


def timing_data(found: TimeDistribution) -> TimingRecord:
    """The distribution of time robustness, flat; entry k of a list is that of k steps."""
    lower, upper = found.bounds["predicates"]
    task_lower, task_upper = found.bounds["task"]
    return {
        "task": found.task_name,
        "formula": str(found.formula),
        "model": found.model.name,
        "model_digest": found.model.digest(),
        "question": found.question,
        "margin": found.margin,
        "predicates": {"lower": lower.tolist(), "upper": upper.tolist()},
        "whole_task": {"lower": task_lower.tolist(), "upper": task_upper.tolist()},
        "seconds": found.seconds,
    }
