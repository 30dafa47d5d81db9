"""`stltool explain`: the structure and meaning of a task."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from stltool.cli.app import app
from stltool.cli.options import AsJson, Encoding, Model, Normalize, Params, Step, TaskName, TaskOrFormula
from stltool.cli.steps import load_task_or_formula, task_model, warnings_shown


@app.command('stltool explain "G[0,9] (request -> F[0,5] grant)"')
def explain(
    task: TaskOrFormula,
    model: Model = None,
    normalize: Normalize = False,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    step: Step = None,
    as_json: AsJson = False,
) -> None:
    """Explain a task: its tree and horizons, the fragment of Wang et al. (2024), automaton and product sizes.

    Warns if the task can never hold or always holds, if a part of it is vacuous, and if other tools would read the text
    differently.
    """
    import stltool as stl
    from stltool.reporting.terminal import print_facts, print_json, print_table, print_tree

    loaded = load_task_or_formula(task, param, name, step)
    world = task_model(loaded, model, normalize) if model is not None or loaded.model is not None else None
    with warnings_shown():
        facts = stl.explain(loaded, model=world, encoding=encoding)  # type: ignore[arg-type]  # checked there, with a message
    if as_json:
        print_json(facts)
        return
    print_facts(_shown(facts))
    print()
    print_tree(facts["tree"])
    if "parts" in facts:
        print("\nparts of the automaton (a start's truth is known `delay` steps after it):")
        print_table(facts["parts"])
    trace = facts.get("disagrees_on")
    if trace is not None:
        print(
            "\na shortest trace on which the encoding and the formula disagree (without a model, comparisons are\n"
            "treated as independent of each other):"
        )
        print_table(trace["steps"])
        print(f"the encoding says {trace['encoding_says']}, the formula is {trace['formula_is']}")
    for note in facts.get("model_notes", []):
        print(f"\nnote: {note}")
    for advice in facts.get("warnings", []) + facts["ambiguities"]:
        print(f"\nwarning: {advice}")


def _shown(facts: dict[str, Any]) -> dict[str, Any]:
    """The facts that take one line each, as text."""

    shown = {
        key.replace("_", " "): value
        for key, value in facts.items()
        if not isinstance(value, dict | list) and "digest" not in key
    }
    if shown["horizon"] is None:
        shown["horizon"] = shown["samples needed"] = "none: an interval has no end; only monitors can judge this"
        shown["meaning"] = "not analysed: the formula has no horizon"
    if shown.get("transitions", 0) is None:
        shown["transitions"] = "unknown: the model is a black box"
    for key in ("flag states", "history states"):
        if key in shown:
            size = shown[key]
            large = isinstance(size, int) and size >= 10**9
            shown[key] = "no such encoding" if size is None else f"{Decimal(size):.3g}" if large else size
    if "initial" in shown:
        shown["starts in"] = shown.pop("initial")
        del shown["initial states"]
    shown["params"] = ", ".join(f"{key} = {value}" for key, value in facts["params"].items()) or "none"
    for key in ("fragment", "automaton"):
        for detail, value in facts.get(key, {}).items():
            shown[f"{key} {detail}".replace("_", " ")] = ", ".join(value) if isinstance(value, list) else value
    if "actions" in facts:
        shown["actions"] = ", ".join(facts["actions"])
    return shown
