"""`stltool monitor`: judges a recorded trace at every step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stltool.cli.app import app
from stltool.cli.follow import follow
from stltool.cli.options import (
    AsJson,
    Decimal,
    Missing,
    Params,
    ReportFolder,
    Resample,
    Step,
    TaskName,
    TaskOrFormula,
    TimeOf,
    Tolerance,
    Unit,
)
from stltool.cli.roles import Reads, Writes
from stltool.cli.steps import load_task_or_formula, this_command
from stltool.errors import SettingsError, StlToolError, TraceError, marked
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.logic.task import Task
    from stltool.monitoring import MonitorResult
    from stltool.monitoring.logs import Log
    from stltool.monitoring.logs.recording import Signals
    from stltool.reporting.records import MonitorRecord

_ENDS = ("error", "cut", "hold")


@dataclass(frozen=True)
class Judged:
    """A file's signals, verdicts and data."""

    result: MonitorResult
    signals: Signals
    data: MonitorRecord

    @classmethod
    def of(cls, log: Log, task: Task, end: str, at: int | None, several: bool) -> Judged:
        import stltool as stl
        from stltool.reporting import monitor_data

        try:
            result = stl.monitor(task, log.signals, end=end)  # type: ignore[arg-type]  # checked before
            return cls(result, log.signals, monitor_data(result, task, log.where, at, log.timing.says))
        except StlToolError as error:
            of_this = several or isinstance(error, TraceError)
            raise type(error)(f"{log.where}: {marked(error)}") if of_this else error from None


def shown_of(judged: list[Judged], shown: int | None) -> tuple[MonitorResult, Signals, int | None]:
    """The verdicts and signals of the file that has the trace shown, and the trace's number there, if it is a batch."""
    before = 0
    for one in judged:
        traces = one.data["traces"]
        if shown is None or shown < before + (traces or 1):
            return one.result, one.signals, shown - before if shown is not None and traces is not None else None
        before += traces or 1
    raise AssertionError("shown_trace gave a trace that exists")


