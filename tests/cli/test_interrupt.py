"""Ctrl-C and SIGKILL while learning: what was asked to be kept is kept, and continues to the same bits."""

import json
import shlex
import signal
import subprocess
import sys
import time
from importlib import import_module

import numpy as np
import pytest

import stltool as stl
from tests.conftest import FACTORY, PATROLLING, SMALL


@pytest.fixture
def interrupted(monkeypatch):
    """SIGINT comes in the middle of the fifth episode; `interrupted()` makes the next run an undisturbed one."""
    usual, episodes = stl.ModelBased.episode, []

    def episode(self, state, one):
        episodes.append(one)
        if len(episodes) == 5:
            signal.raise_signal(signal.SIGINT)
        usual(self, state, one)

    monkeypatch.setattr(stl.ModelBased, "episode", episode)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of shells ignore it
    yield lambda: monkeypatch.setattr(stl.ModelBased, "episode", usual)
    signal.signal(signal.SIGINT, previous)


def learning(tmp_path, name, *more):
    out = ["--out", tmp_path / f"{name}.npz", "--history", tmp_path / f"{name}.csv"]
    return ["learn", PATROLLING, *SMALL, "--episodes", 40, "--seed", 3, *out, *more]


def test_learning_is_kept_and_goes_on_by_the_printed_command(stltool, tmp_path, interrupted):
    arguments = learning(tmp_path, "cut one", "--checkpoint", tmp_path / "a run.ckpt")
    code, out, err = stltool(*arguments)
    again = shlex.join(["stltool", *map(str, arguments), "--resume"])
    assert (code, out) == (130, "")
    assert err == f"error: interrupted; the run is kept in {tmp_path / 'a run.ckpt'}; resume it with\n{again}\n"
    assert not (tmp_path / "cut one.npz").exists()
    interrupted()
    code, out, _ = stltool(*shlex.split(again)[1:])
    assert (code, "40 episodes" in out) == (0, True)
    assert stltool(*learning(tmp_path, "whole"))[0] == 0
    with np.load(tmp_path / "cut one.npz") as cut, np.load(tmp_path / "whole.npz") as whole:
        assert cut.files == whole.files
        assert all(np.array_equal(cut[name], whole[name]) for name in cut.files if name != "header")
    assert (tmp_path / "cut one.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_the_main_job_is_kept_and_goes_on(stltool, tmp_path, interrupted):
    def running(name, *more):
        return ["run", PATROLLING, *SMALL, "-e", 40, "-s", 3, "--rollouts", 50, "-o", tmp_path / name, "--json", *more]

    code, out, err = stltool(*running("cut", "--checkpoint", tmp_path / "run.ckpt"))
    assert (code, out, len(err.splitlines())) == (130, "", 2)
    assert not (tmp_path / "cut").exists()
    interrupted()
    cut = json.loads(stltool(*shlex.split(err.splitlines()[1])[1:])[1])
    whole = json.loads(stltool(*running("whole"))[1])
    for training in (cut["training"], whole["training"]):
        training.pop("seconds")
        for point in training["history"]:
            point.pop("time", None)
    assert cut["training"] == whole["training"]
    assert [row["lower"] for row in cut["guarantees"]] == [row["lower"] for row in whole["guarantees"]]
    assert cut["checks"][1]["probability"] == whole["checks"][1]["probability"]


def test_without_a_checkpoint_it_says_how_to_have_one(stltool, tmp_path, interrupted):
    code, out, err = stltool(*learning(tmp_path, "lost"))
    assert (code, out) == (130, "")
    assert err == "error: interrupted; nothing is kept (with --checkpoint FILE, a run can be resumed)\n"


def test_a_check_that_goes_to_a_file_is_kept_and_goes_on(stltool, tmp_path, monkeypatch):
    """SIGINT comes in the middle of the eighth step back, by the kernels that a large product takes."""
    from stltool.checking.induction import recording

    induct = import_module("stltool.checking.induction.induct")
    add, seen = recording.OnDisk.add, []

    def interrupted(self, listed):
        seen.append(listed)
        if len(seen) in (1, 9):
            signal.raise_signal(signal.SIGINT)
        add(self, listed)

    monkeypatch.setattr(induct, "FEW", 0)
    monkeypatch.setattr(induct, "FEW_LOADED", 0)
    monkeypatch.setattr(induct, "FEW_USED", 0)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    arguments = ["check", PATROLLING, "--save-policy", tmp_path / "a best.policy", "--json"]
    again = shlex.join(["stltool", *map(str, arguments), "--resume"])
    with monkeypatch.context() as patch:
        patch.setattr(recording.OnDisk, "add", interrupted)
        early = stltool(*arguments)
        kept = stltool(*arguments)
    signal.signal(signal.SIGINT, previous)
    assert early == (130, "", "error: interrupted before the first state was saved; there is nothing to resume\n")
    state = tmp_path / "a best.policy.state"
    assert kept == (130, "", f"error: interrupted; the run is kept in {state}; resume it with\n{again}\n")
    code, _, err = stltool(*arguments)
    assert (code, f"{state} holds a stopped run; resume it (--resume), or delete it" in err) == (2, True)
    code, out, _ = stltool(*shlex.split(again)[1:])
    wanted = json.loads(stltool("check", PATROLLING, "--json")[1])
    assert (code, json.loads(out)["probability"]) == (0, wanted["probability"])
    assert [path.name for path in tmp_path.iterdir()] == ["a best.policy"]


@pytest.mark.parametrize("command", ["learn", "run"])
def test_targets_are_tried_before_the_work(stltool, tmp_path, monkeypatch, command):
    monkeypatch.setattr(stl.ModelBased, "episode", lambda *_: pytest.fail("it began to learn"))
    (tmp_path / "file").write_text("")
    (tmp_path / "old.ckpt").write_text("")
    out = tmp_path / ("p.npz" if command == "learn" else "out")
    cases = [
        (["--checkpoint", tmp_path / "file" / "x"], "is not a writable directory"),
        (["--checkpoint", tmp_path], "it is not a regular file"),
        (["--checkpoint", tmp_path / "old.ckpt"], "exists; resume it"),
        (["--resume"], "--resume needs the checkpoint to continue from; give --checkpoint FILE"),
    ]
    if command == "learn":
        cases += [
            (["--history", tmp_path / "file" / "x.csv"], "is not a writable directory"),
            (["--history", tmp_path], "it is not a regular file"),
            (["--tensorboard", tmp_path / "file"], "is not a writable directory"),
        ]
    for options, says in cases:
        code, shown, err = stltool(command, PATROLLING, *SMALL, "--out", out, *options)
        assert (code, shown, says in err) == (2, "", True), (options, err)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "old.ckpt"]


