"""`stltool verify`: exit codes, and the files that CI systems and people read."""

import json
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from stltool.log import Log
from tests.conftest import FACTORY, ROOT

TASK = 'model "coin.toml"\nreach := F[0,1] A\n'
COIN = 'kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = "1/3"\n'
HOLDS, FAILS = "expect Pmax(reach) >= 0.3", "expect Pmax(reach) >= 0.4"
UNDECIDED, WRONG = "expect Pmax(reach | A) >= 1/3", 'expect P(reach, policy "no.npz") >= 0.3'


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Task files of these expectations, in the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coin.toml").write_text(COIN)
    (tmp_path / "no.npz").write_text("no policy")

    def write(name="task.stl", *lines):
        (tmp_path / name).write_text("\n".join([TASK, *lines, ""]))
        return name

    return write


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        ([HOLDS], 0),
        ([HOLDS, FAILS], 1),
        ([HOLDS, "expect Pmax(reach) >= 1/3"], 1),  # undecided, since no time is left for the fraction
        ([HOLDS, FAILS, WRONG], 2),
        (["expect Pmax(reach) >= 2"], 2),
        ([], 2),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_exit_codes(stltool, files, lines, code, as_json):
    got, out, err = stltool("verify", files("task.stl", *lines), "--exact-seconds", "0", *["--json"] * as_json)
    assert got == code
    assert bool(err) == (code == 2)
    if as_json and out:
        data = json.loads(out)
        assert data["holds"] == (code == 0)
        assert len(data["expectations"]) == len(lines)


def test_params_are_given_as_to_other_commands(stltool, files):
    first = files("task.stl", "param goal = 0.9", "expect Pmax(reach) >= goal")
    assert stltool("verify", first)[0] == 1
    code, out, _ = stltool("verify", first, files("other.stl", "expect Pmax(reach) >= 2/5"), "-p", "goal=0.3", "-p",
                           "success=0.4", "--json")  # fmt: skip
    data = json.loads(out)
    assert (code, [row["bound"] for row in data["expectations"]]) == (0, ["0.3", "0.4"])
    assert "-p goal=0.3" in data["command"]
    for wrong, says in ((["-p", "gaol=1"], "did you mean goal?"), (["-p", "goal=1", "-p", "goal=2"], "given twice")):
        code, _, err = stltool("verify", first, *wrong)
        assert (code, says in err) == (2, True)


def test_the_table_says_what_holds_and_why_not(stltool, files):
    code, out, err = stltool("verify", files("task.stl", HOLDS, FAILS, "expect Pmin(reach) <= 0"))
    assert (code, err) == (1, "")
    assert re.sub(" +", " ", out).splitlines() == [
        "verdict expectation found at",
        "holds Pmax(reach) >= 0.3 P = 0.33333333333333331 task.stl:4",
        "does not hold Pmax(reach) >= 0.4 P = 0.33333333333333331 task.stl:5",
        "holds Pmin(reach) <= 0 P = 0 task.stl:6",
        "",
        "verified 2 of 3 expectations hold, 1 does not",
    ]


def test_reasons_are_told(stltool, files):
    code, out, err = stltool("verify", files("task.stl", "expect Pmax(reach) > 1/3", WRONG), "--exact-seconds", "0")
    assert code == 2
    assert "task.stl:4  the bound lies inside the enclosure, and the exact fraction is not computed" in out
    assert 'error: task.stl:5: P(reach, policy "no.npz") >= 0.3: no.npz: ' in err
    assert "write one with check --save-policy" in err


def test_what_is_suspicious_is_told(stltool, files):
    code, _, err = stltool("verify", files("task.stl", "expect Pmax(reach) <= 1"), files("quiet.stl"))
    assert code == 0
    assert "warning: task.stl, line 4, column 1: every probability is at most 1, so this always holds" in err
    assert "warning: quiet.stl: this file has no expectations" in err


