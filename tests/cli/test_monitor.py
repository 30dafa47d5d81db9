"""`stltool monitor` as its users meet it."""

import json
import os
import re

import numpy as np
import pytest

from stltool.monitoring.logs import Reading
from stltool.reporting import terminal
from tests.conftest import ROOT

DUTY = ROOT / "examples" / "monitor" / "duty.stl"
SHIFT = ROOT / "examples" / "monitor" / "shift.csv"
KEYS = [
    "task", "formula", "trace", "traces", "samples", "horizon", "end", "at", "unit", "step", "clock", "judged",
    "verdict", "holds", "violations", "first_violation", "first_violation_time", "least_robustness",
    "least_robustness_at", "least_robustness_time", "verdicts", "robustness",
]  # fmt: skip


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("when,x,door\nMon,1,true\nTue,-1,true\nWed,-2,false\nThu,-3,false\nFri,4,true\n")
    return path


@pytest.fixture
def batch(tmp_path):
    path = tmp_path / "batch.npz"
    np.savez(path, x=np.array([[1.0, 2, 3], [1, -1, -2], [-1, 1, 1]]))
    return path


def test_a_task_file_on_a_log(stltool):
    code, out, err = stltool("monitor", DUTY, SHIFT)
    assert (code, err) == (1, "")
    lines = out.splitlines()
    assert lines[0].startswith("task        duty := battery > 0.1 & (battery < 0.3 -> (F[0,12] docked)) & ")
    assert lines[2:7] == [
        "horizon     45",
        "judged      206 steps, 0 … 205",
        "step 0      holds",
        "violated    at 19 of 206 steps, first at step 132",
        "robustness  -0.339 at step 142, the least",
    ]
    assert lines[8].split() == ["violated", "steps", "least", "robustness", "at", "step"]
    assert lines[9:] == [
        "steps 132 … 148  17     -0.339            142",
        "steps 160 … 161  2      -0.009            160",
    ]
    for late, violated in ((20, 1), (21, 0)):  # the battery is low at step 140, the robot in the dock at 161
        code, out, _ = stltool("monitor", DUTY, SHIFT, "--task", "charged", "-p", f"late={late}", "--json")
        data = json.loads(out)
        assert (code, data["task"], data["violations"]) == (violated, "charged", violated)
        assert data["formula"] == f"battery < 0.3 -> (F[0,{late}] docked)"


def test_a_formula_on_a_log(stltool, log):
    code, out, _ = stltool("monitor", "G[0,1] (x > -T | door)", log, "-p", "T=2.5")
    assert code == 1
    assert out.splitlines() == [
        "task        G[0,1] (x > -2.5 | door)",
        f"trace       {log}, 5 samples",
        "horizon     1",
        "judged      4 steps, 0 … 3",
        "step 0      holds",
        "violated    at 2 of 4 steps, first at step 2",
        "robustness  -0.5 at step 2, the least",
        "",
        "violated     steps  least robustness  at step",
        "steps 2 … 3  2      -0.5              2",
    ]
    code, out, _ = stltool("monitor", "x > -5", log)
    assert code == 0
    assert out.splitlines()[-2:] == ["violated    at no step", "robustness  2 at step 3, the least"]


def test_one_object(stltool, log):
    code, out, err = stltool("monitor", "G[0,1] (x > 0 & door)", log, "--json")
    data = json.loads(out)
    assert (code, err, list(data)) == (1, "", KEYS)
    assert data == {
        "task": None, "formula": "G[0,1] (x > 0 & door)", "trace": str(log), "traces": None, "samples": 5, "horizon": 1,
        "end": "error", "at": None, "unit": None, "step": None, "clock": None, "judged": 4, "verdict": False,
        "holds": False, "violations": 4, "first_violation": 0, "first_violation_time": None, "least_robustness": "-inf",
        "least_robustness_at": 1, "least_robustness_time": None, "verdicts": [False] * 4,
        "robustness": [-1.0, "-inf", "-inf", "-inf"],
    }  # fmt: skip
    data = json.loads(stltool("monitor", "F[0,1] door", log, "--json")[1])
    assert (data["holds"], data["robustness"]) == (False, ["inf", "inf", "-inf", "inf"])


