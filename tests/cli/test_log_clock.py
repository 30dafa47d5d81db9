"""The clock of a log as users of `monitor` and `verify` meet it."""

import io
import json
import sys

import numpy as np
import pytest

import stltool as stl
from stltool.errors import TraceError

LIM = 'step = 0.1s\nlim := G[0,1s] x < 5\nexpect holds(lim, trace "log.csv")\n'


@pytest.fixture
def log(tmp_path):
    """A CSV file of columns."""

    def written(name="log.csv", **columns):
        path = tmp_path / name
        rows = zip(*columns.values(), strict=True)
        path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
        return path

    return written


def spike(n=101):
    """Rows 0.01 s apart, as the issue has them: x = 9 at 0.50 s, 1 elsewhere."""
    return {"time": [f"{i / 100:.2f}" for i in range(n)], "x": [9 if i == 50 else 1 for i in range(n)]}


def test_rows_that_are_no_steps_are_refused_with_the_ways_out(stltool, log, tmp_path):
    path, task = log(**spike()), tmp_path / "task.stl"
    task.write_text(LIM)
    with pytest.raises(TraceError) as refused:
        stl.load_trace(path, ["x"], step="0.1s")
    assert str(refused.value) == (
        f"{path}, rows 1 and 2 (lines 2 and 3): in column time they are 0.01s apart; the step is 0.1s (and 99 more "
        'rows); resample="hold" or resample="linear" puts the signals on the step\'s grid, time="none" takes rows as '
        "steps"
    )
    for command in (["monitor", task, path], ["monitor", "G[0,1s] x < 5", path, "--step", "0.1s"]):
        code, out, err = stltool(*command)
        assert (code, out) == (2, "")
        assert "--resample hold or --resample linear puts the signals on the step's grid, --time none takes" in err
        assert stltool(*command, "--resample", "hold", "--at", 0)[0] == 1
        assert stltool(*command, "--resample", "linear", "--at", 0)[0] == 1
        assert stltool(*command, "--time", "none", "--at", 0)[0] == 0  # 11 rows see no spike: asked for
    code, out, err = stltool("verify", task)
    assert code == 2
    assert "rows 1 and 2 (lines 2 and 3): in column time they are 0.01s apart; the step is 0.1s" in err
    assert stltool("verify", task, "--resample", "hold")[0] == 1


@pytest.mark.soak(only=True)
def test_what_was_done_is_told_and_times_stand_beside_steps(stltool, log, tmp_path):
    path = log(t=[0, 0.1, 0.2, 0.3, 0.5], x=[1, 1, -1, -2, 4])
    code, out, _ = stltool("monitor", "G[0,0.1s] x > 0", path, "--step", "0.1s", "--resample", "hold")
    assert code == 1
    assert out.splitlines() == [
        "task        G[0,1] (x > 0)",
        f"trace       {path}, 6 samples",
        "clock       column t, on steps of 0.1s (hold): 6 steps of 5 rows; the longest gap is 0.2s, after row 4 (line "
        "5)",
        "horizon     1 (0.1 s)",
        "judged      5 steps, 0 … 4 (0 s … 0.4 s)",
        "step 0      holds",
        "violated    at 4 of 5 steps, first at step 1 (0.1 s)",
        "robustness  -2 at step 2 (0.2 s), the least",
        "",
        "violated     time           steps  least robustness  at step",
        "steps 1 … 4  0.1 s … 0.4 s  4      -2                2",
    ]
    _, out, _ = stltool(
        "monitor", "G[0,0.1s] x > 0", path, "--step", "100ms", "--unit", "ms", "--time", "none", "--steps"
    )
    assert "clock       rows are steps of 0.1s\n" in out
    assert out.split("\n\n")[-1].splitlines()[:3] == [
        "step  time      verdict   robustness", "0     0 ms      holds     1", "1     100 ms    violated  -1",
    ]  # fmt: skip
    assert "clock       rows are steps; the column t is not used\n" in stltool("monitor", "x > 0", path)[1]
    uniform = log("u.csv", time=[0, 0.1, 0.2], x=[1, 1, -1])
    picture, folder = tmp_path / "t.svg", tmp_path / "report"
    _, out, _ = stltool("monitor", "x > 0", uniform, "--step", "0.1s", "--json", "--plot", picture, "--report", folder)
    data = json.loads(out)
    assert (data["unit"], data["step"], data["clock"]) == ("s", 0.1, "column time, every 0.1s")
    assert (data["first_violation"], data["first_violation_time"], data["least_robustness_time"]) == (2, 0.2, 0.2)
    assert "time [s]" in picture.read_text()
    assert "first at step 2 (0.2 s)" in (folder / "report.html").read_text()


