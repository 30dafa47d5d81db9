"""`expected_cost` against walking all histories, in fractions, and its laws."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, ModelError, NameLookupError, PolicyError, SettingsError
from stltool.models import Cost
from stltool.models.costs import Amounts, Entries
from stltool.testing import formulas, mdps
from tests import oracles
from tests.checking.test_check import random_policy
from tests.conftest import many

TENTHS = st.integers(0, 30).map(lambda n: Fraction(n, 10))
SIGNED = st.integers(-30, 30).map(lambda n: Fraction(n, 7))


def tolled(draw, model, numbers, horizon):
    """A product of a model with a cost of states, choices and transitions, and the cost as a function."""

    def amounts(n):
        return draw(st.lists(numbers, min_size=n, max_size=n))

    states, choices, entries = map(amounts, (model.n_states, model.n_choices, model.n_transitions))

    def given_as(numbers):
        return Amounts.read(np.array(numbers, dtype=object), "cost toll")

    along = given_as(entries)
    toll = Cost(
        given_as(states), given_as(choices),
        Entries(along.values, along.given, row_start=model.row_start, target=model.target),
    )  # fmt: skip
    model = dataclasses.replace(model, costs={"toll": toll})
    product = stl.build_product(model, draw(formulas(longest=2, max_leaves=4, horizon=horizon)))
    return product, lambda s, c, k: states[s] + choices[c] + entries[k]


@st.composite
def cases(draw):
    model = draw(mdps(exact=draw(st.booleans())))
    return tolled(draw, model, draw(st.sampled_from((TENTHS, SIGNED))), horizon=4)


def close(found, exact):
    assert Fraction(found.lower) <= exact <= Fraction(found.upper)
    assert found.lower <= found.value <= found.upper
    assert found.upper - found.lower <= 1e-11


@given(cases(), st.sampled_from(("verdict", "horizon")), st.booleans(), st.sampled_from(("nodes", "words")))
@settings(max_examples=many(60))
def test_the_least_and_the_greatest_equal_the_tree_of_all_histories(case, until, maximize, engine):
    product, cost = case
    found = stl.expected_cost(product, "toll", maximize=maximize, until=until, engine=engine)
    exact = oracles.expected_cost(product, cost, maximize=maximize, until=until)
    close(found, exact)
    again = stl.expected_cost(product, "toll", found.policy, until=until)
    assert again.question == "policy"
    assert abs(Fraction(again.value) - exact) < Fraction(1, 10**11)


@given(cases(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.sampled_from(("verdict", "horizon")))
@settings(max_examples=many(50))
def test_a_policys_cost_equals_the_tree_of_its_runs(case, seed, timed, mixed, until):
    product, cost = case
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    close(
        stl.expected_cost(product, "toll", policy, until=until),
        oracles.expected_cost(product, cost, policy, until=until),
    )


@given(cases(), st.sampled_from(("verdict", "horizon")), st.booleans(), st.integers(0, 2))
@settings(max_examples=many(40))
def test_exact_costs_are_fractions(case, until, maximize, seed):
    product, cost = case
    policy = random_policy(product, np.random.default_rng(seed), True, seed == 2) if seed else None
    if product.model.rows.defect:  # sixteenths given in doubles have none
        return
    found = stl.expected_cost(product, "toll", policy, maximize=maximize, until=until, exact=True)
    assert found.fraction == oracles.expected_cost(product, cost, policy, maximize, until)
    assert Fraction(found.lower) <= found.fraction <= Fraction(found.upper)
    assert found.upper - found.lower <= 1e-12


@pytest.fixture(scope="module")
def door():
    """Trying the door costs 2 and opens it half of the time; waiting costs 0."""
    stay, once = [[1, 0], [0, 1]], [["1/2", "1/2"], [0, 1]]
    model = stl.MDP.from_arrays(
        [stay, once], {"x": [-1, 2]}, labels={"open": [0, 1]}, action_names=["wait", "try"],
        state_names=["shut", "ajar"], costs={"effort": [[0, 2], [0, 2]], "noise": [[[0, 0], [0, 0]], [[0, 8], [0, 1]]]},
    )  # fmt: skip
    return stl.build_product(model, stl.parse("F[0,3] open"))


def test_what_is_paid_and_when(door):
    """Tries until the first success, at most 3: 1 + 1/2 + 1/4 of them; then, until the horizon, as the policy likes."""
    eager = stl.check(door).policy
    assert stl.expected_cost(door, "effort", eager).value == 2 * 1.75
    assert stl.expected_cost(door, "effort").value == 0
    assert stl.expected_cost(door, "effort", maximize=True).value == 2 * 1.75
    assert stl.expected_cost(door, "effort", maximize=True, until="horizon").value == 2 * 3
    assert stl.expected_cost(door, "noise", eager).value == 8 * (1 - 0.5**3)
    assert stl.expected_cost(door, "x", eager).value == -1.75
    assert stl.expected_cost(door, "open", eager).value == 0
    assert stl.expected_cost(door, lambda state, action: state == "shut" and action == "try", eager).value == 1.75
    found = stl.expected_cost(door, "effort", eager)
    assert "E[effort] = 3.5, of the policy, until the verdict" in repr(found)


@pytest.fixture(scope="module")
def coin():
    """Two states that follow each other by chance; the first one has `init` and `b`, the last one `a`."""
    return stl.MDP.from_arrays([[["1/2", "1/2"]] * 2], {}, labels={"init": [1, 0], "a": [0, 1], "b": [1, 0]}, initial=0)


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("F[0,2] a | G[0,2] a", Fraction(3, 2)),
        ("G[0,3] (a -> once[0,5] init)", 0),
        ("F[0,2] a & (F[0,3] init | G[0,3] !init)", Fraction(3, 2)),
        ("F[1,1] prev b", 0),
        ("G[0,1] (a | prev b)", 0),
        ("F[1,2] (a | !a)", 0),
        ("F[2,4] true", 0),
        ("F[0,3] (a & init)", 0),
    ],
)
def test_the_verdict_is_that_of_the_task_whatever_automaton_decides_it(coin, text, steps):
    """Automata of tasks about the past, and of tautologies, decide later than they could; nothing is paid for that."""
    past = "once" in text or "prev" in text  # which histories of the future cannot tell
    for encoding in ("exact",) if past else ("exact", "history"):
        product = stl.build_product(coin, stl.parse(text), encoding=encoding)
        found = stl.expected_cost(product, lambda state, action: 1, exact=True)
        assert found.fraction == steps, encoding
        free = stl.cost_distribution(product, lambda state, action: 1, 0, exact=True).exactly(0)
        assert free == (stl.check(product, exact=True).fraction if steps == 0 else 0)
        runner = stl.Runner(product)
        runner.act("0")
        assert (runner.verdict is None) == (steps > 0)


@given(cases(), st.booleans())
@settings(max_examples=many(20))
def test_costs_do_not_depend_on_the_encoding(case, maximize):
    product, _ = case
    other = stl.build_product(product.model, product.formula, encoding="history")
    lower, upper = (stl.expected_cost(one, "toll", maximize=maximize) for one in (product, other))
    assert lower.value == pytest.approx(upper.value, abs=1e-11)


def test_exactly(door):
    found = stl.expected_cost(door, lambda state, action: Fraction(action == "try", 3), maximize=True, exact=True)
    assert found.fraction == Fraction(7, 12)
    assert "exactly: 7/12" in repr(found)
    assert stl.expected_cost(door, lambda state, action: 0.1, maximize=True, exact=True).fraction == Fraction(3, 10)
    assert stl.expected_cost(door, "x", exact=True).fraction == -3


def test_a_cost_of_nothing_is_exactly_nothing(door):
    found = stl.expected_cost(door, lambda state, action: 0, maximize=True)
    assert (found.lower, found.value, found.upper) == (0, 0, 0)


def test_bad_questions_are_refused(door):
    with pytest.raises(NameLookupError, match="no cost, signal or label effor; did you mean effort"):
        stl.expected_cost(door, "effor")
    with pytest.raises(ArgumentError, match="returned nan for state shut, action wait; return a finite number"):
        stl.expected_cost(door, lambda state, action: float("nan"))
    with pytest.raises(ArgumentError, match="not a cost's name, or a function"):
        stl.expected_cost(door, 3)
    with pytest.raises(SettingsError, match="until is 'end'"):
        stl.expected_cost(door, "effort", until="end")
    with pytest.raises(SettingsError, match="cost cost is up to 1e\\+100 per step"):
        stl.expected_cost(door, type("cost", (), {"__call__": lambda self, s, a: 1e100, "__name__": "cost"})())
    with pytest.raises(PolicyError, match="use until='verdict'"):
        stl.expected_cost(door, "effort", stl.Policy(door, np.array([[1, 1], [-1, -1]])), until="horizon")
    with pytest.raises(PolicyError, match="the policy defines no action at step 0, state shut"):
        stl.expected_cost(door, "effort", stl.Policy(door, np.array([[-1, -1], [0, 0]])))


def test_exact_costs_need_rows_that_sum_to_one():
    model = stl.MDP.from_arrays([[[0.5 + 1e-13, 0.5], [0, 1]]], {"x": [0, 1]}, labels={"a": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,3] a"))
    assert stl.expected_cost(product, "x").value >= 0
    with pytest.raises(ModelError, match="sum"):
        stl.expected_cost(product, "x", exact=True)
