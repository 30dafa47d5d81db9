"""Terminal output: progress on stderr, tables on stdout."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from stltool.display import NATURES
from stltool.kernels.jit import compiling
from stltool.log import LOG, Stage
from stltool.numbers import bound_texts, difference_text, fraction_text, probability_text, within_text
from stltool.reporting.runs import trace_text, verdict_text
from stltool.reporting.what_if import best_of_steps, chance_text
from stltool.reporting.words import run_sentences, sensitivity_sentences
from stltool.screen import Screen
from stltool.streams import escaped, printable, say

if TYPE_CHECKING:
    from stltool.checking.values import StateValues
    from stltool.learning.sweep import SweepProgress
    from stltool.reporting.records import SensitivityRecord

_LONGEST_FRACTION = 40  # characters in a table
_PATIENCE = 2.0  # seconds without output
Advance = Callable[..., None]
"""Called with (done, total), or while learning (episode, episodes, environment steps, exact probability or None)."""


@contextmanager
def progress_bar(title: str, quiet: bool = False, patience: float | None = None) -> Iterator[Advance | None]:
    """A bar on a terminal; in a log, a line at every tenth and at least every ten seconds, the first after `patience`.

    `quiet` shows no bar, and in a log only stages that take longer than that. Kernels that are compiled meanwhile are
    announced.
    """
    console = Screen(stderr=True)

    quiet = quiet or LOG.quiet

    def tell(kept: bool) -> None:
        if not quiet:
            (console.print if console.is_terminal else LOG.say)(_compiling_text(kept))

    with compiling(tell), _bar(console, title, quiet, patience) as advance:
        yield advance


@contextmanager
def _bar(console: Screen, title: str, quiet: bool, patience: float | None) -> Iterator[Advance | None]:
    if not console.is_terminal:
        with LOG.stage(title, None if quiet else patience) as stage:
            yield _to_log(stage, quiet)
    elif quiet:
        yield None
    else:
        note = TextColumn("{task.fields[note]}")
        columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), note, TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task(title, total=None, note="")

            def advance(done: int, total: int, steps: int = 0, probability: float | None = None) -> None:
                progress.update(bar, completed=done, total=total, note=", ".join(_notes(steps, probability)))

            yield advance


def _to_log(stage: Stage, quiet: bool) -> Advance:
    tenths = 0

    def advance(done: int, total: int, steps: int = 0, probability: float | None = None) -> None:
        nonlocal tenths
        stage.note = ", ".join([f"{done} of {total}", *_notes(steps, probability)])
        if not quiet and total >= 100 and done * 10 // total > tenths:
            tenths = done * 10 // total
            LOG.say(f"{stage.title}: {stage.note}")

    return advance


def _notes(steps: int, probability: float | None) -> list[str]:
    told = [f"{steps} steps"] if steps else []
    return told + ([] if probability is None else [f"exact P {probability_text(probability)}"])


@contextmanager
def sweep_bar(quiet: bool = False) -> Iterator[Callable[[SweepProgress], None] | None]:
    """Runs done, environment steps per second and time left; in a log, a line at every tenth of the runs."""
    console = Screen(stderr=True)
    start, quiet = time.perf_counter(), quiet or LOG.quiet

    def told(state: SweepProgress) -> str:
        passed = time.perf_counter() - start
        left = timedelta(seconds=round(passed * (1 - state.share) / state.share)) if state.share else "?"
        return f"{state.done} of {state.total} runs, {state.steps / passed:.3g} steps/s, about {left} left"

    if not console.is_terminal:
        with LOG.stage("sweep") as stage:
            stage.note = "no run is finished yet"

            def log(state: SweepProgress) -> None:
                stage.note = told(state)
                if not quiet and state.done * 10 // state.total > (state.done - 1) * 10 // state.total:
                    LOG.say(f"sweep: {stage.note}")

            yield log
    elif quiet:
        yield None
    else:
        columns = (TextColumn("sweep"), BarColumn(), TextColumn("{task.fields[note]}"))
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task("sweep", total=1.0, note="starting")

            def advance(state: SweepProgress) -> None:
                progress.update(bar, completed=state.share, note=told(state))

            yield advance


def _compiling_text(kept: bool) -> str:
    after = "once for this version" if kept else "in every run; set NUMBA_CACHE_DIR to a writable folder"
    return f"compiling the numerical kernels (some seconds, {after})"


@contextmanager
def kernels_ready(quiet: bool = False) -> Iterator[None]:
    """Announce that kernels are compiled in this block; usually they are only loaded, and nothing is printed."""
    console = Screen(stderr=True)
    status, quiet = console.status(""), quiet or LOG.quiet

    def tell(kept: bool) -> None:
        message = _compiling_text(kept)
        if quiet:
            return
        if console.is_terminal:
            status.update(message)
            status.start()
        else:
            LOG.say(message)

    with ExitStack() as stack:
        if not console.is_terminal:
            stack.enter_context(LOG.stage("loading the numerical kernels"))
        stack.callback(status.stop)
        stack.enter_context(compiling(tell))
        yield


@contextmanager
def working(title: str, quiet: bool = False) -> Iterator[None]:
    """Show on stderr what is going on: on a terminal at once, in a log only if it takes long."""
    console, quiet = Screen(stderr=True), quiet or LOG.quiet
    if not console.is_terminal:
        with LOG.stage(title, patience=None if quiet else _PATIENCE):
            yield
    elif quiet:
        yield
    else:
        with console.status(title):
            yield


def print_checks(checks: Sequence[Mapping[str, Any]]) -> None:
    """Probabilities with their bounds, one row per check; lines are never cut."""
    rows: list[tuple[str, ...]] = [("", "P", "lower bound", "upper bound", "gap", "status")]
    rows += [
        (
            ("the policy" if check["question"] == "policy" else f"{check['question']} over all policies")
            + (f", {NATURES[check['nature']]}" if check["nature"] in NATURES else ""),
            within_text(check["probability"], check["lower"], check["upper"]),
            *bound_texts(check["lower"], check["upper"]),
            difference_text(check["gap"]),
            check["status"],
        )
        for check in checks
    ]
    _print_columns(rows)


def print_state_values(values: StateValues) -> None:
    """P from each of several states, and where it is least and greatest."""
    say()
    print_table([
        {
            "from_state": each.name, "P": within_text(each.value, each.lower, each.upper),
            **dict(zip(("lower_bound", "upper_bound"), bound_texts(each.lower, each.upper), strict=True)),
            **({"exactly": fraction_text(each.fraction, _LONGEST_FRACTION)} if each.fraction is not None else {}),
        }
        for each in values
    ])  # fmt: skip
    if len(values) > 1:
        least, greatest = values.least, values.greatest
        print_facts({
            "least": f"{within_text(least.value, least.lower, least.upper)} from {least.name}",
            "greatest": f"{within_text(greatest.value, greatest.lower, greatest.upper)} from {greatest.name}",
        })  # fmt: skip


def print_facts(facts: dict[str, Any]) -> None:
    """Name and value, one per line; lines are never cut."""
    _print_columns([(name, str(value)) for name, value in facts.items()])


def print_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows of one kind, their keys as the heading."""
    if rows:
        heading = tuple(key.replace("_", " ") for key in rows[0])
        _print_columns([heading, *(tuple(str(value) for value in row.values()) for row in rows)])


