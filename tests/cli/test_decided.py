"""Tasks that the first state decides: every command answers at once, horizon 0 included."""

import json

import pytest

import stltool as stl
from tests.conftest import FACTORY

TASKS = f"""
model "{FACTORY}/floor-5x5.toml"
soon := F[0,3] !A
never := !(F[0,3] !A)
now := !A
absent := A
nested := F[0,3] F[0,2] !A
"""
CASES = [("soon", 1.0), ("never", 0.0), ("now", 1.0), ("absent", 0.0), ("nested", 1.0)]


@pytest.fixture
def ask(stltool, tmp_path):
    file = tmp_path / "tasks.stl"
    file.write_text(TASKS)

    def ask(command, task, *options):
        code, out, err = stltool(command, file, "--task", task, *options, "--json")
        assert err == ""
        return code, json.loads(out)

    return ask


@pytest.mark.parametrize(("task", "probability"), CASES)
def test_every_command_knows_the_probability(ask, tmp_path, task, probability):
    code, data = ask("run", task, "--out", tmp_path / "out", "--rollouts", 100)
    assert (code, [check["probability"] for check in data["checks"]]) == (0, [probability] * 2)
    assert data["training"]["status"] == "nothing to learn"
    assert [row["lower"] for row in data["guarantees"][:2]] == [probability] * 2
    assert len(data["run"]["steps"]) == 1
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Nothing was learned: the first state decides the task" in page

    policy = tmp_path / "p.npz"
    for faithful in ([], ["--faithful"]):
        code, data = ask("learn", task, "--out", policy, "--history", tmp_path / "h.csv", *faithful)
        assert (code, data["history"][-1]["probability"], data["environment_steps"]) == (0, probability, 0)
    rows = (tmp_path / "h.csv").read_text().splitlines()
    assert rows[1].startswith(f"0,0,{probability},cfer,True,0,")
    for options in ([], ["--policy", policy], ["--exact"]):
        assert ask("check", task, *options)[1]["probability"] == probability
    for options in ([], ["--policy", policy]):
        data = ask("estimate", task, "--runs", 50, *options)[1]
        assert (data["probability"], data["steps"]) == (probability, 0)
        code, data = ask("estimate", task, "--at-least", "0.5", *options)
        assert (code, data["verdict"]) == ((0, "holds") if probability else (1, "does not hold"))
    code, data = ask("why", task, "--policy", policy)
    assert (code, data["probability"], len(data["runs"])) == (0, probability, int(probability == 0))


def test_the_surrogate_too(ask):
    for row in ask("surrogate", "nested")[1]["surrogates"]:
        assert (row["least"], row["greatest"], row["at_random"]) == (1.0, 1.0, 1.0)


def test_the_text_says_so(stltool, tmp_path):
    (tmp_path / "tasks.stl").write_text(TASKS)
    code, out, _ = stltool("learn", tmp_path / "tasks.stl", "--task", "now", "--out", tmp_path / "p.npz")
    assert code == 0
    assert "learned  nothing: the first state decides the task, so all policies are equally good" in out
    assert "exact P  1\n" in out


@pytest.mark.soak(only=True)
def test_sweeps_too(stltool, tmp_path):
    (tmp_path / "tasks.stl").write_text(TASKS)
    scenarios = "".join(f'[[scenario]]\nid = "{t}"\ntask = "tasks.stl"\ndefinition = "{t}"\n' for t, _ in CASES)
    methods = '[[method]]\nname = "cfer"\n[[method]]\nid = "p"\nname = "cfer"\nfaithful = true\n'
    (tmp_path / "sweep.toml").write_text(f"[sweep]\nseeds = 2\n{methods}{scenarios}")
    code, out, err = stltool("sweep", tmp_path / "sweep.toml", "--workers", 1, "--out", tmp_path / "out", "--json")
    data = json.loads(out)
    assert (code, err, data["runs"]) == (0, "", {"finished": 20, "failed": 0, "all": 20})
    assert {(row["scenario"], row["median"]) for row in data["results"]} == set(CASES)
    assert {row["environment_steps"] for row in data["results"]} == {0}
    assert data["results"][0]["settings"] == {**stl.Cfer().__dict__}
    assert stltool("sweep", tmp_path / "sweep.toml", "--workers", 1, "--out", tmp_path / "x", "--dry-run")[0] == 0


def test_a_bound_inside_the_enclosure_is_undecided(stltool, tmp_path, monkeypatch):
    monkeypatch.setattr(stl.CheckResult, "at_least", lambda self, bound: None)
    (tmp_path / "tasks.stl").write_text(TASKS)
    given = [tmp_path / "tasks.stl", "--task", "soon", "--rollouts", 10, "--out", tmp_path / "out", "--at-least", "0.5"]
    code, out, _ = stltool("run", *given)
    assert code == 1
    assert "P >= 0.5  undecided: the bound lies inside the enclosure; stltool check" in out
    code, out, _ = stltool("run", *given, "--json")
    assert (code, json.loads(out)["asked"]) == (1, [{"claim": "P >= 0.5", "holds": None}])
