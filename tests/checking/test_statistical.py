"""Rollouts counted out exactly; Clopper–Pearson and the sequential test against fractions and their own promises."""

import math
import sys
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

import stltool as stl
from stltool.checking import estimate_from, rollouts, sprt_from
from stltool.checking.rollouts import BLOCK, Rollouts, follow
from stltool.checking.statistical import _excess, clopper_pearson, okamoto_runs, planned_runs, runs_needed
from stltool.errors import ModelError, PolicyError, SettingsError, SizeError
from stltool.kernels import rollout as kernels
from stltool.models.environment import Environment, cumulated, simulator
from stltool.models.rows import Stored
from stltool.randomness import Purpose
from stltool.testing import flag_formulas, formulas, mdps
from tests import oracles
from tests.conftest import many


def coin(p, rest="0"):
    """A model whose only policy satisfies F[0,2] win with probability p, after one step or two."""
    stay = [[0, p / 2, 1 - p, p / 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]]
    model = stl.MDP.from_arrays([stay], {"x": [0, 1, 2, 3]}, labels={"win": [0, 1, 0, 0], "lost": [0, 0, 1, 0]})
    product = stl.build_product(model, stl.parse("F[0,2] win"))
    return product, stl.Policy(product, np.zeros(product.shape, dtype=int))


def counts(product, policy, groups, size, seed=0):
    """How many runs of each of `groups` groups of `size` runs satisfied."""
    verdicts = np.concatenate(list(Rollouts(product, policy, groups * size, seed)))
    return verdicts.reshape(groups, size).sum(axis=1)


# ------------------------------------------------------------------------------------------------------ rollouts


@st.composite
def followed(draw):
    """A tiny product, a policy with weights over quarters, and how often each random number is used."""
    mixed = draw(st.booleans())
    model = draw(mdps(states=3, actions=3))
    most = 2 if mixed else 3
    kinds = flag_formulas(longest=2, horizon=most), formulas(signals=(), longest=2, max_leaves=4, horizon=most)
    phi = draw(st.one_of(kinds))
    assume(stl.horizon(phi) >= 1)
    product = stl.build_product(model, phi)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (product.horizon, *product.shape) if draw(st.booleans()) else product.shape
    n_choices = np.diff(model.choice_start)
    table = (rng.random(shape) * n_choices[:, None]).astype(int)
    if mixed:
        weights = np.zeros((*shape, n_choices.max()))
        for _ in range(4):
            pick = (rng.random(shape) * n_choices[:, None]).astype(int)
            np.put_along_axis(weights, pick[..., None], np.take_along_axis(weights, pick[..., None], -1) + 0.25, -1)
        table = weights
    return product, stl.Policy(product, table)


