"""Distributions of robustness, P over a parameter, and frontiers as reports and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from stltool.checking import Frontier, ParametricResult
from stltool.files import write_result
from stltool.logic.printer import with_names
from stltool.logic.task import Task
from stltool.numbers import bound_texts, most_text, within_text
from stltool.reporting.frontiers import frontier_data
from stltool.reporting.monitoring import jsonable, robustness_text
from stltool.reporting.records import (
    FrontierReport,
    ParametricRecord,
    ParametricReport,
    RobustnessRecord,
    RobustnessReport,
)
from stltool.reporting.tradeoffs import require_picture
from stltool.reporting.words import SentenceRecord, sentences

ROBUSTNESS_FORMAT, PARAMETRIC_FORMAT = "stltool-robustness-1", "stltool-parametric-1"
FRONTIER_FORMAT = "stltool-frontier-1"
_VERDICTS = {True: ("holds", "good"), False: ("does not hold", "bad"), None: ("undecided", "")}


# -------------------------------------------------------------------------------------------------------- robustness


def robustness_report(
    task: Task,
    found: RobustnessRecord,
    beside: RobustnessRecord,
    command: str | None = None,
    margin: float | None = None,
) -> RobustnessReport:
    """Everything that the page of a distribution shows. `beside`: of the optimum, the distribution of the policy that
    is best for P; of a policy, the optimum. `margin`: one that the page marks."""
    words = sentences(task.formula, with_names(task.predicates))
    version = metadata.version("stltool")
    return {
        **found, "beside": beside, "format": "stltool-robustness-1", "version": version, "command": command,
        "words": words, "margin": jsonable(np.array([margin]))[0] if margin is not None else None,
    }  # fmt: skip


def robustness_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the template answer.html needs for a distribution of robustness."""
    own = data["question"] == "policy"
    optimum, policy = (data["beside"], data) if own else (data, data["beside"])
    which = "the policy" if own else "the policy that is best for P"
    return {
        "value": _largest(optimum),
        "chip": _chip(data, _at(data)),
        "lead": contrast(optimum, policy, which),
        "picture": survival_picture(data, "svg"),
        "note": f"The {optimum['question']} over all policies is for each margin by itself: different margins have "
        "different best policies. Every P is enclosed, rounding included.",
        "tables": {"The optimum for each margin": _rows(optimum), which.capitalize(): _rows(policy)},
        "facts": {
            **({f"P{_at(data)}": " … ".join(bound_texts(*_enclosure(data)))} if data["margin"] is not None else {}),
            "mean robustness": " … ".join(bound_texts(*data["mean"])) if data["mean"] else "not finite",
        },
    }


def _at(data: Mapping[str, Any]) -> str:
    """The margin that was asked for, in words."""
    return f" at margin {robustness_text(float(data['margin']))}" if data["margin"] is not None else ""


def _enclosure(data: Mapping[str, Any]) -> tuple[float, float]:
    """P of the margin that was asked for: that of the next larger one that is possible."""
    rows = zip(map(float, data["values"]), data["lower"], data["upper"], strict=True)
    return next(((low, high) for r, low, high in rows if r >= float(data["margin"])), (0.0, 0.0))


def contrast(optimum: Mapping[str, Any], policy: Mapping[str, Any], which: str) -> str:
    """What a policy leaves on the table: its largest margin, and the larger ones that are possible."""
    never = _largest_value(policy)
    if never is None:
        return "The robustness is infinite: labels or constants decide."
    said = f"{which[0].upper()}{which[1:]} never has a margin above {robustness_text(never)}"
    more = [
        f"{robustness_text(r)} is possible at {within_text(p, p, q, 5)}"
        for r, p, q in zip(map(float, optimum["values"]), optimum["lower"], optimum["upper"], strict=True)
        if r > never and p > 0
    ]
    return f"{said}; {', '.join(more[:3])}." if more else f"{said}, and no policy has one."


def survival_picture(data: Mapping[str, Any], kind: str) -> str | bytes:
    """P(robustness ≥ r) of the optimum and of the policy next to it."""
    from stltool.reporting.figures import survival

    own = data["question"] == "policy"
    optimum, policy = (data["beside"], data) if own else (data, data["beside"])
    names = (f"{optimum['question']}, for each r by itself", "the policy" if own else "the policy that is best for P")
    curves = []
    for name, one in zip(names, (optimum, policy), strict=True):
        rows = list(zip(map(float, one["values"]), one["lower"], strict=True))
        finite = [(r, p) for r, p in rows if math.isfinite(r)]
        beyond = next((p for r, p in rows if r == math.inf), 0.0)
        curves.append({"name": name, "values": [r for r, _ in finite], "p": [p for _, p in finite], "beyond": beyond})
    margin = data.get("margin")  # of a page alone
    return survival(curves, kind, float(margin) if margin is not None else None)


def _largest_value(data: Mapping[str, Any]) -> float | None:
    """The largest margin that is possible; None if it is infinite."""
    largest = max((r for r, p in zip(map(float, data["values"]), data["upper"], strict=True) if p > 0), default=None)
    return largest if largest is not None and math.isfinite(largest) else None


def _largest(data: Mapping[str, Any]) -> str:
    largest = _largest_value(data)
    return f"margins up to {robustness_text(largest)}" if largest is not None else "infinite margins"


