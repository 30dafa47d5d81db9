""".pre-commit-hooks.yaml and action.yml: their structure, and their commands run here as CI would run them."""

import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest
import yaml

from tests.cli.every import COMMANDS
from tests.conftest import ROOT

HOOKS = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
STEPS = {step["name"]: step for step in ACTION["runs"]["steps"]}


def test_hooks_have_what_pre_commit_needs():
    assert [hook["id"] for hook in HOOKS] == ["stltool-fmt", "stltool-lint"]
    for hook in HOOKS:
        assert set(hook) == {"id", "name", "description", "entry", "language", "files", "types"}
        program, command = shlex.split(hook["entry"])
        assert (program, hook["language"]) == ("stltool", "python")
        (argument,) = [parameter for parameter in COMMANDS[command].params if parameter.param_type_name == "argument"]
        assert argument.nargs == -1  # any number of files
        assert re.search(hook["files"], "tasks/patrolling.stl")
        assert not re.search(hook["files"], "tasks/patrolling.stl.txt")


def test_the_action_has_what_github_needs():
    assert {"name", "description", "inputs", "outputs", "runs"} <= set(ACTION)
    assert ACTION["runs"]["using"] == "composite"
    for step in STEPS.values():
        assert ("uses" in step) != ("run" in step)
        assert "run" not in step or step["shell"] == "bash"
        assert "uses" not in step or re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step["uses"])
        # values reach scripts as variables: text of a pull request is never a part of a command
        assert "${{" not in step.get("run", "")
    text = (ROOT / "action.yml").read_text(encoding="utf-8")
    assert set(re.findall(r"inputs\.([\w-]+)", text)) == set(ACTION["inputs"])
    for entry in ACTION["inputs"].values():
        assert set(entry) in ({"description", "default"}, {"description", "required"})
    named = re.findall(r"steps\.(\w+)\.outputs\.([\w-]+)", text)
    assert [(STEPS["Verify"]["id"], "exit-code")] == named
    for option in re.findall(r"stltool verify .*", STEPS["Verify"]["run"])[0].split():
        if option.startswith("--"):
            assert any(option in parameter.opts for parameter in COMMANDS["verify"].params)


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("check_jsonschema", ["--builtin-schema", "vendor.github-actions", "action.yml"]),
        ("pre_commit", ["validate-manifest", ".pre-commit-hooks.yaml"]),
    ],
)
def test_those_who_read_them_accept_them(module, arguments):
    pytest.importorskip(module)
    done = subprocess.run([sys.executable, "-m", module, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def stand_in(folder, name="stltool"):
    """A program for this Python's stltool, and the environment that finds it."""
    folder.mkdir()
    program = folder / name
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m stltool "$@"\n')
    program.chmod(0o755)
    return {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.mark.soak(only=True)
@pytest.mark.skipif(not shutil.which("git"), reason="there is no git here")
def test_the_hooks_run_in_a_repository(tmp_path):
    """Under pre-commit, with the program that is here in place of an installation of its own."""
    pytest.importorskip("pre_commit")
    environment = stand_in(tmp_path / "bin") | {"PRE_COMMIT_HOME": str(tmp_path / "home")}
    place = tmp_path / "work"
    place.mkdir()
    hooks = [{**hook, "language": "system"} for hook in HOOKS]
    (place / ".pre-commit-config.yaml").write_text(yaml.safe_dump({"repos": [{"repo": "local", "hooks": hooks}]}))
    (place / "task.stl").write_text("reach   := F[0,3]  a\n")
    (place / "notes.txt").write_text("reach   := no task\n")

    def run(*command):
        return subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True)

    for command in ("init", "add"):
        assert run("git", command, ".").returncode == 0
    commit = (sys.executable, "-m", "pre_commit", "run")
    first = run(*commit)
    assert (first.returncode, "files were modified by this hook" in first.stdout) == (1, True), first.stdout
    assert (place / "task.stl").read_text() == "reach := F[0,3] a\n"
    assert (place / "notes.txt").read_text() == "reach   := no task\n"
    run("git", "add", ".")
    second = run(*commit)
    assert (second.returncode, second.stdout.count("Passed")) == (0, 2), second.stdout


@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash here")
@pytest.mark.parametrize(("extras", "named"), [("", "a place"), ("gymnasium,parquet", "a place[gymnasium,parquet]")])
def test_the_action_installs_what_it_is_part_of(tmp_path, extras, named):
    """Its script, with a program in place of pip that writes down what it is asked for."""
    program = tmp_path / "python"
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@" > asked\n')
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "SOURCE": "a place", "EXTRAS": extras}
    subprocess.run(["bash", "-eo", "pipefail", "-c", STEPS["Install stltool"]["run"]], cwd=tmp_path, env=environment,
                   check=True)  # fmt: skip
    asked = (tmp_path / "asked").read_text().splitlines()
    assert (asked[:3], asked[-1]) == (["-m", "pip", "install"], named)


@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash here")
@pytest.mark.parametrize(
    ("files", "code", "told"),
    [
        ("tasks/**/*.stl\nbad.stl", 1, "1 of 2 expectations hold, 1 does not"),
        ("none/*.stl", 2, ""),
        ("$(touch owned).stl", 2, ""),
    ],
)
def test_the_action_verifies(tmp_path, files, code, told):
    """Its script, with a stand-in for the installed program."""
    (tmp_path / "tasks" / "deep").mkdir(parents=True)
    coin = 'kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = "1/3"\n'
    (tmp_path / "tasks" / "deep" / "coin.toml").write_text(coin)
    task = 'model "{}coin.toml"\nreach := F[0,1] A\nexpect Pmax(reach) {} 1/4\n'
    (tmp_path / "tasks" / "deep" / "good.stl").write_text(task.format("", ">="))
    (tmp_path / "bad.stl").write_text(task.format("tasks/deep/", "<="))
    summary, outputs = tmp_path / "summary", tmp_path / "outputs"
    environment = {
        **stand_in(tmp_path / "bin"), "FILES": files, "OUT": "out dir",
        "CERTIFICATES": "true", "OPTIONS": "--exact-seconds 5", "GITHUB_STEP_SUMMARY": str(summary),
        "GITHUB_OUTPUT": str(outputs),
    }  # fmt: skip
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", STEPS["Verify"]["run"]],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, outputs.read_text()) == (code, f"exit-code={code}\n"), done.stderr
    assert not (tmp_path / "owned").exists()
    if not told:
        assert not summary.exists()
        return
    assert told in summary.read_text(encoding="utf-8")
    found = {path.name for path in (tmp_path / "out dir").iterdir()}
    assert found == {"report.html", "report.json", "junit.xml", "summary.md", "certificates"}
