"""Runs that are cut and resumed end with the bits of an undisturbed one."""

import copy
import csv
import io
import json
import signal
import time
import tracemalloc
import zipfile

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, SettingsError
from stltool.learning.checkpoint import FORMAT, packed
from stltool.learning.interrupt import interruptible
from stltool.models.environment import Environment, simulator
from stltool.randomness import Purpose, generator
from stltool.reporting import write_history
from tests.conftest import FACTORY, some
from tests.learning.test_learning import RUNS, small

SMALL = {"evaluate_every": 4, "optimism": 0.5, "seed": 3}


class Cut(Exception):
    pass


def cut_after(episodes):
    def shown(episode, of, steps, probability):
        if episode == episodes:
            raise Cut

    return shown


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_a_cut_run_resumes_to_the_same_bits(patrolling, tmp_path, method, faithful):
    settings = {"evaluate_every": 4, "seed": 3, "episodes": 12, "faithful": faithful}
    settings |= small(method, faithful, memory=90, batch=8)
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


def test_a_plan_that_is_held_outlives_the_run(patrolling, tmp_path):
    """After many episodes plans are held for later ones: cut anywhere, those act on the same plan."""
    settings = {"seed": 3, "evaluate_every": 1000}
    whole = stl.learn(patrolling, episodes=400, **settings)
    plans, path = [], tmp_path / "run.ckpt"
    for cut in range(31, 400, 33):
        with pytest.raises(Cut):
            stl.learn(
                patrolling,
                episodes=400,
                checkpoint=path,
                resume=cut > 31,
                checkpoint_every=0,
                progress=cut_after(cut),
                **settings,
            )
        plans.append(np.load(path)["learner plan begins"][0])
    assert set(plans) == {0, 1}
    resumed = stl.learn(patrolling, episodes=400, checkpoint=path, resume=True, **settings)
    assert [rows.tolist() for rows in resumed.counts.in_context] == [rows.tolist() for rows in whole.counts.in_context]
    assert resumed.history == whole.history


@pytest.fixture
def kept(patrolling, tmp_path):
    path = tmp_path / "run.ckpt"
    stl.learn(patrolling, "cfer", episodes=4, checkpoint=path, **SMALL)
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"method": stl.NaiveER(memory=90)}, "its method is 'cfer', here it is 'naive-er'"),
        ({"seed": 9}, "its seed is 3, here it is 9"),
        ({"optimism": 5.0}, "its optimism is 0.5, here it is 5"),
        ({"episodes": 3}, "4 episodes already, and episodes is 3"),
        ({"resume": False}, r"exists; resume it \(resume=True\), or delete it"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(patrolling, kept, change, says):
    given = {"method": "cfer", "episodes": 4, "resume": True, **SMALL, **change}
    if not isinstance(given["method"], str):
        given = {name: value for name, value in given.items() if name != "optimism"}
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
        (data.replace(FORMAT.encode(), b"stltool-checkpoint-0"), "damaged|stltool-checkpoint-0"),
        (data.replace(b'"steps": ', b'"stepz": '), "damaged"),
        (b"", "damaged"),
    ):
        kept.write_bytes(broken)
        with pytest.raises(SettingsError, match=says):
            stl.learn(patrolling, "cfer", episodes=4, checkpoint=kept, resume=True, **SMALL)


# ------------------------------------------------------------------------------------------- changed on purpose


@pytest.fixture(scope="module")
def small_product(floor5):
    return stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl", params={"T": 3, "tau": 3}))


def unpacked(path):
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(arrays.pop("header").tobytes())
    del header["digest"]
    return header, arrays


def changed_values(name, array, rng, published):
    """The array with an entry out of range, or none that the run can have had; its digest will be right."""
    flat = np.flatnonzero(np.isfinite(array.ravel())) if array.dtype.kind == "f" else np.arange(array.size)
    entries = rng.choice(flat, size=min(len(flat), 1), replace=False)
    bad = [np.nan, np.inf, -1e300, 1e300, -1.0] if array.dtype.kind == "f" else [-1, -(2**31), 2**31 - 1]
    if array.dtype == np.int64:
        bad += [-(2**63), 2**63 - 1]
    if array.dtype.kind == "i":
        bad = [value for value in bad if np.iinfo(array.dtype).min <= value <= np.iinfo(array.dtype).max]
    for entry in entries:
        for value in bad:
            if name == "history probability" and np.isnan(value):
                continue  # of a known model refused, tested below
            if name == "history time" and np.isfinite(value):
                continue  # any time may have been
            if name == "learner Q" and value == -1.0 and published:
                continue  # rewards as published may be that low
            again = array.copy()
            again.ravel()[entry] = value
            yield f"{name}[{entry}] = {value}", again


