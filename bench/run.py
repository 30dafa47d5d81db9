"""`make bench`: every table, printed and written to bench/results.md with machine, versions and date."""

from __future__ import annotations

import datetime
import os
import platform
from importlib import metadata
from pathlib import Path

import automata
import certificates
import floors
import goals
import loading
import monitors
import parsing
import rigour
import spine
import windows

versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("stltool", "numpy", "numba", "scipy"))
lines = [
    "# Benchmark results",
    "",
    f"`make bench` on {datetime.date.today()}: {platform.machine()}, {os.cpu_count()} cores, "
    f"Python {platform.python_version()}, {versions}.",
    "",
    "## Growing floors, beside Storm and an older commit",
    "",
    "What each column is: bench/floors.py.",
    "",
    *floors.table(),
    "",
    *floors.scaling(),
    "",
    "![CPU seconds and memory over product states](scaling.svg)",
    "",
    "## Checking and learning",
    "",
    *spine.table(),
    "",
    "## Environment steps to a good policy, ten seeds",
    "",
    *goals.table(),
    "",
    "## Enclosures and exact fractions",
    "",
    *rigour.table(),
    "",
    "## Reading formulas",
    "",
    *parsing.table(),
    "",
    "## Model files: CPU seconds and memory, beside an older commit",
    "",
    "What each part is: bench/loading.py.",
    "",
    *loading.table(),
    "",
    "## Monitors",
    "",
    *monitors.table(),
    "",
    "## Automata: states by encoding, seconds to compile the exact one",
    "",
    "`*`: the flags are not the formula there. What each column counts: bench/automata.py.",
    "",
    *automata.table(),
    "",
    "## Automata: long windows, CPU seconds to compile them, beside an older commit",
    "",
    "What each column counts: bench/windows.py.",
    "",
    *windows.table(),
    "",
    "## Certificates written and re-checked, CPU seconds and bytes, beside an older commit",
    "",
    "What each column counts: bench/certificates.py.",
    "",
    *certificates.table(),
]
text = "\n".join(lines) + "\n"
print(text)
(Path(__file__).parent / "results.md").write_text(text, encoding="utf-8")
