"""`stltool convert`: model files in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, ModelReading, Params
from stltool.cli.roles import Reads, Writes, model_files, written_model
from stltool.streams import say


@app.command("stltool convert model.tra model.umb")
def convert(
    source: Annotated[
        Path,
        typer.Argument(metavar="IN", help="model file, of any format that can be read", show_default=False),
        Reads("model file", model_files),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="model file to write: .umb, .drn, .drn.gz, .tra, .tra.gz", show_default=False
        ),
        Writes(written_model),
    ],
    reading: ModelReading = READ,
    param: Params = None,
    as_json: AsJson = False,
) -> None:
    """Convert a model file to another format: Storm's, PRISM's, or the one that both read (UMB).

    Exact probabilities stay exact; labels, signals and costs keep their names. What the other format cannot represent
    is refused, and names that it does not keep are reported. Files of another origin are not replaced.
    """
    from stltool.cli.steps import converted_model
    from stltool.models.save import files_of, not_kept, require_writable, save_model
    from stltool.reporting.terminal import note, print_json

    require_writable(target)
    model = converted_model(source, param, reading)
    save_model(model, target)
    written = [str(path) for path in files_of(target)]
    lost = not_kept(model, target)
    for what in lost:
        note(f"{target} does not keep {what}")
    if as_json:
        print_json({
            "source": str(source), "target": str(target), "files": written, "not_kept": lost, "name": model.name,
            "states": model.n_states, "choices": model.n_choices, "transitions": model.n_transitions,
            "actions": list(model.action_names), "signals": list(model.signals), "labels": list(model.labels),
            "costs": list(model.costs), "intervals": model.uncertain, "exact": model.rows.given_exactly,
        })  # fmt: skip
    else:
        say(str(model))
        say(f"written to {', '.join(written)}")
