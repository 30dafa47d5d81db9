"""Guarantees from data as plain data, and as the rows that terminal and report show next to the exact value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stltool.checking import Estimate
from stltool.errors import SettingsError
from stltool.numbers import floor_text

if TYPE_CHECKING:
    from stltool.learning import Guarantee


def guarantee_data(found: Guarantee | Estimate) -> dict[str, Any]:
    """One guarantee, flat."""
    if not isinstance(found, Estimate):
        details: dict[str, Any] = {
            "source": "learning data" if found.fresh is None else "best of both",
            "support": found.support,
            "transitions": found.transitions,
            "choices": found.choices,
            "never_tried": found.never_tried,
            "assumes": found.assumes,
        }
        if found.parameters:
            details["parameters"] = [
                {
                    "name": one.name,
                    "lower": float(one.lower),
                    "upper": float(one.upper),
                    "estimate": float(one.estimate),
                    "transitions": one.transitions,
                }
                for one in found.parameters
            ]
            details["evidence_against_tie"] = found.evidence
            details["looser"] = found.looser
        if found.fresh is not None:
            details |= {"runs": found.fresh.runs, "satisfied": found.fresh.satisfied, "seed": found.fresh.seed}
    elif found.side == "upper":
        raise SettingsError('an estimate with side="upper" gives no lower bound; make it with side="lower"')
    else:
        details = {
            "source": "fresh runs",
            "runs": found.runs,
            "satisfied": found.satisfied,
            "seed": found.seed,
            "assumes": "the runs are independent of each other and of the learning",
        }
    bound = {"lower": found.lower, "confidence": found.confidence, "seconds": found.seconds}
    return {**details, **bound, "statement": found.statement}


def looser_note(guarantees: Sequence[dict[str, Any]]) -> str | None:
    """Why bounds of `guarantee_data` may be lower than what they assume allows; None if none is."""
    reasons = dict.fromkeys(data["looser"] for data in guarantees if data.get("looser"))  # each once
    return "; ".join(reasons) or None


def refused_data(reason: str, transitions: int, confidence: float) -> dict[str, Any]:
    """A guarantee that is not given, since the data contradict what it would assume."""
    return {
        "source": "learning data",
        "transitions": transitions,
        "lower": 0.0,
        "confidence": confidence,
        "seconds": 0.0,
        "refused": reason,
        "assumes": "one parameter for all rows, which the data contradict",
        "statement": f"no bound is given: {reason}",
    }


def guarantee_rows(guarantees: Sequence[dict[str, Any]], checks: Sequence[dict[str, Any]] = ()) -> list[dict[str, Any]]:
    """The rows shown for `guarantee_data`, preceded by the exact check of the policy if `checks` has one."""
    rows = [
        {
            "guaranteed_by": "exact check",
            "P_at_least": floor_text(check["lower"]),
            "confidence": "certain",
            "assumes": "the model, including its probabilities",
        }
        for check in checks
        if check["question"] == "policy"
    ][:1]
    for data in guarantees:
        numbers = [f"{data[key]} {key}" for key in ("transitions", "runs") if key in data]
        samples = " and ".join(numbers) + ("; looser, see below" if data.get("looser") else "")
        rows.append({
            "guaranteed_by": f"{data['source']}, {samples}",
            "P_at_least": floor_text(data["lower"]) if "refused" not in data else "refused",
            "confidence": f"{100 * data['confidence']:.12g} %",
            "assumes": data["assumes"] if data["source"] != "best of both" else "what these two assume",
        })  # fmt: skip
    return rows
