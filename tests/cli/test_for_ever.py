"""`stltool check --for-ever`: the same numbers as `long_run`, and what it refuses."""

import json

import pytest

import stltool as stl
from stltool.checking.long_run import QUESTIONS
from tests.conftest import FACTORY, PATROLLING, SMALL


@pytest.fixture
def watch(tmp_path):
    path = tmp_path / "watch.stl"
    path.write_text(
        f'model "{(FACTORY / "floor-5x5.toml").as_posix()}"\nparam n = 3\nvisits := G F[0,9] A\n'
        "settles := F G F[0,n] A\noften := G F (A & F[0,n] B)\nbad := G (A -> F B)\nsoon := F[0,n] A\n"
    )
    return path


def test_all_questions(stltool, floor5):
    code, out, err = stltool("check", PATROLLING, *SMALL, "--for-ever", "all", "--json")
    data = json.loads(out)
    assert (code, err, data["form"], data["formula"]) == (0, "", None, data["repeated"])
    product = stl.build_product(floor5, stl.load_task(PATROLLING, params={"T": 5, "tau": 5}), "running")
    found = [(one["asked"], one["question"], one["lower"], one["upper"]) for one in data["answers"]]
    wanted = [(asked, maximize) for asked in QUESTIONS for maximize in (False, True)]
    assert [(asked, question) for asked, question, *_ in found] == [
        (asked, "maximum" if maximize else "minimum") for asked, maximize in wanted
    ]
    best = stl.long_run(product)
    assert found[1][2:] == (best.lower, best.upper)
    assert data["answers"][1]["components"] == best.components == 1
    assert [one["encoding"] for one in data["answers"]] == ["running"] * 2 + ["safety"] * 2 + ["running"] * 4
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--for-ever", "all")
    assert code == 0
    assert "persistence  P that it holds at every step from some step on" in out


def test_tasks_that_repeat(stltool, watch, tmp_path):
    policy = tmp_path / "watch.npz"
    asked = ["check", watch, "--task", "visits", "--for-ever", "always"]
    code, out, _ = stltool(*asked, "--at-least", "0.999999", "--save-policy", policy)
    assert code == 0
    assert "asks for  always\nrepeats   F[0,9] A\n" in out
    assert "maximum over all policies of always >= 0.999999  holds" in out
    code, out, _ = stltool(*asked, "--at-least", "0.999999999999", "--policy", policy, "--exact", "--json")
    data = json.loads(out)
    assert (code, data["holds"], data["decided"], data["form"]) == (1, False, True, "always")
    assert [one["question"] for one in data["answers"]] == ["minimum", "maximum", "policy"]
    assert data["answers"][1]["exact"] == data["answers"][2]["exact"]
    code, out, _ = stltool("check", watch, "--task", "settles", "--for-ever", "persistence", "-p", "n=5", "--minimize",
                           "--at-most", "0")  # fmt: skip
    assert code == 0
    assert "minimum over all policies of persistence <= 0  holds" in out
    assert "repeats      F[0,5] A" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--for-ever", "often"], "--for-ever often: choose share, always, recurrence, persistence or all"),
        (["--for-ever", "all", "--at-least", "0.5"], "--at-least is for one question; write --for-ever share, always"),
        (["--for-ever", "all", "--minimize"], "--minimize is for one question"),
        (["--for-ever", "share", "--save-policy", "best.csv"], "best.csv: a policy that goes on for ever is saved as"),
        (["--for-ever", "share", "--report", "x"], "--report is not supported with --for-ever"),
        (["--for-ever", "share", "--encoding", "paper"], "--encoding is not supported with --for-ever"),
        (["--for-ever", "share", "--nominal"], "--nominal: the model's probabilities are not intervals"),
        (
            ["--for-ever", "share", "--task", "bad"],
            "line 6, column 16: this interval has no end; of a task that repeats",
        ),
        (["--task", "visits"], "only monitors and check --for-ever can do without"),
        (["--for-ever", "share", "--policy", "finite.npz"], "depends on the step and ends after 3 steps"),
    ],
)
def test_what_is_refused(stltool, watch, tmp_path, monkeypatch, floor5, options, message):
    monkeypatch.chdir(tmp_path)
    stl.check(stl.build_product(floor5, stl.parse("F[0,3] A"))).policy.save("finite.npz")
    code, out, err = stltool("check", watch, *options)
    assert (code, out) == (2, "")
    assert message in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["finite.npz", "watch.stl"]


def test_models_that_are_refused_or_made_nominal(stltool):
    uncertain = ["check", "examples/factory/uncertain.stl", "-p", "T=3", "-p", "tau=5", "--for-ever", "share"]
    code, out, err = stltool(*uncertain)
    assert (code, out) == (2, "")
    assert "--for-ever needs probabilities without intervals; add --nominal" in err
    code, out, _ = stltool(*uncertain, "--nominal", "--json")
    assert code == 0
    assert 0 < json.loads(out)["answers"][1]["lower"] < 1
