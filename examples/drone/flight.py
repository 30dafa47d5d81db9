"""The log of a simulated survey flight: `python -m examples.drone.flight` writes flight.csv, two rows a second.

A drone climbs, flies legs over a field, and returns when its battery is low. A gust carries it above the height limit
for a moment; the log is the same every time.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

STEPS, LIMIT = 240, 120.0


def main(folder: Path = Path(__file__).parent) -> Path:
    rng = np.random.default_rng(2024)
    height = speed = gust = 0.0
    battery = 100.0
    path = folder / "flight.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["step", "height", "speed", "battery", "landed"])
        for step in range(STEPS):
            aim = 100.0 if battery > 35 and step < 190 else 0.0
            gust = 0.8 * gust + float(rng.normal(0, 0.5)) + (9.0 if 118 <= step < 122 else 0.0)
            height = max(
                0.0, height + float(np.clip(0.2 * (aim - height), -3.0, 3.0)) + (0.3 * gust if height > 5 else 0)
            )
            speed = max(0.0, 0.9 * speed + (0.9 if height > 60 and aim else 0.0) + float(rng.normal(0, 0.05)))
            battery -= 0.12 + 0.02 * speed
            landed = height < 0.5 and step > 10
            out.writerow([step, f"{height:.2f}", f"{speed:.2f}", f"{battery:.1f}", str(landed).lower()])
    return path


if __name__ == "__main__":
    main()
