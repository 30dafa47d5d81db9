"""`stltool sweep` as its users meet it."""

import json
import re

import pytest

from tests.learning.test_sweep import TINY, files


@pytest.fixture
def sweep_file(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def test_a_sweep_from_start_to_report(stltool, sweep_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = stltool("sweep", sweep_file, "--workers", 1)
    assert code == 0
    assert len(re.findall("of 8 runs,", err)) == 8  # and, on a slow machine, that it goes on
    assert "sweep: 8 of 8 runs," in err
    lines = out.splitlines()
    statistics = "P median  [q1, q3]  least  greatest  published  P*  0.99 P* at  steps  regret  time"
    assert re.split(r"  +", lines[0]) == ["scenario", "method", "seeds", *statistics.split("  ")]
    assert [line.split()[:3] for line in lines[1:5]] == [[s, m, "2"] for s in "RC" for m in ("naive", "replay")]
    assert "runs    8 finished, 0 of them earlier; 0 failed" in out
    assert "report  out/tiny/report.html" in out
    folder = tmp_path / "out" / "tiny"
    assert {path.name for path in folder.iterdir()} >= {
        "report.html", "report.json", "table.csv", "curves.csv", "figure.svg", "figure.png", "runs"
    }  # fmt: skip
    code, out, err = stltool("sweep", sweep_file, "--json")  # nothing to do: no process is started
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert data == json.loads((folder / "report.json").read_text())
    page = (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    assert stltool("report", folder / "report.json")[0] == 0
    assert (folder / "report.html").read_text() == page


@pytest.mark.soak(only=True)
def test_parts_are_run_and_all_that_is_there_is_shown(stltool, sweep_file, tmp_path):
    out = tmp_path / "o"
    options = ["--workers", 1, "--out", out, "--json"]
    code, text, _ = stltool("sweep", sweep_file, "--only", "C", "--method", "naive", "--seeds", 1, *options)
    data = json.loads(text)
    assert code == 0
    assert [(r["scenario"], r["method"], r["seeds"]) for r in data["results"]] == [("C", "naive", [0])]
    data = json.loads(stltool("sweep", sweep_file, "--only", "R,C", "-m", "naive", "--seeds", "1,4", *options)[1])
    shown = [(r["scenario"], r["method"], r["seeds"]) for r in data["results"]]
    assert shown == [("R", "naive", [1, 4]), ("C", "naive", [0, 1, 4])]
    assert sorted(files(out)) == sorted(f"runs/{s}/{m}/seed-{n}.json" for s, m, seeds in shown for n in seeds)
    data = json.loads(stltool("sweep", sweep_file, "--only", "R", "--seeds", "7,", *options)[1])
    assert [(r["method"], r["seeds"]) for r in data["results"]] == [
        ("naive", [1, 7]), ("replay", [7]), ("naive", [0, 1])
    ]  # fmt: skip


@pytest.mark.soak(only=True)
def test_a_dry_run_writes_nothing(stltool, sweep_file, tmp_path):
    out = tmp_path / "o"
    code, text, _ = stltool("sweep", sweep_file, "--dry-run", "--out", out, "--workers", 2)
    assert code == 0
    assert f"to run  8 runs in {out}, 0 already finished" in text
    assert "with 2 workers" in text
    assert not out.exists()
    assert stltool("sweep", sweep_file, "--only", "R", "--workers", 1, "--out", out)[0] == 0
    data = json.loads(stltool("sweep", sweep_file, "--dry-run", "--out", out, "--json", "-w", 1)[1])
    assert (data["finished"], data["workers"]) == (4, 1)
    assert [(r["scenario"], r["method"], r["seeds"]) for r in data["runs"]] == [
        ("C", "naive", [0, 1]), ("C", "replay", [0, 1])
    ]  # fmt: skip
    assert data["seconds"] == pytest.approx(2 * sum(r["seconds_each"] for r in data["runs"]))


def test_failures_are_told_at_the_end(stltool, sweep_file, tmp_path):
    sweep_file.write_text(TINY.replace("batch = 8", "most_steps = 1"))
    code, out, err = stltool("sweep", sweep_file, "--workers", 1, "--out", tmp_path / "o")
    assert code == 2
    assert "runs    4 finished, 0 of them earlier; 4 failed" in out
    assert [line for line in err.splitlines() if line.startswith("error")] == [
        f"error: {scenario} replay, seeds 0, 1: most_steps is 1, and one episode takes 5; allow at least one"
        for scenario in "RC"
    ]
    sweep_file.write_text(TINY.replace("evaluate_every = 5", "most_steps = 1"))
    code, out, err = stltool("sweep", sweep_file, "--workers", 1, "--out", tmp_path / "none")
    assert code == 2
    assert "0 finished, 0 of them earlier; 8 failed" in out
    assert "report" not in out
    sweep_file.write_text(TINY.replace("batch = 8", "batch = 0"))
    code, out, err = stltool("sweep", sweep_file, "--workers", 1, "--out", tmp_path / "none")
    assert (code, out) == (2, "")
    assert err == f"error: {sweep_file}: [[method]] 2, settings: batch is 0; it must be an integer from 1\n"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--only", "P1"], "the sweep has no scenario 'P1'"),
        (["--only", "R,"], "--only R,: write names separated by commas"),
        (["--method", "naive-er"], "the sweep has no method 'naive-er'"),
        (["--seeds", "some"], "--seeds: 'some' is not an integer; write a number of seeds, such as 3"),
        (["--seeds", "0"], "seeds is 0"),
        (["--seeds", "1,1"], "seeds is [1, 1]"),
        (["--workers", "0"], "workers is 0"),
        (["--workers", "2", "--cluster", "tcp://h:1"], "give only one of the two"),
    ],
)
def test_bad_options_end_with_their_message(stltool, sweep_file, tmp_path, options, says):
    code, out, err = stltool("sweep", sweep_file, "--out", tmp_path / "o", *options)
    assert (code, out) == (2, "")
    assert says in err
    assert not (tmp_path / "o").exists()
