"""`stltool check --cost`: expected costs, the least, the greatest and a policy's; with `--within`, the probability that
the task holds within a budget."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from stltool.arguments import one_of
from stltool.cli.bounds import WITH_EXACT, Asked, conclude
from stltool.errors import SettingsError
from stltool.numbers import NumberError, bound_texts, fraction_text, number_text, read, within_text
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.checking.costs import Until
    from stltool.checking.robust import Nature
    from stltool.policy import Policy
    from stltool.product import Product


_LONGEST_FRACTION = 40  # characters in a table


def check_cost(product: Product, policy: Policy | None, cost: str, until: str, exact: bool, as_json: bool) -> None:
    """Print the enclosures of expected costs."""
    import stltool as stl
    from stltool.checking.costs import Until
    from stltool.reporting import costs_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    one_of(until, "--until", get_args(Until))
    ends = cast("Until", until)
    with progress_bar("checking", quiet=as_json) as bar:
        found = [
            stl.expected_cost(product, cost, maximize=maximize, exact=exact, until=ends, progress=bar)
            for maximize in (False, True)
        ]
    if policy is not None:
        found.append(stl.expected_cost(product, cost, policy, exact=exact, until=ends))
    if as_json:
        print_json(costs_data(found))
        return
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "cost": f"{cost}, " + ("until the verdict" if until == "verdict" else f"over {product.horizon} steps"),
    })  # fmt: skip
    rows = []
    for one in found:
        lower, upper = bound_texts(one.lower, one.upper)
        exactly = fraction_text(one.fraction, _LONGEST_FRACTION) if one.fraction is not None else ""
        rows.append({
            f"E[{cost}]": within_text(one.value, one.lower, one.upper), "lower_bound": lower, "upper_bound": upper,
            "of": "the policy" if one.question == "policy" else f"{one.question} over all policies",
            **({"exactly": exactly} if exact else {}),
        })  # fmt: skip
    say()
    print_table(rows)


def read_budget(text: str) -> Fraction:
    """The number of `--within`."""
    try:
        return read(text)
    except NumberError as error:
        raise SettingsError(f"--within {text}: {error}; write, for example, --within 12") from None


def check_within(
    product: Product,
    policy: Policy | None,
    cost: str,
    budget: Fraction,
    maximize: bool,
    exact: bool,
    nature: Nature,
    bounds: list[tuple[str, str, Fraction]],
    save_policy: Path | None,
    as_json: bool,
) -> bool:
    """Print P(task and cost <= c) for every c up to the budget; whether every bound holds for the budget."""
    import stltool as stl
    from stltool.reporting import cost_distribution_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    with progress_bar("checking", quiet=as_json) as bar:
        found = stl.cost_distribution(
            product, cost, budget, policy, maximize=maximize, exact=exact, nature=nature, progress=bar
        )
    if save_policy is not None:
        found.policy.save(save_policy)
    data = cost_distribution_data(found)
    facts: dict[str, object] = {}
    verdicts: list[bool | None] = []
    lower, upper = ends if (ends := (found.exactly(budget),) * 2) != (None, None) else found.at(budget)
    assert lower is not None
    assert upper is not None
    for option, text, bound in bounds:
        given = Asked(option, text, bound, data)
        verdicts.append(given.judge(lower, upper))
        facts[f"P {given.text} with {cost} <= {number_text(budget)}"] = WITH_EXACT[verdicts[-1]]
        if given.below:
            smallest = found.smallest(bound)
            known = number_text(smallest) if smallest is not None else f"more than {number_text(budget)}"
            facts[f"smallest budget with P >= {text}"] = known
    if verdicts:
        conclude(verdicts, data)
    if as_json:
        print_json(data)
        return data.get("holds", True)
    asked = "the policy" if found.question == "policy" else f"{found.question} over all policies, for each c by itself"
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "P": f"{asked}: the task holds and {cost} until the verdict is at most c",
        **({"nature": found.nature} if found.nature is not None else {}),
    })  # fmt: skip
    say()
    last, exactly = len(found.budgets) - 1, found.fractions
    print_table([
        {
            "c": number_text(found.budgets[i]),
            **dict(zip(("lower_bound", "upper_bound"), bound_texts(found.lower[i], found.upper[i]), strict=True)),
            **({"exactly": fraction_text(exactly[i], _LONGEST_FRACTION)} if exactly is not None else {}),
        }
        for i in range(last + 1)
        if i in (0, last) or (found.lower[i], found.upper[i]) != (found.lower[i - 1], found.upper[i - 1])
    ])  # fmt: skip
    if save_policy is not None:
        facts["policy"] = save_policy
    print_facts(facts)
    return not verdicts or data["holds"]
