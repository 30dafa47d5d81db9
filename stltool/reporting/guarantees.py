"""Guarantees from data as plain data, and as the rows that terminal and report show next to the exact value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from stltool.checking import Estimate
from stltool.errors import SettingsError
from stltool.numbers import floor_text
from stltool.reporting.records import CheckRecord, GuaranteeRecord

if TYPE_CHECKING:
    from stltool.learning import Guarantee


def guarantee_data(found: Guarantee | Estimate) -> GuaranteeRecord:
    """One guarantee, flat."""
    data: GuaranteeRecord
    if not isinstance(found, Estimate):
        data = {
            "source": "learning data" if found.fresh is None else "best of both",
            "lower": found.lower,
            "confidence": found.confidence,
            "seconds": found.seconds,
            "assumes": found.assumes,
            "statement": found.statement,
            "support": found.support,
            "transitions": found.transitions,
            "choices": found.choices,
            "never_tried": found.never_tried,
        }
        if found.parameters:
            data["parameters"] = [
                {
                    "name": one.name,
                    "lower": float(one.lower),
                    "upper": float(one.upper),
                    "estimate": float(one.estimate),
                    "transitions": one.transitions,
                }
                for one in found.parameters
            ]
            data["evidence_against_tie"] = found.evidence
            data["looser"] = found.looser
        if found.fresh is not None:
            data |= {"runs": found.fresh.runs, "satisfied": found.fresh.satisfied, "seed": found.fresh.seed}
        return data
    if found.side == "upper":
        raise SettingsError('an estimate with side="upper" gives no lower bound; make it with side="lower"')
    return {
        "source": "fresh runs",
        "lower": found.lower,
        "confidence": found.confidence,
        "seconds": found.seconds,
        "assumes": "the runs are independent of each other and of the learning",
        "statement": found.statement,
        "runs": found.runs,
        "satisfied": found.satisfied,
        "seed": found.seed,
    }


def looser_note(guarantees: Sequence[GuaranteeRecord]) -> str | None:
    """Why bounds of `guarantee_data` may be lower than what they assume allows; None if none is."""
    reasons = dict.fromkeys(told for data in guarantees if (told := data.get("looser")))  # each once
    return "; ".join(reasons) or None


def refused_data(reason: str, transitions: int, confidence: float) -> GuaranteeRecord:
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


def guarantee_rows(guarantees: Sequence[GuaranteeRecord], checks: Sequence[CheckRecord] = ()) -> list[dict[str, str]]:
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
