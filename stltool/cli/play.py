"""`stltool play`: a policy, move by move in the terminal."""

from __future__ import annotations

import io
import shlex
import sys
from collections.abc import Iterator
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import (
    READ,
    AsJson,
    Encoding,
    Model,
    ModelReading,
    Nominal,
    Params,
    PolicyFile,
    PolicyFunction,
    Seed,
    TaskFile,
    TaskName,
)
from stltool.cli.steps import given_policy, make_product, require_one_policy
from stltool.errors import SettingsError
from stltool.streams import say


@app.command("stltool play patrolling.stl --policy policy.npz")
def play(
    task: TaskFile,
    policy: PolicyFile = None,
    policy_function: PolicyFunction = None,
    moves: Annotated[
        str | None,
        typer.Option(
            "--moves",
            metavar="LIST",
            help='moves to make instead of asking, such as ". N N>(2,1) *"; write names without their spaces '
            "(go>x=0,y=1), or in quotes, or a state's number (go>3)",
        ),
    ] = None,
    seed: Seed = 0,
    nominal: Nominal = False,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Step through a run of a policy, with P at every step; take other actions and see what they cost."""
    import stltool as stl
    from stltool.checking.playing import Game
    from stltool.randomness import require_seed
    from stltool.reporting.playing import HELP, Told
    from stltool.reporting.terminal import print_json, progress_bar
    from stltool.screen import Screen

    require_one_policy(policy, policy_function)
    require_seed(seed)
    listed = _split(moves) if moves is not None else None
    if listed is not None and not listed:
        raise SettingsError('--moves is empty; list moves, such as --moves ". N *", or leave it out to be asked')
    product = make_product(task, model, param, name, encoding, as_json, nominal=nominal, reading=reading)
    if product.model.blackbox is not None:
        raise SettingsError(f"{product.model.name} is a black box, whose probabilities are unknown; play needs them")
    chosen = given_policy(product, policy, policy_function)
    with progress_bar("checking", quiet=as_json) as bar:
        chosen = chosen if chosen is not None else stl.check(product, progress=bar).policy
        assert chosen is not None  # set by every check
        game = Game(product, chosen, seed)
        told = Told(game)
    kept = io.StringIO() if moves is not None else None  # nothing is printed if one of them is refused
    console = Screen(file=kept)
    if not as_json:
        told.show(console)
    for move in _asked() if listed is None else listed:
        if move == "q":
            break
        if move == "?":
            console.print(HELP)
            continue
        try:
            remark = game.move(move)
        except SettingsError as error:
            if kept is not None:
                raise
            console.print(str(error))
            continue
        if not as_json:
            console.print()
            if remark is not None:
                console.print(remark)
            told.show(console)
    if listed is None and not as_json:
        console.print(told.ending())
    if kept is not None:
        say(kept.getvalue(), end="")
    if as_json:
        print_json(told.data())


def _split(moves: str) -> list[str]:
    """A list of moves; SettingsError if a quote is not closed."""
    words = shlex.shlex(moves, posix=True, punctuation_chars=False)
    words.whitespace_split, words.commenters, words.escape = True, "", ""
    try:
        return list(words)
    except ValueError:
        raise SettingsError(f"--moves {moves}: a quotation mark is not closed") from None


def _asked() -> Iterator[str]:
    """The lines of stdin, asked for until it ends."""
    while True:
        say("move (? for help): ", end="", error=True, flush=True)
        line = sys.stdin.readline()
        if not line:
            say(error=True)
            return
        yield line.strip()
