"""`stltool fmt`: task files in their canonical layout."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.errors import StlToolError


@app.command()
def fmt(
    files: Annotated[list[Path], typer.Argument(help="task files; - for standard input", show_default=False)],
    check: Annotated[
        bool, typer.Option("--check", help="write nothing; exit code 1 if a file is not in its canonical layout")
    ] = False,
) -> None:
    """Put task files into their canonical layout; comments stay, and the meaning provably does.

    Places that other tools would read differently are told, with the reading that holds here. A file that does not
    parse is left alone, its errors are told, and the exit code is 2.
    """
    from stltool.files import read_text, write_atomically
    from stltool.logic.format import format_task
    from stltool.logic.lint import ambiguities
    from stltool.logic.syntax import LONGEST_TEXT, read
    from stltool.source import Source

    changed, refusals = [], []
    for path in files:
        piped = str(path) == "-"
        name = "standard input" if piped else str(path)
        try:
            text = sys.stdin.read() if piped else read_text(path, "task file", LONGEST_TEXT)
            laid_out = format_task(text, name)
        except StlToolError as refusal:
            refusals.append(str(refusal))
            continue
        for advice in ambiguities(read(Source(name, text), "task")):
            typer.echo(f"warning: {advice}", err=True)
        if laid_out != text:
            changed.append(name)
        if piped and not check:
            print(laid_out, end="")
        elif laid_out != text:
            if not check:
                write_atomically(path, laid_out)
            print(f"{name}: {'would be laid out anew' if check else 'laid out anew'}")
    if refusals:
        raise StlToolError("\n".join(refusals))
    if check and changed:
        raise typer.Exit(1)
