"""Gymnasium environments on the command line, and their model files."""

import json
import re

import gymnasium
import pytest
from gymnasium import spaces

import stltool as stl
from stltool.errors import ModelError
from stltool.reporting import load_report, render
from tests.conftest import ROOT
from tests.models.gymnasium_envs import Scripted

LAKE = ROOT / "examples" / "frozenlake"
KNOWN, UNKNOWN = LAKE / "crossing.stl", LAKE / "crossing-blackbox.stl"


def test_a_black_box_is_run_and_bounded(stltool, tmp_path):
    arguments = [UNKNOWN, "-p", "T=40", "--episodes", 100, "--rollouts", 300, "--seed", 4, "--out", tmp_path]
    code, out, _ = stltool("run", *arguments)
    assert code == 0
    bound = float(re.search(r"\nfresh runs, 300 runs +(\S+) +99 %", out)[1])
    assert "maximum over all policies" not in out
    assert "learning data" not in out
    data = load_report(tmp_path / "report.json")
    (found,) = data["guarantees"]
    assert (data["checks"], data["why"], data["transitions"], found["source"]) == ([], None, None, "fresh runs")
    assert 0.1 < bound <= found["lower"] < found["satisfied"] / 300
    assert {point["probability"] for point in data["training"]["history"]} == {None}
    assert len(data["run"]["steps"]) > 1
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for text in ("The model is a black box", f"P ≥ {bound}", "with confidence 99 %", "transitions unknown"):
        assert text in page
    for text in ("Exact probabilities", "exact probability", "known from the model"):
        assert text not in page
    assert f"with the choice before as context: {data['markov']['statement']}" in page
    assert page == render(data)
    known, task = (stl.load_task(path, params={"T": 40}) for path in (KNOWN, UNKNOWN))
    table = stl.build_product(stl.load_model(LAKE / "lake.toml"), known)
    unknown = stl.build_product(stl.load_model(LAKE / "lake-blackbox.toml"), task)
    policy = stl.load_policy(tmp_path / "policy.npz", unknown)
    assert stl.check(table, stl.Policy(table, policy.table)).probability >= bound
    code, out, err = stltool("run", *arguments, "--json")
    again = json.loads(out)
    assert (code, err, again["guarantees"][0]["satisfied"]) == (0, "", found["satisfied"])


def test_the_table_is_run_and_checked(stltool, tmp_path):
    code, out, _ = stltool("run", KNOWN, "-p", "T=30", "--episodes", 200, "--out", tmp_path)
    assert code == 0
    assert "maximum over all policies" in out
    assert "exact check" in out
    code, _, err = stltool("run", UNKNOWN, "--rollouts", 0, "--out", tmp_path)
    assert (code, "a policy for a black box is judged only by fresh runs" in err) == (2, True)


def test_the_other_commands_on_a_black_box(stltool, tmp_path):
    policy = tmp_path / "p.npz"
    code, out, _ = stltool("learn", UNKNOWN, "--episodes", 100, "--out", policy)
    assert (code, "unknown: the model is a black box" in out) == (0, True)
    assert "Markov test  no evidence that the next state depends on more than state and action" in out
    data = json.loads(stltool("learn", UNKNOWN, "--episodes", 20, "--out", tmp_path / "q.npz", "--json")[1])
    assert data["history"][-1]["probability"] is None
    assert data["markov"]["rejected"] is False
    code, out, _ = stltool("estimate", UNKNOWN, "--policy", policy, "--runs", 50)
    assert (code, "exact P" in out, "the probability lies in" in out) == (0, False, True)
    assert stltool("estimate", UNKNOWN, "--policy", policy, "--at-least", "0.99")[0] == 1
    code, out, _ = stltool("explain", UNKNOWN)
    assert code == 0
    assert re.search(r"^transitions +unknown: the model is a black box$", out, flags=re.MULTILINE)
    assert json.loads(stltool("explain", UNKNOWN, "--json")[1])["transitions"] is None
    for arguments in (["check"], ["check", "--policy", policy], ["why", "--policy", policy]):
        code, out, err = stltool(arguments[0], UNKNOWN, *arguments[1:])
        assert (code, out) == (2, "")
        assert "error: the probabilities of lake-blackbox are unknown: it is a black box" in err
    code, _, err = stltool("estimate", UNKNOWN)
    assert (code, "give --policy FILE" in err) == (2, True)
    code, _, err = stltool("check", KNOWN, "--policy", policy)
    assert (code, "is for the model lake-blackbox" in err) == (2, True)
    code, _, err = stltool("learn", UNKNOWN, "-p", "T=200", "--out", policy)
    assert (code, "after 100 steps, and the task needs 200" in err) == (2, True)


# ------------------------------------------------------------------------------------------------------ model files


