"""What changed between two results of the same kind: reports, sweeps, or what commands print with --json.

Both are compared place by place. Times, lines of texts and the command that was typed are no results and are left out.
Records in a list are matched by what names them (the question, the source of a bound, a file with an expectation), not
by their position. A number has changed if it differs by more than the tolerance. Whether a larger or a smaller P is
worse is decided by the bound that was asked for; without one, a smaller P is, or a larger minimum.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NotRequired, TypeAlias, get_origin, get_type_hints

from stltool.errors import FileError, SettingsError
from stltool.files import read_text
from stltool.reporting.records import FORMATS, OUTPUTS

TOLERANCE = 1e-9

# a statement repeats figures in words; a page's explorer repeats the model, the policy and the run
_NO_RESULTS = {"seconds", "time", "command", "threads", "statement", "explorer"}
_NAMES = ("name", "id", "file", "task", "question", "nature", "kind", "source", "support", "scenario", "method",
          "encoding", "assumes", "seed")  # fmt: skip
_VERDICTS = {"holds", "verdict", "satisfied", "met", "decides", "proved"}  # fields that are true, false or open
# how good each is: what is open (null, or not there) is better than a no, and what could not be judged is the worst
_GOOD = {"holds": 3, "true": 3, "undecided": 2, "null": 2, "does not hold": 1, "false": 1, "error": 0}
_LONG = 20  # entries of a list that are compared one by one
_MANY = 8  # differences in one part of the file; more are counted, unless all are asked for
_ALWAYS = {"checks", "guarantees", "estimates", "expectations", "results"}  # parts that are always shown in full
_NOTHING = object()
_ENOUGH = 0.75  # of a kind's fields; an older version may have fewer

Worse: TypeAlias = Literal["smaller", "larger", "neither"]
"""Which P is the worse one; "neither" under a bound from below and another from above."""


@dataclass(frozen=True)
class Difference:
    """`what` was `before` and is `after`; None for what is not there. `worse`: whether that is for the worse."""

    what: str
    before: Any
    after: Any
    worse: bool = False


def load_result(path: Path) -> dict[str, Any]:
    """A result that stltool has written; of a folder, its report.json. FileError for anything else."""
    if path.is_dir():
        path = path / "report.json"
    try:
        data = json.loads(read_text(path, "report"))
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise FileError(
            f"{path}: not the JSON file of a report; give a report.json, or what a command printed with --json"
        )
    if kind_of(data) is None:
        fields = [_cut(str(field), 20) for field in data]
        has = ", ".join(fields[:4]) + (f" and {len(fields) - 4} more" if len(fields) > 4 else "")
        raise FileError(
            f"{path}: no result that can be compared: an object with {has or 'no fields'}; give a report.json, or what "
            f"one of these printed with --json: {', '.join(OUTPUTS)}"
        )
    return data


def kind_of(data: dict[str, Any]) -> str | None:
    """The format of a file, or what printed it, in words; None for what is no result."""
    kinds: dict[str, Any] = {f"the output of {command} --json": record for command, record in OUTPUTS.items()}
    if "format" in data:
        kinds = {name: record for name, record in FORMATS.items() if name == data["format"]}
    shares = {}
    for kind, record in kinds.items():
        needed = _needed(record)
        shares[kind] = (len(needed & set(data)) / len(needed), len(needed))
    best = max(shares, key=lambda kind: shares[kind], default=None)
    return best if best is not None and shares[best][0] >= _ENOUGH else None


def _needed(record: Any) -> set[str]:
    """The fields that every record of a class has."""
    hints = get_type_hints(record, include_extras=True)
    return {field for field in record.__required_keys__ if get_origin(hints[field]) is not NotRequired}


def require_one_kind(before: dict[str, Any], after: dict[str, Any]) -> None:
    """SettingsError if two results are of different kinds."""
    first, second = kind_of(before), kind_of(after)
    if first != second:
        raise SettingsError(f"the first file is {first}, the second {second}; compare two of the same kind")


def differences(before: dict[str, Any], after: dict[str, Any], tolerance: float = TOLERANCE) -> list[Difference]:
    """What differs between two results of one kind, in the order of the file."""
    return list(_records("", *_without_repeats(before, after), tolerance, None))


def _without_repeats(before: dict[str, Any], after: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Both without what the checks of a report repeat from the report itself: the task, the model and their sizes."""
    reports = (before, after)
    if not all(isinstance(data.get("checks"), list) for data in reports):
        return reports
    both = [(data, check) for data in reports for check in data["checks"] if isinstance(check, dict)]
    repeated = {
        key
        for key in before
        if key not in _NAMES and all(key in one and one[key] == data.get(key) for data, one in both)
    }

    def without(data: dict[str, Any]) -> dict[str, Any]:
        return {
            **data, "checks": [{k: v for k, v in one.items() if k not in repeated} if isinstance(one, dict) else one
                               for one in data["checks"]]
        }  # fmt: skip

    return without(before), without(after)


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


