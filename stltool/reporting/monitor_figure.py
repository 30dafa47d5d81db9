"""A monitored trace as a picture: signals with their predicates, labels, the formula's parts, robustness and verdicts.

If there are more samples than columns in the picture, envelopes are drawn and no sample is omitted: a curve goes
through the least and the greatest value of each column, and a column with any violated step is violated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from stltool.errors import TraceError
from stltool.logic.formula import (
    Arithmetic,
    Call,
    Comparison,
    Negate,
    Number,
    Term,
    Variable,
    label_names,
    variables,
    walk,
)
from stltool.logic.printer import with_names
from stltool.logic.task import Task
from stltool.monitoring.offline import MonitorResult, monitor
from stltool.monitoring.parts import part_verdicts
from stltool.numbers import shortest
from stltool.reporting.diagnosis import PARTS
from stltool.reporting.drawing import INK, alone, drawing, fitted, picture, shown, svg, text_width
from stltool.reporting.monitoring import both, robustness_text, true_ranges

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Reals: TypeAlias = NDArray[np.float64]
Booleans: TypeAlias = NDArray[np.bool_]
Causes: TypeAlias = Mapping[str, NDArray[np.int64]]
"""Samples that decided a verdict: name → steps."""

COLUMNS = 1500  # columns of the time axis, each a step or an envelope of several
PANELS, LANES, PREDICATES = 8, 12, 6  # signals, labels, and predicates on one signal, at most
HOLDS, VIOLATED, UNJUDGED = "#0072b2", "#d55e00", "#cccccc"  # Okabe and Ito's blue and vermillion
_PREDICATES = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a7000", "#7f7f7f")
_LABEL, _SMALL, _TINT = "#5f7f9f", 8, 0.11
_LARGEST = 1e100  # larger values are drawn here: matplotlib computes differences
_TALL = 88  # height of a panel in points, along which a signal's name is written
_LONGEST = 120  # characters of a formula in the title; half of it in a legend


@dataclass(frozen=True)
class Threshold:
    """Where on a signal's axis the truth of a comparison changes, and on which side it is true.

    `side` is "above" or "below" one value, "between" or "outside" two, and "anywhere" if the signal alone does not
    determine it.
    """

    values: tuple[float, ...] = ()
    side: str = "anywhere"


def monitored(
    result: MonitorResult,
    signals: dict[str, NDArray[Any]],
    task: Task,
    kind: str,
    trace: int | None = None,
    at: int | None = None,
    causes: Causes | None = None,
) -> str | bytes:
    """The picture as a file's content; `kind` is svg, png or pdf."""
    figure = monitor_figure(result, signals, task, trace, at, causes)
    return picture(figure, kind, "monitor", "a trace, its robustness and its verdicts")


@drawing()
def monitor_figure(
    result: MonitorResult,
    signals: dict[str, NDArray[Any]],
    task: Task,
    trace: int | None = None,
    at: int | None = None,
    causes: Causes | None = None,
) -> Figure:
    """One trace (in a batch: number `trace`) as a matplotlib figure; step `at` or the first violation is marked.

    `causes` are samples to be marked, name → steps.
    """
    verdicts, robustness = both(result)
    if trace is not None:
        verdicts, robustness = verdicts[trace], robustness[trace]
        signals = {name: values[trace] for name, values in signals.items()}
    names, labels = list(variables(task.formula)), list(label_names(task.formula))
    panels, lanes = names[:PANELS], labels[:LANES]
    parts, more = part_verdicts(task.formula, signals, result.end, PARTS)
    heights = [1.3] * len(panels) + [0.3 + 0.22 * len(some) for some in (lanes, parts) if some] + [1.3, 0.4]
    figure = Figure(figsize=(10, 1.2 + 1.1 * sum(heights)), layout="constrained")
    axes = figure.subplots(len(heights), sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    reading = _readers(task, panels)
    colours: dict[Comparison, str] = {}
    for panel, name in zip(axes, panels, strict=False):
        for node in reading[name]:
            colours.setdefault(node, _PREDICATES[len(colours) % len(_PREDICATES)])
        _signal_panel(panel, name, signals, reading[name], colours)
        _mark_causes(panel, signals[name], (causes or {}).get(name))
    if lanes:
        _label_panel(axes[len(panels)], lanes, signals)
        for i, name in enumerate(lanes):
            _mark_causes(axes[len(panels)], np.full(result.n_steps, i), (causes or {}).get(name))
    if parts:
        text = with_names(task.formulas, task.ticks)
        lines = [Lane(text(part.formula), part.verdicts) for part in parts]
        part_panel(axes[len(panels) + bool(lanes)], lines, result.n_steps)
    _robustness_panel(axes[-2], robustness)
    violated = np.flatnonzero(~verdicts)
    first = int(violated[0]) if len(violated) else None
    _verdict_strip(axes[-1], verdicts, result.n_steps)
    _mark(axes, first if at is None else at, verdicts, at is None)
    for panel in axes:
        panel.tick_params(labelsize=_SMALL)
        if panel.get_legend_handles_labels()[0]:
            legend = panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize=_SMALL, frameon=False)
            for handle in legend.legend_handles:
                handle.set_alpha(1.0)  # a tint would hardly be visible
    hidden = [
        f"{drawn} of the {all_} {what} are shown"
        for drawn, all_, what in (
            (len(panels), len(names), "signals"),
            (len(lanes), len(labels), "labels"),
            (len(parts), len(parts) + more, "parts"),
        )
        if drawn < all_
    ]
    axes[-1].set(xlabel="; ".join(["step", *hidden]), xlim=(-0.5, result.n_steps - 0.5))
    if task.ticks is not None:
        _time_axis(axes[0], task.ticks.number(1), task.ticks.unit)
    figure.align_ylabels(axes[:-1])
    figure.suptitle(_title(task, verdicts, robustness, trace, at), fontsize=10, x=0.01, ha="left", color=INK)
    return figure


