"""`stltool check --robustness`: by how much the task holds."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from stltool.cli.bounds import VERDICTS, Asked, conclude
from stltool.cli.steps import this_command
from stltool.errors import SettingsError
from stltool.logic.timing import Reading
from stltool.numbers import NumberError, bound_texts, read

if TYPE_CHECKING:
    from stltool.logic.task import Task
    from stltool.models import MDP
    from stltool.policy import Policy
    from stltool.reporting.records import RobustnessRecord, TimingRecord


def read_margin(text: str) -> float:
    """The number of `--margin`."""
    try:
        return float(read(text))
    except (NumberError, OverflowError) as error:
        raise SettingsError(f"--margin {text}: {error}; write, for example, --margin 0.1") from None


def check_margins(
    task: Task,
    model: MDP,
    policy: Policy | None,
    margin: float | None,
    maximize: bool,
    bounds: list[tuple[str, str, Fraction]],
    as_json: bool,
    plot: Path | None = None,
    report: Path | None = None,
) -> bool:
    """Print P(robustness >= r), for one r or all, and write the picture and page of all; whether every bound holds.

    Without a margin, the bound `--at-least` asks for the largest one whose probability is at least that.
    """
    import stltool as stl
    from stltool.reporting import robustness_data, robustness_report, write_answer_picture, write_report
    from stltool.reporting.monitoring import robustness_text
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    facts: dict[str, str] = {}
    only, holds = [margin] if margin is not None else None, True
    if margin is None and bounds:
        [(_, text, bound)] = bounds
        with progress_bar("checking", quiet=as_json):
            largest, found = stl.largest_margin(model, task, bound, policy, maximize=maximize)
        facts[f"largest margin with P >= {text}"] = robustness_text(largest) if found is not None else "there is none"
        only, holds = [largest] if found is not None else [], found is not None
    with progress_bar("checking", quiet=as_json) as bar:
        distribution = None
        if only != []:
            distribution = stl.robustness_distribution(
                model, task, policy, margins=only, maximize=maximize, progress=bar
            )
    data = robustness_data(task, model, distribution, "policy" if policy is not None else None, maximize)
    if margin is None and bounds:
        data["at_least"], data["holds"], data["decided"] = float(bounds[0][2]), holds, True
    elif bounds:
        assert margin is not None
        assert distribution is not None
        holds = _judge(bounds, {"": distribution.at(margin)}, data, facts)
    if plot is not None or report is not None:
        with progress_bar("the policy that is best for P" if policy is None else "the optimum", quiet=as_json) as bar:
            whole = distribution
            if only is not None:  # the page shows where the margin lies among all of them
                whole = stl.robustness_distribution(model, task, policy, maximize=maximize)
            other = None
            if policy is None:
                other = stl.check(stl.build_product(model, task), maximize=maximize).policy
            beside = stl.robustness_distribution(model, task, other, maximize=maximize, progress=bar)
        judged: Literal["policy"] | None = "policy" if policy is None else None
        asked_of: Literal["policy"] | None = "policy" if policy is not None else None
        shown = robustness_data(task, model, whole, asked_of, maximize)
        for key in ("at_least", "at_most", "holds", "decided"):
            if key in data:
                shown[key] = data[key]
        page = robustness_report(
            task, shown, robustness_data(task, model, beside, judged, maximize), this_command(),
            only[0] if only else None,
        )  # fmt: skip
        if plot is not None:
            write_answer_picture(page, plot)
            facts["plot"] = str(plot)
        if report is not None:
            write_report(page, report / "report.html")
            facts["report"] = str(report / "report.html")
    if as_json:
        print_json(data)
        return holds
    asked = {"policy": "the policy"}.get(data["question"], f"{data['question']} over all policies")
    print_facts(
        {"task": str(task), "P": f"{asked}, that the robustness is at least r{', for each r' * (only is None)}"}
    )
    if distribution is not None:
        ends = ("lower_bound", "upper_bound")
        print_table([
            {"r": robustness_text(r), **dict(zip(ends, bound_texts(lower, upper), strict=True))}
            for r, lower, upper in distribution.steps()
        ])  # fmt: skip
        if distribution.mean is not None:
            least, most = bound_texts(*distribution.mean)
            facts["mean robustness"] = f"from {least} to {most}"
    print_facts(facts)
    return holds


def _judge(
    bounds: list[tuple[str, str, Fraction]],
    found: Mapping[str, tuple[float, float]],
    data: RobustnessRecord | TimingRecord,
    facts: dict[str, str],
) -> bool:
    """Whether every bound holds on every enclosure, by what it is of; the verdicts are added to data and facts."""
    verdicts: list[bool | None] = []
    for option, text, bound in bounds:
        asked = Asked(option, text, bound, data)
        for of, ends in found.items():
            verdicts.append(asked.judge(*ends))
            facts[f"P {asked.text}{of}"] = VERDICTS[verdicts[-1]]
    return conclude(verdicts, data)


_READINGS: dict[Reading, tuple[str, str]] = {
    "predicates": ("predicates", "every predicate keeps its truth for k more steps, wherever it is read"),
    "task": ("whole task", "the whole task holds from each of the steps 0 to k on"),
}


def check_timing(
    task: Task,
    model: MDP,
    policy: Policy | None,
    most: int,
    margin: float | None,
    maximize: bool,
    bounds: list[tuple[str, str, Fraction]],
    as_json: bool,
) -> bool:
    """Print P(time robustness >= k) for k = 0 … most; whether every bound holds on that of `most`, in both readings."""
    import stltool as stl
    from stltool.reporting import timing_data
    from stltool.reporting.monitoring import robustness_text
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    with progress_bar("checking", quiet=as_json) as bar:
        found = stl.time_distribution(model, task, most, policy, margin=margin, maximize=maximize, progress=bar)
    data, facts = timing_data(found), dict[str, str]()
    holds = not bounds or _judge(
        bounds, {f", k = {most}, {name}": found.at(most, one) for one, (name, _) in _READINGS.items()}, data, facts
    )
    if as_json:
        print_json(data)
        return holds
    asked = "the policy" if policy is not None else f"{found.question} over all policies"
    kept = f" with robustness of at least {robustness_text(margin)}" if margin is not None else ""
    print_facts({
        "task": str(task),
        "P": f"{asked}, that the task holds{kept} and tolerates k steps, for each k",
        **dict(_READINGS.values()),
    })  # fmt: skip
    rows = []
    for k in range(most + 1):
        row: dict[str, object] = {"k": k}
        for one, (name, _) in _READINGS.items():
            lower, upper = bound_texts(*found.at(k, one))
            row |= {f"{name} lower": lower, f"{name} upper": upper}
        rows.append(row)
    print_table(rows)
    print_facts(facts)
    return holds
