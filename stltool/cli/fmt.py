"""`stltool fmt`: task files in their canonical layout."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Reads
from stltool.errors import StlToolError
from stltool.streams import say


@app.command("stltool fmt --check patrolling.stl")
def fmt(
    files: Annotated[
        list[Path], typer.Argument(help="task files; - for standard input", show_default=False), Reads("task file")
    ],
    check: Annotated[
        bool, typer.Option("--check", help="write nothing; exit code 1 if a file is not in its canonical layout")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Put task files into their canonical layout; comments are kept, and the meaning is checked to be the same.

    Warns about passages that other tools would read differently, and states their meaning here. A file that does not
    parse is left unchanged; its errors are reported, and the exit code is 2.
    """
    from stltool.files import read_text, text_of, write_atomically
    from stltool.logic.format import format_task
    from stltool.logic.lint import ambiguities
    from stltool.logic.syntax import LONGEST_TEXT, read
    from stltool.reporting.terminal import print_json, print_text, warn
    from stltool.source import Source

    told: list[dict[str, Any]] = []
    for path in files:
        piped = str(path) == "-"
        name = "standard input" if piped else str(path)
        try:
            if piped:
                text = text_of(sys.stdin.buffer.read(), name, "task file")
            else:
                text = read_text(path, "task file", LONGEST_TEXT)
            laid_out = format_task(text, name)
        except StlToolError as refusal:
            told.append({"file": name, "error": str(refusal)})
            continue
        advices = [str(advice) for advice in ambiguities(read(Source(name, text), "task"))]
        told.append({"file": name, "changed": laid_out != text, "ambiguities": advices})
        if not check and not piped and laid_out != text:
            write_atomically(path, laid_out)
        if piped and not check and as_json:
            told[-1]["text"] = laid_out
        if as_json:
            continue
        for advice in advices:
            warn(advice)
        if piped and not check:
            print_text(laid_out)
        elif laid_out != text:
            say(f"{name}: {'would be reformatted' if check else 'reformatted'}")
    if as_json:
        print_json({"check": check, "files": told})
    refusals = [file["error"] for file in told if "error" in file]
    if refusals:
        raise StlToolError("\n".join(refusals))
    if check and any(file["changed"] for file in told):
        raise typer.Exit(1)
