"""`stltool monitor --follow`: verdicts while the log is being written."""

import io
import json
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import stltool as stl

LOG = "# a log\nx,a,note\n1,true,ok\n2,1,\n-1,0,low\n3,1,\n"


@pytest.fixture
def typed(monkeypatch):
    def type_in(text):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))

    return type_in


def test_violations_are_printed_once_certain(stltool, typed):
    typed(LOG)
    code, out, err = stltool("monitor", "G[0,1000] x > 0", "-", "--follow")
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        *(f"step {t}  violated, certain at step 2" for t in range(3)),
        "read      4 samples of standard input",
        "decided   3 steps; the verdicts of 1 depend on what comes",
        "violated  at 3 of them, first at step 0",
    ]


def test_one_step_ends_the_reading(stltool, typed):
    typed(LOG + "not a number,0,\n")
    assert stltool("monitor", "F[0,3] x < 0", "-", "--follow", "--at", "0")[:2] == (
        0, "step 0  holds, certain at step 2\n",
    )  # fmt: skip


def test_a_file_and_the_end_of_the_trace(stltool, tmp_path):
    rng = np.random.default_rng(0)
    x = rng.random(30).round(3)
    path = tmp_path / "log.csv"
    path.write_text("x;y\n" + "".join(f"{value};0\n" for value in x))
    for end in ("error", "cut", "hold"):
        code, out, _ = stltool("monitor", "G[0,4] F[0,2] x > 0.5", path, "--follow", "--steps", "--end", end)
        found = [line.split() for line in out.splitlines() if line.startswith("step")]
        verdicts = {int(words[1]): words[2] == "holds," for words in found}
        result = stl.monitor(stl.parse("G[0,4] F[0,2] x > 0.5"), {"x": x}, end)
        assert [verdicts[t] for t in range(24)] == result.verdicts[:24].tolist()
        assert len(verdicts) == 30 or end == "error"
        assert code == (not all(verdicts.values()))


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("x,y\n1,1\n", [], "standard input: there is no column a; "),
        ("x,a\n1,1\n2,\n", [], "standard input, line 3, column a: an empty cell; every step needs a value"),
        ("x,a\n1,1\n2\n", [], "standard input, line 3: 1 cell where the header names 2 columns"),
        ("x,a\n1,1\n\n2,1\n", [], "standard input, line 3: an empty line between rows; remove it, or write a row"),
        ("x,a\n1,1\nmany,1\n", [], "standard input, line 3, column x: 'many' is not a number"),
        ("x,a\n1,1\n", ["--at", "0"], "--at 0: not decided by the 1 sample of standard input"),
        ("x,a\n1,1\n", ["--resample", "hold"], "--follow prints verdicts as they come; --resample needs"),
        ("x,a\n1,1\n", ["--time", "x"], "--time x: the duration of a step is not declared"),
        ("x,a,x\n1,1,5\n", [], "standard input, line 1: two columns are named x; every column needs a name of its own"),
        ("", [], "the file is empty"),
    ],
)
def test_what_cannot_be_followed(stltool, typed, text, options, says):
    typed(text)
    code, _, err = stltool("monitor", "G[0,3] (x > 0 & a)", "-", "--follow", *options)
    assert code == 2
    assert says in err


def test_intervals_without_an_end_are_not_followed(stltool, typed):
    for end in ("error", "cut", "hold"):
        typed(LOG)
        code, out, err = stltool("monitor", "G x > 0", "-", "--follow", "--end", end)
        assert (code, out) == (2, "")
        assert "G[0,inf) (x > 0): --follow needs intervals with an end, such as G[0,10]; leave out --follow" in err