def test_several_files_are_judged_as_a_batch(stltool, log, tmp_path, monkeypatch):
    """Each on its own clock; traces may differ in length, and rows are named by their files."""
    monkeypatch.chdir(tmp_path)
    log("a.csv", t=[0, 0.1, 0.2], x=[1, 2, 3])
    log("b.csv", t=[5, 5.1, 5.2, 5.3], x=[1, -1, 2, -3])
    np.savez("c.npz", x=np.array([[1.0, 1], [1, -9]]))
    options = ["--step", "0.1s"]
    code, out, err = stltool("monitor", "x > 0", "a.csv", "b.csv", "c.npz", *options)
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        "task        x > 0",
        "trace       3 files, 4 traces of 2 to 4 samples",
        "clock       differs from file to file; --json has it for each",
        "horizon     0",
        "judged      4 steps, 0 … 3 (0 s … 0.3 s) at most, 2 steps at least",
        "holds       for 2 of 4 traces at every step",
        "violated    at 3 of 11 steps",
        "robustness  -9 at step 1 (0.1 s), the least",
        "",
        "trace           step 0  violated at  first      least robustness  at step",
        "a.csv           holds   0 steps      –          1                 0",
        "b.csv           holds   2 steps      1 (0.1 s)  -3                3",
        "c.npz, trace 0  holds   0 steps      –          1                 0",
        "c.npz, trace 1  holds   1 step       1 (0.1 s)  -9                1",
    ]
    data = json.loads(stltool("monitor", "x > 0", "a.csv", "b.csv", "c.npz", *options, "--json")[1])
    assert [one["file"] for one in data["each"]] == ["a.csv", "b.csv", "c.npz, trace 0", "c.npz, trace 1"]
    assert [one["samples_there"] for one in data["each"]] == [3, 4, 2, 2]
    assert data["each"][1]["clock_there"] == "column t, every 0.1s"
    assert (data["traces"], data["violating_traces"], data["violations"]) == (4, 2, 3)
    assert data["verdicts"] == [[True] * 3, [True, False, True, False], [True, True], [True, False]]
    out = stltool("monitor", "x > 0", "a.csv", "b.csv", *options, "--steps")[1]
    assert "\nb.csv:\nstep  time" in out
    out = stltool("monitor", "x > 0", "b.csv", "c.npz", *options, "--steps", "--trace", 2, "--plot", "p.svg")[1]
    assert "\nc.npz, trace 1:\nstep  time" in out
    assert out.endswith("plot  p.svg, c.npz, trace 1\n")
    stltool("monitor", "x > 0", "a.csv", "b.csv", *options, "--report", "page")
    assert "b.csv" in (tmp_path / "page" / "report.html").read_text()
    assert stltool("monitor", "x > -99", "a.csv", "b.csv")[0] == 0
    code, out, err = stltool("monitor", "G[0,2] x > 0", "a.csv", "c.npz")
    assert (code, out) == (2, "")
    assert "error: c.npz: the traces have 2 samples; this formula needs 3" in err
    code, out, err = stltool("monitor", "x > 0", "a.csv", "none.csv")
    assert (code, out) == (2, "")
    assert "none.csv: there is no such trace file" in err
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"x\n1\n-1\n")))
    out = stltool("monitor", "x > 0", "-")[1]
    assert out.splitlines()[1] == "trace       standard input, 2 samples"
