"""The pictures with two axes: learning curves, Pareto fronts, the panels of a sweep, lines of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from stltool.numbers import ceiling_text, probability_text
from stltool.reporting.drawing import COLOURS, INK, alone, drawing, picture, shown, svg, text_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

_CURVE, _OPTIMUM = "#2166ac", "#b2182b"
_HIGH = 0.98  # a curve that gets this high shows its distance from 1, too
_MARKED = 300  # at most this many evaluations are marked one by one
_POINT, _SMALL = 1e-9, 0.3  # a front that spans more than the first and less than the second is enlarged
_POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@drawing()
def learning_curve(history: Sequence[Mapping[str, Any]], optimum: float | None = None) -> str:
    """Exact probability of the greedy policy over environment steps, with the optimum; if it comes near 1, also
    1 − P on a logarithmic axis. `history`: `steps` and `probability` of each evaluation."""
    steps, values = (_reals([point[key] for point in history]) for key in ("steps", "probability"))
    near = bool(values.max() >= _HIGH and (values < 1).any())
    figure = Figure(figsize=(9.6 if near else 7.2, 3.3), layout="constrained")
    panels = figure.subplots(1, 2 if near else 1, squeeze=False)[0]
    for axes, ys, name in zip(panels, (values, 1 - values), ("curve", "distance"), strict=False):
        drawn = np.where(ys > 0, ys, np.nan) if name == "distance" else ys
        marked = np.arange(len(steps)) if len(steps) <= _MARKED else np.flatnonzero(alone(drawn))
        axes.plot(steps, drawn, color=_CURVE, linewidth=1.6, label="greedy policy, exact", gid=name,
                  marker=".", markersize=6 if len(steps) <= 60 else 3, markevery=marked.tolist())  # fmt: skip
        _steps_axis(axes, steps)
    panels[0].set(ylabel="P(task)", ylim=(-0.03, 1.03))
    if optimum is not None:
        panels[0].axhline(float(optimum), color=_OPTIMUM, linestyle="--", linewidth=1.2, gid="optimum",
                          label=f"optimum {probability_text(optimum)}")  # fmt: skip
    panels[0].legend(loc="lower right", frameon=False)
    if near:
        _distance_axis(panels[1], steps, 1 - values, 1 - optimum if optimum is not None else None)
    return svg(figure, "curve", "the exact probability of the greedy policy while learning")


@drawing()
def gap_curve(history: Sequence[Mapping[str, Any]], without_data: float) -> str:
    """What was certified of the distance to the optimum over environment steps, on a logarithmic axis, and dashed what
    needs no data. `history`: `steps` and `gap` of each certificate; a triangle at the lower end for 0."""
    steps, gaps = (_reals([point[key] for point in history]) for key in ("steps", "gap"))
    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    axes = figure.subplots()
    drawn = np.where(gaps > 0, gaps, np.nan)
    marked = np.arange(len(steps)) if len(steps) <= _MARKED else np.flatnonzero(alone(drawn))
    axes.plot(steps, drawn, color=_CURVE, linewidth=1.6, label="gap, from the transitions so far", gid="gap",
              marker=".", markersize=6 if len(steps) <= 60 else 3, markevery=marked.tolist())  # fmt: skip
    _steps_axis(axes, steps)
    low = _powers_of_ten(axes, [*gaps, without_data], "P* − P, at most")
    if without_data > 0:
        axes.axhline(without_data, color=_OPTIMUM, linestyle="--", linewidth=1.2, gid="without-data",
                     label=f"without data: {ceiling_text(without_data)}")  # fmt: skip
    nothing = steps[gaps <= 0]
    if len(nothing):
        axes.plot(nothing, np.full(len(nothing), low), color=_CURVE, linestyle="", marker="v", markersize=5,
                  clip_on=False, label="0: it is optimal", gid="closed")  # fmt: skip
    axes.legend(loc="best", frameon=False)
    return svg(figure, "gap", "the certified distance to the optimum while learning")


def _distance_axis(axes: Axes, steps: Any, distances: Any, least: float | None) -> None:
    """A logarithmic axis of 1 − P; a triangle at its lower end for 0."""
    low = _powers_of_ten(axes, [*distances, least or 0.0], "1 − P(task)")
    if least:
        axes.axhline(least, color=_OPTIMUM, linestyle="--", linewidth=1.2, gid="least-distance")
    certain = steps[distances <= 0]
    if len(certain):
        axes.plot(certain, np.full(len(certain), low), color=_CURVE, linestyle="", marker="v", markersize=5,
                  clip_on=False, label="0: the task always holds", gid="certain")  # fmt: skip
        axes.legend(frameon=False)


def _steps_axis(axes: Axes, steps: NDArray[np.float64]) -> None:
    """From 0 to the last step, whatever is drawn there or left out."""
    axes.set(xlim=(0, 1.05 * max(steps.max(), 1.0)), xlabel="environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.grid(alpha=0.25)


def _powers_of_ten(axes: Axes, values: Sequence[float], label: str) -> float:
    """A logarithmic axis over integer powers of ten, around the positive values; its lower end."""
    positive = [value for value in values if value > 0] or [1.0]
    low = float(10 ** np.floor(np.log10(min(positive)) - 0.1))
    axes.set(yscale="log", ylim=(low, 1.3 * 10 ** np.ceil(np.log10(max(positive)))), ylabel=label)
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"10{str(round(np.log10(y))).translate(_POWERS)}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    return low


@drawing()
def pareto_front(data: Mapping[str, Any], kind: str) -> str | bytes:
    """The corners of a front (`front_data`) and the area below them; a small front is shown enlarged.

    `kind` is svg, png or pdf.
    """
    first, second = data["tasks"]
    points = _reals(
        [[corner["probabilities"][name]["value"] for name in (first, second)] for corner in data["corners"]]
    )
    points = points[np.lexsort((-points[:, 1], points[:, 0]))]
    (left, top), (right, bottom) = points[0], points[-1]
    figure = Figure(figsize=(5.4, 4.8), layout="constrained")
    axes = figure.subplots()
    below = np.array([(0.0, 0.0), (0.0, top), *points, (right, 0.0)])
    axes.fill(*below.T, color=_CURVE, alpha=0.12, linewidth=0, label="no better than the front", gid="below")
    axes.plot([0.0, left], [top, top], color=_CURVE, linewidth=1.0, linestyle=":", gid="edge")
    axes.plot([right, right], [bottom, 0.0], color=_CURVE, linewidth=1.0, linestyle=":", gid="edge")
    axes.plot(*points.T, color=_CURVE, linewidth=1.8, marker="o", markersize=4, label="Pareto front, exact",
              gid="front", zorder=3)  # fmt: skip
    width, height = np.ptp(points, axis=0)
    if _POINT < max(width, height) < _SMALL:
        room = 0.15 * max(width, height)
        axes.set(xlim=(left - room, right + room), ylim=(bottom - room, top + room))
    else:
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axes.set(xlabel=f"P({shown(first, 40)})", ylabel=f"P({shown(second, 40)})", aspect="equal")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.locator_params(nbins=5)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", frameon=False)
    return picture(figure, kind, "front", "the best pairs of probabilities for two tasks")


@drawing()
def survival(curves: Sequence[Mapping[str, Any]], kind: str, mark: float | None = None) -> str | bytes:
    """P(robustness ≥ r) over r: a falling step for each of the curves, from 1 to 0; dashed the margin `mark`.

    `curves`: `name`, `values` (ascending, finite), `p` at each, and `beyond`, the probability of being infinite. `kind`
    is svg, png or pdf.
    """
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.subplots()
    marked = [mark] if mark is not None and np.isfinite(mark) else []
    ends = [*(value for curve in curves for value in curve["values"]), *marked] or [0.0]
    room = 0.06 * (max(ends) - min(ends)) or 0.5
    left, right = min(ends) - room, max(ends) + room
    for i, curve in enumerate(curves):
        values, p = _reals(curve["values"]), _reals(curve["p"])
        first = p[0] if len(p) else curve["beyond"]
        axes.step([left, *values, right], [first, *p, curve["beyond"]], where="pre", color=_colour(i),
                  linestyle=_dashes(i), linewidth=3.0 - 1.4 * i, label=shown(curve["name"], 50),
                  gid=f"survival-{i}")  # fmt: skip
        axes.plot(values, p, color=_colour(i), linestyle="", marker="o", markersize=4, gid=f"values-{i}")
    axes.axvline(0.0, color=INK, linewidth=0.8, linestyle=":", gid="zero")
    for r in marked:
        axes.axvline(r, color=INK, linewidth=1.0, linestyle="--", gid="margin")
    axes.set(xlabel="margin r", ylabel="P(robustness ≥ r)", xlim=(left, right), ylim=(-0.03, 1.03))
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", frameon=False)
    return picture(figure, kind, "survival", "how probable each margin of robustness is")


_PER_PIECE = 33  # points of a polynomial


@drawing()
def parameter_curve(data: Mapping[str, Any], kind: str) -> str | bytes:
    """P over a parameter (`parametric_data`): the enclosure, and below it the pieces on which one policy is optimal.

    Dashed the bounds that were asked for, dotted the smallest value that reaches one. `kind` is svg, png or pdf.
    """
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.subplots()
    xs, ends = np.linspace(0, 1, _PER_PIECE), ([], [])  # type: tuple[Any, tuple[list[Any], list[Any]]]
    at: list[Any] = []
    for piece in data["pieces"]:
        at.append(piece["from"] + (piece["to"] - piece["from"]) * xs)
        for side, coefficients in zip(ends, (piece["lower"], piece["upper"]), strict=True):
            side.append(_polynomial(_reals(coefficients), xs))
    p, lower, upper = np.concatenate(at), *(np.concatenate(side) for side in ends)
    axes.fill_between(p, lower, upper, color=_CURVE, alpha=0.3, linewidth=0, gid="enclosure")
    axes.plot(p, lower, color=_CURVE, linewidth=1.6, label=f"P, {shown(data['question'], 20)}", gid="lower")
    low, high = float(lower.min()), float(upper.max())
    bounds = [data[key] for key in ("at_least", "at_most") if key in data]
    low, high = min([low, *bounds]), max([high, *bounds])
    room = 0.08 * (high - low) or 0.05
    floor = low - room
    for bound in bounds:
        axes.axhline(bound, color=_OPTIMUM, linestyle="--", linewidth=1.2, label=f"bound {bound:g}", gid="bound")
    smallest = data.get("smallest")
    if smallest is not None and smallest["enough"] is not None:
        axes.axvline(smallest["enough"], color=_OPTIMUM, linestyle=":", linewidth=1.2, gid="smallest",
                     label=f"smallest {shown(data['parameter'], 20)} ≈ {smallest['enough']:.6g}")  # fmt: skip
    optimal = [piece for piece in data["pieces"] if piece["optimal"]]
    for i, piece in enumerate(optimal):
        axes.plot([piece["from"], piece["to"]], [floor, floor], color=COLOURS[2], linewidth=5, solid_capstyle="butt",
                  clip_on=False, marker="|", markeredgecolor=INK, label=None if i else "one policy is optimal",
                  gid=f"optimal-{i}")  # fmt: skip
    axes.set(xlabel=shown(data["parameter"], 40), ylabel="P(task)", ylim=(floor, high + room))
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", frameon=False)
    return picture(figure, kind, "parameter", "the probability as a function of a parameter")


@drawing()
def frontier_picture(data: Mapping[str, Any], kind: str) -> str | bytes:
    """A frontier (`frontier_data`): with two params which values reach the bound, with one P over its values.

    `kind` is svg, png or pdf.
    """
    figure = Figure(figsize=(5.8, 4.2), layout="constrained")
    axes = figure.subplots()
    params = data["params"]
    places = [_Axis(param["values"]) for param in params]
    title = "for which values of the params the bound is reached"
    if len(params) == 1:
        found = [(places[0].at(probe["values"][0]), probe["P"]) for probe in data["probes"]]
        axes.plot(*zip(*found, strict=True), color=_CURVE, linewidth=1.0, marker="o", markersize=4, gid="probes",
                  label=f"P, {shown(data['question'], 20)}, where checked")  # fmt: skip
        axes.axhline(data["bound"], color=_OPTIMUM, linestyle="--", linewidth=1.2, gid="bound",
                     label=f"bound {data['bound']:g}")  # fmt: skip
        for step in data["steps"]:
            if step["tightest"] is not None:
                axes.axvline(places[0].at(step["tightest"]), color=_OPTIMUM, linestyle=":", linewidth=1.2,
                             gid="tightest", label=f"tightest: {shown(step['tightest'], 20)}")  # fmt: skip
        axes.set(xlabel=shown(params[0]["name"], 40), ylabel="P(task)")
        places[0].show(axes.xaxis)
    else:
        for name, marker, held in (("holds", "o", True), ("fails", "x", False), ("undecided", "s", None)):
            seen = [probe["values"] for probe in data["probes"] if probe["holds"] is held]
            if seen:
                axes.plot(*([place.at(v) for v in column] for place, column in zip(places, zip(*seen, strict=True),
                                                                                  strict=True)),
                          color={"holds": _CURVE, "fails": _OPTIMUM}.get(name, INK), linestyle="", marker=marker,
                          markersize=5, gid=name, label=f"checked: {name}")  # fmt: skip
        steps = [(places[0].at(step["others"][0]), places[1].at(step["tightest"])) for step in data["steps"]
                 if step["tightest"] is not None]  # fmt: skip
        if steps:
            edge = max(places[1].ends) if params[1]["direction"] > 0 else min(places[1].ends)
            xs, ys = _reals(steps).T
            axes.fill_between(xs, ys, edge, step="mid", color=_CURVE, alpha=0.12, linewidth=0, gid="reached",
                              label="reaches the bound")  # fmt: skip
            axes.plot(xs, ys, color=_CURVE, drawstyle="steps-mid", linewidth=1.6, gid="staircase",
                      label=f"tightest {shown(params[1]['name'], 20)}")  # fmt: skip
        axes.set(xlabel=shown(params[0]["name"], 40), ylabel=shown(params[1]["name"], 40))
        for place, axis in zip(places, (axes.xaxis, axes.yaxis), strict=True):
            place.show(axis)
    axes.grid(alpha=0.25)
    axes.legend(loc="best", frameon=False, fontsize=8)
    return picture(figure, kind, "frontier", title)


def _polynomial(c: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Its values at x, from 0 to 1, by de Casteljau's algorithm from its coefficients in Bernstein's basis."""
    values = np.repeat(c[:, None], len(x), axis=1)
    while len(values) > 1:
        values = (1 - x) * values[:-1] + x * values[1:]
    found: NDArray[np.float64] = values[0]
    return found


