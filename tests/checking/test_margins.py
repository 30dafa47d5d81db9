"""The distribution of robustness, against all histories and the slow semantics."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FragmentError, NameLookupError, PolicyError, SettingsError, SizeError
from tests import oracles
from tests.conftest import FACTORY, many

PREDICATES = ["x > 0", "y > 0", "x < 0.3", "y >= 0.25", "x - y > 0", "x != 0", "x == 0.5", "abs(y) <= 0.5"]
LEVELS = [-1, -0.5, 0, 0.25, 0.5, 1]


def random_formula(rng, steps, depth=2, atoms=PREDICATES):
    """A formula of at most so many steps, with every operator of the language."""
    if depth == 0:
        return atoms[rng.integers(len(atoms))]
    a = int(rng.integers(0, min(1, steps), endpoint=True))
    b = int(rng.integers(a, min(steps, a + 2), endpoint=True))

    def inner(left=steps):
        return f"({random_formula(rng, left, depth - 1, atoms)})"

    ahead, now = steps - b, inner
    forms = [
        lambda: f"F[{a},{b}] {inner(ahead)}", lambda: f"G[{a},{b}] {inner(ahead)}",
        lambda: f"{inner(ahead)} U[{a},{b}] {inner(ahead)}", lambda: f"{inner(ahead)} release[{a},{b}] {inner(ahead)}",
        lambda: f"!{now()}", lambda: f"{now()} & {now()}", lambda: f"{now()} | {now()}", lambda: f"{now()} -> {now()}",
        lambda: f"{now()} <-> {now()}", lambda: f"rise {now()}", lambda: f"once[{a},{b}] {now()}",
        lambda: f"historically[{a},{b}] {now()}", lambda: f"{now()} since[{a},{b}] {now()}",
        lambda: f"{now()} trigger[{a},{b}] {now()}",
    ]  # fmt: skip
    return forms[rng.integers(len(forms))]()


def random_case(seed, atoms=PREDICATES):
    """A model of three states, whose margins coincide often, and a task that looks ahead by one to three steps."""
    rng = np.random.default_rng(seed)
    signals = {name: rng.choice(LEVELS, 3) for name in "xy"}
    model = replace(oracles.random_model(rng, 4), signals=signals)
    return rng, model, stl.parse(f"{'FG'[seed % 2]}[0,1] ({random_formula(rng, 2, atoms=atoms)})")


def encloses(lower, exact, upper):
    return lower <= exact <= upper <= lower + 1e-12


@pytest.mark.parametrize("seed", range(many(60)))
def test_the_optimum_for_every_margin_is_that_of_all_histories(seed):
    _, model, phi = random_case(seed)
    for best in (True, False):
        found = stl.robustness_distribution(model, phi, maximize=best)
        for r, lower, upper in zip(found.values.tolist(), *found.survival, strict=True):
            exact = oracles.robustness_optimum(model, phi, lambda rho, r=r: rho >= r, best)
            assert encloses(lower, exact, upper), (r, str(phi))
        last = float(found.values[-1])
        assert oracles.robustness_optimum(model, phi, lambda rho, last=last: rho > last, best) == 0
        if found.mean is not None:
            exact = oracles.robustness_optimum(model, phi, Fraction, best)
            assert found.mean[0] <= exact <= found.mean[1] <= found.mean[0] + 1e-11
            wide = stl.robustness_distribution(model, phi, maximize=best, mean_states=0)
            assert wide.mean[0] <= found.mean[0] <= found.mean[1] <= wide.mean[1]


@pytest.mark.parametrize("seed", range(many(60)))
def test_a_policys_distribution_is_that_of_its_histories(seed):
    rng, model, phi = random_case(1000 + seed)
    product = stl.build_product(model, phi)
    policy = stl.Policy(product, rng.integers(2, size=(product.horizon, *product.shape)))
    shares = oracles.robustness_shares(product, policy, phi)
    found = stl.robustness_distribution(model, phi, policy)
    assert sum(shares.values()) == 1
    assert set(shares) <= {*found.values.tolist(), -math.inf}
    for r, lower, upper in zip(found.values.tolist(), *found.survival, strict=True):
        assert encloses(lower, sum(p for rho, p in shares.items() if rho >= r), upper), (r, str(phi))
    finite = all(map(math.isfinite, shares))
    assert (found.mean is not None) == finite
    if finite:
        mean = sum(p * Fraction(rho) for rho, p in shares.items())
        assert found.mean[0] <= mean <= found.mean[1] <= found.mean[0] + 1e-11
    decided = stl.check(product, policy)  # ρ > 0 implies Φ, which implies ρ ≥ 0
    assert found.at(0.0)[1] >= decided.lower
    assert found.at(math.nextafter(0.0, 1.0))[0] <= decided.upper


@pytest.mark.parametrize("seed", range(many(10)))
def test_labels_have_infinite_margins(seed):
    _, model, phi = random_case(2000 + seed, ["A", "B", "x > 0", "y < 0.25", "true"])
    found = stl.robustness_distribution(model, phi)
    for r, lower, upper in zip(found.values.tolist(), *found.survival, strict=True):
        assert encloses(lower, oracles.robustness_optimum(model, phi, lambda rho, r=r: rho >= r), upper), (r, str(phi))
    assert (math.inf in found.values) == (oracles.robustness_optimum(model, phi, lambda rho: rho == math.inf) > 0)


@pytest.mark.parametrize("seed", range(many(5)))
def test_scaled_signals_scale_the_margins(seed):
    rng = np.random.default_rng(3000 + seed)
    model = replace(oracles.random_model(rng, 4), signals={name: rng.choice(LEVELS, 3) for name in "xy"})
    wide = replace(model, signals={name: 4 * values for name, values in model.signals.items()})
    phi, four = (stl.parse(f"F[0,1] ((x > {c}) <-> rise (y <= {c})) & G[0,2] (x != y)") for c in (0.25, 1))
    found, scaled = stl.robustness_distribution(model, phi), stl.robustness_distribution(wide, four)
    assert (4 * found.values).tolist() == scaled.values.tolist()
    assert found.lower.tolist() == scaled.lower.tolist()
    assert found.upper.tolist() == scaled.upper.tolist()


def test_equality_never_has_a_positive_margin():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0.0, 0.5]})
    found = stl.robustness_distribution(model, stl.parse("F[0,1] x == 0.5"))
    assert found.values.tolist() == [-0.5, 0]
    assert encloses(found.lower[1], Fraction(1, 2), found.upper[1])
    assert found.at(1e-300) == (0.0, 0.0)
    assert found.largest(0.4) == 0
    assert found.largest(0.6) == -0.5
    assert found.mean == pytest.approx((-0.25, -0.25), abs=1e-12)


def test_the_policy_that_is_best_for_p_may_have_a_small_margin():
    """The headline of docs/robustness.md, on the smaller floor."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    model = stl.load_model(task.model)
    best = stl.check(stl.build_product(model, task)).policy
    phi = stl.parse(str(task.formula).replace("A", "(x > 0.6 & y < 0.4)"))
    optimum = stl.robustness_distribution(model, phi)
    kept = stl.robustness_distribution(model, phi, maximize=False)  # by every policy
    own = stl.robustness_distribution(model, phi, best)  # a policy of another task on the same model
    assert (own.upper <= optimum.upper + 1e-12).all()
    assert own.at(1e-9)[0] == pytest.approx(optimum.at(1e-9)[0], abs=1e-12)  # of ρ > 0 it is the best
    for bound in (0.1, 0.7, 0.9, 1):
        margin, found = stl.largest_margin(model, phi, bound)
        assert stl.largest_margin(model, phi, bound, maximize=False)[0] == kept.largest(bound)
        assert margin == optimum.largest(bound)
        assert found.lower == optimum.at(margin)[0] >= bound
        own_margin, _ = stl.largest_margin(model, phi, bound, best)
        assert own_margin == own.largest(bound) <= margin
        # the policy of that margin, over its own automaton, has the probability that was promised
        again = stl.robustness_distribution(model, phi, found.policy, margins=[margin])
        assert again.lower[0] == pytest.approx(found.lower, abs=1e-12)


