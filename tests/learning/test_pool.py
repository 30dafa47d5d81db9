"""Work shared out to processes of this machine or of a cluster."""

import errno
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import psutil
import pytest

import stltool as stl
from stltool.errors import MissingExtraError, SettingsError
from stltool.learning import pool
from tests.conftest import ROOT
from tests.learning.test_sweep import files
from tests.processes import LONG, children, running


@pytest.fixture(scope="module")
def sweep_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "long.toml"
    path.write_text(LONG)
    return path


DEADLY = """
import os, sys
from stltool.learning.pool import spread

def work(item):
    with open(sys.argv[1], "a") as log:
        print(item, file=log)
    if item == "deadly":
        os._exit(1)
    if item == "faulty":
        raise ValueError("no good")
    return item.upper()

if __name__ == "__main__":
    items = ["deadly", "faulty", *(f"fine{i}" for i in range(6))]
    for item, result in sorted(spread(work, items, 2)):
        print(f"{item}: {result}")
"""
UNGUARDED = """
import sys
import stltool as stl
stl.run_sweep(stl.load_sweep(sys.argv[1]), sys.argv[2], workers=2)
"""


@pytest.mark.soak(only=True)
def test_work_that_kills_its_workers_is_given_up(tmp_path):
    script = tmp_path / "deadly.py"
    script.write_text(DEADLY)
    log = tmp_path / "log"
    done = subprocess.run([sys.executable, script, log], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split("; ")[0] for line in done.stdout.splitlines()] == [
        "deadly: its worker process died repeatedly", "faulty: the worker could not run it: ValueError: no good",
        *(f"fine{i}: FINE{i}" for i in range(6)),
    ]  # fmt: skip
    lines = sorted(log.read_text().splitlines())
    assert lines == sorted([*["deadly"] * 3, "faulty", *(f"fine{i}" for i in range(6))])  # nothing else is done twice


@pytest.mark.soak(only=True)
def test_a_script_without_a_guard_is_told_so(sweep_file, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    done = subprocess.run(
        [sys.executable, script, sweep_file, tmp_path / "out"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 1
    assert 'if __name__ == "__main__":' in done.stderr.splitlines()[-1]
    assert files(tmp_path / "out") == {}


WITHOUT_DASK = """
import sys
sys.modules["dask"] = sys.modules["distributed"] = None
import stltool as stl
if __name__ == "__main__":
    sweep = stl.load_sweep(sys.argv[1]).select(seeds=2)
    assert len(stl.run_sweep(sweep, sys.argv[2], workers=2).runs) == 2
"""
INHERITED = """
import os, signal, sys, threading
from stltool.learning.pool import spread

def seen(_):
    threads = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN, set(threads.values())

if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"], before = "7", threading.active_count()
    for _, found in spread(seen, [1, 2, 3], 2):
        assert found == (True, {"1"}), found
    assert os.environ["OMP_NUM_THREADS"] == "7" and "OPENBLAS_NUM_THREADS" not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert threading.active_count() == before
"""


@pytest.mark.parametrize(
    "program",
    [pytest.param(WITHOUT_DASK, marks=pytest.mark.soak(only=True)), INHERITED],
    ids=["without dask", "inherited"],
)
def test_processes_of_this_machine(sweep_file, tmp_path, program):
    """They need no dask, have one thread for linear algebra, ignore Ctrl-C; this process stays as it was."""
    script = tmp_path / "script.py"
    script.write_text(program)
    command = [sys.executable, script, sweep_file, tmp_path / "out"]
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert (done.returncode, done.stderr) == (0, "")


ASLEEP = """
import os, sys, time
from stltool.learning.pool import spread

def work(item):
    open(f"{sys.argv[1]}/{item}", "w").close()
    time.sleep(60)

if __name__ == "__main__":
    list(spread(work, ["one", "two"], 2))
"""


@pytest.mark.soak(only=True)
def test_workers_end_with_who_asked(tmp_path):
    """At once, in the middle of work that would go on for long."""
    script = tmp_path / "script.py"
    script.write_text(ASLEEP)
    (tmp_path / "begun").mkdir()
    with running(script, tmp_path / "begun") as process:
        while len(list((tmp_path / "begun").iterdir())) < 2:
            assert process.poll() is None, process.communicate()
            time.sleep(0.005)
        workers = children(process)
        process.kill()
        process.wait()
        assert len(workers) == 2
        assert psutil.wait_procs(workers, timeout=20)[1] == []


@pytest.mark.soak(only=True)
def test_what_is_given_up_ends_at_once():
    """Closing the iterator ends processes in the middle of their work, and waits for none of it."""
    before = set(psutil.Process().children())
    outcomes = pool.spread(time.sleep, [0, 60, 60], 2)
    assert next(outcomes) == (0, None)
    assert set(psutil.Process().children()) > before
    start = time.perf_counter()
    outcomes.close()
    assert time.perf_counter() - start < 10
    assert not any("spawn_main" in " ".join(child.cmdline()) for child in psutil.Process().children())


def test_a_process_that_cannot_start_is_told(monkeypatch):
    def no_more(*_):
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(ProcessPoolExecutor, "submit", no_more)
    with pytest.raises(SettingsError, match="did not start: Resource temporarily unavailable; use fewer workers"):
        list(pool.spread(str, [1, 2], 2))


def test_clusters_that_do_not_answer(sweep_file, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("stltool.cluster._PATIENCE", 0.2)
    sweep = stl.load_sweep(sweep_file)
    for address, says in [("nonsense", "missing port"), ("x://h:1", "unknown address scheme"), ("", "missing port")]:
        with pytest.raises(SettingsError, match=f"no dask scheduler answers at {address}: {says}"):
            stl.run_sweep(sweep, tmp_path, cluster=address)


def test_what_to_install_where_dask_is_missing(sweep_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'stltool\[cluster\]', or give --workers"):
        stl.run_sweep(stl.load_sweep(sweep_file), tmp_path, cluster="tcp://localhost:8786")