# Jenkins' junit-10.xsd, which pytest's reports keep to as well
# of an element: its attributes, those that it must have, and its children
JUNIT = {
    "testsuites": ({"name", "time", "tests", "failures", "errors"}, set(), {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures", "errors", "skipped", "time", "timestamp", "hostname", "id", "package", "group"},
        {"name", "tests", "failures", "errors"},
        {"testcase", "properties", "system-out", "system-err"},
    ),
    "testcase": ({"name", "classname", "time", "group"}, {"name", "classname"}, {"failure", "error", "skipped"}),
    "failure": ({"type", "message"}, set(), set()),
    "error": ({"type", "message"}, set(), set()),
}


def test_junit_is_what_its_readers_know(stltool, files):
    first = files("a.stl", HOLDS, FAILS, UNDECIDED)
    second = files("b<&>.stl", WRONG, 'expect Pmax(reach & x < 0.1 -> A) >= 1e-300 # <&"')
    code, _, _ = stltool("verify", first, second, "--junit", "out/verify.xml", "--exact-seconds", "0")
    assert code == 2
    root = ET.parse("out/verify.xml").getroot()
    assert root.tag == "testsuites"
    for element in root.iter():
        known, needed, children = JUNIT[element.tag]
        assert needed <= set(element.attrib) <= known, element.tag
        assert {child.tag for child in element} <= children
    suites = root.findall("testsuite")
    assert [suite.get("name") for suite in suites] == ["a.stl", "b<&>.stl"]
    counted = [{key: int(suite.get(key)) for key in ("tests", "failures", "errors")} for suite in suites]
    assert counted == [{"tests": 3, "failures": 2, "errors": 0}, {"tests": 2, "failures": 0, "errors": 1}]
    assert {key: int(root.get(key)) for key in ("tests", "failures", "errors")} == {
        "tests": 5,
        "failures": 2, "errors": 1,
    }  # fmt: skip
    for suite in suites:
        cases = suite.findall("testcase")
        assert len(cases) == int(suite.get("tests"))
        assert len(suite.findall("testcase/failure")) == int(suite.get("failures"))
        assert all(float(case.get("time")) >= 0 for case in cases)
    failure, undecided = suites[0].findall("testcase/failure")
    assert undecided.get("message").startswith("undecided: the bound lies inside the enclosure")
    assert failure.text.splitlines()[:2] == ["a.stl:5", "expect Pmax(reach) >= 0.4"]
    assert failure.get("message") == "does not hold: P = 0.33333333333333331"


def test_markdown_is_a_table(stltool, files):
    code, _, _ = stltool("verify", files("task.stl", HOLDS, "expect Pmax(reach | A) >= 0.4"), "--markdown", "out.md")
    assert code == 1
    with open("out.md", encoding="utf-8") as file:
        lines = file.read().splitlines()
    assert lines[:2] == ["<!-- Generator: stltool -->", "### ❌ stltool verify: 1 of 2 expectations hold, 1 does not"]
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines if line.startswith("|")]
    assert {len(row) for row in rows} == {4}
    assert rows[3][1].strip() == r"`Pmax(reach \| A) >= 0.4`"
    assert rows[3][3].strip() == "`task.stl:5`"


def test_a_report_is_a_page_and_its_data(stltool, files):
    code, out, _ = stltool("verify", files("task.stl", HOLDS, FAILS), "--report", "out", "--json")
    assert code == 1
    with open("out/report.json", encoding="utf-8") as file:
        data = json.load(file)
    assert json.loads(out) == data
    with open("out/report.html", encoding="utf-8") as file:
        page = file.read()
    assert "Pmax(reach) &gt;= 0.4" in page
    assert "1 of 2 expectations hold, 1 does not" in page
    assert stltool("report", "out/report.json")[0] == 0
    with open("out/report.html", encoding="utf-8") as file:
        assert file.read() == page


def test_every_certificate_passes_certify(stltool, files, tmp_path):
    task = files("task.stl", HOLDS, "expect Pmin(reach) <= 0.2", "expect Pmax(reach) <= 1/3")
    code, out, _ = stltool("verify", task, "--certificates", "proofs")
    assert (code, "certificates  3 in proofs" in out) == (0, True)
    for path in sorted((tmp_path / "proofs").iterdir()):
        code, out, _ = stltool("certify", path, task)
        assert (code, "proved" in out) == (0, True)


@pytest.mark.parametrize("command", ["check", "verify", "explain"])
def test_what_is_no_task_file_is_told_in_one_line(stltool, files, tmp_path, command):
    files("task.stl", HOLDS)
    (tmp_path / "small.toml").write_text("[sweep]\nseeds = 2\n")
    (tmp_path / "empty").mkdir()
    for given, says in (
        ("coin.toml", "coin.toml: this is a model file; give the .stl task, which names its model, or use --model"),
        ("small.toml", "small.toml: this is a sweep file; give it to stltool sweep, or give the .stl task"),
        ("tsak.stl", "tsak.stl: there is no such task file; did you mean task.stl?"),
        (".", ".: this is a folder; name its task files, such as task.stl"),
        ("empty", "empty: this is a folder; name a task file; it has none (.stl)"),
    ):
        if command != "explain" or given.endswith((".toml", ".stl")):  # others are read as formulas
            assert stltool(command, given) == (2, "", f"error: {says}\n")