def _rows(data: Mapping[str, Any]) -> list[dict[str, str]]:
    rows = zip(map(float, data["values"]), data["lower"], data["upper"], strict=True)
    return [
        {"r": robustness_text(r), **dict(zip(("lower ≤ P", "P ≤ upper"), bound_texts(low, high), strict=True))}
        for r, low, high in rows
    ]


# -------------------------------------------------------------------------------------------------------- parameters


def parametric_report(found: ParametricResult, data: ParametricRecord, command: str | None = None) -> ParametricReport:
    """Everything that the page of P over a parameter shows; `data` as made by `parametric_data`, with verdicts."""
    product = found.product
    words: SentenceRecord = sentences(product.formula, with_names(product.definitions))
    version = metadata.version("stltool")
    return {**data, "format": "stltool-parametric-1", "version": version, "command": command, "words": words}


def parametric_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the template answer.html needs for P over a parameter."""
    from stltool.reporting.figures import parameter_curve

    name, pieces = data["parameter"], data["pieces"]
    least, greatest = bound_texts(data["least"][0], data["greatest"][1])
    optimal = [piece for piece in pieces if piece["optimal"]]
    note = f"The bounds hold for every value of {name}, rounding included; at most {most_text(data['gap'])} apart."
    if optimal:
        sure = "which is proved in fractions" if optimal[0].get("proved") else "up to rounding"
        note += f" On {len(optimal)} of {len(pieces)} pieces one policy is optimal throughout, {sure}."
    smallest = [smallest_text(data)] if "smallest" in data else []
    lead = f"{least} ≤ P ≤ {greatest} for {name} from {data['from']:g} to {data['to']:g}"
    return {
        "value": f"P over {name}, {'of the policy' if data['question'] == 'policy' else 'the ' + data['question']}",
        "chip": _chip(data),
        "lead": "; ".join([lead, *smallest]) + ".",
        "picture": parameter_curve(data, "svg"),
        "note": note,
        "tables": {
            "Values": [
                {name: f"{point['value']:.12g}",
                 **dict(zip(("lower ≤ P", "P ≤ upper"), bound_texts(point["lower"], point["upper"]), strict=True))}
                for point in data["points"]
            ],
        },
        "facts": {"pieces": f"{len(pieces)}, {data['status']}", "horizon": data["horizon"]},
    }  # fmt: skip


def smallest_text(data: Mapping[str, Any]) -> str:
    """The smallest value that reaches the bound, in words."""
    name, found = data["parameter"], data["smallest"]
    if found is None:
        return f"no {name} of the range reaches {data['at_least']:g}"
    below, enough = f"{found['below']:.9g}", found["enough"]
    if enough is None:
        return f"no {name} below {below} reaches {data['at_least']:g}, and none is proved to"
    return f"{name} = {enough:.9g} reaches {data['at_least']:g}, none below {below} does"


def _chip(data: Mapping[str, Any], where: str = " everywhere") -> dict[str, str] | None:
    if "holds" not in data:
        return None
    text, kind = _VERDICTS[data["holds"] if data["decided"] else None]
    return {"text": f"{text}{where}", "kind": kind}


# --------------------------------------------------------------------------------------------------------- frontiers


def frontier_report(found: Frontier, command: str | None = None) -> FrontierReport:
    """Everything that a frontier's page shows."""
    words = sentences(found.task.formula, with_names(found.task.predicates))
    version = metadata.version("stltool")
    return {
        **frontier_data(found), "format": "stltool-frontier-1", "version": version, "command": command, "words": words,
    }  # fmt: skip


def frontier_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the template answer.html needs for a frontier."""
    from stltool.reporting.figures import frontier_picture

    names = [param["name"] for param in data["params"]]
    held = {True: "yes", False: "no", None: "undecided"}
    reached = sum(step["tightest"] is not None for step in data["steps"])
    lead = f"{len(data['probes'])} checks, by {data['method']}"
    if data["steps"] and len(names) == 2:
        lead += f"; the bound is reached for {reached} of {len(data['steps'])} values of {names[0]}"
    elif data["steps"]:
        tightest = data["steps"][0]["tightest"]
        lead += f"; the tightest {names[0]} is {tightest}" if reached else "; none of the values reaches the bound"
    rows = [
        {**dict(zip(names, probe["values"], strict=True)), "reached": held[probe["holds"]],
         **dict(zip(("lower ≤ P", "P ≤ upper"), bound_texts(probe["lower"], probe["upper"]), strict=True))}
        for probe in data["probes"]
    ]  # fmt: skip
    directions = {1: "larger is weaker", -1: "larger is stronger", 0: "no direction is proved"}
    return {
        "value": f"{data['question']} P ≥ {data['bound']:g}, over {' and '.join(names)}",
        "chip": None,
        "lead": f"{lead}.",
        "picture": frontier_picture(data, "svg"),
        "note": "Every P is that of an exact check, with its enclosure; nothing is said of values in between.",
        "tables": {"The checks": rows},
        "facts": {param["name"]: directions[param["direction"]] for param in data["params"]},
    }


def write_answer_picture(data: Mapping[str, Any], path: str | Path) -> None:
    """Write the picture of a report's data, whole or not at all."""
    from stltool.reporting.figures import frontier_picture, parameter_curve

    draw = {
        ROBUSTNESS_FORMAT: survival_picture, PARAMETRIC_FORMAT: parameter_curve, FRONTIER_FORMAT: frontier_picture,
    }[data["format"]]  # fmt: skip
    require_picture(path)
    write_result(path, draw(data, Path(path).suffix.lower()[1:]), "picture")
