"""`make bench` keeps each table on its own: bench/run.py."""

import ast
import subprocess
import sys

import pytest

from tests.conftest import ROOT


@pytest.fixture
def run(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    import run

    monkeypatch.setattr(run, "RESULTS", tmp_path / "results.md")
    yield run
    del sys.modules["run"]


def made(run, *arguments, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["run.py", *arguments])
    run.main()
    return run.RESULTS.read_text(encoding="utf-8")


def test_results_are_as_the_runner_writes_them(run):
    text = (ROOT / "bench" / "results.md").read_text(encoding="utf-8")
    assert run.together(run.sections(text)) == text
    for body in run.sections(text).values():
        assert body.strip().startswith("Measured on 2")


def test_every_part_is_a_function_that_can_be_quick(run):
    for part in run.PARTS.values():
        tree = ast.parse((ROOT / "bench" / f"{part.module}.py").read_text(encoding="utf-8"))
        (function,) = (node for node in tree.body if getattr(node, "name", None) == part.function)
        assert function.args.args[0].arg == "quick"
        assert ast.literal_eval(function.args.defaults[0]) is False


def test_a_part_that_fails_leaves_its_table_and_the_others_go_on(run, monkeypatch, capsys):
    def fails(name, quick):
        raise subprocess.CalledProcessError(1, name)

    monkeypatch.setattr(run, "measured", lambda name, quick: f"first {name}")
    made(run, "--only", "parsing,kernels", monkeypatch=monkeypatch)
    monkeypatch.setattr(run, "measured", lambda name, quick: f"second {name}" if name != "kernels" else fails(name, 0))
    with pytest.raises(SystemExit, match="failed: kernels; again: python bench/run.py --only kernels"):
        made(run, "--only", "kernels,parsing,monitors", monkeypatch=monkeypatch)
    found = run.sections(run.RESULTS.read_text(encoding="utf-8"))
    assert {title: body.strip() for title, body in found.items()} == {
        run.PARTS["kernels"].title: "first kernels",
        run.PARTS["parsing"].title: "second parsing",
        run.PARTS["monitors"].title: "second monitors",
    }
    assert "[3/3] monitors" in capsys.readouterr().err


def test_quick_figures_are_printed_and_not_kept(run, monkeypatch, capsys):
    run.RESULTS.write_text("as it was", encoding="utf-8")
    monkeypatch.setattr(run, "measured", lambda name, quick: f"{name} {quick}")
    assert made(run, "--quick", "--skip", "largest", monkeypatch=monkeypatch) == "as it was"
    printed = capsys.readouterr().out
    assert "goals True" in printed
    assert "largest" not in printed


@pytest.mark.soak(only=True)
def test_a_part_runs_in_its_own_process_and_says_when_and_where(run):
    lines = run.measured("parsing", quick=True).splitlines()
    assert lines[0].startswith("Measured on 2")
    assert lines[2] == "| operators | seconds | against RTAMT |"
