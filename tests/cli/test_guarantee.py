"""`stltool run` tells what is guaranteed from data beside the exact value; reports show it."""

import html
import importlib
import json
import re
import sys

import numpy as np
import pytest

import stltool as stl
from stltool import cli
from stltool.errors import SettingsError
from stltool.learning.counts import Counts
from stltool.reporting import guarantee_data, guarantee_rows, load_report, render, report_data
from tests.conftest import FACTORY

TASK = str(FACTORY / "patrolling.stl")
SMALL = ("-p", "T=3", "-p", "tau=3", "-e", "150")


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """`stltool run` of a small task in this process: (exit code, stdout, stderr)."""

    def command(*args):
        monkeypatch.setattr(sys, "argv", ["stltool", "run", TASK, *SMALL, "-o", str(tmp_path / "out"), *args])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        output = capsys.readouterr()
        assert "Traceback" not in output.err
        return ended.value.code or 0, output.out, output.err

    return command


def test_run_prints_guarantees_beside_the_exact_value(run, tmp_path):
    out = tmp_path / "out"
    code, text, _ = run("--rollouts", "500", "--confidence", "0.9")
    assert code == 0
    data = load_report(out / "report.json")
    unknown, known, tied, runs, best = data["guarantees"]
    exact = data["checks"][1]
    assert (unknown["support"], known["support"], runs["runs"]) == ("unknown", "known", 500)
    assert unknown["transitions"] == known["transitions"] == data["training"]["environment_steps"]
    assert 0 <= unknown["lower"] <= known["lower"] <= tied["lower"] <= exact["upper"]
    (success,) = tied["parameters"]
    assert success["lower"] <= 0.93 <= success["upper"]
    assert best["source"] == "best of both"
    assert (best["runs"], best["transitions"]) == (500, tied["transitions"])
    assert max(tied["lower"], runs["lower"]) >= best["lower"] >= min(tied["lower"], runs["lower"])
    assert {row["confidence"] for row in data["guarantees"]} == {0.9}
    page = html.unescape((out / "report.html").read_text(encoding="utf-8"))
    assert "<h2>Guarantees</h2>" in page
    for row in guarantee_rows(data["guarantees"], data["checks"]):
        assert re.search(r"\s{2,}".join(map(re.escape, row.values())), text)
        assert f'<td class="number">{row["P_at_least"]}</td><td class="number">{row["confidence"]}</td>' in page
    assert [row["confidence"] for row in guarantee_rows(data["guarantees"], data["checks"])] == ["certain"] + [
        "90 %"
    ] * 5


def test_the_bounds_are_those_of_the_functions(run):
    found = json.loads(run("--seed", "4", "--rollouts", "300", "--json")[1])["guarantees"]
    assert found[3]["seed"] == 4
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"),
                                stl.load_task(TASK, params={"T": 3, "tau": 3}))  # fmt: skip
    training = stl.learn(product, "cfer", episodes=150, seed=4)
    runs = stl.estimate(product, training.policy, runs=300, side="lower", seed=4)
    assert (runs.lower, runs.satisfied) == (found[3]["lower"], found[3]["satisfied"])
    for row, support in zip(found, ("unknown", "known"), strict=False):
        bound = stl.guarantee(product, training.policy, training.counts, support=support)
        assert (bound.lower, bound.statement) == (row["lower"], row["statement"])
    tied = {"parameters": "model"}
    for row, how in ((found[2], tied), (found[4], {**tied, "fresh": runs})):
        bound = stl.guarantee(product, training.policy, training.counts, **how)
        assert (bound.lower, bound.statement) == (row["lower"], row["statement"])


def test_without_rollouts_the_data_alone_tells(run):
    code, text, _ = run("--rollouts", "0", "--json")
    assert code == 0
    assert [row["source"] for row in json.loads(text)["guarantees"]] == ["learning data"] * 3


def test_a_split_learns_in_a_share_of_the_episodes_and_judges_by_the_others(run):
    data = json.loads(run("--split", "0.2", "--json")[1])
    assert data["training"]["history"][-1]["episode"] == 30
    assert data["guarantees"][3]["runs"] == 120


