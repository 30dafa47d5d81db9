"""Sweeps in several processes: the same bytes, whoever is killed."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

import stltool as stl
from stltool.errors import SettingsError
from stltool.learning import pool
from tests.conftest import FACTORY, ROOT
from tests.learning.test_sweep import files

pytest.importorskip("distributed")

# runs long enough to be killed in, whatever their speed: evaluations cost milliseconds each
LONG = f"""
[sweep]
seeds = 7
settings = {{ episodes = 30, evaluate_every = 1 }}
[[method]]
name = "cfer"
faithful = true
[[scenario]]
id = "P"
task = "{FACTORY}/patrolling.stl"
model = "{FACTORY}/floor-10x10.toml"
params = {{ T = 10, tau = 5 }}
"""
CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.fixture(scope="module")
def sweep_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "long.toml"
    path.write_text(LONG)
    return path


@pytest.fixture(scope="module")
def undisturbed(sweep_file, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed")
    assert not stl.run_sweep(stl.load_sweep(sweep_file), out, workers=1).failures
    return files(out)


@contextlib.contextmanager
def running(*command, cwd=ROOT):
    """A process group of its own, all of which is gone afterwards."""
    process = subprocess.Popen(
        [sys.executable, *map(str, command)],
        cwd=cwd, start_new_session=True, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def sweeping(sweep_file, out, *options, cwd=ROOT):
    return running("-m", "stltool", "sweep", sweep_file, "--out", out, *options, cwd=cwd)


def wait_for(process, out, count):
    """Until so many results are there, while the process runs."""
    while len(files(out)) < count:
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)


def children(process):
    return [
        child for child in psutil.Process(process.pid).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]  # fmt: skip


def test_killed_at_any_moment_nothing_finished_is_lost(sweep_file, undisturbed, tmp_path):
    with sweeping(sweep_file, tmp_path, "--workers", 2) as client:
        wait_for(client, tmp_path, 1)
        workers = children(client)
        client.kill()
        client.wait()
        early = files(tmp_path)
    assert len(workers) == 2
    assert 1 <= len(early) < len(undisturbed)
    assert all(undisturbed[name] == content for name, content in early.items())
    psutil.wait_procs(workers, timeout=10)
    assert not any(worker.is_running() for worker in workers)  # they do not outlive who asked

    with sweeping(sweep_file, tmp_path, "--workers", 2, "--json") as client:
        wait_for(client, tmp_path, len(early) + 1)
        children(client)[0].kill()  # a worker, in the middle of a run
        out, err = client.communicate(timeout=60)
    assert client.returncode == 0, err
    assert json.loads(out)["runs"] == {"finished": 7, "failed": 0, "all": 7}
    assert files(tmp_path) == undisturbed


def test_an_interrupt_says_how_to_go_on(sweep_file, undisturbed, tmp_path):
    with sweeping(sweep_file, tmp_path, "--workers", 2) as client:
        wait_for(client, tmp_path, 1)
        os.killpg(client.pid, signal.SIGINT)  # as a terminal does
        _, err = client.communicate(timeout=60)
    kept = files(tmp_path)
    assert client.returncode == 130
    assert f"interrupted; {len(kept)} of 7 runs are finished and kept: the same command goes on there" in err
    assert "Traceback" not in err
    assert 1 <= len(kept) < 7
    result = stl.run_sweep(stl.load_sweep(sweep_file), tmp_path, workers=1)
    assert (len(result.runs), result.skipped) == (7, len(kept))
    assert files(tmp_path) == undisturbed


def test_a_cluster_that_goes_and_one_that_comes(sweep_file, undisturbed, tmp_path):
    script = tmp_path / "cluster.py"
    script.write_text(CLUSTER)
    (tmp_path / "elsewhere").mkdir()
    out = tmp_path / "out"
    with running(script, cwd=tmp_path / "elsewhere") as cluster:
        address = cluster.stdout.readline().strip()
        with sweeping(sweep_file, "out", "--cluster", address, cwd=tmp_path) as client:
            wait_for(client, out, 1)
            os.killpg(cluster.pid, signal.SIGKILL)
            _, err = client.communicate(timeout=60)
    assert client.returncode == 2
    assert "the connection to the dask scheduler was lost; the same command goes on from here" in err
    assert "Traceback" not in err
    with running(script, cwd=tmp_path / "elsewhere") as cluster:
        address = cluster.stdout.readline().strip()
        with sweeping(sweep_file, "out", "--cluster", address, cwd=tmp_path) as client:
            _, err = client.communicate(timeout=60)
    assert client.returncode == 0, err
    assert files(out) == undisturbed
    assert list((tmp_path / "elsewhere").glob("**/seed-*")) == []  # results come to the client


DEADLY = """
import os
from stltool.learning.pool import spread

def work(item):
    if item == "deadly":
        os._exit(1)
    if item == "faulty":
        raise ValueError("no good")
    return item.upper()

if __name__ == "__main__":
    print(sorted(spread(work, ["deadly", "faulty", "fine"], 3)))
"""
UNGUARDED = """
import sys
import stltool as stl
stl.run_sweep(stl.load_sweep(sys.argv[1]), sys.argv[2], workers=2)
"""


def test_work_that_kills_its_workers_is_given_up(tmp_path):
    script = tmp_path / "deadly.py"
    script.write_text(DEADLY)
    environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert "('deadly', 'its worker process died again and again" in done.stdout, done.stderr
    assert "('faulty', 'the worker could not run it: ValueError: no good')" in done.stdout
    assert "('fine', 'FINE')" in done.stdout


def test_a_script_without_a_guard_is_told_so(sweep_file, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    done = subprocess.run(
        [sys.executable, script, sweep_file, tmp_path / "out"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 1
    assert 'if __name__ == "__main__":' in done.stderr.splitlines()[-1]
    assert files(tmp_path / "out") == {}


def test_clusters_that_do_not_answer(sweep_file, tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "_PATIENCE", 0.2)
    sweep = stl.load_sweep(sweep_file)
    for address, says in [("nonsense", "missing port"), ("x://h:1", "unknown address scheme"), ("", "missing port")]:
        with pytest.raises(SettingsError, match=f"no dask scheduler answers at {address}: {says}"):
            stl.run_sweep(sweep, tmp_path, cluster=address)


def test_what_to_install_where_dask_is_missing(sweep_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SettingsError, match=r"pip install 'stltool\[sweep\]', or take 1 worker"):
        stl.run_sweep(stl.load_sweep(sweep_file), tmp_path, workers=2)


def test_dask_is_imported_only_for_several_processes():
    code = "import sys, stltool as stl; stl.run_sweep; sys.exit('distributed' in sys.modules or 'dask' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(ROOT)).returncode == 0
