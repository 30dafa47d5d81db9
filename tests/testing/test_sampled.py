"""Tests of randomised programs: errors as promised, runs as planned."""

import math

import numpy as np
import pytest

import stltool as stl
from stltool.testing import SampledViolation, assert_probability_sampled, sampling_plan
from tests.conftest import many


def lucky(p):
    return lambda rng: bool(rng.random() < p)


def test_a_program_that_is_good_enough_passes():
    told = []
    result = assert_probability_sampled(lucky(0.99), 0.95, tell=told.append)
    assert result.verdict == "holds"
    assert told == [sampling_plan(0.95).statement]
    assert result == assert_probability_sampled(lucky(0.99), 0.95, tell=None).__class__(
        **{**vars(result), "seconds": result.seconds}
    )


def test_one_that_is_not_fails_with_the_numbers():
    with pytest.raises(SampledViolation, match=r"does not hold.*\n  \d+ of \d+ runs succeeded \(seed 3\)") as raised:
        assert_probability_sampled(lucky(0.9), 0.95, seed=3, tell=None)
    assert raised.value.result.verdict == "does not hold"
    with pytest.raises(SampledViolation, match="is undecided after 10 runs"):
        assert_probability_sampled(lucky(0.95), 0.95, most_runs=10, tell=None)


def test_a_seed_is_a_test_and_runs_differ():
    seen = []

    def run(rng):
        seen.append(rng.random())
        return True

    first = assert_probability_sampled(run, 0.9, tell=None)
    again = assert_probability_sampled(run, 0.9, tell=None)
    assert first.runs == again.runs == len(seen) // 2
    assert seen[: first.runs] == seen[first.runs :]
    assert len(set(seen)) == first.runs


def test_a_program_may_have_its_own_chance():
    calls = []
    assert_probability_sampled(lambda: calls.append(1) is None, 0.5, indifference=0.4, tell=None)
    assert calls


@pytest.mark.soak
@pytest.mark.parametrize("theta", [0.6, 0.95])
def test_the_errors_are_as_promised(theta):
    margin, runs, wrong = 0.04, many(150), {"holds": 0, "does not hold": 0}
    for seed in range(runs):
        for p, worst in ((theta + margin, "does not hold"), (theta - margin, "holds")):
            try:
                verdict = assert_probability_sampled(
                    lucky(p), theta, confidence=0.9, indifference=margin, seed=seed, tell=None
                ).verdict
            except SampledViolation as error:
                verdict = error.result.verdict
            wrong[worst] += verdict == worst
    allowed = runs * 0.1 + 4 * math.sqrt(runs * 0.09)
    assert max(wrong.values()) <= allowed


@pytest.mark.parametrize("p", [0.0, 0.5, 0.9, 0.94, 0.95, 0.96, 0.99, 1.0])
def test_runs_are_as_many_as_planned(p):
    plan, n = sampling_plan(0.95), 2000
    down, up, edge = math.log(0.94 / 0.96), math.log(0.06 / 0.04), math.log(100)
    rng, ratio, runs, live = np.random.default_rng(0), np.zeros(n), np.zeros(n), np.ones(n, bool)
    while live.any():
        ratio[live] += np.where(rng.random(live.sum()) < p, down, up)
        runs[live] += 1
        live &= np.abs(ratio) < edge
    assert runs.mean() == pytest.approx(plan.runs(p), rel=0.12, abs=1)  # Wald's formula leaves out the overshoot
    assert plan.runs(p) <= plan.at_worst * 1.001


def test_a_plan_at_the_edge_of_certainty():
    plan = sampling_plan(0.99, indifference=0.01)  # p0 = 1: one failure decides
    assert plan.if_higher == math.ceil(math.log(0.01) / math.log(0.98))
    assert plan.runs(0) == 1
    with pytest.raises(SampledViolation):
        assert_probability_sampled(lambda: False, 0.99, indifference=0.01, tell=None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"run": 3}, "run is 3, not a function"),
        ({"at_least": 1}, "at_least is 1; give a probability above 0 and below 1"),
        ({"confidence": 0.5}, "confidence is 0.5; give a number above 0.5"),
        ({"indifference": 0.2}, "indifference is 0.2; give a number above 0 and at most 0.1"),
        ({"most_runs": 0}, "most_runs"),
        ({"seed": -1}, "seed is -1"),
        ({"tell": 3}, "tell is 3, not a function or None"),
        ({"run": lambda: 1}, "run 0 returned 1; return True or False"),
    ],
)
def test_bad_arguments_are_told(change, message):
    given = {"run": lambda: True, "at_least": 0.9, "tell": None, **change}
    with pytest.raises(stl.StlToolError, match=message):
        assert_probability_sampled(given.pop("run"), given.pop("at_least"), **given)
    with pytest.raises(stl.StlToolError, match="p is 2"):
        sampling_plan(0.9).runs(2)