def changed_shapes(array):
    other = {np.dtype(np.float64): np.float32, np.dtype(np.int16): np.int32}.get(array.dtype, np.int16)
    yield "another type", array.astype(other)
    yield "another byte order", array.astype(array.dtype.newbyteorder())
    yield "text", array.astype(str)
    yield "an axis more", array[None]
    if array.ndim > 1:
        yield "flat", array.ravel()
    yield "longer", np.concatenate([array, array[-1:]] if len(array) else [np.zeros(1, array.dtype)])
    if len(array):
        yield "shorter", array[:-1]


@pytest.mark.soak
@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_a_changed_checkpoint_is_never_believed(small_product, tmp_path, method, faithful):
    """Every array of every method: missing, of another shape or type, out of range, and what does not add up."""
    settings = {"seed": 3, "episodes": 6, "evaluate_every": 2, "faithful": faithful}
    settings |= small(method, faithful, memory=60, batch=8)
    if method == "cfer" and faithful:
        settings["factual_share"] = 0.5
    path = tmp_path / "run.ckpt"
    whole = stl.learn(small_product, method, checkpoint=path, **settings)
    header, arrays = unpacked(path)
    rng = np.random.default_rng(0)

    def resume():
        return stl.learn(small_product, method, checkpoint=path, resume=True, **settings)

    def refused(case, arrays=arrays, **changes):
        path.write_bytes(packed({**header, **changes}, arrays))
        with pytest.raises(SettingsError, match="damaged"):
            pytest.fail(f"{case} was believed: {resume()}")

    for name, array in arrays.items():
        refused(f"no {name}", {other: one for other, one in arrays.items() if other != name})
        for what, again in some([*changed_shapes(array), *changed_values(name, array, rng, faithful)]):
            refused(f"{name}: {what}", {**arrays, name: again})
    refused("one more", {**arrays, "learner X": np.zeros(3)})
    seen = arrays["counts seen"].copy()
    seen[0] += 1
    refused("counts", {**arrays, "counts seen": seen})
    values = arrays["history probability"].copy()
    values[0] = np.nan
    refused("an evaluation without a value", {**arrays, "history probability": values})
    for changes in (
        {"episode": 5}, {"episode": -1}, {"episode": 2.0}, {"episode": True}, {"episode": None}, {"steps": 0},
        {"steps": header["steps"] + 1}, {"steps": 2**80}, {"status": "over"}, {"status": "nothing to learn"},
        {"status": []}, {"generators": []}, {"generators": header["generators"][:1]}, {"generators": [1, 2]},
        {"generators": header["generators"][::-1]}, {"what": 5}, {"more": 1},
    ):  # fmt: skip
        refused(str(changes), **changes)
    for place, entry, value in (
        ("state", "state", 2**128), ("state", "state", -1), ("state", "state", "1"), ("state", "inc", 4),
        (None, "has_uint32", 2), (None, "uinteger", -1), (None, "bit_generator", "MT19937"),
    ):  # fmt: skip
        generators = copy.deepcopy(header["generators"])
        (generators[1][place] if place else generators[1])[entry] = value
        refused(f"{entry} = {value}", generators=generators)

    path.write_bytes(packed(header, arrays))
    again = resume()
    assert (again.history, again.counts.seen.tolist()) == (whole.history, whole.counts.seen.tolist())
    assert np.array_equal(again.policy.table, whole.policy.table)


@pytest.mark.parametrize(
    ("method", "name", "change"),
    [
        ("naive", "visits", "one more"), ("naive", "V", "one more"), ("naive", "Q", "one more"),
        ("naive-er", "visits", "one more"), ("naive-er", "memory", "other rows"),
    ],
)  # fmt: skip
def test_arrays_that_contradict_each_other(small_product, tmp_path, method, name, change):
    """All values in their ranges: sums against each other, best values against values, rows against counts."""
    path, settings = tmp_path / "run.ckpt", {"seed": 3, "episodes": 6, **small(method, False, memory=60, batch=8)}
    stl.learn(small_product, method, checkpoint=path, **settings)
    header, arrays = unpacked(path)
    array = arrays[f"learner {name}"].copy()
    if change == "other rows":
        array[:5] = np.roll(array[:5], 1, axis=1) % (np.array([2, 2, 2, 2, 2, 2])[: array.shape[1]])
    elif array.dtype.kind == "f":
        array[array < 0.5] += 0.25
    else:
        array.ravel()[np.flatnonzero(array)[0]] += 1
    path.write_bytes(packed(header, {**arrays, f"learner {name}": array}))
    with pytest.raises(SettingsError, match="damaged"):
        stl.learn(small_product, method, checkpoint=path, resume=True, **settings)


