"""Gaps to the optimum from data: against exact checks, members of the set, and runs that stop when they may."""

import itertools
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import binomtest

import stltool as stl
from stltool.errors import SettingsError, TieError
from stltool.learning.counts import Counts
from stltool.learning.gap import TiedGaps, UntiedGaps, due
from stltool.learning.guarantee import interval_model
from stltool.reporting import render, report_data
from tests import oracles
from tests.conftest import FACTORY, many
from tests.learning.test_guarantee import counts_of, sampled

FLOOR = stl.load_model(FACTORY / "floor-5x5.toml")


@pytest.fixture(scope="module")
def patrolling():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    return stl.build_product(FLOOR, task)


def mutated(policy, t, s, q):
    """Another action at one place."""
    table = np.stack([policy.row(step) for step in range(policy.home.horizon)])
    table = np.maximum(table, 0)
    table[t, s, q] = (table[t, s, q] + 1) % 9
    return stl.Policy(policy.home, table)


def test_the_tied_gap_is_the_greatest_difference_on_the_set(patrolling):
    counts = sampled(FLOOR, np.random.default_rng(0), np.full(FLOOR.n_choices, 3))
    best = stl.check(patrolling).policy
    start = int(np.flatnonzero(FLOOR.initial)[0])
    q = patrolling.enter(start, patrolling.automaton.initial)
    for policy in (None, best, mutated(best, 0, start, q)):
        found = stl.optimality_gap(patrolling, policy, counts, parameters="model")
        (known,) = found.parameters
        differences = []
        for i in range(21):
            p = known.lower + (known.upper - known.lower) * i / 20
            member = replace(patrolling, model=FLOOR.at(success=p))
            own = stl.check(member, stl.Policy(member, found.policy.form)).probability
            differences.append(stl.check(member).probability - own)
        assert max(differences) - 1e-12 <= found.upper <= 1.2 * max(differences) + 1e-6
    assert found.upper > 1e-3  # the mutated policy is not optimal
    assert "(from none: " in found.statement
    assert "the same everywhere" in found.assumes


def test_the_set_may_contain_a_crossing():
    """With p one action is better, without it the other: near the crossing neither is proved to be best."""
    rows = [[["p", "1-p", 0], [0, 1, 0], [0, 0, 1]], [["1/2", 0, "1/2"], [0, 1, 0], [0, 0, 1]]]
    rows[0][0] = ["0", "1-p", "p"]
    rows[1][0] = ["0", "1/2", "1/2"]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    for wins, losses in ((5, 5), (80, 20), (20, 80)):
        counts = counts_of(model, [(0, 1, losses), (0, 2, wins)])
        found = stl.optimality_gap(product, None, counts, parameters="model")
        (known,) = found.parameters
        action = int(found.policy.row(0)[0, product.enter(0, product.automaton.initial)])
        worst = max(known.upper - Fraction(1, 2), 0) if action == 1 else max(Fraction(1, 2) - known.lower, 0)
        assert found.upper == pytest.approx(float(worst), abs=1e-6)
        assert found.upper >= worst


@pytest.mark.parametrize("seed", range(many(10)))
def test_the_untied_gap_holds_for_every_member(seed):
    rng = np.random.default_rng(seed)
    model = oracles.random_model(rng, 8)
    product = stl.build_product(model, stl.parse(["F[0,3] A", "G[0,2] !B", "(!B) U[0,3] A"][seed % 3]))
    counts = sampled(model, rng, rng.integers(0, 200, size=model.n_choices))
    policy = stl.Policy(product, rng.integers(2, size=(product.horizon, *product.shape)))
    found = stl.optimality_gap(product, policy, counts)
    intervals = interval_model(model, model.initial, counts, 0.99).intervals
    inside = interval_model(model, model.initial, counts, 0.99)
    for _ in range(5):
        rows = []
        for a, b in zip(inside.row_start[:-1].tolist(), inside.row_start[1:].tolist(), strict=True):
            row, left = intervals.lower[a:b].copy(), 1 - intervals.lower[a:b].sum()
            for k in rng.permutation(b - a):  # nature's corners
                take = min(intervals.upper[a + k] - intervals.lower[a + k], left)
                row[k], left = row[k] + take, left - take
            rows.append(row / row.sum())
        flat = np.concatenate(rows[: model.n_choices])
        member = product if (flat <= 0).any() else replace(product, model=model.with_rows(probability=flat, exact=None))
        own = stl.check(member, stl.Policy(member, policy.form)).probability
        assert stl.check(member).probability - own <= found.upper + 1e-9
    assert found.without_data == 1 or found.upper <= found.without_data


def test_the_untied_gap_of_much_data_is_the_exact_one():
    model = oracles.random_model(np.random.default_rng(3), 4)
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    counts = counts_of(model, [
        (c, int(model.target[k]), round(10**13 * model.probability[k]))
        for c in range(model.n_choices) for k in range(model.row_start[c], model.row_start[c + 1])
    ])  # fmt: skip
    for seed in range(5):
        table = np.random.default_rng(seed).integers(2, size=(product.horizon, *product.shape))
        policy = stl.Policy(product, table)
        exact = stl.check(product).probability - stl.check(product, policy).probability
        found = stl.optimality_gap(product, policy, counts)
        assert exact - 1e-12 <= found.upper
        assert found.upper <= exact + 1e-3 or found.upper <= 1  # a sum over the run of what single choices lose
    best = stl.optimality_gap(product, stl.check(product).policy, counts)
    assert best.upper < 1e-4


