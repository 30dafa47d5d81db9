"""P from each initial state and from every state, as model checkers report it."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking import values as module
from stltool.errors import ModelError, NameLookupError, SettingsError
from stltool.testing import formulas, interval_mdps, mdps
from tests import oracles
from tests.checking.test_check import random_policy
from tests.conftest import many

COIN = """@type: MDP
@parameters

@reward_models

@nr_states
4
@nr_choices
6
@model
state 0 init
\taction 0
\t\t1 : 1/3
\t\t2 : 2/3
\taction 1
\t\t0 : 1
state 1 init
\taction 0
\t\t1 : 9/10
\t\t3 : 1/10
state 2
\taction 0
\t\t0 : 1/7
\t\t3 : 6/7
\taction 1
\t\t1 : 1
state 3 done
\taction 0
\t\t3 : 1
"""


def starting(product, s):
    """The same product, with runs that start in one state."""
    one = (np.arange(product.model.n_states) == s).astype(np.int64)
    return dataclasses.replace(product, model=dataclasses.replace(product.model, initial=one, exact_initial=None))


@given(st.booleans(), st.data(), st.booleans(), st.sampled_from(("auto", "double", "exact")), st.integers(0, 3))
@settings(max_examples=many(40))
def test_each_value_is_that_of_the_tree_from_there(exact, data, maximize, how, seed):
    model = data.draw(mdps(exact=exact or how == "exact"))
    product = stl.build_product(model, data.draw(formulas(longest=2, max_leaves=4, horizon=3)))
    options = {"exact": True} if how == "exact" else {"arithmetic": how}
    policy = random_policy(product, np.random.default_rng(seed), True, how == "double") if seed else None
    found = stl.check(product, policy, maximize=maximize, values="all", **options)
    initial = stl.check(product, policy, maximize=maximize, values="initial", **options).values
    assert (found.lower, found.upper) == (lambda r: (r.lower, r.upper))(
        stl.check(product, policy, maximize=maximize, **options)
    )
    assert initial.states.tolist() == np.flatnonzero(model.initial).tolist()
    for s, one in enumerate(found.values):
        there = starting(product, s)
        truth = (
            oracles.policy_value(there, stl.Policy(there, policy.form))
            if policy is not None
            else oracles.optimum(there.model, there.formula, maximize)
        )
        assert Fraction(one.lower) <= truth <= Fraction(one.upper)
        assert one.lower <= one.value <= one.upper
        assert one.upper - one.lower <= 1e-12
        if how == "exact":
            assert one.fraction == truth
    for place, s in enumerate(initial.states.tolist()):
        assert initial[place] == found.values[s]


@given(interval_mdps(), st.booleans(), st.sampled_from(("against", "with")), st.data())
@settings(max_examples=many(20))
def test_of_interval_models_too(model, maximize, nature, data):
    product = stl.build_product(model, data.draw(formulas(longest=2, max_leaves=4, horizon=3)))
    found = stl.robust_check(product, maximize=maximize, nature=nature, values="all").values
    for s, one in enumerate(found):
        truth = oracles.robust_optimum(
            starting(product, s).model, product.formula, maximize, maximize == (nature == "against")
        )
        assert Fraction(one.lower) <= truth <= Fraction(one.upper)


@pytest.mark.parametrize("arithmetic", ["double", "fixed"])
def test_bounds_of_many_values_enclose_those_of_few(floor5, monkeypatch, arithmetic):
    """Where there are too many different values for fractions, doubles are rounded outwards: hardly wider."""
    product = stl.build_product(floor5, stl.parse("F[0,7] (C & F[0,4] A)"))
    few = stl.check(product, values="all", arithmetic=arithmetic).values
    monkeypatch.setattr(module, "_FEW", 0)
    rough = stl.check(product, values="all", arithmetic=arithmetic).values
    assert (rough.lower <= few.lower).all()
    assert (few.upper <= rough.upper).all()
    assert (rough.upper - rough.lower <= few.upper - few.lower + 1e-14).all()
    assert len(np.unique(few.value)) > 5


def test_storm_reports_the_same_from_every_state(tmp_path):
    stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")
    path = tmp_path / "coin.drn"
    path.write_text(COIN)
    product = stl.build_product(stl.load_model(path, initial="uniform"), stl.parse("F[0,4] done"))
    theirs = stormpy.build_model_from_drn[stormpy.Rational](str(path))
    for maximize, name in ((True, "max"), (False, "min")):
        (asked,) = stormpy.parse_properties(f'P{name}=? [F<=4 "done"]')
        answer = stormpy.model_checking(theirs, asked)
        ours = stl.check(product, maximize=maximize, exact=True, values="all").values
        assert [one.fraction for one in ours] == [Fraction(str(answer.get_value(s))) for s in range(4)]
        starts = stl.check(product, maximize=maximize, exact=True, values="initial").values
        assert [one.fraction for one in starts] == [
            Fraction(str(answer.get_value(s))) for s in sorted(theirs.initial_states)
        ]


def test_several_named_starts(tmp_path):
    path = tmp_path / "coin.drn"
    path.write_text(COIN)
    assert stl.load_model(path, initial=["2", 0]).initial.tolist() == [0.5, 0, 0.5, 0]
    assert stl.load_model(path, initial=[0, "0"]).initial.tolist() == [1, 0, 0, 0]
    with pytest.raises(SettingsError, match="names states and 'uniform', which are all of them; give one"):
        stl.load_model(path, initial=["0", "uniform"])
    with pytest.raises(SettingsError, match="initial is 1.5; give a state's name or number, a list of them"):
        stl.load_model(path, initial=[1.5])
    with pytest.raises(ModelError, match="there is no initial state"):
        stl.load_model(path, initial=["0", "9"])


def test_values_by_name(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,6] C"))
    found = stl.check(product, values="all").values
    name = floor5.state_name(7)
    assert found[name] == found[7] == list(found)[7]
    assert found[-1] == found[17]
    assert [each.name for each in found[:2]] == [floor5.state_name(0), floor5.state_name(1)]
    assert found.least.value == min(each.value for each in found)
    assert found.greatest.value == max(each.value for each in found)
    assert found.at_least(found.least.lower)
    assert found.at_least(found.greatest.upper) is False
    assert found.at_most(found.least.lower) is False
    assert found.at_most(found.greatest.upper)
    with pytest.raises(NameLookupError, match="there is no value for the state 'nowhere'"):
        found["nowhere"]
    with pytest.raises(SettingsError, match="values is 'some'; choose initial or all"):
        stl.check(product, values="some")


def test_a_policy_that_is_silent_from_another_start_is_refused_with_the_place(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,6] C"))
    table = stl.check(product).policy.table.copy()
    table[0, floor5.initial == 0] = -1
    assert stl.check(product, stl.Policy(product, table)).probability > 0
    with pytest.raises(stl.errors.PolicyError, match="the policy defines no action at step 0, state"):
        stl.check(product, stl.Policy(product, table), values="all")
