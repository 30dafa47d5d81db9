"""`stltool check --for-ever`: a task that repeats for ever."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

from stltool.cli.bounds import WITH_EXACT, Asked, conclude
from stltool.cli.options import ModelReading
from stltool.cli.steps import bind, given_policy, load_with_model, require_points
from stltool.errors import PolicyError, SettingsError
from stltool.numbers import bound_texts, fraction_text, within_text

if TYPE_CHECKING:
    from stltool.checking.long_run import LongRun, Question

_ALL = "all"
_MEANING = {
    "share": "of the steps, in the long run, at which the task holds",
    "always": "P that it holds at every step",
    "recurrence": "P that it holds at infinitely many steps",
    "persistence": "P that it holds at every step from some step on",
}
_LONGEST_FRACTION = 40  # characters in a table


def read_questions(text: str, single: Sequence[str]) -> tuple[Question, ...]:
    """The questions of `--for-ever`; `single` are the given options that need one of them."""
    from stltool.checking.long_run import QUESTIONS

    if text not in (*QUESTIONS, _ALL):
        raise SettingsError(f"--for-ever {text}: choose {', '.join(QUESTIONS)} or {_ALL}")
    if text == _ALL and single:
        names = f"{', '.join(QUESTIONS[:-1])} or {QUESTIONS[-1]}"
        raise SettingsError(f"{single[0]} is for one question; write --for-ever {names}")
    return QUESTIONS if text == _ALL else (cast("Question", text),)


def require_endless_policy_file(path: Path) -> None:
    """PolicyError unless the file can hold a policy that goes on for ever."""
    if path.suffix.lower() != ".npz":
        raise PolicyError(
            f"{path}: a policy that goes on for ever is saved as .npz; the other formats list what runs come to before "
            "a task ends"
        )


def check_for_ever(
    task: Path,
    model: Path | None,
    param: list[str] | None,
    name: str | None,
    reading: ModelReading,
    nominal: bool,
    policy: Path | None,
    policy_function: str | None,
    questions: Sequence[Question],
    minimize: bool,
    exact: bool,
    bounds: list[tuple[str, str, Fraction]],
    save_policy: Path | None,
    as_json: bool,
) -> bool:
    """Print the least and the greatest answers, and a policy's; whether every bound holds."""
    from stltool.checking.long_run import Forever
    from stltool.logic.repeated import repeated
    from stltool.reporting import long_run_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar
    from stltool.streams import say

    (loaded,), world = load_with_model(task, model, param, [name], reading, unbounded=True)
    form, inner = repeated(loaded.formula)
    if nominal and not world.uncertain:
        raise SettingsError("--nominal: the model's probabilities are not intervals; leave out --nominal")
    world = world.nominal() if nominal else world
    require_points(world, "--for-ever")
    product = bind(replace(loaded, formula=inner), world, "exact")
    chosen = given_policy(product, policy, policy_function)
    with progress_bar("checking", quiet=as_json):
        forever = Forever(product)
        optima = [forever.ask(asked, maximize, exact) for asked in questions for maximize in (False, True)]
        found = list(optima)
        if chosen is not None:
            under = Forever(product, chosen)
            found += [under.ask(asked, exact=exact) for asked in questions]
    if save_policy is not None:
        optima[0 if minimize else 1].policy.save(save_policy)
    judged = found[-1] if chosen is not None else optima[0 if minimize else 1]
    data = long_run_data(found, form, str(loaded.formula))
    facts: dict[str, object] = {}
    verdicts = []
    for option, text, bound in bounds:
        given = Asked(option, text, bound, data)
        verdicts.append(given.judge(*judged.ends))
        facts[f"{_of(judged)} of {judged.asked} {given.text}"] = WITH_EXACT[verdicts[-1]]
    if verdicts:
        conclude(verdicts, data)
    if as_json:
        print_json(data)
        return data.get("holds", True)
    repeats = {"task": f"{loaded.name} := {loaded.formula}"}
    if form is not None:
        repeats |= {"asks for": form, "repeats": str(inner)}
    print_facts({**repeats, **{asked: _MEANING[asked] for asked in questions}})
    say()
    rows = []
    for asked in questions:
        for one in found:
            if one.asked == asked:
                lower, upper = bound_texts(one.lower, one.upper)
                exactly = fraction_text(one.fraction, _LONGEST_FRACTION) if one.fraction is not None else ""
                rows.append({
                    "question": asked, "value": within_text(one.value, one.lower, one.upper), "lower_bound": lower,
                    "upper_bound": upper, "of": _of(one), **({"exactly": exactly} if exact else {}),
                })  # fmt: skip
    print_table(rows)
    if save_policy is not None:
        facts["policy"] = save_policy
    print_facts(facts)
    return not verdicts or data["holds"]


def _of(found: LongRun) -> str:
    return "the policy" if found.question == "policy" else f"{found.question} over all policies"