@given(followed())
@settings(max_examples=many(50))
def test_rollouts_counted_out_are_the_exact_probability(case):
    """Rows over sixteenths, weights over quarters: over all combinations of i/16 and i/4 the share is P, as a fraction.

    These are the very borders, so a number that falls on one has to belong to the successor above it.
    """
    product, policy = case
    per_step = [16] if policy.deterministic else [4, 16]
    values = [16, *per_step * product.horizon]
    runs, used = math.prod(values), iter(range(len(values)))

    def draw(number):
        i = next(used)
        return (number // math.prod(values[:i]) % values[i]) / values[i]

    verdicts, steps = follow(product, policy, cumulated(product.model), runs, draw)
    assert Fraction(int(verdicts.sum()), runs) == oracles.policy_value(product, policy)
    assert steps <= runs * product.horizon


def test_each_run_is_the_simulators_with_the_same_numbers(patrolling):
    """Lock step changes nothing: verdicts stand in the order of the runs and every run is the slow one."""
    policy = stl.check(patrolling).policy
    model, automaton = patrolling.model, patrolling.automaton
    rng, drawn, runs = np.random.default_rng(5), {}, 300

    def draw(number):
        u = rng.random(len(number))
        for k, value in zip(number.tolist(), u.tolist(), strict=True):
            drawn.setdefault(k, []).append(value)
        return u

    class Replay:
        """A generator that hands out given numbers, one by one."""

        def __init__(self, numbers):
            self.random = iter(numbers).__next__

    verdicts, steps = follow(patrolling, policy, cumulated(model), runs, draw)
    assert 0 < verdicts.sum() < runs
    for k in range(runs):
        slow = simulator(model, Replay(drawn[k]))
        s, t = slow.reset(), 0
        q = patrolling.enter(s, automaton.initial)
        while automaton.verdicts(t)[q] < 0:
            s = slow.step(int(policy.row(t)[s, q]))
            q, t = patrolling.enter(s, q), t + 1
        assert (automaton.verdicts(t)[q], t) == (verdicts[k], len(drawn[k]) - 1)
    assert steps == sum(map(len, drawn.values())) - runs


def test_the_kernels_are_their_plain_python(patrolling, monkeypatch):
    rng = np.random.default_rng(1)
    weights = rng.random((*patrolling.shape, 9)) * (
        np.arange(9) < np.diff(patrolling.model.choice_start)[:, None, None]
    )
    mixed = stl.Policy(patrolling, weights / weights.sum(axis=-1, keepdims=True))
    for policy in (stl.check(patrolling).policy, mixed):
        fast = [batch.tolist() for batch in Rollouts(patrolling, policy, 500, 3)]
        with monkeypatch.context() as patch:
            for name in ("pick", "mix", "move"):
                patch.setattr(kernels, name, getattr(kernels, name).py_func)
            assert [batch.tolist() for batch in Rollouts(patrolling, policy, 500, 3)] == fast


@pytest.mark.parametrize("runs", [1, BLOCK - 1, BLOCK, BLOCK + 1, 5 * BLOCK + 7])
def test_verdicts_depend_on_the_seed_alone(runs, monkeypatch):
    product, policy = coin(0.5)
    made = {}
    for workers in (1, 2, 7):
        monkeypatch.setattr(rollouts.os, "cpu_count", lambda workers=workers: workers)
        some = Rollouts(product, policy, runs, 11)
        made[workers] = np.concatenate(list(some))
        assert len(made[workers]) == runs
        steps = some.steps
        assert np.array_equal(np.concatenate(list(some)), made[workers])  # iterated again: the same runs
        assert some.steps == steps
    assert np.array_equal(made[1], made[2])
    assert np.array_equal(made[1], made[7])
    if runs > BLOCK:
        other = np.concatenate(list(Rollouts(product, policy, runs, 12)))
        assert not np.array_equal(made[1], other)
        assert not np.array_equal(made[1][:1000], made[1][BLOCK : BLOCK + 1000][:1000])  # no block repeats


def test_steps_are_counted_until_the_verdict():
    product, policy = coin(0.5)
    result = stl.estimate(product, policy, runs=4000, seed=1)
    # F[0,2] win: one step where it wins at once (1/4), else two
    assert stats.binomtest(8000 - result.steps, 4000, 0.25).pvalue > 1e-4
    slow = stl.estimate(product, policy, runs=2000, environment=simulator(product.model, np.random.default_rng(4)))
    assert stats.binomtest(4000 - slow.steps, 2000, 0.25).pvalue > 1e-4


def test_a_policy_that_remembers_otherwise_is_followed(patrolling, flagged):
    policy = stl.check(flagged).policy
    result = stl.estimate(patrolling, policy, runs=100_000, confidence=0.9999, seed=2)
    assert result.lower <= 0.737948 <= result.upper


def test_a_silent_policy_is_named_only_where_it_is_reached(patrolling):
    table = stl.check(patrolling).policy.table.copy()
    s = int(patrolling.model.initial.argmax())
    table[0, s - 1, :] = -1  # never there at step 0
    assert stl.estimate(patrolling, stl.Policy(patrolling, table), runs=100).runs == 100
    table[0, s, :] = -1
    environment = simulator(patrolling.model, np.random.default_rng(0))
    for black_box in (None, environment):
        with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\); x = 0.3, y = 0.1"):
            stl.estimate(patrolling, stl.Policy(patrolling, table), runs=100, environment=black_box)


