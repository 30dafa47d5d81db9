"""`stltool new`: every starter and every example runs as it stands, and nothing is ever replaced."""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys

import pytest

from stltool.starters import EXAMPLES, KINDS, example, starter
from tests.conftest import ROOT

QUICK = {"run": ["--rollouts", "50", "--episodes", "20"], "sweep": ["--workers", "1"], "check": [], "why": [],
         "explain": [], "monitor": []}  # fmt: skip
# which other tests do
SLOW = {"stltool sweep small.toml", "stltool run patrolling.stl", "stltool run crossing-blackbox.stl",
        "stltool run delivery.stl", "stltool why inspection.stl"}  # fmt: skip
# programs, with less to do
LESS = {
    "--example robot": shlex.split("--window 3 --episodes 10 --moves 300 --runs 10 --robots 10 --out out"),
    "--example deep": shlex.split("--episodes 1 --seeds 1"),
}
SAYS = {"--example robot": "promise  P >= ", "--example deep": "counterfactual transitions a step"}
VIOLATED = {"--example monitor", "--example drone", "--example insulin"}  # logs with something to see


def test_a_missing_extra_is_told_with_what_needs_it(stltool, tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "gymnasium" else found(name))
    for i, (options, told) in enumerate(
        [("--kind gymnasium", 1), ("--kind grid", 0), ("--example frozenlake", 1), ("--example deep", 1)]
    ):
        code, _, err = stltool("new", tmp_path / str(i), *options.split())
        assert code == 0
        assert err.count("pip install 'stltool[gymnasium]'") == told


@pytest.mark.parametrize(
    "made",
    [f"--kind {kind}" for kind in KINDS]
    + [
        pytest.param(f"--example {name}", marks=[pytest.mark.soak(only=True)] if name == "robot" else [])
        for name in EXAMPLES
    ],
)
def test_what_is_made_runs(stltool, tmp_path, monkeypatch, made):
    monkeypatch.chdir(tmp_path)
    code, text, _ = stltool("new", "shift", *made.split())
    assert code == 0
    assert text.splitlines()[1] == "next  cd shift"
    commands = [line.strip() for line in text.splitlines()[2:]]
    assert commands
    assert all(command.startswith(("stltool ", "python ")) for command in commands)
    monkeypatch.chdir("shift")
    programs = [shlex.split(command) for command in commands if command.startswith("python ")]
    commands = [command for command in commands if command.startswith("stltool ")]
    for _, file, *options in programs[:1]:
        options += LESS[made]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, file, *options], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert SAYS[made] in done.stdout
    learned = made == "--kind grid"  # of the others, run is the same
    for command in [one for one in commands if one not in SLOW and (learned or one != "stltool run task.stl")]:
        _, name, *arguments = shlex.split(command)
        code, out, err = stltool(name, *arguments, *QUICK[name])
        assert (code, err.count("error")) == (int(made in VIOLATED), 0), err
        assert out
    for task in (tmp_path / "shift").glob("*.stl"):
        if made.startswith("--kind"):
            assert stltool("fmt", "--check", task)[0] == 0


def test_the_violation_that_a_comment_promises(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stltool("new", "log", "--kind", "trace")
    monkeypatch.chdir("log")
    (line,) = [line for line in (tmp_path / "log" / "task.stl").read_text().splitlines() if "violation" in line]
    _, name, *arguments = shlex.split(line[line.index("stltool") :])
    assert stltool(name, *arguments)[0] == 1


def test_examples_are_those_of_the_sources():
    for name in EXAMPLES:
        assert (ROOT / "examples" / name).is_dir()
        listed = (ROOT / "pyproject.toml").read_text()
        assert f'"examples/{name}" = "stltool/examples/{name}"' in listed
        for file, content in example(name).files.items():
            if file.endswith(".py"):
                assert not re.search(rb"^\s*(from|import) examples", content, re.M)  # it runs without the sources
                compile(content, file, "exec")
                assert content.count(b"\n") == (ROOT / "examples" / name / file).read_bytes().count(b"\n")
            elif (ROOT / "examples" / name / file).exists():  # not a file of another one
                assert (ROOT / "examples" / name / file).read_bytes() == content
    assert set(starter("grid").files) == {"floor.toml", "task.stl"}
    assert all(len(starter(kind).files["task.stl"].split(b"#")) > 1 for kind in KINDS)  # commented


def test_the_list_and_the_files_as_json(stltool, tmp_path):
    listed = json.loads(stltool("new", "--json")[1])
    assert (listed["kinds"], listed["examples"]) == (KINDS, EXAMPLES)
    text = stltool("new")[1]
    assert all(f"--kind {kind}" in text for kind in KINDS)
    assert all(f"--example {name}" in text for name in EXAMPLES)
    made = json.loads(stltool("new", tmp_path / "a", "--json")[1])
    assert sorted(made["files"]) == sorted(path.name for path in (tmp_path / "a").iterdir())


def test_nothing_is_replaced(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    assert stltool("new", "empty")[0] == 0
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "task.stl").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for name in ("full", "file", "empty"):
        code, _, err = stltool("new", name)
        assert code == 2
        assert "it exists, and nothing is replaced; name a new folder" in err
    assert (tmp_path / "full" / "task.stl").read_text() == "mine"
    code, _, err = stltool("new", "file/below")
    assert code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "file", "full"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["x", "--kind", "gird"], "--kind gird: there is no such kind; did you mean grid?"),
        (["x", "--example", "factry"], "--example factry: there is no such example; did you mean factory"),
        (["x", "--kind", "grid", "--example", "ward"], "give one of them"),
        (["--kind", "grid"], "no folder is named"),
    ],
)
def test_what_does_not_fit_is_refused(stltool, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    code, _, err = stltool("new", *arguments)
    assert code == 2
    assert says in err
    assert not list(tmp_path.iterdir())
