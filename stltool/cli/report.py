"""`stltool report`: pages made again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app


@app.command()
def report(
    data: Annotated[list[Path], typer.Argument(help="report.json files of earlier runs", show_default=False)],
) -> None:
    """Make the HTML page of a report again from its JSON, beside it."""
    from stltool.files import write_atomically
    from stltool.reporting import load_report, render
    from stltool.reporting.terminal import print_facts

    for path in data:
        page = path.with_suffix(".html")
        write_atomically(page, render(load_report(path)))
        print_facts({"report": page})