def model_of(tmp_path, text):
    file = tmp_path / "lake.toml"
    file.write_text(text, encoding="utf-8")
    return stl.load_model(file)


def test_what_a_file_can_say(tmp_path):
    model = model_of(
        tmp_path,
        """
        id = "Blackjack-v1"
        kind = 'gymnasium'
        ends = "apart"
        name = "cards"
        actions = ["stick", "hit"]
        options = { natural = true, sab = false }
        labels.twenty = [[20, 1, 0], [20, 1, 1]]
        coordinates = { total = 32, dealer = 11, ace = 2 }
        """,
    )
    assert (model.n_states, model.name, model.action_names) == (1408, "cards", ("stick", "hit"))
    assert model.state_name(20 * 22 + 3) == "(20,1,1)"
    assert model.labels["twenty"].nonzero()[0].tolist() == [442, 443, 704 + 442, 704 + 443]
    assert [model.signals[name][20 * 22 + 3] for name in ("total", "dealer", "ace")] == [20, 1, 1]


def test_components_that_do_not_count_from_zero(tmp_path, monkeypatch):
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    pair = spaces.Tuple([spaces.Discrete(2, start=5), spaces.Discrete(2)])
    gymnasium.register("Pair-v0", entry_point=lambda: Scripted(((5, 0), {}), (), pair))
    text = 'kind = "gymnasium"\nid = "Pair-v0"\n[labels]\nthere = [[6, 0]]\n[coordinates]\na = 2\nb = 2'
    model = model_of(tmp_path, text)
    assert model.signals["a"].tolist() == [5, 5, 6, 6]
    assert model.signals["b"].tolist() == [0, 1, 0, 1]
    assert model.labels["there"].tolist() == [False, False, True, False]


def test_the_lake_of_the_examples():
    known, unknown = (stl.load_model(LAKE / name) for name in ("lake.toml", "lake-blackbox.toml"))
    assert (known.blackbox, known.n_transitions, known.action_names) == (None, 148, ("left", "down", "right", "up"))
    assert unknown.blackbox is not None
    for model in (known, unknown):
        assert [int(model.signals[axis][6]) for axis in ("row", "column")] == [1, 2]
        assert model.labels["hole"].nonzero()[0].tolist() == [5, 7, 11, 12]


START = 'kind = "gymnasium"\nid = "FrozenLake-v1"\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('kind = "gym"', r'lake.toml, line 1: kind is .gym.; write kind = "grid", "gymnasium" or'),
        ('x = 1\nkind = ["grid"]', "lake.toml, line 2: kind is"),
        ("map = 'S'", r"lake.toml: kind is None; write kind ="),
        ('kind = "gymnasium"', "lake.toml: id is None; write the name of an environment"),
        ('kind = "gymnasium"\nid = 3', "lake.toml, line 2: id is 3"),
        ('kind = "gymnasium"\nid = "FrozenLak-v1"', "line 2: id is 'FrozenLak-v1': .*did you mean FrozenLake-v1"),
        ('kind = "gymnasium"\nid = "FrozenLake-v7"', "line 2: id is 'FrozenLake-v7': .*; did you mean"),
        ('kind = "gymnasium"\nid = "os:FrozenLake-v1"', "line 2: id is .*: a file cannot import a module"),
        ('kind = "gymnasium"\nid = ""', "line 2: id is ''"),
        ('kind = "gymnasium"\nid = "CartPole-v1"', "lake.toml, line 2: CartPole-v1: its observations are Box"),
        (START + "labls = {}", "line 3: unknown key labls; did you mean labels"),
        (START + "table = 1", 'line 3: table is 1; write true, false or "auto"'),
        (START + 'ends = "both"', 'line 3: ends is .both.; write "merged" or "apart"'),
        (START + "actions = [1]", "line 3: actions is .1.; write a list of names"),
        (START + 'actions = ["go"]', "lake.toml: FrozenLake-v1: 1 action names for 4 actions"),
        (START + "labels = 5", "line 3: labels is 5; write it as a table"),
        (START + "[labels]\ngoal = 15", "line 4: label goal is 15; give a function"),
        (START + "[labels]\n# far\ngoal = [16]", "line 5: label goal: 16 is not an observation of FrozenLake-v1"),
        (START + '[labels]\n"goal" = [1, 1]', "line 4: label goal lists 1 twice"),
        (START + "[signals]\nx = [1, 2]", r"line 4: signal x has shape \(2,\); one number for each of 16"),
        (START + "[signals]\nx = 'row'", "line 4: signal x does not contain numbers"),
        (START + "[coordinates]\nrow = 4\ncolumn = 5", "line 3: the coordinates have 4 × 5 values, .* has 16 states"),
        (START + "[coordinates]\nrow = 'x'", "line 4: coordinate row is 'x'; write how many"),
        (START + "[coordinates]\nx = 16\n[signals]\nx = [1]", "line 6: signal x is a coordinate too"),
        (START + "[options]\nslippery = true", "line 3: FrozenLake-v1 cannot be made with the options slippery = True"),
        (START + "[options]\nday = 2020-01-01", "line 4: option day is .*; write a number, a string"),
        (START + "[labels]\nx = [1]\n[signals]\nx = [0]", "line 6: signal x has shape"),
        (START + "a = ", "lake.toml: not valid TOML"),
        ('kind = "gymnasium"\nid = "Blackjack-v1"\n[coordinates]\ntotal = 704', "line 3: .* has 32 × 11 × 2"),
        ('kind = "gymnasium"\nid = "Blackjack-v1"\ntable = true', "lake.toml: Blackjack-v1 has no transition table"),
    ],
)  # fmt: skip
def test_files_that_say_something_else(tmp_path, text, says):
    with pytest.raises(ModelError, match=says):
        model_of(tmp_path, text)


