"""`--report FOLDER`: every command that has it writes a page and the JSON that it is made from."""

import html
import json
import re

import pytest

import stltool as stl
from stltool.reporting import load_report, render
from tests.conftest import FACTORY, PATROLLING, SMALL


def page_of(folder):
    """The page, which its JSON makes again."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert render(load_report(folder / "report.json")) == page
    return html.unescape(page), json.loads((folder / "report.json").read_text())


def test_a_check_reports_verdicts_and_its_certificate(stltool, tmp_path):
    certificate = tmp_path / "best.jsonl"
    code, out, _ = stltool(
        "check", PATROLLING, *SMALL, "--at-least", "0.7", "--at-most", "0.7", "--exact",
        "--certificate", certificate, "--report", tmp_path,
    )  # fmt: skip
    page, data = page_of(tmp_path)
    assert code == 1
    assert f"report  {tmp_path / 'report.html'}" in out
    assert data["asked"] == [{"claim": "P >= 0.7", "holds": True}, {"claim": "P <= 0.7", "holds": False}]
    assert "✓ holds: P >= 0.7" in page
    assert "✕ does not hold: P <= 0.7" in page
    [value] = re.findall(r"P = ([\d.]+)<", page)
    assert data["checks"][0]["lower"] <= float(value) <= data["checks"][0]["upper"]
    assert float(value) == pytest.approx(0.73794757279959, rel=0, abs=1e-14)
    assert page.index("✓ holds") < page.index(f"P = {value}<") < page.index("within the next 4 steps at_A holds")
    assert data["certificate"]["lower"] == data["certificate"]["upper"] == "73794757279959/100000000000000"
    assert data["certificate"]["command"] in page
    assert stltool(*data["certificate"]["command"].split()[1:])[0] == 0  # it re-checks it


def test_a_bound_inside_the_enclosure_is_undecided(stltool, tmp_path, patrolling):
    middle = stl.check(patrolling)
    bound = f"{(middle.lower + middle.upper) / 2:.17g}"
    assert stltool("check", PATROLLING, *SMALL, "--at-least", bound, "--report", tmp_path)[0] == 1
    page, data = page_of(tmp_path)
    assert data["asked"][0]["holds"] is None
    assert f"? undecided: P >= {bound}" in page


def test_a_given_policy_is_shown_against_the_optimum(stltool, tmp_path, patrolling):
    policy = stl.learn(patrolling, "cfer", episodes=30, seed=0).policy
    policy.save(tmp_path / "policy.npz")
    assert stltool("check", PATROLLING, *SMALL, "--policy", tmp_path / "policy.npz", "--report", tmp_path)[0] == 0
    page, data = page_of(tmp_path)
    assert [check["question"] for check in data["checks"]] == ["maximum", "policy"]
    assert "Under the given policy." in page
    assert "below the best possible" in page


def test_an_estimate_has_a_page(stltool, tmp_path, patrolling):
    assert stltool("estimate", PATROLLING, *SMALL, "--runs", "200", "--report", tmp_path)[0] == 0
    page, data = page_of(tmp_path)
    assert data["format"] == "stltool-estimate-1"
    assert f"P ≈ {data['probability']:.6g}" in page
    assert data["statement"][1:] in page
    assert data["exact"] == stl.check(patrolling).probability


def test_a_sequential_test_has_a_page(stltool, tmp_path):
    code, _, _ = stltool("estimate", PATROLLING, *SMALL, "--at-least", "0.9", "--report", tmp_path)
    page, data = page_of(tmp_path)
    assert (code, data["verdict"]) == (1, "does not hold")
    assert "✕ does not hold: P ≥ 0.9" in page


def test_a_front_has_a_page(stltool, tmp_path):
    task = FACTORY / "tradeoff.stl"
    arguments = ("pareto", task, "-p", "T=3", "-p", "tau=8", "--tasks", "charging,patrolling", "--report", tmp_path)
    assert stltool(*arguments)[0] == 0
    page, data = page_of(tmp_path)
    assert data["format"] == "stltool-front-1"
    assert "charging against patrolling" in page
    for corner in data["corners"]:
        found = corner["probabilities"]["patrolling"]  # shown with the digits that its bounds take
        shown = [
            text for text in re.findall(r">(0\.\d+|[01])<", page) if found["lower"] <= float(text) <= found["upper"]
        ]
        assert shown, found
    assert data["words"]["charging"]["text"].startswith("at some step")


def test_a_monitored_trace_has_a_page(stltool, tmp_path):
    (tmp_path / "trace.csv").write_text("x\n1\n1\n0\n0\n0\n1\n")
    for formula, code, words in (
        ("F[0,1] x > 0.5", 1, "first at step 2"),
        ("F[0,4] x >= 0", 0, "holds at each of the 2"),
    ):
        assert stltool("monitor", formula, tmp_path / "trace.csv", "--report", tmp_path)[0] == code
        page, data = page_of(tmp_path)
        assert data["format"] == "stltool-monitor-1"
        assert words in page
        assert ("Violated" in page) == bool(code)


def test_a_batch_of_traces_and_an_endless_formula_have_pages(stltool, tmp_path):
    import numpy as np

    np.savez(tmp_path / "batch.npz", x=np.array([[1.0, 0, 1, 1], [0, 0, 0, 0], [1, 1, 1, 1]]))
    assert stltool("monitor", "G x > 0.5", tmp_path / "batch.npz", "--end", "cut", "--report", tmp_path)[0] == 1
    page, data = page_of(tmp_path)
    assert data["words"] is None
    assert f"It holds for {data['traces'] - data['violating_traces']} of {data['traces']} traces" in page


@pytest.mark.parametrize("command", ["check", "estimate"])
def test_the_folder_is_tried_before_the_work(stltool, tmp_path, command):
    (tmp_path / "file").touch()
    code, _, err = stltool(command, PATROLLING, *SMALL, "--report", tmp_path / "file" / "below")
    assert code == 2
    assert "file" in err


def test_why_speaks_in_sentences(stltool):
    _, out, _ = stltool("why", PATROLLING, *SMALL, "-k", "1")
    assert "The most probable run that violates the task has probability 0.0466667" in out
    assert "P depends most on state (2,2): one more percentage point of success there" in out
