"""`stltool frontier`: the same as `stl.frontier`, in a table and as JSON."""

import json

import pytest

from tests.conftest import FACTORY, PATROLLING, SMALL


def test_a_staircase_and_a_scan(stltool, tmp_path):
    asked = ["frontier", PATROLLING, *SMALL, "--at-least", "0.95", "--vary", "T=4:5", "--vary", "tau=5:7"]
    code, out, err = stltool(*asked)
    assert (code, err) == (0, "")
    assert "T      larger is stronger" in out
    assert "checks                      3 of 6, by staircase" in out
    assert "smallest tau for T = 4 … 5  6" in out
    code, out, _ = stltool(*asked, "--json")
    data = json.loads(out)
    assert [step["tightest"] for step in data["steps"]] == ["6", "6"]
    assert [probe["holds"] for probe in data["probes"]].count(True) == 2
    (tmp_path / "both.stl").write_text("param n = 1\nr := G[0,n] F[0,n] A\n")
    asked = ["frontier", tmp_path / "both.stl", "--model", FACTORY / "floor-5x5.toml", "--at-least", "0.5"]
    code, out, _ = stltool(*asked, "--vary", "n=1,3")
    assert code == 0
    assert "no direction is proved" in out
    assert "2 of 2, by scan" in out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--vary", "=3"], "--vary =3: write a param and its values"),
        (["--vary", "U"], "the task has no param U"),
        (["--vary", "T=3:1"], "the lower end of a range comes first"),
        (["--vary", "T=1:3:0"], "the step is positive"),
        (["--vary", "T=1s:3s"], "a range is of plain numbers"),
        (["--vary", "T=1:1e9"], "1000000000 values are more than 20000"),
        (["--vary", "T=1:2", "--vary", "T=1:2"], "--vary names a param twice"),
        (["--vary", "U=1:2"], "the task has no param U"),
        (["--vary", "T=0:2"], "the interval"),
    ],
)
def test_bad_questions_end_with_a_message(stltool, options, says):
    code, out, err = stltool("frontier", PATROLLING, "--at-least", "0.95", *options)
    assert (code, out) == (2, "")
    assert says in err
