"""`stltool explain --policy`: a policy as a decision tree, as users meet it."""

import json
import re

import pytest

import stltool as stl
from tests.conftest import PATROLLING, SMALL


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    path = tmp_path_factory.mktemp("tree") / "best.npz"
    stl.check(stl.build_product(stl.load_model(task.model), task)).policy.save(path)
    return path


@pytest.mark.soak(only=True)
def test_the_tree_is_printed_drawn_and_told(stltool, policy, tmp_path):
    code, out, _ = stltool("explain", PATROLLING, *SMALL, "--policy", policy, "--plot", tmp_path / "leaves.svg")
    assert code == 0
    assert "P of it" in out
    assert "within the price" in out
    assert "[at_B]: 0 nothing pending" in out
    assert (tmp_path / "leaves.svg").read_text().startswith("<svg")
    code, out, _ = stltool(
        "explain", PATROLLING, *SMALL, "--policy", policy, "--most-leaves", 3, "--price", 1e-6, "--json"
    )
    data = json.loads(out)
    assert (code, data["met"], data["price"]) == (1, False, 1e-6)
    assert data["lower"] <= data["probability"] <= data["upper"] < data["given"]
    assert {"if", "then", "else", "share"} == set(data["tree"])
    assert data["leaves"] == len([line for line in data["rules"] if not line.endswith(":")])


def test_the_best_policy_s_tree_is_saved_and_checked(stltool, tmp_path):
    code, out, _ = stltool("explain", PATROLLING, *SMALL, "--price", 0.01, "--out", tmp_path / "tree.npz")
    assert code == 0
    assert "policy   maximum over all policies" in out
    p = float(re.search(r"P of it +([\d.]+)", out)[1])
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", tmp_path / "tree.npz", "--json")
    assert (code, json.loads(out)["probability"]) == (0, pytest.approx(p, abs=1e-6))
    code, _, err = stltool("explain", "F[0,3] A", "--price", 0.1)
    assert code == 2
    assert "F[0,3] A: the tree of a policy needs a task file with a model" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--policy", "POLICY", "--price", 2), "--price is 2.0; give a number between 0 and 1"),
        (("--policy", "POLICY", "--most-leaves", 0), "--most-leaves is 0"),
        (("--policy", "POLICY", "--step", "1s"), "--step 1s: a task file declares its own step"),
        (("--policy", "POLICY", "--plot", "leaves.txt"), "leaves.txt: pictures are written as"),
    ],
)
def test_what_it_refuses(stltool, policy, arguments, says):
    given = [policy if one == "POLICY" else one for one in arguments]
    code, _, err = stltool("explain", PATROLLING, *SMALL, *given)
    assert code == 2
    assert says in err
