"""`stltool why` as its users meet it."""

import json

import numpy as np
import pytest

import stltool as stl
from tests.conftest import FACTORY, PATROLLING, SMALL


def test_the_runs_and_states_of_the_optimum(stltool):
    code, out, _ = stltool("why", PATROLLING, *SMALL, "-k", 2, "--states", 1)
    lines = out.splitlines()
    assert code == 0
    assert lines[0].endswith("patrolling := G[0,4] ((F[0,4] A) & (F[0,4] (x < 0.4 & y > 0.6)))")
    assert lines[1] == "policy  maximum over all policies (time-dependent, deterministic)"
    assert lines[2].startswith("P       0.737947572")
    assert lines[3] == "violated  probability 0.262052; 34.4 % of it in the most probable 2 runs"
    assert lines[5] == "run 1  probability 0.0466667, 17.8 %; violated at step 4 (certain from step 1)"
    assert lines[6] == "       (1,0) NE → 3 × (1,0) stay → (1,0)"
    assert lines[7] == "       before the verdict: due since 3 steps: A; due since 3 steps: x < 0.4 & y > 0.6"
    assert lines[13].split() == ["state", "dP/dp", "steepest", "visits", "mostly", "by"]
    assert lines[14].startswith("(2,2)  0.9179  0.9234    1.581   NW to (1,3) (p = 0.93), SE to (3,1) (p = 0.93)")
    assert lines[16].startswith("The most probable run that violates the task has probability 0.0466667, 17.8 %")
    assert lines[17].startswith("P depends most on state (2,2)")
    assert len(lines) == 18


def test_one_object(stltool):
    code, out, err = stltool("why", PATROLLING, *SMALL, "--mass", 0.9, "-k", 1, "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert (data["question"], data["satisfied"], data["asked_mass"], data["status"]) == (
        "maximum", False, 0.9, "complete",
    )  # fmt: skip
    assert data["verdict_probability"] == pytest.approx(1 - data["probability"], abs=1e-12)
    assert data["lower"] <= data["probability"] <= data["upper"]
    assert data["mass"] == pytest.approx(sum(run["probability"] for run in data["runs"]))
    assert data["covered"] >= 0.9 > data["covered"] - data["runs"][-1]["share"]
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    for run in data["runs"]:
        assert [model.state_name(s) for s in run["state_indices"]] == run["states"]
        assert run["labels"] == [[name for name in "ABC" if model.labels[name][s]] for s in run["state_indices"]]
        assert len(run["actions"]) == run["step"] == len(run["memory"]) - 1
        assert run["remembered"] == run["memory"][-2]
    assert [row["name"] for row in data["sensitive"]] == ["(2,2)", "(2,1)", "(3,1)", "(1,0)", "(1,3)"]
    assert all(action["derivative"] for row in data["sensitive"] for action in row["actions"])


def test_a_mass_and_its_cap(stltool):
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--mass", 0.9, "-k", 1)
    assert "8 runs are the fewest that cover 90 % of it" in out
    assert "7 more; -k prints more of them, --json all" in out
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--mass", 0.9, "--most", 2)
    assert "covered 0.344 of the requested 0.9 with 2 runs; raise most to continue" in out
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--mass", 1)
    assert "runs (there are no others)" in out


def test_the_worst_policy_and_what_satisfies(stltool, tmp_path):
    code, out, _ = stltool("why", PATROLLING, *SMALL, "--satisfying", "-k", 1)
    assert code == 0
    assert "satisfied  probability 0.737948; 87.7 % of it in the most probable 1 run" in out
    assert "satisfied at step 8 (certain from step 6)" in out
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--satisfying", "--minimize")
    assert "minimum over all policies" in out
    assert "satisfied  no run of positive probability" in out
    assert "no state; no success probability affects P" in out
    sure = tmp_path / "sure.stl"
    sure.write_text("sure := F[0,5) A | G[0,5) !A\n")
    code, out, _ = stltool("why", sure, "--model", FACTORY / "floor-5x5.toml")
    assert code == 0
    assert "violated  no run of positive probability" in out
    _, out, _ = stltool("why", sure, "--model", FACTORY / "floor-5x5.toml", "--mass", 0.5, "--json")
    data = json.loads(out)
    assert (data["runs"], data["verdict_probability"], data["covered"], data["exhausted"]) == ([], 0, 1, True)


def test_a_given_policy(stltool, tmp_path):
    path = tmp_path / "policy.npz"
    assert stltool("learn", PATROLLING, *SMALL, "-e", 60, "--seed", 2, "--out", path)[0] == 0
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--policy", path, "--json")
    data = json.loads(out)
    _, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", path, "--json")
    assert (data["question"], data["probability"]) == ("policy", json.loads(out)["probability"])
    _, out, _ = stltool("why", PATROLLING, *SMALL, "--policy", path)
    assert f"policy  {path} (" in out


def test_bad_input_ends_with_code_2(stltool, tmp_path):
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(task.model), task)
    silent = tmp_path / "silent.npz"
    stl.Policy(product, np.full(product.shape, -1)).save(silent)
    cases = [
        (["-k", 0], "--count is 0; it must be an integer from 1"),
        (["-k", "few"], "Invalid value"),
        (["--mass", 0], "mass is 0.0; give a share of the probability"),
        (["--mass", 1.01], "mass is 1.01"),
        (["--mass", "nan"], "'nan' is not a finite number"),
        (["--mass", 0.5, "--most", 0], "most is 0"),
        (["--states", -1], "--states is -1; it must be an integer from 0"),
        (["--minimize", "--policy", silent], "keep one of them"),
        (["--policy", silent], "the policy defines no action at step 0, state (1,0)"),
        (["--policy", tmp_path / "none.npz"], "there is no such policy file"),
    ]
    for arguments, says in cases:
        code, out, err = stltool("why", PATROLLING, *SMALL, *arguments)
        assert (code, out) == (2, ""), arguments
        assert says in " ".join(err.replace("│", " ").split()), arguments
