"""The options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from stltool.cli.roles import Reads, Writes, model_files, task_files, within
from stltool.cli.words import Named

TaskFile = Annotated[Path, typer.Argument(help="task file (.stl)", show_default=False), Reads("task file", task_files)]
Model = Annotated[
    Path | None,
    typer.Option("--model", help="model file; default: the task file's model line"),
    Reads("model file", model_files),
]
Nominal = Annotated[
    bool,
    typer.Option("--nominal", help="for interval probabilities: use nominal values inside the intervals"),
    Named("nominal", " (--nominal)"),
]


class ModelReading(NamedTuple):
    """How model files are read: three options, in every command that reads one."""

    normalize: Annotated[
        bool,
        typer.Option(
            "--normalize", help="rescale probabilities that miss a sum of 1 only by rounding; reported on stderr"
        ),
    ] = False
    initial: Annotated[
        list[str] | None,
        typer.Option(
            "--initial",
            metavar="STATE|uniform",
            help="where runs start: a state's name or number, repeatable; or uniform over the file's initial states",
        ),
    ] = None
    deadlocks: Annotated[
        str,
        typer.Option(
            "--deadlocks",
            metavar="loop|error",
            help="states without transitions: they stay where they are, or are refused",
            autocompletion=lambda: ["loop", "error"],
        ),
    ] = "loop"

    def arguments(self) -> dict[str, Any]:
        """As `load_model` and `verify` take them."""
        return {**self._asdict(), "initial": self.initial or None}


READ = ModelReading()


TaskOrFormula = Annotated[
    str,
    typer.Argument(metavar="TASK|FORMULA", help="task file (.stl), or a formula in quotes", show_default=False),
    Reads("task file", task_files),
]
Step = Annotated[
    str | None, typer.Option("--step", metavar="TIME", help="duration of a step, if the bounds of a formula are times")
]
Unit = Annotated[
    str | None,
    typer.Option(
        "--unit", metavar="UNIT", help="with --step: what plain numbers in bounds are: s, another unit, or step"
    ),
]
TimeOf = Annotated[
    str | None,
    typer.Option(
        "--time",
        metavar="COLUMN",
        help="the trace's column of times; default: time, t or timestamp; none: rows are steps, whatever the times",
    ),
]
Resample = Annotated[
    str | None, typer.Option("--resample", help="put the signals on the step's grid by hold or linear; labels are held")
]
Tolerance = Annotated[float, typer.Option("--tolerance", help="by how much of a step a time may be off")]
Decimal = Annotated[str, typer.Option("--decimal", metavar="SIGN", help="a comma for files with decimal commas")]
Missing = Annotated[
    str, typer.Option("--missing", help="samples without a value: error, hold the last value, or drop the row")
]
PolicyFile = Annotated[
    Path | None,
    typer.Option(
        "--policy", help="policy file (.npz, .csv, .json, .policy) or Q-table (.csv); default: the best policy"
    ),
    Reads("policy"),
]
PolicyFunction = Annotated[
    str | None,
    typer.Option(
        "--policy-function",
        metavar="MODULE:FUNCTION",
        help="a Python function of a situation as policy; MODULE is imported, from this folder or the Python path",
    ),
]
Params = Annotated[
    list[str] | None,
    typer.Option(
        "--param",
        "-p",
        metavar="NAME=VALUE",
        help="override a param of the task file; or the value of a model's parameter",
    ),
]
TaskName = Annotated[str | None, typer.Option("--task", help="the definition to use; default: the last one")]
Encoding = Annotated[
    str,
    typer.Option(
        "--encoding",
        help="exact, paper (Wang et al. 2024: flags), history (tau-MDP); running and safety judge every step",
        autocompletion=lambda: ["exact", "paper", "history", "running", "safety"],
    ),
]
ReportFolder = Annotated[
    Path | None,
    typer.Option("--report", metavar="FOLDER", help="write report.html there, and report.json, which it is made from"),
    Writes(within("report.html", "report.json")),
]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON object instead of a table")]
Method = Annotated[
    str | None,
    typer.Option(
        "--method", "-m",
        help="model-based (default), cfer (default with --faithful), naive or naive-er; cfper as published",
        autocompletion=lambda: ["model-based", "cfer", "naive", "naive-er", "cfper"],
    ),
]  # fmt: skip
Faithful = Annotated[bool, typer.Option("--faithful", help="the method as published, including its slips")]
Episodes = Annotated[int, typer.Option("--episodes", "-e", help="training episodes")]
EvaluateEvery = Annotated[
    int, typer.Option("--evaluate-every", help="episodes between exact evaluations of the learned policy")
]
MostSteps = Annotated[
    int | None, typer.Option("--most-steps", help="stop before the total of environment steps could exceed this")
]
StopGap = Annotated[
    float | None, typer.Option("--stop-gap", help="stop once an evaluation is within this of the exact optimum")
]
UntilGap = Annotated[
    float | None,
    typer.Option(
        "--until-gap",
        help="stop once the transitions prove, with --confidence, that the policy is within this of the optimum",
    ),
]
Checkpoint = Annotated[
    Path | None,
    typer.Option("--checkpoint", help="file that keeps the run, to resume it after an interruption"),
    Writes(),
]
Resume = Annotated[bool, typer.Option("--resume", help="continue from the checkpoint, if there is one")]
CheckpointEvery = Annotated[float, typer.Option("--checkpoint-every", help="seconds between checkpoints")]
Seed = Annotated[int, typer.Option("--seed", "-s", help="seed of every random choice")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="a setting of the method, e.g. optimism=0.5; listed below"),
]
