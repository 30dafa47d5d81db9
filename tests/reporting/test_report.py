import html
import json
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.evidence import evidence_of
from stltool.errors import FileError, InexactEncodingWarning, SettingsError
from stltool.reporting import check_data, load_report, render, report_data
from stltool.reporting.page import bound_texts, probability_text
from stltool.reporting.runs import trace_text, verdict_text


@pytest.fixture
def results(patrolling):
    run = stl.learn(patrolling, "cfer", episodes=60, seed=1)
    return [stl.check(patrolling), stl.check(patrolling, run.policy)], run


def test_a_report_is_one_self_contained_page_and_its_data(results, tmp_path):
    checks, run = results
    stl.report(checks, run, tmp_path / "report.html", source="task := …", command="stltool run task.stl", seed=1)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    data = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert not re.findall(r"(?:src|href)\s*=\s*[\"'](?!#)", page)  # nothing is loaded from elsewhere
    assert page.count("<script") == 2  # the explorer's data and the page's own script
    assert (
        page.count('<div class="pictures"><svg') == 3
    )  # learning curve, floors with a run and the likeliest violation
    for check, result in zip(data["checks"], checks, strict=True):
        assert check["probability"] == result.probability
        for bound in bound_texts(result.lower, result.upper):
            assert f">{bound}<" in page
    assert data["checks"][1]["gap"] == checks[0].probability - checks[1].probability
    for text in (html.escape(str(checks[0].product.formula)), "stltool run task.stl", "seed 1", "task := …"):
        assert text in page
    assert len(data["training"]["history"]) == 3
    assert data["training"]["environment_steps"] == run.environment_steps


def test_the_page_is_made_from_the_data_alone(results, tmp_path):
    checks, run = results
    stl.report(checks, run, tmp_path / "report.html")
    assert render(load_report(tmp_path / "report.json")) == (tmp_path / "report.html").read_text(encoding="utf-8")


def test_text_of_the_user_is_escaped(results):
    checks, run = results
    page = render(report_data(checks, run, source="a < b <script>alert(1)</script>"))
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page


def test_a_report_without_training_or_floor():
    model = stl.MDP.from_arrays([np.eye(2)], {"x": [0, 1]}, labels={"A": [0, 1]}, initial=[0.5, 0.5])
    product = stl.build_product(model, stl.parse("F[0,2) A"))
    page = render(report_data([stl.check(product)]))
    assert 'class="pictures"' not in page
    assert "P = 0.5" in page


def test_a_report_says_what_a_clock_is_worth(patrolling, floor5, tmp_path):
    found = [stl.stationary(patrolling, memory=memory, most=2) for memory in ("automaton", "none")]
    stl.report(stl.check(patrolling), None, tmp_path / "report.html", stationary=found)
    page = html.unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "Without a clock" in page
    data = load_report(tmp_path / "report.json")["stationary"]
    for row, one in zip(data, found, strict=True):
        assert (row["kind"], row["bound"], row["gap"]) == (one.kind, one.bound, one.gap)
        assert one.status in page
    assert f"{sum(len(one.candidates) for one in found)} such policies were evaluated" in page
    other = stl.stationary(stl.build_product(floor5, stl.parse("F[0,2] A")), most=0)
    with pytest.raises(SettingsError, match="belong to several models or tasks"):
        report_data([stl.check(patrolling)], stationary=[other])


def test_a_report_tells_why_it_fails(results):
    checks, run = results
    data = report_data(checks, run, evidence=evidence_of(checks[1].product, run.policy, 0))
    page = html.unescape(render(data))
    likely = stl.likely_runs(checks[1].product, run.policy, count=5)
    assert [row["probability"] for row in data["why"]["runs"]] == [row.probability for row in likely.runs]
    for row in data["why"]["runs"]:
        assert f"violated at step {row['step']}" in page
        assert f'<td class="long">{trace_text(row["states"], row["labels"], row["actions"])}</td>' in page
    moves = stl.sensitivity(checks[1].product, run.policy).ranked(5)
    assert [row["name"] for row in data["why"]["sensitive"]] == [row.name for row in moves if row.derivative]
    assert f"{moves[0].derivative:.4g}</td>" in page
    del data["why"]  # as earlier versions wrote it
    assert "Why it fails" not in render(data)


