"""Which tests are marked slow, so that the others take a minute: `python -m tests.slow` measures and lists them again.

Of a slow test's parameters, `make test` takes as many as fit into CASES seconds, and `make soak` takes all.

tests/slow.txt has a test a line, the longest first: processor seconds of all its parameters together, on one machine
and one day, with the processes that it starts or that a fixture has started for it.
"""

import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import psutil
import pytest

LIST = Path(__file__).with_name("slow.txt")
REST = 40.0  # processor seconds of all others
CASES = 0.1  # of a slow test, in `make test`: the rest of its parameters is left to `make soak`
KEPT = {"browser", "cluster", "processes"}  # fixtures whose processes go on after a test
_OUT = "STLTOOL_SLOW_OUT"


def listed():
    """The slow tests, as file::function, with the seconds of all their parameters."""
    lines = (line.split() for line in LIST.read_text(encoding="utf-8").splitlines())
    return {name: float(taken) for taken, name in lines}


def beyond(nodeids, listed, cases=CASES):
    """{slow test: those of its parameters that do not fit}, the same ones in every process; at least one fits."""
    parameters = {}
    for nodeid in nodeids:
        if of_all_parameters(nodeid) in listed:
            parameters.setdefault(of_all_parameters(nodeid), []).append(nodeid)
    found = {}
    for name, all_of_it in parameters.items():
        fit = max(1, int(len(all_of_it) * cases / listed[name]))
        if fit < len(all_of_it):
            kept = set(random.Random(name).sample(all_of_it, fit))
            found[name] = [nodeid for nodeid in all_of_it if nodeid not in kept]
    return found


def measured():
    """Whether this process measures, for which all parameters must run."""
    return _OUT in os.environ


def of_all_parameters(nodeid):
    return nodeid.partition("[")[0]


def seconds(fixtures):
    """Of a processor, so far: of this process, those that have ended, and those that these fixtures keep."""
    me, taken = psutil.Process(), 0.0
    for process in [me, *(me.children(recursive=True) if KEPT & set(fixtures) else [])]:
        with contextlib.suppress(psutil.NoSuchProcess):
            taken += sum(process.cpu_times()[:4])
    return taken


class Stopwatch:
    """Of a process that runs tests: what each of them takes."""

    def __init__(self, out):
        self._out, self._taken = out, Counter()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        before = seconds(item.fixturenames)
        ran = yield
        self._taken[of_all_parameters(item.nodeid)] += seconds(item.fixturenames) - before
        return ran

    def pytest_sessionfinish(self):
        (self._out / f"{os.getpid()}.json").write_text(json.dumps(self._taken))


def pytest_configure(config):
    if measured():
        config.pluginmanager.register(Stopwatch(Path(os.environ[_OUT])))


def lines_of(taken, rest=REST):
    """The longest, until the others take no more than `rest`."""
    left = sum(taken.values())
    for name, seconds in sorted(taken.items(), key=lambda entry: (-entry[1], entry[0])):
        if left <= rest:
            return
        left -= seconds
        yield f"{seconds:6.2f} {name}\n"


def main():
    taken = Counter()
    command = [sys.executable, "-m", "pytest", "-n", "2", "-p", "tests.slow"]
    for last in (False, True):  # the first compiles kernels for whichever test comes first
        with tempfile.TemporaryDirectory() as out:
            done = subprocess.run(command, env={**os.environ, _OUT: out})
            assert done.returncode == 0, "the list stays as it was"
            for path in Path(out).iterdir() if last else ():
                taken.update(json.loads(path.read_text()))
    LIST.write_text("".join(lines_of(taken)), encoding="utf-8")


if __name__ == "__main__":
    main()