@pytest.mark.parametrize(
    ("at", "code", "says"),
    [(0, 0, "step 0      holds\nrobustness  1\n"), (2, 1, "step 2      violated\nrobustness  -2\n")],
)
def test_one_step(stltool, log, at, code, says):
    ended, out, _ = stltool("monitor", "x > 0", log, "--at", at)
    assert ended == code
    assert out.endswith(f"judged      step {at}\n{says}")
    ended, out, _ = stltool("monitor", "x > 0", log, "--at", at, "--json")
    data = json.loads(out)
    assert (ended, data["at"], data["judged"], data["verdict"], data["holds"]) == (code, at, 1, not code, not code)
    assert (data["violations"], data["first_violation"]) == ((1, at) if code else (0, None))
    assert (len(data["verdicts"]), len(data["robustness"]), data["least_robustness_at"]) == (1, 1, at)


def test_the_end_of_the_trace(stltool, log):
    """At the last step a cut G[0,2] sees one sample, a held one that sample thrice."""
    for end, verdicts in (("error", [False] * 3), ("cut", [False] * 4 + [True]), ("hold", [False] * 4 + [True])):
        code, out, _ = stltool("monitor", "G[0,2] x > 0", log, "--end", end, "--json")
        data = json.loads(out)
        assert (code, data["end"], data["verdicts"], data["judged"]) == (1, end, verdicts, len(verdicts))
    for end, verdict in (("cut", True), ("hold", False)):
        code, out, _ = stltool("monitor", "G[1,2] x < 0", log, "--end", end, "--at", 4, "--json")
        assert json.loads(out)["verdict"] is verdict
    assert "horizon     2; windows are cut at the end of the trace\n" in stltool(
        "monitor", "G[0,2] x > 0", log, "--end", "cut")[1]  # fmt: skip
    assert "horizon     2; the last sample is held at the end of the trace\n" in stltool(
        "monitor", "G[0,2] x > 0", log, "--end", "hold")[1]  # fmt: skip
    code, out, _ = stltool("monitor", "F[0,1] door -> G[0,0] x > -9", log, "--end", "hold", "--steps")
    assert code == 0


def test_every_step_is_listed(stltool, log):
    code, out, _ = stltool("monitor", "x > 0", log, "--steps")
    assert code == 1
    assert out.split("\n\n")[-1].splitlines() == [
        "step  verdict   robustness", "0     holds     1", "1     violated  -1", "2     violated  -2",
        "3     violated  -3", "4     holds     4",
    ]  # fmt: skip
    _, out, _ = stltool("monitor", "x > 0", log, "--steps", "--at", 3)
    assert out.split("\n\n")[-1].splitlines() == ["step  verdict   robustness", "3     violated  -3"]


def test_a_batch_has_a_row_a_trace(stltool, batch, tmp_path):
    code, out, _ = stltool("monitor", "x > 0", batch)
    assert code == 1
    assert out.splitlines() == [
        "task        x > 0",
        f"trace       {batch}, 3 samples × 3 traces",
        "horizon     0",
        "judged      3 steps, 0 … 2",
        "holds       for 1 of 3 traces at every step",
        "violated    at 3 of 9 steps",
        "robustness  -2 at step 2, the least",
        "",
        "trace  step 0    violated at  first  least robustness  at step",
        "0      holds     0 steps      –      1                 0",
        "1      holds     2 steps      1      -2                2",
        "2      violated  1 step       0      -1                0",
    ]
    code, out, _ = stltool("monitor", "x > 0", batch, "--at", 1)
    assert (code, out.splitlines()[4:]) == (1, [
        "holds       for 2 of 3 traces", "robustness  -1", "", "trace  step 1    robustness", "0      holds     2",
        "1      violated  -1", "2      holds     1",
    ])  # fmt: skip
    assert stltool("monitor", "x > -5", batch)[0] == 0
    data = json.loads(stltool("monitor", "x > 0", batch, "--json")[1])
    assert list(data) == [*KEYS, "violating_traces", "each"]
    assert (data["traces"], data["violating_traces"], data["first_violation"]) == (3, 2, 0)
    assert data["verdicts"] == [[True] * 3, [True, False, False], [False, True, True]]
    assert data["each"][1] == {
        "verdict": True, "holds": False, "violations": 2, "first_violation": 1, "first_violation_time": None,
        "least_robustness": -2.0, "least_robustness_at": 2, "least_robustness_time": None,
    }  # fmt: skip
    for options, says in (([], "trace 1:\nstep "), (["--trace", 2], "trace 2:\nstep ")):
        assert says in stltool("monitor", "x > 0", batch, "--steps", *options)[1]
    np.savez(tmp_path / "many.npz", x=np.ones((23, 2)))
    assert stltool("monitor", "x > 0", tmp_path / "many.npz")[1].endswith("\nand 3 more; --json lists all\n")