def _walk(what: str, a: Any, b: Any, tolerance: float, side: Worse | None, worse: bool = False) -> Iterator[Difference]:
    """`side`: which P is worse, if a record around this one says so. `worse`: whether any change here is."""
    if isinstance(a, dict) and isinstance(b, dict):
        yield from _records(f"{what}." if what else "", a, b, tolerance, side)
    elif isinstance(a, list) and isinstance(b, list):
        yield from _lists(what, a, b, tolerance, side)
    elif not _same(a, b, tolerance):
        before, after = (None if one is _NOTHING else one for one in (a, b))
        yield Difference(what, before, after, worse)


def _records(
    first: str, a: dict[str, Any], b: dict[str, Any], tolerance: float, side: Worse | None
) -> Iterator[Difference]:
    side = _asked(b) or _asked(a) or side or _sought(b)
    for key in dict.fromkeys([*a, *b]):
        moved = key in ("line", "column") and first.startswith("expectations[")
        if key not in _NO_RESULTS and not moved:
            mine, theirs = (one.get(key, _NOTHING) for one in (a, b))
            yield from _walk(f"{first}{key}", mine, theirs, tolerance, side, _worse(key, a, b, side or "smaller"))


def _asked(record: dict[str, Any]) -> Worse | None:
    """Which P is worse by the bounds of a record: an expectation's, those of check, run and estimate."""
    bounds = [str(record.get("relation") or "")[:1]]
    bounds += [sign for key, sign in (("at_least", ">"), ("at_most", "<")) if isinstance(record.get(key), int | float)]
    if isinstance(asked := record.get("asked"), list):
        bounds += [str(one.get("claim")).removeprefix("P ")[:1] for one in asked if isinstance(one, dict)]
    if record.get("side") in ("lower", "upper") and "confidence" in record:
        bounds.append(">" if record["side"] == "lower" else "<")
    below, above = ">" in bounds, "<" in bounds
    return "neither" if below and above else "smaller" if below else "larger" if above else None


def _sought(record: dict[str, Any]) -> Worse | None:
    """Which P is worse where no bound was asked for: what a minimum is sought of shall be small."""
    if isinstance(checks := record.get("checks"), list):
        questions = {one.get("question") for one in checks if isinstance(one, dict)}
        return "larger" if "minimum" in questions and "maximum" not in questions else None
    if record.get("question") in ("minimum", "Pmin"):
        return "larger"
    best, given = record.get("optimum_upper"), record.get("lower")
    if record.get("question") == "policy" and isinstance(best, int | float) and isinstance(given, int | float):
        return "larger" if best < given else None  # a policy next to a minimum
    return None


def _worse(key: str, a: dict[str, Any], b: dict[str, Any], side: Worse) -> bool:
    """Whether a record's entry changed for the worse: a bound no longer holds, a P is on the worse `side`, a guarantee
    is weaker, a gap larger."""
    mine, theirs = a.get(key), b.get(key)
    if key in _VERDICTS and key in a and (first := _goodness(mine)) is not None:
        second = _goodness(theirs)
        return second is not None and second < first
    if key == "gap" and isinstance(mine, dict):
        return theirs is None
    if not (isinstance(mine, int | float) and isinstance(theirs, int | float)):
        return False
    if (key == "gap" and "episode" not in a) or (key == "upper" and "without_data" in a):
        return theirs > mine
    bound = "confidence" in a
    probability = key == "probability" and ("question" in a or "proved" in a)
    if side == "smaller" and (probability or (key == "lower" and bound)):
        return theirs < mine
    return side == "larger" and (probability or (key == "upper" and bound)) and theirs > mine


def _goodness(verdict: Any) -> int | None:
    """The rank of a verdict; None for what is none, such as a number of satisfied runs."""
    text = json.dumps(verdict) if verdict is None or isinstance(verdict, bool) else verdict
    return _GOOD.get(text) if isinstance(text, str) else None


def _lists(what: str, a: list[Any], b: list[Any], tolerance: float, side: Worse | None) -> Iterator[Difference]:
    named = _named(a, b, ("file", "text"), 200) if what == "expectations" else _named(a, b)
    if named is not None:
        mine, theirs = named
        for name in dict.fromkeys([*mine, *theirs]):
            lost = name not in theirs and what in ("guarantees", "expectations")
            pair = mine.get(name, _NOTHING), theirs.get(name, _NOTHING)
            yield from _walk(f"{what}[{name}]", *pair, tolerance, side, lost)
        return
    if len(a) == len(b) <= _LONG:
        for i, pair in enumerate(zip(a, b, strict=True)):
            yield from _walk(f"{what}[{i}]", *pair, tolerance, side)
        return
    differ = (i for i, pair in enumerate(zip(a, b, strict=False)) if next(_walk("", *pair, tolerance, side), None))
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
