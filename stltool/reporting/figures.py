"""The pictures: learning curves, floor map, Pareto front; SVG text, or PNG. The only module that imports matplotlib,
with `monitor_figure`.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABEL_COLOURS = ("#9ecae1", "#fdae6b", "#a1d99b", "#bcbddc", "#fa9fb5", "#fee391", "#c7e9c0", "#d9d9d9")
_METHOD_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito's
_INK, _BLOCKED, _RUN, _CURVE = "#222222", "#4a4a4a", "#b2182b", "#2166ac"


def learning_curve(data: dict[str, Any]) -> str:
    """Exact probability of the greedy policy over environment steps, with the optimum."""
    history = data["training"]["history"]
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.plot([p["steps"] for p in history], [p["probability"] for p in history], color=_CURVE, linewidth=1.8,
              label="greedy policy, exact")  # fmt: skip
    optimum = next((c for c in data["checks"] if c["question"] != "policy"), None)
    if optimum is not None:
        axes.axhline(optimum["probability"], color=_RUN, linestyle="--", linewidth=1.2,
                     label=f"optimum {optimum['probability']:.6g}")  # fmt: skip
    axes.set(xlabel="environment steps", ylabel="P(task)", ylim=(-0.03, 1.03))
    axes.grid(alpha=0.25)
    axes.legend(loc="lower right", frameon=False)
    return _svg(figure, "curve")


def floor_map(data: dict[str, Any], states: list[int] | None = None) -> str:
    """The floor with its labels, and a run (default: the sampled one) as a path numbered by steps."""
    floor = data["floor"]
    width, height = floor["width"], floor["height"]
    scale = min(0.8, 6.4 / max(width, height))
    figure = Figure(figsize=(scale * width + 0.6, scale * height + 0.6), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal", xlabel="column", ylabel="row")
    for axis, size in ((axes.xaxis, width), (axes.yaxis, height)):
        ticks = range(0, size, max(1, size // 10))
        axis.set_ticks([tick + 0.5 for tick in ticks], [str(tick) for tick in ticks])
    axes.set_facecolor(_BLOCKED)
    _cells(axes, range(len(floor["column"])), floor, "white")
    for i, (name, states) in enumerate(floor["labels"].items()):
        _cells(axes, states, floor, _LABEL_COLOURS[i % len(_LABEL_COLOURS)])
        for s in states:
            axes.text(floor["column"][s] + 0.06, floor["row"][s] + 0.94, name, va="top", fontsize=13 * scale,
                      color=_INK, alpha=0.75)  # fmt: skip
    for s in floor["initial"]:
        axes.text(floor["column"][s] + 0.06, floor["row"][s] + 0.94, "start", va="top", fontsize=11 * scale, color=_INK)
    if states is None and data["run"] is not None:
        states = data["run"]["states"]
    if states is not None:
        _path(axes, states, floor, scale)
    return _svg(figure, "floor")


def pareto_front(data: dict[str, Any], kind: str) -> str | bytes:
    """The achievable pairs under the corners' polygon; `kind` is svg or png."""
    first, second = data["tasks"]
    points = [[corner["probabilities"][name]["value"] for name in (first, second)] for corner in data["corners"]]
    xs, ys = np.array([[0.0, points[-1][1]], *points[::-1], [points[0][0], 0.0]]).T
    figure = Figure(figsize=(5.4, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.fill([0.0, *xs], [0.0, *ys], color=_CURVE, alpha=0.12, linewidth=0)
    axes.plot(xs, ys, color=_CURVE, linewidth=1.0, linestyle=":")
    axes.plot(xs[1:-1], ys[1:-1], color=_CURVE, linewidth=1.8, marker="o", markersize=4, label="Pareto front, exact")
    axes.set(xlabel=f"P({first})", ylabel=f"P({second})", xlim=(0, 1.03), ylim=(0, 1.03), aspect="equal")
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", frameon=False)
    return picture(figure, kind, "front")


def learning_curves(data: dict[str, Any], kind: str) -> str | bytes:
    """A sweep's exact learning curves, a panel a scenario: median and quartiles over the seeds, the optimum dashed.

    `kind` is svg or png.
    """
    from stltool.reporting.sweeps import panel_title

    scenarios, columns = data["scenarios"], min(data["columns"], len(data["scenarios"]))
    rows = -(-len(scenarios) // columns)
    figure = Figure(figsize=(max(4.2, 3.2 * columns), 2.3 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    style = {method["id"]: i for i, method in enumerate(data["methods"])}
    for panel, scenario in zip(panels, scenarios, strict=False):
        for result in data["results"]:
            if result["scenario"] != scenario["id"]:
                continue
            curve, i = result["curve"], style[result["method"]]
            colour = _METHOD_COLOURS[i % len(_METHOD_COLOURS)]
            panel.fill_between(curve["steps"], curve["q1"], curve["q3"], color=colour, alpha=0.18, linewidth=0)
            line = ("-", "--", "-.", ":")[i // len(_METHOD_COLOURS) % 4]
            panel.plot(curve["steps"], curve["median"], color=colour, linewidth=1.5, linestyle=line,
                       label=result["method"])  # fmt: skip
        panel.axhline(scenario["optimum"], color=_INK, linestyle="--", linewidth=0.9, label="optimum")
        panel.set(ylim=(-0.03, 1.03))
        panel.set_title(panel_title(scenario), fontsize=8)
        panel.tick_params(labelsize=7)
        panel.ticklabel_format(axis="x", style="sci", scilimits=(0, 3), useMathText=True)
        panel.xaxis.get_offset_text().set_fontsize(7)
        panel.grid(alpha=0.25)
    for panel in panels[len(scenarios) :]:
        panel.set_axis_off()
    shown = {text: line for panel in panels for line, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    names = [*style, "optimum"]
    figure.legend([shown[name] for name in names], names, loc="outside upper center", ncols=len(names), frameon=False)
    figure.supxlabel("environment steps", fontsize=9)
    figure.supylabel("P(task), exact", fontsize=9)
    return picture(figure, kind, "sweep")


def _cells(axes: Axes, states: Any, floor: dict[str, Any], colour: str) -> None:
    for s in states:
        corner = (floor["column"][s], floor["row"][s])
        axes.add_patch(matplotlib.patches.Rectangle(corner, 1, 1, facecolor=colour, edgecolor="#cccccc", linewidth=0.6))


def _path(axes: Axes, states: list[int], floor: dict[str, Any], scale: float) -> None:
    """Visits of one cell are spread a little, so that every step number can be read."""
    seen: dict[int, int] = {}
    points = []
    for s in states:
        visit = seen[s] = seen.get(s, -1) + 1
        angle, radius = 2.4 * visit, 0.0 if visit == 0 else 0.13 + 0.02 * visit
        x, y = floor["column"][s] + 0.5, floor["row"][s] + 0.45
        points.append((x + radius * np.cos(angle), y + radius * np.sin(angle)))
    xs, ys = np.array(points).T
    axes.plot(xs, ys, color=_RUN, linewidth=1.3, alpha=0.7)
    axes.scatter(xs, ys, s=150 * scale**2, color="white", edgecolors=_RUN, linewidths=0.8, zorder=3)
    for step, (px, py) in enumerate(points):
        axes.text(px, py, str(step), ha="center", va="center", fontsize=8.5 * scale, color=_RUN, zorder=4)


def picture(figure: Figure, kind: str, salt: str) -> str | bytes:
    """A figure as svg, png or pdf, the same bytes every time; `salt` tells its elements from another picture's."""
    if kind == "svg":
        return _svg(figure, salt)
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=150, metadata=metadata[kind])
    return buffer.getvalue()


def _svg(figure: Figure, salt: str) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": salt, "svg.fonttype": "none", "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
