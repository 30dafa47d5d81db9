"""What is listed as slow is what takes long."""

import subprocess
import sys

from tests import slow


def test_the_longest_are_listed_until_the_others_are_short():
    taken = {"a.py::one": 5.0, "a.py::two": 0.5, "b.py::three": 30.0, "b.py::four": 0.25}
    assert list(slow.lines_of(taken, rest=1)) == [" 30.00 b.py::three\n", "  5.00 a.py::one\n"]
    assert list(slow.lines_of(taken, rest=6)) == [" 30.00 b.py::three\n"]
    assert list(slow.lines_of(taken, rest=40)) == []


def test_parameters_count_together():
    assert slow.of_all_parameters("a.py::one[x[0]-y]") == "a.py::one" == slow.of_all_parameters("a.py::one")


def test_processes_that_a_fixture_keeps_count():
    code = "import time; start = time.process_time()\nwhile time.process_time() < start + 0.3: pass\nprint(); input()"
    before = slow.seconds(["tmp_path", "browser"])
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert slow.seconds(["tmp_path"]) < before + 0.2 <= slow.seconds(["tmp_path", "browser"])
        process.communicate(b"\n")
    assert slow.seconds([]) >= before + 0.2  # it has ended
