"""`stltool export`: a task with its model, for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import (
    READ,
    AsJson,
    Encoding,
    Model,
    ModelReading,
    Params,
    PolicyFunction,
    TaskFile,
    TaskName,
)
from stltool.cli.roles import Reads, Writes
from stltool.cli.steps import bind, compile_task, given_policy, load_with_model, read_params, require_one_policy
from stltool.errors import SettingsError


@app.command("stltool export patrolling.stl --to prism --out patrolling.prism")
def export(
    task: TaskFile,
    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="prism, drn, umb (the product), dot (the automaton), python (a policy); default: by the file's ending",
            autocompletion=lambda: ["prism", "drn", "umb", "dot", "python"],
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="file to write; default: print it"), Writes()] = None,
    policy: Annotated[
        Path | None,
        typer.Option("--policy", help="the Markov chain under this policy; default: the product, with all choices"),
        Reads("policy"),
    ] = None,
    policy_function: PolicyFunction = None,
    clock: Annotated[
        bool,
        typer.Option("--clock", help="count steps in the states up to the horizon, so that the property has no bound"),
    ] = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Export the product of a task and its model, for PRISM and Storm to check it again; or draw the automaton.

    --to prism writes the product as a program that people can read: variables are the state, what the task remembers,
    and the step where it matters; labels "satisfied" and "violated" are the verdicts. --to drn and --to umb write the
    same state by state. The properties that ask for P are printed. With a policy it is the Markov chain under that
    policy. --to python writes the policy as one file of plain Python, with its tables inside, for a robot that does not
    have stltool. --to dot draws the automaton: states are labelled with what they remember, edges with their
    conditions.
    """
    import stltool as stl
    from stltool.exporting import targets
    from stltool.reporting.terminal import note, print_facts, print_json, print_text

    target = targets.target_of(to, out)
    named_policy = require_one_policy(policy, policy_function)
    if out is not None:
        targets.require_file(target, out)
    if targets.TARGETS[target].of == "automaton" and model is None and stl.load_task(task, task=name).model is None:
        if named_policy is not None:
            raise SettingsError(f"--policy {named_policy}: a policy needs a model; give --model FILE")
        loaded = stl.load_task(task, read_params(param), name)
        asked = targets.Request(compile_task(loaded, encoding), clock=clock)
    else:
        (loaded,), world = load_with_model(task, model, param, [name], reading)
        product = bind(loaded, world, encoding)
        asked = targets.Request(product.automaton, product, given_policy(product, policy, policy_function), clock)
    text = None
    if out is None:
        text = targets.text_of(target, asked)
    else:
        targets.write(target, asked, out)
    sizes, questions = {}, {}
    if targets.TARGETS[target].of == "product":
        built = asked.built.model
        sizes = {"states": built.n_states, "choices": built.n_choices, "transitions": built.n_transitions}
        questions = asked.built.questions
    if as_json:
        print_json({
            "task": loaded.name, "formula": str(loaded.formula), "horizon": asked.automaton.horizon,
            "encoding": encoding, "automaton_states": asked.automaton.n_states, "to": target,
            "out": str(out) if out is not None else None, "text": text, **sizes,
            "questions": {
                asked_for: {"property": one.property, "complement": one.complement}
                for asked_for, one in questions.items()
            } or None,
        })  # fmt: skip
    elif text is not None:
        print_text(text)
        for asked_for, one in questions.items() if target != "prism" else ():  # which has them in a comment
            note(f"{asked_for}: {one}")
    elif sizes:
        counts = ", ".join(f"{n} {what}" for what, n in sizes.items())
        print_facts({"written": f"{out}: {counts}", **{name: str(one) for name, one in questions.items()}})
    elif targets.TARGETS[target].of == "policy":
        print_facts({"written": out})
