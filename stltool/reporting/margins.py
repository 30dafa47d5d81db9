"""By how much a task holds, as plain data."""

from __future__ import annotations

from typing import Literal

import numpy as np

from stltool.checking import RobustnessDistribution
from stltool.logic.formula import horizon
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.reporting.monitoring import jsonable
from stltool.reporting.records import RobustnessRecord


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
