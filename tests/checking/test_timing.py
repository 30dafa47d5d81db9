"""Time robustness: as a formula, against the slow semantics; its distribution, against all histories."""

from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FragmentError, PolicyError, SettingsError
from tests import oracles
from tests.checking.test_margins import PREDICATES, encloses, random_case, random_formula
from tests.conftest import FACTORY, many

MOST = 2
ATOMS = [*PREDICATES, "A", "B", "x[t+1] > x"]
FUTURE = ("once", "historically", "since", "trigger", "rise", "[t+1]")


def random_trace(rng, length):
    signals = {name: rng.choice([-1, 0, 0.25, 0.5], length) for name in "xy"}
    return {**signals, **{name: rng.random(length) < 0.6 for name in "AB"}}


def holds_in(phi, trace, reading, k):
    """Time robustness of at least k by its definition."""
    if reading == "task":
        return all(stl.satisfies(phi, trace, t) for t in range(k + 1))
    return stl.time_robustness(phi, trace, most=k) >= k


@pytest.mark.parametrize("seed", range(many(50)))
def test_the_formula_holds_where_the_time_robustness_is_as_large(seed):
    rng = np.random.default_rng(seed)
    text = random_formula(rng, 3, atoms=ATOMS)
    phi = stl.parse(text)
    for _ in range(6):
        trace = random_trace(rng, stl.horizon(phi) + MOST + 2)
        most = stl.time_robustness(phi, trace, most=MOST)
        for k in range(1, MOST + 1):
            assert (
                stl.satisfies(stl.time_shifted(phi, k), trace) == (most >= k) == holds_in(phi, trace, "predicates", k)
            )
            assert stl.satisfies(stl.time_shifted(phi, k, "task"), trace) == holds_in(phi, trace, "task", k)
            assert stl.satisfies(stl.time_shifted(~phi, k), trace) == (most <= -k)
            if most >= k:
                assert stl.satisfies(phi, trace)
                if not any(word in text for word in FUTURE):
                    assert holds_in(phi, trace, "task", k)  # the first reading implies the second


@pytest.mark.parametrize("seed", range(many(20)))
def test_a_time_robust_task_holds_whichever_samples_are_late(seed):
    rng = np.random.default_rng(seed)
    phi = stl.parse(random_formula(rng, 3, atoms=["A", "B", "!A"]))
    n = stl.horizon(phi) + 1
    for _ in range(20):
        trace = {name: np.repeat(rng.random(n + MOST) < 0.5, 2)[: n + MOST] for name in "AB"}
        lasts = stl.time_robustness(phi, trace, most=MOST)
        for name in "AB":  # each sample of each label may be late by its own number of steps
            late = rng.integers(0, min(abs(lasts), MOST) + 1, n)
            trace[name] = trace[name][np.arange(n) + late.astype(int)]
        if lasts:
            assert stl.satisfies(phi, trace) == (lasts > 0)


def test_a_predicates_time_robustness_is_for_how_long_it_keeps_its_truth():
    trace = {"A": [1, 1, 1, 0, 0, 1], "x": [1, 1, 1, 1, 1, 1]}
    found = [stl.time_robustness(stl.parse("A"), trace, t, most=2) for t in range(4)]
    assert found == [2, 1, 0, -1]
    assert stl.time_robustness(stl.parse("true"), trace, most=2) == np.inf
    assert stl.time_robustness(stl.parse("F[0,3] !A"), trace, most=2) == 1
    with pytest.raises(stl.StlToolError, match="needs 7"):
        stl.time_robustness(stl.parse("F[0,3] A"), trace, most=3)
    with pytest.raises(SettingsError, match="time_robustness' most"):
        stl.time_robustness(stl.parse("A"), trace, most=0)
    phi = stl.parse("F[0,3] A -> !(x > 0)")
    assert str(stl.time_shifted(phi, 2)) == "(!F[0,3] F[0,2] A) | (!F[0,2] (x > 0))"
    assert str(stl.time_shifted(phi, 2, "task")) == f"G[0,2] ({phi})"
    assert stl.time_shifted(phi, 0) == phi
    with pytest.raises(SettingsError, match="reading is 'both'; choose predicates or task"):
        stl.time_shifted(phi, 1, "both")


