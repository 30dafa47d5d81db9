"""Random models and formulas through every encoding, arithmetic, engine and format: against all histories, and Storm.

`make soak` takes ten thousand pairs of a model and a formula, CI's share of it and `make test` a few dozen.
"""

import contextlib
import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.fixed import fixed_point
from stltool.errors import SizeError
from stltool.models import save_model
from stltool.testing import flag_formulas, formulas, mdps, policies
from tests import oracles
from tests.conftest import soaked

with contextlib.suppress(ImportError):
    import stormpy

ENGINES = ("nodes", "words")
AIMS = (False, True)  # the minimum and the maximum, as in oracles.optima
A_MODEL = 4  # formulas

any_formula = formulas(longest=2, max_leaves=4, horizon=4)
with_past = formulas(longest=2, max_leaves=4, horizon=4, past=True)
flags = flag_formulas(longest=2, horizon=3)  # of which the paper's encoding is exact


@pytest.fixture(autouse=True)
def results_are_not_kept(monkeypatch):
    """Half of the time would be spent on waiting for the disk."""
    monkeypatch.setattr("os.fsync", lambda descriptor: None)


@pytest.mark.soak
@settings(
    max_examples=soaked(10_000) // A_MODEL + 1, database=None,
    suppress_health_check=[*HealthCheck],
)  # fmt: skip
@given(st.data(), mdps(single_start=True, exact=True) | mdps(single_start=True))
def test_every_encoding_arithmetic_and_format(tmp_path, data, model):
    loaded = [reloaded(model, tmp_path / f"model{ending}") for ending in (".drn", ".umb", ".tra")]
    wide, family = intervals_around(model), family_through(model)
    for one in range(A_MODEL):
        phi = data.draw(flags if one == 0 else with_past if one == 1 else any_formula)
        truths = oracles.optima(model, phi)
        product = stl.build_product(model, phi)
        optima(product, truths)
        following(product, data.draw(policies(product)))
        for other in loaded:
            exactly(stl.build_product(other, phi), truths)
        for encoding in ["history"] * (one > 1) + ["paper"] * (one == 0):
            with contextlib.suppress(SizeError):
                exactly(stl.build_product(model, phi, encoding), truths)
        uncertain(stl.build_product(wide, phi), truths)
        if family is not None:
            bernstein(stl.build_product(family, phi), truths)
        if one == 0:
            certified(product, truths, tmp_path / "proof.jsonl.gz")
        if "stormpy" in globals():
            storm(product, truths, tmp_path, (".drn", ".umb", ".prism")[one % 3])


def reloaded(model, path):
    save_model(model, path)
    return stl.load_model(path)


def intervals_around(model):
    """Every probability of which no double is certain to be the exact one, between its neighbours."""
    rows = model.matrix().toarray()
    shape = model.n_actions, model.n_states, model.n_states
    lower, upper = np.zeros(shape), np.zeros(shape)
    for s, c in choices(model):
        lower[model.choice_action[c], s] = np.where(rows[c] > 0, np.nextafter(rows[c], 0), 0)
        upper[model.choice_action[c], s] = np.where(rows[c] > 0, np.minimum(np.nextafter(rows[c], 2), 1), 0)
    return stl.MDP.from_intervals(lower, upper, model.signals, model.initial, model.labels)


def family_through(model):
    """A family with this model at p = 0, in whose rows probabilities change places as p grows; None if none can."""
    rows = np.full((model.n_actions, model.n_states, model.n_states), "0", dtype=object)
    for s, c in choices(model):
        here = [(s2, p) for s2, p in oracles.choices(model, s)[c - model.choice_start[s]] if p]
        for (s2, p), (_, other) in zip(here, reversed(here), strict=True):
            rows[model.choice_action[c], s, s2] = f"{p}+({other}-{p})*p" if p != other else f"{p}"
    if not any("*p" in entry for entry in rows.ravel()):
        return None
    return stl.MDP.from_arrays(
        rows.astype(str), model.signals, model.initial, model.labels, parameters={"p": (Fraction(0), Fraction(1))}
    )


def choices(model):
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            yield s, c


def optima(product, truths):
    """Both optima in every arithmetic and engine."""
    exactly(product, truths)
    for maximize, arithmetic, engine in itertools.product(AIMS, ("double", "fixed"), ENGINES):
        if arithmetic == "fixed" and fixed_point(product.model) is None:
            continue
        found = stl.check(product, maximize=maximize, arithmetic=arithmetic, engine=engine)
        assert found.lower <= truths[maximize] <= found.upper <= found.lower + 1e-8


def exactly(product, truths):
    for maximize in AIMS:
        assert stl.check(product, maximize=maximize, exact=True).fraction == truths[maximize]


def following(product, policy):
    truth = oracles.policy_value(product, policy)
    found = stl.check(product, policy, exact=True)
    assert found.fraction == truth
    for engine in ENGINES:
        found = stl.check(product, policy, arithmetic="double", engine=engine)
        assert found.lower <= truth <= found.upper <= found.lower + 1e-12


def uncertain(product, truths):
    """What nature can do within intervals of a few roundings."""
    for maximize in AIMS:
        opposed = "against" if maximize else "with"  # nature minimises
        other = "with" if maximize else "against"
        least = stl.robust_check(product, maximize=maximize, nature=opposed)
        greatest = stl.robust_check(product, maximize=maximize, nature=other)
        assert least.lower <= truths[maximize] <= greatest.upper <= least.lower + 1e-12


def bernstein(product, truths):
    """At an end of the domain one of the bounds is the optimum; the other one is a policy's of the middle."""
    for maximize in AIMS:
        lower, upper = stl.parametric(product, maximize=maximize, tol=2.0).at(p=0)
        assert lower <= truths[maximize] <= upper
        assert abs((upper if maximize else lower) - truths[maximize]) < 1e-12


def certified(product, truths, path):
    for maximize in AIMS:
        stl.write_certificate(stl.check(product, maximize=maximize), path)
        found = stl.certify(path)
        assert Fraction(found["lower"]) <= truths[maximize] <= Fraction(found["upper"])


def storm(product, truths, folder, ending):
    """Storm's answers on the exported product, in doubles where the format has them, and as fractions."""
    path, asked = folder / f"product{ending}", stl.product_mdp(product).questions
    stl.export(product, path)
    for kind in (float, stormpy.Rational):
        if ending == ".umb":
            model = stormpy.build_model_from_umb(str(path))
        elif ending == ".drn":
            model = stormpy.build_model_from_drn[kind](str(path))
        else:
            model = stormpy.build_model[kind](stormpy.parse_prism_program(str(path)))
        for name, question in asked.items():
            read = stormpy.parse_properties(question.property)[0]
            answer = stormpy.model_checking(model, read, only_initial_states=True)
            found = Fraction(str(answer.get_value(model.initial_states[0])))
            found = 1 - found if question.complement else found
            truth = truths[name == "maximum"]
            assert found == truth if model.is_exact else abs(found - truth) < 1e-9
        if ending == ".umb":
            break
