"""Readers of other packages: found by entry points, or given; and MCAP, which is read by the same interface."""

import json

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, MissingExtraError, NameLookupError, SettingsError, TraceError
from tests.cli.conftest import stltool  # noqa: F401 - a fixture
from tests.monitoring.logs.test_formats import plain

READER = """
import numpy as np
import stltool as stl

def read_bag(path, names, time):
    rows = np.array([line.split() for line in path.read_text().splitlines()], float)
    return stl.Recording({"x": rows[:, 1], "y": rows[:, 2]}, times=rows[:, 0], clock=time or "the bag's clock")
"""


def test_a_package_brings_its_reader(stltool, tmp_path, monkeypatch):  # noqa: F811
    """As pip would install it: a module, and metadata with the entry point."""
    (tmp_path / "its_reader.py").write_text(READER)
    (tmp_path / "its_reader-1.0.dist-info").mkdir()
    (tmp_path / "its_reader-1.0.dist-info" / "METADATA").write_text("Name: its-reader\nVersion: 1.0\n")
    (tmp_path / "its_reader-1.0.dist-info" / "entry_points.txt").write_text(
        "[stl.trace_readers]\nbag = its_reader:read_bag\nbroken = its_reader:nothing\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    log = tmp_path / "drive.BAG"
    log.write_text("0 1 5\n0.1 2 6\n0.2 3 nan\n")
    assert {".bag", ".broken", ".mcap"} <= set(stl.trace_readers)
    assert stl.load_trace(log, ["x"], step="0.1s")["x"].tolist() == [1, 2, 3]
    with pytest.raises(TraceError, match="rows 1 and 2: in the bag's clock they are 0.1s apart; the step is 1s"):
        stl.load_trace(log, ["x"], step="1s")
    with pytest.raises(TraceError, match="signal y, row 3: nan is not a finite number"):
        stl.load_trace(log, ["y"], time="none")
    with pytest.raises(NameLookupError, match="there is no signal z; known names: x, y"):
        stl.load_trace(log, ["z"], time="none")
    code, out, _ = stltool("monitor", "x > 1", log, "--step", "0.1s", "--time", "stamp")
    assert code == 1
    assert "clock       stamp, every 0.1s\n" in out
    (tmp_path / "a.broken").touch()
    with pytest.raises(FileError, match="the reader of .broken files, its_reader:nothing, cannot be imported"):
        stl.load_trace(tmp_path / "a.broken")
    log.write_text("not numbers")
    with pytest.raises(FileError, match="drive.BAG: the reader of .bag files failed: ValueError"):
        stl.load_trace(log)


@pytest.mark.parametrize(
    ("returned", "says"),
    [
        ({"x": [1]}, "the reader of .log files returned a dict of 1, not a stl.Recording"),
        (stl.Recording({"x": ["a"]}), "signal x: the reader returned <U1 of shape (1,); samples are"),
        (stl.Recording({"x": []}), "signal x: the reader returned float64 of shape (0,)"),
        (stl.Recording({"x": [1], "y": [1, 2]}), "signal y: its shape is (2,), that of x is (1,); sig"),
        (stl.Recording({"x": [1, 2]}, times=[0]), "signal x: the reader returned another number of times"),
        (stl.Recording({"x": [1, 2]}, times=np.float64(0)), "signal x: the reader returned another number of times"),
        (stl.Recording({"x": [1], "y": [1]}, times={"x": [0]}), "signal y: the reader returned no times for it"),
    ],
)  # fmt: skip
def test_what_a_reader_returns_is_checked(tmp_path, monkeypatch, returned, says):
    monkeypatch.setitem(stl.trace_readers, ".log", lambda path, names, time: returned)
    (tmp_path / "t.log").touch()
    with pytest.raises((FileError, TraceError)) as refused:
        stl.load_trace(tmp_path / "t.log")
    assert says in str(refused.value)


def test_traces_recorded_together_may_share_their_times(tmp_path, monkeypatch):
    batch = stl.Recording({"x": np.arange(6.0).reshape(2, 3)}, times=[0, 1, 2])
    monkeypatch.setitem(stl.trace_readers, ".log", lambda path, names, time: batch)
    (tmp_path / "t.log").touch()
    assert stl.load_trace(tmp_path / "t.log", step="1s")["x"].tolist() == [[0, 1, 2], [3, 4, 5]]


def test_lines_end_with_the_first_signal_of_numbers(tmp_path, monkeypatch):
    """What is true or false stays as it was, as the last of a number does not."""
    times = {"x": [0.0, 2.0], "door": [0.0, 1.0], "y": [0.0, 3.0]}
    own = stl.Recording({"x": [0.0, 4.0], "door": [False, True], "y": [0.0, 3.0]}, times=times)
    monkeypatch.setitem(stl.trace_readers, ".log", lambda path, names, time: own)
    (tmp_path / "t.log").touch()
    found = stl.load_trace(tmp_path / "t.log", step="1s", resample="linear")
    assert {name: values.tolist() for name, values in found.items()} == {
        "x": [0, 2, 4], "door": [False, True, True], "y": [0, 1, 2]
    }  # fmt: skip


def test_a_signal_of_a_single_sample_is_held(tmp_path, monkeypatch):
    own = stl.Recording({"x": [0.0, 4.0], "door": [True]}, times={"x": [0.0, 2.0], "door": [0.0]})
    monkeypatch.setitem(stl.trace_readers, ".log", lambda path, names, time: own)
    (tmp_path / "t.log").touch()
    found = stl.load_trace(tmp_path / "t.log", step="1s", resample="hold")
    assert {name: values.tolist() for name, values in found.items()} == {"x": [0, 0, 4], "door": [True] * 3}


def test_what_can_be_given():
    for extension, reader in ((".csv", len), ("log", len), (3, len), (".log", "text")):
        with pytest.raises(FileError):
            stl.trace_readers[extension] = reader
    assert ".log" not in stl.trace_readers
    with pytest.raises(KeyError):
        stl.trace_readers[".log"]


@pytest.fixture
def drive(tmp_path):
    """Two topics in JSON, at 10 and 4 messages a second, as a robot's logger writes them."""
    writer_of = pytest.importorskip("mcap.writer", reason="mcap is not installed").Writer
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = writer_of(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        odometry = writer.register_channel("/odometry", "json", schema)
        door = writer.register_channel("/door", "json", schema)
        for i in range(11):
            content = {"speed": i / 10, "pose": {"at": [i, -i]}, "note": "text", "ok": i < 5}
            stamp = 10**18 + i * 10**8
            writer.add_message(odometry, stamp, json.dumps(content).encode(), stamp + 5)
        for i in range(5):
            writer.add_message(door, 10**18 + i * 25 * 10**7, json.dumps({"open": i > 1}).encode(), 10**18)
        writer.finish()
    return path


def test_mcap(stltool, drive):  # noqa: F811
    names = ["/odometry.speed", "/odometry.pose.at.1", "/odometry.ok"]
    found = stl.load_trace(drive, names, step="0.1s")
    assert found["/odometry.speed"].tolist() == [i / 10 for i in range(11)]
    assert found["/odometry.pose.at.1"].tolist() == [-i for i in range(11)]
    assert found["/odometry.ok"].tolist() == [i < 5 for i in range(11)]
    assert {*stl.trace_readers[".mcap"](drive, names, None).signals} == {*names}  # no others are kept
    assert stl.load_trace(drive, names, step="0.1s", time="publish_time")["/odometry.speed"][10] == 1
    both = [*names, "/door.open"]
    with pytest.raises(TraceError, match="/door.open were not recorded together; put them on the step's"):
        stl.load_trace(drive, both, step="0.1s")
    with pytest.raises(TraceError, match="its signals were not recorded together; declare a step"):
        stl.load_trace(drive, both)
    for how in ("hold", "linear"):
        found = stl.load_trace(drive, both, step="0.05s", resample=how)
        assert len(found["/door.open"]) == 21
        assert np.flatnonzero(found["/door.open"])[0] == 10  # 0.5 s
        speed = [i / 20 if how == "linear" else i // 2 / 10 for i in range(21)]
        np.testing.assert_allclose(found["/odometry.speed"], speed, atol=1e-15)
    code, out, _ = stltool(
        "monitor", 'G[0,0.2s] ("/door.open" -> "/odometry.speed" > 0.4)', drive, "--step", "0.1s", "--resample", "hold"
    )
    assert code == 0
    assert "log_time, on steps of 0.1s (hold): 11 steps; the longest time without a sample is 0.25s, of /door" in out


ROS = """std_msgs/Header header
float64 speed
float32[2] pair
float64[] ranges
bool ok
string note
uint8 mode
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def test_messages_of_ros_2(tmp_path):
    writer = pytest.importorskip("mcap_ros2.writer", reason="mcap-ros2-support is not installed")
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        log = writer.Writer(file)
        schema = log.register_msgdef("robot_msgs/Odometry", ROS)
        for i in range(5):
            header = {"stamp": {"sec": i, "nanosec": 7}, "frame_id": "map"}
            message = {
                "header": header, "speed": i / 10, "pair": [1, i], "ranges": [i / 4, 2.5], "ok": i < 2, "note": "",
                "mode": i,
            }  # fmt: skip
            log.write_message("/odom", schema, message, 10**18 + i * 10**8, 10**18)
        log.finish()
    found = {name: values.tolist() for name, values in stl.load_trace(path, step="0.1s").items()}
    assert found == {
        "/odom.header.stamp.sec": [0, 1, 2, 3, 4], "/odom.header.stamp.nanosec": [7] * 5,
        "/odom.speed": [0, 0.1, 0.2, 0.3, 0.4], "/odom.pair.0": [1] * 5, "/odom.pair.1": [0, 1, 2, 3, 4],
        "/odom.ranges.0": [0, 0.25, 0.5, 0.75, 1], "/odom.ranges.1": [2.5] * 5,
        "/odom.ok": [True, True, False, False, False], "/odom.mode": [0, 1, 2, 3, 4],
    }  # fmt: skip


def test_messages_of_protobuf(tmp_path):
    """Nested, repeated and keyed fields, as a generated class has them."""
    writer = pytest.importorskip("mcap_protobuf.writer", reason="mcap-protobuf-support is not installed")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    field = descriptor_pb2.FieldDescriptorProto
    described = descriptor_pb2.FileDescriptorProto(name="odometry.proto", package="robot", syntax="proto3")
    pose = described.message_type.add(name="Pose")
    odometry = described.message_type.add(name="Odometry")
    entry = odometry.nested_type.add(name="HeatEntry")
    entry.options.map_entry = True
    one, many_, inner = field.LABEL_OPTIONAL, field.LABEL_REPEATED, field.TYPE_MESSAGE
    for message, fields in (
        (pose, [("x", field.TYPE_DOUBLE, one, ""), ("y", field.TYPE_DOUBLE, one, "")]),
        (entry, [("key", field.TYPE_STRING, one, ""), ("value", field.TYPE_DOUBLE, one, "")]),
        (odometry, [("ok", field.TYPE_BOOL, one, ""), ("pose", inner, one, ".robot.Pose"),
                    ("wheels", field.TYPE_FLOAT, many_, ""), ("track", inner, many_, ".robot.Pose"),
                    ("heat", inner, many_, ".robot.Odometry.HeatEntry")]),
    ):  # fmt: skip
        for number, (name, kind, label, of) in enumerate(fields, 1):
            message.field.add(name=name, number=number, type=kind, label=label, type_name=of or None)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(described)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.Odometry"))
    path = tmp_path / "protobuf.mcap"
    with path.open("wb") as file:
        log = writer.Writer(file)
        for i in range(3):
            content = made(ok=i < 2, wheels=[i, -i], heat={"motor": 20.5 + i})
            content.pose.x = i
            content.track.add(x=1, y=i)
            log.write_message("/odom", content, log_time=10**18 + i * 10**8, publish_time=10**18)
        log.finish()
    found = {name: values.tolist() for name, values in stl.load_trace(path, step="0.1s").items()}
    assert found == {
        "/odom.ok": [True, True, False], "/odom.pose.x": [0, 1, 2], "/odom.pose.y": [0, 0, 0],
        "/odom.wheels.0": [0, 1, 2], "/odom.wheels.1": [0, -1, -2], "/odom.track.0.x": [1, 1, 1],
        "/odom.track.0.y": [0, 1, 2], "/odom.heat.motor": [20.5, 21.5, 22.5],
    }  # fmt: skip


def test_mcap_at_fault(drive, tmp_path, monkeypatch):
    with pytest.raises(NameLookupError, match="there is no field /odometry.sped; did you mean"):
        stl.load_trace(drive, ["/odometry.sped"], step="0.1s")
    with pytest.raises(SettingsError, match="messages have log_time and publish_time"):
        stl.load_trace(drive, ["/door.open"], step="0.1s", time="header")
    (tmp_path / "t.mcap").write_bytes(drive.read_bytes()[:-40])
    with pytest.raises(FileError, match="t.mcap: cannot be read as an MCAP file"):
        stl.load_trace(tmp_path / "t.mcap", step="0.1s")
    monkeypatch.setitem(__import__("sys").modules, "mcap", None)
    with pytest.raises(MissingExtraError, match=r"MCAP needs the package mcap, .*pip install 'stltool\[mcap\]'"):
        stl.load_trace(drive)


def test_all_signals_of_a_recording(drive):
    found = stl.load_trace(drive, step="0.25s", resample="hold")
    assert set(plain(found)) == {
        "/odometry.speed", "/odometry.pose.at.0", "/odometry.pose.at.1", "/odometry.ok", "/door.open"
    }  # fmt: skip
    assert found["/odometry.speed"].tolist() == [0, 0.2, 0.5, 0.7, 1]
