"""Costs of models: how they are given, that they stay with their transitions, and what is refused."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

import stltool as stl
from stltool.errors import ModelError, SettingsError
from stltool.models import Cost
from stltool.models.costs import Amounts

STAY, SWAP = np.eye(2), np.array([[0.1, 0.9], [0.0, 0.0]])  # SWAP is not available in state 1
MOVES = [[[0, 0], [0, 0]], [["7/3", 5], [8, 9]]]


def build(**changes):
    arguments = {"transitions": [STAY, SWAP], "signals": {"x": [0.0, 1.0]}, "labels": {"A": [1, 0]}}
    return stl.MDP.from_arrays(**(arguments | changes))


def test_a_cost_is_a_sum_of_numbers_for_states_choices_and_transitions():
    model = build(
        costs={
            "time": ["0.1", 1], "wear": [[1, 2], [3, 4]], "way": MOVES, "all": {"states": [1, 2], "choices": np.eye(2)},
        }
    )  # fmt: skip
    assert model.costs["time"].states.values.tolist() == [0.1, 1]
    assert model.costs["time"].states.exact[0] == Fraction(1, 10)
    assert model.costs["wear"].choices.values.tolist() == [1, 2, 3]  # state 1 has one action
    assert [model.costs["way"].transitions.exact[k] for k in range(4)] == [0, Fraction(7, 3), 5, 0]
    assert [list(cost.parts) for cost in model.costs.values()] == [
        ["states"], ["choices"], ["transitions"], ["states", "choices"],
    ]  # fmt: skip
    assert model.costs["all"].range == (1, 3)
    assert "costs: time, wear, way, all" in repr(model)
    assert repr(model.costs["wear"]) == "Cost\n  choices: 3 of 3 nonzero, in [1, 3]"
    sparse_ones = [sparse.csr_array(matrix) for matrix in (np.zeros((2, 2)), SWAP)]
    assert build(costs={"c": sparse_ones}).costs["c"].transitions.values.tolist() == [0, 0.1, 0.9, 0]


def test_doubles_mean_their_shortest_decimals_and_costs_are_in_the_digest():
    digests = {build(costs=costs).digest() for costs in ({}, {"c": [0.1, 1]}, {"d": [0.1, 1]}, {"c": [0.1, 2]})}
    assert len(digests) == 4
    assert build(costs={"c": np.array([0.1, 1])}).costs["c"].states.exact[0] == Fraction(1, 10)
    with pytest.raises(ValueError, match="read-only"):
        build(costs={"c": [0.1, 1]}).costs["c"].states.values[:] = 0


def test_costs_stay_with_their_transitions():
    lower, upper = [[[0, 0.5], [0, 1]]], [[[0.5, 1], [0, 1]]]
    loose = stl.MDP.from_intervals([np.array([[0, 1.0], [0, 1]])], upper, {}, costs={"way": [[[3, 4], [5, 6]]]})
    assert loose.costs["way"].transitions.values.tolist() == [3, 4, 6]
    assert loose.nominal().costs["way"].transitions.values.tolist() == [4, 6]
    wide = stl.MDP.from_intervals(lower, upper, {}, costs={"way": [[[3, 4], [5, 6]]], "c": [1, 2]})
    point = wide.nominal().with_rows()
    assert point.costs["way"].transitions.values.tolist() == [3, 4, 6]
    assert point.digest() == wide.nominal().digest()
    fewer = {"row_start": np.array([0, 1, 2]), "target": np.array([1, 1], dtype=np.int32), "probability": np.ones(2)}
    assert point.with_rows(**fewer, exact=None).costs["way"].transitions.values.tolist() == [4, 6]
    other = {**fewer, "target": np.array([1, 0], dtype=np.int32)}
    with pytest.raises(ModelError, match="cost way has no number for some of the transitions; leave out this cost"):
        point.with_rows(**other, exact=None)


def test_costs_of_families_have_the_entries_of_all_members():
    family = build(
        transitions=[[["1-p", "p"], [0, 1]]], parameters={"p": (0, 1)}, costs={"way": [[["3", 4], [5, 6]]], "c": [1, 2]}
    )
    assert family.costs["way"].transitions.values.tolist() == [3, 4, 6]
    never, always = family.at(p=0), family.at(p=1)
    assert (never.costs["way"].transitions.values.tolist(), always.costs["way"].transitions.values.tolist()) == (
        [3, 6], [4, 6],
    )  # fmt: skip
    assert never.family.costs["way"].transitions.values.tolist() == [3, 4, 6]
    assert never.at(p=1).digest() == always.digest()
    with pytest.raises(ModelError, match="cost c depends on parameters; only probabilities may"):
        stl.MDP.from_family(
            lambda p: build(transitions=[[[p, 1 - p], [0, 1]]], costs={"c": [p, 0]}), {"p": ("1/4", "3/4")}
        )
    with pytest.raises(ModelError, match="different costs"):
        stl.MDP.from_family(
            lambda p: build(transitions=[[[p, 1 - p], [0, 1]]], costs={} if p < 0.6 else {"c": [1, 0]}),
            {"p": ("1/4", "3/4")},
        )


def test_functions_have_costs_of_states_and_choices():
    def step(s, a):
        return np.stack([s], axis=1), np.ones((len(s), 1))

    model = stl.MDP.from_function(
        2, 2, step, available=[[True, False], [True, True]], costs={"c": [[1, 2], [3, 4]], "d": [5, 6]}
    )
    assert model.costs["c"].choices.values.tolist() == [1, 3, 4]
    with pytest.raises(
        ModelError, match=r"cost c has shape \(2, 2, 2\); give \(2,\) \(states\), or \(2, 2\) \(choices\)"
    ):
        stl.MDP.from_function(2, 2, step, costs={"c": np.zeros((2, 2, 2))})


def test_budgets_take_costs_of_states():
    tasks = [stl.parse_task("near := G[0,2] x < 1")]
    costs = {"fuel": [3, 1], "wear": [[1, 2], [3, 4]], "x": [1, 2], "gain": [-1, 1]}
    joint = stl.build_joint_product(build(costs=costs, signals={"x": [0.0, 1.0], "same": [3, 1]}), tasks)
    found, same = (stl.tradeoff(joint, "near", budget={name: 5}) for name in ("fuel", "same"))
    assert 0.1 < found.probability == same.probability < 1
    assert found.costs["fuel"] == same.costs["same"]
    for name, says in (
        ("wear", "cost wear depends on actions; a budget takes costs that depend on states alone"),
        ("x", "the model has a cost x and a signal x; rename one of them"),
        ("gain", "cost gain is -1 in state 0, but a cost must be at least 0"),
    ):
        with pytest.raises(SettingsError, match=says):
            stl.tradeoff(joint, "near", budget={name: 2})


@pytest.mark.parametrize(
    ("costs", "says"),
    [
        ({"c": [1]}, r"cost c has shape \(1,\); give \(2,\) \(states\), or \(2, 2\) \(choices\), or \(2, 2, 2\) \(tr"),
        ({"c": {"choices": [1, 2]}}, r"cost c: choices has shape \(2,\); give \(2, 2\) \(choices\)"),
        ({"c": {"choice": [1, 2]}}, "cost c: did you mean choices"),
        ({"c": ["far", 1]}, "cost c does not contain numbers"),
        ({"c": [np.nan, 1]}, "cost c of state 0 is nan; it must be finite"),
        ({"c": [[1, np.inf], [1, 1]]}, "cost c of choice 1 is inf; it must be finite"),
        ({"c": Cost(states=Amounts(np.ones(3)))}, r"cost c: states have shape \(3,\); give one number for each of 2"),
        ([1], "the model's costs are .*, not a mapping"),
        ({"c": [[1, 2], [3]]}, "cost c does not contain numbers"),
    ],
)
def test_bad_costs_are_refused_by_name(costs, says):
    with pytest.raises(stl.StlToolError, match=says):
        build(costs=costs)
