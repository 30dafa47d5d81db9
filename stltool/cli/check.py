"""`stltool check`: the probability that the task holds, and verdicts on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import (
    AsJson,
    Encoding,
    Model,
    Params,
    TaskFile,
    TaskName,
)
from stltool.cli.steps import make_product
from stltool.errors import SettingsError


@app.command()
def check(
    task: TaskFile,
    policy: Annotated[
        Path | None, typer.Option("--policy", help="policy file (.npz) or Q-table (.csv); default: the best of all")
    ] = None,
    minimize: Annotated[bool, typer.Option("--minimize", help="the least instead of the greatest probability")] = False,
    at_least: Annotated[
        float | None, typer.Option("--at-least", metavar="P", help="exit code 1 unless the probability is at least P")
    ] = None,
    save_policy: Annotated[
        Path | None, typer.Option("--save-policy", metavar="FILE", help="write the optimal policy (.npz)")
    ] = None,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The exact probability that the task holds: of the best policy, or of a given one."""
    import stltool as stl
    from stltool.policy import require_policy_file
    from stltool.reporting import check_data
    from stltool.reporting.terminal import print_checks, print_facts, progress_bar

    if at_least is not None and not 0 <= at_least <= 1:
        raise SettingsError(f"--at-least {at_least}: a probability lies between 0 and 1")
    product = make_product(task, model, param, name, encoding, as_json, learning=False)
    chosen = stl.load_policy(policy, product) if policy is not None else None
    if save_policy is not None:
        require_policy_file(save_policy)
    with progress_bar("checking", quiet=as_json) as bar:
        optimum = stl.check(product, maximize=not minimize, keep_policy=save_policy is not None, progress=bar)
    result = optimum if chosen is None else stl.check(product, chosen)
    if save_policy is not None and optimum.policy is not None:
        optimum.policy.save(save_policy)
    data = check_data(result, optimum)
    if at_least is not None:
        data["at_least"], data["holds"] = at_least, result.lower >= at_least
    if as_json:
        print(json.dumps(data))
    else:
        print_facts({"task": f"{product.task_name} := {product.formula}"})
        print_checks([check_data(optimum), data] if chosen is not None else [data])
        if at_least is not None:
            print_facts({f"P >= {at_least}": _verdict(result.lower, result.upper, at_least)})
    if at_least is not None and not data["holds"]:
        raise typer.Exit(1)


def _verdict(lower: float, upper: float, bound: float) -> str:
    if lower >= bound:
        return "holds"
    return "does not hold" if upper < bound else "not decided: the bound lies inside the enclosure"
