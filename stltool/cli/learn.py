"""`stltool learn`: a policy from experience."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
from stltool.cli.roles import Writes
from stltool.cli.steps import (
    LearnerCommand,
    gap_facts,
    make_product,
    read_learner,
    resumable,
    train,
    training_text,
)


@app.command("stltool learn patrolling.stl --episodes 2000 --out policy.npz", cls=LearnerCommand)
def learn(
    task: TaskFile,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="policy file to write (.npz; text: .csv, .json)", show_default=False),
        Writes(),
    ],
    method: Method = None,
    faithful: Faithful = False,
    episodes: Episodes = 1000,
    evaluate_every: EvaluateEvery = 20,
    most_steps: MostSteps = None,
    stop_gap: StopGap = None,
    seed: Seed = 0,
    setting: Set = None,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    until_gap: UntilGap = None,
    confidence: Annotated[float, typer.Option("--confidence", help="confidence level for --until-gap")] = 0.99,
    checkpoint: Checkpoint = None,
    resume: Resume = False,
    checkpoint_every: CheckpointEvery = 30.0,
    history: Annotated[Path | None, typer.Option("--history", help="learning curve to write (.csv)"), Writes()] = None,
    tensorboard: Annotated[
        Path | None, typer.Option("--tensorboard", help="folder for TensorBoard events"), Writes()
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Learn a policy without knowledge of the probabilities, and save it."""
    from stltool.learning.checkpoint import require_checkpoint
    from stltool.learning.markov import tested
    from stltool.policy import require_policy_file
    from stltool.reporting import markov_data, training_data, write_history
    from stltool.reporting.curves import require_history_file
    from stltool.reporting.tensorboard import require_tensorboard, write_tensorboard
    from stltool.reporting.terminal import print_facts, print_json

    require_policy_file(out)
    require_checkpoint(checkpoint, resume)
    if history is not None:
        require_history_file(history)
    if tensorboard is not None:
        require_tensorboard(tensorboard)
    learner = read_learner(method, faithful, setting)
    product = make_product(
        task, model, param, name, encoding, as_json, kernels=learner.kernels, nominal=nominal, reading=reading
    )
    with resumable(checkpoint):
        training = train(
            product, learner, as_json, episodes=episodes, evaluate_every=evaluate_every, most_steps=most_steps,
            stop_gap=stop_gap, until_gap=until_gap, confidence=confidence, seed=seed, checkpoint=checkpoint,
            resume=resume, checkpoint_every=checkpoint_every,
        )  # fmt: skip
    training.policy.save(out)
    if history is not None:
        write_history(training, history)
    events = write_tensorboard(training, tensorboard) if tensorboard is not None else None
    test = tested(training)
    markov = markov_data(test, product.model) if test is not None else None
    if as_json:
        found = {**training_data(training), "markov": markov}
        print_json({"task": product.task_name, "formula": str(product.formula), **found})
        return
    exact = training.history[-1].probability
    unknown = "unknown: the model is a black box; use stltool estimate --policy for bounds"
    print_facts({
        "learned": training_text(training),
        **gap_facts(training),
        "exact P": f"{exact:.12g}" if exact is not None else unknown,
        "policy": out,
        **({"Markov test": markov["statement"]} if markov is not None else {}),
        **({"events": events} if events is not None else {}),
    })  # fmt: skip