def test_times_are_held_against_the_step(stltool, typed):
    typed("t [ms],x\n0,1\n100,1\n200.5,-1\n300,3\n")
    code, out, err = stltool("monitor", "G[0,1s] x > 0", "-", "--follow", "--step", "0.1s")
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        *(f"step {t} ({t / 10:g} s)  violated, certain at step 2 (0.2 s)" for t in range(3)),
        "read      4 samples of standard input",
        "clock     column t [ms], every 0.1s",
        "decided   3 steps; the verdicts of 1 depend on what comes",
        "violated  at 3 of them, first at step 0 (0 s)",
    ]


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("0,1\n0.1,-1\n0.3,1\n0.4,1\n", "rows 2 and 3 (lines 3 and 4): in column t they are 0.2s apart; the step is"),
        ("0,1\n0.1,-1\n0.05,1\n", "rows 2 and 3 (lines 3 and 4): column t goes from 0.1s to 0.05s; times must"),
        ("0,1\n0.1,-1\n0.1,1\n", "column t goes from 0.1s to 0.1s; times must increase from row to row"),
        # each row is near enough to the one before, but not to the grid
        ("0,1\n0.1,-1\n0.2009,1\n0.3016,1\n", "row 4 (line 5): in column t it is 0.016 of a step away from step 3"),
        ("0,1\n0.1,-1\n100,1\n", "they are 99.9s apart; the step is 0.1s; --time none takes rows as steps; without"),
        ("0,1\n100,-1\n", '(if the column is in ms, give --time "t [ms]")'),
        ("0,1\n0.1,-1\n,1\n", "line 4, column t: an empty cell; every row needs a time"),
        ("0,1\n0.1,-1\nsoon,1\n", "line 4, column t: 'soon' is not a time; write seconds, or dates"),
        ("2026-03-01T00:00:00Z,1\n2026-03-01T00:00:00.1Z,-1\n2026-03-01T00:00:00.25Z,1\n", "0.15s apart; the step is"),
        ("2026-03-01T00:00:00Z,1\n2026-03-01T00:00:00.1Z,-1\n2026-03-01T00:00:00.2,1\n", "names no time zone, unlike"),
    ],
)  # fmt: skip
def test_a_row_that_is_not_the_next_step(stltool, typed, rows, says):
    """The violation of the second row is told before, if its time is as it should be."""
    typed(f"t,x\n{rows}")
    code, out, err = stltool("monitor", "x > 0", "-", "--follow", "--step", "0.1s")
    assert code == 2
    assert says in err
    early = "in ms" in says
    assert out == ("" if early else "step 1 (0.1 s)  violated, certain at step 1 (0.1 s)\n")
    typed(f"t,x\n{rows}")
    whole = stltool("monitor", "x > 0", "-", "--step", "0.1s")[2]
    assert whole.split("; --")[0].split(" (and ")[0].strip() in err  # the same fault


@pytest.mark.parametrize(
    ("options", "clock", "code"),
    [
        (["--step", "0.1s", "--time", "none"], "rows are steps of 0.1s", 0),
        (["--step", "0.1s", "--tolerance", "0.4"], "column t, every 0.1s", 0),
        (["--step", "0.1s", "--tolerance", "0.01"], None, 2),
        (["--step", "0.1s", "--time", "u"], "column u, every 0.1s", 0),
        (["--step", "0.1s", "--time", "u [s]"], "column u, every 0.1s", 0),
        ([], "rows are steps; the column t is not used", 0),
        (["--time", "none"], None, 0),
    ],
)
def test_which_times_are_used(stltool, typed, options, clock, code):
    text = "t,u,x\n0,5,1\n0.1,5.1,1\n0.23,5.2,1\n"
    for more in ([], ["--follow"]):
        typed(text)
        found, out, _ = stltool("monitor", "x > 0", "-", *options, *more)
        assert found == code
        said = [line.split(maxsplit=1)[1] for line in out.splitlines() if line.startswith("clock")]
        assert said == ([clock] if clock is not None else [])


def test_a_log_without_times_has_rows_of_a_step_each(stltool, typed):
    typed("x\n1\n1\n")
    assert (
        "clock     rows are steps of 0.1s; there is no column of times\n"
        in (stltool("monitor", "x > 0", "-", "--follow", "--step", "0.1s")[1])
    )


def test_json_is_one_object_at_the_end(stltool, typed):
    typed(LOG)
    code, out, err = stltool("monitor", "G[0,2] x > 0", "-", "--follow", "--json", "--end", "cut")
    assert (code, err, out.count("\n")) == (1, "", 1)
    data = json.loads(out)
    assert [(one["step"], one["verdict"], one["certain_at"]) for one in data["decisions"]] == [
        (0, False, 2), (1, False, 2), (2, False, 2), (3, True, None),
    ]  # fmt: skip
    assert [data[key] for key in ("samples", "decided", "violations", "first_violation", "holds", "clock")] == [
        4, 4, 3, 0, False, None,
    ]  # fmt: skip


def test_json_of_a_declared_step_has_times(stltool, typed):
    typed("t [ms],x\n0,1\n100,-1\n")
    data = json.loads(stltool("monitor", "x > 0", "-", "--follow", "--json", "--step", "0.1s", "--at", "1")[1])
    assert data["decisions"] == [{"step": 1, "time": 0.1, "verdict": False, "certain_at": 1, "certain_at_time": 0.1}]
    assert (data["unit"], data["step"], data["clock"]) == ("s", 0.1, "column t [ms], every 0.1s")


def test_other_files_cannot_be_followed(stltool, tmp_path):
    assert "--follow reads CSV line by line" in stltool("monitor", "x > 0", tmp_path / "log.npz", "--follow")[2]
    assert "no such trace file" in stltool("monitor", "x > 0", tmp_path / "log.csv", "--follow")[2]
    (tmp_path / "folder.csv").mkdir()
    assert "it is not a regular file" in stltool("monitor", "x > 0", tmp_path / "folder.csv", "--follow")[2]


def test_a_verdict_comes_while_the_log_is_still_open():
    command = [sys.executable, "-m", "stltool", "monitor", "G[0,1000] x > 0", "-", "--follow"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ) as running:
        assert running.stdin is not None
        assert running.stdout is not None
        running.stdin.write("x\n1\n-1\n")
        running.stdin.flush()
        assert running.stdout.readline() == "step 0  violated, certain at step 1\n"
        running.stdin.close()
        assert running.wait() == 1