def print_tree(data: Mapping[str, Any]) -> None:
    """A formula's operators, nested, each with its horizon (one per line; lines are never cut)."""
    from rich.tree import Tree

    def label(node: Mapping[str, Any]) -> Text:
        reach = f"  horizon {node['horizon']}" if node["horizon"] and node["operands"] else ""
        return Text.assemble(node["operator"], (reach, "dim"))

    def grow(node: Mapping[str, Any], tree: Tree) -> None:
        for operand in node["operands"]:
            grow(operand, tree.add(label(operand)))

    root = Tree(label(data))
    grow(data, root)
    Screen().print(root)


def print_likely(data: Mapping[str, Any], count: int) -> None:
    """The first `count` of the most probable runs of a verdict, three lines per run."""
    verdict, found = "satisfied" if data["satisfied"] else "violated", data["runs"]
    whole = probability_text(data["verdict_probability"])
    if not found:
        print_facts({verdict: "no run of positive probability"})
        return
    runs = "1 run" if len(found) == 1 else f"{len(found)} runs"
    if data["exhausted"]:
        told = f"in {runs} (there are no others)"
    elif data["asked_mass"] is None:
        told = f"{100 * data['covered']:.3g} % of it in the most probable {runs}"
    elif data["status"] == "complete":
        told = f"{runs} are the fewest that cover {100 * data['asked_mass']:.3g} % of it"
    else:
        told = data["status"]
    print_facts({verdict: f"probability {whole}; {told}"})
    for number, run in enumerate(found[:count], start=1):
        share = f", {100 * run['share']:.3g} %" if run["share"] is not None else ""
        rows = {f"run {number}": f"probability {run['probability']:.6g}{share}; {verdict_text(run)}"}
        rows[""] = trace_text(run["states"], run["labels"], run["actions"])
        say()
        print_facts(rows)
        if run["remembered"] is not None:
            print_facts({" " * len(f"run {number}"): f"before the verdict: {run['remembered']}"})
    if len(found) > count:
        print_facts({"\nand": f"{len(found) - count} more; -k prints more of them, --json all"})


