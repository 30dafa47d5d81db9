"""Programs of the PRISM language mean what their products mean: in fractions, by a slow reader of such programs."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.exporting.prism import to_prism
from tests.conftest import many
from tests.exporting.products import TASKS, answers, factory, policies, products
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
@settings(max_examples=many(50))
@given(products(), st.booleans())
def test_random_products_and_their_chains(product, clock):
    for policy in policies(product):
        _, program = agree(product, policy, clock)
        assert program.require_total()


@pytest.mark.parametrize(("name", "params"), TASKS, ids=[name for name, _ in TASKS])
def test_the_factory_tasks(name, params):
    product = factory(name, params)
    for policy in (None, stl.check(product).policy):
        agree(product, policy, clock=False)[1].require_total()
