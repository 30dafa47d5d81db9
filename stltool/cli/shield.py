"""`stltool shield`: the actions that any policy may take while P(Φ) ≥ c stays certain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Encoding, Model, ModelReading, Nominal, Params, TaskFile, TaskName
from stltool.cli.roles import Writes
from stltool.cli.steps import make_product, read_probability
from stltool.numbers import bound_texts, within_text


@app.command("stltool shield patrolling.stl --at-least 0.9 --out mask.npz")
def shield(
    task: TaskFile,
    at_least: Annotated[
        str,
        typer.Option("--at-least", metavar="P", help="what every policy that obeys is promised", show_default=False),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="write the mask (.npz)"), Writes()
    ] = None,
    rule: Annotated[
        Literal["static", "ratio"],
        typer.Option("--rule", help="static: by step, state and memory; ratio: also by what has been spent"),
    ] = "static",
    levels: Annotated[int, typer.Option("--levels", help="for --rule ratio: how finely what is spent is counted")] = 64,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """A mask of actions under which every policy has at least a given P, whatever it remembers or intends."""
    import stltool as stl
    from stltool.checking.shield import require_shield_file
    from stltool.reporting import shield_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    bound = read_probability(at_least, "--at-least")
    if out is not None:
        require_shield_file(out)
    product = make_product(task, model, param, name, encoding, as_json, nominal=nominal, reading=reading)
    with progress_bar("making the shield", quiet=as_json) as bar:
        found = stl.shield(product, bound, rule, levels=levels, progress=bar)
    if out is not None:
        found.save(out)
    if as_json:
        print_json(shield_data(found))
        return
    lower, upper = bound_texts(found.least.lower, found.least.upper)
    print_facts({"task": f"{product.task_name} := {product.formula}", "promise": f"P >= {at_least}"})
    print_table([
        {
            "policy": "the worst that obeys",
            "P": within_text(found.least.value, found.least.lower, found.least.upper),
            "lower_bound": lower,
            "upper_bound": upper,
        },
        {"policy": "even among what is allowed", "P": f"{found.uniform:.12g}", "lower_bound": "", "upper_bound": ""},
    ])  # fmt: skip
    print_facts({
        "actions allowed": f"{found.share:.1%} on average along runs of the latter",
        **({"mask": out} if out is not None else {}),
    })  # fmt: skip