def print_findings(data: Mapping[str, Any]) -> None:
    """The first findings of `why` in sentences."""
    say()
    for text in (*run_sentences(data, 1), *sensitivity_sentences(data["sensitive"], 1)):
        say(printable(text))


def print_what_if(data: Mapping[str, Any], run: str, policy: str | None, steps: bool) -> None:
    """What would have become of a run: each step with its best action, or all actions asked for."""
    verdict = {None: "undecided at its end", True: "satisfied", False: "violated"}[data["satisfied"]]
    print_facts({
        "task": f"{data['task']} := {data['formula']}",
        "run": f"{run}: {verdict}",
        "then": f"{policy or 'the best policy'} ({data['policy']})",
        "assuming": data["assumption"],
    })  # fmt: skip
    say()
    if not steps:
        print_table([
            {
                "step": one["step"], "state": one["state"], "action": one["action"],
                "P": within_text(one["probability"], one["lower"], one["upper"]),
                **({"exactly": one["fraction"]} if "fraction" in one else {}),
                "": "as it was" if one["taken"] else "",
            }
            for one in data["alternatives"]
        ])  # fmt: skip
        return
    print_table([
        {
            "step": row["step"], "state": row["state"], "action": row["taken"]["action"] if row["taken"] else "",
            "by chance": chance_text(data["noise"][row["step"]]), "best": row["best"]["action"],
            "P then": within_text(row["best"]["probability"], row["best"]["lower"], row["best"]["upper"]),
        }
        for row in best_of_steps(data["alternatives"])
    ])  # fmt: skip


def print_sensitive(rows: Sequence[SensitivityRecord]) -> None:
    """States by the effect of their success probability on P, with the most relevant actions."""
    say()
    if not rows:
        print_facts({"sensitive": "no state; no success probability affects P"})
    print_table(
        [
            {
                "state": row["name"],
                "dP/dp": f"{row['derivative']:.4g}",
                "steepest": f"{row['steepest']:.4g}",
                "visits": f"{row['visits']:.4g}",
                "mostly by": ", ".join(
                    f"{action['action']} to {action['intended']} (p = {action['success']:.4g})"
                    for action in row["actions"][:2]
                ),
            }
            for row in rows
        ]
    )


def _print_columns(rows: list[tuple[str, ...]]) -> None:
    rows = [tuple(map(printable, row)) for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    console = Screen()
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        console.print(Text.assemble((cells[0], "bold"), "  ", "  ".join(cells[1:]).rstrip()))


def print_json(data: Mapping[str, Any]) -> None:
    """One JSON object on a line, strictly: no NaN, no infinity."""
    say(json.dumps(data, allow_nan=False))


def print_text(text: str) -> None:
    """Print the text of a file in UTF-8, whatever the terminal's encoding; its bytes as they are to a file or pipe."""
    sys.stdout.flush()
    sys.stdout.buffer.write((escaped(text) if sys.stdout.isatty() else text).encode())


def error(message: str) -> None:
    """A message about the user's input, as plain text on stderr."""
    Screen(stderr=True).print(f"error: {message}")


def note(message: str) -> None:
    """Report something done on request, on stderr, where it does not mix with results."""
    say(f"note: {message}", error=True)


def warn(message: str) -> None:
    """Report something the user should know, on stderr, where it does not mix with results."""
    say(f"warning: {message}", error=True)
