"""The command `learn`: its help, and what it writes besides the policy."""

from pathlib import Path

import pytest

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