@pytest.fixture
def uneven():
    """Three states with one, two and three choices, which lead to the first two only."""
    rows = [[[1, 0, 0]], [[1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 1, 0], [0.5, 0.5, 0]]]
    transitions = np.zeros((3, 3, 3))
    for s, choices in enumerate(rows):
        transitions[: len(choices), s] = choices
    model = stl.MDP.from_arrays(transitions, {"x": [0, 1, 2]}, initial=[0.2, 0.4, 0.4], labels={"A": [0, 1, 0]})
    assert np.diff(model.choice_start).tolist() == [1, 2, 3]
    return stl.build_product(model, stl.parse("G[0,3] F[0,3] A"))


def strange_choice(columns):
    """The first transition of the memory is made one of state 0 with its second choice, which it does not have."""

    def change(arrays, name):
        arrays[name][0, columns] = 0, 1

    return change


def strange_memory(arrays, name):
    """The automaton arrives elsewhere, in a state that there is."""
    q = arrays[name][:, -1]
    q[0] = (q[0] + 1) % (q.max() + 1)


def other_place(arrays, name):
    arrays[name][0] += 1


def no_weight(arrays, name):
    arrays[name][0] = 0


def beyond_the_end(arrays, name):
    arrays[name][-1, 0] = 1


def impossible_successor(arrays, name):
    """As often seen, but to a state that no choice leads to."""
    arrays["counts codes"][-1] += 2 - arrays["counts codes"][-1] % 3


def out_of_order(arrays, name):
    for one in ("counts codes", "counts contexts", "counts seen"):
        arrays[one][:2] = arrays[one][1::-1]


@pytest.mark.parametrize(
    ("learner", "name", "change", "says"),
    [
        (stl.PublishedNaiveER(memory=90), "learner rows", strange_memory, "a step that the automaton does not take"),
        (stl.PublishedCfper(memory=900), "learner rows", strange_memory, "a step that the automaton does not take"),
        (
            stl.PublishedNaiveER(memory=90),
            "learner rows",
            strange_choice([0, 2]),
            "a choice that its state does not have",
        ),
        (stl.PublishedNaiveER(memory=90), "learner rows", beyond_the_end, "transitions, and the next one is"),
        (stl.PublishedCfper(memory=900), "learner weight", no_weight, "weight does not fit"),
        (stl.NaiveER(memory=90), "learner memory", strange_choice([1, 3]), "an impossible step"),
        (stl.NaiveER(memory=90), "learner memory", strange_memory, "an impossible step"),
        (stl.NaiveER(memory=90), "learner memory", beyond_the_end, "rows beyond its end"),
        (stl.NaiveER(memory=90), "learner place", other_place, "and the next one is"),
        (stl.ModelBased(), "", impossible_successor, "a transition was counted that the model does not have"),
        (stl.ModelBased(), "", out_of_order, "out of range or out of order"),
    ],
)
def test_rows_that_no_run_can_have(uneven, tmp_path, learner, name, change, says):
    path, settings = tmp_path / "run.ckpt", {"seed": 1, "episodes": 3, "checkpoint": tmp_path / "run.ckpt"}
    stl.learn(uneven, learner, **settings)
    header, arrays = unpacked(path)
    change(arrays, name)
    path.write_bytes(packed(header, arrays))
    with pytest.raises(SettingsError, match=says):
        stl.learn(uneven, learner, resume=True, **settings)


def test_a_checkpoint_changed_within_its_ranges_has_another_digest(small_product, tmp_path):
    path, settings = tmp_path / "run.ckpt", {"seed": 3, "episodes": 6}
    stl.learn(small_product, "cfer", checkpoint=path, **settings)
    header, arrays = unpacked(path)
    times = arrays["history time"] + 1
    path.write_bytes(packed(header, {**arrays, "history time": times}))
    # whoever computes the digest is believed
    stl.learn(small_product, "cfer", checkpoint=path, resume=True, **settings)
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    with path.open("wb") as file:
        np.savez(file, **{**members, "history time": times + 1})
    with pytest.raises(SettingsError, match="its content was changed"):
        stl.learn(small_product, "cfer", checkpoint=path, resume=True, **settings)


