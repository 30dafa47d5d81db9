"""`stltool pareto`: the Pareto front of two tasks."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Encoding, Model, ModelReading, Params, ReportFolder, TaskFile
from stltool.cli.roles import Writes
from stltool.cli.steps import make_joint_product, this_command
from stltool.errors import SettingsError
from stltool.numbers import most_text
from stltool.streams import say


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number}{path.suffix}")


def _numbered_files(path: Path) -> list[Path]:
    """The files that may be written, of those there are."""
    return [path, *sorted(path.parent.glob(f"{glob.escape(path.stem)}-*{glob.escape(path.suffix)}"))]


@app.command("stltool pareto tradeoff.stl --tasks charging,patrolling --plot front.svg")
def pareto(
    task: TaskFile,
    tasks: Annotated[str, typer.Option("--tasks", metavar="NAME,NAME", help="two definitions of the task file")],
    points: Annotated[int, typer.Option("--points", help="maximum number of backward inductions")] = 100,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="draw the front (.svg or .png)"), Writes()
    ] = None,
    save_policies: Annotated[
        Path | None,
        typer.Option(
            "--save-policies",
            metavar="FILE",
            help="write each corner's policy (.npz; text: .csv, .json) to FILE with the corner's number: front-1.npz",
        ),
        Writes(_numbered_files),
    ] = None,
    report: ReportFolder = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The Pareto front of two tasks: the pairs of probabilities where improving one lowers the other."""
    import stltool as stl
    from stltool.policy import require_policy_file
    from stltool.reporting import front_data, front_report, require_report, write_front_picture, write_report
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar
    from stltool.reporting.tradeoffs import require_picture

    names = [name.strip() for name in tasks.split(",")]
    if len(names) != 2 or not all(names):
        raise SettingsError(
            f"--tasks {tasks}: two names are needed, separated by a comma; write, for example, --tasks a,b"
        )
    if plot is not None:
        require_picture(plot)
    if save_policies is not None:
        for file in _numbered_files(save_policies):
            require_policy_file(file)
        if save_policies.suffix.lower() == ".policy":
            raise SettingsError(
                f"--save-policies {save_policies}: policies of corners are saved as .npz, .csv or .json"
            )
    if report is not None:
        require_report(report / "report.html")
    joint = make_joint_product(task, names, model, param, encoding, as_json, reading=reading)
    with progress_bar("finding corners", quiet=as_json) as bar:
        front = stl.pareto(joint, points=points, progress=bar)
    if plot is not None:
        write_front_picture(front, plot)
    files = {}
    if save_policies is not None:
        files = {i: _numbered(save_policies, i + 1) for i in range(len(front.corners))}
        for i, file in files.items():
            front.corners[i].policy.save(file)
    if report is not None:
        write_report(front_report(front, this_command()), report / "report.html")
    if as_json:
        print_json(front_data(front))
        return
    print_facts({name: product.formula for name, product in zip(names, joint.tasks, strict=True)})
    say("\ncorners of the front (mixtures of policies reach the segments between neighbours):")
    print_table(
        [
            {
                **{f"P({name})": f"{value:.12g}" for name, value in zip(names, corner.point, strict=True)},
                **{f"weight_{name}": f"{weight:.6g}" for name, weight in zip(names, corner.weights, strict=True)},
                **({"policy": files[i]} if files else {}),
            }
            for i, corner in enumerate(front.corners)
        ]
    )
    say()
    print_facts({
        "front": f"{front.status}; {front.inductions} backward inductions, {front.seconds:.1f} s",
        "gap": f"at most {most_text(front.gap)} above the segments",
        **({"plot": plot} if plot is not None else {}),
        **({"report": report / "report.html"} if report is not None else {}),
    })  # fmt: skip