def test_rows_that_sum_to_less_than_one_are_scaled():
    """The first successor's share is 0.5 + 8e-10 of 1 − 8e-10, which is 0.5 + 1.2e-9 of the whole."""
    model = stl.MDP.from_arrays([[[0.5 + 8e-10, 0.5 - 1.6e-9], [0, 1]]], {"x": [0, 1]}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    policy = stl.Policy(product, np.zeros(product.shape, dtype=int))
    for u, satisfied in ((0.5 + 1e-9, False), (0.5 + 2e-9, True)):
        verdicts, _ = follow(product, policy, cumulated(model), 1, lambda number, u=u: np.array([u]))
        assert verdicts[0] == satisfied


def test_rows_are_summed_one_by_one():
    """In one long sum over a large model a probability of 1e-13 would drown."""
    n = 20_000
    states = np.arange(n)
    rare = np.zeros((n, 2))
    rare[:, 0], rare[:, 1] = 1e-13, 1 - 1e-13
    model = stl.MDP(
        Stored(
            np.arange(n + 1), np.zeros(n, dtype=np.int32), 2 * np.arange(n + 1),
            np.stack([states, (states + 1) % n], axis=1).astype(np.int32).ravel(), rare.ravel(),
        ),
        initial=np.eye(1, n)[0], signals={}, labels={}, action_names=("go",),
    )  # fmt: skip
    assert np.array_equal(cumulated(model).reshape(n, 2), np.cumsum(rare, axis=1))


@given(mdps(states=5, actions=3))
def test_cumulated_rows_are_numpys(model):
    rows = zip(model.row_start[:-1], model.row_start[1:], strict=True)
    slow = np.concatenate([np.cumsum(model.probability[a:b]) for a, b in rows])
    assert np.array_equal(cumulated(model), slow)


# ------------------------------------------------------------------------------------------------- a black box


def test_a_black_box_is_asked_and_the_models_probabilities_are_not():
    product, policy = coin(0.3)
    asked = []
    always = Environment(reset=lambda: 0, step=lambda i: asked.append(i) or np.int64(1))
    result = stl.estimate(product, policy, runs=50, environment=always)
    assert (result.satisfied, result.steps, asked) == (50, 50, [0] * 50)
    never = Environment(reset=lambda: 0, step=lambda i: 2)
    assert stl.sprt(product, policy, 0.3, environment=never).verdict == "does not hold"


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("mixed", [False, True])
def test_a_black_box_that_is_the_model_gives_the_models_probability(patrolling, mixed):
    policy = stl.check(patrolling).policy
    if mixed:
        n_choices = np.diff(patrolling.model.choice_start)
        best = stl.check(stl.build_product(patrolling.model, patrolling.formula)).policy.table
        weights = (
            0.9 * (best[..., None] == np.arange(9))
            + 0.1 * (np.arange(9) < n_choices[:, None, None]) / (n_choices[:, None, None])
        )
        policy = stl.Policy(patrolling, weights)
    exact = stl.check(patrolling, policy).probability
    environment = simulator(patrolling.model, np.random.default_rng(8))
    slow = stl.estimate(patrolling, policy, runs=3000, confidence=0.999, environment=environment)
    fast = stl.estimate(patrolling, policy, runs=300_000, confidence=0.999, seed=8)
    for result in (slow, fast):
        assert result.lower <= exact <= result.upper
    assert fast.upper - fast.lower < 0.007


@pytest.mark.parametrize("answer", [18, -1, 1.0, None, (3, {}), "3", np.array([1, 2])])
def test_what_is_no_state_is_refused(patrolling, answer):
    policy = stl.check(patrolling).policy
    with pytest.raises(ModelError, match=r"environment's reset\(\) returned .* not a state of floor-5x5; .* 0 … 17"):
        stl.estimate(patrolling, policy, environment=Environment(lambda: answer, lambda i: 0))
    s = int(patrolling.model.initial.argmax())
    with pytest.raises(ModelError, match=r"environment's step\(\d\) in state \(1,0\) returned"):
        stl.sprt(patrolling, policy, 0.5, environment=Environment(lambda: s, lambda i: answer))


# -------------------------------------------------------------------------------------------- Clopper–Pearson


def tail(n, k, p, above):
    """P(X ≥ k) or P(X ≤ k), X binomial(n, p), exactly."""
    p = Fraction(p)
    some = range(k, n + 1) if above else range(k + 1)
    return float(sum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in some))