def test_a_report_without_a_violating_run(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,2) (A | !A)"))
    best = stl.check(product)
    page = render(report_data([best], evidence=evidence_of(product, best.policy, 0)))
    assert "No run of positive probability violates the task." in page
    assert page.count('class="pictures"') == 1
    assert "dP / dp" not in page


def test_a_large_unfolding_is_left_to_those_who_ask(results, monkeypatch):
    checks, _ = results
    monkeypatch.setattr("stltool.checking.evidence._MOST_EDGES", 100)
    data = report_data(checks, evidence=evidence_of(checks[1].product, checks[1].policy, 0))
    assert data["why"] is None
    assert data["run"] is not None
    assert "Why it fails" not in render(data)


def test_a_trace_and_a_verdict_in_one_line():
    fell = {"satisfied": False, "step": 4, "certain_from": 4}
    assert verdict_text(fell) == "violated at step 4"
    assert verdict_text({**fell, "satisfied": True, "certain_from": 2}) == "satisfied at step 4 (certain from step 2)"
    text = trace_text(["a", "b", "b", "b"], [[], ["A", "B"], ["A", "B"], []], ["go", "stay", "stay"])
    assert text == "a go → 2 × b {A, B} stay → b"
    assert trace_text(["a"], [["A"]], []) == "a {A}"


def test_the_approximation_is_said_aloud(floor5):
    with pytest.warns(InexactEncodingWarning):
        product = stl.build_product(floor5, stl.parse("F[0,3) (F[0,2) A & G[0,4) B)"), encoding="paper")
    assert "only approximates this formula" in render(report_data([stl.check(product)]))


def test_check_data_has_the_promised_keys(results):
    checks, _ = results
    keys = "task formula horizon encoding states automaton_states product_states probability lower upper optimum gap"
    data = check_data(checks[1], checks[0])
    assert {*keys.split(), "status", "seconds"} <= set(data)
    assert json.loads(json.dumps(data)) == data


def test_results_of_different_products_do_not_mix(results, floor5):
    other = stl.check(stl.build_product(floor5, stl.parse("F[0,5) A")))
    with pytest.raises(SettingsError, match="several models or tasks"):
        report_data([results[0][0], other])
    with pytest.raises(SettingsError, match="at least one check"):
        report_data([])


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": "stltool-report-1"}', '{"format": "other"}'])
def test_what_is_no_report(tmp_path, text):
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(FileError, match="not the JSON file of a report"):
        load_report(tmp_path / "report.json")


@given(st.floats(0, 1), st.floats(0, 1))
def test_printed_bounds_enclose_the_bounds(one, other):
    lower, upper = sorted((one, other))
    low, high = bound_texts(lower, upper)
    assert Fraction(low) <= Fraction(lower)
    assert Fraction(high) >= Fraction(upper)


def test_probabilities_near_one_are_told_apart():
    assert [probability_text(p) for p in (0.0, 0.5, 0.9999930210946937, 1.0)] == ["0", "0.5", "1 − 6.98e-06", "1"]


def test_the_headline_says_whose_probability_and_how_sure(patrolling, tmp_path):
    best = stl.check(patrolling)
    run = stl.learn(patrolling, "cfer", episodes=5, seed=0)
    mine = stl.check(patrolling, run.policy)
    for training, words in ((run, "Under the learned policy."), (None, "Under the given policy.")):
        stl.report([best, mine], training, tmp_path / "r.html")
        page = (tmp_path / "r.html").read_text(encoding="utf-8")
        assert words in page
        assert " ≤ P ≤ ".join(bound_texts(mine.lower, mine.upper)) in page


def test_a_fraction_is_shown_whole(patrolling, tmp_path):
    stl.report([stl.check(patrolling, exact=True)], None, tmp_path / "r.html")
    assert "73794757279959/100000000000000" in (tmp_path / "r.html").read_text(encoding="utf-8")
