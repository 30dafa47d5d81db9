"""`stltool check --cost`: the same numbers as `expected_cost`."""

import json

import pytest

import stltool as stl
from tests.conftest import PATROLLING, SMALL


def test_the_least_the_greatest_and_a_policys(stltool, tmp_path, floor5):
    product = stl.build_product(floor5, stl.load_task(PATROLLING, params={"T": 5, "tau": 5}))
    policy = stl.check(product).policy
    policy.save(tmp_path / "best.npz")
    asked = ["check", PATROLLING, *SMALL, "--cost", "B", "--policy", tmp_path / "best.npz"]
    code, out, err = stltool(*asked, "--json")
    data = json.loads(out)
    assert (code, err, data["until"]) == (0, "", "verdict")
    bounds = [(one["lower"], one["upper"]) for one in data["expected"]]
    found = [stl.expected_cost(product, "B", maximize=maximize) for maximize in (False, True)]
    assert bounds == [(one.lower, one.upper) for one in [*found, stl.expected_cost(product, "B", policy)]]
    code, out, _ = stltool(*asked, "--until", "horizon")
    assert code == 0
    assert "B, over 8 steps" in out
    assert "minimum over all policies" in out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--cost", "nothing"], "the model has no cost, signal or label nothing"),
        (["--cost", "B", "--at-least", "0.9"], "--at-least is for the probability of the task"),
        (["--cost", "B", "--until", "end"], "--until is 'end'; choose verdict or horizon"),
        (["--until", "horizon"], "add --cost NAME, or leave it out"),
    ],
)
def test_bad_questions_end_with_a_message(stltool, options, says):
    code, out, err = stltool("check", PATROLLING, *SMALL, *options)
    assert (code, out) == (2, "")
    assert says in err