def test_many_ranges(stltool, tmp_path):
    (tmp_path / "t.csv").write_text("x\n" + "1\n-1\n" * 7)
    _, out, _ = stltool("monitor", "x > 0", tmp_path / "t.csv")
    assert out.endswith("step 9    1      -1                9\nand 2 more; --json lists all\n")


@pytest.mark.parametrize("ending", ["png", "SVG", "pdf"])
def test_the_picture(stltool, log, batch, tmp_path, ending):
    path = tmp_path / "sub" / f"t.{ending}"
    code, out, _ = stltool("monitor", "G[0,1] x > 0 & door", log, "--plot", path)
    assert code == 1
    assert out.endswith(f"\n\nplot  {path}\n")
    assert path.read_bytes().startswith({"png": b"\x89PNG", "SVG": b"<svg", "pdf": b"%PDF"}[ending])
    assert os.listdir(path.parent) == [path.name]
    if ending == "SVG":
        for options, shown in (([], 1), (["--trace", 0], 0)):
            code, out, _ = stltool("monitor", "x > 0", batch, "--plot", path, *options)
            assert (code, out.splitlines()[-1]) == (1, f"plot  {path}, trace {shown}")
        assert "trace 0: holds at all 3 steps" in path.read_text()
        stltool("monitor", "x > 0", batch, "--plot", path, "--at", 1, "--json")
        assert "trace 1: step 1 violated, robustness -1" in path.read_text()


def test_bad_input_ends_with_code_2(stltool, log, batch, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "task.stl").write_text("bounded := G[0,9] x > 0\nforever := x > 0\n")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "folder.stl").mkdir()
    cases = [
        (["tsak.stl", log], "tsak.stl: there is no such task file; did you mean task.stl?"),
        ([tmp_path / "none" / "a.stl", log], "a.stl: there is no such task file\n"),
        (["folder.stl", log], "folder.stl: this is a folder; name a task file"),
        (["task", log], f"{log}: there is no column task; known names: door, when, x"),
        (["task.txt", log], "task.txt: there is no such task file; a label of that name is in quotes"),
        (["folder/task", log], "(read as a formula: there is no file folder/task)"),
        (["G[0,1] x >", log], "G[0,1] x >\n              ^\n"),
        (["G[0,1] " * 60 + "x >", log], "formula, line 1"),  # too long for a file's name
        (["task.stl", log, "--task", "bonded"], "there is no definition bonded; did you mean bounded?"),
        (["task.stl", log, "-p", "T=3"], "there is no param T to override"),
        (["task.stl", log, "--task", "bounded"], "(its horizon is 9); give longer ones, or --end cut"),
        (["x > 0", log, "--task", "a"], "--task a: a formula has no definitions to choose from; leave out --task"),
        (["x > 0", log, "-p", "T=3"], "formula: this formula has no param T; no such name occurs in it"),
        (["x > T0", log, "-p", "T=3"], "formula: this formula has no param T; did you mean T0?"),
        (["x > 0", log, "-p", "T"], "'T' is not NAME=VALUE"),
        (["true", log], "true: this formula is constant"),
        (["X > 0", log], "there is no column X; did you mean x?"),
        (["when > 0", log], "line 2, column when: 'Mon' is not a number"),
        (["x & door", log], f"{log}: signal x is -1.0 at step 1: it is used as a label"),
        (["once[1,1] 1 / (x + 1) > 9", log], "step 1: formula, line 1, column 11: this term has no value"),
        (["x > 0", "none.csv"], "none.csv: there is no such trace file"),
        (["x > 0", "task.stl"], "task.stl: not a trace file; traces are read from .csv, .tsv, .npz, .parquet"),
        (["x > 0", log, "--end", "wrap"], "--end wrap: choose error, cut, hold"),
        (["x > 0", log, "--at", 5], "--at 5: steps 0 … 4 of these 5 samples are judged; --end cut or hold judges"),
        (["x > 0", log, "--at", -1], "--at -1: steps 0 … 4 of these 5 samples are judged"),
        (["x > 0", log, "--at", 5, "--end", "cut"], "--at 5: steps 0 … 4 of these 5 samples are judged"),
        (["x > 0", log, "--trace", 0], "--trace 0 selects the trace for --plot, --steps or --why; add one of them"),
        (["x > 0", log, "--trace", 0, "--steps"], "log.csv contains a single trace; leave out --trace"),
        (["x > 0", batch, "--trace", 3, "--steps"], f"--trace 3: {batch} contains traces 0 … 2"),
        (["x > 0", log, "--steps", "--json"], "--steps lists what --json contains already; keep one of them"),
        (["x > 0", "none.csv", "--plot", "t.jpg"], "t.jpg: pictures are written as .png, .svg or .pdf; use"),
        (["x > 0", "none.csv", "--plot", "folder.png"], "folder.png: cannot be written: it is not a regular file"),
        (["x > 0", "none.csv", "--plot", "task.stl/t.png"], "task.stl: cannot create the results folder"),
    ]  # fmt: skip
    for arguments, says in cases:
        code, out, err = stltool("monitor", *arguments)
        assert (code, out) == (2, ""), arguments
        assert says in err, arguments
    assert sorted(os.listdir(tmp_path)) == ["batch.npz", "folder.png", "folder.stl", "log.csv", "task.stl"]


