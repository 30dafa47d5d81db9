"""`stltool tradeoff`: the best probability of one task under constraints on others and on costs."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Encoding, Model, ModelReading, Params, TaskFile
from stltool.cli.roles import Writes
from stltool.cli.steps import make_joint_product
from stltool.cli.words import Named
from stltool.errors import SettingsError
from stltool.numbers import NumberError, bound_texts, ceiling_text, number_text, read, within_text
from stltool.streams import say


@app.command('stltool tradeoff tradeoff.stl --objective charging --require "patrolling>=0.9" --budget "C<=3"')
def tradeoff(
    task: TaskFile,
    objective: Annotated[str, typer.Option("--objective", metavar="NAME", help="the definition to maximise")],
    require: Annotated[
        list[str] | None, typer.Option("--require", metavar="NAME>=P", help="least probability of another definition")
    ] = None,
    budget: Annotated[
        list[str] | None,
        typer.Option("--budget", metavar="SIGNAL<=B", help="upper bound on the expected sum of a signal or label"),
    ] = None,
    save_policy: Annotated[
        Path | None,
        typer.Option("--save-policy", metavar="FILE", help="write the policy (.npz; text: .csv, .json)"),
        Writes(),
        Named("keep_policy", "leave --save-policy out, or "),
    ] = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The best probability of a task subject to bounds on the probabilities of others and on expected costs."""
    import stltool as stl
    from stltool.policy import require_policy_file
    from stltool.reporting import tradeoff_data
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    at_least = _read_bounds(require, ">=", "--require", "patrolling>=0.9")
    budgets = _read_bounds(budget, "<=", "--budget", "fuel<=12")
    if save_policy is not None:
        require_policy_file(save_policy)
    names = list(dict.fromkeys([objective, *at_least]))
    joint = make_joint_product(task, names, model, param, encoding, as_json, reading=reading)
    with progress_bar("checking what is possible", quiet=as_json) as bar:
        result = stl.tradeoff(
            joint, objective, at_least=at_least, budget=budgets, keep_policy=save_policy is not None, progress=bar
        )
    if save_policy is not None and result.policy is not None:
        result.policy.save(save_policy)
    if as_json:
        print_json(tradeoff_data(result))
        return
    print_facts({name: product.formula for name, product in zip(names, joint.tasks, strict=True)})
    say()
    figures = {f"P({name})": (figure, name, ">=", at_least) for name, figure in result.probabilities.items()}
    figures |= {f"E[{name}]": (figure, name, "<=", budgets) for name, figure in result.costs.items()}
    asked = {name: f">= {number_text(bound)}" for name, bound in at_least.items()}
    asked |= {name: f"<= {number_text(bound)}" for name, bound in budgets.items()}
    print_table(
        [
            {
                "": shown,
                "value": within_text(figure.value, figure.lower, figure.upper, 12),
                **dict(zip(("lower_bound", "upper_bound"), bound_texts(figure.lower, figure.upper), strict=True)),
                "asked": asked[name] if name in asked else "maximum"[: 7 * (name == objective)],
                "multiplier": f"{result.multipliers[name]:.6g}" if name in bounds else "",
            }
            for shown, (figure, name, sign, bounds) in figures.items()
        ]
    )
    say()
    size = result.size
    print_facts({
        "no policy exceeds": f"P({objective}) = {ceiling_text(result.bound, 12)}, a gap of {result.gap:.3g}",
        "status": result.status,
        "programme": f"{size['variables']} variables, {size['rows']} rows, {size['nonzeros']} non-zeros; "
                     f"{result.seconds:.1f} s in all",
        "randomised": f"at {result.randomised} of {size['rows']} triples (step, state, automaton state)",
        **({"policy": save_policy} if save_policy is not None else {}),
    })  # fmt: skip


def _read_bounds(texts: list[str] | None, sign: str, option: str, example: str) -> dict[str, Fraction]:
    """NAME>=P or NAME<=B, each name once."""
    bounds: dict[str, Fraction] = {}
    for text in texts or []:
        name, found, value = (part.strip() for part in text.partition(sign))
        if not found or not name:
            raise SettingsError(f'{option} {text}: expected a name, {sign} and a number; write {option} "{example}"')
        try:
            number = read(value)
        except NumberError as error:
            raise SettingsError(f'{option} {text}: {error}; write {option} "{example}"') from None
        if name in bounds:
            raise SettingsError(f"{option}: {name} has two bounds; give one")
        bounds[name] = number
    return bounds
