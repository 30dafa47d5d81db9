"""What commands say about a model's files."""

from tests.models import test_explicit
from tests.models.test_normalize import write


def test_normalize_rescales_rows_and_says_so(stltool, tmp_path):
    write(tmp_path, "m.tra", "2 2 3\n0 0 0 0.333333\n0 0 1 0.666666\n1 0 1 1\n")
    task = write(tmp_path, "t.stl", 'model "m.tra"\nt := F[0,2] true & G[0,1] true\n')
    code, _, err = stltool("check", task, "--exact")
    assert code == 2
    assert "--normalize" in err
    code, out, err = stltool("check", task, "--exact", "--normalize")
    assert code == 0
    assert "exact P" in out
    assert f"note: {tmp_path / 'm.tra'}: normalize rescaled 1 of 2 distributions" in err
    code, out, err = stltool("explain", task, "--normalize")
    assert code == 0
    assert "note: normalize rescaled 1 of 2 distributions" in out


def test_a_missing_label_file_is_a_note(stltool, tmp_path):
    test_explicit.write(tmp_path, lab=None)
    (tmp_path / "t.stl").write_text('model "m.tra"\nt := F[0,2] x > 0\n')
    code, out, _ = stltool("explain", tmp_path / "t.stl")
    assert code == 0
    assert "note: there is no m.lab next to m.tra: the model has no labels, and runs start in state 0" in out
    assert "m.sta" not in out
