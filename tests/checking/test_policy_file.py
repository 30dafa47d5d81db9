"""Policies that go to disk while they are found: the same as in memory, resumed after any stop; damaged files."""

import json
import os
import subprocess
import sys
import time
from importlib import import_module

import numpy as np
import pytest

import stltool as stl
from stltool.checking.induction import recording
from stltool.errors import FileError, PolicyError, SettingsError
from stltool.layered import read_layers
from tests.checking.test_induction import wide_product
from tests.conftest import ROOT

ENGINES = ("nodes", "words")


@pytest.fixture(scope="module")
def product():
    return wide_product(1)


class Stop(Exception):
    """Instead of a kill."""


class Asks:
    """Its pickle makes a folder when it is read."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def stop_after(monkeypatch, n):
    """The process ends after so many steps back."""
    passed, seen = recording.OnDisk.passed, []

    def counted(self, at):
        passed(self, at)
        seen.append(at)
        if len(seen) == n:
            raise Stop

    monkeypatch.setattr(recording.OnDisk, "passed", counted)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("options", [{}, {"arithmetic": "double"}, {"maximize": False}, {"exact": True}], ids=str)
def test_the_policy_on_disk_is_the_one_in_memory(patrolling, tmp_path, engine, options):
    wanted = stl.check(patrolling, engine=engine, **options)
    path = tmp_path / "best.policy"
    found = stl.check(patrolling, engine=engine, policy_file=path, **options)
    assert (found.probability, found.lower, found.upper) == (wanted.probability, wanted.lower, wanted.upper)
    assert os.listdir(tmp_path) == ["best.policy"]
    for policy in (found.policy, stl.load_policy(path, patrolling)):
        assert np.array_equal(policy.table, wanted.policy.table)
        assert stl.check(patrolling, policy).probability == stl.check(patrolling, wanted.policy).probability


def test_saving_and_loading_is_the_identity(patrolling, tmp_path):
    best = stl.check(patrolling).policy
    best.save(tmp_path / "best.policy")
    again = stl.load_policy(tmp_path / "best.policy", patrolling)
    for mine, theirs in zip(best.form.arrays().values(), again.form.arrays().values(), strict=True):
        assert np.array_equal(mine, theirs)
    again.save(tmp_path / "again.npz")
    assert np.array_equal(stl.load_policy(tmp_path / "again.npz", patrolling).table, best.table)
    with pytest.raises(PolicyError, match=r"\.policy files are for policies found by check"):
        stl.Policy(patrolling, best.table).save(tmp_path / "dense.policy")


@pytest.mark.parametrize("after", [1, 2, 11, 26])
def test_a_run_that_was_stopped_goes_on_to_the_same_bits(product, tmp_path, monkeypatch, after):
    wanted = stl.check(product, engine="words")
    path = tmp_path / "best.policy"
    with monkeypatch.context() as patch:
        stop_after(patch, after)
        with pytest.raises(Stop):
            stl.check(product, engine="words", policy_file=path, save_every=0)
    assert not path.exists()
    steps = []
    found = stl.check(
        product, engine="words", policy_file=path, resume=True, progress=lambda done, _: steps.append(done)
    )
    assert (found.probability, found.lower, found.upper) == (wanted.probability, wanted.lower, wanted.upper)
    assert found.sweeps == wanted.sweeps
    assert len([n for n in steps if n > product.horizon]) <= wanted.sweeps - after
    assert np.array_equal(found.policy.table, wanted.policy.table)
    assert sorted(os.listdir(tmp_path)) == ["best.policy"]


def stopped(product, path, monkeypatch, after=5, **options):
    """A run is stopped, and leaves these files."""
    with monkeypatch.context() as patch:
        stop_after(patch, after)
        with pytest.raises(Stop):
            stl.check(product, engine="words", policy_file=path, save_every=0, **options)
    return {name: (path.parent / name).read_bytes() for name in os.listdir(path.parent)}


def test_work_of_a_stopped_run_is_never_replaced(product, patrolling, tmp_path, monkeypatch):
    path = tmp_path / "best.policy"
    files = stopped(product, path, monkeypatch)
    assert sorted(files) == ["best.policy.partial", "best.policy.state"]
    for asked, options, message in (
        (product, {}, "holds a stopped run; resume it"),
        (product, {"resume": True, "maximize": False}, "a stopped run with another task"),
        (product, {"resume": True, "arithmetic": "double"}, "a stopped run with another task"),
        (patrolling, {"resume": True}, "a stopped run with another task"),
    ):
        with pytest.raises(SettingsError, match=message):
            stl.check(asked, engine="words", policy_file=path, **options)
    stl.check(product).policy.save(path)
    path.unlink()
    assert files == {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    (tmp_path / "mine.policy.partial").write_text("my own notes")
    with pytest.raises(FileError, match=r"mine\.policy\.partial: .* would be lost"):
        stl.check(product, policy_file=tmp_path / "mine.policy")
    assert (tmp_path / "mine.policy.partial").read_text() == "my own notes"


def test_doubles_after_fixed_point_are_resumed_as_doubles(patrolling, tmp_path, monkeypatch):
    """Where fixed point has too few digits, doubles follow: a run stopped in these does not begin in the other."""
    monkeypatch.setattr(import_module("stltool.checking.check"), "_SHARP", -1.0)
    first = stl.check(patrolling, engine="words", arithmetic="fixed")
    wanted = stl.check(patrolling, engine="words")
    assert (wanted.arithmetic, wanted.certain) == ("double", False)
    path = tmp_path / "best.policy"
    stopped(patrolling, path, monkeypatch, after=first.sweeps + 5)
    begun = []
    writer = recording.LayeredWriter.__init__
    monkeypatch.setattr(
        recording.LayeredWriter, "__init__", lambda self, *given: (begun.append(given[-1]), writer(self, *given))[1]
    )
    found = stl.check(patrolling, engine="words", policy_file=path, resume=True)
    assert (found.lower, found.upper, found.sweeps) == (wanted.lower, wanted.upper, wanted.sweeps)
    assert len(begun) == 1
    assert begun[0]
    assert np.array_equal(found.policy.table, wanted.policy.table)


def test_an_interrupt_saves_what_is_needed_to_go_on(product, tmp_path, monkeypatch):
    """It comes amid a step, when a layer is in the file already, and long before the next state is due."""
    wanted, path = stl.check(product, engine="words"), tmp_path / "best.policy"
    add, added = recording.OnDisk.add, []

    def interrupted(self, listed):
        add(self, listed)
        added.append(listed)
        if len(added) == 7:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(recording.OnDisk, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            stl.check(product, engine="words", policy_file=path)
    assert sorted(os.listdir(tmp_path)) == ["best.policy.partial", "best.policy.state"]
    steps = []
    found = stl.check(
        product, engine="words", policy_file=path, resume=True, progress=lambda done, _: steps.append(done)
    )
    assert (found.probability, found.lower, found.upper) == (wanted.probability, wanted.lower, wanted.upper)
    assert len([n for n in steps if n > product.horizon]) <= wanted.sweeps - 6
    assert np.array_equal(found.policy.table, wanted.policy.table)
    assert os.listdir(tmp_path) == ["best.policy"]


@pytest.mark.parametrize("engine", ENGINES)
def test_an_end_before_the_first_state_leaves_nothing(patrolling, tmp_path, monkeypatch, engine):
    monkeypatch.setattr(recording.OnDisk, "add", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        stl.check(patrolling, engine=engine, policy_file=tmp_path / "best.policy")
    assert os.listdir(tmp_path) == []


def test_folders_are_made_and_links_followed(patrolling, tmp_path):
    deep, link = tmp_path / "a" / "b" / "best.policy", tmp_path / "link.policy"
    link.symlink_to(deep)
    found = stl.check(patrolling, policy_file=link)
    assert (link.is_symlink(), os.listdir(deep.parent)) == (True, ["best.policy"])
    written = deep.read_bytes()
    deep.unlink()
    found.policy.save(link)
    assert (link.is_symlink(), os.listdir(deep.parent)) == (True, ["best.policy"])
    assert deep.read_bytes() == written


@pytest.mark.soak(only=True)
def test_a_killed_process_leaves_what_the_next_one_goes_on_from(tmp_path):
    """SIGKILL, whenever it comes: nothing half-written is taken for whole."""
    floor = ROOT / "examples" / "factory" / "floor-10x10.toml"
    (tmp_path / "task.stl").write_text(f'model "{floor}"\ntask := G[0,400] ((F[0,30] A) & (F[0,30] B))\n')
    code = (
        "import sys, stltool as stl; task = stl.load_task(sys.argv[1]); "
        "p = stl.build_product(stl.load_model(task.model), task); "
        "print(stl.check(p, engine='words', policy_file='best.policy', resume=True, save_every=0).probability)"
    )
    command = [sys.executable, "-c", code, "task.stl"]
    killed = 0
    for pause in (0.1, 0.4):
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 60
        while process.poll() is None and not (tmp_path / "best.policy.state").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(pause)
        killed += process.poll() is None
        process.kill()
        process.wait()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    task = stl.load_task(tmp_path / "task.stl")
    asked = stl.build_product(stl.load_model(task.model), task)
    wanted = stl.check(asked)
    assert float(done.stdout) == wanted.probability
    assert killed
    policy = stl.load_policy(tmp_path / "best.policy", asked)
    for t in range(0, asked.horizon, 50):
        assert np.array_equal(policy.row(t), wanted.policy.row(t))


# ------------------------------------------------------------------------------------------------- bad input


def test_what_does_not_fit_together_is_refused(patrolling, tmp_path):
    path = tmp_path / "best.policy"
    best = stl.check(patrolling, policy_file=path)
    for options, message in (
        ({"policy_file": tmp_path / "p.npz"}, "needs the suffix .policy; rename it"),
        ({"policy_file": path, "keep_policy": False}, "is for the optimal policy, which is not kept here"),
        ({"resume": True}, "needs policy_file"),
    ):
        with pytest.raises(SettingsError, match=message):
            stl.check(patrolling, **options)
    with pytest.raises(SettingsError, match="is for the optimal policy"):
        stl.check(patrolling, best.policy, policy_file=tmp_path / "q.policy")
    (tmp_path / "mine.policy").write_text("my own notes")
    with pytest.raises(FileError, match="does not contain a policy"):
        stl.check(patrolling, policy_file=tmp_path / "mine.policy")
    assert (tmp_path / "mine.policy").read_text() == "my own notes"


def test_damaged_files_are_refused_and_change_nothing(patrolling, tmp_path):
    """Every byte changed, every length cut: a PolicyError, or the same policy, or one that still fits."""
    path, broken = tmp_path / "best.policy", tmp_path / "broken.policy"
    stl.check(patrolling, policy_file=path)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for i in rng.permutation(len(data))[:400].tolist():
        for changed in (data[:i], data[:i] + bytes([data[i] ^ (1 << int(rng.integers(8)))]) + data[i + 1 :]):
            broken.write_bytes(changed)
            try:
                policy = stl.load_policy(broken, patrolling)
            except PolicyError as error:
                assert str(error).startswith(str(broken))
                refused += 1
            else:
                assert 0 <= stl.check(patrolling, policy, engine="words").probability <= 1
    assert refused > 500
    for row in ([0, 0, 1, 0, 0], [0, 0, 0, 10**9, 0], [0, 0, "0", 0, 0], [0, 0, 8], [3, 1, 0, 0, 0], [0, 99, 0, 0, 0]):
        at = int.from_bytes(data[-16:-8], "little")
        broken.write_bytes(data[:at] + json.dumps([row]).encode() + data[-16:])
        with pytest.raises(PolicyError):
            stl.load_policy(broken, patrolling)


def test_numbers_of_files_do_not_wrap(patrolling, tmp_path):
    """Numbers that no int64 holds, and ascending ones whose differences wrap round its ends."""
    path, saved = tmp_path / "best.policy", tmp_path / "best.npz"
    best = stl.check(patrolling, policy_file=path).policy
    data = path.read_bytes()
    at = int.from_bytes(data[-16:-8], "little")
    for big in (2**63, 2**70):
        for row in ([big, big, 0, 0, 0], [0, big, 0, 0, 0], [0, 0, 8 * big, 0, 0]):
            path.write_bytes(data[:at] + json.dumps([row]).encode() + data[-16:])
            with pytest.raises(PolicyError):
                stl.load_policy(path, patrolling)
    best.save(saved)
    with np.load(saved) as archive:
        arrays = dict(archive)
    around = [0, 2**63 - 1, -(2**63), -1]
    keys, n = arrays["keys"], arrays["start"][-1]
    many = np.concatenate([around, np.arange(5, 60)])[:n]
    one = {"first": [0], "last": [0], "start": [0, len(many)], "keys": many, "bits": [1] * len(many)}
    for changed in (
        {**one, "choice": np.zeros(len(many), dtype=arrays["choice"].dtype)},
        {**arrays, "start": [*around, n], "first": [0, 1, 2, 3], "last": [0, 1, 2, 3]},
    ):
        typed = {name: np.asarray(array, dtype=arrays[name].dtype) for name, array in changed.items()}
        np.savez(saved, **{**typed, "header": arrays["header"]})
        with pytest.raises(PolicyError, match="choices are inconsistent"):
            stl.load_policy(saved, patrolling)
    assert len(keys) > 4


def test_damaged_states_are_refused(product, tmp_path, monkeypatch):
    path, state = tmp_path / "best.policy", tmp_path / "best.policy.state"
    with monkeypatch.context() as patch:
        stop_after(patch, 9)
        with pytest.raises(Stop):
            stl.check(product, engine="words", policy_file=path, save_every=0)
    with np.load(state) as saved:
        arrays = dict(saved)
    partial = (tmp_path / "best.policy.partial").read_bytes()

    def resumed(changed):
        np.savez(state.with_suffix(".npz"), **changed)
        os.replace(state.with_suffix(".npz"), state)
        (tmp_path / "best.policy.partial").write_bytes(partial)
        return stl.check(product, engine="words", policy_file=path, resume=True)

    wanted = stl.check(product, engine="words").probability
    assert resumed(arrays).probability == wanted
    for name, change in {
        "states": lambda a: a[::-1], "start": lambda a: a + 1, "word": lambda a: a + 1000, "open": lambda a: a[:-1],
        "sure": lambda a: a | arrays["open"], "tiles": lambda a: a * 2, "values": lambda a: a[:-8],
        "sure_choice": lambda a: a[1:], "numbers": lambda a: a[:1],
    }.items():  # fmt: skip
        with pytest.raises(FileError, match="delete it to start again"):
            resumed({**arrays, name: change(arrays[name])})
        with pytest.raises(FileError, match="delete it to start again"):
            resumed({key: array for key, array in arrays.items() if key != name})
        with pytest.raises(FileError, match="delete it to start again"):
            resumed({**arrays, name: arrays[name].astype(np.float32)})
    with pytest.raises(FileError, match="delete it to start again"):  # what a pickle asks for is not done
        resumed({**arrays, "more": np.array([Asks(tmp_path / "done")], dtype=object)})
    assert not (tmp_path / "done").exists()
    state.write_bytes(b"nothing of the kind")
    with pytest.raises(FileError, match="delete it to start again"):
        stl.check(product, engine="words", policy_file=path, resume=True)


def test_layers_are_read_as_views(patrolling, tmp_path):
    stl.check(patrolling, policy_file=tmp_path / "best.policy")
    header, layers = read_layers(tmp_path / "best.policy")
    assert header["format"] == "stltool-policy-2"
    assert all(isinstance(layer.keys.base, np.memmap) or layer.keys.base is not None for layer in layers)
