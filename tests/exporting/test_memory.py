"""What tasks remember, as variables: one for each part, with names, wherever the parts can be told apart."""

import numpy as np
import pytest

import stltool as stl
from stltool.exporting import memory
from tests.conftest import FACTORY, ROOT
from tests.exporting.products import factory


def remembered(path, **params):
    task = stl.load_task(ROOT / "examples" / path, params)
    return stl.product_mdp(stl.build_product(stl.load_model(task.model), task)).remembered


@pytest.mark.parametrize(
    ("path", "params", "names"),
    [
        ("factory/patrolling.stl", {"T": "5", "tau": "5"}, ["without_at_A", "without_at_B"]),
        ("factory/charging.stl", {"T": "5", "tau": "3"}, ["held_at_charger"]),
        # its automaton has merged states in which a part no longer matters
        ("factory/shift.stl", {"T": "8", "tau": "10"}, ["without_A", "without_B", "held_C", "not_C_U_0_7_B"]),
        ("zeroconf/address.stl", {}, ["F_0_5_configured"]),
        ("ward/delivery.stl", {}, ["F_0_8_P_and_F_0_10_W", "G_0_18_not_X"]),
    ],
)
def test_each_part_has_a_variable_with_a_name(path, params, names):
    found = remembered(path, **params)
    assert [variable.name for variable in found.variables] == names
    for i, variable in enumerate(found.variables):
        assert set(found.values[:, i]) == set(range(len(variable.meanings)))
    assert len(np.unique(found.values, axis=0)) == len(found)


def test_values_have_meanings():
    (variable,) = remembered("factory/charging.stl", T="5", tau="3").variables
    assert variable.meanings == (
        "nothing pending",
        "at_charger for 1 step",
        "possible since 1 step: at_charger",
        "the task holds",
    )


def test_updates_that_are_not_those_of_the_automaton_are_not_taken(monkeypatch):
    """What is found is compared with the automaton; whatever is proposed, the program means the task."""
    proposed = memory._update

    def wrong(*given):
        return np.where(proposed(*given) > 0, 0, proposed(*given)).astype(np.int32)

    monkeypatch.setattr(memory, "_update", wrong)
    product = factory("charging.stl", {"T": "5", "tau": "3"})
    exported = stl.product_mdp(product)
    assert [variable.name for variable in exported.remembered.variables] == ["memory"]
    again = stl.build_product(exported.model, stl.parse("F[0,6] satisfied"))
    assert stl.check(again, exact=True).fraction == stl.check(product, exact=True).fraction


def test_parts_that_cannot_be_told_apart_are_one_number():
    task = stl.load_task(FACTORY / "charging.stl", {"T": "3", "tau": "3"})
    product = stl.build_product(stl.load_model(task.model), task, "history")
    (variable,) = stl.product_mdp(product).remembered.variables
    assert len(variable.meanings) > 3
