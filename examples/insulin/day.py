"""A day of blood glucose under an insulin pump, simulated: `python -m examples.insulin.day` writes day.csv.

One row in five minutes: glucose in mmol/l, the pump's insulin in units an hour, and whether a meal begins. Three meals
raise the glucose, the pump answers late; after the evening meal it answers too strongly. A sketch for monitors, not a
model for medicine.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

ROWS, MEALS = 288, {84: 45.0, 150: 70.0, 204: 60.0}  # row of five minutes: grams of carbohydrate


def main(folder: Path = Path(__file__).parent) -> Path:
    rng = np.random.default_rng(7)
    glucose, insulin, stomach, acting = 6.0, 0.8, 0.0, 0.8
    path = folder / "day.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["step", "glucose", "insulin", "meal"])
        for row in range(ROWS):
            stomach += MEALS.get(row, 0.0)
            absorbed = 0.09 * stomach
            stomach -= absorbed
            gain = 2.6 if row >= 204 else 1.0
            insulin = float(np.clip(0.8 + gain * (glucose - 6.2), 0.0, 9.0))
            acting += 0.06 * (insulin - acting)
            glucose = max(2.0, glucose + 0.17 * absorbed - 0.11 * (acting - 0.8) + float(rng.normal(0, 0.04)))
            out.writerow([row, f"{glucose:.2f}", f"{insulin:.2f}", str(row in MEALS).lower()])
    return path


if __name__ == "__main__":
    main()