@given(st.integers(1, 25), st.data())
@settings(max_examples=many(50))
def test_bounds_have_the_binomial_tails_that_define_them(n, data):
    k = data.draw(st.integers(0, n))
    confidence = data.draw(st.sampled_from([0.5, 0.9, 0.99, 0.999999]))
    lower, upper = clopper_pearson(k, n, confidence)
    below, above = clopper_pearson(k, n, confidence, "lower"), clopper_pearson(k, n, confidence, "upper")
    assert 0 <= lower <= below[0] <= k / n <= above[1] <= upper <= 1
    assert (below[1], above[0]) == (1, 0)
    for bound, share in ((lower, (1 - confidence) / 2), (below[0], 1 - confidence)):
        assert bound == 0 if k == 0 else tail(n, k, bound, above=True) == pytest.approx(share, rel=1e-8)
    for bound, share in ((upper, (1 - confidence) / 2), (above[1], 1 - confidence)):
        assert bound == 1 if k == n else tail(n, k, bound, above=False) == pytest.approx(share, rel=1e-8)


def test_rare_events_keep_their_digits():
    """All of 10⁹ runs but one: lower bounds by series, where an absolute tolerance would show."""
    n, share = 10**9, 0.005
    assert clopper_pearson(1, n)[0] == pytest.approx(-math.expm1(math.log1p(-share) / n), rel=1e-9)
    assert clopper_pearson(0, n)[1] == pytest.approx(-math.expm1(math.log(share) / n), rel=1e-9)
    assert clopper_pearson(n - 1, n)[1] == pytest.approx(math.exp(math.log1p(-share) / n), rel=1e-15)


@pytest.mark.parametrize("side", ["both", "lower", "upper"])
@pytest.mark.parametrize("n", [1, 7, 40])
def test_the_coverage_computed_is_never_below_the_confidence(side, n):
    """Without any sampling: the probability, for many p, of the outcomes whose interval contains p."""
    intervals = np.array([clopper_pearson(k, n, 0.9, side) for k in range(n + 1)])
    for p in np.linspace(0, 1, 401):
        contains = (intervals[:, 0] <= p) & (p <= intervals[:, 1])
        assert stats.binom.pmf(np.arange(n + 1), n, p)[contains].sum() >= 0.9 - 1e-12


def fails_at_most(count, n, share):
    """Whether `count` failures of n are in keeping with a probability of at most `share` (one in a thousand is not)."""
    return count <= stats.binom.ppf(0.999, n, share)


@pytest.mark.soak(only=True)
def test_calibration_on_patrolling(patrolling):
    """The issue's promise: the interval contains the exact value as often as stated, each side failing half of it."""
    best = stl.check(patrolling)
    assert best.probability == pytest.approx(0.737948, abs=5e-7)
    n = many(1000)
    found = [stl.estimate(patrolling, best.policy, runs=150, confidence=0.9, seed=seed) for seed in range(n)]
    too_high = sum(result.lower > best.probability for result in found)
    too_low = sum(result.upper < best.probability for result in found)
    assert fails_at_most(too_high, n, 0.05)
    assert fails_at_most(too_low, n, 0.05)
    assert too_high + too_low >= stats.binom.ppf(0.001, n, 0.05)  # and no wider than it need be
    mean = sum(result.satisfied for result in found) / (150 * n)
    assert mean == pytest.approx(best.probability, abs=4 * math.sqrt(0.25 / (150 * n)))


