"""Runs that are cut and resumed end with the bits of an undisturbed one."""

import csv
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, SettingsError
from stltool.learning.checkpoint import FORMAT
from stltool.models.environment import Environment
from stltool.reporting import write_history
from tests.conftest import FACTORY
from tests.learning.test_learning import RUNS

SMALL = {"evaluate_every": 4, "memory": 90, "batch": 8, "replays": 20, "seed": 3}


class Cut(Exception):
    pass


def cut_after(episodes):
    def shown(episode, of, steps, probability):
        if episode == episodes:
            raise Cut

    return shown


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_a_cut_run_resumes_to_the_same_bits(patrolling, tmp_path, method, faithful):
    settings = {**SMALL, "episodes": 12, "faithful": faithful}
    whole = stl.learn(patrolling, method, **settings)
    path = tmp_path / "run.ckpt"
    for cut in (3, 7):
        with pytest.raises(Cut):
            stl.learn(
                patrolling,
                method,
                checkpoint=path,
                resume=True,
                checkpoint_every=0,
                progress=cut_after(cut),
                **settings,
            )
    began = time.time()
    resumed = stl.learn(patrolling, method, checkpoint=path, resume=True, **settings)
    assert resumed.history == whole.history
    times = [point.time for point in resumed.history]
    assert times == sorted(times)
    assert times[0] <= began <= times[-1] <= time.time()  # those of the first run are kept
    assert np.array_equal(resumed.policy.table, whole.policy.table)
    assert resumed.counts.seen.tolist() == whole.counts.seen.tolist()
    longer = stl.learn(patrolling, method, checkpoint=path, resume=True, **{**settings, "episodes": 16})
    assert longer.history == stl.learn(patrolling, method, **{**settings, "episodes": 16}).history


@pytest.mark.parametrize("seed", range(2))
def test_a_killed_process_resumes_to_the_same_bits(tmp_path, seed):
    rng = np.random.default_rng(seed)

    def command(name):
        return [
            sys.executable, "-m", "stltool", "learn", str(FACTORY / "patrolling.stl"), "-p", "T=6", "-p", "tau=6",
            "--episodes", "1500", "--seed", "4", "--checkpoint", str(tmp_path / f"{name}.ckpt"), "--resume",
            "--checkpoint-every", "0.02", "--out", str(tmp_path / f"{name}.npz"),
            "--history", str(tmp_path / f"{name}.csv"),
        ]  # fmt: skip

    subprocess.run(command("whole"), check=True, capture_output=True)
    killed = 0
    for _ in range(3):
        with subprocess.Popen(command("cut"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            began = time.monotonic()
            while not (tmp_path / "cut.ckpt").exists() and process.poll() is None and time.monotonic() - began < 60:
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.5))
            process.send_signal(signal.SIGKILL)
        killed += process.returncode == -signal.SIGKILL
    assert killed
    subprocess.run(command("cut"), check=True, capture_output=True)
    assert (tmp_path / "cut.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    with np.load(tmp_path / "cut.npz") as cut, np.load(tmp_path / "whole.npz") as whole:
        assert np.array_equal(cut["table"], whole["table"])


@pytest.fixture
def kept(patrolling, tmp_path):
    path = tmp_path / "run.ckpt"
    stl.learn(patrolling, "cfer", episodes=4, checkpoint=path, **SMALL)
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"method": "naive"}, "its method is 'cfer', here it is 'naive'"),
        ({"seed": 9}, "its seed is 3, here it is 9"),
        ({"replays": 5}, "its replays is 20, here it is 5"),
        ({"episodes": 3}, "4 episodes old already; episodes is 3"),
        ({"resume": False}, r"exists; resume it \(--resume\), or delete it"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(patrolling, kept, change, says):
    given = {"method": "cfer", "episodes": 4, "resume": True, **SMALL, **change}
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, checkpoint=kept, **given)


def test_a_checkpoint_of_another_task_or_model_is_refused(floor5, floor10, kept):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    other = stl.build_product(floor5, stl.parse("G[0,4] F[0,4] A"))
    with pytest.raises(SettingsError, match="its task is 'G"):
        stl.learn(other, "cfer", episodes=4, checkpoint=kept, resume=True, **SMALL)
    with pytest.raises(SettingsError, match="its model is"):
        stl.learn(stl.build_product(floor10, task), "cfer", episodes=4, checkpoint=kept, resume=True, **SMALL)


def test_a_damaged_checkpoint_and_one_of_another_version_are_refused(patrolling, kept):
    data = kept.read_bytes()
    for broken, says in (
        (data[: len(data) // 2], "damaged"),
        (b"not a checkpoint", "damaged"),
        (data.replace(FORMAT.encode(), FORMAT.replace("-1", "-0").encode()), "damaged|stltool-checkpoint-0"),
    ):
        kept.write_bytes(broken)
        with pytest.raises(SettingsError, match=says):
            stl.learn(patrolling, "cfer", episodes=4, checkpoint=kept, resume=True, **SMALL)


def test_a_full_disk_leaves_the_last_checkpoint(patrolling, kept, monkeypatch):
    before = kept.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(FileError, match="cannot be written: No space left on device"):
        stl.learn(patrolling, "cfer", episodes=8, checkpoint=kept, resume=True, checkpoint_every=0, **SMALL)
    assert kept.read_bytes() == before
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_an_unknown_environment_cannot_be_resumed(patrolling, tmp_path):
    with pytest.raises(SettingsError, match="give an Environment with its generator"):
        stl.learn(patrolling, environment=Environment(lambda: 0, lambda i: 0), checkpoint=tmp_path / "x.ckpt")


def test_the_history_goes_to_csv(patrolling, tmp_path):
    run = stl.learn(patrolling, "model-based", episodes=20, evaluate_every=5, seed=0)
    write_history(run, tmp_path / "run.csv")
    rows = list(csv.DictReader((tmp_path / "run.csv").read_text().splitlines()))
    assert [(int(r["episode"]), int(r["steps"]), float(r["probability"])) for r in rows] == [
        (p.episode, p.steps, p.probability) for p in run.history
    ]
