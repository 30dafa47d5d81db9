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
    if path.suffix != ".prism":  # a UMB file says itself whether it is exact
        umb, drn = stormpy.build_model_from_umb, stormpy.build_model_from_drn[kind]
        return (umb if path.suffix == ".umb" else drn)(str(path)), lambda text: stormpy.parse_properties(text)[0]
    program = stormpy.parse_prism_program(str(path))
    return stormpy.build_model[kind](program), lambda text: stormpy.parse_properties(text, program)[0]


def answered(model, question, **how):
    """What Storm answers to a question of ours; `how`: settings of Storm."""
    found = stormpy.model_checking(model, question, only_initial_states=True, **how)
    return Fraction(str(found.get_value(model.initial_states[0])))


def agrees(product, policy, folder, endings, clock=False):
    """Storm's models of our exports have our sizes, and its answers are ours: to 1e-9, and as fractions."""
    exported, wanted = stl.product_mdp(product, policy, clock=clock), answers(product, policy)
    ours = exported.model
    assert set(exported.questions) == set(wanted)
    for ending in endings:
        path = folder / f"product{ending}"
        stl.export(product, path, policy=policy, clock=clock)
        for exact in (False, True):
            model, read = built(path, exact)
            sizes = model.nr_states, model.nr_choices, model.nr_transitions
            assert sizes == (ours.n_states, ours.n_choices, ours.n_transitions)
            for name, question in exported.questions.items():
                found = answered(model, read(question.property))
                value = 1 - found if question.complement else found
                assert value == (wanted[name] if model.is_exact else pytest.approx(wanted[name], abs=1e-9))
            if ending == ".umb":
                break


@pytest.mark.parametrize(("name", "params"), TASKS, ids=[name for name, _ in TASKS])
def test_the_factory_tasks(tmp_path, name, params):
    product = factory(name, params)
    others = {"patrolling.stl": [".drn", ".umb"], "docks.stl": [".drn.gz", ".umb"]}.get(name, [])
    for policy in (None, stl.check(product).policy):
        agrees(product, policy, tmp_path, [".prism", *others])


@pytest.mark.soak
@settings(max_examples=many(15))
@given(products(), st.booleans(), st.sampled_from([".prism", ".drn", ".umb"]))
def test_random_products_and_their_chains(tmp_path_factory, product, clock, ending):
    folder = tmp_path_factory.mktemp("storm")
    for policy in policies(product):
        agrees(product, policy, folder, [ending], clock)


@pytest.mark.parametrize("ending", [".prism", ".drn"])
def test_interval_models(tmp_path, ending):
    """Nature is adversarial or cooperative in Storm too."""
    task = stl.load_task(FACTORY / "uncertain.stl", params={"T": "1", "tau": "5"})
    product = stl.build_product(stl.load_model(task.model), task)
    exported = stl.product_mdp(product, clock=True)
    path = tmp_path / f"product{ending}"
    stl.export(product, path, clock=True)
    if ending == ".prism":
        program = stormpy.parse_prism_program(str(path))
        model = stormpy.build_model[stormpy.Interval](program)
    else:
        model = stormpy.build_model_from_drn[stormpy.Interval](str(path))
    for nature, mode in (("against", "ROBUST"), ("with", "COOPERATIVE")):
        how = getattr(stormpy.UncertaintyResolutionMode, mode)
        for name, question in exported.questions.items():
            found = answered(model, stormpy.parse_properties(question.property)[0], uncertainty_resolution_mode=how)
            ours = stl.robust_check(product, maximize=name == "maximum", nature=nature).probability
            assert found == pytest.approx(ours, abs=1e-9), (nature, name)
