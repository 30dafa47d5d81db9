"""`stltool check --cost`: expected costs, the least and the greatest over all policies, and a policy's."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast, get_args

from stltool.arguments import one_of
from stltool.numbers import bound_texts, within_text
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.checking.costs import Until
    from stltool.policy import Policy
    from stltool.product import Product


def check_cost(product: Product, policy: Policy | None, cost: str, until: str, as_json: bool) -> None:
    """Print the enclosures."""
    import stltool as stl
    from stltool.checking.costs import Until
    from stltool.reporting import costs_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    one_of(until, "--until", get_args(Until))
    ends = cast("Until", until)
    with progress_bar("checking", quiet=as_json) as bar:
        found = [
            stl.expected_cost(product, cost, maximize=maximize, until=ends, progress=bar) for maximize in (False, True)
        ]
    if policy is not None:
        found.append(stl.expected_cost(product, cost, policy, until=ends))
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
        rows.append({
            f"E[{cost}]": within_text(one.value, one.lower, one.upper), "lower_bound": lower, "upper_bound": upper,
            "of": "the policy" if one.question == "policy" else f"{one.question} over all policies",
        })  # fmt: skip
    say()
    print_table(rows)