@app.command('stltool monitor "G[0,20] battery > 0.2" log.csv --plot log.png')
def monitor(
    task: TaskOrFormula,
    traces: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRACE...",
            help="trace files: .csv, .tsv (also .gz), .npz, .parquet, .mcap; - is CSV from standard input",
            show_default=False,
        ),
        Reads("trace"),
    ],
    end: Annotated[
        str,
        typer.Option(
            "--end", help="windows beyond the end of the trace: error (no verdict), cut, or hold the last sample"
        ),
    ] = "error",
    at: Annotated[
        int | None,
        typer.Option("--at", metavar="STEP", help="judge only this step; --at 0 judges the trace as a whole"),
    ] = None,
    which: Annotated[
        int | None,
        typer.Option(
            "--trace",
            metavar="N",
            help="in a batch or of files: the trace for --plot, --steps and --why; default: the first that violates",
        ),
    ] = None,
    steps: Annotated[bool, typer.Option("--steps", help="list every judged step")] = False,
    why: Annotated[
        bool,
        typer.Option(
            "--why", help="what decided the first violated step, or --at: sentences, and a minimal set of samples"
        ),
    ] = False,
    coverage: Annotated[
        bool,
        typer.Option(
            "--coverage",
            help="how much the traces say about each part of the task; judges the task file's lines expect cover",
        ),
    ] = False,
    following: Annotated[
        bool,
        typer.Option(
            "--follow",
            help="read rows as they come, from a CSV file or - (standard input), and print violations once certain",
        ),
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="draw the trace with its verdicts (.png, .svg, .pdf)"),
        Writes(),
    ] = None,
    report: ReportFolder = None,
    param: Params = None,
    name: TaskName = None,
    step: Step = None,
    unit: Unit = None,
    time: TimeOf = None,
    resample: Resample = None,
    tolerance: Tolerance = 0.01,
    missing: Missing = "error",
    decimal: Decimal = ".",
    as_json: AsJson = False,
) -> None:
    """Judge a recorded trace: at which steps the task holds, and by how much. Exit code 1 if any step is violated, or
    with --coverage if the traces say too little.

    TASK is read as a task file if one of that name exists or the name ends in .stl, otherwise as a formula. Names in it
    are columns of the trace.
    """
    import stltool as stl
    from stltool.gate import counted_over
    from stltool.logic.formula import is_bounded, label_names, variables
    from stltool.monitoring.coverage import Coverage
    from stltool.monitoring.logs import Reading
    from stltool.reporting import monitor_report, require_report, write_monitor_picture, write_report
    from stltool.reporting.diagnosis import diagnosis_data, diagnosis_lines
    from stltool.reporting.monitoring import (
        counted_rows,
        coverage_data,
        files_data,
        monitor_facts,
        range_rows,
        require_monitor_picture,
        shown_trace,
        step_lines,
        trace_name,
        trace_rows,
    )
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar, working

    if end not in _ENDS:
        raise SettingsError(f"--end {end}: choose {', '.join(_ENDS)}")
    if steps and as_json:
        raise SettingsError("--steps lists what --json contains already; keep one of them")
    if which is not None and plot is None and not steps and not why:
        raise SettingsError(f"--trace {which} selects the trace for --plot, --steps or --why; add one of them")
    if plot is not None:
        require_monitor_picture(plot)
    if report is not None:
        require_report(report / "report.html")
    reading = Reading(time, resample, tolerance, decimal, missing)  # type: ignore[arg-type]  # checked there
    loaded = load_task_or_formula(task, param, name, step, unit)
    names = {**variables(loaded.formula), **label_names(loaded.formula)}
    if not names:
        raise SettingsError(f"{loaded.formula}: this formula is constant; name a signal or a label of the trace")
    if following:
        beside = {
            "--trace": which is not None, "--why": why, "--plot": plot is not None, "--report": report is not None,
            "--coverage": coverage, "--resample": resample is not None, "--missing": missing != "error",
        }  # fmt: skip
        for option in (option for option, given in beside.items() if given):
            raise SettingsError(f"--follow prints verdicts as they come; {option} needs the whole trace: leave one out")
        if len(traces) > 1:
            raise SettingsError(f"--follow reads one trace as it grows; {len(traces)} files are given: name one")
        if not is_bounded(loaded.formula):
            raise SettingsError(
                f"{loaded.formula}: --follow needs intervals with an end, such as G[0,10]; leave out --follow to judge "
                "a whole trace, with --end cut or hold"
            )
        follow(loaded, traces[0], reading, end, at, steps, as_json)
        return
    judged = []
    for trace in traces:
        with working(f"reading {trace}", quiet=as_json):
            log = reading.log(trace, list(names), loaded.step, label_names(loaded.formula))
        with working("judging every step", quiet=as_json):
            judged.append(Judged.of(log, loaded, end, at, len(traces) > 1))
    data = judged[0].data if len(judged) == 1 else files_data([one.data for one in judged], loaded)
    shown = shown_trace(data, which)
    result, signals, within = shown_of(judged, shown)
    diagnosis = None
    if why:
        first = (data if shown is None else data["each"][shown])["first_violation"]
        asked = at if at is not None else first if first is not None else 0
        one = {key: values if within is None else values[within] for key, values in signals.items()}
        with progress_bar("finding causes", quiet=as_json, patience=2.0) as bar:
            diagnosis = stl.diagnose(loaded, one, asked, end=end, progress=bar)  # type: ignore[arg-type]
        data["why"] = diagnosis_data(diagnosis, shown)
    counts = None
    if coverage:
        with working("counting what the traces say", quiet=as_json):
            counts = Coverage(loaded)
            for part in judged:
                counts.add_all(part.signals, at or 0, end=end, every=at is None)  # type: ignore[arg-type]
        data["coverage"] = coverage_data(counts, counted_over(loaded, counts))
    if plot is not None:
        with working(f"drawing {plot}", quiet=as_json):
            write_monitor_picture(result, signals, loaded, plot, within, at, diagnosis.causes if diagnosis else None)
    if report is not None:
        _, shown_signals, number = shown_of(judged, shown_trace(data, None))
        one = shown_signals if number is None else {key: values[number] for key, values in shown_signals.items()}
        write_report(monitor_report(data, one, loaded, this_command()), report / "report.html")
    if as_json:
        print_json(data)
    else:
        print_facts(monitor_facts(data))
        rows, more = range_rows(data) if shown is None else trace_rows(data)
        if rows and (at is None or shown is not None):
            say()
            print_table(rows)
            if more:
                say(f"and {more} more; --json lists all")
        if why:
            say("\n" + "\n".join(diagnosis_lines(data["why"])))
        if counts is not None:
            say(f"\n{counts.report()}")
            if data["coverage"]["expectations"]:
                say()
                print_table(counted_rows(data["coverage"]))
        if steps:
            say(f"\n{trace_name(data, shown)}:" if shown is not None else "")
            say("\n".join(step_lines(data, shown)))
        if plot is not None:
            say()
            print_facts({"plot": f"{plot}" + (f", {trace_name(data, shown)}" if shown is not None else "")})
        if report is not None:
            print_facts({"report": report / "report.html"})
    counted = data["coverage"]["expectations"] if coverage else []
    if not data["holds"] or any(one["verdict"] != "holds" for one in counted):
        raise typer.Exit(1)
