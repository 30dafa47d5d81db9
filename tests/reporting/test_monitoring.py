"""Monitored traces as data and as pictures, against slow and obvious twins."""

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.colors import to_hex

import stltool as stl
from stltool.errors import SettingsError
from stltool.logic.formula import Always, Interval
from stltool.logic.semantics import satisfies
from stltool.reporting import monitor_data, monitor_report, render, write_monitor_picture
from stltool.reporting import monitor_figure as pictures
from stltool.reporting.diagnosis import diagnosis_data
from stltool.reporting.monitor_figure import HOLDS, VIOLATED, coarse, envelope, monitor_figure, monitored, threshold
from stltool.reporting.monitoring import monitor_facts, range_rows, shown_trace, step_lines, trace_rows, true_ranges
from stltool.testing import formulas, traces
from tests.reporting.svg import Picture, drawn

VERDICTS = st.lists(st.booleans(), min_size=1, max_size=12)


def judged(text, **signals):
    """(result, signals, task) of a formula on lists of samples."""
    signals = {name: np.array(values) for name, values in signals.items()}
    task = stl.Task("formula", stl.parse(text))
    return stl.monitor(task, signals), signals, task


# -------------------------------------------------------------------------------------------------------------- data


@given(formulas(), st.data())
def test_the_data_is_what_the_oracle_says_step_by_step(phi, data):
    n = stl.horizon(phi) + data.draw(st.integers(1, 4))
    signals = data.draw(traces(n))
    result = stl.monitor(phi, signals)
    at = data.draw(st.none() | st.integers(0, n - stl.horizon(phi) - 1))
    found = json.loads(json.dumps(monitor_data(result, stl.Task("formula", phi), "t.csv", at)))
    steps = range(n - stl.horizon(phi)) if at is None else [at]
    verdicts = [stl.satisfies(phi, signals, t) for t in steps]
    margins = [stl.robustness(phi, signals, t) for t in steps]
    assert found["verdicts"] == verdicts
    assert [float(value) for value in found["robustness"]] == pytest.approx(margins)
    assert all(isinstance(v, str) == math.isinf(m) for v, m in zip(found["robustness"], margins, strict=True))
    violated = [t for t, verdict in zip(steps, verdicts, strict=True) if not verdict]
    assert found["verdict"] == verdicts[0]
    assert found["holds"] == all(verdicts)
    assert (found["violations"], found["first_violation"]) == (len(violated), violated[0] if violated else None)
    least = min(float(value) for value in found["robustness"])
    assert float(found["least_robustness"]) == least
    assert found["least_robustness_at"] == steps[[float(v) for v in found["robustness"]].index(least)]
    assert (found["samples"], found["judged"], found["at"], found["traces"]) == (n, len(steps), at, None)
    assert (found["horizon"], found["formula"], found["task"]) == (stl.horizon(phi), str(phi), None)


@given(st.lists(st.lists(st.sampled_from([-2.0, -1.0, 0.0, 1.0]), min_size=4, max_size=4), min_size=1, max_size=4),
       st.none() | st.integers(0, 2))  # fmt: skip
