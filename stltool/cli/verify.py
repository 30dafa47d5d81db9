"""`stltool verify`: the gate. Judges every expectation of task files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from textwrap import indent
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Decimal, Missing, ModelReading, Params, Resample, TimeOf, Tolerance
from stltool.cli.roles import Reads, Writes, expectation_files, within
from stltool.cli.steps import read_params, this_command
from stltool.streams import say

_NO_CERTIFICATE = "none: no expectation has a probability that a certificate can prove; intervals and traces have none"


@app.command("stltool verify patrolling.stl --junit verify.xml --report out/verify")
def verify(
    files: Annotated[
        list[Path],
        typer.Argument(help="task files with expect lines", show_default=False),
        Reads("task file", expectation_files),
    ],
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FOLDER", help="write a page and its JSON: report.html, report.json"),
        Writes(within("report.html", "report.json")),
    ] = None,
    junit: Annotated[
        Path | None,
        typer.Option("--junit", metavar="FILE", help="write JUnit XML, which CI systems show"),
        Writes(),
    ] = None,
    markdown: Annotated[
        Path | None,
        typer.Option("--markdown", metavar="FILE", help="write a table in Markdown, for a pull request"),
        Writes(),
    ] = None,
    certificates: Annotated[
        Path | None,
        typer.Option(
            "--certificates", metavar="FOLDER", help="write a certificate of each probability; certify re-checks them"
        ),
        Writes(within()),
    ] = None,
    exact_seconds: Annotated[
        float,
        typer.Option(
            "--exact-seconds", help="time that an exact fraction may take where a bound lies inside the enclosure"
        ),
    ] = 60.0,
    param: Params = None,
    reading: ModelReading = READ,
    time: TimeOf = None,
    resample: Resample = None,
    tolerance: Tolerance = 0.01,
    missing: Missing = "error",
    decimal: Decimal = ".",
    as_json: AsJson = False,
) -> None:
    """Check every expectation of task files: expect Pmax(patrolling) >= 0.95.

    Exit code 0: all hold. 1: one does not hold, or is undecided. 2: a file is at fault, or an expectation cannot be
    judged.
    """
    import stltool as stl
    from stltool.files import require_result, write_result
    from stltool.logic.lint import about_expectations
    from stltool.reporting import junit_text, markdown_text, require_report, verification_data, write_report
    from stltool.reporting.terminal import error, note, print_facts, print_json, print_table, progress_bar, warn
    from stltool.reporting.verification import asked_text, counts_text, explained, place_text, verification_rows

    for file, what in ((junit, "JUnit file"), (markdown, "Markdown table")):
        if file is not None:
            require_result(file, what)
    if report is not None:
        require_report(report / "report.html")

    found = stl.verify(
        files,
        params=read_params(param),
        **reading.arguments(),
        certificates=certificates,
        exact_seconds=exact_seconds,
        stage=partial(progress_bar, quiet=as_json, patience=2.0),
        time=time,
        resample=resample,  # type: ignore[arg-type]  # checked there
        tolerance=tolerance,
        decimal=decimal,
        missing=missing,  # type: ignore[arg-type]
    )
    data = verification_data(found, this_command())
    if junit is not None:
        write_result(junit, junit_text(data), "JUnit file")
    if markdown is not None:
        write_result(markdown, markdown_text(data), "Markdown table")
    if report is not None:
        write_report(data, report / "report.html")
    for model in dict.fromkeys(one.result.product.model for one in found.results if one.result is not None):
        for key in ("normalize", "cells", "deadlocks"):
            if key in model.notes:
                note(f"{model.name}: {model.notes[key]}")
    for path in found.quiet:
        warn(f"{path}: this file has no expectations")
    for task in {result.path: result.task for result in found.results}.values():
        for advice in about_expectations(task):
            warn(str(advice))
    if as_json:
        print_json(data)
    else:
        print_table(verification_rows(data))
        shown: set[str] = set()  # several counts are explained by one table
        for row in data["expectations"]:
            told = explained(row) or ""
            if row["question"] == "cover" and told in shown:
                continue
            shown.add(told)
            if row["why"] is not None or (row["question"] == "cover" and row["verdict"] == "does not hold"):
                say(f"\n{place_text(row)}\n{indent(told, '  ')}")
            elif row["reason"] is not None and row["verdict"] != "error":
                print_facts({f"\n{place_text(row)}": row["reason"]})
        say()
        kept = {result.certificate.path for result in found.results if result.certificate is not None}
        written = {
            "certificates": f"{len(kept)} in {certificates}" if kept else _NO_CERTIFICATE if certificates else None,
            "report": report / "report.html" if report is not None else None,
            "JUnit": junit,
            "Markdown": markdown,
        }
        print_facts({"verified": counts_text(data), **{name: at for name, at in written.items() if at is not None}})
    for row in data["expectations"]:
        if row["verdict"] == "error":
            error(f"{place_text(row)}: {asked_text(row)}: {row['reason']}")
    if data["counts"]["error"]:
        raise typer.Exit(2)
    if not data["holds"]:
        raise typer.Exit(1)
