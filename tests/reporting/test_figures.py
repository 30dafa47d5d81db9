"""Curves, fronts and panels, read back from their SVG and compared with the numbers that they were drawn from."""

import matplotlib
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.numbers import ceiling_text, probability_text
from stltool.reporting import monitor_data
from stltool.reporting.drawing import COLOURS
from stltool.reporting.figures import gap_curve, learning_curve, learning_curves, line_chart, pareto_front
from stltool.reporting.monitor_figure import HOLDS, VIOLATED, monitored
from tests.conftest import many, some
from tests.reporting.svg import Picture, drawn, overlapping

PROBABILITIES = st.floats(0, 1) | st.sampled_from([0.0, 0.5, 1 - 1e-3, 1 - 1e-9, 1.0])


def same(found, expected, panel):
    """Points of a picture, to a thousandth of its panel."""
    expected = np.asarray(expected, dtype=float).reshape(-1, 2)
    assert found.shape == expected.shape
    room = np.array([np.ptp(panel.xlim), np.ptp(panel.ylim)])
    np.testing.assert_allclose(found / room, expected / room, atol=1e-3)


def points(steps, values):
    return np.stack([np.asarray(steps, dtype=float), np.asarray(values, dtype=float)], axis=1)


def history(values, every=360):
    return [{"episode": 20 * i, "steps": every * i, "probability": p} for i, p in enumerate(values, start=1)]


# ---------------------------------------------------------------------------------------------------- learning curves


@given(st.lists(PROBABILITIES, min_size=2, max_size=70), st.none() | PROBABILITIES)
@settings(max_examples=many(12))
@example([0.2, 1 - 1e-9, *[1.0] * 9], 1.0)
@example([1.0, 1.0], None)
def test_a_learning_curve_and_its_optimum(values, optimum):
    told = history(values)
    steps = [point["steps"] for point in told]
    picture = Picture(learning_curve(told, optimum))
    panel, *logarithmic = picture.panels
    [curve] = panel.shapes("curve")
    same(curve, points(steps, values), panel)
    assert panel.ylim == pytest.approx((-0.03, 1.03), abs=1e-3)
    assert panel.levels("optimum") == ([] if optimum is None else pytest.approx([optimum], abs=1e-3))
    legend = [text.text for text in picture.texts("legend")]
    assert ("optimum" in " ".join(legend)) == (optimum is not None)
    if optimum is not None:
        assert f"optimum {probability_text(optimum)}" in legend
    assert len(logarithmic) == (max(values) >= 0.98 and min(values) < 1)
    if logarithmic:
        [panel] = logarithmic
        distances = 1 - np.array(values)
        marked = panel.markers("distance")
        kept = points(steps, distances)[distances > 0]
        assert marked[:, 0] == pytest.approx(kept[:, 0], rel=1e-2)
        assert marked[:, 1] == pytest.approx(kept[:, 1], rel=1e-2)
        assert panel.ylim[0] < kept[:, 1].min()
        assert kept[:, 1].max() < panel.ylim[1]
        certain = panel.markers("certain")
        assert certain[:, 0] == pytest.approx(points(steps, values)[distances <= 0, 0], rel=1e-2)
        assert certain[:, 1] == pytest.approx(panel.ylim[0], rel=1e-2)
        assert (certain[:, 0] < panel.xlim[1]).all()
        least = panel.levels("least-distance")
        assert least == ([] if optimum in (None, 1.0) else pytest.approx([1 - optimum], rel=1e-2))


def test_a_long_curve_marks_what_stands_alone():
    values = [0.5] * 400 + [1.0, 1 - 1e-4, 1.0]
    panel, distance = Picture(learning_curve(history(values), None)).panels
    same(panel.shapes("curve")[0], points([360 * i for i in range(1, 404)], values), panel)
    assert len(panel.markers("curve")) == 0
    assert distance.markers("distance")[:, 1] == pytest.approx([1e-4], rel=1e-2)
    assert len(distance.markers("certain")) == 2


def test_a_learning_curve_of_a_training(patrolling):
    from stltool.reporting import render, report_data

    best, run = stl.check(patrolling), stl.learn(patrolling, "cfer", episodes=60, seed=1)
    page = render(report_data([best, stl.check(patrolling, run.policy)], run))
    (panel,) = [panel for text in drawn(page) for panel in Picture(text).panels if "curve" in panel.names()]
    [curve] = panel.shapes("curve")
    same(curve, [(p.steps, p.probability) for p in run.history], panel)
    assert panel.levels("optimum") == pytest.approx([best.probability], abs=1e-3)


# ---------------------------------------------------------------------------------------------------------------- gaps