@pytest.mark.soak(only=True)
def test_members_are_measured_before_they_are_unpacked(small_product, tmp_path, monkeypatch):
    """A small file whose member unpacks to 64 MB, and one that declares far more than it holds."""
    path, settings = tmp_path / "run.ckpt", {"seed": 3, "episodes": 6}
    stl.learn(small_product, "naive", checkpoint=path, **settings)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def npy(shape, data, dtype="<f8"):
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": dtype, "fortran_order": False, "shape": shape})
        return head.getvalue() + data

    Q = np.lib.format.read_array(io.BytesIO(members["learner Q.npy"])).shape
    zeros = bytes(1 << 26)
    for name, content in (
        ("learner Q", npy((1 << 23,), zeros)), ("learner Q", npy(Q, zeros)), ("learner Q", npy(Q, b"")),
        ("learner Q", npy((1 << 40, 1 << 40), b"")), ("history time", npy((1 << 23,), zeros)),
        ("counts seen", npy((1 << 23,), zeros, "<i8")), ("header", npy((1 << 26,), zeros, "|u1")),
        ("learner Q", npy(Q, b"", "|O")), ("learner Q", b"\x93NUMPY\x02\x00" + zeros[:50]), ("learner Q", b"x"),
    ):  # fmt: skip
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for other, data in {**members, f"{name}.npy": content}.items():
                archive.writestr(other, data)
        tracemalloc.start()
        with pytest.raises(SettingsError, match="damaged"):
            stl.learn(small_product, "naive", checkpoint=path, resume=True, **settings)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 1 << 24, (name, peak)


def test_a_run_with_nothing_to_learn_is_kept_too(floor5, tmp_path):
    product, path = stl.build_product(floor5, stl.parse("F[0,3] !A")), tmp_path / "run.ckpt"
    for resume in (False, True):
        run = stl.learn(product, checkpoint=path, resume=resume)
        assert (run.status, run.history[0].probability) == ("nothing to learn", 1.0)


# ------------------------------------------------------------------------------------------------------ interrupts


def test_an_interrupt_waits_for_the_episodes_end_and_is_kept(patrolling, tmp_path):
    """Ctrl-C in the middle of an episode: the run up to its end is in the checkpoint, and resumes to the same bits."""
    settings = {"episodes": 12, "seed": 4, "evaluate_every": 4}
    whole, path = stl.learn(patrolling, "cfer", **settings), tmp_path / "run.ckpt"
    steps = []
    sampled = simulator(patrolling.model, generator(4, Purpose.LEARNING_ENVIRONMENT))

    def step(action):
        steps.append(action)
        if len(steps) == 20:
            signal.raise_signal(signal.SIGINT)
        return sampled.step(action)

    environment = Environment(sampled.reset, step, sampled.generator)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of shells ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            stl.learn(patrolling, "cfer", environment=environment, checkpoint=path, **settings)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, previous)
    assert len(steps) == 24  # the third episode was finished
    resumed = stl.learn(patrolling, "cfer", checkpoint=path, resume=True, **settings)
    assert (resumed.history, resumed.counts.seen.tolist()) == (whole.history, whole.counts.seen.tolist())
    assert np.array_equal(resumed.policy.table, whole.policy.table)


def test_without_a_checkpoint_an_interrupt_is_immediate(patrolling):
    steps = []

    def step(action):
        steps.append(action)
        signal.raise_signal(signal.SIGINT)
        return 0

    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            stl.learn(patrolling, environment=Environment(lambda: 0, step), episodes=3)
    finally:
        signal.signal(signal.SIGINT, previous)
    assert len(steps) == 1


def test_a_second_interrupt_does_not_wait():
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with interruptible(deferred=True) as interrupt:
            signal.raise_signal(signal.SIGINT)
            assert interrupt.asked
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with interruptible(deferred=True):
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, previous)


def test_a_full_disk_leaves_the_last_checkpoint(patrolling, kept, monkeypatch):
    before = kept.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    def fills(*_):
        monkeypatch.setattr("os.fsync", full)

    again = {"episodes": 8, "checkpoint": kept, "resume": True, "checkpoint_every": 0, **SMALL}
    with pytest.raises(FileError, match="cannot be written: No space left on device"):
        stl.learn(patrolling, "cfer", progress=fills, **again)  # full once the first episode is over
    with pytest.raises(FileError, match="No space left on device"):
        stl.learn(patrolling, "cfer", progress=pytest.fail, **again)  # full from the beginning
    assert kept.read_bytes() == before
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_a_checkpoint_is_tried_before_the_first_episode(patrolling, tmp_path):
    (tmp_path / "file").write_text("")
    for path, says in ((tmp_path / "file" / "x.ckpt", "not a writable directory"), (tmp_path, "not a regular file")):
        with pytest.raises(FileError, match=says):
            stl.learn(patrolling, checkpoint=path, progress=pytest.fail)


def test_generators_of_other_kinds_are_refused(patrolling, tmp_path):
    rng = np.random.Generator(np.random.MT19937(0))
    with pytest.raises(SettingsError, match="the environment's generator is a MT19937; a checkpoint needs one of"):
        stl.learn(patrolling, environment=simulator(patrolling.model, rng), checkpoint=tmp_path / "x.ckpt")


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
