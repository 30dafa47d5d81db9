"""`stltool fmt`: files laid out in place, checked, piped; warnings and refusals."""

import io
import sys

import pytest

UNTIDY = "param T=3 # steps\nr:=alw_[0,T] A and B\n"
TIDY = "param T = 3  # steps\nr := (G[0,T] A) & B\n"


@pytest.fixture
def task(tmp_path):
    path = tmp_path / "task.stl"
    path.write_text(UNTIDY)
    return path


def test_files_are_laid_out_in_place(stltool, task):
    code, out, err = stltool("fmt", task)
    assert (code, out) == (0, f"{task}: reformatted\n")
    assert task.read_text() == TIDY
    assert "warning:" in err
    assert "here it means (G[0,T] A) & B" in err
    assert "    r:=alw_[0,T] A and B\n       ^^^" in err
    assert stltool("fmt", task) == (0, "", "")


def test_check_writes_nothing_and_tells_by_its_exit_code(stltool, task):
    code, out, err = stltool("fmt", "--check", task)
    assert (code, out) == (1, f"{task}: would be reformatted\n")
    assert "here it means" in err
    assert task.read_text() == UNTIDY
    task.write_text(TIDY)
    assert stltool("fmt", "--check", task) == (0, "", "")


def test_a_pipe(stltool, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(UNTIDY.encode())))
    code, out, err = stltool("fmt", "-")
    assert (code, out) == (0, TIDY)
    assert "warning: standard input, line 2, column 4" in err
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(UNTIDY.encode())))
    assert stltool("fmt", "--check", "-")[:2] == (1, "standard input: would be reformatted\n")


def test_a_faulty_file_is_left_alone_and_the_others_are_laid_out(stltool, task, tmp_path):
    faulty, missing = tmp_path / "faulty.stl", tmp_path / "missing.stl"
    faulty.write_text("r := A &\nq := § B\n")
    code, out, err = stltool("fmt", faulty, missing, task)
    assert code == 2
    assert out == f"{task}: reformatted\n"
    assert task.read_text() == TIDY
    assert faulty.read_text() == "r := A &\nq := § B\n"
    assert f"error: {faulty}, line 1, column 9: the statement ends here" in err
    assert f"{faulty}, line 2, column 6: unexpected character '§'" in err
    assert f"{missing}: there is no such task file" in err