@given(st.lists(st.sampled_from([0.0, 1e-16, 1e-6, 1.0]) | st.floats(0, 1), min_size=2, max_size=70), PROBABILITIES)
@settings(max_examples=many(6))
@example([0.5, 1e-3, 0.0], 0.14)
@example([0.0, 0.0], 0.0)
def test_a_gap_over_steps_and_without_data(values, without_data):
    values = [value if value > 1e-20 else 0.0 for value in values]
    found = [{**point, "gap": gap} for point, gap in zip(history(values), values, strict=True)]
    steps = [point["steps"] for point in found]
    picture = Picture(gap_curve(found, without_data))
    panel, kept = picture.panel, np.array(values) > 0
    marked, drawn = panel.markers("gap"), points(steps, values)
    assert marked[:, 0] == pytest.approx(drawn[kept, 0], rel=1e-2)
    assert marked[:, 1] == pytest.approx(drawn[kept, 1], rel=2e-2)
    closed = panel.markers("closed")
    assert closed[:, 0] == pytest.approx(drawn[~kept, 0], rel=1e-2)
    assert closed[:, 1] == pytest.approx(panel.ylim[0], rel=2e-2)
    assert panel.xlim == pytest.approx((0, 1.05 * max(steps)), rel=1e-2)
    assert panel.levels("without-data") == ([] if not without_data else pytest.approx([without_data], rel=2e-2))
    legend = [text.text for text in picture.texts("legend")]
    assert (f"without data: {ceiling_text(without_data)}" in legend) == (without_data > 0)


# -------------------------------------------------------------------------------------------------------------- fronts


def front(corners, names=("charging", "patrolling")):
    return {
        "tasks": dict.fromkeys(names, "…"),
        "corners": [{"probabilities": dict(zip(names, ({"value": v} for v in corner), strict=True))}
                    for corner in corners],
    }  # fmt: skip


@st.composite
def fronts(draw):
    """Corners as a front has them: the first probability falls, the second rises."""
    unit = draw(st.sampled_from([500, 10_000, 10**7]))
    xs = draw(st.lists(st.integers(0, 500), min_size=1, max_size=8, unique=True))
    ys = draw(st.lists(st.integers(0, 500), min_size=len(xs), max_size=len(xs), unique=True))
    return [(1 - x / unit, y / unit) for x, y in zip(sorted(xs), sorted(ys), strict=True)]


@given(fronts())
@settings(max_examples=many(12))
@example([(1.0, 0.0), (0.0, 1.0)])
@example([(0.999, 0.9901), (0.9989, 0.9921)])
@example([(1.0, 1.0)])
def test_a_front_and_what_is_below_it(corners):
    picture = Picture(pareto_front(front(corners), "svg"))
    panel = picture.panel
    marks = panel.markers("front")
    same(marks, corners[::-1], panel)
    if len(corners) > 1:
        same(panel.shapes("front")[0], corners[::-1], panel)
    [below] = panel.shapes("below")
    for corner in corners:
        assert np.abs(below - corner).max(axis=1).min() < 1e-3
    assert below.min(axis=0) == pytest.approx([0, 0], abs=1e-3)
    assert below.max(axis=0) == pytest.approx(np.max(corners, axis=0), abs=1e-3)
    for (x, y), low, high in ((corner, *zip(panel.xlim, panel.ylim, strict=True)) for corner in corners):
        assert low[0] < x < high[0]  # no marker on the edge
        assert low[1] < y < high[1]
    labels = [text.text for text in picture.texts()]
    assert {"P(charging)", "P(patrolling)", "Pareto front, exact"} <= set(labels)


def test_a_small_front_is_enlarged():
    corners = [(0.9996, 0.9901), (0.9991, 0.9903), (0.998, 0.9904)]
    panel = Picture(pareto_front(front(corners), "svg")).panel
    assert np.ptp(panel.xlim) < 0.003
    for corners in ([(0.9, 0.1), (0.2, 0.8)], [(1.0, 0.5), (1 - 1e-12, 0.5 + 1e-12)]):
        whole = Picture(pareto_front(front(corners), "svg")).panel
        assert (*whole.xlim, *whole.ylim) == pytest.approx((-0.03, 1.03) * 2, abs=1e-3)


def test_the_front_of_two_tasks():
    from stltool.reporting import front_data
    from tests.conftest import FACTORY

    tasks = [stl.load_task(FACTORY / "tradeoff.stl", {"T": 5, "tau": 6}, name) for name in ("charging", "patrolling")]
    found = stl.pareto(stl.build_joint_product(stl.load_model(tasks[0].model), tasks))
    panel = Picture(pareto_front(front_data(found), "svg")).panel
    same(panel.markers("front"), sorted(corner.point for corner in found.corners), panel)


