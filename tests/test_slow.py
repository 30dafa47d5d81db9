"""What is listed as slow is what takes long."""

import subprocess
import sys
from unittest.mock import Mock

import pytest

from tests import conftest, slow


def test_the_longest_are_listed_until_the_others_are_short():
    taken = {"a.py::one": 5.0, "a.py::two": 0.5, "b.py::three": 30.0, "b.py::four": 0.25}
    assert list(slow.lines_of(taken, rest=1)) == [" 30.00 b.py::three\n", "  5.00 a.py::one\n"]
    assert list(slow.lines_of(taken, rest=6)) == [" 30.00 b.py::three\n"]
    assert list(slow.lines_of(taken, rest=40)) == []


def test_parameters_count_together():
    assert slow.of_all_parameters("a.py::one[x[0]-y]") == "a.py::one" == slow.of_all_parameters("a.py::one")


def test_of_many_parameters_those_that_fit_are_kept_and_the_rest_is_for_soak(monkeypatch):
    cases = [f"a.py::one[{i}]" for i in range(20)]
    others = ["a.py::two", *(f"b.py::three[{i}]" for i in range(20)), "b.py::four[0]", "b.py::four[1]"]
    listed = {"a.py::one": 3.0, "a.py::two": 9.0, "b.py::four": 9.0}
    found = slow.beyond([*cases, *others], listed, cases=0.3)
    assert found == slow.beyond([*cases, *others], listed, cases=0.3)
    assert {name: len(names) for name, names in found.items()} == {"a.py::one": 18, "b.py::four": 1}
    assert set(found["a.py::one"]) < set(cases)
    assert slow.beyond([*cases, *others], listed, cases=9) == {}

    monkeypatch.delenv(slow._OUT, raising=False)
    monkeypatch.setattr(slow, "listed", lambda: listed)
    few = 20 - len(slow.beyond(cases, listed)["a.py::one"])
    for more, args, kept in ((0.1, ["tests"], few), (conftest.WHOLE, ["tests"], 20), (0.1, ["a.py::one"], 20)):
        monkeypatch.setattr(conftest, "MORE", more)
        items = [Mock(nodeid=name, iter_markers=lambda _: []) for name in cases]
        conftest.pytest_collection_modifyitems(Mock(args=args), items)
        assert len(items) == kept
        assert all({mark.args[0] for mark in item.add_marker.mock_calls} == {"slow", "soak"} for item in items)
    monkeypatch.setenv(slow._OUT, "folder")
    monkeypatch.setattr(conftest, "MORE", 0.1)
    items = [Mock(nodeid=name, iter_markers=lambda _: []) for name in cases]
    conftest.pytest_collection_modifyitems(Mock(args=["tests"]), items)
    assert len(items) == 20


def test_processes_that_a_fixture_keeps_count():
    code = "import time; start = time.process_time()\nwhile time.process_time() < start + 0.3: pass\nprint(); input()"
    before = slow.seconds(["tmp_path", "browser"])
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert slow.seconds(["tmp_path"]) < before + 0.2 <= slow.seconds(["tmp_path", "browser"])
        process.communicate(b"\n")
    assert slow.seconds([]) >= before + 0.2  # it has ended


@pytest.mark.parametrize(
    ("more", "named", "kept"),
    [(0.2, "tests", ["usual", "more"]), (0.2, "tests/a.py::alone", ["usual", "more", "alone"]),
     (2, "tests", ["usual", "more", "alone"])],
)  # fmt: skip
def test_what_soak_runs_alone_is_left_out_unless_it_is_named(monkeypatch, more, named, kept):
    monkeypatch.setattr(conftest, "MORE", more)
    marks = {"usual": [], "more": [pytest.mark.soak.mark], "alone": [pytest.mark.soak(only=True).mark]}
    items = [Mock(nodeid=f"tests/a.py::{name}", iter_markers=lambda _, own=own: own) for name, own in marks.items()]
    config = Mock(args=[named])
    conftest.pytest_collection_modifyitems(config, items)
    assert [item.nodeid.partition("::")[2] for item in items] == kept
    left_out = [item for call in config.hook.pytest_deselected.mock_calls for item in call.kwargs["items"]]
    assert len(left_out) == 3 - len(kept)
