"""`stltool explain`: what a task says."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson, Encoding, Model, Params, TaskFile, TaskName
from stltool.cli.steps import bind, compile_task, read_params, task_model
from stltool.errors import FragmentError, SizeError


@app.command()
def explain(
    task: TaskFile,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """What a task says: horizon, decomposition along the paper's fragment, automaton and product sizes."""
    import stltool as stl
    from stltool.reporting.data import disagreement_data, encoding_sizes, part_data, product_data
    from stltool.reporting.terminal import print_facts, print_table
    from stltool.sizes import bytes_text

    loaded = stl.load_task(task, read_params(param), name)
    facts: dict[str, Any] = {
        "task": loaded.name,
        "formula": str(loaded.formula),
        "params": {key: str(value) for key, value in loaded.params.items()},
        "horizon": stl.horizon(loaded.formula),
        "samples_needed": stl.horizon(loaded.formula) + 1,
    }
    try:
        fragment = stl.check_fragment(loaded.formula)
        facts["fragment"] = {
            "outer": f"{fragment.outer}[0,{fragment.T})",
            "parts": [str(part) for part in fragment.parts],
            "equal_windows": fragment.uniform,
        }
    except FragmentError as refusal:
        facts["fragment"] = {"refused": str(refusal)}
    try:
        if model is not None or loaded.model is not None:
            product = bind(loaded, task_model(loaded, model), encoding)
            automaton = product.automaton
            facts |= product_data(product)
            facts["check_bytes"] = product.check_bytes()
        else:
            automaton = compile_task(loaded, encoding)
            facts["automaton_states"] = automaton.n_states
        facts |= encoding_sizes(automaton)
        facts["parts"] = part_data(automaton)
        if not automaton.exact:
            try:
                facts["disagrees_on"] = disagreement_data(automaton)
            except SizeError as refusal:
                facts["disagreement"] = str(refusal)
    except (FragmentError, SizeError) as refusal:
        facts["automaton"] = {"refused": str(refusal)}
    if as_json:
        print(json.dumps(facts))
        return
    shown = {
        key.replace("_", " "): value
        for key, value in facts.items()
        if not isinstance(value, dict) and "digest" not in key
    }
    if shown.get("transitions", 0) is None:
        shown["transitions"] = "unknown: the model is a black box"
    for key in ("flag states", "history states"):
        if key in shown:
            size = shown[key]
            large = isinstance(size, int) and size >= 10**9
            shown[key] = "no such encoding" if size is None else f"{Decimal(size):.3g}" if large else size
    shown["params"] = ", ".join(f"{key} = {value}" for key, value in facts["params"].items()) or "none"
    for key in ("fragment", "automaton"):
        for detail, value in facts.get(key, {}).items():
            shown[f"{key} {detail}".replace("_", " ")] = ", ".join(value) if isinstance(value, list) else value
    if "check_bytes" in facts:
        shown["check bytes"] = bytes_text(facts["check_bytes"])
        shown["actions"] = ", ".join(facts["actions"])
    shown.pop("parts", None)
    trace = facts.get("disagrees_on")
    print_facts(shown)
    if "parts" in facts:
        typer.echo("\nparts of the automaton (a start's truth is known `delay` steps after it):")
        print_table(facts["parts"])
    if trace is not None:
        typer.echo(
            "\na shortest trace on which the encoding and the formula disagree (without a model, comparisons are"
        )
        typer.echo("taken as independent of each other):")
        print_table(trace["steps"])
        typer.echo(f"the encoding says {trace['encoding_says']}, the formula is {trace['formula_is']}")