# -------------------------------------------------------------------------------------------------------------- sweeps


def swept(scenarios, methods, seed=0, columns=2):
    """A sweep's data as a report has it, made up."""
    rng = np.random.default_rng(seed)
    results = []
    for i, scenario in enumerate(scenarios):
        for method in methods[: len(methods) - i % 2]:
            steps = np.cumsum(rng.integers(100, 9000, size=rng.integers(2, 12))).tolist()
            q1, median, q3 = np.sort(rng.random((3, len(steps))), axis=0).tolist()
            curve = {"steps": steps, "q1": q1, "median": median, "q3": q3}
            results.append({"scenario": scenario, "method": method, "curve": curve})
    described = [
        {"id": name, "task": "t", "model": "m", "params": {"T": "3"}, "optimum": float(rng.random())}
        for name in scenarios
    ]
    return {"columns": columns, "methods": [{"id": m} for m in methods], "scenarios": described, "results": results}


@pytest.mark.parametrize(
    ("scenarios", "methods", "columns"),
    [(["R1"], ["naive"], 1), (["R1", "C1", "P1", "P2"], ["naive", "cfer", "cfper"], 2),
     (["a", "b"], list("abcdefghi"), 4), (["x"], ["optimum", "_m", "$a$", "n" * 99], 1)],
)  # fmt: skip
def test_each_panel_has_the_medians_and_quartiles_of_its_scenario(scenarios, methods, columns):
    data = swept(scenarios, methods, columns=columns)
    picture = Picture(learning_curves(data, "svg"))
    assert len(picture.panels) == len(scenarios)
    for panel, scenario in zip(picture.panels, data["scenarios"], strict=True):
        assert panel.levels("optimum") == pytest.approx([scenario["optimum"]], abs=1e-3)
        for i, method in enumerate(methods):
            found = [r["curve"] for r in data["results"] if (r["scenario"], r["method"]) == (scenario["id"], method)]
            medians, bands = panel.shapes(f"median-{i}"), panel.shapes(f"quartiles-{i}")
            assert len(medians) == len(bands) == len(found)
            for curve, median, band in zip(found, medians, bands, strict=True):
                same(median, points(curve["steps"], curve["median"]), panel)
                assert panel.colours(f"median-{i}", "stroke") == {COLOURS[i % len(COLOURS)]}
                for step, q1, q3 in zip(curve["steps"], curve["q1"], curve["q3"], strict=True):
                    at = band[np.isclose(band[:, 0], step, atol=1e-3 * np.ptp(panel.xlim)), 1]
                    assert (at.min(), at.max()) == pytest.approx((q1, q3), abs=1e-3)
    texts = picture.texts()
    titles = [text.text for text in texts if ": t, m, T = 3" in text.text]
    assert titles == [f"{name}: t, m, T = 3" for name in scenarios]
    legend = [text.text.strip() for text in picture.texts("legend")]
    assert sorted(legend) == sorted(m if len(m) <= 30 else m[:29] + "…" for m in [*methods, "optimum"])
    assert not [(texts[i].text, texts[j].text) for i, j in overlapping([text.box for text in texts])]
    page = tuple(float(number) for number in picture.root.get("viewBox").split())
    for text in texts:
        assert page[0] - 1 <= text.box[0] < text.box[2] <= page[2] + 1, text.text


def test_lines_are_drawn_where_they_are():
    chart = {"x": "share", "y": "P & <b>", "lines": [
        {"name": "first", "x": [0, 0.5, 1], "y": [0.1, 0.9, 0.4]}, {"name": "$_second$", "x": [0, 1], "y": [-2, 3]},
    ]}  # fmt: skip
    picture = Picture(line_chart(chart, "here"))
    for i, line in enumerate(chart["lines"]):
        [found] = [shape for shape in picture.panel.shapes(f"line-{i}") if len(shape) == len(line["x"])][:1]
        same(found, points(line["x"], line["y"]), picture.panel)
    assert {"share", "P & <b>", "first", "$_second$"} <= {text.text for text in picture.texts()}


# ------------------------------------------------------------------------------------------------------------ monitors