def test_all_faults_are_told_at_once(tmp_path):
    text = """\
kind = "gymnasium"
id = "FrozenLake-v1"
tabel = true
ends = "both"
actions = 3

[options]
map_name = "4x4"
is_slippery = true

[labels]
goal = [16]
hole = "water"

[signals]
x = [1, 2]
"y z" = ["1_0", 2]
"""
    with pytest.raises(ModelError) as caught:
        model_of(tmp_path, text)
    lines = str(caught.value).split("\n")
    assert [line.partition("lake.toml")[2].partition(": ")[::2] for line in lines[:-1]] == [
        (", line 3", "unknown key tabel; did you mean table or labels?"),
        (", line 4", "ends is 'both'; write \"merged\" or \"apart\""),
        (", line 5", "actions is 3; write a list of names, such as [\"left\", \"right\"]"),
        (", line 12", "label goal: 16 is not an observation of FrozenLake-v1, which has Discrete(16)"),
        (", line 13", "label hole is 'water'; give a function of an observation, the observations where it holds, or "
                      "16 Booleans"),
        (", line 16", "signal x has shape (2,); one number for each of 16 states"),
        (", line 17", "signal y z does not contain numbers: '1_0' is not a number; write it without underscores; give "
                      "16 of them in the order of the states, or a function of an observation"),
    ]  # fmt: skip
    assert lines[-1] == "7 errors"


def test_grids_keep_their_lines_too(tmp_path):
    with pytest.raises(ModelError, match="lake.toml, line 2: unknown key mapp; did you mean map"):
        model_of(tmp_path, 'kind = "grid"\nmapp = "S"')


POLE = """
kind = "gymnasium"
id = "CartPole-v1"
actions = ["left", "right"]
[signals]
x = 0
angle = 2
[cells]
angle = [-0.05, 0, 0.05]
x = 1.2
[labels]
fell = "info.fell"
"""


def test_real_observations_from_a_file(stltool, tmp_path):
    (tmp_path / "pole.toml").write_text(POLE)
    (tmp_path / "up.stl").write_text('model "pole.toml"\nup := G[0,5] (angle < 0.15 & angle > -0.15 & !fell)\n')
    code, out, err = stltool("learn", tmp_path / "up.stl", "--episodes", 20, "--out", tmp_path / "p.npz")
    assert code == 0
    assert "pole.toml: states are cells of what is observed: the task is read from the real signals" in err
    code, out, _ = stltool("estimate", tmp_path / "up.stl", "--policy", tmp_path / "p.npz", "--runs", 20)
    assert code == 0
    assert "20, 20 satisfied" in out
    code, out, _ = stltool("explain", tmp_path / "up.stl")
    assert code == 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("x = 0", "x = 7", "signal x is 7; give a function of an observation, or the number of a component, 0 … 3"),
        ("x = 1.2", "y = 1.2", "cells divide y, which is not a signal"),
        ("x = 1.2", "x = 0", r"cells of width 0 for x"),
        ("[labels]", "[coordinates]\nx = 3\n[labels]", "coordinates are of finitely many observations"),
        ('"info.fell"', "[1]", "label fell is"),
        ("[cells]", "[cell]", "unknown key cell; did you mean cells?"),
    ],
)
def test_faults_of_cells_are_located(stltool, tmp_path, old, new, says):
    (tmp_path / "pole.toml").write_text(POLE.replace(old, new, 1))
    (tmp_path / "up.stl").write_text('model "pole.toml"\nup := G[0,5] angle < 0.15\n')
    code, out, err = stltool("learn", tmp_path / "up.stl", "--episodes", 20, "--out", tmp_path / "p.npz")
    assert (code, out) == (2, "")
    assert says in err
    assert "pole.toml, line" in err