@pytest.mark.soak(only=True)
def test_a_killed_process_resumes_to_the_same_bits(tmp_path):
    """Two processes are killed at some moment after their first checkpoint; this one finishes their work."""
    path, rng, killed = tmp_path / "cut.ckpt", np.random.default_rng(0), 0
    command = [
        sys.executable, "-m", "stltool", "learn", str(FACTORY / "patrolling.stl"), "-p", "T=6", "-p", "tau=6",
        "--method", "cfer", "--episodes", "6000", "--seed", "4",
        "--resume", "--checkpoint-every", "0.02", "--checkpoint", str(path), "--out", str(tmp_path / "cut.npz"),
    ]  # fmt: skip
    for _ in range(2):
        before = path.read_bytes() if path.exists() else b""
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            began = time.monotonic()
            while time.monotonic() - began < 60 and process.poll() is None:
                if path.exists() and path.read_bytes() != before:
                    break
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.1))
            process.send_signal(signal.SIGKILL)
        killed += process.returncode == -signal.SIGKILL
    assert killed  # a slow machine may let one of them finish
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 6, "tau": 6})
    product = stl.build_product(stl.load_model(task.model), task)
    settings = {"episodes": 6000, "seed": 4}
    resumed = stl.learn(product, "cfer", **settings, checkpoint=path, resume=True)
    whole = stl.learn(product, "cfer", **settings)
    assert resumed.history == whole.history
    assert np.array_equal(resumed.policy.table, whole.policy.table)
    assert resumed.counts.seen.tolist() == whole.counts.seen.tolist()