def _title(task: Task, verdicts: Booleans, robustness: Reals, trace: int | None, at: int | None) -> str:
    told = [] if trace is None else [f"trace {trace}"]
    told += [] if task.path is None else [shown(task.name)]
    if at is not None:
        verdict = f"step {at}{_time(task, at)} {'holds' if verdicts[at] else 'violated'}, robustness "
        verdict += robustness_text(robustness[at])
    else:
        least = int(robustness.argmin())
        count = int((~verdicts).sum())
        verdict = f"violated at {count} of {len(verdicts)} steps" if count else f"holds at all {len(verdicts)} steps"
        verdict += f"; least robustness {robustness_text(robustness[least])} at step {least}{_time(task, least)}"
    return ": ".join([*told, verdict]) + "\n" + shown(str(task.formula), _LONGEST)


def _time(task: Task, step: int) -> str:
    return f" ({task.ticks.text(step)})" if task.ticks is not None else ""


# -------------------------------------------------------------------------------------------------------- the panels


def _signal_panel(
    axes: Axes,
    name: str,
    signals: dict[str, NDArray[Any]],
    comparisons: Sequence[Comparison],
    colours: dict[Comparison, str],
) -> None:
    """The curve, with each predicate's thresholds dashed, and its side of them tinted at steps where it holds."""
    values = signals[name].astype(np.float64)
    xs, ys = envelope(values)
    few, whole = len(values) <= 150, len(xs) == len(values)
    axes.plot(xs, ys, color=INK, linewidth=1.1 if whole else 0.6, marker="." if few else None, markersize=3, zorder=3,
              gid="signal")  # fmt: skip
    tests = {node: threshold(node, name) for node in comparisons[:PREDICATES]}
    levels = [level for test in tests.values() for level in test.values]
    low, high = _limits(ys, levels)
    axes.set_ylim(low, high)
    for node, test in tests.items():
        text = shown(str(node), _LONGEST // 2)
        try:
            truth = monitor(node, signals, semantics="boolean").verdicts
        except TraceError:  # no value, such as 1/0, at a step that the formula does not evaluate
            truth, text = np.zeros(len(values), dtype=np.bool_), f"{text} (has gaps)"
        assert truth is not None  # asked for
        for i, (bottom, top) in enumerate(_sides(test, low, high)):
            _bands(axes, truth, bottom, top, colours[node], text if i == 0 else None)
        for level in (level for level in test.values if low <= level <= high):
            axes.axhline(level, color=colours[node], linestyle="--", linewidth=1.0, gid="threshold")
    if len(comparisons) > PREDICATES:
        axes.plot([], [], linestyle="", label=f"and {len(comparisons) - PREDICATES} more")
    size = 9 if text_width(name, 9) <= _TALL else 7.5
    axes.set_ylabel(fitted(name, size, _TALL), fontsize=size)
    axes.grid(axis="x", alpha=0.25)


def _bands(axes: Axes, truth: Booleans, bottom: float, top: float, colour: str, label: str | None) -> None:
    """A light tint for columns with a step that holds, a stronger one if all their steps do."""
    some, every = coarse(truth, np.logical_or), coarse(truth, np.logical_and)
    for ranges, text, name in ((some, label, "some"), (every, None, "every")):
        axes.broken_barh(
            ranges, (bottom, top - bottom), facecolor=colour, alpha=_TINT, linewidth=0, label=text, gid=name
        )


def _sides(test: Threshold, low: float, high: float) -> list[tuple[float, float]]:
    """The tinted ranges of a panel from `low` to `high`."""
    first, *rest = [min(max(level, low), high) for level in test.values] or [low]
    match test.side:
        case "above":
            return [(first, high)]
        case "below":
            return [(low, first)]
        case "between":
            return [(first, rest[0])]
        case "outside":
            return [(low, first), (rest[0], high)]
        case _:
            return [(low, high)]


def _limits(values: Reals, levels: Sequence[float]) -> tuple[float, float]:
    """The range of the axis: all values, and those levels next to which they are more than a flat line."""
    low, high = float(values.min()), float(values.max())
    reach = 3 * (high - low) or math.inf
    near = [level for level in levels if max(low - reach, -_LARGEST) <= level <= min(high + reach, _LARGEST)]
    low, high = min([low, *near]), max([high, *near])
    room = 0.08 * (high - low) or 0.5 * (abs(high) or 1.0)
    return low - room, high + room


def _label_panel(axes: Axes, lanes: Sequence[str], signals: dict[str, NDArray[Any]]) -> None:
    for i, name in enumerate(lanes):
        truth = signals[name] != 0
        for part, combined in (("some", np.logical_or), ("every", np.logical_and)):
            bars = coarse(truth, combined)
            axes.broken_barh(bars, (i - 0.35, 0.7), facecolor=_LABEL, alpha=0.6, linewidth=0, gid=part)
    axes.set_yticks(range(len(lanes)), [shown(name, _LONGEST // 4) for name in lanes])
    axes.set(ylim=(len(lanes) - 0.4, -0.6))
    axes.set_ylabel("labels", fontsize=9)
    axes.grid(axis="x", alpha=0.25)


@dataclass(frozen=True, eq=False)
class Lane:
    """A part of the formula, and where it holds, (n_decided,); None if it has no value somewhere."""

    name: str
    verdicts: Booleans | None


def part_panel(axes: Axes, lanes: Sequence[Lane], n_steps: int) -> None:
    """A lane for each part: the bar is tall where it is true, low where it is false, a grey line where not judged."""
    for i, lane in enumerate(lanes):
        verdicts = lane.verdicts if lane.verdicts is not None else np.zeros(0, dtype=np.bool_)
        for ranges, height, colour, name in (
            (coarse(verdicts, np.logical_and), 0.7, HOLDS, f"true-{i}"),
            (coarse(~verdicts, np.logical_or), 0.3, VIOLATED, f"false-{i}"),
            ([(len(verdicts) - 0.5, n_steps - len(verdicts))] * (len(verdicts) < n_steps), 0.1, UNJUDGED, f"open-{i}"),
        ):
            if ranges:
                axes.broken_barh(ranges, (i - height / 2, height), facecolor=colour, alpha=0.8, linewidth=0, gid=name)
    axes.set_yticks(range(len(lanes)), [
        shown(lane.name, _LONGEST // 4) + (" (has gaps)" if lane.verdicts is None else "") for lane in lanes
    ])  # fmt: skip
    axes.set(ylim=(len(lanes) - 0.4, -0.6))
    axes.set_ylabel("parts", fontsize=9)
    axes.grid(axis="x", alpha=0.25)


@drawing()
def lane_picture(data: Mapping[str, Any], verdicts: Booleans | None) -> str:
    """The verdicts of a report's task and of its parts as SVG, and the samples that decided, signal by signal.

    `verdicts` are those of the task; None if one step was judged.
    """
    why = data.get("why") or {"causes": []}
    lanes = [Lane(data["task"] or "the formula", verdicts)] if verdicts is not None else []
    for part in data["subformulas"]:
        held = None
        if part["holds"] is not None:
            held = np.zeros(part["judged"], dtype=np.bool_)
            for first, last in part["holds"]:
                held[first : last + 1] = True
        lanes.append(Lane(part["formula"], held))
    lanes += [Lane(f"causes in {cause['signal']}", np.zeros(0, dtype=np.bool_)) for cause in why["causes"]]
    figure = Figure(figsize=(7.2, 0.8 + 0.3 * len(lanes)), layout="constrained")
    axes = figure.subplots()
    part_panel(axes, lanes, data["samples"])
    for i, cause in enumerate(why["causes"], start=len(lanes) - len(why["causes"])):
        _mark_causes(axes, np.full(data["samples"], i), np.array(cause["steps"], dtype=np.int64))
    axes.tick_params(labelsize=_SMALL)
    axes.set(xlabel="step", xlim=(-0.5, data["samples"] - 0.5), ylabel="")
    if data["step"] is not None:
        _time_axis(axes, data["step"], data["unit"])
    return svg(figure, "lanes", "where the task and its parts hold")


def _mark_causes(axes: Axes, values: NDArray[Any], steps: NDArray[np.int64] | None) -> None:
    """Circles around the samples that decided, one in each of the picture's columns at most."""
    if steps is None or not len(steps):
        return
    n = len(values)
    columns = np.searchsorted(_columns(n), steps, side="right") if n > COLUMNS else steps
    first = np.unique(columns, return_index=True)[1]
    heights = values[steps[first]].astype(np.float64).clip(-_LARGEST, _LARGEST)
    axes.plot(steps[first], heights, linestyle="", marker="o", markersize=5, markerfacecolor="none",
              markeredgecolor=VIOLATED, markeredgewidth=1.0, zorder=5, gid="cause", label="causes")  # fmt: skip


def _robustness_panel(axes: Axes, robustness: Reals) -> None:
    """The finite part, on its side of zero in the verdicts' colours."""
    finite = np.isfinite(robustness)
    xs, ys = envelope(robustness)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.plot(xs, ys, color=INK, linewidth=1.1 if len(xs) == len(robustness) else 0.6, gid="robustness")
    marked = alone(ys)
    axes.plot(xs[marked], ys[marked], linestyle="", marker=".", color=INK, markersize=5, gid="alone")
    for colour, side, name in ((HOLDS, ys >= 0, "positive"), (VIOLATED, ys <= 0, "negative")):
        axes.fill_between(xs, ys, 0.0, where=side, color=colour, alpha=0.25, linewidth=0, interpolate=True, gid=name)
    axes.set_ylim(*_limits(np.append(ys[np.isfinite(ys)], 0.0), ()))
    if not finite.all():
        axes.plot([], [], linestyle="", label=f"infinite at {len(finite) - finite.sum()}\nof {len(finite)} steps")
    if not finite.any():
        axes.set_yticks([0])
    axes.set_ylabel("robustness", fontsize=9)
    axes.grid(axis="x", alpha=0.25)


def _verdict_strip(axes: Axes, verdicts: Booleans, n_steps: int) -> None:
    """Violated steps are drawn taller than others, so that they can be distinguished without colours."""
    violated = coarse(~verdicts, np.logical_or)
    holding = coarse(verdicts, np.logical_and)
    if len(holding):
        axes.broken_barh(holding, (0.25, 0.5), facecolor=HOLDS, linewidth=0, label="holds", gid="holds")
    if len(violated):
        axes.broken_barh(violated, (0.0, 1.0), color=VIOLATED, linewidth=0.6, label="violated",  # never too thin to see
                         gid="violated")  # fmt: skip
    if len(verdicts) < n_steps:
        rest = [(len(verdicts) - 0.5, n_steps - len(verdicts))]
        axes.broken_barh(rest, (0.4, 0.2), facecolor=UNJUDGED, linewidth=0, label="not judged", gid="unjudged")
    axes.set(ylim=(0, 1), yticks=[])
    axes.set_ylabel("verdict", fontsize=9, rotation=0, ha="right", va="center")


def _time_axis(top: Axes, scale: float, unit: str) -> None:
    """The times of the steps, above the first panel; `scale` is the duration of a step."""

    def time_of(steps: ArrayLike) -> Reals:
        return np.asarray(steps, dtype=np.float64) * scale

    def step_of(times: ArrayLike) -> Reals:
        return np.asarray(times, dtype=np.float64) / scale

    times = top.secondary_xaxis("top", functions=(time_of, step_of))
    times.set_xlabel(f"time [{unit}]", fontsize=9)
    times.tick_params(labelsize=_SMALL)


def _mark(panels: Iterable[Axes], step: int | None, verdicts: Booleans, first: bool) -> None:
    """A dotted line through all panels at the first violation, or at the requested step."""
    if step is None:
        return
    colour = HOLDS if verdicts[step] else VIOLATED
    *_, strip = panels
    for panel in panels:
        panel.axvline(step, color=colour, linewidth=1.0, linestyle=":", zorder=4, gid="mark")
    text = f"first violated: step {step}" if first else f"selected: step {step}"
    strip.plot(step, 1.3, marker="v", color=colour, markersize=7, linestyle="", clip_on=False, label=text, gid="first")


# ---------------------------------------------------------------------------------------------------------- envelopes


def envelope(values: Reals) -> tuple[Reals, Reals]:
    """The curve of values (n,) as points: each sample, or each column's least and greatest; gaps where infinite."""
    values = np.where(np.isfinite(values), values.clip(-_LARGEST, _LARGEST), np.nan)
    n = len(values)
    if n <= 2 * COLUMNS:
        return np.arange(n, dtype=np.float64), values
    starts = _columns(n)
    centres = (starts + np.append(starts[1:], n) - 1) / 2
    ends = [np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)]
    return np.repeat(centres, 2), np.stack(ends, axis=1).ravel()


def coarse(truth: Booleans, combined: np.ufunc) -> list[tuple[float, float]]:
    """The ranges (left edge, width) in which truth (n,), column by column combined by "or" or "and", is true."""
    n = len(truth)
    if not n:
        return []
    starts = _columns(n) if n > COLUMNS else np.arange(n)
    stops = np.append(starts[1:], n)
    ranges = true_ranges(combined.reduceat(truth, starts))
    return [(float(starts[a]) - 0.5, float(stops[b - 1] - starts[a])) for a, b in ranges.tolist()]


def _columns(n: int) -> NDArray[np.int64]:
    """Where each of the picture's columns starts among n samples."""
    return np.arange(COLUMNS, dtype=np.int64) * n // COLUMNS


# --------------------------------------------------------------------------------------------------------- thresholds


def _readers(task: Task, panels: Sequence[str]) -> dict[str, list[Comparison]]:
    """The distinct comparisons that read each signal, in the formula's order."""
    reading: dict[str, dict[Comparison, None]] = {name: {} for name in panels}
    for node in walk(task.formula):
        if isinstance(node, Comparison):
            for name in variables(node):
                if name in reading:
                    reading[name][node] = None
    return {name: list(nodes) for name, nodes in reading.items()}


def threshold(node: Comparison, name: str) -> Threshold:
    """Where the truth of `a·name + b ⋈ c·name + d`, or of `|a·name + b| ⋈ d`, changes."""
    for inner, outer, flipped in ((node.left, node.right, False), (node.right, node.left, True)):
        if isinstance(inner, Call) and inner.function == "abs":
            line, bound = _affine(inner.args[0], name), _affine(outer, name)
            if line is None or bound is None or not line[0] or bound[0] or bound[1] < 0:
                return Threshold()
            low, high = sorted(_double((sign * bound[1] - line[1]) / line[0]) for sign in (-1, 1))
            greater = (node.op in (">", ">=")) != flipped
            return Threshold(
                (low, high), "anywhere" if node.op in ("==", "!=") else "outside" if greater else "between"
            )
    left, right = _affine(node.left, name), _affine(node.right, name)
    if left is None or right is None or left[0] == right[0]:
        return Threshold()
    slope = left[0] - right[0]
    value = _double((right[1] - left[1]) / slope)
    if node.op in ("==", "!="):
        return Threshold((value,))
    return Threshold((value,), "above" if (node.op in (">", ">=")) == (slope > 0) else "below")


def _double(value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.copysign(math.inf, value)


def _affine(term: Term, name: str) -> tuple[Fraction, Fraction] | None:
    """(a, b) where the term is a·name + b for numbers a and b, as written; None for any other term."""
    match term:
        case Number(value):
            return Fraction(0), shortest(value)
        case Variable(other):
            return (Fraction(1), Fraction(0)) if other == name else None
        case Negate(arg):
            inner = _affine(arg, name)
            return None if inner is None else (-inner[0], -inner[1])
        case Arithmetic(op, left, right):
            (a, b), (c, d) = _affine(left, name) or (None, None), _affine(right, name) or (None, None)
            if a is None or b is None or c is None or d is None:
                return None
            match op:
                case "+":
                    return a + c, b + d
                case "-":
                    return a - c, b - d
                case "*" if not a or not c:
                    return a * d + b * c, b * d
                case "/" if not c and d:
                    return a / d, b / d
                case _:
                    return None
        case _:
            return None
