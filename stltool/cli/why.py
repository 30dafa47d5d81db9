"""`stltool why`: the runs behind a probability, and the states that it depends on most."""

from __future__ import annotations

from typing import Annotated

import typer

from stltool.arguments import whole
from stltool.cli.app import app
from stltool.cli.options import (
    READ,
    AsJson,
    Encoding,
    Model,
    ModelReading,
    Nominal,
    Params,
    PolicyFile,
    PolicyFunction,
    TaskFile,
    TaskName,
)
from stltool.cli.steps import given_policy, make_product, require_one_policy
from stltool.errors import SettingsError


@app.command("stltool why patrolling.stl --policy policy.npz")
def why(
    task: TaskFile,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    minimize: Annotated[bool, typer.Option("--minimize", help="the worst policy instead of the best")] = False,
    satisfying: Annotated[
        bool, typer.Option("--satisfying", help="runs that satisfy the task instead of those that violate it")
    ] = False,
    count: Annotated[int, typer.Option("--count", "-k", metavar="K", help="runs to print")] = 5,
    mass: Annotated[
        float | None, typer.Option("--mass", metavar="SHARE", help="smallest set of runs with this share, such as 0.9")
    ] = None,
    most: Annotated[int, typer.Option("--most", metavar="N", help="maximum size of that set")] = 10_000,
    states: Annotated[int, typer.Option("--states", metavar="N", help="most sensitive states to print")] = 5,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Explain P: the most probable runs that violate the task, and the states that P depends on most."""
    import stltool as stl
    from stltool.reporting import likely_data, product_data, sensitivity_data
    from stltool.reporting.records import WhyOutput
    from stltool.reporting.terminal import (
        print_facts,
        print_findings,
        print_json,
        print_likely,
        print_sensitive,
        progress_bar,
    )

    named = require_one_policy(policy, policy_function)
    if minimize and named is not None:
        option = "--policy" if policy is not None else "--policy-function"
        raise SettingsError(f"--minimize asks for the worst policy, {option} for a given one; keep one of them")
    count = whole(count, "--count", least=1)
    states = whole(states, "--states", least=0)
    product = make_product(task, model, param, name, encoding, as_json, nominal=nominal, reading=reading)
    given = given_policy(product, policy, policy_function)
    if given is None:
        with progress_bar("checking", quiet=as_json) as bar:
            result = stl.check(product, maximize=not minimize, progress=bar)
    followed = given if given is not None else result.policy
    assert followed is not None  # set by every check
    with progress_bar("finding runs", quiet=as_json) as bar:
        likely = stl.likely_runs(
            product, followed, satisfied=satisfying, count=count, mass=mass, most=most, progress=bar
        )
    with progress_bar("finding derivatives", quiet=as_json) as bar:
        moves = stl.sensitivity(product, followed, progress=bar)
    if given is not None:
        result = stl.check(product, given)
    data: WhyOutput = {
        **product_data(product),
        "question": result.question,
        "policy": followed.kind,
        "probability": result.probability,
        "lower": result.lower,
        "upper": result.upper,
        "asked_mass": mass,
        **likely_data(likely),
        "sensitive": sensitivity_data(moves, states),
    }
    if as_json:
        print_json(data)
        return
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "policy": f"{named or result.question + ' over all policies'} ({followed.kind})",
        "P": f"{result.probability:.15g}",
    })  # fmt: skip
    print_likely(data, count)
    if states:
        print_sensitive(data["sensitive"])
    print_findings(data)
