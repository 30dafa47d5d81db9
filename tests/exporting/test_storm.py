"""Exports in Storm, an outside judge: it has our probabilities, to 1e-9 in doubles and to the last digit in fractions.

`pip install stltool[peers]`; without it these tests are skipped.
"""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from tests.conftest import FACTORY, many
from tests.exporting.products import TASKS, answers, factory, policies, products

stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")


def built(path, exact):
    """Storm's model of a file, and a function that reads properties for it."""
    kind = stormpy.Rational if exact else float
    program = stormpy.parse_prism_program(str(path))
    return stormpy.build_model[kind](program), lambda text: stormpy.parse_properties(text, program)[0]


def asked(path, question, exact=False):
    """What Storm answers to a question of ours."""
    model, read = built(path, exact)
    found = stormpy.model_checking(model, read(question.property), only_initial_states=True)
    value = found.get_value(model.initial_states[0])
    value = Fraction(str(value)) if exact else float(value)
    return 1 - value if question.complement else value


def judged(product, policy, folder, clock=False, exact=True):
    exported = stl.product_mdp(product, policy, clock=clock)
    path = folder / "product.prism"
    stl.export(product, path, policy=policy, clock=clock)
    model, _ = built(path, False)
    ours = exported.model
    assert (model.nr_states, model.nr_choices, model.nr_transitions) == (
        ours.n_states,
        ours.n_choices,
        ours.n_transitions,
    )
    for name, value in answers(product, policy).items():
        question = exported.questions[name]
        assert asked(path, question) == pytest.approx(float(value), abs=1e-9)
        if exact:
            assert asked(path, question, exact=True) == value


@pytest.mark.parametrize(("name", "params"), TASKS, ids=[name for name, _ in TASKS])
def test_the_factory_tasks(tmp_path, name, params):
    product = factory(name, params)
    for policy in (None, stl.check(product).policy):
        judged(product, policy, tmp_path)


@pytest.mark.soak
@settings(max_examples=many(15))
@given(products(), st.booleans())
def test_random_products_and_their_chains(tmp_path_factory, product, clock):
    folder = tmp_path_factory.mktemp("storm")
    for policy in policies(product):
        judged(product, policy, folder, clock)


def test_interval_models(tmp_path):
    """Storm reads intervals in programs, and nature is adversarial or cooperative there too."""
    task = stl.load_task(FACTORY / "uncertain.stl", params={"T": "3", "tau": "4"})
    product = stl.build_product(stl.load_model(task.model), task)
    exported = stl.product_mdp(product, clock=True)
    path = tmp_path / "product.prism"
    stl.export(product, path, clock=True)
    program = stormpy.parse_prism_program(str(path))
    model = stormpy.build_model[stormpy.Interval](program)
    for nature, mode in (("against", "ROBUST"), ("with", "COOPERATIVE")):
        for name, question in exported.questions.items():
            formula = stormpy.parse_properties(f"{question.property}", program)[0]
            found = stormpy.model_checking(
                model, formula, uncertainty_resolution_mode=getattr(stormpy.UncertaintyResolutionMode, mode)
            )
            ours = stl.robust_check(product, maximize=name == "maximum", nature=nature).probability
            assert found.get_value(model.initial_states[0]) == pytest.approx(ours, abs=1e-9), (nature, name)
