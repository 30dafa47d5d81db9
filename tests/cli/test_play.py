"""`stltool play`: a run, move by move."""

import io
import json

import pytest

import stltool as stl
from stltool.checking.situations import Situations
from tests.conftest import FACTORY, PATROLLING, SMALL


def test_moves_are_made_and_reported(stltool, patrolling):
    code, out, _ = stltool("play", PATROLLING, *SMALL, "--moves", "NE>(2,1) E>(3,1) *", "--json")
    data = json.loads(out)
    assert code == 0
    assert [step["state"] for step in data["steps"][:3]] == ["(1,0)", "(2,1)", "(3,1)"]
    assert [step["action"] for step in data["steps"][:2]] == ["NE", "E"]
    assert data["steps"][-1]["action"] is None
    assert data["satisfied"] is bool(data["steps"][-1]["probability"])
    assert data["steps"][0]["probability"] == pytest.approx(stl.check(patrolling).probability, abs=1e-14)
    assert data["steps"][0]["memory"] == "at_A not seen for 1 step; at_B not seen for 1 step"
    here = Situations(patrolling, stl.check(patrolling).policy)
    s, q = patrolling.model.state_names.index("(2,1)"), patrolling.automaton.initial
    for name in ("(1,0)", "(2,1)"):
        q = patrolling.enter(patrolling.model.state_names.index(name), q)
    assert data["steps"][1]["probability"] == here.value(1, s, q)


def test_the_same_seed_plays_the_same_run(stltool):
    runs = [stltool("play", PATROLLING, *SMALL, "--moves", "*", "--seed", str(i % 9), "--json")[1] for i in range(18)]
    assert runs[:9] == runs[9:]
    assert len(set(runs)) > 1


def test_lines_are_asked_for_until_they_end(stltool, monkeypatch):
    """A move that there is not is explained, and one is asked for again; the floor shows where the run is."""
    monkeypatch.setattr("sys.stdin", io.StringIO("north\n?\n2\n<\n!\n*\n.\n"))
    code, out, err = stltool("play", PATROLLING, *SMALL)
    assert code == 0
    assert "north: there is no such action here; known names: E, N" in out
    assert "one step back" in out
    assert out.count("step 0 of 8, (1,0)") == 3  # at first, after <, and after !
    assert "violated" in out
    assert "nothing left to do" in out
    assert " @ " in out
    assert "move (? for help)" in err


def test_the_most_probable_violation_is_played(stltool, patrolling):
    _, out, _ = stltool("play", PATROLLING, *SMALL, "--moves", "! *", "--json")
    data = json.loads(out)
    [worst] = stl.likely_runs(patrolling, count=1).runs
    assert [step["state"] for step in data["steps"]] == [patrolling.model.state_name(s) for s in worst.states]
    assert data["satisfied"] is False


@pytest.mark.parametrize(
    ("moves", "fault"),
    [
        ("up", "up: there is no such action here"),
        ("N>(4,4)", "N does not lead to (4,4)"),
        ("* .", "the verdict is known"),
    ],
)
def test_faults_of_given_moves_end_it(stltool, moves, fault):
    code, _, err = stltool("play", PATROLLING, *SMALL, "--moves", moves)
    assert code == 2
    assert fault in err


def test_a_black_box_is_not_played(stltool):
    task = FACTORY.parent / "frozenlake" / "crossing-blackbox.stl"
    code, _, err = stltool("play", task, "-p", "T=5")
    assert code == 2
    assert "black box" in err


@pytest.fixture
def twins(tmp_path):
    """A task on a model of PRISM's in which two successors have the same values, and another two variables."""
    (tmp_path / "m.tra").write_text("3 3 4\n0 0 1 0.9 go\n0 0 2 0.1 go\n1 0 1 1 stay\n2 0 2 1 stay\n")
    (tmp_path / "m.sta").write_text("(x,y)\n0:(0,0)\n1:(1,0)\n2:(1,0)\n")
    (tmp_path / "m.lab").write_text('0="init" 1="good"\n0: 0\n1: 1\n')
    (tmp_path / "m.stl").write_text('model "m.tra"\nreach := F[0,1] good\n')
    return tmp_path / "m.stl"


def test_states_of_the_same_name_are_told_apart(stltool, twins):
    code, _, err = stltool("play", twins, "--moves", "'go>x=1, y=0'")
    assert code == 2
    assert "go>x=1,y=0(1); go>x=1,y=0(2)" in err
    for move, satisfied in (
        ("go>x=1,y=0(1)", True),
        ("go>x=1,y=0(2)", False),
        ("'go>x=1, y=0 (2)'", False),
        ('go>"x=1, y=0 (1)"', True),
        ("go>1", True),
        ("1>2", False),
    ):
        code, out, _ = stltool("play", twins, "--moves", move, "--json")
        data = json.loads(out)
        assert (code, data["satisfied"]) == (0, satisfied)
        assert data["steps"][1]["state"] == f"x=1, y=0 ({1 if satisfied else 2})"
    assert "x=1, y=0 (2)" in stltool("why", twins)[1]


def test_a_name_cut_at_its_space_is_refused_with_the_way_to_write_it(stltool, twins):
    code, _, err = stltool("play", twins, "--moves", "go>x=1, y=0")
    assert code == 2
    assert "go does not lead to x=1,; choose from: go>x=1,y=0(1); go>x=1,y=0(2) (or, by" in err
    assert "states' numbers, 1, 2)" in err
    code, _, err = stltool("play", twins, "--moves", "'go>x=1")
    assert code == 2
    assert "a quotation mark is not closed" in err


def test_every_move_says_something(stltool, twins, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("<\n!\n\n"))
    code, out, _ = stltool("play", twins)
    assert code == 0
    assert "<: the run is at its first step" in out
    assert "the most probable violation, with probability 0.1, is decided at step 1: Enter follows it" in out
    assert out.endswith("left at step 1 of 1: violated\n")


def test_the_starter_from_prism_has_a_name_for_every_state(stltool, tmp_path):
    assert stltool("new", tmp_path / "n", "--kind", "prism")[0] == 0
    names = stl.load_model(tmp_path / "n" / "line.tra").state_names
    assert len({name.split(" (")[0] for name in names}) == 5
