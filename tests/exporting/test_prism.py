"""Programs of the PRISM language mean what their products mean: in fractions, by a slow reader of such programs."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.exporting.prism import to_prism
from tests.conftest import many
from tests.exporting.products import TASKS, answers, factory, mixture, policies, products
from tests.prism import Program


def agree(product, policy, clock):
    """The program's probabilities are the task's, its sizes those of the exported model; returns both."""
    exported = stl.product_mdp(product, policy, clock=clock)
    program = Program(to_prism(exported))
    wanted = answers(product, policy)
    assert set(exported.questions) == set(wanted)
    assert {name: program.value(question) for name, question in exported.questions.items()} == wanted
    model = exported.model
    assert program.sizes() == (model.n_states, model.n_choices, model.n_transitions)
    assert program.kind == ("mdp" if policy is None else "dtmc")
    assert not clock or all("<=" not in question.property for question in exported.questions.values())
    return exported, program


@pytest.mark.soak
@settings(max_examples=many(25))
@given(products(), st.booleans())
def test_random_products_and_their_chains(product, clock):
    for policy in policies(product):
        _, program = agree(product, policy, clock)
        assert program.require_total()


def test_a_task_that_cannot_hold_has_a_property_all_the_same():
    """Formats without labels of no state, such as DRN, have no label "satisfied" then."""
    product = stl.build_product(stl.MDP.from_arrays([[[1]]], {}, labels={"A": [0]}), stl.parse("F[0,2] A"))
    exported, _ = agree(product, None, clock=False)
    assert exported.questions["maximum"].property == "Pmax=? [ F<=2 false ]"
    exported, _ = agree(product, None, clock=True)
    assert exported.questions["maximum"].property == "Pmax=? [ F false ]"


def test_rows_of_a_mixture_sum_to_one_where_runs_start_in_several_states():
    model = stl.MDP.from_arrays([[[0.5, 0.5]] * 2, [[0.1, 0.9]] * 2], {}, [0.5, 0.5], {"A": [0, 1]})
    product = stl.build_product(model, stl.parse("G[0,2] A"))
    exported, _ = agree(product, mixture(product, 0, by_step=True), clock=False)
    assert exported.model.rows.defect == 0


SMALL = [task for task in TASKS if task[0] not in ("shift.stl", "patrolling.stl")]


@pytest.mark.parametrize(("name", "params"), SMALL, ids=[name for name, _ in SMALL])
def test_the_factory_tasks(name, params):
    product = factory(name, params)
    for policy in (None, stl.check(product).policy):
        agree(product, policy, clock=False)[1].require_total()