def test_a_file_comes_before_a_formula(stltool, log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert stltool("monitor", "door", log)[0] == 1
    (tmp_path / "door").write_text("any := door | x < 0")
    assert stltool("monitor", "door", log)[0] == 0


def test_what_takes_long_is_told(stltool, log, monkeypatch):
    monkeypatch.setattr(terminal, "_PATIENCE", 0.0)
    slow = Reading.log

    def wait(*args, **kwargs):
        import time

        time.sleep(0.2)
        return slow(*args, **kwargs)

    monkeypatch.setattr(Reading, "log", wait)
    assert f"reading {log} …" in stltool("monitor", "x > 0", log)[2]
    assert stltool("monitor", "x > 0", log, "--json")[2] == ""
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, where somebody watches
    _, out, err = stltool("monitor", "x > 0", log)
    assert "reading" in err
    assert "reading" not in out


def test_help_has_an_example(stltool):
    _, out, _ = stltool("monitor", "--help")
    shown = " ".join(re.sub(r"[│\n]", " ", out).split())
    assert 'stltool monitor "G[0,20] battery > 0.2" log.csv --plot log.png' in shown


def test_why_the_first_violated_step_fails(stltool, tmp_path):
    path = tmp_path / "dock.csv"
    path.write_text("docked\n1\n1\n0\n1\n0\n0\n0\n1\n")
    code, out, _ = stltool("monitor", "G[0,5] F[0,2] docked", path, "--why")
    assert code == 1
    assert out.splitlines()[-4:] == [
        "why",
        "  G[0,5] F[0,2] docked fails at step 0:",
        "    F[0,2] docked fails at step 4: docked is false throughout steps 4 … 6; "
        "last true at 3, next at 7, needed by 6",
        "causes  docked at steps 4 … 6 (3 samples, a minimal set)",
    ]
    code, out, _ = stltool("monitor", "G[0,1s] F[0,0.4s] docked", path, "--why", "--step", "0.2s", "--json")
    why = json.loads(out)["why"]
    assert (code, why["step"], why["verdict"], why["minimal"], why["unit"]) == (1, 0, False, True, "s")
    [cause] = why["causes"]
    assert (cause["signal"], cause["steps"], cause["values"]) == ("docked", [4, 5, 6], [False] * 3)
    assert cause["times"] == pytest.approx([0.8, 1.0, 1.2])
    assert why["sentences"][-1].endswith("last true at 0.6 s, next at 1.4 s, needed by 1.2 s")
    inner = why["reason"]["parts"][0]
    assert (inner["formula"], inner["steps"], inner["holds"]) == ("F[0,0.4s] docked", [[4, 4]], False)
    assert [inner["parts"][0][key] for key in ("steps", "awaited", "last", "next")] == [[[4, 6]], True, 3, 7]


def test_why_of_a_batch_is_of_the_trace_that_is_shown(stltool, batch):
    code, out, _ = stltool("monitor", "x > 0", batch, "--why")
    assert code == 1
    assert out.splitlines()[-3:] == [
        "why", "  x > 0 fails at step 1 with x = -1, short by 1", "causes  x at step 1 (1 sample, a minimal set)",
    ]  # fmt: skip
    code, out, _ = stltool("monitor", "x > 0", batch, "--why", "--trace", 0, "--json")
    assert (json.loads(out)["why"]["trace"], json.loads(out)["why"]["verdict"]) == (0, True)


def test_comparisons_of_several_steps(stltool, log, tmp_path):
    code, out, _ = stltool("monitor", "x[t+1] - x[t] > -9", log, "--end", "cut", "--report", tmp_path, "--json")
    data = json.loads(out)
    assert (code, data["verdicts"][-1], all(data["verdicts"][:-1])) == (1, False, True)
    assert "F[1,1] (x - x[t-1]" in (tmp_path / "report.html").read_text()
    trace = tmp_path / "log.csv"
    trace.write_text("speed\n1\n3\n2\n")
    assert stltool("monitor", "speed[t+1s] > speed", trace, "--step", "1s", "--at", 0)[0] == 0
    assert stltool("monitor", "speed[t+1s] > speed", trace, "--step", "1s", "--at", 1)[0] == 1


def test_coverage_counts_over_all_files(stltool, tmp_path):
    """By hand: x > 0 at two steps of one trace, where y is high enough anyway, and at none of the other."""
    (tmp_path / "one.csv").write_text("x,y\n1,0\n0,4\n1,0\n0,4\n")
    (tmp_path / "two.csv").write_text("x,y\n0,0\n0,4\n0,0\n0,0\n")
    task = tmp_path / "task.stl"
    task.write_text("asked := x > 0\ntask := asked -> F[0,1] y > 3\nexpect cover(asked) >= 2\nexpect cover(asked) > 2\n"
                    'expect cover(task, vacuous) <= 1\nexpect cover(asked, trace "none.csv") >= 9\n')  # fmt: skip
    asked = ("monitor", task, tmp_path / "one.csv", tmp_path / "two.csv")
    assert stltool(*asked)[0] == 0
    code, out, err = stltool(*asked, "--coverage")
    assert (code, err) == (1, "")
    rows = [line.split() for line in out.splitlines()[-4:]]
    assert [" ".join(row) for row in rows] == [
        "verdict expectation counted", "holds cover(asked) >= 2 2", "does not hold cover(asked) > 2 2",
        "holds cover(task, vacuous) <= 1 1",
    ]  # fmt: skip
    code, out, _ = stltool(*asked, "--coverage", "--json")
    data = json.loads(out)["coverage"]
    assert (code, data["traces"], data["passed"], data["vacuous"]) == (1, 2, 2, 1)
    assert data["parts"][0] == {"part": "x > 0", "premise": True, "held": 2, "failed": 4, "open": 0, "mattered": 1}
    assert [(one["count"], one["verdict"]) for one in data["expectations"]] == [
        (2, "holds"), (2, "does not hold"), (1, "holds"),
    ]  # fmt: skip
    code, out, _ = stltool(*asked, "--coverage", "--at", 1, "--json", "--report", tmp_path / "page")
    data = json.loads(out)["coverage"]
    assert (data["parts"][0]["held"], data["expectations"][0]["count"]) == (0, 0)
    page = re.sub(r"<[^>]*>", " ", (tmp_path / "page" / "report.html").read_text())
    told = " ".join(page.partition("What the traces say about its parts")[2].split())
    assert told.startswith("2 traces: 2 passed, 2 of them vacuously (a premise held nowhere).")
    assert "part held failed open mattered x &gt; 0 (premise) 0 2 0 0" in told
    assert "the premise x &gt; 0 held at no step" in told
    assert "does not hold cover(asked) &gt;= 2 0" in told


def test_a_page_without_coverage_has_no_table_of_it(stltool, log, tmp_path):
    stltool("monitor", "door -> x > -9", log, "--report", tmp_path / "page")
    assert "What the traces say" not in (tmp_path / "page" / "report.html").read_text()


def test_coverage_of_a_formula_has_no_expectations(stltool, log):
    code, out, _ = stltool("monitor", "door -> x > -9", log, "--coverage")
    assert code == 0
    assert "door (premise)" in out
    assert "expectation" not in out
    code, _, err = stltool("monitor", "door -> x > -9", log, "--coverage", "--follow")
    assert code == 2
    assert "--coverage needs the whole trace" in err
