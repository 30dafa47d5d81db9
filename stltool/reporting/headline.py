"""The top of a report's page: the verdict in words, and all that is known about P on one scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from stltool.display import NATURES
from stltool.numbers import ceiling_text, difference_text, floor_text, within_text

_VERDICTS = {True: "holds", False: "does not hold", None: "undecided"}
_CHIPS = {"holds": ("good", "✓ holds"), "does not hold": ("bad", "✕ does not hold"), "undecided": ("", "? undecided")}
_TICKS = (0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999, 0.9999999)
_RARE = 0.05  # up to here it is one run in so many
_APART = 13.0  # per cent of the scale between its numbers
_FEWEST = 6  # digits of P
_SURE = 1e-15  # odds of 0 and 1 are those of this distance


def headline(data: Mapping[str, Any], guarantees: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the page shows first: `value`, `whose`, `chips`, `lead`, `rows` and `ticks` of the scale."""
    shown = next((c for c in data["checks"] if c["question"] == "policy"), next(iter(data["checks"]), None))
    learned = bool(data["training"])
    asked = [verdict_chip(_VERDICTS[one["holds"]], one["claim"]) for one in data.get("asked") or ()]
    if shown is None:
        found: dict[str, Any] = {
            "value": f"P ≥ {guarantees[0]['P_at_least']}",
            "whose": f"under the learned policy, with confidence {guarantees[0]['confidence']}",
            "chip": None,
            "lead": "The model is a black box: its probabilities are unknown, so nothing can be checked exactly. The "
            f"bound is from {guarantees[0]['guaranteed_by']}.",
        }
    else:
        found = {
            "value": f"P = {inside_text(shown)}",
            "whose": _whose(shown, learned),
            "chip": _gap_chip(shown, data["checks"]),
            "lead": _lead(shown, data["checks"]),
        }
    rows = _rows(data, shown, learned)
    ticks = positions(rows)
    return {**found, "asked": asked, "shown": shown, "rows": rows if len(rows) > 1 else [], "ticks": ticks}


def verdict_chip(verdict: str, claim: str) -> dict[str, str]:
    """A verdict on a claim: its kind, for the colour, and its text."""
    kind, text = _CHIPS[verdict]
    return {"kind": kind, "text": f"{text}: {claim}"}


