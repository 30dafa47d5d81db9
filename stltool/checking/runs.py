"""Runs that were observed, from files: what a robot logged, or what `stltool play --json` printed.

CSV has a line for each state, with the columns `state` and `action`, what was done there; others are not read. The
action of the last state is empty. JSON is what `play --json` prints, {"steps": [{"state": …, "action": …}, …]}; other
keys are not read.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from stltool.arguments import path as path_of
from stltool.errors import FileError
from stltool.files import read_text

_WHAT = "file of a run"
_LARGEST = 100_000_000  # bytes
_HINT = "write the columns state,action, with one line for each state; the last has no action"


def load_run(path: str | Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The states (n + 1) and the actions (n) of a run, by their names, from `.csv` or `.json`.

    Raises FileError, with the line, for a file that is not a run.
    """
    path = path_of(path, "load_run's path")
    kind = path.suffix.lower()
    if kind not in (".csv", ".json"):
        raise FileError(f"{path}: runs are read from .csv and .json; use one of these extensions")
    text = read_text(path, _WHAT, _LARGEST)
    pairs = _of_csv(path, text) if kind == ".csv" else _of_json(path, text)
    if not pairs:
        raise FileError(f"{path}: a run without states; {_HINT}")
    *before, (_, last_state, last_action) = pairs
    for place, state, action in before:
        if not action:
            raise FileError(f"{path}, {place}: state {state} has no action, but the run goes on; {_HINT}")
    if last_action:
        raise FileError(f"{path}: the last action, {last_action}, leads to no state; add the state that came of it")
    return (*(state for _, state, _ in before), last_state), tuple(action for _, _, action in before)


def _of_csv(path: Path, text: str) -> list[tuple[str, str, str]]:
    """The place, the state and the action of each line."""
    reader = csv.reader(io.StringIO(text, newline=""))
    found: list[tuple[str, str, str]] = []
    columns: list[str] = []
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if not columns:
                columns = [cell.strip().lower() for cell in row]
                for name in ("state", "action"):
                    if columns.count(name) != 1:
                        raise FileError(f"{path}: there is no column {name}, or more than one; {_HINT}")
                at_state, at_action = columns.index("state"), columns.index("action")
                continue
            if len(row) != len(columns):
                raise FileError(
                    f"{path}, line {reader.line_num}: this line has {len(row)} cells, the header {len(columns)}"
                )
            found.append((f"line {reader.line_num}", row[at_state].strip(), row[at_action].strip()))
    except csv.Error as error:
        raise FileError(f"{path}, line {reader.line_num}: not a run in CSV: {error}") from None
    return found


def _of_json(path: Path, text: str) -> list[tuple[str, str, str]]:
    try:
        data: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not a run in JSON: {error}") from None
    steps = data.get("steps") if isinstance(data, dict) else None
    if not isinstance(steps, list):
        raise FileError(f'{path}: not a run in JSON; write {{"steps": [{{"state": "a", "action": "go"}}, …]}}')
    found = []
    for t, step in enumerate(steps):
        state, action = (step.get("state"), step.get("action")) if isinstance(step, dict) else (None, None)
        if not isinstance(state, str) or not isinstance(action, str | None):
            raise FileError(f"{path}, steps[{t}]: a step is a state and an action, both names; null for no action")
        found.append((f"steps[{t}]", state, action or ""))
    return found
