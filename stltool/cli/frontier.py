"""`stltool frontier`: the tightest values of a task's params for which the optimum reaches a bound."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated, cast

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Model, ModelReading, Params, ReportFolder, TaskFile, TaskName
from stltool.cli.roles import Writes
from stltool.cli.steps import load_with_model, read_probability, this_command
from stltool.errors import SettingsError
from stltool.logic.quantities import quantity
from stltool.numbers import bound_texts, number_text, within_text
from stltool.streams import say

_MOST = 20_000  # values of a range


@app.command("stltool frontier patrolling.stl --at-least 0.95 --vary T=1:15 --vary tau=1:12")
def frontier(
    task: TaskFile,
    at_least: Annotated[str, typer.Option("--at-least", metavar="P", help="the probability that is to be reached")],
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="NAME=FROM:TO",
            help="a param and its values: FROM:TO, FROM:TO:STEP, or a list such as 1s,2s,5s; or its name alone, for "
            "values around that of the file; once or twice",
        ),
    ],
    minimize: Annotated[
        bool, typer.Option("--minimize", help="ask it of every policy instead of the best one")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="draw which values reach P (.svg or .png)"),
        Writes(),
    ] = None,
    report: ReportFolder = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    as_json: AsJson = False,
) -> None:
    """How to relax a task: the tightest values of one or two params for which P reaches a bound."""
    import stltool as stl
    from stltool.reporting import frontier_data, frontier_report, require_report, write_answer_picture, write_report
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar
    from stltool.reporting.tradeoffs import require_picture

    bound = read_probability(at_least, "--at-least")
    parameters = dict(map(_values, vary))
    if len(parameters) < len(vary):
        raise SettingsError("--vary names a param twice; give each once")
    if plot is not None:
        require_picture(plot)
    if report is not None:
        require_report(report / "report.html")
    (loaded,), world = load_with_model(task, model, param, [name], reading)
    with progress_bar("checking", quiet=as_json) as bar:
        found = stl.frontier(world, loaded, bound, parameters, maximize=not minimize, progress=bar)
    page = frontier_report(found, this_command())
    if plot is not None:
        write_answer_picture(page, plot)
    if report is not None:
        write_report(page, report / "report.html")
    if as_json:
        print_json(frontier_data(found))
        return
    directions = {1: "larger is weaker", -1: "larger is stronger", 0: "no direction is proved"}
    print_facts({
        "task": f"{loaded.name} := {loaded.formula}",
        "asked": f"{found.question} P >= {number_text(bound)}",
        **{one.name: directions[one.direction] for one in found.params},
    })  # fmt: skip
    rows = []
    for row in found.table():
        lower, upper = cast("float", row.pop("lower")), cast("float", row.pop("upper"))
        value = within_text(cast("float", row.pop("P")), lower, upper)
        bounds = dict(zip(("lower_bound", "upper_bound"), bound_texts(lower, upper), strict=True))
        rows.append({**row, "P": value, **bounds})
    say()
    print_table(rows)
    say()
    combinations = len(found.params[0].values) * (len(found.params[1].values) if len(found.params) > 1 else 1)
    undecided = len(found.undecided)
    print_facts({
        "checks": f"{len(found.probes)} of {combinations}, by {found.method}",
        **({"undecided": f"{undecided}, which count as missing the bound"} if undecided else {}),
        **found.told,
        **({"plot": plot} if plot is not None else {}),
        **({"report": report / "report.html"} if report is not None else {}),
    })  # fmt: skip


def _values(text: str) -> tuple[str, list[str | Fraction] | None]:
    """The param with its values, or None for those around its own."""
    name, equals, listed = text.partition("=")
    if name.strip() and not equals:
        return name.strip(), None
    example = "write, for example, --vary T=1:15, or --vary T=1s,2s,5s"
    if not (name.strip() and equals and listed.strip()):
        raise SettingsError(f"--vary {text}: write a param and its values; {example}")
    name = name.strip()
    if ":" not in listed:
        return name, list(listed.split(","))
    ends = [quantity(name, part) for part in listed.split(":")]
    if len(ends) > 3 or not all(isinstance(end, Fraction) for end in ends):
        raise SettingsError(f"--vary {text}: a range is of plain numbers, FROM:TO or FROM:TO:STEP; {example}")
    first, last, step = (*cast("list[Fraction]", ends), Fraction(1))[:3]
    if step <= 0 or last < first:
        raise SettingsError(f"--vary {text}: the lower end of a range comes first, and the step is positive; {example}")
    count = (last - first) // step + 1
    if count > _MOST:
        raise SettingsError(f"--vary {text}: {count} values are more than {_MOST}; give fewer")
    return name, [first + i * step for i in range(count)]
