"""`stltool estimate`: the probability from sampled runs, with an interval, or a sequential test of a bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

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
    ReportFolder,
    Seed,
    TaskFile,
    TaskName,
)
from stltool.cli.steps import given_policy, make_product, read_probability, require_one_policy, this_command
from stltool.errors import SettingsError


@app.command("stltool estimate patrolling.stl --policy policy.npz --epsilon 0.01")
def estimate(
    task: TaskFile,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    runs: Annotated[int | None, typer.Option("--runs", "-n", help="runs to sample; default: 10000")] = None,
    epsilon: Annotated[
        float | None,
        typer.Option(
            "--epsilon", metavar="E", help="sample as many runs as needed for bounds within E of the estimate"
        ),
    ] = None,
    confidence: Annotated[
        float | None, typer.Option("--confidence", help="confidence level of the interval; default: 0.99")
    ] = None,
    side: Annotated[str | None, typer.Option("--side", help="both bounds (default), or only lower or upper")] = None,
    at_least: Annotated[
        str | None,
        typer.Option("--at-least", metavar="P", help="sequential test of the bound P; exit code 1 unless it holds"),
    ] = None,
    indifference: Annotated[
        float | None,
        typer.Option(
            "--indifference",
            metavar="D",
            help="for --at-least: within D of P, either answer is accepted; default: 0.01",
        ),
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option("--alpha", help='for --at-least: probability of a wrong "does not hold"; default: 0.01'),
    ] = None,
    beta: Annotated[
        float | None, typer.Option("--beta", help='for --at-least: probability of a wrong "holds"; default: 0.01')
    ] = None,
    most_runs: Annotated[
        int | None,
        typer.Option("--most-runs", help="for --at-least: undecided after this many runs; default: 10000000"),
    ] = None,
    no_exact: Annotated[bool, typer.Option("--no-exact", help="skip the exact check of the policy")] = False,
    seed: Seed = 0,
    report: ReportFolder = None,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The probability that the task holds, from sampled runs of a policy: an interval, or a test of a bound."""
    import stltool as stl
    from stltool.checking.statistical import hypotheses, planned_runs
    from stltool.reporting import estimate_data, estimate_report, require_report, write_report
    from stltool.reporting.terminal import print_facts, print_json, progress_bar

    fixed = _given(runs=runs, epsilon=epsilon, confidence=confidence, side=side)
    sequential = _given(indifference=indifference, alpha=alpha, beta=beta, most_runs=most_runs)
    bound = float(read_probability(at_least, "--at-least")) if at_least is not None else None
    if bound is None and sequential:
        raise SettingsError(f"{_option(sequential)} belongs to a sequential test; give --at-least P with it")
    if bound is not None and fixed:
        raise SettingsError(
            f"{_option(fixed)} belongs to an interval; a sequential test takes as many runs as it needs, up to "
            "--most-runs; leave out one of the two"
        )
    given = require_one_policy(policy, policy_function)
    if report is not None:
        require_report(report / "report.html")
    if given is None and no_exact:
        raise SettingsError("--no-exact needs --policy FILE: the best policy comes from the exact check")
    if bound is None:
        planned_runs(**fixed)
    else:
        hypotheses(bound, **sequential)
    product = make_product(
        task, model, param, name, encoding, as_json, kernels=["rollouts"], nominal=nominal, reading=reading
    )
    if product.model.blackbox is not None:
        if given is None:
            raise SettingsError(
                f"{product.model.name} is a black box, whose best policy is unknown; give --policy FILE "
                "(stltool learn writes one)"
            )
        no_exact = True
    chosen = given_policy(product, policy, policy_function)
    truth = None
    if not no_exact:
        with progress_bar("checking", quiet=as_json) as bar:
            truth = stl.check(product, chosen, progress=bar)
        chosen = truth.policy if chosen is None else chosen
    assert chosen is not None
    with progress_bar("simulating", quiet=as_json) as bar:
        result: stl.Estimate | stl.SequentialTest
        if bound is None:
            result = stl.estimate(product, chosen, seed=seed, progress=bar, **fixed)
        else:
            result = stl.sprt(product, chosen, bound, seed=seed, progress=bar, **sequential)
    data: Mapping[str, Any] = estimate_data(result, product, chosen, truth)
    if report is not None:
        write_report(estimate_report(data, product, this_command()), report / "report.html")
    if as_json:
        print_json(data)
    else:
        steps = f", {result.steps} steps" if isinstance(result, stl.Estimate) else ""
        facts = {
            "task": f"{product.task_name} := {product.formula}",
            "policy": f"{given if given is not None else 'the best policy'} ({chosen.kind})",
            "runs": f"{result.runs}, {result.satisfied} satisfied{steps}, seed {result.seed}, {result.seconds:.3g} s",
            "found": data["statement"],
        }
        if truth is not None:
            inside = {True: ", in the interval", False: ", outside the interval", None: ""}[data["exact_inside"]]
            facts["exact P"] = f"{truth.probability:.12g}{inside}"
        if report is not None:
            facts["report"] = str(report / "report.html")
        print_facts(facts)
    if bound is not None and not data["holds"]:
        raise typer.Exit(1)


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _option(options: dict[str, Any]) -> str:
    return "--" + next(iter(options)).replace("_", "-")
