"""--plot and --report of check --robustness, check --vary and frontier: pictures read back from the SVG, and pages."""

import json

import numpy as np
import pytest

import stltool as stl
from stltool.numbers import bound_texts
from stltool.reporting import frontier_report, load_report, render
from stltool.reporting.answers import contrast, survival_picture
from stltool.reporting.figures import frontier_picture, parameter_curve, survival
from tests.conftest import FACTORY
from tests.reporting.svg import Picture
from tests.reporting.test_figures import same

MARGINS, TASK = str(FACTORY / "margins.stl"), str(FACTORY / "patrolling.stl")
SMALL = ["--model", str(FACTORY / "floor-5x5.toml"), "-p", "T=3", "-p", "tau=8"]


def step_points(values, p, panel, beyond=0.0):
    """P(ρ ≥ r) as a line: up to each value its own probability."""
    left, right = panel.xlim
    corners = [(left, p[0])]
    for i, r in enumerate(values):
        corners += [(r, p[i]), (r, p[i + 1] if i + 1 < len(p) else beyond)]
    return [*corners, (right, beyond)]


def corners_of(shape):
    """A line without the points inside its straight parts, and without points that repeat."""
    kept = [shape[0]]
    for point in shape[1:]:
        if np.allclose(point, kept[-1], atol=1e-9):
            continue
        if len(kept) > 1 and (np.allclose(point[0], [kept[-1][0], kept[-2][0]], atol=1e-9)
                              or np.allclose(point[1], [kept[-1][1], kept[-2][1]], atol=1e-9)):  # fmt: skip
            kept[-1] = point
        else:
            kept.append(point)
    return np.array(kept)


def test_a_survival_function_falls_after_each_value():
    curves = [
        {"name": "best", "values": [-0.5, 0.25, 1.0], "p": [1.0, 0.75, 0.5], "beyond": 0.25},
        {"name": "given", "values": [-0.5, 0.25], "p": [0.9, 0.125], "beyond": 0.0},
    ]
    picture = Picture(survival(curves, "svg"))
    panel = picture.panel
    for i, curve in enumerate(curves):
        [line] = panel.shapes(f"survival-{i}")
        expected = step_points(curve["values"], curve["p"], panel, curve["beyond"])
        same(corners_of(line), corners_of(np.array(expected)), panel)
        same(panel.markers(f"values-{i}"), list(zip(curve["values"], curve["p"], strict=True)), panel)
    assert {"best", "given", "margin r", "P(robustness ≥ r)"} <= {text.text for text in picture.texts()}


@pytest.mark.soak(only=True)
def test_the_page_contrasts_the_best_policy_with_what_is_possible(stltool, tmp_path):
    """The headline of docs/robustness.md, on a smaller floor."""
    asked = ["check", MARGINS, *SMALL, "--robustness"]
    code, out, err = stltool(*asked, "--report", tmp_path, "--plot", tmp_path / "margins.svg")
    assert (code, err) == (0, "")
    assert f"plot             {tmp_path / 'margins.svg'}" in out
    data = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    task, model = stl.load_task(MARGINS, params={"T": 3, "tau": 8}), stl.load_model(FACTORY / "floor-5x5.toml")
    optimum = stl.robustness_distribution(model, task)
    own = stl.robustness_distribution(model, task, stl.check(stl.build_product(model, task)).policy)
    for found, kept in ((optimum, data), (own, data["beside"])):
        assert (kept["values"], kept["lower"]) == (found.values.tolist(), found.lower.tolist())
    picture = (tmp_path / "margins.svg").read_text(encoding="utf-8")
    panel = Picture(picture).panel
    for i, found in enumerate((optimum, own)):
        same(panel.markers(f"values-{i}"), np.stack([found.values, found.lower], axis=1), panel)
    never, possible = found.values[found.upper > 0][-1], optimum.values[optimum.lower > 0][-1]
    assert never < possible
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    said = f"The policy that is best for P never has a margin above {never:g}; {possible:g} is possible at "
    assert said in page
    assert page == render(load_report(tmp_path / "report.json"))
    code, _, _ = stltool(*asked, "--policy-function", "never.module:f", "--plot", "x.svg")
    assert code == 2
    told = contrast(data["beside"], data["beside"], "the policy")
    assert told == f"The policy never has a margin above {never:g}, and no policy has one."
    policys = {**data["beside"], "beside": data}
    same(Picture(survival_picture(policys, "svg")).panel.markers("values-1"), panel.markers("values-1"), panel)


