"""`stltool new`: a folder to start from."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Writes
from stltool.starters import EXAMPLES, KINDS, example, starter
from stltool.streams import say


@app.command("stltool new shift --kind grid")
def new(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="NAME", help="folder to make; without it, a list", show_default=False),
        Writes(),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            "--kind",
            help="grid (default), gymnasium, prism or trace; see the list without NAME",
            autocompletion=lambda: list(KINDS),
        ),
    ] = None,
    shipped: Annotated[
        str | None,
        typer.Option(
            "--example",
            metavar="EXAMPLE",
            help="copy one of the examples instead",
            autocompletion=lambda: list(EXAMPLES),
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a folder with a commented task and model that run, or a copy of an example; without NAME, list them.

    Nothing is ever replaced: a folder that exists and is not empty is refused.
    """
    from importlib.util import find_spec

    from stltool.errors import SettingsError
    from stltool.files import write_folder
    from stltool.reporting.terminal import note, print_facts, print_json

    if kind is not None and shipped is not None:
        raise SettingsError("--kind and --example each say what to start from; give one of them")
    if folder is None:
        if kind is not None or shipped is not None:
            raise SettingsError("no folder is named; give it first, as in stltool new shift --kind grid")
        if as_json:
            print_json({"kinds": KINDS, "examples": EXAMPLES})
        else:
            print_facts({f"--kind {name}": what for name, what in KINDS.items()})
            print_facts({f"--example {name}": what for name, what in EXAMPLES.items()})
        return
    made = example(shipped) if shipped is not None else starter(kind if kind is not None else "grid")
    write_folder(folder, made.files)
    if as_json:
        print_json({"folder": str(folder), "files": list(made.files), "next": made.next})
        return
    print_facts({"made": f"{folder} with {', '.join(made.files)}", "next": shlex.join(["cd", str(folder)])})
    for command in made.next:
        say(f"      {command}")
    needs = any(re.search(rb'kind = "gymnasium"|^(from|import) gymnasium', text, re.M) for text in made.files.values())
    if needs and find_spec("gymnasium") is None:
        note("these commands need the package gymnasium, which is not installed; pip install 'stltool[gymnasium]'")
