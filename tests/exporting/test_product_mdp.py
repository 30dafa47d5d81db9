"""Products as MDPs of their own: what their states are, and what is refused."""

import numpy as np
import pytest

import stltool as stl
from stltool.errors import PolicyError, SettingsError, SizeError
from tests.conftest import FACTORY
from tests.exporting.products import factory


def test_states_lead_back_to_the_product():
    product = factory("docks.stl", {})
    exported = stl.product_mdp(product, clock=True)
    model, automaton = exported.model, product.automaton
    assert (exported.state[0], model.state_name(0)) == (-1, "before the first state")
    later = exported.state >= 0
    q = exported.remembered.state[exported.memory[later]]
    verdicts = [automaton.verdicts(int(t))[m] for t, m in zip(exported.step[later], q, strict=True)]
    assert np.array_equal(model.labels["satisfied"][later], np.array(verdicts) == 1)
    assert np.array_equal(model.labels["violated"][later], np.array(verdicts) == 0)
    assert np.array_equal(model.labels["A"][later], product.model.labels["A"][exported.state[later]])
    assert np.array_equal(model.signals["step"][later], exported.step[later])
    assert np.array_equal(model.signals["x"][later], product.model.signals["x"][exported.state[later]])
    (last,) = np.flatnonzero((exported.step == 6) & (exported.state == exported.state.max()))[:1]
    assert model.state_name(int(last)).startswith("step 6, state ")


def test_decided_states_stay_as_they_are():
    exported = stl.product_mdp(factory("charging.stl", {"T": "3", "tau": "2"}))
    model = exported.model
    for s in np.flatnonzero(model.labels["satisfied"]).tolist():
        (c,) = range(model.choice_start[s], model.choice_start[s + 1])
        assert model.action_names[model.choice_action[c]] == "end"
        assert model.target[model.row_start[c] : model.row_start[c + 1]].tolist() == [s]


def test_a_product_that_would_not_fit_is_refused_with_its_size():
    product = factory("patrolling.stl", {"T": "5", "tau": "5"})
    with pytest.raises(SizeError, match=r"18 model states, 35 of memory and 9 steps, of which at least \d+ states"):
        stl.product_mdp(product, clock=True, memory_limit=10_000)
    assert stl.product_mdp(product, clock=True, memory_limit=10_000_000).model.n_states == 122


def test_rows_that_are_computed_on_demand(tmp_path):
    """Of a large model only what is reached, and all of that."""
    line = "." * 150
    path = tmp_path / "floor.toml"
    path.write_text(f'kind = "grid"\nmap = """\n{(line + chr(10)) * 150}S.A{line[3:]}\n"""\ncell = 1\nmoves = "king"\n'
                    'success = "93/100"\nslip = "7/300"\n')  # fmt: skip
    model = stl.load_model(path)
    assert type(model.some_rows()).__name__ == "Demand"
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    exported = stl.product_mdp(product, clock=True)
    assert exported.model.n_states < 50
    again = stl.build_product(exported.model, stl.parse("F[0,3] satisfied"))
    assert stl.check(again, exact=True).fraction == stl.check(product, exact=True).fraction


def test_variables_do_not_take_names_that_the_model_has():
    """Signal C becomes C_, a keyword's other name, unless there is one: here a signal, a label and a variable meet."""
    signals = {"C": [0, 1], "C_": [3, 4]}
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], signals, labels={"F_0_2_A": [0, 1], "A": [0, 1]})
    exported = stl.product_mdp(stl.build_product(model, stl.parse("F[0,2] A")))
    assert exported.of_state.names == ("C__2", "C_")
    assert [variable.name for variable in exported.remembered.variables] == ["F_0_2_A_2"]
    assert exported.model.signals["C"].tolist() == [0, 1]
    assert exported.model.signals["C_"].tolist() == [3, 4]


def test_what_has_no_product_is_refused():
    hidden = stl.MDP.black_box(1, 1, lambda rng: None, labels={"A": [1]})
    with pytest.raises(SettingsError, match="the probabilities of black box are unknown"):
        stl.product_mdp(stl.build_product(hidden, stl.parse("F[0,2] A")))
    unknown = stl.load_model(FACTORY / "floor-5x5-p.toml")
    product = stl.build_product(unknown, stl.parse("F[0,2] A"))
    with pytest.raises(SettingsError, match="depend on p"):
        stl.product_mdp(product)
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    silent = stl.Policy(product, np.full(product.shape, -1))
    with pytest.raises(PolicyError, match="the policy defines no action at step 0, state 0"):
        stl.product_mdp(product, silent)