@example([[1.0] * 4] * 2, None)
def test_a_batch_is_its_traces(rows, at):
    result, _, task = judged("F[0,1] (x > 0 & y)", x=rows, y=np.ones((len(rows), 4), bool))
    batch = monitor_data(result, task, "t.npz", at)
    singles = [
        monitor_data(judged("F[0,1] (x > 0 & y)", x=row, y=[True] * 4)[0], task, "t.npz", at) for row in rows
    ]  # fmt: skip
    for key in ("verdicts", "robustness"):
        assert batch[key] == [single[key] for single in singles]
    assert batch["each"] == [{key: single[key] for key in batch["each"][0]} for single in singles]
    assert (batch["traces"], batch["judged"]) == (len(rows), 3 if at is None else 1)
    assert batch["holds"] == all(single["holds"] for single in singles)
    assert batch["verdict"] == all(single["verdict"] for single in singles)
    assert batch["violations"] == sum(single["violations"] for single in singles)
    assert batch["violating_traces"] == sum(not single["holds"] for single in singles)
    firsts = [single["first_violation"] for single in singles if not single["holds"]]
    assert batch["first_violation"] == min(firsts, default=None)
    least = min(singles, key=lambda single: single["least_robustness"])
    for key in ("least_robustness", "least_robustness_at"):
        assert batch[key] == least[key]
    violating = [number for number, single in enumerate(singles) if not single["holds"]]
    assert shown_trace(batch, None) == (violating[0] if violating else 0)
    assert shown_trace(batch, len(rows) - 1) == len(rows) - 1
    for wrong in (-1, len(rows)):
        with pytest.raises(SettingsError, match=rf"--trace {wrong}: t.npz contains traces 0 … {len(rows) - 1}"):
            shown_trace(batch, wrong)


@pytest.mark.parametrize("semantics", ["boolean", "robustness"])
def test_both_semantics_are_shown(semantics):
    _, signals, task = judged("x > 0", x=[1])
    result = stl.monitor(task, signals, semantics=semantics)
    for show in (lambda: monitor_data(result, task, ""), lambda: monitor_figure(result, signals, task)):
        with pytest.raises(SettingsError, match='monitor with semantics="both"'):
            show()


def test_a_formula_without_horizon():
    signals = {"x": np.array([1.0, -1.0, 2.0])}
    phi = Always(Interval(0, None), stl.parse("x > 0"))
    data = monitor_data(stl.monitor(phi, signals, end="cut"), stl.Task("formula", phi), "t.csv")
    assert (data["horizon"], data["verdicts"]) == (None, [False, False, True])
    assert monitor_facts(data)["horizon"] == "none: an interval has no end; windows are cut at the end of the trace"


@given(VERDICTS)
def test_ranges_are_the_runs_of_true_entries(truth):
    runs = [[i for i, _ in group] for value, group in itertools.groupby(enumerate(truth), lambda e: e[1]) if value]
    assert true_ranges(np.array(truth)).tolist() == [[run[0], run[-1] + 1] for run in runs]


def test_rows_of_the_tables():
    result, _, task = judged("x > 0", x=[1, -1, -3, -2, 2] + [-0.5, 0.5] * 6)
    data = monitor_data(result, task, "t.csv")
    rows, more = range_rows(data)
    assert rows[:2] == [
        {"violated": "steps 1 … 3", "steps": 3, "least_robustness": "-3", "at_step": 2},
        {"violated": "step 5", "steps": 1, "least_robustness": "-0.5", "at_step": 5},
    ]
    assert (len(rows), more) == (5, 2)
    assert monitor_facts(data) == {
        "task": "x > 0", "trace": "t.csv, 17 samples", "horizon": "0", "judged": "17 steps, 0 … 16", "step 0": "holds",
        "violated": "at 9 of 17 steps, first at step 1", "robustness": "-3 at step 2, the least",
    }  # fmt: skip
    data = monitor_data(judged("!(x > 0) | A", x=[0, 1, 2, 0], A=[False, True, False, False])[0], task, "t.csv")
    assert [line.split()[2] for line in step_lines(data, None)][1:] == ["0", "inf", "-2", "0"]
    data = monitor_data(judged("A", A=[True, False, False])[0], task, "t.csv")
    assert range_rows(data)[0] == [{"violated": "steps 1 … 2", "steps": 2, "least_robustness": "-inf", "at_step": 1}]
    data = monitor_data(result, task, "t.csv")
    batch = monitor_data(judged("x > 0", x=[[1.0, -1]] * 3 + [[2.0, 2]] * 19)[0], task, "t.npz")
    rows, more = trace_rows(batch)
    assert (len(rows), more) == (20, 2)
    assert rows[2:4] == [
        {"trace": 2, "step 0": "holds", "violated_at": "1 step", "first": 1, "least_robustness": "-1", "at_step": 1},
        {"trace": 3, "step 0": "holds", "violated_at": "0 steps", "first": "–", "least_robustness": "2", "at_step": 0},
    ]
    asked = trace_rows(monitor_data(judged("x > 0", x=[[1.0, -1]])[0], task, "t.npz", at=1))
    assert asked == ([{"trace": 0, "step 1": "violated", "robustness": "-1"}], 0)
    assert list(step_lines(batch, 0)) == ["step  verdict   robustness", "0     holds     1", "1     violated  -1"]
    assert list(step_lines(data, None))[-1] == "16    holds     0.5"
    for at, width in ((9_999, 4), (10_000, 5)):
        data = monitor_data(judged("x > 0", x=np.ones(at + 1))[0], task, "t.csv")
        assert list(step_lines(data, None))[:2] == [
            f"{'step':{width}}  verdict   robustness",
            f"{0:<{width}}  holds     1",
        ]


