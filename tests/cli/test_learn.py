"""The command `learn`: its help, and what it writes besides the policy."""

from pathlib import Path

import pytest

from stltool.files import alone_in
from stltool.learning import LEARNERS
from stltool.learning.settings import settings_of, shown_value
from tests.conftest import PATROLLING, SMALL


def test_the_help_lists_methods_and_their_settings(stltool):
    code, out, _ = stltool("learn", "--help")
    assert code == 0
    for cls in LEARNERS:
        assert f"-m {cls.name}{' --faithful' if cls.published else ''}: " in out
        for name, declared in settings_of(cls).items():
            assert f"{name}={shown_value(declared.default)}" in out
            assert declared.text.split(";")[0][:40] in out
    assert stltool("run", "--help")[1].endswith(out[out.index("Methods, their settings") :])


def test_tensorboard_events_in_a_folder_of_each_run(stltool, tmp_path):
    pytest.importorskip("tensorboard", reason="TensorBoard is not installed")
    from tests.reporting.test_tensorboard import read

    for _ in range(2):
        code, shown, _ = stltool("learn", PATROLLING, *SMALL, "--episodes", 20, "--out", tmp_path / "p.npz",
                             "--tensorboard", tmp_path / "events")  # fmt: skip
        assert code == 0
        [events] = [line.split(maxsplit=1)[1] for line in shown.splitlines() if line.startswith("events ")]
        assert Path(events).parent == tmp_path / "events"
        assert Path(events).is_dir()
    runs = read(tmp_path / "events")
    assert len(runs) == 2
    assert all(name.startswith("patrolling-model-based-seed0-") for name in runs)
    (tmp_path / "file").write_text("")
    code, out, err = stltool("learn", PATROLLING, *SMALL, "--episodes", 10**6, "--out", tmp_path / "q.npz",
                             "--tensorboard", tmp_path / "file")  # fmt: skip
    assert (code, out) == (2, "")
    assert "cannot create the results folder" in err
    assert not (tmp_path / "q.npz").exists()


def test_two_runs_into_one_folder_are_refused(stltool, tmp_path):
    """As two sweeps are; another folder, and the same one later, are free."""
    with alone_in(tmp_path / "out", "run"):
        (tmp_path / "out" / "note.txt").write_text("here first")
        code, _, err = stltool("run", PATROLLING, *SMALL, "-e", "2", "--rollouts", "10", "--out", tmp_path / "out")
        assert code == 2
        assert "another run is writing there; wait until it ends, or name another folder" in " ".join(err.split())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["note.txt"]
    code, _, err = stltool("run", PATROLLING, *SMALL, "-e", "2", "--rollouts", "10", "--out", tmp_path / "out")
    assert (code, (tmp_path / "out" / "report.html").exists()) == (0, True), err