def test_infinite_margins_stay_above():
    curve = {"question": "maximum", "values": [0.0, "inf"], "lower": [1.0, 0.5], "upper": [1.0, 0.5]}
    panel = Picture(survival_picture({**curve, "beside": curve}, "svg")).panel
    [line] = panel.shapes("survival-0")
    same(corners_of(line), [(panel.xlim[0], 1), (0, 1), (0, 0.5), (panel.xlim[1], 0.5)], panel)
    assert contrast(curve, curve, "the policy") == "The robustness is infinite: labels or constants decide."


def test_a_parameters_curve_bound_and_optimal_pieces(stltool, tmp_path):
    asked = ["check", TASK, "-p", "T=3", "-p", "tau=6", "--model", FACTORY / "floor-5x5-p.toml", "--vary", "p=0.5:1"]
    code, out, err = stltool(*asked, "--at-least", "0.9", "--report", tmp_path, "--plot", tmp_path / "p.svg")
    assert (code, err) == (1, "")
    data = load_report(tmp_path / "report.json")
    product = stl.build_product(
        stl.load_model(FACTORY / "floor-5x5-p.toml"), stl.load_task(TASK, params={"T": 3, "tau": 6})
    )
    found = stl.parametric(product, over={"p": (0.5, 1)})
    panel = Picture((tmp_path / "p.svg").read_text(encoding="utf-8")).panel
    [line] = panel.shapes("lower")
    for p, value in line[:: len(line) // 20]:
        assert value == pytest.approx(found.at(min(max(float(p), 0.5), 1.0))[0], abs=5e-3)
    assert (line[0][0], line[-1][0]) == pytest.approx((0.5, 1), abs=1e-3)
    assert panel.levels("bound") == pytest.approx([0.9], abs=1e-3)
    first = found.smallest(0.9)
    [mark] = panel.shapes("smallest")
    assert mark[:, 0] == pytest.approx(float(first.enough), abs=1e-3)
    optimal = [piece for piece in found.pieces if piece.optimal]
    assert len([name for name in panel.names() if name.startswith("optimal-")]) == len(optimal) > 0
    for i, piece in enumerate(optimal):
        spans = [shape for shape in panel.shapes(f"optimal-{i}") if np.ptp(shape[:, 0]) > 0.01]
        for span in spans:
            assert sorted(span[:, 0]) == pytest.approx([piece.lower, piece.upper], abs=1e-3)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    said = f"p = {float(first.enough):.9g} reaches 0.9, none below {float(first.below):.9g} does"
    assert said in page
    assert said in out
    assert "does not hold everywhere" in page
    assert f"On {len(optimal)} of {len(found.pieces)} pieces one policy is optimal" in page
    assert parameter_curve(data, "svg") == (tmp_path / "p.svg").read_text(encoding="utf-8")


def frontier(text, at_least, **values):
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    return stl.frontier(model, stl.parse_task(text), at_least, values)


def test_a_staircase_shows_its_checks_and_steps():
    found = frontier("param T = 2\nparam n = 6\nr := (G[0,T] !A) & F[0,n] A", 0.9, T=[0, 3, 5], n=[3, 5, 6, 7])
    data = json.loads(json.dumps(frontier_report(found, "stltool frontier")))
    panel = Picture(frontier_picture(data, "svg")).panel
    for name, held in (("holds", True), ("fails", False)):
        same(panel.markers(name), [tuple(map(float, probe.values)) for probe in found.probes if probe.holds is held],
             panel)  # fmt: skip
    [line] = panel.shapes("staircase")
    steps = [(float(step.others[0]), float(step.tightest)) for step in found.steps]
    assert len({y for _, y in steps}) == len(steps) == 3
    np.testing.assert_allclose(np.interp([x for x, _ in steps], *line.T), [y for _, y in steps], atol=0.02)
    [reached] = panel.shapes("reached")
    assert reached[:, 1].max() == pytest.approx(7, abs=0.02)
    page = render(data)
    assert "the bound is reached for 3 of 3 values of T" in page
    assert "maximum P ≥ 0.9, over T and n" in page


def test_the_checks_of_one_param_are_a_curve():
    found = frontier("step = 1s\nparam d = 2s\nr := F[0,d] A", 0.9, d=["1s", "2s", "5s", "9s"])
    data = frontier_report(found)
    picture = Picture(frontier_picture(data, "svg"))
    names = [param["values"].index(probe["values"][0]) for param in data["params"] for probe in data["probes"]]
    expected = [(float(place), probe.probability) for place, probe in zip(names, found.probes, strict=True)]
    shown = {text.text for text in picture.texts()}
    assert {"1s", "2s", "5s", "9s"} <= shown
    assert f"tightest: {data['steps'][0]['tightest']}" in shown
    assert sorted(y for _, y in expected) == sorted(probe["P"] for probe in data["probes"])
    assert f"the tightest d is {data['steps'][0]['tightest']}" in render({**data, "command": None})


def test_frontiers_are_drawn_and_reported(stltool, tmp_path):
    asked = ["frontier", TASK, "-p", "T=2", "-p", "tau=3", "--at-least", "0.95", "--vary", "tau"]  # values around 3
    code, out, err = stltool(*asked, "--plot", tmp_path / "f.svg", "--report", tmp_path)
    assert (code, err) == (0, "")
    data = load_report(tmp_path / "report.json")
    assert data["params"][0]["values"] == ["1", "2", "3", "4", "5", "6"]
    assert "smallest tau  6" in out
    panel = Picture((tmp_path / "f.svg").read_text(encoding="utf-8")).panel
    same(panel.markers("probes"), [(float(probe["values"][0]), probe["P"]) for probe in data["probes"]], panel)
    assert panel.levels("bound") == pytest.approx([0.95], abs=1e-3)
    [mark] = panel.shapes("tightest")
    assert mark[:, 0] == pytest.approx(6, abs=0.02)


@pytest.mark.parametrize(
    ("options", "margin", "chip"),
    [
        (["--margin", "0.1", "--at-most", "0.01"], 0.1, "does not hold at margin 0.1"),
        (["--margin", "0.1"], 0.1, None),
        (["--at-least", "0.5"], None, "holds at margin "),
    ],
)
def test_the_page_marks_the_margin_that_was_asked_for(stltool, tmp_path, options, margin, chip):
    """Among all margins, of which stdout has one; without one, the largest that is probable enough."""
    asked = ["check", MARGINS, *SMALL, "--robustness", *options, "--report", tmp_path, "--plot", tmp_path / "m.svg"]
    _, out, err = stltool(*asked, "--json")
    printed, data = json.loads(out), json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    task, model = stl.load_task(MARGINS, params={"T": 3, "tau": 8}), stl.load_model(FACTORY / "floor-5x5.toml")
    everything = stl.robustness_distribution(model, task)
    assert err == ""
    assert data["values"] == everything.values.tolist()
    assert [data["margin"]] == (printed["values"] if margin is None else [margin])
    assert [data.get(key) for key in ("at_least", "at_most", "holds")] == [
        printed.get(key) for key in ("at_least", "at_most", "holds")
    ]
    panel = Picture((tmp_path / "m.svg").read_text(encoding="utf-8")).panel
    [line] = panel.shapes("margin")
    assert line[:, 0] == pytest.approx(data["margin"], abs=1e-3)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page == render(load_report(tmp_path / "report.json"))
    assert (chip is None) == ("hold at margin" not in page and "holds at margin" not in page)
    assert chip is None or chip in page
    assert " … ".join(bound_texts(*everything.at(data["margin"]))) in page


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["check", TASK, "--plot", "x.svg"], "--plot x.svg draws what --robustness or --vary finds; add one of them"),
        (["check", TASK, "--robustness", "--plot", "x.txt"], "x.txt: pictures are written as .svg or .png"),
        (["check", TASK, "--robustness", "--time-shift", "0", "--plot", "x.svg"],
         "with --time-shift, --plot is not supported with --robustness"),
        (["check", TASK, "--robustness", "--time-shift", "0", "--report", "x"],
         "with --time-shift, --report is not supported with --robustness"),
        (["check", TASK, "--cost", "x", "--report", "x"], "--report is not supported with --cost without --within"),
        (["frontier", TASK, "--at-least", "1", "--vary", "T", "--plot", "x"], "pictures are written as .svg or .png"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_refused(stltool, arguments, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = stltool(*arguments)
    assert (code, out) == (2, "")
    assert says in err
    assert list(tmp_path.iterdir()) == []
