"""Every page of docs/ tells the truth: its commands print what stands there, its programs run.

Programs whose output the page shows, too, are claims: tests/test_claims.py runs those and compares it.
"""

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

import stltool as stl
from stltool import cli
from tests.conftest import ROOT
from tests.test_claims import BOOK

PROSE = {
    "architecture", "comparison", "falsification", "index", "models", "references", "semantics", "supported", "testing",
}  # fmt: skip
PAGES = sorted((ROOT / "docs").glob("*.md"))
LONG = {"falsification", "sweeps"}  # seconds each


def pages_to_run():
    return [
        pytest.param(page, id=page.stem, marks=[pytest.mark.soak(only=True)] if page.stem in LONG else [])
        for page in PAGES
    ]


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the examples, as a checkout has them."""
    (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # programs import others that the page has its reader save
    before = set(stl.trace_readers)
    yield tmp_path
    for kind in set(stl.trace_readers) - before:  # a page's own, which no other test knows
        del stl.trace_readers[kind]


def claimed(page):
    """The numbers of the page's programs that are claims."""
    commands = [command for claim in BOOK.claims if claim.kind == "quick" for command in claim.command]
    program = re.compile(rf"python -c .*docs/{page.stem}\.md.*re\.S\)\[(\d+)\]")
    return {int(found[1]) for found in map(program.match, commands) if found}


def test_there_are_pages_with_commands():
    assert {page.stem for page in PAGES} >= {"certificates", "reproduction"}
    assert {page.stem for page in PAGES if not blocks(page, "console")} <= PROSE


def saved(page):
    """The files that a page tells its reader to save, by name."""
    found = re.findall(
        r"Save this as `([^`]+)`:\n\n```\w*\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    for name, content in found:
        Path(name).write_text(content, encoding="utf-8")
    return dict(found)


def test_the_tutorial_s_files_are_those_of_the_example(folder):
    for name, text in saved(ROOT / "docs" / "tutorial.md").items():
        example = (ROOT / "examples" / "ward" / name).read_text(encoding="utf-8")
        assert example.endswith(text), name


def comparable(text):
    """Without what differs from run to run: seconds, and spaces at the ends of lines."""
    return [re.sub(r"\b\d+(\.\d+)? s\b", "# s", line).rstrip() for line in text.strip().splitlines()]


@pytest.mark.parametrize("page", pages_to_run())
def test_commands_print_what_the_page_shows(page, folder, capsys, monkeypatch):
    saved(page)
    for block in blocks(page, "console"):
        for command, shown in re.findall(r"^\$ (stltool .*)\n((?:(?!\$ ).*\n)*)", block, flags=re.MULTILINE):
            monkeypatch.setattr(sys, "argv", shlex.split(command))
            with pytest.raises(SystemExit):
                cli.main()
            assert comparable(capsys.readouterr().out) == comparable(shown), command


@pytest.mark.parametrize("page", pages_to_run())
def test_programs_run(page, folder):
    saved(page)
    for i, code in enumerate(blocks(page, "python")):
        if i not in claimed(page):
            (folder / "program.py").write_text(code, encoding="utf-8")
            runpy.run_path("program.py", run_name="__main__")


def test_programs_that_are_claims_are_found():
    assert {page.stem: claimed(page) for page in PAGES if claimed(page)} == {
        "counterfactuals": {0}, "falsification": {0, 3}, "stationary": {0}, "surrogate": {0}, "testing": {2, 3},
        "why": {0},
    }  # fmt: skip
