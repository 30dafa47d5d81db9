"""`stltool monitor --follow`: judges a log while it is being written."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal, cast

import typer

from stltool.display import counted
from stltool.errors import SettingsError
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.logic.task import Task
    from stltool.monitoring import Decision
    from stltool.monitoring.logs import Reading


def follow(task: Task, trace: Path, reading: Reading, end: str, at: int | None, every: bool, as_json: bool) -> None:
    """Print each violated step (`every`: each step) as soon as it is certain, and stop early if `at` is decided.

    With `as_json`, one object at the end has all of them. Exit code 1 if a decided step is violated.
    """
    from stltool.logic.formula import label_names, variables
    from stltool.monitoring import OnlineMonitor
    from stltool.monitoring.logs.following import Following
    from stltool.reporting.following import Followed, followed_facts
    from stltool.reporting.terminal import print_facts, print_json

    clock = reading.clock(task.step)
    online = OnlineMonitor(task)
    names = [*{**variables(task.formula), **label_names(task.formula)}]
    found = Followed(task, end, at)

    def tell(decisions: Iterable[Decision], sample: int | None) -> None:
        for decision in decisions:
            line = found.add(decision, sample)
            if not as_json and line is not None and (every or at is not None or not decision.verdict):
                say(line, flush=True)

    with _opened(trace) as (where, file):
        following = Following(where, file, names, clock, reading.decimal)
        for n, sample in enumerate(following):
            tell(online.feed(sample), n)
            if found.settled:
                break
    if end != "error" and not found.settled:
        tell(online.finish(cast(Literal["cut", "hold"], end)), None)
    if at is not None and not found.settled:
        read = counted(online.n_steps, "sample")
        raise SettingsError(f"--at {at}: not decided by the {read} of {where}; give more, or --end cut or hold")
    data = found.data(where, online.n_steps, online.horizon, following.timing.says)
    if as_json:
        print_json(data)
    elif at is None:
        print_facts(followed_facts(data))
    if not data["holds"]:
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
