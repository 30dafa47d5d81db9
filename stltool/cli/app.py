"""The application object that commands register with."""

from __future__ import annotations

from typing import Annotated

import typer


def _version(asked: bool) -> None:
    if asked:
        from importlib import metadata

        print(f"stltool {metadata.version('stltool')}")
        raise typer.Exit


app = typer.Typer(
    help="Signal temporal logic tasks on Markov decision processes, learned and verified exactly.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Signal temporal logic tasks on Markov decision processes, learned and verified exactly."""
