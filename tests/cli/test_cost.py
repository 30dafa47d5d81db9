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


def test_the_probability_within_a_budget(stltool, tmp_path, floor5):
    product = stl.build_product(floor5, stl.load_task(PATROLLING, params={"T": 5, "tau": 5}))
    asked = ["check", PATROLLING, *SMALL, "--cost", "B", "--within", "3"]
    code, out, err = stltool(*asked, "--at-least", "0.5", "--save-policy", tmp_path / "best.npz", "--json")
    data = json.loads(out)
    found = stl.cost_distribution(product, "B", 3)
    assert (code, err, data["holds"], data["within"]) == (0, "", True, "3")
    assert (data["lower"], data["upper"]) == (found.lower.tolist(), found.upper.tolist())
    again = stl.check(found.product, stl.load_policy(tmp_path / "best.npz", found.product))
    assert again.lower <= found.upper[-1]
    assert found.lower[-1] <= again.upper
    code, out, _ = stltool(*asked, "--at-least", "0.99", "--exact")
    assert code == 1
    assert "P >= 0.99 with B <= 3           does not hold" in out
    assert "smallest budget with P >= 0.99  more than 3" in out
    exact = stl.cost_distribution(product, "B", 3, exact=True)
    assert str(exact.fractions[-1]) in out


def test_within_a_budget_whatever_nature_does(stltool):
    asked = ["check", "examples/factory/uncertain.stl", "-p", "T=4", "-p", "tau=5", "--cost", "B", "--within", "2"]
    lower = {}
    for nature in ("against", "nominal", "with"):
        code, out, _ = stltool(*asked, "--nature", nature, "--json")
        assert code == 0
        lower[nature] = json.loads(out)["lower"][-1]
    assert 0 < lower["against"] < lower["nominal"] < lower["with"] < 1
    code, out, err = stltool(*asked[:-2])
    assert (code, out) == (2, "")
    assert "--cost needs probabilities without intervals; add --nominal" in err
    assert stltool(*asked[:-2], "--nominal")[0] == 0


def test_exact_expected_costs(stltool, floor5):
    product = stl.build_product(floor5, stl.load_task(PATROLLING, params={"T": 5, "tau": 5}))
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--cost", "B", "--exact", "--json")
    assert code == 0
    exact = [stl.expected_cost(product, "B", maximize=maximize, exact=True).fraction for maximize in (False, True)]
    assert [one["exact"] for one in json.loads(out)["expected"]] == list(map(str, exact))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--cost", "nothing"], "the model has no cost, signal or label nothing"),
        (["--cost", "B", "--at-least", "0.9"], "--at-least is not supported with --cost without --within"),
        (["--cost", "B", "--within", "x"], "--within x: "),
        (["--within", "3"], "--within 3 is a budget for a cost; add --cost NAME"),
        (["--cost", "B", "--within", "3", "--until", "horizon"], "--until is not supported with --cost; leave one out"),
        (["--cost", "B", "--until", "end"], "--until is 'end'; choose verdict or horizon"),
        (["--until", "horizon"], "add --cost NAME, or leave it out"),
    ],
)
def test_bad_questions_end_with_a_message(stltool, options, says):
    code, out, err = stltool("check", PATROLLING, *SMALL, *options)
    assert (code, out) == (2, "")
    assert says in err
