"""The application object that commands register with."""

from __future__ import annotations

import typer

app = typer.Typer(
    help="Signal temporal logic tasks on Markov decision processes, learned and verified exactly.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
