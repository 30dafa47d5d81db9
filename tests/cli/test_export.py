"""`stltool export`: automata for Graphviz, products and chains for PRISM and Storm."""

import json
import re
import subprocess
import sys
from fractions import Fraction

import pytest

import stltool as stl
from tests.conftest import FACTORY, PATROLLING, SMALL
from tests.prism import Program


def test_export_draws_the_automaton(stltool, tmp_path):
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--to", "dot")
    assert code == 0
    assert out.splitlines()[1].startswith("// G[0,4]")
    assert "A not seen for 2 steps" in out
    path = tmp_path / "task.dot"
    assert stltool("export", PATROLLING, *SMALL, "--to", "dot", "--out", path)[0] == 0
    assert path.read_text() == out
    bare = tmp_path / "task.stl"
    bare.write_text("task := G[0,5] (a -> F[0,3] b)\n")
    code, out, _ = stltool("export", bare, "--to", "dot")
    assert "b not seen for 2 steps" in out
    code, _, err = stltool("export", bare, "--to", "png")
    assert (code, "known names: dot, drn, prism, python, umb" in err) == (2, True)


def test_the_product_as_a_program(stltool, tmp_path):
    path = tmp_path / "product.prism"
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--out", path)  # the ending says what to write
    assert code == 0
    states, choices, transitions = Program(path.read_text()).sizes()
    lines = out.splitlines()
    assert lines[0] == f"written  {path}: {states} states, {choices} choices, {transitions} transitions"
    assert lines[1] == 'maximum  1 - x, where x is Pmin=? [ F<=8 "violated" ]'
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--to", "prism")
    assert (code, out) == (0, path.read_text())
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--to", "prism", "--clock", "--json")
    data = json.loads(out)
    assert data["questions"] == {
        "maximum": {"property": 'Pmax=? [ F "satisfied" ]', "complement": False},
        "minimum": {"property": 'Pmin=? [ F "satisfied" ]', "complement": False},
    }
    assert Program(data["text"]).sizes() == tuple(data[key] for key in ("states", "choices", "transitions"))


@pytest.mark.parametrize("ending", ["drn", "drn.gz", "umb"])
def test_the_product_state_by_state(stltool, tmp_path, ending):
    path = tmp_path / f"product.{ending}"
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--clock", "--out", path)
    assert (code, 'maximum  Pmax=? [ F "satisfied" ]' in out) == (0, True)
    product = stl.build_product(stl.load_model(path), stl.parse("F[0,8] satisfied"))
    assert stl.check(product, exact=True).fraction == Fraction(73794757279959, 10**14)
    assert {"column", "row", "without_at_A", "without_at_B", "step", "x", "y"} == set(product.model.signals)
    assert {"A", "B", "C", "satisfied", "violated"} == set(product.model.labels) - {"init"}
    path.write_text("mine")
    code, _, err = stltool("export", PATROLLING, *SMALL, "--out", path)
    assert (code, "would be lost" in err) == (2, True)


def test_drn_is_printed_and_its_properties_told(stltool):
    code, out, err = stltool("export", PATROLLING, *SMALL, "--to", "drn")
    assert (code, "@nr_states\n109\n" in out) == (0, True)
    assert 'maximum: 1 - x, where x is Pmin=? [ F<=8 "violated" ]' in err


