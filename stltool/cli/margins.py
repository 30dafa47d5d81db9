"""`stltool check --robustness`: by how much the task holds."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from stltool.errors import SettingsError
from stltool.numbers import NumberError, bound_texts, read

if TYPE_CHECKING:
    from stltool.logic.task import Task
    from stltool.models import MDP
    from stltool.policy import Policy

_VERDICTS = {True: "holds", False: "does not hold", None: "undecided: the bound lies inside the enclosure"}


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
) -> bool:
    """Print P(robustness >= r), for one r or all; whether every bound holds on it.

    Without a margin, the bound `--at-least` asks for the largest one whose probability is at least that.
    """
    import stltool as stl
    from stltool.reporting import robustness_data
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
        verdicts = []
        lower, upper = distribution.at(margin)
        for option, text, bound in bounds:
            below = option == "--at-least"
            data["at_least" if below else "at_most"] = float(bound)
            sure, never = (lower >= bound, upper < bound) if below else (upper <= bound, lower > bound)
            verdicts.append(True if sure else False if never else None)
            facts[f"P {'>=' if below else '<='} {text}"] = _VERDICTS[verdicts[-1]]
        data["holds"] = holds = all(verdict is True for verdict in verdicts)
        data["decided"] = all(verdict is not None for verdict in verdicts)
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
