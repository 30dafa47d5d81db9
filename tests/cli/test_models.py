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


def test_several_initial_states_and_deadlocks(stltool, tmp_path):
    write(tmp_path, "m.tra", "3 2 2\n0 0 2 1 go\n2 0 2 1 stay\n")
    write(tmp_path, "m.lab", '0="init" 1="goal"\n0: 0\n1: 0\n2: 1\n')
    task = write(tmp_path, "task.stl", 'model "m.tra"\nreach := F[0,2] goal\n')
    code, _, err = stltool("check", task)
    assert code == 2
    assert "2 initial states are marked (0; 1)" in err
    assert "choose one with --initial NAME, or --initial uniform for each with the same probability" in err
    for initial, value in (("uniform", "1/2"), ("0", "1"), ("1", "0")):
        code, out, err = stltool("check", task, "--exact", "--initial", initial)
        assert code == 0
        assert f"exact P  {value}\n" in out
        assert f"note: {tmp_path / 'm.tra'}: states without transitions stay where they are, as in PRISM: 1\n" in err
    assert "states without transitions stay" in stltool("explain", task, "--initial", "0")[1]
    code, _, err = stltool("check", task, "--initial", "0", "--deadlocks", "error")
    assert code == 2
    assert "state 1 has no action; give it one that stays" in err
    code, _, err = stltool("check", task, "--deadlocks", "stop")
    assert code == 2
    assert "--deadlocks is 'stop'; give loop or error" in err
    expect = write(tmp_path, "expect.stl", 'model "m.tra"\nreach := F[0,2] goal\nexpect Pmax(reach) >= 1/2\n')
    assert stltool("verify", expect, "--initial", "uniform")[0] == 0
    assert stltool("verify", expect)[0] == 2
    assert stltool("verify", expect, "--initial", "uniform", "--deadlocks", "error")[0] == 2
