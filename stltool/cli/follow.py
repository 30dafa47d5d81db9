"""`stltool monitor --follow`: judges a log while it is being written."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal, cast

import typer

from stltool.errors import SettingsError

if TYPE_CHECKING:
    from stltool.logic.task import Task


def follow(task: Task, trace: Path, end: str, at: int | None, every: bool, decimal: str, time: str | None) -> None:
    """Print each violated step (`every`: each step) as soon as it is certain, and stop early if `at` is decided.

    Exit code 1 if a decided step is violated.
    """
    from stltool.logic.formula import label_names, variables
    from stltool.monitoring import Decision, OnlineMonitor
    from stltool.monitoring.logs.clock import NO_TIME
    from stltool.monitoring.logs.following import samples
    from stltool.reporting.terminal import print_facts

    if task.step is not None and time != NO_TIME:
        raise SettingsError(
            "--follow takes rows as steps and does not check their times, and the task declares a step; add --time none"
        )
    online = OnlineMonitor(task)
    names = [*{**variables(task.formula), **label_names(task.formula)}]
    decided = violated = 0
    first: int | None = None
    judged: Decision | None = None

    def tell(decision: Decision, when: str) -> None:
        nonlocal decided, violated, first, judged
        if at is not None and decision.step != at:
            return
        decided += 1
        judged = decision
        if not decision.verdict:
            violated += 1
            first = decision.step if first is None else min(first, decision.step)
        if every or at is not None or not decision.verdict:
            print(f"step {decision.step}  {'holds' if decision.verdict else 'violated'}, {when}", flush=True)

    with _opened(trace) as (where, file):
        for n, sample in enumerate(samples(where, file, names, decimal)):
            for decision in online.feed(sample):
                tell(decision, f"certain at step {n}")
            if at is not None and judged is not None:
                break
    if end != "error" and (at is None or judged is None):
        for decision in online.finish(cast(Literal["cut", "hold"], end)):
            tell(decision, "at the end of the trace")
    if at is not None and judged is None:
        raise SettingsError(
            f"--at {at}: not decided by the {online.n_steps} samples of {where}; give more, or --end cut or hold"
        )
    if at is None:
        left = online.n_steps - decided
        print_facts({
            "read": f"{online.n_steps} samples of {where}",
            "decided": f"{decided} steps" + (f"; the verdicts of {left} depend on what comes" if left else ""),
            "violated": f"at {violated} of them, first at step {first}" if violated else "at no step",
        })  # fmt: skip
    if violated:
        raise typer.Exit(1)


@contextmanager
def _opened(trace: Path) -> Iterator[tuple[str, IO[str]]]:
    """The name of a log in messages, and its text."""
    from stltool.monitoring.logs.readers import require_trace_file

    if str(trace) == "-":
        text = io.TextIOWrapper(sys.stdin.buffer, "utf-8", "surrogateescape", newline="")
        try:
            yield "standard input", text
        finally:
            text.detach()  # or standard input would be closed with it
        return
    if trace.suffix.lower() not in (".csv", ".tsv"):
        raise SettingsError(
            f"--follow reads CSV line by line, from .csv and .tsv files or from - (standard input), not {trace}"
        )
    require_trace_file(trace)
    with trace.open(encoding="utf-8", errors="surrogateescape", newline="") as file:
        yield str(trace), file