@pytest.mark.parametrize("p", [0.0, 0.004, 0.5, 0.97, 1.0])
def test_calibration_on_coins(p):
    """Rare events, where the normal approximation fails, and the impossible and the certain."""
    product, policy = coin(p)
    exact = stl.check(product, policy).probability
    assert exact == pytest.approx(p, abs=1e-12)
    found = counts(product, policy, groups=2000, size=200, seed=3)
    intervals = {k: clopper_pearson(int(k), 200, 0.95) for k in np.unique(found)}
    missed = [not intervals[k][0] <= p <= intervals[k][1] for k in found]
    assert fails_at_most(sum(missed), 2000, 0.05)
    one_sided = {k: clopper_pearson(int(k), 200, 0.95, "lower")[0] for k in np.unique(found)}
    assert fails_at_most(sum(one_sided[k] > p for k in found), 2000, 0.05)
    if p in (0, 1):
        assert set(found) == {200 * p}
        assert not any(missed)


# ------------------------------------------------------------------------------------------------------ planning


@pytest.mark.parametrize("side", ["both", "lower"])
@pytest.mark.parametrize(("epsilon", "confidence"), [(0.2, 0.5), (0.1, 0.9), (0.05, 0.99), (0.02, 0.95), (0.3, 0.999)])
def test_planned_runs_are_enough_whatever_is_seen(epsilon, confidence, side):
    n = runs_needed(epsilon, confidence, side)
    assert n <= okamoto_runs(epsilon, confidence, side)

    def worst(n):
        bounds = np.array([clopper_pearson(k, n, confidence, side) for k in range(n + 1)])
        shares = np.arange(n + 1) / n
        excess = shares - bounds[:, 0]
        return max(excess.max(), (bounds[:, 1] - shares).max()) if side == "both" else excess.max()

    assert worst(n) <= epsilon + 1e-12
    fewer = math.ceil(0.9 * n) - 1
    assert fewer < 1 or worst(fewer) > epsilon  # and not many more than needed


@given(st.integers(1, 3000), st.sampled_from([0.25, 0.05, 0.005, 1e-6]))
@settings(max_examples=many(30))
def test_the_worst_outcome_is_found_without_looking_at_all(n, share):
    k = np.arange(n)
    assert _excess(n, share) == pytest.approx((stats.beta.isf(share, k + 1, n - k) - k / n).max(), abs=1e-15)


def test_okamotos_numbers_as_published():
    """⌈ln(2/δ)/2ε²⌉: 26492 runs for ε = δ = 0.01, 18445 for δ = 0.05, 38005 for ε = 0.01, δ = 0.001."""
    assert [okamoto_runs(0.01, c) for c in (0.99, 0.95, 0.999)] == [26492, 18445, 38005]
    assert planned_runs() == 10_000
    assert planned_runs(epsilon=0.01) == runs_needed(0.01) < 26492 * 0.65


def test_an_estimate_of_planned_width_keeps_it(patrolling):
    policy = stl.check(patrolling).policy
    result = stl.estimate(patrolling, policy, epsilon=0.01, confidence=0.95, seed=4)
    assert result.runs == runs_needed(0.01, 0.95)
    assert result.probability - result.lower <= 0.01
    assert result.upper - result.probability <= 0.01
    again = stl.estimate(patrolling, policy, runs=result.runs, confidence=0.95, seed=4)
    assert (again.satisfied, again.lower, again.upper) == (result.satisfied, result.lower, result.upper)
    assert stl.estimate(patrolling, policy, runs=result.runs, seed=5).satisfied != result.satisfied


# ------------------------------------------------------------------------------------------------ sequential test


