"""Sweeps' tables and curves, against slow and obvious twins."""

import csv
import dataclasses
import json
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.encodings import story_of
from stltool.errors import FileError
from stltool.learning.sweep import Failure, RunResult
from stltool.reporting import load_report, render, sweep_data, write_history, write_sweep
from stltool.reporting.curves import quartile_curves
from stltool.reporting.sweeps import failure_text, regret, result_rows
from tests.conftest import FACTORY

SWEEP = f"""
[sweep]
name = "made-up"
seeds = 3
settings = {{ episodes = 10 }}
columns = 3
[[method]]
name = "naive"
[[method]]
id = "cf"
name = "cfer"
faithful = true
settings = {{ batch = 8 }}
[[scenario]]
id = "R"
task = "{FACTORY}/reaching.stl"
params = {{ T = 2, tau = 3 }}
published = {{ cf = 0.25 }}
[[scenario]]
id = "C"
task = "{FACTORY}/charging.stl"
[[scenario]]
id = "unfinished"
task = "{FACTORY}/charging.stl"
"""


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "made-up.toml"
    path.write_text(SWEEP)
    return stl.load_sweep(path)


def run(scenario, method, seed, probability, seconds=1.0):
    steps = [10 * (i + 1) for i in range(len(probability))]
    return RunResult(scenario, method, seed, [s // 5 for s in steps], steps, probability, "0" * 64, seconds)


@pytest.fixture(scope="module")
def result(sweep):
    optimum = stl.check(sweep.scenarios[0].product).probability
    runs = [
        run("R", "naive", 0, [0.0, 0.0, 0.0], 3.0),
        run("R", "naive", 1, [0.0, 0.1, 0.2], 1.0),
        run("R", "naive", 2, [0.5, 0.3, 0.1], 2.0),
        run("R", "cf", 0, [0.0, 0.99 * optimum, optimum]),
        run("R", "cf", 2, [0.0, optimum]),  # stopped early
        run("C", "cf", 1, [0.25, 0.125]),
    ]
    failures = [Failure("C", "naive", seed, "no good") for seed in (0, 2)] + [Failure("C", "naive", 1, "<worse>")]
    return stl.SweepResult(sweep, runs, failures, 0)


@pytest.fixture(scope="module")
def written(result, tmp_path_factory):
    """The folder of its report."""
    folder = tmp_path_factory.mktemp("written")
    write_sweep(sweep_data(result), folder)
    return folder


def quantile(values, share):
    """Between the two nearest of the sorted values, in fractions."""
    values = sorted(map(Fraction, values))
    place = Fraction(share) * (len(values) - 1)
    low = int(place)
    high = min(low + 1, len(values) - 1)
    return values[low] + (place - low) * (values[high] - values[low])


PROBABILITIES = st.lists(st.floats(0, 1), min_size=1, max_size=6)


@given(st.lists(st.tuples(PROBABILITIES, st.integers(1, 3)), min_size=1, max_size=5))
def test_quartiles_are_of_what_each_seed_had_at_that_step(drawn):
    curves = [([every * (i + 1) for i in range(len(values))], values) for values, every in drawn]
    found = quartile_curves(curves)
    first = max(at[0] for at, _ in curves)
    assert found["steps"] == sorted({step for at, _ in curves for step in at if step >= first})
    for i, step in enumerate(found["steps"]):
        values = []
        for at, probability in curves:
            values.append([p for s, p in zip(at, probability, strict=True) if s <= step][-1])
        for name, share in (("q1", "1/4"), ("median", "1/2"), ("q3", "3/4")):
            assert found[name][i] == pytest.approx(float(quantile(values, share)), abs=1e-15)


def test_the_table_tells_what_was_found(result):
    data = sweep_data(result, command="stltool sweep made-up.toml")
    assert [s["id"] for s in data["scenarios"]] == ["R", "C"]  # what has no run is not shown
    optimum = data["scenarios"][0]["optimum"]
    assert optimum == stl.check(result.sweep.scenarios[0].product).probability
    assert 0.1 < optimum < 1
    naive, cfer, charging = data["results"]
    assert (naive["scenario"], naive["method"], naive["seeds"], naive["published"]) == ("R", "naive", [0, 1, 2], None)
    assert (naive["median"], naive["q1"], naive["q3"]) == pytest.approx((0.1, 0.05, 0.15))
    assert (naive["least"], naive["greatest"], naive["near_optimum_at"]) == (0, 0.2, None)
    assert (naive["environment_steps"], naive["seconds"]) == (30, 2)
    # evaluated after episodes 2, 4, 6: the seeds' P sum to 0, 0 + 0 + .05 + .1 + .15 + .2, .25 + .5 + .4 + .3 + .2 + .1
    assert naive["regret"] == pytest.approx(6 * optimum - 0.5)
    assert (cfer["seeds"], cfer["published"], cfer["near_optimum_at"]) == ([0, 2], 0.25, 20)
    assert cfer["median"] == pytest.approx(optimum)
    assert charging["near_optimum_at"] is None
    assert data["runs"] == {"finished": 6, "failed": 3, "all": 18}
    rows = result_rows(data)
    assert rows[0]["P median"] == "0.1000"
    assert rows[0]["[q1, q3]"] == "[0.0500, 0.1500]"
    assert (rows[0]["least"], rows[0]["greatest"]) == ("0.0000", "0.2000")
    assert [row["published"] for row in rows] == ["", "0.2500", ""]
    assert [row["0.99 P* at"] for row in rows] == ["–", "20", "–"]
    assert rows[0]["regret"] == f"{6 * optimum - 0.5:.4g}"
    assert rows[2]["P*"] == "0.9999"  # below 1, never 1
    assert all("published" not in row for row in result_rows({**data, "results": [naive]}))
    assert [failure_text(failure) for failure in data["failures"]] == [
        "C naive, seeds 0, 2: no good", "C naive, seed 1: <worse>"
    ]  # fmt: skip


def test_the_page_has_it_all_and_is_made_again_from_its_json(result, tmp_path):
    sections = [
        {"title": "Encodings", "text": "Sizes & such.", "rows": [{"scenario": "R", "flags": "6"}]},
        {
            "title": "A picture",
            "figure": {"x": "share of it", "y": "P", "lines": [{"name": "mine", "x": [0, 1], "y": [0, 1]}]},
        },
    ]
    data = sweep_data(result, command="stltool sweep <made-up>.toml", sections=sections)
    paths = write_sweep(data, tmp_path / "out")
    assert [path.name for path in paths] == [
        "report.html", "report.json", "table.csv", "curves.csv", "figure.svg", "figure.png"
    ]  # fmt: skip
    page = paths[0].read_text(encoding="utf-8")
    for text in (
        "<h1>made-up</h1>", "6 of 18 runs finished, 3 failed", "C naive, seed 1: &lt;worse&gt;", "<h2>Encodings</h2>",
        "Sizes &amp; such.", '<td class="number">6</td>', ">share of it</text>", "stltool sweep &lt;made-up&gt;.toml",
        "R: reaching, floor-5x5, T = 2, tau = 3", "<th>0.99 P* at</th>", "<th>cf</th><td>cfer, as published, batch = 8",
    ):  # fmt: skip
        assert text in page, text
    assert load_report(paths[1]) == json.loads(json.dumps(data))
    assert render(load_report(paths[1])) == page
    (tmp_path / "half.json").write_text(json.dumps({**data, "scenarios": None}))
    with pytest.raises(FileError, match="not the JSON file of a report"):
        load_report(tmp_path / "half.json")


def test_the_story_is_told_where_it_is_asked_for(result, tmp_path):
    assert sweep_data(result)["sections"] == []
    (tmp_path / "until.stl").write_text(f'model "{FACTORY}/floor-5x5.toml"\nphi := A U[0,3] B\n')  # has no flags
    path = tmp_path / "story.toml"
    path.write_text(SWEEP.replace("columns = 3", "story = true").replace(f"{FACTORY}/charging.stl", "until.stl", 1))
    sweep = stl.load_sweep(path)
    mine = [{"title": "mine"}]
    stories = [story_of(scenario.id, scenario.product) for scenario in sweep.scenarios]
    assert [story is None for story in stories] == [False, True, False]
    data = sweep_data(stl.SweepResult(sweep, result.runs, [], 0), sections=mine, stories=stories[:1])
    gap, sizes, own = data["sections"]
    assert (gap["title"], sizes["title"], own["title"]) == ("The surrogate's gap", "Flags against histories", "mine")
    assert [row["scenario"] for row in gap["rows"]] == [row["scenario"] for row in sizes["rows"]] == ["R"]
    assert sizes["rows"][0]["|Σ|^τ"] == str(18**3)
    assert sizes["rows"][0]["× flags"] == str(18 * 4)
    page = render(data)
    assert f'<td class="number">{18**3}</td>' in page
    until = stl.SweepResult(sweep, result.runs[-1:], [], 0)
    assert sweep_data(until, stories=stories[:1])["sections"] == []  # of a scenario without runs


def test_a_sweep_without_any_result_has_a_page_too(sweep):
    page = render(sweep_data(stl.SweepResult(sweep, [], [Failure("R", "naive", 0, "no good")], 0)))
    assert "0 of 18 runs finished, 1 failed" in page
    assert "<svg" not in page


def test_regret_is_summed_over_episodes():
    assert regret([1, 2, 3], [0.1, 0.5, 0.75], 0.75) == pytest.approx(0.65 + 0.25 + 0)  # every episode evaluated
    assert regret([2, 4], [0.2, 0.4], 0.5) == pytest.approx(0.4 + 0.3 + 0.2 + 0.1)  # linear between, from 0


def test_tables_and_curves_as_csv(result, written):
    data = sweep_data(result)
    with open(written / "table.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [(row["scenario"], row["method"], row["seeds"]) for row in table] == [
        ("R", "naive", "3"), ("R", "cf", "2"), ("C", "cf", "1")
    ]  # fmt: skip
    assert float(table[1]["optimum"]) == data["scenarios"][0]["optimum"]
    assert [float(row["regret"]) for row in table] == [found["regret"] for found in data["results"]]
    assert (table[0]["published"], table[1]["published"]) == ("", "0.25")
    with open(written / "curves.csv", newline="") as file:
        curves = list(csv.DictReader(file))
    wanted = [
        (r.scenario, r.method, str(r.seed), str(e), str(s), repr(p))
        for r in result.runs for e, s, p in zip(r.episode, r.steps, r.probability, strict=True)
    ]  # fmt: skip
    assert [tuple(row.values()) for row in curves] == wanted


def test_the_figure_has_a_panel_a_scenario(written):
    svg = (written / "figure.svg").read_text()
    assert svg.startswith("<svg")
    for text in ("R: reaching", "C: charging", "naive", ">cf<", "optimum", "environment steps"):
        assert text in svg
    assert "unfinished" not in svg
    assert (written / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_runs_that_take_longer_change_wall_times_and_no_other_byte(sweep, result, written, tmp_path):
    """What docs/sweeps.md says of interrupted sweeps: which files are the same bytes, how others differ."""
    slower = [dataclasses.replace(run, seconds=10 * run.seconds) for run in result.runs]
    write_sweep(sweep_data(stl.SweepResult(sweep, slower, result.failures, 0)), tmp_path)
    first, again = ({p.name: p.read_bytes() for p in folder.iterdir()} for folder in (written, tmp_path))
    differ = {name for name in first if first[name] != again[name]}
    assert first.keys() == again.keys()
    assert differ == {"table.csv", "report.html", "report.json"}
    data = [json.loads(files["report.json"]) for files in (first, again)]
    seconds = [[row.pop("seconds") for row in one["results"]] for one in data]
    assert seconds[1] == [10 * s for s in seconds[0]]
    assert data[0] == data[1]


def test_a_history_as_csv_reads_back(patrolling, tmp_path):
    training = stl.learn(patrolling, "cfer", episodes=7, evaluate_every=3, seed=1)
    write_history(training, tmp_path / "history.csv")
    with (tmp_path / "history.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["episode"]), int(row["steps"]), float(row["probability"])) for row in rows] == [
        (p.episode, p.steps, p.probability) for p in training.history
    ]
    assert len(rows) == 3
    for row in rows:  # each says what run it is of
        assert (row["method"], row["faithful"], row["seed"]) == ("cfer", "False", "1")
        used = {"episodes": 7, "evaluate_every": 3, "most_steps": None, "stop_gap": None, **training.settings}
        assert json.loads(row["settings"]) == used
