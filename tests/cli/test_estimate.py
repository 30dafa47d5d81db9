"""`stltool estimate`: intervals and sequential tests as their users meet them."""

import json
import re

import numpy as np
import pytest

import stltool as stl
from stltool.checking.statistical import runs_needed
from stltool.reporting import render, report_data
from tests.conftest import PATROLLING, SMALL

EXACT = 0.73794757279959


@pytest.fixture
def estimate(stltool):
    """`stltool estimate` of the small task in this process: (exit code, stdout, stderr)."""
    return lambda *args: stltool("estimate", PATROLLING, *SMALL, *args)


def test_the_best_policys_interval_stands_beside_the_exact_value(estimate, patrolling):
    code, out, err = estimate("--seed", 3)
    result = stl.estimate(patrolling, stl.check(patrolling).policy, seed=3)
    assert code == 0
    for text in (
        "the best policy (time-dependent, deterministic)",
        f"10000, {result.satisfied} satisfied, {result.steps} steps, seed 3",
        result.statement,
        "exact P  0.7379475728, in the interval",
    ):
        assert text in out
    assert "simulating: 10000 of 10000" in err


def test_one_object_with_all_of_it(estimate, patrolling, tmp_path):
    policy = tmp_path / "p.npz"
    stl.Policy(patrolling, np.zeros(patrolling.shape, dtype=int)).save(policy)
    code, out, err = estimate("--policy", policy, "--epsilon", 0.02, "--confidence", 0.9, "--side", "upper", "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert (data["runs"], data["side"], data["lower"]) == (runs_needed(0.02, 0.9, "upper"), "upper", 0)
    assert (data["satisfied"], data["probability"], data["exact"], data["exact_inside"]) == (0, 0, 0, True)
    assert (data["task"], data["policy"], data["seed"]) == ("patrolling", "stationary, deterministic", 0)
    _, out, _ = estimate("--policy", policy, "--no-exact", "--json")
    data = json.loads(out)
    assert (data["runs"], data["confidence"], data["exact"], data["exact_inside"]) == (10_000, 0.99, None, None)
    _, out, _ = estimate("--policy", policy, "--no-exact", "--runs", 50)
    assert "exact" not in out
    assert str(policy) in out


def test_an_exact_value_outside_is_said_to_be(estimate):
    _, out, _ = estimate("--runs", 40, "--confidence", 0.01, "--seed", 1)
    assert "outside the interval" in out


@pytest.mark.parametrize(("bound", "code", "verdict"), [(0.7, 0, "holds"), (0.78, 1, "does not hold")])
def test_a_sequential_test_sets_the_exit_code(estimate, bound, code, verdict):
    ended, out, _ = estimate("--at-least", bound, "--indifference", 0.02, "--alpha", 0.001, "--beta", 0.001)
    assert ended == code
    assert f"P >= {bound} {verdict}; if P were at " in out
    assert "probability at most 0.001" in out
    ended, out, err = estimate("--at-least", bound, "--json")
    data = json.loads(out)
    assert (ended, err, data["verdict"], data["holds"]) == (code, "", verdict, code == 0)
    assert data["exact"] == pytest.approx(EXACT, rel=0, abs=1e-14)
    assert data["runs"] < 10_000


def test_undecided_is_neither(estimate):
    code, out, _ = estimate("--at-least", EXACT, "--most-runs", 100)
    assert code == 1
    assert "is undecided after 100 runs; no claim is made" in out


def test_an_infinite_ratio_is_null_in_the_json(estimate):
    code, out, _ = estimate("--at-least", 0.95, "--indifference", 0.05, "--json")
    data = json.loads(out)
    assert (code, data["verdict"]) == (1, "does not hold")
    assert data["log_likelihood_ratio"] is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--runs", 5, "--epsilon", 0.1], "give one of the two"),
        (["--runs", -5], "runs is -5"),
        (["--epsilon", 1e-9], "takes up to 2.65e+18 runs; these would take about"),
        (["--at-least", 0.7, "--runs", 5], "--runs belongs to an interval"),
        (["--at-least", 0.7, "--confidence", 0.9], "--confidence belongs to an interval"),
        (["--most-runs", 5], "--most-runs belongs to a sequential test; give --at-least P"),
        (["--at-least", 0.7, "--alpha", 2], "alpha is 2.0"),
        (["--at-least", 0.995], "at most 0.005"),
        (["--no-exact"], "--no-exact needs --policy FILE"),
        (["--policy", "absent.npz"], "absent.npz"),
        (["--seed", -1], "seed is -1"),
    ],
)
def test_bad_options_end_with_a_message(estimate, options, message):
    code, out, err = estimate(*options)
    assert (code, out) == (2, "")
    assert message in err


def test_a_report_shows_estimates_beside_the_exact_value(patrolling):
    best = stl.check(patrolling)
    estimate = stl.estimate(patrolling, best.policy, runs=500, seed=1)
    data = report_data([best], estimates=[estimate])
    assert json.loads(json.dumps(data)) == data
    page = render(data)
    assert estimate.statement in page
    [printed] = re.findall(r"exact probability is ([\d.]+)\.</p>", page)
    assert best.lower <= float(printed) <= best.upper
    assert float(printed) == pytest.approx(EXACT, rel=0, abs=1e-14)
    assert "Statistical check" not in render(report_data([best]))