@pytest.mark.parametrize("seed", range(many(8)))
def test_the_distribution_is_that_of_all_histories(seed):
    rng, model, phi = random_case(4000 + seed, [*PREDICATES[:4], "A", "B"])
    best = bool(seed % 3)
    found = stl.time_distribution(model, phi, 1, maximize=best)
    length = stl.horizon(phi) + 2
    for reading in ("predicates", "task"):
        exact = oracles.history_optimum(model, length - 1, lambda trace: stl.satisfies(phi, trace), best)
        assert encloses(found.at(0, reading)[0], exact, found.at(0, reading)[1])
        exact = oracles.history_optimum(model, length, lambda trace, r=reading: holds_in(phi, trace, r, 1), best)
        assert encloses(found.at(1, reading)[0], exact, found.at(1, reading)[1])
    longer = stl.build_product(model, stl.parse(f"F[0,{length - 1}] x > 0"))
    policy = stl.Policy(longer, rng.integers(2, size=(longer.horizon, *longer.shape)))
    own = stl.time_distribution(model, phi, 1, policy)
    for reading in ("predicates", "task"):
        shifted = stl.time_shifted(phi, 1, reading)
        shares = oracles.history_shares(longer, policy, length, lambda trace, psi=shifted: stl.satisfies(psi, trace))
        assert encloses(own.at(1, reading)[0], shares.get(True, 0), own.at(1, reading)[1])


def test_margins_are_kept_for_as_long():
    _, model, phi = random_case(5003)
    found = stl.time_distribution(model, phi, 1, margin=-0.25)
    for reading in ("predicates", "task"):
        for k in (0, 1):
            shifted = stl.time_shifted(phi, k, reading)
            assert found.at(k, reading) == stl.robustness_distribution(model, shifted, margins=[-0.25]).at(-0.25)
    delayed = stl.parse("F[0,1] x[t+1] > x")
    assert stl.time_distribution(model, delayed, 1).at(1)[1] <= 1
    with pytest.raises(FragmentError, match="compares several steps"):
        stl.time_distribution(model, delayed, 1, margin=0)


def test_the_floors_figures_are_those_of_the_design():
    task = stl.load_task(FACTORY / "margins.stl", params={"T": 10, "tau": 10})
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    found = stl.time_distribution(model, task, 2)
    assert [round(found.at(k)[0], 6) for k in range(3)] == [0.999993, 0.999856, 0.992901]
    assert [round(found.at(k, "task")[0], 6) for k in (1, 2)] == [0.999993, 0.999993]
    assert (found.largest(0.9999), found.largest(0.9999, "task"), found.largest(1)) == (0, 2, None)


def test_what_does_not_fit_is_refused():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0.0, 0.5]})
    phi = stl.parse("F[0,1] x > 0.2")
    own = stl.check(stl.build_product(model, phi)).policy
    with pytest.raises(PolicyError, match="ends after 1 steps, the task after 2"):
        stl.time_distribution(model, phi, 1, own)
    with pytest.raises(SettingsError, match="time_distribution's most"):
        stl.time_distribution(model, phi, -1)
    with pytest.raises(SettingsError, match="time_distribution's margin"):
        stl.time_distribution(model, phi, 1, margin="much")
    found = stl.time_distribution(model, phi, 1)
    with pytest.raises(SettingsError, match="at's steps"):
        found.at(2)
    assert found.at(1, "task")[0] == pytest.approx(0.5)
    assert Fraction(found.at(0)[0]) <= Fraction(1, 2) <= Fraction(found.at(0)[1])
