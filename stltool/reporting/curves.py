"""Learning curves: a run's as a CSV file, and several runs' as median and quartiles."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stltool.files import write_atomically
from stltool.learning import Training


def write_history(training: Training, path: str | Path) -> None:
    """The exact learning curve as CSV: episode, steps, probability. Doubles are written so that they read back."""
    write_csv(
        path, ("episode", "steps", "probability"), ((p.episode, p.steps, p.probability) for p in training.history)
    )


def write_csv(path: str | Path, heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV file, whole or not at all; None is an empty cell."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    write_atomically(path, buffer.getvalue())


def quartile_curves(curves: Sequence[tuple[Sequence[int], Sequence[float]]]) -> dict[str, list[float]]:
    """Curves (steps, probabilities), one a seed, as steps, q1, median and q3 over the seeds.

    From where every seed has been evaluated, at each seed's evaluations: a seed's probability is its latest, and one
    that stopped early keeps that of the policy that it stopped with.
    """
    steps = np.unique(np.concatenate([np.asarray(at) for at, _ in curves]))
    steps = steps[steps >= max(at[0] for at, _ in curves)]
    values = np.array([
        np.asarray(probability)[np.searchsorted(at, steps, side="right") - 1]
        for at, probability in curves
    ])  # fmt: skip
    q1, median, q3 = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    return {"steps": steps.tolist(), "q1": q1.tolist(), "median": median.tolist(), "q3": q3.tolist()}