def test_a_tie_that_the_data_contradict_is_refused(run, monkeypatch):
    """Where the moves of one cell succeed less often, in a simulator of its own."""
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    start = int(np.flatnonzero(model.initial)[0])
    worse, probability = model.at(success="1/3"), model.probability.copy()
    a, b = model.row_start[model.choice_start[start : start + 2]]
    probability[a:b] = worse.probability[a:b]
    strange = model.with_rows(probability=probability, exact=None)
    object.__setattr__(strange.source, "_family", model.family.source)  # it claims to be tied
    monkeypatch.setattr("stltool.load_model", lambda *given, **reading: strange)
    code, text, err = run("--rollouts", "100", "--method", "cfer", "-e", "600")
    assert code == 0
    assert "warning: the data contradict the assumption that the same success holds in every row" in err
    assert re.search(r"learning data, \d+ transitions  refused +99 % +one parameter for all rows", text)
    assert "best of both" not in text


def test_a_bound_that_is_looser_says_so(run, monkeypatch, tmp_path):
    """Where a polynomial takes too long; on the terminal, in the data and on the page."""
    monkeypatch.setattr(importlib.import_module("stltool.learning.guarantee"), "_MOST_WORK", 1.0)
    code, text, _ = run("--rollouts", "100", "--until-gap", "0.5")
    assert code == 0
    data = load_report(tmp_path / "out" / "report.json")
    looser = [row.get("looser") for row in data["guarantees"]]
    assert looser[:2] == [None, None]
    assert looser[3] is None
    assert looser[2] == looser[4]
    assert looser[2].startswith("bounded row by row, as if each row had a value of success of its own, since its poly")
    assert looser[2] in data["guarantees"][2]["statement"]
    transitions = data["training"]["environment_steps"]
    assert f"learning data, {transitions} transitions; looser, see below" in text
    assert re.search(r"^looser +bounded row by row.*more than 1$", text, flags=re.MULTILINE)
    of_gap = data["training"]["gap"]["looser"]
    assert of_gap.startswith("bounded row by row, as if each row had a value of success of its own")
    assert text.count("bounded row by row") == 2  # of the gap, and below the table, there once
    page = html.unescape((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert f"Looser than what it assumes allows: {looser[2]}." in page
    assert f"{of_gap}.</p>" in page[page.index("<b>Certified</b>") :]


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--confidence", "1", "confidence is 1.0"),
        ("--confidence", "-0.5", "confidence is -0.5"),
        ("--rollouts", "-3", "--rollouts is -3"),
        ("--split", "1.5", "--split 1.5: of 150 episodes, it leaves none"),
        ("--split", "0", "--split 0: of 150 episodes, it leaves none"),
    ],
)
def test_bad_options_are_told_before_the_work(run, tmp_path, option, value, says):
    code, out, err = run(option, value)
    assert (code, out) == (2, "")
    assert says in err
    assert not (tmp_path / "out").exists()


def test_reports_take_guarantees_as_found_and_do_without(patrolling):
    best = stl.check(patrolling)
    mine = stl.check(patrolling, best.policy)
    runs = stl.estimate(patrolling, best.policy, runs=100, side="lower")
    counts = Counts(patrolling.model.n_choices, patrolling.model.n_states)
    nothing = stl.guarantee(patrolling, best.policy, counts)
    data = report_data([best, mine], guarantees=[nothing, guarantee_data(runs)])
    assert [row["lower"] for row in data["guarantees"]] == [0.0, runs.lower]
    rows = guarantee_rows(data["guarantees"], data["checks"])
    assert [row["guaranteed_by"] for row in rows] == ["exact check", "learning data, 0 transitions",
                                                      "fresh runs, 100 runs"]  # fmt: skip
    assert float(rows[0]["P_at_least"]) <= best.lower < float(rows[0]["P_at_least"]) + 1e-5
    assert "<h2>Guarantees</h2>" in render(data)
    assert "<h2>Guarantees</h2>" not in render(report_data([best]))
    del data["guarantees"]  # as earlier versions wrote it
    assert "<h2>Guarantees</h2>" not in render(data)
    with pytest.raises(SettingsError, match='side="upper" gives no lower bound'):
        report_data([best], guarantees=[stl.estimate(patrolling, best.policy, runs=100, side="upper")])
    assert guarantee_rows([]) == []
