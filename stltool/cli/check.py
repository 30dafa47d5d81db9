"""`stltool check`: the probability that the task holds, and verdicts on bounds."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path
from typing import Annotated, cast

import typer

from stltool.cli.app import app
from stltool.cli.cost import check_cost, check_within, read_budget
from stltool.cli.for_ever import check_for_ever, read_questions, require_endless_policy_file
from stltool.cli.margins import check_margins, check_timing, read_margin
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
    TaskFile,
    TaskName,
)
from stltool.cli.roles import Reads, Writes, model_files
from stltool.cli.steps import (
    bind,
    given_policy,
    judge_by,
    load_policy_product,
    load_product,
    load_with_model,
    make_product,
    moved_policy,
    nature_text,
    read_params,
    read_probability,
    require_one_policy,
    require_points,
    resumable,
    this_command,
)
from stltool.cli.vary import check_range
from stltool.errors import SettingsError
from stltool.numbers import bound_texts, fraction_text

_LONGEST_FRACTION = 400  # characters that are printed; --json has them all
_VERDICTS = {
    True: "holds",
    False: "does not hold",
    None: "undecided: the bound lies inside the enclosure; add --exact",
}


def _policy_files(path: Path) -> list[Path]:
    """A policy file, and the files next to it while it is written."""
    from stltool.checking.induction import files_beside

    return [path, *files_beside(path)] if path.suffix.lower() == ".policy" else [path]


@app.command("stltool check patrolling.stl -p T=20 --at-least 0.95")
def check(
    task: TaskFile,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    transfer: Annotated[
        bool,
        typer.Option(
            "--transfer",
            help="judge a policy of another model, by the names of states and actions; report how the models differ",
        ),
    ] = False,
    policy_model: Annotated[
        Path | None,
        typer.Option(
            "--policy-model",
            metavar="FILE",
            help="with --transfer: the model that the policy was made for; default: the task file's model line",
        ),
        Reads("policy's model", model_files),
    ] = None,
    minimize: Annotated[
        bool, typer.Option("--minimize", help="the minimum over all policies instead of the maximum")
    ] = False,
    stationary: Annotated[
        bool,
        typer.Option(
            "--stationary",
            help="evaluate the best policy found whose action depends on model and automaton state, not on the step",
        ),
    ] = False,
    memoryless: Annotated[
        bool,
        typer.Option("--memoryless", help="evaluate the best policy found whose action depends on the state alone"),
    ] = False,
    exact: Annotated[
        bool, typer.Option("--exact", help="compute the probability as a fraction, without rounding")
    ] = False,
    at_least: Annotated[
        str | None, typer.Option("--at-least", metavar="P", help="exit code 1 unless the probability is at least P")
    ] = None,
    at_most: Annotated[
        str | None, typer.Option("--at-most", metavar="P", help="exit code 1 unless the probability is at most P")
    ] = None,
    save_policy: Annotated[
        Path | None,
        typer.Option(
            "--save-policy",
            metavar="FILE",
            help="write the optimal policy: .npz; text, .csv or .json; or .policy, written step by step, which may "
            "exceed memory",
        ),
        Writes(_policy_files),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="continue the .policy file of an interrupted run")] = False,
    certificate: Annotated[
        Path | None,
        typer.Option(
            "--certificate", metavar="FILE", help="write a certificate of the bounds; compressed if it ends in .gz"
        ),
        Writes(),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="ADDRESS", help="a dask scheduler whose workers do the computation"),
    ] = None,
    nature: Annotated[
        str | None,
        typer.Option("--nature", help="of intervals: against (adversarial, default), with (cooperative) or nominal"),
    ] = None,
    nominal: Nominal = False,
    vary: Annotated[
        str | None,
        typer.Option(
            "--vary",
            metavar="NAME=FROM:TO",
            help="P as a function of a model's parameter (a grid's: success), enclosed on the whole range",
        ),
    ] = None,
    cost: Annotated[
        str | None,
        typer.Option(
            "--cost",
            metavar="NAME",
            help="expected sums of a cost, signal or label of the model: least, greatest, and the policy's",
        ),
    ] = None,
    within: Annotated[
        str | None,
        typer.Option(
            "--within",
            metavar="BUDGET",
            help="with --cost: P(the task holds and the cost until its verdict is at most c), for every c up to BUDGET",
        ),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option("--until", help="with --cost, pay until the verdict is decided (default) or the horizon"),
    ] = None,
    robustness: Annotated[
        bool,
        typer.Option(
            "--robustness",
            help="P(robustness >= r) for every margin r; with --at-least P: the largest r whose probability is that",
        ),
    ] = False,
    margin: Annotated[
        str | None, typer.Option("--margin", metavar="R", help="with --robustness: this r alone; bounds are on its P")
    ] = None,
    values: Annotated[
        str | None,
        typer.Option(
            "--values",
            metavar="initial|all",
            help="also P from each initial state, or from every state of the model; bounds are then on each of these",
            autocompletion=lambda: ["initial", "all"],
        ),
    ] = None,
    time_shift: Annotated[
        int | None,
        typer.Option(
            "--time-shift",
            metavar="K",
            help="with --robustness: P that the task tolerates 0 to K steps of delay, in both meanings of the term; "
            "bounds are on the P of K",
        ),
    ] = None,
    for_ever: Annotated[
        str | None,
        typer.Option(
            "--for-ever",
            metavar="QUESTION",
            help="judge the task at every step of endless runs: the long-run share of the steps at which it holds, or "
            "P that it does always, again and again (recurrence), or from some step on (persistence); or all",
            autocompletion=lambda: ["share", "always", "recurrence", "persistence", "all"],
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="FILE", help="with --robustness or --vary: draw the probabilities (.svg or .png)"
        ),
        Writes(),
    ] = None,
    report: ReportFolder = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The exact probability that the task holds: of the best policy, or of a given one."""
    import stltool as stl
    from stltool.checking.certificate import require_certificate_file
    from stltool.checking.evidence import evidence_of
    from stltool.files import read_text
    from stltool.policy import require_policy_file
    from stltool.reporting import (
        check_data,
        report_data,
        require_report,
        stationary_data,
        transfer_data,
        write_report,
    )
    from stltool.reporting.records import CheckOutput, Nature, ProvedRecord
    from stltool.reporting.terminal import (
        print_checks,
        print_facts,
        print_json,
        print_state_values,
        progress_bar,
    )
    from stltool.reporting.tradeoffs import require_picture

    bounds: list[tuple[str, str, Fraction]] = [
        (option, text, read_probability(text, option))
        for option, text in (("--at-least", at_least), ("--at-most", at_most))
        if text is not None
    ]
    if nominal and nature not in (None, "nominal"):
        raise SettingsError(f"--nominal leaves nature no choice; leave out --nature {nature} or --nominal")
    nature = "nominal" if nominal else nature
    clockless = stationary or memoryless
    given = require_one_policy(policy, policy_function)
    if transfer and policy is None:
        raise SettingsError("--transfer judges a policy file on another model; add --policy FILE")
    if policy_model is not None and not transfer:
        raise SettingsError("--policy-model is for a policy of another model; add --transfer, or leave it out")
    of_p = [
        (clockless, "--stationary and --memoryless"), (certificate is not None, "--certificate"),
        (cluster is not None, "--cluster"), (transfer, "--transfer"), (robustness, "--robustness"),
        (values is not None, "--values"),
    ]  # fmt: skip
    of_one = [(exact, "--exact"), (nature is not None, "--nature"), (save_policy is not None, "--save-policy")]
    if plot is not None:
        require_picture(plot)
        if vary is None and not robustness:
            raise SettingsError(f"--plot {plot} draws what --robustness or --vary finds; add one of them")
    if report is not None:
        require_report(report / "report.html")
    if for_ever is not None:
        beside = [
            *of_p, (cost is not None, "--cost"), (within is not None, "--within"), (until is not None, "--until"),
            (vary is not None, "--vary"), (report is not None, "--report"), (margin is not None, "--margin"),
            (time_shift is not None, "--time-shift"), (resume, "--resume"), (encoding != "exact", "--encoding"),
            (nature not in (None, "nominal"), "--nature"),
        ]  # fmt: skip
        _require_none(beside, "is not supported with --for-ever; leave one of them out")
        of_one_answer = [(save_policy is not None, "--save-policy"), (minimize, "--minimize")]
        asked_once = [option for option, _, _ in bounds] + [option for given_it, option in of_one_answer if given_it]
        questions = read_questions(for_ever, asked_once)
        if save_policy is not None:
            require_endless_policy_file(save_policy)
            require_policy_file(save_policy)
        repeats = check_for_ever(
            task, model, param, name, reading, nature == "nominal", policy, policy_function, questions, minimize, exact,
            bounds, save_policy, as_json,
        )  # fmt: skip
        if not repeats:
            raise typer.Exit(1)
        return
    if within is not None and cost is None:
        raise SettingsError(f"--within {within} is a budget for a cost; add --cost NAME, or leave it out")
    if cost is not None:
        beside = [(vary is not None, "--vary"), (report is not None, "--report"), *of_p]
        if within is None:
            beside += [(minimize, "--minimize"), (at_least is not None, "--at-least"), of_one[2]]
            beside.append((nature not in (None, "nominal"), "--nature"))
            beside.append((at_most is not None, "--at-most"))
        else:
            beside.append((until is not None, "--until"))
        _require_none(beside, f"is not supported with --cost{' without --within' * (within is None)}; leave one out")
        if save_policy is not None:
            require_policy_file(save_policy)
        budget = read_budget(within) if within is not None else None
        product = load_product(task, model, param, name, encoding, reading=reading)
        if budget is None and nature is None:
            require_points(product.model, "--cost")
        chosen = given_policy(product, policy, policy_function)
        product, _ = judge_by(product, nature)
        if budget is None:
            check_cost(product, chosen, cost, until or "verdict", exact, as_json)
            return
        within_it = check_within(
            product, chosen, cost, budget, not minimize, exact, "with" if nature == "with" else "against", bounds,
            save_policy, as_json,
        )  # fmt: skip
        if not within_it:
            raise typer.Exit(1)
        return
    if until is not None:
        raise SettingsError("--until says how long a cost is paid; add --cost NAME, or leave it out")
    if vary is not None:
        _require_none([*of_p, *of_one[1:]], "is for one value of the parameter; leave it or --vary out")
        (loaded,), world = load_with_model(task, model, param, [name], reading)
        varied = vary.partition("=")[0].strip()
        if given is None and varied in read_params(param) and varied not in loaded.params:  # else that of the policy
            raise SettingsError(f"-p {varied} and --vary {varied} both give {varied} its values; leave one of them out")
        product = bind(loaded, world, encoding)
        chosen = given_policy(product, policy, policy_function)
        if not check_range(product, chosen, vary, not minimize, exact, bounds, as_json, plot, report):
            raise typer.Exit(1)
        return
    if margin is not None and not robustness:
        raise SettingsError(f"--margin {margin} is a margin of robustness; add --robustness, or leave it out")
    if time_shift is not None and time_shift < 0:
        raise SettingsError(f"--time-shift {time_shift}: write a number of steps, such as --time-shift 2")
    if time_shift is not None and not robustness:
        raise SettingsError(f"--time-shift {time_shift} is robustness in time; add --robustness, or leave it out")
    if robustness:
        beside = [
            (clockless, "--stationary and --memoryless"), (exact, "--exact"), (transfer, "--transfer"),
            (save_policy is not None, "--save-policy"), (certificate is not None, "--certificate"),
            (cluster is not None, "--cluster"), (encoding != "exact", "--encoding"),
            (nature not in (None, "nominal"), "--nature"), (values is not None, "--values"),
            (margin is None and time_shift is None and at_most is not None, "without --margin, --at-most"),
            (plot is not None and time_shift is not None, "with --time-shift, --plot"),
            (report is not None and time_shift is not None, "with --time-shift, --report"),
        ]  # fmt: skip
        _require_none(beside, "is not supported with --robustness; leave one of them out")
        r = read_margin(margin) if margin is not None else None
        (loaded,), world = load_with_model(task, model, param, [name], reading)
        world = world.nominal() if nature == "nominal" else world
        require_points(world, "--robustness")
        chosen = given_policy(bind(loaded, world, encoding), policy, policy_function) if given is not None else None
        if time_shift is not None:
            if not check_timing(loaded, world, chosen, time_shift, r, not minimize, bounds, as_json):
                raise typer.Exit(1)
            return
        if not check_margins(loaded, world, chosen, r, not minimize, bounds, as_json, plot, report):
            raise typer.Exit(1)
        return
    if clockless and (given is not None or (stationary and memoryless)):
        raise SettingsError(
            "--stationary, --memoryless, --policy and --policy-function exclude each other; give one of them"
        )
    streamed = save_policy is not None and save_policy.suffix.lower() == ".policy"
    if save_policy is not None:
        require_policy_file(save_policy)
    if resume and not streamed:
        raise SettingsError("--resume continues a policy file; add --save-policy FILE.policy")
    if certificate is not None:
        require_certificate_file(certificate)
    product = make_product(task, model, param, name, encoding, as_json, reading=reading)
    uncertain = product.model.uncertain
    if nominal and not uncertain:
        raise SettingsError("--nominal: the model's probabilities are not intervals; leave out --nominal")
    product, judge = judge_by(product, nature)
    robust = uncertain and nature != "nominal"
    if product.model.parameters and (exact or clockless or streamed or certificate is not None or cluster is not None):
        product.model.require_points()
    if clockless:
        require_points(product.model, "--stationary" if stationary else "--memoryless")
    if clockless and streamed:
        raise SettingsError(
            f"--save-policy {save_policy}: policies that do not know the step are saved as .npz, .csv or .json"
        )
    fraction = {"exact": True} if exact else {}
    moved = None
    if transfer:
        assert policy is not None  # required above
        moved = moved_policy(product, policy, load_policy_product(task, policy_model, param, name, encoding, reading))
    chosen = moved.policy if moved is not None else given_policy(product, policy, policy_function)
    to_file = {"policy_file": save_policy, "resume": resume} if streamed else {}
    if robust and streamed:
        raise SettingsError(
            f"--save-policy {save_policy}: for interval probabilities, policies are saved as .npz, .csv or .json"
        )
    if cluster is not None:
        require_points(product.model, "--cluster")
    if clockless and cluster is not None:
        raise SettingsError("--cluster is for the optimum and for given policies; leave it or the other option out")
    where = {"cluster": cluster} if cluster is not None else {}
    each = {"values": values} if values is not None else {}
    keep = save_policy is not None or (report is not None and cluster is None)  # workers keep none
    found = None
    if clockless:
        with progress_bar("searching", quiet=as_json) as bar:
            found = stl.stationary(
                product, memory="automaton" if stationary else "none", maximize=not minimize, progress=bar
            )
        chosen = found.policy
    state = _policy_files(save_policy)[-1] if save_policy is not None else None
    with (
        resumable(state, "the first state was saved") if streamed else nullcontext(),
        progress_bar("checking", quiet=as_json) as bar,
    ):
        asked = fraction | each if chosen is None else {}
        optimum = judge(product, maximize=not minimize, keep_policy=keep, progress=bar, **asked, **to_file, **where)
        result = (
            optimum if chosen is None else judge(product, chosen, maximize=not minimize, **fraction, **where, **each)
        )
    kept = found.policy if found is not None else optimum.policy
    if save_policy is not None and kept is not None and not streamed:
        kept.save(save_policy)
    if certificate is not None:
        with progress_bar("writing the certificate", quiet=as_json) as bar:
            proved = stl.write_certificate(result, certificate, progress=bar, cluster=cluster)
    data = cast(CheckOutput, check_data(result, optimum))
    if moved is not None:
        data["transfer"] = transfer_data(moved.differences)
    if uncertain:
        data["nature"] = cast(Nature, nature or "against")
    if found is not None:
        data["stationary"] = stationary_data(found)
    verdicts = []
    for option, text, bound in bounds:
        judged = result.values if result.values is not None else result
        holds = judged.at_least(bound) if option == "--at-least" else judged.at_most(bound)
        everywhere = (
            "" if values is None else " from every initial state" if values == "initial" else " from every state"
        )
        verdicts.append((f"P {'>=' if option == '--at-least' else '<='} {text}{everywhere}", holds))
        data["at_least" if option == "--at-least" else "at_most"] = float(bound)
    if verdicts:
        data["holds"] = all(holds is True for _, holds in verdicts)
        data["decided"] = all(holds is not None for _, holds in verdicts)
    if report is not None:
        proof: ProvedRecord | None = None
        if certificate is not None:
            lower, upper = map(fraction_text, proved)
            command = ["stltool", "certify", str(certificate), str(task)]
            command += [*(["--model", str(model)] if model is not None else []), *(f"-p{pair}" for pair in param or [])]
            proof = {"file": str(certificate), "lower": lower, "upper": upper, "command": shlex.join(command)}
        page = report_data(
            [optimum] if chosen is None else [optimum, result],
            source=read_text(task, "task file"),
            command=this_command(),
            stationary=[found] if found is not None else [],
            evidence=evidence_of(product, optimum.policy if chosen is None else chosen, seed=0),
            asked=[{"claim": claim, "holds": holds} for claim, holds in verdicts],
            certificate=proof,
        )
        write_report(page, report / "report.html")
    if as_json:
        print_json(data)
    else:
        print_facts({"task": f"{product.task_name} := {product.formula}"})
        if data["initial_states"] > 1:
            print_facts({"starts in": data["initial"]})
        if uncertain:
            print_facts({"nature": nature_text(nature or "against", product.model)})
        print_checks([check_data(optimum), data] if chosen is not None else [data])
        if result.values is not None:
            print_state_values(result.values)
        if moved is not None:
            print_facts({"policy's model": "; ".join(moved.differences.told) or "differs in nothing"})
        if found is not None:
            limit = bound_texts(found.bound, found.bound)[0 if minimize else 1]
            print_facts({
                found.kind: found.status,
                "bound": f"no deterministic {found.kind} policy has {'less' if minimize else 'more'} than {limit}",
            })  # fmt: skip
        if result.certainty is not None:
            print_facts({"certain": result.certainty})
        if result.fraction is not None:
            print_facts({"exact P": fraction_text(result.fraction, _LONGEST_FRACTION)})
        print_facts({claim: _VERDICTS[holds] for claim, holds in verdicts})
        if certificate is not None:
            lower, upper = bound_texts(*proved)
            print_facts({"certificate": f"{certificate} proves {lower} <= P <= {upper}"})
        if save_policy is not None:
            print_facts({"policy": save_policy})
        if report is not None:
            print_facts({"report": report / "report.html"})
    if verdicts and not data["holds"]:
        raise typer.Exit(1)


def _require_none(options: Iterable[tuple[bool, str]], advice: str) -> None:
    """SettingsError for the first of the options that is given."""
    for given, option in options:
        if given:
            raise SettingsError(f"{option} {advice}")