# ---------------------------------------------------------------------------------------------------------- envelopes


@given(VERDICTS | st.lists(st.booleans(), min_size=20, max_size=60), st.integers(2, 9))
def test_coarse_ranges_cover_what_any_or_every_step_of_a_column_says(truth, columns):
    n = len(truth)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "COLUMNS", columns)
        some, every = (coarse(np.array(truth), combined) for combined in (np.logical_or, np.logical_and))
        column = [[t for t in range(n) if t * columns // n == i] for i in range(columns)] if n > columns else None
    for ranges, combined in ((some, any), (every, all)):
        covered = [t for t in range(n) if any(left < t < left + width for left, width in ranges)]
        if column is None:
            assert covered == [t for t in range(n) if truth[t]]
        else:
            starts = sorted({i * n // columns for i in range(columns)})
            parts = [range(a, b) for a, b in itertools.pairwise([*starts, n])]
            assert covered == [t for part in parts if combined(truth[u] for u in part) for t in part]
        assert ranges == sorted(ranges)
        assert all(a + width < b for (a, width), (b, _) in itertools.pairwise(ranges))  # joined where they touch


@given(st.lists(st.floats(-5, 5) | st.sampled_from([math.inf, -math.inf]), min_size=1, max_size=60), st.integers(2, 9))
def test_an_envelope_leaves_no_extreme_out(values, columns):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "COLUMNS", columns)
        xs, ys = envelope(np.array(values))
    n = len(values)
    finite = [value if math.isfinite(value) else math.nan for value in values]
    if n <= 2 * columns:
        assert xs.tolist() == list(range(n))
        np.testing.assert_array_equal(ys, finite)
        return
    assert len(xs) == len(ys) == 2 * columns
    for i, (a, b) in enumerate(itertools.pairwise([*(i * n // columns for i in range(columns)), n])):
        inside = [value for value in finite[a:b] if not math.isnan(value)]
        assert xs[2 * i] == xs[2 * i + 1] == (a + b - 1) / 2
        expected = [min(inside), max(inside)] if inside else [math.nan] * 2
        np.testing.assert_array_equal(ys[2 * i : 2 * i + 2], expected)


# --------------------------------------------------------------------------------------------------------- thresholds


@pytest.mark.parametrize(
    ("text", "values", "side"),
    [
        ("x > 0.5", (0.5,), "above"),
        ("x <= 0.5", (0.5,), "below"),
        ("0.5 >= x", (0.5,), "below"),
        ("2 * x - 1 < 3 - x / 2", (1.6,), "below"),
        ("1 - x * 4 > 3", (-0.5,), "below"),
        ("-(x + 1) <= -2", (1,), "above"),
        ("x == 0.1", (0.1,), "anywhere"),
        ("x != 0.1", (0.1,), "anywhere"),
        ("abs(x - 0.9) < 0.1", (0.8, 1.0), "between"),
        ("0.1 <= abs(0.9 - 2 * x)", (0.4, 0.5), "outside"),
        ("abs(x) == 2", (-2, 2), "anywhere"),
        ("abs(x) <= 0", (0, 0), "between"),
        ("x + x > 1", (0.5,), "above"),
        ("abs(x) < y", (), "anywhere"),
        ("abs(x) > -1", (), "anywhere"),
        ("abs(y) > 1", (), "anywhere"),
        ("abs(x) > x", (), "anywhere"),
        ("x > y", (), "anywhere"),
        ("x * x > 4", (), "anywhere"),
        ("1 / x > 4", (), "anywhere"),
        ("x / 0 > 4", (), "anywhere"),
        ("x ^ 2 > 4", (), "anywhere"),
        ("sqrt(x) > 4", (), "anywhere"),
        ("x + 1 > x", (), "anywhere"),
    ],
)
def test_where_a_predicates_truth_changes(text, values, side):
    node = stl.parse(text)
    found = threshold(node, "x")
    assert (found.values, found.side) == (pytest.approx(values), side)


@given(st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), st.sampled_from("xyc"), st.booleans(),
       st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3))  # fmt: skip
def test_a_side_is_where_the_predicate_holds(op, form, flipped, a, b, c):
    inner = {"x": f"({a}) * x + ({b})", "y": f"abs(({a}) * x + ({b}))", "c": f"x - ({a}) * x"}[form]
    node = stl.parse(f"({c}) {op} {inner}" if flipped else f"{inner} {op} ({c})")
    found = threshold(node, "x")
    if found.side == "anywhere":
        return
    first, *rest = found.values
    for x in (first - 0.25, first + 0.25, *(value + 0.25 for value in rest), sum(found.values) / len(found.values)):
        if x in found.values:
            continue
        inside = {"above": x > first, "below": x < first}.get(found.side)
        if inside is None:
            inside = (first < x < rest[0]) == (found.side == "between")
        assert satisfies(node, {"x": [x]}) == inside


# ----------------------------------------------------------------------------------------------------------- pictures


def boxes(collection):
    """(left, right, bottom, top) of each path."""
    return [tuple(path.get_extents().extents[[0, 2, 1, 3]].tolist()) for path in collection.get_paths()]


def bars(axes, label):
    """The boxes of one legend entry."""
    [found] = [bars for bars in axes.collections if bars.get_label() == label]
    return boxes(found)


def levels(axes):
    return [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "--"]


def texts(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()] if axes.get_legend() else []


def test_panels_bands_and_verdicts():
    result, signals, task = judged(
        "F[0,1] x > 0.5 & (y < 2 | door)",
        x=[0, 1, 0, 0, 0, 1], y=[1, 1, 3, 3, 1, 1], door=[False, True, True, False, False, False],
    )  # fmt: skip
    assert result.verdicts.tolist() == [True, True, False, False, True]
    figure = monitor_figure(result, signals, task)
    x, y, labels, parts, robustness, verdict = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == ["x", "y", "labels", "parts", "robustness", "verdict"]
    assert [text.get_text() for text in parts.get_yticklabels()] == ["F[0,1] (x > 0.5)", "y < 2 | door"]
    assert all(axes.get_xlim() == (-0.5, 5.5) for axes in figure.axes)
    assert verdict.get_xlabel() == "step"
    assert 6 < figure.get_size_inches()[1] < 9
    assert figure.get_suptitle() == "violated at 2 of 5 steps; least robustness -1 at step 3\n" + str(task.formula)
    np.testing.assert_array_equal(x.lines[0].get_ydata(), [0, 1, 0, 0, 0, 1])
    assert x.lines[0].get_marker() == "."
    top, bottom = x.get_ylim()[1], y.get_ylim()[0]
    assert top > 1
    assert bottom < 1
    assert bars(x, "x > 0.5") == [(0.5, 1.5, 0.5, top), (4.5, 5.5, 0.5, top)]
    assert bars(y, "y < 2") == [(-0.5, 1.5, bottom, 2), (3.5, 5.5, bottom, 2)]
    assert (levels(x), levels(y), levels(robustness)) == ([0.5], [2], [])
    assert (texts(x), texts(y), texts(labels), texts(robustness)) == (["x > 0.5"], ["y < 2"], [], [])
    assert [text.get_text() for text in labels.get_yticklabels()] == ["door"]
    assert boxes(labels.collections[0]) == [(0.5, 2.5, -0.35, 0.35)]
    assert labels.get_ylim() == (0.6, -0.6)
    np.testing.assert_array_equal(robustness.lines[0].get_ydata(), [0, 0])
    np.testing.assert_array_equal(robustness.lines[1].get_ydata(), result.robustness)
    least, greatest = robustness.get_ylim()
    assert least < result.robustness.min()
    assert greatest > result.robustness.max()
    ranges = ((0, result.robustness.max()), (result.robustness.min(), 0))
    for area, colour, (low, high) in zip(robustness.collections, (HOLDS, VIOLATED), ranges, strict=True):
        assert to_hex(area.get_facecolor()[0]) == colour
        assert {(round(bottom, 9), round(top, 9)) for _, _, bottom, top in boxes(area)} == {(low, high)}
    assert (bars(verdict, "holds"), bars(verdict, "violated"), bars(verdict, "not judged")) == (
        [(-0.5, 1.5, 0.25, 0.75), (3.5, 4.5, 0.25, 0.75)], [(1.5, 3.5, 0, 1)], [(4.5, 5.5, 0.4, 0.6000000000000001)]
    )  # fmt: skip
    assert texts(verdict) == ["holds", "violated", "not judged", "first violated: step 2"]
    for label, colour in (("holds", HOLDS), ("violated", VIOLATED)):
        [found] = [bars for bars in verdict.collections if bars.get_label() == label]
        assert to_hex(found.get_facecolor()[0]) == colour
    for axes in figure.axes:
        [mark] = [line for line in axes.lines if line.get_linestyle() == ":"]
        assert (mark.get_xdata(), mark.get_color()) == ([2, 2], VIOLATED)


def test_an_asked_step_and_a_trace_of_a_batch():
    result, signals, task = judged("abs(x) > 2 & x != 9", x=[[5, 5, 5], [0, -3, 0]])
    figure = monitor_figure(result, signals, task, trace=1, at=1)
    x, _, verdict = figure.axes
    low, high = x.get_ylim()
    assert bars(x, "abs(x) > 2") == [(0.5, 1.5, low, -2)]
    assert boxes(x.collections[2]) == [(0.5, 1.5, 2, high)]
    assert bars(x, "x != 9") == [(-0.5, 2.5, low, high)]
    assert levels(x) == [-2, 2, 9]
    assert figure.get_suptitle().startswith("trace 1: step 1 holds, robustness 1\n")
    assert texts(verdict) == ["holds", "violated", "selected: step 1"]
    [mark] = [line for line in x.lines if line.get_linestyle() == ":"]
    assert (mark.get_xdata(), mark.get_color()) == ([1, 1], HOLDS)
    whole = monitor_figure(result, signals, task, trace=0)
    assert whole.axes[1].get_ylim() == pytest.approx((-0.24, 3.24))  # zero is always seen
    assert whole.get_suptitle().startswith("trace 0: holds at all 3 steps; least robustness 3 at step 0\n")
    assert texts(whole.axes[-1]) == ["holds"]


def test_infinite_robustness_and_predicates_with_gaps():
    result, signals, task = judged("F[1,1] 1 / x > 0 | A", x=[0, 1, 1], A=[True, False, False])
    figure = monitor_figure(result, signals, task)
    x, _, _, robustness, _ = figure.axes
    assert bars(x, "1 / x > 0 (has gaps)") == []
    assert texts(robustness) == ["infinite at 1\nof 2 steps"]
    assert np.isnan(robustness.lines[1].get_ydata()).tolist() == [True, False]
    assert len(robustness.get_yticks()) > 1
    result, signals, task = judged("_A", _A=[True, False])
    robustness = monitor_figure(result, signals, task).axes[1]
    assert texts(robustness) == ["infinite at 2\nof 2 steps"]
    assert robustness.get_yticks().tolist() == [0]
    result, signals, task = judged("_x > 0 & F[0,1] _x > 1e300", _x=[1e308, -1e308, 0])
    assert texts(monitor_figure(result, signals, task).axes[0]) == [" _x > 0", " _x > 1e+300"]


def test_what_would_not_be_read_is_counted(monkeypatch):
    text = " & ".join([f"s{i} > 0" for i in range(10)] + [f"s0 < {i}" for i in range(7)] + [f"L{i}" for i in range(14)])
    names = [f"s{i}" for i in range(10)], [f"L{i}" for i in range(14)]
    result, signals, task = judged(f"G[0,1] ({text})", **{name: [0.5] * 4 for name in names[0]},
                                   **{name: [True] * 4 for name in names[1]})  # fmt: skip
    figure = monitor_figure(result, signals, task)
    assert [axes.get_ylabel() for axes in figure.axes] == [*names[0][:8], "labels", "parts", "robustness", "verdict"]
    assert texts(figure.axes[0]) == ["s0 > 0", *(f"s0 < {i}" for i in range(5)), "and 2 more"]
    assert len(figure.axes[8].get_yticks()) == 12
    assert 15 < figure.get_size_inches()[1] < 20
    assert figure.axes[-1].get_xlabel() == "step; 8 of the 10 signals are shown; 12 of the 14 labels are shown"
    assert len(figure.get_suptitle().splitlines()[1]) == 120
    assert figure.get_suptitle().endswith("…")
    six = monitor_figure(*judged(" & ".join(f"x < {i}" for i in range(6)), x=[0, 1])).axes[0]
    assert texts(six) == [f"x < {i}" for i in range(6)]


def lanes(panel, name, n=3):
    """The ranges of steps that the bars in one of n lanes cover, first … last, and whether they are tall."""
    half = np.ptp(panel.ylim) / (n + 0.2) / 2
    return [(round(a + 0.5), round(b - 0.5), bool(d - c > half)) for a, c, b, d in panel.boxes(name)]


def in_lanes(panel, name, n):
    """The markers in a panel of n lanes, as (step, lane)."""
    down = (panel.ylim[1] - panel.markers(name)[:, 1]) / np.ptp(panel.ylim)
    return sorted(zip(panel.markers(name)[:, 0].round(2).tolist(), (down * (n + 0.2) - 0.6).round(2), strict=True))


def test_parts_and_causes_read_back_from_the_picture():
    task = stl.parse_task("near := x > 2 & a\nduty := G[0,2] (near -> (F[0,1] b))")
    signals = {
        "x": np.array([0.0, 3, 3, 0, 3, 3, 0]),
        "a": np.array([1, 0, 1, 1, 0, 1, 1]),
        "b": np.array([1, 0, 0, 0, 0, 1, 0]),
    }
    result = stl.monitor(task, signals)
    assert result.verdicts.tolist() == [False, False, False, True]
    why = stl.diagnose(task, signals, 0)
    assert {name: steps.tolist() for name, steps in why.causes.items()} == {"a": [2], "b": [2, 3], "x": [2]}
    drawn = Picture(monitored(result, signals, task, "svg", causes=why.causes))
    x, labels, parts, _, verdict = drawn.panels
    assert [text.text for text in drawn.texts() if text.text in ("near", "F[0,1] b", "near -> (F[0,1] b)")] == [
        "near -> (F[0,1] b)", "near", "F[0,1] b",
    ]  # fmt: skip
    assert (lanes(parts, "true-0"), lanes(parts, "false-0")) == ([(0, 1, True), (3, 5, True)], [(2, 2, False)])
    assert (lanes(parts, "true-1"), lanes(parts, "open-1")) == ([(2, 2, True), (5, 5, True)], [])
    assert (lanes(parts, "true-2"), lanes(parts, "open-2")) == ([(0, 0, True), (4, 5, True)], [(6, 6, False)])
    assert lanes(parts, "false-2") == [(1, 3, False)]
    np.testing.assert_allclose(x.markers("cause"), [[2, 3]], atol=0.01)
    assert in_lanes(labels, "cause", 2) == [(2, 0), (2, 1), (3, 1)]
    assert "cause" not in {*parts.names(), *verdict.names()}
    assert "cause" not in Picture(monitored(result, signals, task, "svg")).panels[0].names()


def test_the_page_shows_parts_and_why():
    task = stl.parse_task("near := x > 2 & a\nduty := G[0,2] (near -> (F[0,1] b))")
    signals = {"x": [0, 3, 3, 0, 3, 3, 0], "a": [1, 0, 1, 1, 0, 1, 1], "b": [1, 0, 0, 0, 0, 1, 0]}
    data = monitor_data(stl.monitor(task, signals), task, "log.csv")
    data["why"] = diagnosis_data(stl.diagnose(task, signals, 0))
    page = render(json.loads(json.dumps(monitor_report(data, signals, task))))
    panel = Picture(drawn(page)[0]).panel
    told = [(lanes(panel, f"true-{i}", 7), lanes(panel, f"false-{i}", 7)) for i in range(4)]
    assert told[0] == ([(3, 3, True)], [(0, 2, False)])  # the whole
    assert told[1] == ([(0, 1, True), (3, 5, True)], [(2, 2, False)])
    assert told[2] == ([(2, 2, True), (5, 5, True)], [(0, 1, False), (3, 4, False), (6, 6, False)])
    assert told[3] == ([(0, 0, True), (4, 5, True)], [(1, 3, False)])
    assert in_lanes(panel, "cause", 7) == [(2, 4), (2, 5), (2, 6), (3, 5)]  # below the parts: a, b, x
    assert "<h2>Why it is violated at step 0</h2>" in page
    assert "F[0,1] b fails at step 2: b is false throughout steps 2 … 3; last true at 0, next at 5, needed by 3" in page
    assert "Causes: a at step 2, b at steps 2 … 3, x at step 2 (4 samples, a minimal set)." in page
    data = monitor_data(stl.monitor(task, signals), task, "log.csv", at=0) | {"why": data["why"]}
    panel = Picture(drawn(render(json.loads(json.dumps(monitor_report(data, signals, task)))))[0]).panel
    assert lanes(panel, "false-0", 6) == [(2, 2, False)]  # the same without the whole, of which one step was judged
    assert in_lanes(panel, "cause", 6) == [(2, 3), (2, 4), (2, 5), (3, 4)]
    batch = {name: [values, values[::-1]] for name, values in signals.items()}
    data = monitor_data(stl.monitor(task, batch), task, "log.npz")
    told = render(json.loads(json.dumps(monitor_report(data, batch, task))))
    assert lanes(Picture(drawn(told)[0]).panel, "true-2", 4) == [(2, 2, True), (5, 5, True)]
    assert "Why it" not in told
    assert "thin where it is not judged, of trace 0" in told
    data["why"] = diagnosis_data(stl.diagnose(task, {name: rows[1] for name, rows in batch.items()}), 1)
    assert "not judged, of trace 1" in render(json.loads(json.dumps(monitor_report(data, batch, task))))


def test_many_parts_are_folded_and_gaps_told():
    text = " & ".join(f"(F[0,{i}] x > 0)" for i in range(20))
    figure = monitor_figure(*judged(text, x=np.ones(30)))
    assert len(figure.axes[1].get_yticks()) == 12
    assert figure.axes[-1].get_xlabel() == "step; 12 of the 20 parts are shown"
    figure = monitor_figure(*judged("F[1,1] (1 / x > 0 & a)", x=[0.0, 1, 1], a=[True, True, True]))
    assert [text.get_text() for text in figure.axes[2].get_yticklabels()] == ["1 / x > 0 & a (has gaps)"]


@pytest.mark.parametrize(
    ("text", "x", "limits", "shown"),
    [
        ("x < 1000 & x > 1.5", [1, 2, 3], (0.84, 3.16), [1.5]),  # a curve, not a flat line below 1000
        ("x > -1000 & x < 8", [1, 2, 3], (0.44, 8.56), [8]),
        ("x > -4", [1, 2, 3], (-4.56, 3.56), [-4]),
        ("x > 1e200 & x < 1e9", [5, 5], (5 - 0.08 * (1e9 - 5), 1e9 + 0.08 * (1e9 - 5)), [1e9]),
        ("x < x + 1", [4, 4], (2, 6), []),
        ("x < x + 1", [0, 0], (-0.5, 0.5), []),
        ("abs(x) < 2", [1, 2, 3], (-2.4, 3.4), [-2, 2]),
    ],
)
def test_what_a_panel_shows(text, x, limits, shown):
    panel = monitor_figure(*judged(text, x=x)).axes[0]
    assert panel.get_ylim() == pytest.approx(limits)
    assert levels(panel) == shown
    if text == "abs(x) < 2":
        assert bars(panel, text) == [(-0.5, 0.5, -2, 2)]
    if "1000" in text:
        low, high = panel.get_ylim()
        assert bars(panel, next(part for part in text.split(" & ") if "1000" in part)) == [(-0.5, 2.5, low, high)]


def test_tints_where_a_column_holds_now_and_then(monkeypatch):
    monkeypatch.setattr(pictures, "COLUMNS", 3)
    x, labels, _, verdict = monitor_figure(*judged("x > 0 & A", x=[1, 1, 1, -1, -1, -1], A=[0, 1, 0, 0, 1, 1])).axes
    some, every = x.collections
    assert [box[:2] for box in boxes(some)] == [(-0.5, 3.5)]
    assert [box[:2] for box in boxes(every)] == [(-0.5, 1.5)]
    some, every = labels.collections
    assert [box[:2] for box in boxes(some)] == [(-0.5, 1.5), (3.5, 5.5)]
    assert [box[:2] for box in boxes(every)] == [(3.5, 5.5)]
    assert texts(verdict) == ["violated", "first violated: step 0"]  # at step 1 it holds, in a column that does not
    assert bars(verdict, "violated") == [(-0.5, 5.5, 0, 1)]
    assert verdict.get_ylim() == (0, 1)


def test_a_violation_among_many_samples_is_seen():
    x = np.ones(100_000)
    x[77_777] = -5
    figure = monitor_figure(*judged("x > 0", x=x))
    [(left, right, _, _)] = bars(figure.axes[-1], "violated")
    assert left < 77_777 < right < left + 70
    assert figure.axes[0].lines[0].get_ydata().min() == -5
    assert len(figure.axes[0].lines[0].get_ydata()) == 3000
    assert figure.axes[0].lines[0].get_marker() == "None"


@pytest.mark.parametrize(("ending", "magic"), [("png", b"\x89PNG"), ("svg", b"<svg"), ("PDF", b"%PDF")])
def test_pictures_are_the_same_bytes_every_time(tmp_path, ending, magic):
    result, signals, task = judged("F[0,1] x > 0 & A", x=[1, -1, -1, 1], A=[True, True, False, True])
    first, again = (tmp_path / f"{name}.{ending}" for name in ("first", "again"))
    for path in (first, again):
        write_monitor_picture(result, signals, task, path)
    assert first.read_bytes().startswith(magic)
    assert first.read_bytes() == again.read_bytes()