def test_learning_stops_when_the_gap_is_certified(patrolling, tmp_path):
    run = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.01, seed=0)
    assert run.status == "gap certified"
    assert run.gap.upper <= 0.01
    assert run.environment_steps < 200
    assert stl.check(patrolling).probability - stl.check(patrolling, run.policy).probability <= run.gap.upper
    assert [point.gap for point in run.history][-1] == run.gap.upper
    assert all(point.gap > 0.01 for point in run.history[:-1])
    data = report_data([stl.check(patrolling, run.policy)], run)
    page = render(data)
    assert "<b>Certified</b>: with confidence 99 %" in page
    assert '<td class="number">without data</td>' in page
    assert json.loads(json.dumps(data))["training"]["gap"]["transitions"] == run.environment_steps
    # the same, stopped and resumed
    path = tmp_path / "run.checkpoint"
    part = stl.learn(patrolling, "model-based", episodes=1, until_gap=0.01, seed=0, checkpoint=path)
    assert part.status == "complete"
    whole = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.01, seed=0, checkpoint=path, resume=True)
    again = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.01, seed=0, checkpoint=path, resume=True)
    for other in (whole, again):
        assert other.environment_steps == run.environment_steps
        assert other.gap.upper == run.gap.upper


def test_models_without_parameters_are_certified_untied():
    rows = [[[0.9, 0.1], [0, 1]], [[0.5, 0.5], [0, 1]]]
    product = stl.build_product(stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}), stl.parse("F[0,2] A"))
    run = stl.learn(product, "model-based", episodes=3000, until_gap=0.3, seed=0)
    assert run.gap.assumes == "the possible successors are known, their probabilities are not"
    exact = stl.check(product).probability - stl.check(product, run.policy).probability
    assert exact <= run.gap.upper
    assert run.status == "gap certified"
    assert run.episodes < 3000


def test_certificates_are_due_ever_more_rarely():
    times = [n for n in range(1, 10_000) if due(n)]
    assert times[:20] == list(range(1, 21))
    assert len(times) < 200
    assert all(later <= 1.11 * earlier + 1 for earlier, later in itertools.pairwise(times))


@pytest.mark.soak
def test_runs_are_given_a_gap_that_is_too_small_no_more_often_than_stated():
    """A hard instance: the true parameter is close to where the better action changes; one looks after each batch."""
    rows = [[["0", "1-p", "p"], [0, 1, 0], [0, 0, 1]], [["0", "1/2", "1/2"], [0, 1, 0], [0, 0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    gaps, wrong, p = TiedGaps(product, 0.8, enough=0.02), 0, 0.47  # the first action loses 0.03
    for seed in range(many(15)):
        rng, counts = np.random.default_rng(seed), Counts(model.n_choices, model.n_states)
        for _ in range(12):
            wins = int(rng.binomial(40, p))
            counts.add([0] * 40, [2] * wins + [1] * (40 - wins))
            found = gaps.of(counts)
            first = int(found.policy.row(0)[0, product.enter(0, product.automaton.initial)]) == 0
            if (0.03 if first else 0.0) > found.upper:
                wrong += 1
                break
    assert binomtest(wrong, many(15), 0.2, "greater").pvalue > 1e-4


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"until_gap": 0}, "until_gap is 0; give a probability between 0 and 1"),
        ({"until_gap": 2}, "until_gap is 2; give a probability between 0 and 1"),
        ({"until_gap": 0.1, "confidence": 1}, "confidence is 1"),
        ({"until_gap": 0.1, "faithful": True}, "until_gap is not for methods as published"),
    ],
)
def test_settings_out_of_range_are_refused(patrolling, options, says):
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, episodes=1, **options)


def test_what_does_not_fit_is_refused(patrolling):
    counts = Counts(FLOOR.n_choices, FLOOR.n_states)
    with pytest.raises(SettingsError, match="needs a policy"):
        stl.optimality_gap(patrolling, None, counts)
    with pytest.raises(SettingsError, match="leave out successors or parameters"):
        stl.optimality_gap(patrolling, None, counts, parameters="model", successors=lambda s, a: [s])
    hidden = stl.MDP.black_box(3, 2, lambda rng: None, labels={"A": [0, 0, 1]})
    box = stl.build_product(hidden, stl.parse("F[0,2] A"))
    with pytest.raises(SettingsError, match="possible successors are not known"):
        stl.learn(box, until_gap=0.1)
    mixed = stl.Policy(patrolling, np.full((*patrolling.shape, 9), 1 / 9))
    with pytest.raises(SettingsError, match="deterministic"):
        stl.optimality_gap(patrolling, mixed, counts)
    rng, here = np.random.default_rng(0), np.repeat(np.arange(FLOOR.n_states), np.diff(FLOOR.choice_start)) == 8
    parts = [sampled(member, rng, tries) for member, tries in
             ((FLOOR, np.where(here, 0, 40)), (FLOOR.at(success="1/3"), np.where(here, 40, 0)))]  # fmt: skip
    odd = counts_of(FLOOR, [row for one in parts for row in zip(one.choice, one.target, one.seen, strict=True)])
    with pytest.raises(TieError):
        stl.optimality_gap(patrolling, None, odd, parameters="model")
    assert UntiedGaps(patrolling, 0.99).of(odd, stl.check(patrolling).policy).upper > 0.3
