"""`stltool explain`: the structure and meaning of a task."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    Step,
    TaskName,
    TaskOrFormula,
    Unit,
)
from stltool.cli.roles import Writes
from stltool.cli.steps import (
    given_policy,
    load_task_or_formula,
    make_product,
    require_declared_there,
    require_one_policy,
    task_model,
    warnings_shown,
)
from stltool.errors import SettingsError
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.product import Product


@app.command('stltool explain "G[0,9] (request -> F[0,5] grant)"')
def explain(
    task: TaskOrFormula,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    price: Annotated[
        float | None, typer.Option("--price", metavar="P", help="how much of P its tree may lose, default: 0.001")
    ] = None,
    most_leaves: Annotated[
        int | None, typer.Option("--most-leaves", metavar="N", help="give up there, default: 200")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="draw P over the number of leaves (.svg or .png)"),
        Writes(),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="save the tree as a policy (.npz; text: .csv, .json)"),
        Writes(),
    ] = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    step: Step = None,
    unit: Unit = None,
    as_json: AsJson = False,
) -> None:
    """Explain a task: its tree and horizons, the fragment of Wang et al. (2024), automaton and product sizes.

    Warns if the task can never hold or always holds, if a part of it is vacuous, and if other tools would read the text
    differently.

    With --policy, --price, --most-leaves, --plot or --out: the policy, or the best one, as a small decision tree, with
    the exact P of the tree itself. Exit code 1 if no tree is within the price.
    """
    import stltool as stl
    from stltool.reporting.terminal import print_facts, print_json, print_table, print_tree

    about_a_tree = any(value is not None for value in (price, most_leaves, plot, out))
    if require_one_policy(policy, policy_function) is not None or about_a_tree:
        if not task.endswith(".stl") and not Path(task).is_file():
            raise SettingsError(f"{task}: the tree of a policy needs a task file with a model; give one")
        require_declared_there(step, unit)
        product = make_product(Path(task), model, param, name, encoding, as_json, reading=reading)
        _explain_policy(product, policy, policy_function, price, most_leaves, plot, out, as_json)
        return
    loaded = load_task_or_formula(task, param, name, step, unit)
    world = task_model(loaded, model, reading) if model is not None or loaded.model is not None else None
    with warnings_shown():
        facts = stl.explain(loaded, model=world, encoding=encoding)  # type: ignore[arg-type]  # checked there, with a message
    if as_json:
        print_json(facts)
        return
    print_facts(_shown(facts))
    say()
    print_tree(facts["tree"])
    if "parts" in facts:
        say("\nparts of the automaton (a start's truth is known `delay` steps after it):")
        print_table(facts["parts"])
    trace = facts.get("disagrees_on")
    if trace is not None:
        say(
            "\na shortest trace on which the encoding and the formula disagree (without a model, comparisons are\n"
            "treated as independent of each other):"
        )
        print_table(trace["steps"])
        say(f"the encoding says {trace['encoding_says']}, the formula is {trace['formula_is']}")
    for note in facts.get("model_notes", []):
        say(f"\nnote: {note}")
    for advice in facts.get("warnings", []) + facts["ambiguities"]:
        say(f"\nwarning: {advice}")


def _explain_policy(
    product: Product,
    policy: Path | None,
    policy_function: str | None,
    price: float | None,
    most_leaves: int | None,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    import stltool as stl
    from stltool.numbers import probability_text
    from stltool.policy import require_policy_file
    from stltool.reporting.terminal import print_facts, print_json, print_table, print_text, progress_bar
    from stltool.reporting.tradeoffs import require_picture
    from stltool.reporting.trees import tree_data, write_tree_picture

    if plot is not None:
        require_picture(plot)
    if out is not None:
        require_policy_file(out)
    given = given_policy(product, policy, policy_function)
    settings: dict[str, Any] = {"price": price, "most_leaves": most_leaves}
    with progress_bar("growing trees", quiet=as_json) as bar:
        found = stl.policy_tree(
            product, given, progress=bar, **{key: value for key, value in settings.items() if value is not None}
        )
    if plot is not None:
        write_tree_picture(found, plot)
    if out is not None:
        found.policy.save(out)
    if as_json:
        print_json(tree_data(found))
        _end(found.met)
        return
    lost = found.given.probability - found.check.probability
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "policy": policy or policy_function or "maximum over all policies",
        "P": probability_text(found.given.probability),
        "tree": "1 leaf" if found.leaves == 1 else f"{found.leaves} leaves",
        "P of it": f"{probability_text(found.check.probability)}, {lost:.3g} less; "
        + ("within the price" if found.met else f"more than {found.price:g}; raise --most-leaves or the price"),
        **({"plot": plot} if plot is not None else {}),
        **({"saved": out} if out is not None else {}),
    })  # fmt: skip
    say()
    print_text("\n".join([found.rules, "", *found.legend, ""]))
    say("\nthe best trees found of each size:")
    print_table([{"leaves": leaves, "P": probability_text(p)} for leaves, p in found.curve])
    _end(found.met)


def _end(met: bool) -> None:
    if not met:
        raise typer.Exit(1)


def _shown(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The facts that take one line each, as text."""

    shown = {
        key.replace("_", " "): value
        for key, value in facts.items()
        if not isinstance(value, dict | list) and "digest" not in key
    }
    if shown["horizon"] is None:
        shown["horizon"] = shown["samples needed"] = (
            "none: an interval has no end; only monitors and check --for-ever judge this"
        )
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