def slow_sprt(verdicts, theta, margin, alpha, beta):
    """Verdict after verdict, the likelihood ratio itself as a fraction."""
    p0, p1 = Fraction(theta) + Fraction(margin), Fraction(theta) - Fraction(margin)
    against, support = Fraction(1), Fraction(1)
    for n, verdict in enumerate(verdicts, start=1):
        against *= p1 if verdict else 1 - p1
        support *= p0 if verdict else 1 - p0
        if against * Fraction(alpha) >= support:
            return "does not hold", n
        if against <= support * Fraction(beta):
            return "holds", n
    return "undecided", len(verdicts)


@given(
    st.lists(st.booleans(), min_size=1, max_size=60),
    st.lists(st.integers(0, 60), max_size=4),
    st.sampled_from(
        [("0.5", "0.2"), ("0.9", "0.1"), ("0.3", "0.3"), ("0.5", "0.5"), ("0.8", "0.15"), ("0.05", "0.04")]
    ),
    st.sampled_from([("0.1", "0.2"), ("0.01", "0.3"), ("0.4", "0.05")]),
)
@settings(max_examples=many(300))
def test_the_sequential_test_is_its_definition(verdicts, cuts, region, errors):
    batches = [np.array(part, dtype=bool) for part in np.split(np.array(verdicts), sorted(cuts))]
    theta, margin, alpha, beta = map(float, region + errors)
    verdict, n = slow_sprt(verdicts, *region, *errors)
    for given_as in (batches, verdicts):
        result = sprt_from(given_as, theta, indifference=margin, alpha=alpha, beta=beta)
        assert (result.verdict, result.runs, result.satisfied) == (verdict, n, sum(verdicts[:n]))
        left = result.accept_below < result.log_likelihood_ratio < result.reject_above
        assert left == (result.verdict == "undecided")
        assert (result.accept_below, result.reject_above) == (math.log(beta), -math.log(alpha))
    short = sprt_from(batches, theta, indifference=margin, alpha=alpha, beta=beta, most_runs=5)
    assert (short.verdict, short.runs) == slow_sprt(verdicts[:5], *region, *errors)


def wald(p0, p1, alpha, beta, p):
    """Wald's expected number of runs where the truth is p, one of the two; bounds ln(1/α), ln β."""
    high, low = 1 / alpha, beta
    reject = (1 - low) / (high - low) if p == p0 else high * (1 - low) / (high - low)
    drift = p * math.log(p1 / p0) + (1 - p) * math.log((1 - p1) / (1 - p0))
    return (reject * math.log(high) + (1 - reject) * math.log(low)) / drift


@pytest.mark.soak(only=True)
@pytest.mark.parametrize(("theta", "margin", "alpha", "beta"), [(0.8, 0.05, 0.02, 0.2), (0.5, 0.1, 0.2, 0.02)])
def test_error_rates_and_lengths_at_the_edges_of_the_indifference_region(theta, margin, alpha, beta):
    options = {"indifference": margin, "alpha": alpha, "beta": beta}
    for edge, wrong, share in ((theta + margin, "does not hold", alpha), (theta - margin, "holds", beta)):
        product, policy = coin(edge)
        verdicts = np.concatenate(list(Rollouts(product, policy, 1_500_000, 6))).reshape(1000, 1500)
        found = [sprt_from([row], theta, **options) for row in verdicts]
        errors = sum(result.verdict == wrong for result in found)
        assert fails_at_most(errors, 1000, share)
        assert errors > 0  # or the test would be far too cautious
        assert sum(result.verdict == "undecided" for result in found) <= 5
        mean = sum(result.runs for result in found) / 1000
        assert 0.9 < mean / wald(theta + margin, theta - margin, alpha, beta, edge) < 1.25


def test_the_test_on_a_policy_is_the_test_on_its_runs(patrolling):
    policy = stl.check(patrolling).policy
    for bound, verdict in ((0.7, "holds"), (0.76, "does not hold")):
        result = stl.sprt(patrolling, policy, bound, seed=9)
        other = sprt_from(Rollouts(patrolling, policy, 100_000, 9, purpose=Purpose.SPRT), bound)
        assert result.verdict == verdict
        assert (result.runs, result.satisfied) == (other.runs, other.satisfied)
    short = stl.sprt(patrolling, policy, 0.738, most_runs=200)
    assert (short.verdict, short.runs) == ("undecided", 200)
    seen = []
    stl.sprt(patrolling, policy, 0.738, indifference=0.0001, most_runs=40_000, progress=lambda *p: seen.append(p))
    assert seen == [(BLOCK, 40_000), (2 * BLOCK, 40_000), (40_000, 40_000)]


