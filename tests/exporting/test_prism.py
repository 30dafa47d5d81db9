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


@pytest.mark.parametrize(
    ("text", "encoding", "counted", "bound"),
    [
        ("G[0,3] F[0,1] a", "history", 0, 4),  # the rest is true
        ("F[0,1] (a & F[0,1] b)", "history", 0, 2),  # the rest is false
        ("a <-> F[2,2] b", "history", 0, None),  # no rest
        ("G[0,3] F[0,1] a", "paper", 1, 4),  # no flag set: undecided at step 0, violated from step 1 on
        ("F[0,2] a & G[2,4] !b", "exact", 2, 4),
        ("(F[0,3] a) & (G[0,1] !b) | F[4,4] b", "exact", 4, None),  # some of the rest is true, some false
    ],
)
def test_steps_are_counted_as_far_as_verdicts_depend_on_them(text, encoding, counted, bound):
    rows, labels = [[[0.5, 0.3, 0.2]] * 3, [[0.1, 0.1, 0.8]] * 3], {"a": [1, 0, 0], "b": [0, 1, 0]}
    product = stl.build_product(stl.MDP.from_arrays(rows, {}, labels=labels), stl.parse(text), encoding)
    exported, _ = agree(product, None, clock=False)
    assert (exported.clock.last, exported.clock.bound) == (counted, bound)
    exported, _ = agree(product, None, clock=True)
    assert (exported.clock.last, exported.clock.bound) == (product.horizon, None)


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
