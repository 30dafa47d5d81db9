"""`stltool monitor --follow`: verdicts while the log is being written."""

import io
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import stltool as stl

LOG = "# a log\nx,a,note\n1,true,ok\n2,1,\n\n-1,0,low\n3,1,\n"


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
        ("x,a\n1,1\n2,\n", [], "standard input, line 3, column a: '' is no value; every step needs one"),
        ("x,a\n1,1\n2\n", [], "standard input, line 3: 1 cells where the header has 2"),
        ("x,a\n1,1\nmany,1\n", [], "standard input, line 3, column x: 'many' is not a number"),
        ("x,a\n1,1\n", ["--at", "0"], "--at 0: not decided by the 1 samples of standard input"),
        ("x,a\n1,1\n", ["--json"], "--follow prints verdicts as they come; --json needs the whole trace"),
        ("x,a\n1,1\n", ["--step", "0.1s"], "--follow takes rows as steps"),
        ("x,a,x\n1,1,5\n", [], "standard input, line 1: two columns are named x; every column needs a name of its own"),
        ("", [], "the file is empty"),
    ],
)
def test_what_cannot_be_followed(stltool, typed, text, options, says):
    typed(text)
    code, _, err = stltool("monitor", "G[0,3] (x > 0 & a)" if "--step" not in options else "x > 0 & a", "-", "--follow",
                           *options)  # fmt: skip
    assert code == 2
    assert says in err


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
