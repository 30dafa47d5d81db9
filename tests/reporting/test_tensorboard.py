"""TensorBoard events, read back with TensorBoard's own reader."""

import math
import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

import stltool as stl
from stltool.errors import FileError, MissingExtraError
from stltool.learning.trainer import Point
from stltool.reporting.tensorboard import require_tensorboard, write_tensorboard

pytest.importorskip("tensorboard", reason="TensorBoard is not installed")
from tensorboard.backend.event_processing.event_multiplexer import EventMultiplexer
from tensorboard.plugins.hparams import metadata


def read(folder):
    """All runs of a folder by name, as TensorBoard would show them."""
    found = EventMultiplexer().AddRunsFromDirectory(str(folder)).Reload()
    return {run: found.GetAccumulator(run) for run in found.Runs()}


@pytest.fixture
def training(patrolling):
    return stl.learn(patrolling, "model-based", episodes=20, evaluate_every=5, seed=3)


def test_a_curve_with_its_times(training, tmp_path):
    before = training.history[0].time
    run = write_tensorboard(training, tmp_path / "events")
    [(name, events)] = read(tmp_path / "events").items()
    assert tmp_path / "events" / name == run
    assert name.startswith("patrolling-model-based-seed3-")
    assert [path.parent for path in tmp_path.rglob("*tfevents*")] == [run]
    scalars = {tag: events.Scalars(tag) for tag in events.Tags()["scalars"]}
    assert set(scalars) == {"episode", "probability/P", "probability/1-P", "probability/log10(1-P)"}
    for found in scalars.values():
        assert [event.step for event in found] == [point.steps for point in training.history]
        assert [event.wall_time for event in found] == [point.time for point in training.history]
    assert 0 < time.time() - before < 600  # real ones
    assert [event.value for event in scalars["episode"]] == [point.episode for point in training.history]
    assert [event.value for event in scalars["probability/P"]] == pytest.approx(
        [point.probability for point in training.history]
    )


def test_what_is_left_to_one_is_seen(training, tmp_path):
    """In single precision 1 − 1e-9 is 1."""
    values = [0.25, 1 - 1e-6, 1 - 1e-9, 1 - 2**-53, 1.0]
    history = [Point(i, 10 * i, p, 1.7e9 + i) for i, p in enumerate(values)]
    write_tensorboard(replace(training, history=history), tmp_path)
    [events] = read(tmp_path).values()
    rest = [event.value for event in events.Scalars("probability/1-P")]
    assert rest == pytest.approx([0.75, 1e-6, 1e-9, 2**-53, 0.0], rel=1e-6, abs=0)
    logarithms = [event.value for event in events.Scalars("probability/log10(1-P)")]
    assert logarithms == pytest.approx([math.log10(0.75), -6, -9, -15.9546, -15.9546], abs=1e-4)
    assert events.Scalars("probability/P")[2].value == 1  # the reason for the others


def test_a_second_run_is_another_curve(training, tmp_path):
    first, second, third = (write_tensorboard(training, tmp_path) for _ in range(3))
    assert len({first, second, third}) == 3
    runs = read(tmp_path)
    assert {tmp_path / name for name in runs} == {first, second, third}
    for events in runs.values():
        assert len(events.Scalars("probability/P")) == len(training.history)


def test_method_and_settings_are_hyperparameters(training, tmp_path):
    write_tensorboard(training, tmp_path)
    [events] = read(tmp_path).values()
    content = events.SummaryMetadata(metadata.SESSION_START_INFO_TAG).plugin_data.content
    start = metadata.parse_session_start_info_plugin_data(content)
    assert start.hparams["method"].string_value == "model-based"
    assert start.hparams["seed"].number_value == 3
    assert start.start_time_secs == training.history[0].time
    [text] = events.Tensors("task")
    assert text.tensor_proto.string_val[0].decode().strip().startswith("patrolling := G[0,4]")


def test_a_black_box_has_no_probability(training, tmp_path):
    history = [replace(point, probability=None) for point in training.history]
    write_tensorboard(replace(training, history=history), tmp_path)
    [events] = read(tmp_path).values()
    assert events.Tags()["scalars"] == ["episode"]


def test_where_nothing_can_be_written_is_told_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "events"):
        with pytest.raises(FileError, match="cannot create the results folder"):
            require_tensorboard(folder)
    require_tensorboard(tmp_path / "new" / "events")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]  # trying leaves nothing
    if Path("/proc/self").is_dir():
        with pytest.raises(FileError, match="cannot create the results folder: /proc: "):
            require_tensorboard("/proc/events")  # not even for root

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match=r"cannot create the results folder: .*: No space left on device; name another"):
        require_tensorboard(tmp_path / "events")


def test_a_disk_that_gets_full_leaves_no_half_file(training, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("stltool.reporting.tensorboard.require_folder", lambda folder: None)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match="cannot be written: No space left on device"):
        write_tensorboard(training, tmp_path)
    assert not list(tmp_path.iterdir())  # an empty folder would be listed as a run


def test_without_tensorboard_its_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tensorboard", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'stltool\[tensorboard\]'"):
        require_tensorboard(tmp_path)
