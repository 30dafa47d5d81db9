"""`stltool diff`: what changed between two reports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Reads


@app.command("stltool diff old/report.json out/patrolling/report.json --tolerance 1e-6")
def diff(
    before: Annotated[
        Path,
        typer.Argument(help="report.json or its folder, or what a command printed with --json", show_default=False),
        Reads("report"),
    ],
    after: Annotated[Path, typer.Argument(help="the later one", show_default=False), Reads("report")],
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="numbers that differ by at most this are the same")
    ] = 1e-9,
    worse: Annotated[
        bool, typer.Option("--worse", help="exit code 1 only if something is worse: a bound, a policy's P, a guarantee")
    ] = False,
    everything: Annotated[
        bool, typer.Option("--all", help="every place, also where a part of the file differs in many")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show what changed between two reports, times aside; exit code 1 if anything did.

    Records are matched by what names them: a question, the source of a bound, a file. Something is worse if a verdict
    is (best to worst: holds, undecided, does not hold, error), a guarantee is weaker or gone, a certified gap larger,
    or a probability went the wrong way: down, or up if a bound asks for at most so much, or if no bound was given and a
    minimum was sought.
    """  # fmt: skip
    from dataclasses import asdict

    from stltool.errors import SettingsError
    from stltool.reporting.differences import difference_rows, differences, load_result, require_one_kind, summarised
    from stltool.reporting.terminal import print_facts, print_json, print_table

    if not 0 <= tolerance < float("inf"):
        raise SettingsError(f"--tolerance {tolerance:g}: give a number from 0, such as 1e-9")
    first, second = load_result(before), load_result(after)
    require_one_kind(first, second)
    found = differences(first, second, tolerance)
    bad = sum(one.worse for one in found)
    if as_json:
        print_json({"before": str(before), "after": str(after), "tolerance": tolerance, "worse": bad,
                    "differences": [asdict(one) for one in found]})  # fmt: skip
    else:
        print_table(difference_rows(found if everything else summarised(found)))
        places = f"in {len(found)} place{'s' if len(found) > 1 else ''}, of which {bad} for the worse"
        print_facts({"differs": places} if found else {"same": f"all but times; numbers up to {tolerance:g}"})
    if bad or (found and not worse):
        raise typer.Exit(1)