@pytest.mark.parametrize(("verdicts", "verdict", "runs"), [([1, 1, 0], "does not hold", 3), ([1] * 500, "holds", 44)])
def test_a_certain_hypothesis_falls_with_one_failure(verdicts, verdict, runs):
    result = sprt_from(np.array(verdicts, dtype=bool), 0.95, indifference=0.05)
    assert (result.verdict, result.runs) == (verdict, runs)  # 0.9^44 < 0.01
    assert math.isinf(result.log_likelihood_ratio) == (verdict == "does not hold")


# -------------------------------------------------------------------------------------- statements and bad input


def test_statements_say_what_is_claimed():
    half = estimate_from([np.array([True, False])] * 500, 1000)
    lower, upper = clopper_pearson(500, 1000)
    assert half.statement == "with confidence 99 % the probability lies in [0.458852, 0.541148]"
    assert 0.458852 <= lower < 0.458853
    assert 0.541147 < upper <= 0.541148
    rare = estimate_from(np.arange(10**6) < 1, 10**6, confidence=0.999)
    assert rare.statement.endswith("99.9 % the probability lies in [0.000000000500125, 0.00000999864]")
    one = estimate_from(np.ones(100, dtype=bool), 100, side="lower", confidence=0.95)
    assert one.statement == "with confidence 95 % the probability is at least 0.970486"
    assert "is at most 0.0295" in estimate_from(np.zeros(100, dtype=bool), 100, side="upper", confidence=0.95).statement
    found = [sprt_from(np.full(999, value), 0.9, alpha=0.02, beta=0.03) for value in (True, False)]
    assert found[0].statement == (
        "P >= 0.9 holds; if P were at most 0.89, this result would have probability at most 0.03"
    )
    assert found[1].statement == (
        "P >= 0.9 does not hold; if P were at least 0.91, this result would have probability at most 0.02"
    )
    assert sprt_from([True], 0.9).statement == "P >= 0.9 is undecided after 1 runs; no claim is made"


def test_a_fixed_number_of_verdicts_is_taken_and_no_more():
    taken, seen = [], []

    def endless():
        while True:
            taken.append(1)
            yield True

    result = estimate_from(endless(), 7, progress=lambda *p: seen.append(p))
    assert (result.runs, result.satisfied, len(taken), seen[-1]) == (7, 7, 7, (7, 7))
    assert estimate_from([np.ones(5, dtype=bool), np.zeros(9, dtype=bool)], 8).satisfied == 5
    with pytest.raises(SettingsError, match="ended after 2 of 3 runs"):
        estimate_from([True, False], 3)
    for verdict in (1, "true", np.ones((2, 2), dtype=bool), 0.5):
        with pytest.raises(SettingsError, match="give True or False"):
            estimate_from([verdict], 1)


def test_without_a_policy_the_optimal_one_is_judged(patrolling):
    best = stl.check(patrolling).policy
    for ask in (
        lambda *policy: stl.estimate(patrolling, *policy, runs=300, seed=5).satisfied,
        lambda *policy: stl.sprt(patrolling, *policy, at_least=0.7, seed=5).satisfied,
        lambda *policy: stl.sample_run(patrolling, *policy, seed=5),
        lambda *policy: stl.likely_runs(patrolling, *policy).runs,
        lambda *policy: stl.sensitivity(patrolling, *policy).tilt.tolist(),
    ):
        assert ask() == ask(None) == ask(best)


