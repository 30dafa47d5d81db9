"""`stltool export`: automata in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson, Encoding, Model, Normalize, Params, TaskFile, TaskName
from stltool.cli.roles import Writes
from stltool.cli.steps import bind, compile_task, read_params, task_model
from stltool.errors import SettingsError


@app.command("stltool export patrolling.stl --to dot --out patrolling.dot")
def export(
    task: TaskFile,
    to: Annotated[str, typer.Option("--to", help="format: dot (Graphviz)")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="file to write; default: print it"), Writes()] = None,
    model: Model = None,
    normalize: Normalize = False,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Export the task's automaton: states are labelled with what they remember, edges with their conditions."""
    import stltool as stl
    from stltool.automata.graph import to_dot
    from stltool.files import require_result, write_result
    from stltool.reporting.terminal import print_json, print_text

    if to != "dot":
        raise SettingsError(f"--to {to}: there is no such format; known: dot")
    if out is not None:
        if out.suffix.lower() not in (".dot", ".gv"):
            raise SettingsError(f"--out {out}: Graphviz files end in .dot or .gv; use one of these extensions")
        require_result(out, "graph")
    loaded = stl.load_task(task, read_params(param), name)
    if model is not None or loaded.model is not None:
        automaton = bind(loaded, task_model(loaded, model, normalize), encoding).automaton
    else:
        automaton = compile_task(loaded, encoding)
    text = to_dot(automaton)
    if out is not None:
        write_result(out, text, "graph")
    if as_json:
        print_json({
            "task": loaded.name, "formula": str(loaded.formula), "horizon": automaton.horizon, "encoding": encoding,
            "automaton_states": automaton.n_states, "to": to, "out": str(out) if out is not None else None,
            "text": text if out is None else None,
        })  # fmt: skip
    elif out is None:
        print_text(text)