def test_what_is_no_policy_is_told_with_the_commands_that_save_one(stltool, files):
    code, _, err = stltool("check", files("task.stl", HOLDS), "--policy", "coin.toml")
    assert code == 2
    assert "write one with check --save-policy, learn --out or Policy.save" in err


def test_no_certificates_are_explained(stltool, files, tmp_path):
    """What is about traces or intervals has none, and no folder is made."""
    task = files("task.stl", 'expect holds(x > 0, trace "log.csv")')
    (tmp_path / "log.csv").write_text("x\n1\n")
    code, out, _ = stltool("verify", task, "--certificates", "proofs")
    assert code == 0
    assert "certificates  none: no expectation has a probability that a certificate can prove" in out
    assert not (tmp_path / "proofs").exists()


@pytest.mark.parametrize("option", ["--junit", "--markdown"])
def test_a_result_never_replaces_an_input(stltool, files, option, tmp_path):
    task = files("task.stl", 'expect holds(x > 0, trace "log.csv")')
    (tmp_path / "log.csv").write_text("x\n1\n")
    for target in ("task.stl", "coin.toml", "log.csv"):
        code, _, err = stltool("verify", task, option, target)
        assert (code, "would replace" in err) == (2, True), err


def test_nothing_is_written_where_a_file_is_at_fault(stltool, files, tmp_path):
    before = set(tmp_path.iterdir())
    task = files("task.stl", HOLDS, "expect Pmax(reach) >= 3")
    options = ["--junit", "j.xml", "--markdown", "m.md", "--report", "out", "--certificates", "proofs"]
    assert stltool("verify", task, *options)[0] == 2
    assert set(tmp_path.iterdir()) == {*before, tmp_path / task}


def test_what_takes_more_than_two_seconds_is_told(stltool, files, monkeypatch):
    stages = []

    class Spy(Log):
        def stage(self, title, patience=None):
            stages.append((title, patience))
            return super().stage(title, patience)

    monkeypatch.setattr("stltool.reporting.terminal.LOG", Spy(lambda line: None, watched=False))
    stltool("verify", files("task.stl", HOLDS))
    told = [title for title, patience in stages if patience == 2.0]
    assert told == ["reading coin.toml", "compiling reach", "checking Pmax(reach)"]


def test_the_page_shows_the_example():
    page = (ROOT / "docs" / "verify.md").read_text(encoding="utf-8")
    assert f"```\n{(FACTORY / 'gate.stl').read_text(encoding='utf-8')}```" in page


def test_a_trace_that_fails_is_explained_everywhere(stltool, files, tmp_path):
    (tmp_path / "log.csv").write_text("A,x\n1,5\n1,5\n0,4\n1,1\n0,2\n0,3\n0,3\n1,3\n")
    lines = ['expect holds(G[0,5] reach2, trace "log.csv")', 'expect holds(F[0,3] (x < 2), trace "log.csv")']
    name = files("task.stl", "reach2 := F[0,2] A", *lines)
    code, out, _ = stltool("verify", name, "--report", "out", "--junit", "j.xml", "--markdown", "m.md")
    why = [
        "G[0,5] reach2 fails at step 0:",
        "  reach2 fails at step 4: A is false throughout steps 4 … 6; last true at 3, next at 7, needed by 6",
        "causes: A at steps 4 … 6 (3 samples, a minimal set)",
    ]
    assert code == 1
    assert out.split("\n\n")[1].splitlines() == ["task.stl:5", *(f"  {line}" for line in why)]
    for file in ("m.md", "j.xml", "out/report.html"):
        assert "\n".join(why) in (tmp_path / file).read_text(encoding="utf-8"), file
    rows = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["expectations"]
    assert [row["why"] is None for row in rows] == [False, True]
    assert [(cause["signal"], cause["steps"]) for cause in rows[0]["why"]["causes"]] == [("A", [4, 5, 6])]
    np.savez("batch.npz", A=np.array([[1, 1, 1], [1, 0, 0]]))
    first = files("batch.stl", 'expect holds(G[0,1] A, trace "batch.npz")')
    code, out, _ = stltool("verify", first, "--json")
    [row] = json.loads(out)["expectations"]
    assert (code, row["why"]["trace"], row["why"]["sentences"]) == (
        1, 1, ["G[0,1] A fails at step 0: A is false at step 1"],
    )  # fmt: skip
