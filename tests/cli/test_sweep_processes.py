"""The command `sweep` in several processes: the same bytes, whoever is killed."""

import json
import os
import shlex
import signal
import time

import psutil
import pytest

import stltool as stl
from tests.conftest import ROOT
from tests.learning.test_sweep import files
from tests.processes import LONG, children, running

CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    settings = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "protocol": "tcp://"}
    with LocalCluster(**settings, dashboard_address=":0", silence_logs=50) as cluster:
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


def sweeping(sweep_file, out, *options, cwd=ROOT):
    return running("-m", "stltool", "sweep", sweep_file, "--out", out, *options, cwd=cwd)


def wait_for(process, out, count):
    """Until so many results are there, while the process runs."""
    while len(files(out)) < count:
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)


@pytest.mark.soak(only=True)
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
    assert json.loads(out)["runs"] == {"finished": 6, "failed": 0, "all": 6}
    assert files(tmp_path) == undisturbed


@pytest.mark.soak(only=True)
def test_an_interrupt_says_how_to_go_on(sweep_file, undisturbed, tmp_path):
    with sweeping(sweep_file, tmp_path, "--workers", 2) as client:
        wait_for(client, tmp_path, 1)
        os.killpg(client.pid, signal.SIGINT)  # as a terminal does
        _, err = client.communicate(timeout=60)
    kept = files(tmp_path)
    assert client.returncode == 130
    command = shlex.join(["stltool", "sweep", str(sweep_file), "--out", str(tmp_path), "--workers", "2"])
    assert f"interrupted; {len(kept)} of 6 runs are finished and kept; continue with\n{command}\n" in err
    assert "Traceback" not in err
    assert 1 <= len(kept) < 6
    result = stl.run_sweep(stl.load_sweep(sweep_file), tmp_path, workers=1)
    assert (len(result.runs), result.skipped) == (6, len(kept))
    assert files(tmp_path) == undisturbed


@pytest.mark.soak(only=True)
def test_a_cluster_that_goes_and_one_that_comes(sweep_file, undisturbed, tmp_path):
    pytest.importorskip("distributed")
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
    assert "the connection to the dask scheduler was lost; rerun the same command to continue" in err
    assert "Traceback" not in err
    with running(script, cwd=tmp_path / "elsewhere") as cluster:
        address = cluster.stdout.readline().strip()
        with sweeping(sweep_file, "out", "--cluster", address, cwd=tmp_path) as client:
            _, err = client.communicate(timeout=60)
    assert client.returncode == 0, err
    assert files(out) == undisturbed
    assert list((tmp_path / "elsewhere").glob("**/seed-*")) == []  # results come to the client
