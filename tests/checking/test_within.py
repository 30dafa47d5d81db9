"""`cost_distribution` against walking all histories, in fractions, and its laws."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, SizeError
from stltool.testing import mdps
from tests import oracles
from tests.checking.test_check import random_policy
from tests.checking.test_costs import tolled
from tests.conftest import many


@st.composite
def cases(draw, exact=None):
    model = draw(mdps(exact=draw(st.booleans()) if exact is None else exact))
    denominator = draw(st.sampled_from((1, 2, 3)))
    return tolled(draw, model, st.integers(0, 3).map(lambda n: Fraction(n, denominator)), horizon=3)


@given(cases(exact=True), st.booleans(), st.integers(0, 3), st.sampled_from(("auto", "nodes")))
@settings(max_examples=many(25))
def test_every_budget_equals_the_tree_of_all_histories(case, maximize, seed, engine):
    product, cost = case
    policy = random_policy(product, np.random.default_rng(seed), True, seed == 2) if seed else None
    asked = {"maximize": maximize, "engine": engine}
    exactly = stl.cost_distribution(product, "toll", 8, policy, exact=True, **asked)
    enclosed = stl.cost_distribution(product, "toll", 8, policy, **asked)
    assert enclosed.budgets == exactly.budgets
    for budget in (*exactly.budgets[:: max(1, len(exactly.budgets) // 4)], Fraction(15, 2)):
        truth = oracles.within_budget(product, cost, budget, policy, maximize)
        assert exactly.exactly(budget) == truth
        for found in (exactly, enclosed):
            lower, upper = found.at(budget)
            assert Fraction(lower) <= truth <= Fraction(upper)
            assert upper - lower <= 1e-12
    assert (np.diff(enclosed.upper) >= -1e-12).all()
    assert exactly.question == ("policy" if seed else "maximum" if maximize else "minimum")
    if not seed:  # the policy that knows what is left attains the value
        again = stl.check(exactly.product, exactly.policy, exact=True)
        assert again.fraction == exactly.fractions[-1]


@given(cases(), st.booleans())
@settings(max_examples=many(20))
def test_enough_budget_leaves_the_ordinary_check(case, maximize):
    product, _ = case
    found = stl.cost_distribution(product, "toll", 9 * product.horizon, maximize=maximize)
    plain = stl.check(product, maximize=maximize)
    assert found.lower[-1] <= plain.upper
    assert plain.lower <= found.upper[-1]


@pytest.fixture(scope="module")
def door():
    """Trying the door costs 2 and opens it half of the time; pushing costs 3 and opens it with 3/4."""
    stay, once, push = [[1, 0], [0, 1]], [["1/2", "1/2"], [0, 1]], [["1/4", "3/4"], [0, 1]]
    model = stl.MDP.from_arrays(
        [stay, once, push], {"x": [-1, 2]}, labels={"open": [0, 1]}, action_names=["wait", "try", "push"],
        state_names=["shut", "ajar"], costs={"effort": [[0, 2, 3], [0, 2, 3]]},
    )  # fmt: skip
    return stl.build_product(model, stl.parse("F[0,3] open"))


def test_the_door(door):
    found = stl.cost_distribution(door, "effort", 7, exact=True)
    assert found.budgets == tuple(map(Fraction, range(8)))
    half, quarter = Fraction(1, 2), Fraction(1, 4)
    assert found.fractions == (
        0, 0, half, 1 - quarter, 1 - half**2, 1 - half * quarter, 1 - quarter**2, 1 - half**2 * quarter
    )  # fmt: skip
    assert found.smallest(0.75) == 3
    assert found.smallest(Fraction(15, 16)) == 6
    assert found.smallest(1) is None
    assert [c for c, _, _ in found.steps()] == [0, 2, 3, 5, 6]
    assert "P(task and effort <= c), the maximum, 8 budgets" in repr(found)
    assert found.at(2.5) == (0.5, 0.5)
    assert (found.at(-1), found.exactly(-1)) == ((0, 0), 0)
    one = stl.cost_distribution(door, lambda state, action: Fraction(action != "wait", 10), "0.25" and Fraction(1, 4))
    assert one.budgets == (0, Fraction(1, 10), Fraction(1, 5))
    assert one.at(0.25) == one.at(Fraction(1, 5))
    assert one.product.model.state_name(3) == "shut; 1/5 of <lambda> left" or "0.2" in one.product.model.state_name(3)


def test_a_cost_of_nothing_leaves_p(door):
    found = stl.cost_distribution(door, lambda state, action: 0, 0)
    assert found.budgets == (0,)
    assert found.at(0) == (lambda r: (r.lower, r.upper))(stl.check(door))


def test_bad_questions_are_refused(door):
    with pytest.raises(NameLookupError, match="no cost, signal or label effor; did you mean effort"):
        stl.cost_distribution(door, "effor", 3)
    with pytest.raises(SettingsError, match="cost x is negative somewhere"):
        stl.cost_distribution(door, "x", 3)
    with pytest.raises(SettingsError, match="at_most is -1; give a budget of at least 0"):
        stl.cost_distribution(door, "effort", -1)
    with pytest.raises(SettingsError, match="the budget 9 is above the largest that was asked for, 7"):
        stl.cost_distribution(door, "effort", 7).at(9)
    with pytest.raises(SizeError, match="round the costs to a larger unit, or take a smaller budget"):
        stl.cost_distribution(door, lambda state, action: 1e-9, 1000)