class _Axis:
    """Where values of a param are: numbers at themselves, others side by side with their names."""

    _FEW = 12  # names that are shown

    def __init__(self, values: Sequence[str]) -> None:
        try:
            self._places = {value: float(Fraction(value)) for value in values}
            self._names: list[str] | None = None
        except ValueError:
            self._places = {value: float(i) for i, value in enumerate(values)}
            self._names = list(values)

    def at(self, value: str) -> float:
        return self._places[value]

    @property
    def ends(self) -> tuple[float, float]:
        return min(self._places.values()), max(self._places.values())

    def show(self, axis: Axis) -> None:
        if self._names is not None:
            every = -(-len(self._names) // self._FEW)
            axis.set_ticks(range(0, len(self._names), every), [shown(name, 12) for name in self._names[::every]])
        elif all(place.is_integer() for place in self._places.values()):
            axis.set_major_locator(MaxNLocator(integer=True))


@drawing()
def learning_curves(data: Mapping[str, Any], kind: str) -> str | bytes:
    """A sweep's exact learning curves, a panel per scenario: median and quartiles over the seeds, the optimum dashed.

    Where curves coincide, each remains visible under the narrower ones on it. `kind` is svg, png or pdf.
    """
    from stltool.reporting.sweeps import panel_title

    scenarios, columns = data["scenarios"], min(data["columns"], len(data["scenarios"]))
    rows = -(-len(scenarios) // columns)
    methods = [method["id"] for method in data["methods"]]
    wide = max(4.2, 3.2 * columns)
    names = [*(shown(name, 30) for name in methods), "optimum"]
    beside = max(1, min(len(names), int(72 * wide / (max(text_width(name, 10) for name in names) + 45))))
    figure = Figure(figsize=(wide, 2.3 * rows + 0.4 + 0.2 * -(-len(names) // beside)), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    drawn: dict[int, Any] = {}
    for panel, scenario in zip(panels, scenarios, strict=False):
        for result in data["results"]:
            if result["scenario"] != scenario["id"]:
                continue
            i = methods.index(result["method"])
            steps, q1, median, q3 = (_reals(result["curve"][key]) for key in ("steps", "q1", "median", "q3"))
            panel.fill_between(steps, q1, q3, color=_colour(i), alpha=0.18, linewidth=0, gid=f"quartiles-{i}")
            [drawn[i]] = panel.plot(
                steps, median, color=_colour(i), linestyle=_dashes(i), gid=f"median-{i}",
                linewidth=3.0 - 1.8 * i / max(1, len(methods) - 1),
            )  # fmt: skip
        optimum = panel.axhline(
            float(scenario["optimum"]), color=INK, linestyle="--", linewidth=0.9, zorder=3, gid="optimum"
        )
        panel.set(ylim=(-0.03, 1.03))
        panel.set_xlim(left=0)
        panel.set_title(shown(panel_title(scenario), 56), fontsize=8)
        panel.tick_params(labelsize=7)
        panel.xaxis.set_major_formatter(EngFormatter(sep=""))
        panel.grid(alpha=0.25)
    for panel in panels[len(scenarios) :]:
        panel.set_axis_off()
    seen = [*sorted(drawn), -1]
    figure.legend([{**drawn, -1: optimum}[i] for i in seen], [names[i] for i in seen],
                  loc="outside upper center", frameon=False, ncols=beside)  # fmt: skip
    figure.supxlabel("environment steps", fontsize=9)
    figure.supylabel("P(task), exact", fontsize=9)
    return picture(figure, kind, "sweep", "the exact probabilities of the methods' policies while learning")


@drawing()
def leaves_curve(data: Mapping[str, Any], kind: str) -> str | bytes:
    """What a tree loses to its policy over the number of its leaves (`tree_data`), on a logarithmic axis, and dashed
    the price. `kind` is svg, png or pdf."""
    points = [(point["leaves"], max(data["given"] - point["probability"], 0.0)) for point in data["curve"]]
    leaves, lost = (_reals(column) for column in zip(*points, strict=True))
    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    axes = figure.subplots()
    drawn = np.where(lost > 0, lost, np.nan)
    axes.plot(leaves, drawn, color=_CURVE, linewidth=1.6, marker=".", gid="curve",
              label="the best tree found of each size, exact")  # fmt: skip
    low = _powers_of_ten(axes, [*lost, data["price"]], "P(policy) − P(tree)")
    axes.axhline(data["price"], color=_OPTIMUM, linestyle="--", linewidth=1.2, gid="price",
                 label=f"price {data['price']:g}")  # fmt: skip
    equal = leaves[lost <= 0]
    if len(equal):
        axes.plot(equal, np.full(len(equal), low), color=_CURVE, linestyle="", marker="v", markersize=5, clip_on=False,
                  label="0: as good as the policy", gid="equal")  # fmt: skip
    axes.set(xlabel="leaves", xlim=(0, 1.05 * max(leaves.max(), 2.0)))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return picture(figure, kind, "leaves", "what a tree loses to its policy, over the number of its leaves")


@drawing()
def line_chart(chart: Mapping[str, Any], salt: str) -> str:
    """Lines over one axis as SVG. `chart`: `lines`, each with `name`, `x` and `y`; and the axes' names `x` and `y`."""
    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    axes = figure.subplots()
    for i, line in enumerate(chart["lines"]):
        xs, ys = _reals(line["x"]), _reals(line["y"])
        axes.plot(xs, ys, color=_colour(i), linestyle=_dashes(i), marker="." if len(xs) <= 60 else "", gid=f"line-{i}",
                  label=shown(line["name"], 40))  # fmt: skip
    axes.set(xlabel=shown(chart["x"]), ylabel=shown(chart["y"]))
    axes.grid(alpha=0.25)
    if chart["lines"]:
        axes.legend(frameon=False)
    return svg(figure, salt, "lines")


def _reals(values: object) -> NDArray[np.float64]:
    """Numbers; ValueError for strings, which matplotlib would turn into a categorical axis."""
    return np.array(values, dtype=np.float64)


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]


def _dashes(i: int) -> str:
    return ("-", "--", "-.", ":")[i // len(COLOURS) % 4]
