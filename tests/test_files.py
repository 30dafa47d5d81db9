"""What is left beside results by processes that were killed, and two of them in one folder."""

import os
import signal
import subprocess
import sys
import time

import pytest

from stltool import files
from stltool.errors import FileError
from tests.conftest import ROOT

fcntl = pytest.importorskip("fcntl", reason="locks of files are not there on Windows")

WRITING = """
import sys, time
from stltool.files import atomic_file, write_folder
from pathlib import Path
with atomic_file(sys.argv[1]) as file:
    file.write(b"half")
    file.flush()
    print("writing", flush=True)
    time.sleep(60)
"""
RUNNING = """
import sys, time
from stltool.files import alone_in
from pathlib import Path
with alone_in(Path(sys.argv[1]), "run"):
    print("running", flush=True)
    time.sleep(60)
"""


def begun(code, path):
    started = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert started.stdout.readline().endswith("ing\n")
    return started


def end(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


@pytest.fixture(autouse=True)
def next_run(monkeypatch):
    monkeypatch.setattr(files, "_tidied", set())
    monkeypatch.setattr(files, "_YOUNG", -1.0)


def test_what_a_killed_process_leaves_is_removed_by_the_next(tmp_path, monkeypatch):
    process = begun(WRITING, tmp_path / "result.json")
    (left,) = [name for name in os.listdir(tmp_path) if name != "other.txt"]
    files.write_atomically(tmp_path / "other.txt", "whole")
    assert left in os.listdir(tmp_path)  # it is in use
    end(process)
    monkeypatch.setattr(files, "_tidied", set())
    (tmp_path / ".result.json.abcdefgh.stltool").mkdir()
    (tmp_path / ".result.json.abcdefgh.stltool" / "part").write_text("half")
    for name in (".foreign", ".foreign.stltool", "x.abcdefgh.stltool"):
        (tmp_path / name).write_text("mine")
    os.symlink(tmp_path / "other.txt", tmp_path / ".link.abcdefgh.stltool")
    os.mkfifo(tmp_path / ".pipe.abcdefgh.stltool")
    files.write_atomically(tmp_path / "result.json", "whole")
    assert sorted(os.listdir(tmp_path)) == [
        ".foreign", ".foreign.stltool", ".link.abcdefgh.stltool", ".pipe.abcdefgh.stltool", "other.txt", "result.json",
        "x.abcdefgh.stltool",
    ]  # fmt: skip
    assert (tmp_path / "result.json").read_text() == "whole"


def test_young_files_are_left_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_YOUNG", 5.0)
    for name, age in ((".a.abcdefgh.stltool", 0), (".b.abcdefgh.stltool", 60)):
        (tmp_path / name).write_text("half")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    files.write_atomically(tmp_path / "c", "whole")
    assert sorted(os.listdir(tmp_path)) == [".a.abcdefgh.stltool", "c"]


def test_a_folder_is_for_one_process_at_a_time(tmp_path):
    process = begun(RUNNING, tmp_path / "out")
    with (
        pytest.raises(FileError, match="out: another run is writing there; wait until it ends, or name another folder"),
        files.alone_in(tmp_path / "out", "run"),
    ):
        raise AssertionError
    end(process)
    with files.alone_in(tmp_path / "out", "run"):
        (tmp_path / "out" / "page").write_text("whole")
    assert os.listdir(tmp_path / "out") == ["page"]
    with pytest.raises(KeyboardInterrupt), files.alone_in(tmp_path / "new", "run"):
        raise KeyboardInterrupt
    assert not (tmp_path / "new").exists()


def test_names_of_any_length_are_written_or_refused(tmp_path):
    files.write_atomically(tmp_path / ("é" * 120), "whole")
    assert os.listdir(tmp_path) == ["é" * 120]
    with pytest.raises(FileError, match="cannot be written"):
        files.write_atomically(tmp_path / ("a" * 300), "whole")