def positions(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Give each row, with its `values`, their positions `x` on one scale of odds; the numbers on that scale."""
    place, ticks = _scale([p for row in rows for p in row["values"]])
    for row in rows:
        row["x"] = [place(p) for p in row["values"]]
    return ticks


def inside_text(check: Mapping[str, Any]) -> str:
    """P in as few digits as lie in its enclosure, since what is printed is compared with that."""
    return within_text(check["probability"], check["lower"], check["upper"], _FEWEST)


def one_in(p: float) -> str:
    """How often the task fails, in words; what is rare is counted, so that it is not rounded away."""
    if p <= 0 or p >= 1:
        return "no run fails" if p >= 1 else "every run fails"
    if _RARE < p < 1 - _RARE:
        percent = f"{100 * (1 - p):.3g} % of runs fail"
        return percent if percent.startswith(f"{100 * (1 - p):.12g} ") else f"about {percent}"
    n = round(1 / Fraction(min(p, 1 - p)))
    rounded = round(n, 2 - len(str(n)))
    what = "fails" if p > _RARE else "succeeds"
    return f"about one run in {rounded:,} {what}".replace(",", "\u202f")


def _whose(shown: Mapping[str, Any], learned: bool) -> str:
    nature = f", {NATURES[shown['nature']]}" if shown.get("nature") in NATURES else ""
    if shown["question"] == "policy":
        return f"under the {'learned' if learned else 'given'} policy{nature}"
    return f"{shown['question']} over all policies{nature}"


def _gap_chip(shown: Mapping[str, Any], checks: Sequence[Mapping[str, Any]]) -> dict[str, str] | None:
    """How far the policy is from the optimum; None if that was not computed."""
    best = _optimum(shown, checks)
    if shown["question"] != "policy" or best is None:
        return None
    if shown["gap"] <= shown["optimum_upper"] - shown["optimum_lower"]:
        return {"kind": "good", "text": "optimal"}
    below = "below the best possible" if best["question"] == "maximum" else "above the least possible"
    return {"kind": "good" if shown["gap"] < 1e-3 else "", "text": f"{difference_text(shown['gap'], 2)} {below}"}


def _optimum(shown: Mapping[str, Any], checks: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    return next((c for c in checks if c["question"] != "policy" and c.get("nature") == shown.get("nature")), None)


def _lead(shown: Mapping[str, Any], checks: Sequence[Mapping[str, Any]]) -> str:
    how_often = f"{one_in(shown['probability'])[0].upper()}{one_in(shown['probability'])[1:]}."
    best = _optimum(shown, checks)
    if shown["question"] == "maximum":
        return f"{how_often} No policy does better."
    if shown["question"] == "minimum":
        return f"{how_often} No policy does worse."
    if best is None:
        return how_often
    if shown["gap"] <= shown["optimum_upper"] - shown["optimum_lower"]:
        return f"{how_often} No policy does {'better' if best['question'] == 'maximum' else 'worse'}."
    limit = inside_text(best)
    return f"{how_often} No policy does {'better' if best['question'] == 'maximum' else 'worse'} than {limit}."


def _rows(data: Mapping[str, Any], shown: Mapping[str, Any] | None, learned: bool) -> list[dict[str, Any]]:
    """What is known about P: name, how sure, kind of mark, values, and text."""
    rows: list[dict[str, Any]] = []
    if shown is not None and shown["question"] == "policy":
        rows.append(_row(f"The {'learned' if learned else 'given'} policy", "ours", shown))
    for check in data["checks"]:
        if check["question"] != "policy":
            what = f"{'Best' if check['question'] == 'maximum' else 'Least'} over all policies"
            nature = f", {NATURES[check['nature']]}" if check.get("nature") in NATURES else ""
            rows.append(_row(what + nature, "optimum", check))
    for found in data.get("guarantees") or ():
        if "refused" not in found:
            sure = f"{100 * found['confidence']:.12g} %"
            what = {"learning data": "Learning data", "fresh runs": f"{found.get('runs')} fresh runs"}.get(
                found["source"], "Learning data and fresh runs"
            )
            if found.get("support") == "known":
                what += ", successors known"
            if parameters := found.get("parameters"):
                what += ", one parameter" if len(parameters) == 1 else f", {len(parameters)} parameters"
            rows.append({"what": what, "sure": sure, "kind": "from", "values": [found["lower"]],
                         "text": f"≥ {floor_text(found['lower'])}"})  # fmt: skip
    for found in data.get("estimates") or ():
        sure = f"{100 * found['confidence']:.12g} %"
        bounds = [found["lower"], found["upper"]]
        text = f"{floor_text(bounds[0], 4)} … {ceiling_text(bounds[1], 4)}"
        rows.append({"what": f"{found['runs']} sampled runs", "sure": sure, "kind": "range", "values": bounds,
                     "text": text})  # fmt: skip
    return rows


def _row(what: str, kind: str, check: Mapping[str, Any]) -> dict[str, Any]:
    return {"what": what, "sure": "exactly", "kind": kind, "values": [check["probability"]], "text": inside_text(check)}


def _scale(values: Sequence[float]) -> tuple[Any, list[dict[str, Any]]]:
    """A position in per cent for each probability, on a scale of odds, and the numbers on that scale."""
    inside = [_odds(p) for p in values if 0 < p < 1]
    low, high = min([*inside, _odds(0.5)]) - 0.15, max([*inside, _odds(0.9)]) + 0.35

    def place(p: float) -> float:
        return round(min(100.0, max(0.0, 100 * (_odds(p) - low) / (high - low))), 2)

    ticks: list[dict[str, Any]] = []
    for p in _TICKS:
        x = place(p)
        if 4 < x < 96 and (not ticks or x - ticks[-1]["x"] >= _APART):
            ticks.append({"x": x, "text": f"{p:g}" if p < 0.99999 else f"1 − {1 - p:.0e}"})
    return place, ticks


def _odds(p: float) -> float:
    p = min(1 - _SURE, max(_SURE, p))
    return math.log10(p / (1 - p))
