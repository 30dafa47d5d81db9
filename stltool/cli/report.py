"""`stltool report`: rebuilds report pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Reads, Writes, beside
from stltool.errors import FileError


@app.command("stltool report out/first/report.json")
def report(
    data: Annotated[
        list[Path],
        typer.Argument(help="report.json files of earlier runs", show_default=False),
        Reads("report"),
        Writes(beside(".html")),
    ],
    as_json: AsJson = False,
) -> None:
    """Rebuild the HTML page of a report next to its JSON file."""
    from stltool.files import is_marked, require_own, write_result
    from stltool.reporting.page import read_report
    from stltool.reporting.terminal import print_facts, print_json

    for path in data:
        if path.is_dir():
            raise FileError(f"{path}: this is a folder; name its data, such as {path / 'report.json'}")
    pages = [path.with_suffix(".html") for path in data]
    texts = [read_report(path)[1] for path in data]
    for page in pages:
        require_own(page, "page", is_marked)
    for page, text in zip(pages, texts, strict=True):
        write_result(page, text, "page")
    if as_json:
        print_json({"reports": list(map(str, pages))})
        return
    for page in pages:
        print_facts({"report": page})
