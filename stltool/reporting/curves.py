"""Learning curves: of one run as a CSV file, and of several runs as median and quartiles."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stltool.files import begins, require_result, write_result
from stltool.learning import Training
from stltool.learning.settings import recorded
from stltool.reporting.records import CurveRecord

_HISTORY = ("episode", "steps", "probability", "method", "faithful", "seed", "settings")


def write_history(training: Training, path: str | Path) -> None:
    """The exact learning curve as CSV: episode, steps, probability, and in every row the method, whether as published,
    the seed, and all settings as JSON. Doubles are written so that they read back."""
    settings = json.dumps({**recorded(training.budget), **training.settings})
    run = (training.method, training.faithful, training.seed, settings)
    write_csv(path, "learning curve", _HISTORY, ((p.episode, p.steps, p.probability, *run) for p in training.history))


def require_history_file(path: str | Path) -> None:
    """Raise an error, before the work, if the learning curve could not be written after it."""
    require_result(path, "learning curve", begins(*_HISTORY))


def write_csv(path: str | Path, what: str, heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file, whole or not at all; None is an empty cell. FileError if a file of another heading is there."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    write_result(path, buffer.getvalue(), what, begins(*heading))


def quartile_curves(curves: Sequence[tuple[Sequence[int], Sequence[float]]]) -> CurveRecord:
    """Curves (steps, probabilities), one per seed, as steps, q1, median and q3 over the seeds.

    The points are the evaluations of all seeds, from where every seed has been evaluated: the probability of a seed is
    its latest, and a seed that stopped early keeps that of its final policy.
    """
    steps = np.unique(np.concatenate([np.asarray(at) for at, _ in curves]))
    steps = steps[steps >= max(at[0] for at, _ in curves)]
    values = np.array([
        np.asarray(probability)[np.searchsorted(at, steps, side="right") - 1]
        for at, probability in curves
    ])  # fmt: skip
    q1, median, q3 = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    return {"steps": steps.tolist(), "q1": q1.tolist(), "median": median.tolist(), "q3": q3.tolist()}
