"""`stltool lint`: what may be misread in task files, without their models."""

import json

import pytest

GOOD = 'model "nowhere.toml"\nr := F[0,3] A\nexpect Pmax(r) >= 0.5\n'


@pytest.fixture
def task(tmp_path):
    def write(text, name="task.stl"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def test_a_file_in_order_says_nothing(stltool, task):
    assert stltool("lint", task(GOOD)) == (0, "", "")


def test_what_may_be_misread_is_told_with_exit_code_1(stltool, task):
    code, out, err = stltool("lint", task(GOOD), task("r := a and b or c\nexpect Pmax(r) >= 0\n", "other.stl"))
    assert (code, err) == (1, "")
    assert "other.stl, line 1, column 6: 'and' next to 'or'" in out
    assert "other.stl, line 2, column 1: every probability is from 0 up, so this always holds" in out
    code, out, _ = stltool("lint", task(GOOD), task("expect Pmax(s) > 0\nr := a\n", "other.stl"), "--json")
    first, second = json.loads(out)["files"]
    assert (code, first["advice"], len(second["advice"])) == (1, [], 1)


def test_operators_with_other_definitions_elsewhere_are_notes(stltool, task):
    path = task("r := a U[2,5] b\n")
    code, out, err = stltool("lint", path)
    assert (code, err, out.count("note: ")) == (0, "", 1)
    assert "which is written F[2,2] (a U[0,3] b)" in out
    (file,) = json.loads(stltool("lint", path, "--json")[1])["files"]
    assert (file["advice"], len(file["notes"])) == ([], 1)


def test_what_does_not_parse_ends_with_all_its_faults(stltool, task):
    code, out, err = stltool(
        "lint", task("r := a\nexpect Pmax(r) >= 2\n"), task("s := G[0,T] a\n", "b.stl"), task(GOOD, "c.stl")
    )
    assert (code, out) == (2, "")
    assert "2 is not a probability" in err
    assert "T is not a param" in err
