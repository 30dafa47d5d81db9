"""`stltool sweep`: scenarios × methods × seeds, as a table and as learning curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.cli.roles import Reads, Writes, sweep_files, sweep_folder, within
from stltool.cli.steps import this_command
from stltool.errors import SettingsError
from stltool.numbers import NumberError, whole
from stltool.streams import say

_RESULTS = ("report.html", "report.json", "table.csv", "curves.csv", "figure.svg", "figure.png")


@app.command("stltool sweep sweep.toml --workers 2 --dry-run")
def sweep(
    file: Annotated[
        Path, typer.Argument(help="sweep file (.toml)", show_default=False), Reads("sweep file", sweep_files)
    ],
    only: Annotated[str | None, typer.Option("--only", metavar="ID,ID", help="run only these scenarios")] = None,
    method: Annotated[
        str | None, typer.Option("--method", "-m", metavar="ID,ID", help="run only these methods")
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds", metavar="N|N,N", help="number of seeds (0, 1, ...), or a list of seeds; overrides the file"
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", "-w", help="number of processes; default: one per core")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option("--cluster", metavar="ADDRESS", help="a dask scheduler whose workers execute the runs")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="folder for the results; default: out/NAME"),
        Writes(within(*_RESULTS), sweep_folder),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="list what would be run, with estimated times")] = False,
    as_json: AsJson = False,
) -> None:
    """Run every scenario with every method and seed, in parallel; finished runs are kept and not repeated.

    Exit code 0: all runs are finished. 2: some failed, or bad input. 130: interrupted; rerun the same command to
    continue.
    """
    import stltool as stl
    from stltool.checking.encodings import story_of
    from stltool.learning.sweep import finished_runs
    from stltool.reporting import sweep_data, write_sweep
    from stltool.reporting.sweeps import failure_text, failures_data, require_sweep, result_rows
    from stltool.reporting.terminal import error, print_facts, print_json, print_table, sweep_bar, warn

    if workers is not None and cluster is not None:
        raise SettingsError("--workers and --cluster: a cluster brings its own workers; give only one of the two")
    whole = stl.load_sweep(file)
    part = whole.select(_ids(only, "--only"), _ids(method, "--method"), _seeds(seeds))
    folder = out if out is not None else Path("out") / whole.name
    if dry_run:
        _dry_run(part, folder, workers, as_json)
        return
    require_sweep(folder)
    try:
        with sweep_bar(quiet=as_json) as bar:
            result = stl.run_sweep(part, folder, workers=workers, cluster=cluster, progress=bar)
    except KeyboardInterrupt:
        kept = len(finished_runs(part, folder).runs)
        error(f"interrupted; {kept} of {len(part.runs())} runs are finished and kept; continue with\n{this_command()}")
        raise typer.Exit(130) from None
    for place in result.damaged:
        warn(f"{place} was damaged; the run was repeated")
    # the report covers everything of the sweep in the folder, whatever part was requested this time
    shown = whole.select(seeds=sorted({*whole.seeds, *part.seeds}))
    known = finished_runs(shown, folder)
    finished = {run.scenario for run in known.runs}
    told = [one for one in whole.scenarios if whole.story and one.id in finished]
    stories = [story_of(one.id, one.product) for one in told]
    data = sweep_data(
        stl.SweepResult(shown, known.runs, result.failures, result.skipped),
        this_command(),
        stories=[story for story in stories if story is not None],
    )
    paths = write_sweep(data, folder) if known.runs else []
    if as_json:
        print_json(data)
    else:
        print_table(result_rows(data))
        for section in data["sections"]:
            say(f"\n{section['title']}: {section['text']}")
            print_table(section["rows"])
        if paths:
            say()
        print_facts({
            "runs": f"{len(result.runs)} finished, {result.skipped} of them earlier; {len(result.failures)} failed",
            **({"report": paths[0], "data": ", ".join(path.name for path in paths[1:])} if paths else {}),
        })  # fmt: skip
    for failure in failures_data(result.failures):
        error(failure_text(failure))
    if result.failures:
        raise typer.Exit(2)


def _dry_run(part: Any, folder: Path, workers: int | None, as_json: bool) -> None:
    """What is finished, what would be run, and roughly how long that takes."""
    import os

    from stltool.learning.sweep import estimated_seconds, finished_runs
    from stltool.reporting.terminal import kernels_ready, print_facts, print_json, print_table

    known = finished_runs(part, folder)
    done = {(run.scenario, run.method, run.seed) for run in known.runs}
    with kernels_ready(as_json):
        seconds = estimated_seconds(part, folder)
    rows: dict[tuple[str, str], list[int]] = {}
    for run in part.runs():
        if (run.scenario, run.method, run.seed) not in done:
            rows.setdefault((run.scenario, run.method), []).append(run.seed)
    used = workers if workers is not None else os.cpu_count() or 1
    work = sum(seconds.get(key, 0.0) * len(seeds) for key, seeds in rows.items())
    if as_json:
        runs = [
            {"scenario": scenario, "method": method, "seeds": seeds, "seconds_each": seconds.get((scenario, method))}
            for (scenario, method), seeds in rows.items()
        ]
        print_json({"finished": len(done), "runs": runs, "workers": used, "seconds": work / used})
        return
    print_table([
        {"scenario": scenario, "method": method, "seeds": ", ".join(map(str, seeds)),
         "about, each": f"{seconds.get((scenario, method), 0.0):.2f} s"}
        for (scenario, method), seeds in rows.items()
    ])  # fmt: skip
    print_facts({
        "to run": f"{sum(map(len, rows.values()))} runs in {folder}, {len(done)} already finished",
        "time": f"about {work / used:.1f} s with {used} worker{'s'[: used > 1]}",
    })  # fmt: skip


def _ids(text: str | None, option: str) -> list[str] | None:
    if text is None:
        return None
    ids = [one.strip() for one in text.split(",")]
    if not all(ids):
        raise SettingsError(f"{option} {text}: write names separated by commas, such as {option} P1,P2")
    return ids


def _seeds(text: str | None) -> int | list[int] | None:
    """3 means how many; 3,5 means which, and so does 3 followed by a comma."""
    if text is None:
        return None
    try:
        return [whole(one) for one in text.rstrip(",").split(",")] if "," in text else whole(text)
    except NumberError as error:
        raise SettingsError(f"--seeds: {error}; write a number of seeds, such as 3, or a list, such as 0,4,7") from None