def test_labels_alone_leave_no_finite_value():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0.0, 0.5]}, labels={"A": [0, 1]})
    found = stl.robustness_distribution(model, stl.parse("F[0,1] A"))
    assert (found.values.tolist(), found.mean) == ([math.inf], None)
    assert encloses(found.lower[0], Fraction(1, 2), found.upper[0])
    assert stl.largest_margin(model, stl.parse("F[0,1] A"), 0.5)[0] == math.inf
    assert stl.largest_margin(model, stl.parse("F[0,1] A"), 0.9) == (-math.inf, None)


def test_no_mean_if_some_policy_makes_the_robustness_infinite():
    model = stl.MDP.from_arrays([np.eye(3)[[1, 1, 2]], np.eye(3)[[2, 1, 2]]], {"x": [0, 1, 1]}, 0, {"A": [1, 1, 0]})
    phi = stl.parse("F[1,1] (A & x > 0)")
    for task, best in ((phi, True), (~phi, False)):
        found = stl.robustness_distribution(model, task, maximize=best)
        assert found.lower[0] == 1  # the best policy's robustness is finite
        assert np.isfinite(found.values).all()
        assert found.mean is None
    best = stl.check(stl.build_product(model, phi)).policy
    assert stl.robustness_distribution(model, phi, best).mean == pytest.approx((1, 1), abs=1e-12)


def test_what_does_not_fit_is_refused():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0.0, 0.5]})
    phi = stl.parse("F[0,3] x > 0.2")
    with pytest.raises(FragmentError, match="compares several steps"):
        stl.robustness_distribution(model, stl.parse("F[0,1] x[t+1] - x[t] > 0"))
    with pytest.raises(NameLookupError, match="no signal z"):
        stl.robustness_distribution(model, stl.parse("F[0,1] z > 0"))
    with pytest.raises(SizeError, match="may have 3 values, more than 2"):
        stl.robustness_distribution(model, phi, most_values=2)
    with pytest.raises(SettingsError, match="margins are empty"):
        stl.robustness_distribution(model, phi, margins=[])
    with pytest.raises(SettingsError, match="0.1 was not asked for"):
        stl.robustness_distribution(model, phi, margins=[0.2]).at(0.1)
    with pytest.raises(SettingsError, match="a probability above 0"):
        stl.largest_margin(model, phi, 0)
    short = stl.check(stl.build_product(model, stl.parse("F[0,1] x > 0.2"))).policy
    with pytest.raises(PolicyError, match="ends after 1 steps, the task after 3"):
        stl.robustness_distribution(model, phi, short)
    other = replace(model, signals={"x": np.array([0.0, 0.7])})
    with pytest.raises(PolicyError, match="is for the model"):
        stl.robustness_distribution(other, phi, short)