def test_without_a_policy_a_black_box_asks_for_one(patrolling):
    model = stl.MDP.black_box(2, 2, lambda rng: None, labels={"A": [1, 0]})
    hidden = stl.build_product(model, stl.parse("F[0,3] A"))
    for ask in (
        lambda: stl.estimate(hidden, runs=3), lambda: stl.sprt(hidden, at_least=0.5), lambda: stl.sample_run(hidden),
        lambda: stl.likely_runs(hidden), lambda: stl.sensitivity(hidden),
    ):  # fmt: skip
        with pytest.raises(
            SettingsError, match="whose optimal policy is not known; give .* a policy, such as stl.learn"
        ):
            ask()


def test_a_sampled_run_records_its_seed(patrolling):
    runs = [stl.sample_run(patrolling, seed=seed) for seed in (3, 3, np.int64(4))]
    assert runs[0] == runs[1] != runs[2]
    assert [run.seed for run in runs] == [3, 3, 4]
    with pytest.raises(SettingsError, match="seed is a Generator; give an integer from 0"):
        stl.sample_run(patrolling, seed=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"runs": 0}, "runs is 0; it must be an integer from 1"),
        ({"runs": 10.5}, "runs is 10.5; it must be an integer from 1"),
        ({"runs": 10**14}, "100000000000000 runs would take about 116 days"),
        ({"confidence": 1}, "confidence is 1; give a number between 0 and 1"),
        ({"confidence": 0.0}, "confidence is 0.0"),
        ({"confidence": math.nan}, "confidence is nan; a finite number is needed"),
        ({"confidence": "much"}, "confidence is 'much'; a finite number is needed"),
        ({"epsilon": 0}, "epsilon is 0; give a half-width"),
        ({"epsilon": 0.5}, "epsilon is 0.5; give a half-width"),
        ({"epsilon": 1e-8}, r"±1e-08 at confidence 0.99 takes up to 2.65e\+16 runs; these would take about"),
        ({"epsilon": 0.1, "runs": 5}, "runs and epsilon are both given"),
        ({"side": "left"}, "side is 'left'; choose both, lower or upper"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_settings_of_an_estimate_are_checked(options, message):
    product, policy = coin(0.5)
    with pytest.raises((SettingsError, SizeError), match=message):
        stl.estimate(product, policy, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at_least": 0}, "at_least is 0; give a probability above 0"),
        ({"at_least": 1}, "at_least is 1; give a probability above 0 and below 1"),
        ({"at_least": 0.995}, r"region 0.985 … 1.005 is not within \[0, 1\]; take an indifference of at most 0.005"),
        ({"at_least": 0.1, "indifference": 0.2}, r"region -0.1 … 0.3 is not within .* at most 0.1"),
        ({"indifference": 0}, "indifference is 0; give a number above 0"),
        ({"indifference": math.inf}, "indifference is inf; a finite number is needed"),
        ({"alpha": 0}, "alpha is 0"),
        ({"beta": 1.5}, "beta is 1.5"),
        ({"alpha": 0.5, "beta": 0.5}, r"alpha \+ beta is 1; choose them with a sum below 1"),
        ({"most_runs": 0}, "most_runs is 0"),
        ({"seed": 1.5}, "seed is 1.5"),
    ],
)
def test_settings_of_a_sequential_test_are_checked(options, message):
    product, policy = coin(0.5)
    with pytest.raises(SettingsError, match=message):
        stl.sprt(product, policy, **{"at_least": 0.5, **options})


def test_more_satisfied_than_runs_cannot_be():
    with pytest.raises(SettingsError, match="5 of 4 runs satisfied; give counts with"):
        clopper_pearson(5, 4)


@pytest.mark.parametrize("epsilon", [1e-10, 1e-155, 1e-200])
def test_no_one_has_so_many_runs(epsilon):
    with pytest.raises(SettingsError, match="give a half-width between 1e-9 and 0.5"):
        runs_needed(epsilon)


def test_bounds_do_not_load_what_takes_half_a_second(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    lower, upper = clopper_pearson(3, 10)
    assert 0 < lower < 0.3 < upper < 1
    assert runs_needed(0.1) > 100