def test_a_label_that_other_tools_keep_for_the_initial_state_is_renamed(tmp_path):
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {}, labels={"init": [1, 0], "A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    stl.export(product, tmp_path / "product.drn")
    assert list(stl.product_mdp(product).model.labels) == ["init_", "A", "satisfied", "violated"]


def test_the_chain_of_a_policy(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = stl.load_task(PATROLLING, {"T": "5", "tau": "5"})
    product = stl.build_product(stl.load_model(task.model), task)
    stl.check(product).policy.save("best.npz")
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--policy", "best.npz", "--to", "prism")
    assert code == 0
    program = Program(out)
    assert program.kind == "dtmc"
    exported = stl.product_mdp(product, stl.load_policy("best.npz", product))
    assert program.value(exported.questions["policy"]) == stl.check(product, exact=True).fraction
    (tmp_path / "an_agent.py").write_text("def act(here):\n    return here.actions[0]\n")
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--policy-function", "an_agent:act", "--to", "prism")
    assert (code, Program(out).kind) == (0, "dtmc")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "no format is given; write --to prism, or name a file that ends in one of .dot, .prism, .drn, .umb, .py"),
        (["--to", "umb"], "umb files are not text; name one to write: --out"),
        (["--to", "drn", "--out", "product.tra"], "product.tra: a DRN file ends in .drn or .drn.gz"),
        (["--out", "product.txt"], "product.txt: no format has this ending"),
        (["--to", "prism", "--out", "product.dot"], "a PRISM program ends in .prism or .nm or .pm"),
        (["--to", "prsm"], "--to prsm: there is no such format; did you mean prism?"),
        (["--to", "dot", "--clock"], "--clock is for the product; leave it out with dot"),
        (["--to", "dot", "--policy", "best.npz"], "a policy does not change the automaton"),
        (["--to", "python"], "python needs a policy; give --policy"),
        (["--out", "p.py", "--policy", "best.npz", "--clock"], "--clock is for the product; leave it out with python"),
    ],
)
def test_what_does_not_fit_is_refused(stltool, tmp_path, monkeypatch, options, says):
    monkeypatch.chdir(tmp_path)
    task = stl.load_task(PATROLLING, {"T": "5", "tau": "5"})
    stl.check(stl.build_product(stl.load_model(task.model), task)).policy.save("best.npz")
    code, out, err = stltool("export", PATROLLING, *SMALL, *options)
    assert (code, out) == (2, "")
    assert says in err
    assert [path.name for path in tmp_path.iterdir()] == ["best.npz"]


def test_a_policy_as_a_program(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert stltool("check", PATROLLING, *SMALL, "--save-policy", "best.csv")[0] == 0
    code, out, _ = stltool("export", PATROLLING, *SMALL, "--policy", "best.csv", "--out", "robot.py")
    assert (code, out) == (0, "written  robot.py\n")
    asked = ["export", PATROLLING, *SMALL, "--policy", "best.csv", "--to", "python"]
    assert stltool(*asked)[1] == (tmp_path / "robot.py").read_text()
    data = json.loads(stltool(*asked, "--json")[1])
    assert (data["to"], data["questions"]) == ("python", None)
    done = subprocess.run([sys.executable, "-I", "robot.py"], input="(1,0)\n(2,1)\n", capture_output=True, text=True)
    assert done.stdout.split() == ["NE", "E", "undecided"]
    assert stltool("export", PATROLLING, *SMALL, "--policy", "best.csv", "--out", "robot.py")[0] == 0  # ours
    (tmp_path / "robot.py").write_text("print('mine')\n")
    code, _, err = stltool("export", PATROLLING, *SMALL, "--policy", "best.csv", "--out", "robot.py")
    assert (code, "does not contain a Python program that stltool wrote" in err) == (2, True)


def test_a_task_without_a_model_has_no_product(stltool, tmp_path):
    bare = tmp_path / "task.stl"
    bare.write_text("task := F[0,5] A\n")
    code, _, err = stltool("export", bare, "--to", "prism")
    assert (code, "names no model" in err) == (2, True)
    code, _, err = stltool("export", bare, "--to", "dot", "--policy", "best.npz")
    assert (code, "a policy needs a model" in err) == (2, True)
    assert stltool("export", bare, "--to", "prism", "--model", FACTORY / "floor-5x5.toml")[0] == 0


def test_programs_too_long_to_read_are_refused_with_their_size(stltool, monkeypatch):
    monkeypatch.setattr("stltool.exporting.prism.MOST_BRANCHES", 100)
    code, out, err = stltool("export", PATROLLING, *SMALL, "--to", "prism")
    assert (code, out) == (2, "")
    assert re.search(r"the program would have \d+ branches, and has at most 100; use DRN or UMB, or coarsen", err)
