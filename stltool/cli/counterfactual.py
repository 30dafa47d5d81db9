"""`stltool counterfactual`: what would have become of a run, had another action been taken."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stltool.cli.app import app
from stltool.cli.options import (
    READ,
    AsJson,
    Encoding,
    Model,
    ModelReading,
    Params,
    PolicyFile,
    PolicyFunction,
    TaskFile,
    TaskName,
)
from stltool.cli.roles import Reads
from stltool.cli.steps import given_policy, make_product, require_one_policy
from stltool.cli.words import Named
from stltool.errors import SettingsError

if TYPE_CHECKING:
    from stltool.checking.induction import Progress
    from stltool.checking.sampling import Run
    from stltool.policy import Policy
    from stltool.product import Product


def most_probable_violation(product: Product, policy: Policy | None, progress: Progress | None) -> Run:
    """SettingsError if the task cannot be violated."""
    import stltool as stl

    found = stl.likely_runs(product, policy, count=1, progress=progress).runs
    if not found:
        raise SettingsError("no run of this policy violates the task; give a run: --run FILE")
    return found[0]


@app.command("stltool counterfactual patrolling.stl --run run.csv --at 3")
def counterfactual(
    task: TaskFile,
    run: Annotated[
        Path | None,
        typer.Option(
            "--run",
            metavar="FILE",
            help="what happened: .csv with columns state,action, or .json of stltool play --json; default: the most "
            "probable violation",
        ),
        Reads("run"),
    ] = None,
    at: Annotated[
        int | None, typer.Option("--at", metavar="STEP", help="only this step, from 0"), Named("step")
    ] = None,
    action: Annotated[str | None, typer.Option("--action", metavar="NAME", help="only this action")] = None,
    coupling: Annotated[
        Literal["noise", "order", "independent"] | None,
        typer.Option(
            "--coupling",
            help="what is assumed of the noise of different actions; default: noise where the model names its outcomes "
            "(grids), else independent",
        ),
    ] = None,
    exact: Annotated[bool, typer.Option("--exact", help="as fractions, too")] = False,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """What if: P that a run would have satisfied the task, had another action been taken at one of its steps."""
    import stltool as stl
    from stltool.reporting import counterfactual_data
    from stltool.reporting.terminal import print_json, print_what_if, progress_bar

    named = require_one_policy(policy, policy_function)
    observed = stl.load_run(run) if run is not None else None
    product = make_product(task, model, param, name, encoding, as_json, reading=reading)
    followed = given_policy(product, policy, policy_function)
    with progress_bar("checking", quiet=as_json) as bar:
        followed = followed if followed is not None else stl.check(product, progress=bar).policy
    with progress_bar("finding the run", quiet=as_json) as bar:
        happened = observed or most_probable_violation(product, followed, bar)
    found = stl.counterfactual(product, happened, at, action, policy=followed, coupling=coupling, exact=exact)
    data = counterfactual_data(found)
    if as_json:
        print_json(data)
        return
    print_what_if(data, str(run) if run is not None else "the most probable violation", named, at is None)