def test_a_monitored_trace():
    rng = np.random.default_rng(5)
    n = 90
    signals = {"x": rng.normal(size=n).cumsum(), "y": rng.random(n), "door": rng.random(n) < 0.4}
    task = stl.Task("formula", stl.parse("(F[0,4] x > 0.5) & (abs(y - 0.5) < 0.4 | F[0,3] door)"))
    result = stl.monitor(task, signals)
    picture = Picture(monitored(result, signals, task, "svg"))
    x, y, labels, parts, robustness, verdict = picture.panels
    steps = np.arange(n)
    for panel, name in ((x, "x"), (y, "y")):
        same(panel.shapes("signal")[0], points(steps, signals[name]), panel)
    for panel in picture.panels:
        assert panel.xlim == pytest.approx((-0.5, n - 0.5), abs=1e-2)
    assert x.levels("threshold") == pytest.approx([0.5], abs=2e-2)
    assert sorted(y.levels("threshold")) == pytest.approx([0.1, 0.9], abs=2e-3)
    same(robustness.shapes("robustness")[0], points(steps[: len(result.robustness)], result.robustness), robustness)
    inside = abs(signals["y"] - 0.5) < 0.4
    for panel, truth in ((x, signals["x"] > 0.5), (y, inside), (labels, signals["door"])):
        assert steps_of(panel, "every") == steps_of(panel, "some") == np.flatnonzero(truth).tolist()
    ahead = np.lib.stride_tricks.sliding_window_view
    some_x, some_door = ahead(signals["x"] > 0.5, 5).any(axis=1), ahead(signals["door"], 4).any(axis=1)
    for i, truth in enumerate((some_x, inside[: len(some_door)] | some_door, some_door)):
        assert steps_of(parts, f"true-{i}") == np.flatnonzero(truth).tolist()
        assert steps_of(parts, f"false-{i}") == np.flatnonzero(~truth).tolist()
        assert steps_of(parts, f"open-{i}") == list(range(len(truth), n))
    for name, truth in (("holds", result.verdicts), ("violated", ~result.verdicts)):
        assert steps_of(verdict, name) == np.flatnonzero(truth).tolist()
    assert steps_of(verdict, "unjudged") == list(range(len(result.verdicts), n))
    assert verdict.colours("holds") == {HOLDS}
    assert verdict.colours("violated") == {VIOLATED}
    first = monitor_data(result, task, "t.csv")["first_violation"]
    for panel in picture.panels:
        assert panel.shapes("mark")[0][:, 0] == pytest.approx(first, abs=1e-2)
    assert verdict.markers("first")[0, 0] == pytest.approx(first, abs=1e-2)
    texts = picture.texts()
    assert not [(texts[i].text, texts[j].text) for i, j in overlapping([text.box for text in texts])]


def test_long_names_of_signals_stay_beside_their_panels():
    names = ["temperature_of_the_coolant", "x" * 60, "y"]
    signals = {name: np.arange(4.0) for name in names}
    task = stl.Task("formula", stl.parse(" & ".join(f"{name} > 1" for name in names)))
    picture = Picture(monitored(stl.monitor(task, signals), signals, task, "svg"))
    texts = picture.texts()
    assert not [(texts[i].text, texts[j].text) for i, j in overlapping([text.box for text in texts])]
    written = [text.text for text in texts]
    assert names[2] in written
    assert any(names[0].startswith(text.removesuffix("…")) for text in written if len(text) > 15)


def steps_of(panel, name):
    """The steps that the bars of a name cover."""
    found = []
    for left, _, right, _ in panel.boxes(name):
        assert left % 1 == pytest.approx(0.5, abs=0.01)
        found += range(round(left + 0.5), round(right - 0.5) + 1)
    return found


# -------------------------------------------------------------------------------------------------- whoever draws them


def test_the_users_own_style_changes_nothing():
    told = history([0.5, 0.7, 0.99])
    plain = learning_curve(told, 1.0), pareto_front(front([(0.9, 0.1), (0.2, 0.8)]), "svg")
    with matplotlib.rc_context(
        {"axes.facecolor": "black", "font.size": 30, "text.usetex": True, "svg.fonttype": "path"}
    ):
        assert (learning_curve(told, 1.0), pareto_front(front([(0.9, 0.1), (0.2, 0.8)]), "svg")) == plain
        assert matplotlib.rcParams["font.size"] == 30


@pytest.mark.soak
@pytest.mark.parametrize(
    "name", some(["$x$", "$\\frac$", "</svg><script>", "a\nb", "\x01\x00", "\ud800", "x" * 3000, "充"])
)
def test_any_name_can_be_drawn(name):
    for text in (
        pareto_front(front([(0.9, 0.1), (0.2, 0.8)], (name, name + "'")), "svg"),
        learning_curves(swept([name], [name]), "svg"),
        line_chart({"x": name, "y": name, "lines": [{"name": name, "x": [1, 2], "y": [1, 2]}]}, "s"),
    ):
        shown = [found.text for found in Picture(text).texts()]
        if name in ("$x$", "$\\frac$", "</svg><script>"):
            assert any(name in found for found in shown)
