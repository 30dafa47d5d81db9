"""`stltool run`: learn, check, report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import (
    READ,
    AsJson,
    Checkpoint,
    CheckpointEvery,
    Encoding,
    Episodes,
    EvaluateEvery,
    Faithful,
    Method,
    Model,
    ModelReading,
    MostSteps,
    Nominal,
    Params,
    Resume,
    Seed,
    Set,
    StopGap,
    TaskFile,
    TaskName,
    UntilGap,
)
from stltool.cli.roles import Writes, task_folder, within
from stltool.cli.steps import (
    ROLLOUTS,
    LearnerCommand,
    gap_facts,
    guarantees_of,
    make_product,
    read_learner,
    read_probability,
    resumable,
    split_episodes,
    this_command,
    train,
    training_text,
)
from stltool.cli.words import Named
from stltool.errors import SettingsError

if TYPE_CHECKING:
    from stltool.reporting.records import AskedRecord

_VERDICTS = {
    True: "holds",
    False: "does not hold",
    None: "undecided: the bound lies inside the enclosure; stltool check --policy FILE --exact decides it",
}


@app.command("stltool run patrolling.stl --episodes 1000 --out out/first", cls=LearnerCommand)
def run(
    task: TaskFile,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    method: Method = None,
    faithful: Faithful = False,
    episodes: Episodes = 1000,
    evaluate_every: EvaluateEvery = 20,
    most_steps: MostSteps = None,
    stop_gap: StopGap = None,
    until_gap: UntilGap = None,
    seed: Seed = 0,
    setting: Set = None,
    confidence: Annotated[
        float, typer.Option("--confidence", help="confidence level of the guarantees from data")
    ] = 0.99,
    rollouts: Annotated[
        int,
        typer.Option("--rollouts", help="fresh runs for judging the learned policy; 0: none"),
        Named("runs"),
    ] = ROLLOUTS,
    split: Annotated[
        float | None,
        typer.Option(
            "--split",
            metavar="SHARE",
            help="learn in this share of the episodes, and use the others as fresh runs instead of --rollouts",
        ),
    ] = None,
    at_least: Annotated[
        str | None,
        typer.Option("--at-least", metavar="P", help="exit code 1 unless the learned policy's P is at least this"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="folder for the results; default: out/NAME"),
        Writes(within("policy.npz", "report.html", "report.json"), task_folder),
    ] = None,
    checkpoint: Checkpoint = None,
    resume: Resume = False,
    checkpoint_every: CheckpointEvery = 30.0,
    as_json: AsJson = False,
) -> None:
    """Learn a policy, check it exactly, and write a report.

    A black box cannot be checked; instead, P of the learned policy is bounded from fresh runs.
    """
    import stltool as stl
    from stltool.checking.evidence import evidence_of
    from stltool.checking.statistical import planned_runs
    from stltool.files import alone_in, read_text
    from stltool.learning.checkpoint import require_checkpoint
    from stltool.learning.markov import tested
    from stltool.policy import require_policy_file
    from stltool.reporting import guarantee_rows, looser_note, report_data, require_report, write_report
    from stltool.reporting.terminal import print_checks, print_facts, print_json, print_table, progress_bar

    if split is not None:
        episodes, rollouts = split_episodes(split, episodes, rollouts)
    bound = read_probability(at_least, "--at-least") if at_least is not None else None
    planned_runs(rollouts or None, confidence=confidence, side="lower")
    learner = read_learner(method, faithful, setting)
    product = make_product(
        task,
        model,
        param,
        name,
        encoding,
        as_json,
        kernels=(*learner.kernels, "rollouts") if rollouts > 0 else learner.kernels,
        nominal=nominal,
        reading=reading,
    )
    folder = out if out is not None else Path("out") / product.task_name
    require_policy_file(folder / "policy.npz")
    require_report(folder / "report.html")
    known = product.model.blackbox is None
    if not known and not rollouts:
        raise SettingsError("--rollouts 0: a policy for a black box is judged only by fresh runs; request some")
    if not known and bound is not None:
        raise SettingsError(
            f"--at-least {at_least}: {product.model.name} is a black box, whose probabilities are unknown; test the "
            "bound by runs: stltool estimate --policy FILE --at-least P"
        )
    require_checkpoint(checkpoint, resume)
    with alone_in(folder, "run"), resumable(checkpoint):
        checks = []
        if known:
            with progress_bar("checking the optimum", quiet=as_json) as bar:
                checks.append(stl.check(product, progress=bar))
        training = train(
            product, learner, as_json, episodes=episodes, evaluate_every=evaluate_every, most_steps=most_steps,
            stop_gap=stop_gap, until_gap=until_gap, confidence=confidence, seed=seed, checkpoint=checkpoint,
            resume=resume, checkpoint_every=checkpoint_every,
        )  # fmt: skip
        if known:
            checks.append(stl.check(product, training.policy))
        guarantees = guarantees_of(product, training, confidence, rollouts, as_json)
        data = report_data(
            checks, training, source=read_text(task, "task file"), command=this_command(), guarantees=guarantees,
            evidence=evidence_of(product, training.policy, seed, why=known), markov=tested(training), product=product,
            asked=[{"claim": f"P >= {at_least}", "holds": checks[-1].at_least(bound)}] if bound is not None else [],
        )  # fmt: skip
        training.policy.save(folder / "policy.npz")
        write_report(data, folder / "report.html")
    if as_json:
        print_json(data)
        _require(data["asked"])
        return
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "product": f"{product.shape[0]} model states × {product.shape[1]} automaton states, horizon {product.horizon}",
        **({"starts in": data["initial"]} if data["initial_states"] > 1 else {}),
        "learned": training_text(training),
        **gap_facts(training),
        **({"Markov test": data["markov"]["statement"]} if data["markov"] is not None else {}),
    })  # fmt: skip
    if known:
        print_checks(data["checks"])
    print_table(guarantee_rows(data["guarantees"], data["checks"]))
    if (note := looser_note(data["guarantees"])) is not None:
        print_facts({"looser": note})
    print_facts({asked["claim"]: _VERDICTS[asked["holds"]] for asked in data["asked"]})
    print_facts({"report": folder / "report.html", "data": folder / "report.json", "policy": folder / "policy.npz"})
    _require(data["asked"])


def _require(asked: Sequence[AskedRecord]) -> None:
    if not all(one["holds"] for one in asked):
        raise typer.Exit(1)
