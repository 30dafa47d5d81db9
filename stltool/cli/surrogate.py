"""`stltool surrogate`: where the surrogate objective of [Wang24] leads if it is learned perfectly."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Model, ModelReading, Nominal, Params, TaskFile, TaskName
from stltool.cli.steps import make_product


@app.command("stltool surrogate patrolling.stl -p T=20")
def surrogate(
    task: TaskFile,
    gamma: Annotated[
        float, typer.Option("--gamma", help="discount, as in the published runs; the paper states 0.9999")
    ] = (0.999),
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    as_json: AsJson = False,
) -> None:
    """Compare P of the policies optimal for the surrogate reward of Wang et al. (2024) with the best possible P."""
    import stltool as stl
    from stltool.checking.surrogate import READINGS
    from stltool.reporting import product_data, surrogate_data
    from stltool.reporting.story import gap_text, reading_text
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    product = make_product(task, model, param, name, "exact", as_json, nominal=nominal, reading=reading)
    with progress_bar("solving the surrogate", quiet=as_json) as bar:
        results = [stl.surrogate_optimum(product, reading, gamma=gamma, progress=bar) for reading in READINGS]
    data: dict[str, Any] = {**product_data(product), "surrogates": [surrogate_data(result) for result in results]}
    if as_json:
        print_json(data)
        return
    print_facts({"task": f"{product.task_name} := {product.formula}", "P*": f"{results[0].optimum.probability:.15g}"})
    print_table([
        {
            "surrogate": reading_text(reading),
            "P, ties at random": f"{reading['at_random']:.15g}",
            "gap": gap_text(reading, "at_random"),
            "least P": f"{reading['least']:.15g}",
            "greatest P": f"{reading['greatest']:.15g}",
            "status": reading["status"],
        }
        for reading in data["surrogates"]
    ])  # fmt: skip
