"""The sources of an older commit, to be measured beside the present ones."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COMMIT = "fdc09f8"


def older_sources(folder: str) -> str:
    """Unpack the older commit's package into a folder, for PYTHONPATH."""
    archive = subprocess.run(
        ["git", "archive", COMMIT, "stltool", "grammars"], cwd=ROOT, capture_output=True, check=True
    )
    subprocess.run(["tar", "x", "-C", folder], input=archive.stdout, check=True)
    return folder
