"""`stltool lint`: what is wrong with task files, or may be misread, without reading their models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Reads
from stltool.errors import StlToolError
from stltool.streams import say


@app.command("stltool lint patrolling.stl")
def lint(
    files: Annotated[list[Path], typer.Argument(help="task files (.stl)", show_default=False), Reads("task file")],
    as_json: AsJson = False,
) -> None:
    """Report passages of task files that other tools would read differently, and expectations that say nothing.

    Exit code 1 if there are any; 2 if a file does not parse, with all its errors. Models are not read. Notes leave the
    exit code as it is: operators that other tools define differently, with the text for the other definition, and
    equalities that computed values hardly ever fulfil.
    """
    import stltool as stl
    from stltool.reporting.terminal import print_json

    told: list[dict[str, Any]] = []
    for path in files:
        try:
            task = stl.load_task(path, unbounded=True)
            advices = stl.ambiguities(task)
            notes = stl.conventions(task)
        except StlToolError as refusal:
            told.append({"file": str(path), "error": str(refusal)})
            continue
        told.append({"file": str(path), "advice": list(map(str, advices)), "notes": list(map(str, notes))})
        if not as_json:
            for advice in advices:
                say(str(advice))
            for note in notes:
                say(f"note: {note}")
    if as_json:
        print_json({"files": told})
    refusals = [file["error"] for file in told if "error" in file]
    if refusals:
        raise StlToolError("\n".join(refusals))
    if any(file["advice"] for file in told):
        raise typer.Exit(1)
