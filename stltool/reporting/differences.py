"""What changed between two results of the same kind: reports, sweeps, or what commands print with --json.

Both are compared place by place. Times, lines of texts and the command that was typed are no results and are left out.
Records in a list are matched by what names them (the question, the source of a bound, a file with an expectation), not
by their position. A number has changed if it differs by more than the tolerance.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stltool.errors import FileError, SettingsError
from stltool.files import read_text

TOLERANCE = 1e-9

# a statement repeats figures in words; arrays are the model and the policy, in bytes for a page's explorer
_NO_RESULTS = {"seconds", "time", "command", "threads", "statement", "arrays"}
_NAMES = ("name", "id", "file", "task", "question", "nature", "kind", "source", "support", "scenario", "method",
          "encoding", "assumes", "seed")  # fmt: skip
_BETTER_TRUE = {"holds", "satisfied", "passed", "valid"}
_LONG = 20  # entries of a list that are compared one by one
_MANY = 8  # differences in one part of the file; more are counted, unless all are asked for
_ALWAYS = {"checks", "guarantees", "estimates", "expectations", "results"}  # parts that are always shown in full
_NOTHING = object()


@dataclass(frozen=True)
class Difference:
    """`what` was `before` and is `after`; None for what is not there. `worse`: whether that is for the worse."""

    what: str
    before: Any
    after: Any
    worse: bool = False


def load_result(path: Path) -> dict[str, Any]:
    """A JSON object that stltool has written. FileError for anything else."""
    try:
        data = json.loads(read_text(path, "report"))
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise FileError(
            f"{path}: not the JSON file of a report; give a report.json, or what a command printed with --json"
        )
    return data


def differences(before: dict[str, Any], after: dict[str, Any], tolerance: float = TOLERANCE) -> list[Difference]:
    """What differs, in the order of the file. SettingsError if the two are of different kinds."""
    formats = [data.get("format", "no format") for data in (before, after)]
    if formats[0] != formats[1]:
        raise SettingsError(f"the first file has {formats[0]}, the second {formats[1]}; compare two of the same kind")
    return list(_records("", before, after, tolerance))


def summarised(found: Sequence[Difference]) -> list[Difference]:
    """The same, with one line for a part of the file that differs in many places, unless it has the results."""
    parts: dict[str, list[Difference]] = {}
    for one in found:
        part = re.split(r"[.\[]", one.what)[0]
        if part == "training" and one.what.startswith("training.history"):
            part = "training.history"
        parts.setdefault(part, []).append(one)
    shown: list[Difference] = []
    for part, several in parts.items():
        if part in _ALWAYS or len(several) <= _MANY:
            shown += several
        else:
            shown += [one for one in several if one.worse]
            shown.append(Difference(part, "", f"differs in {len(several)} places; --all shows them"))
    return shown


def _walk(what: str, a: Any, b: Any, tolerance: float, worse: bool = False) -> Iterator[Difference]:
    """`worse`: whether any change here is."""
    if isinstance(a, dict) and isinstance(b, dict):
        yield from _records(f"{what}." if what else "", a, b, tolerance)
    elif isinstance(a, list) and isinstance(b, list):
        yield from _lists(what, a, b, tolerance)
    elif not _same(a, b, tolerance):
        before, after = (None if one is _NOTHING else one for one in (a, b))
        yield Difference(what, before, after, worse)


def _records(first: str, a: dict[str, Any], b: dict[str, Any], tolerance: float) -> Iterator[Difference]:
    for key in dict.fromkeys([*a, *b]):
        moved = key in ("line", "column") and first.startswith("expectations[")
        if key not in _NO_RESULTS and not moved:
            mine, theirs = (one.get(key, _NOTHING) for one in (a, b))
            yield from _walk(f"{first}{key}", mine, theirs, tolerance, _worse(key, a, b))


def _worse(key: str, a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether a record's entry changed for the worse: a bound no longer holds, a P or a guarantee is smaller, a gap
    larger."""
    mine, theirs = a.get(key), b.get(key)
    if key in _BETTER_TRUE:
        return mine is True and theirs is not True
    if key == "verdict":
        return mine == "holds" != theirs
    if not (isinstance(mine, int | float) and isinstance(theirs, int | float)):
        return False
    smaller = (key == "probability" and "question" in a) or (key == "lower" and "confidence" in a)
    larger = key == "upper" and "without_data" in a
    return (smaller and theirs < mine) or (larger and theirs > mine)


def _lists(what: str, a: list[Any], b: list[Any], tolerance: float) -> Iterator[Difference]:
    named = _named(a, b, ("file", "text"), 200) if what == "expectations" else _named(a, b)
    if named is not None:
        mine, theirs = named
        for name in dict.fromkeys([*mine, *theirs]):
            lost = name not in theirs and what in ("guarantees", "expectations")
            pair = mine.get(name, _NOTHING), theirs.get(name, _NOTHING)
            yield from _walk(f"{what}[{name}]", *pair, tolerance, lost)
        return
    if len(a) == len(b) <= _LONG:
        for i, pair in enumerate(zip(a, b, strict=True)):
            yield from _walk(f"{what}[{i}]", *pair, tolerance)
        return
    differ = (i for i, pair in enumerate(zip(a, b, strict=False)) if next(_walk("", *pair, tolerance), None))
    first = next(differ, min(len(a), len(b)))
    if first < max(len(a), len(b)):
        before, after = (
            f"{len(one)} entries" + (f", [{first}] = {_cut(one[first])}" if first < len(one) else "") for one in (a, b)
        )
        yield Difference(what, before, after)


def _named(a: list[Any], b: list[Any], by: Sequence[str] = _NAMES, longest: int = 40) -> list[dict[str, Any]] | None:
    """Two lists of records by what names them, with as few of the names as tell them apart; None if none do."""
    if not all(isinstance(one, dict) for one in [*a, *b]) or not (a or b):
        return None
    for most in range(1, len(by) + 1):
        found = []
        for entries in (a, b):
            names = [
                ", ".join(_cut(str(one[key]), longest) for key in by[:most] if isinstance(one.get(key), str | int))
                for one in entries
            ]
            found.append(dict(zip(names, entries, strict=True)))
        if all(len(one) == len(entries) and all(one) for one, entries in zip(found, (a, b), strict=True)):
            return found
    return None


def _same(a: Any, b: Any, tolerance: float) -> bool:
    numbers = [isinstance(one, int | float) and not isinstance(one, bool) for one in (a, b)]
    if all(numbers):
        return bool(a == b or abs(a - b) <= tolerance or (math.isnan(a) and math.isnan(b)))
    return type(a) is type(b) and bool(a == b)


def difference_rows(found: Sequence[Difference]) -> list[dict[str, str]]:
    """The rows that the terminal shows."""
    rows = []
    for one in found:
        change = ""
        if all(isinstance(side, int | float) and not isinstance(side, bool) for side in (one.before, one.after)):
            change = f"{one.after - one.before:+.3g}"
        rows.append({
            "what": one.what, "before": _cut(one.before), "after": _cut(one.after),
            "change": change + (" worse" if change and one.worse else "worse" if one.worse else ""),
        })  # fmt: skip
    return rows


def _cut(value: Any, most: int = 60) -> str:
    text = "-" if value is None else json.dumps(value, ensure_ascii=False) if not isinstance(value, str) else value
    text = " ".join(text.split())
    return text if len(text) <= most else f"{text[: most - 1]}…"
