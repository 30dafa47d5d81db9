"""A state with more actions than int16 can number: every answer, policy and file is that of the best one, the last."""

from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.checking.certificate import require_certificate_of
from stltool.errors import PolicyError
from stltool.learning.counts import Counts
from stltool.learning.model_based import ModelBased
from stltool.learning.problem import Problem
from stltool.learning.tables import ClockedTable, Entries
from stltool.models.fractions import Shares
from stltool.models.intervals import Intervals
from stltool.models.rows import Stored

BORDERS = [2**15, 2**15 + 1, 40_000]  # int16 numbers 2^15 choices, counted from 0
TASK = stl.parse("F[0,2) F[0,2) goal")  # two tries: 1 − (1 − p)²
BEST, LEAST = Fraction(99, 100), Fraction(7, 16)


def model(n):
    """A start with n actions that reach the goal with chance 1/2, but the first with 1/4 and the last with 9/10."""
    hundredths = np.full(n, 50)
    hundredths[0], hundredths[-1] = 25, 90
    numerator = np.append(np.stack([100 - hundredths, hundredths], axis=1).ravel(), 100)
    return stl.MDP(
        Stored(
            choice_start=np.array([0, n, n + 1]),
            choice_action=np.append(np.arange(n), 0).astype(np.int32),
            row_start=np.append(2 * np.arange(n + 1), 2 * n + 1),
            target=np.append(np.tile([0, 1], n), 1).astype(np.int32),
            probability=numerator / 100,
            exact=Shares(numerator, 100),
        ),
        initial=np.array([1.0, 0.0]),
        signals={},
        labels={"goal": np.array([False, True])},
        action_names=tuple(map(str, range(n))),
    )


@pytest.fixture(scope="module", params=BORDERS)
def wide(request):
    """(the number of actions, product, its check)"""
    product = stl.build_product(model(request.param), TASK)
    return request.param, product, stl.check(product)


def first(product, policy):
    """What the policy takes at the start."""
    return policy.row(0)[0, product.enter(0, product.automaton.initial)]


def test_a_table_is_as_wide_as_it_must_be(wide):
    n, product, best = wide
    table = best.policy.table
    assert table.dtype == (np.int16 if n <= 2**15 else np.int32)
    assert Problem.of(product).choice_type == product.model.choice_type == table.dtype


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"exact": True},
        *(
            pytest.param(options, marks=pytest.mark.soak(only=True))  # whose kernels nobody else compiles
            for options in ({"arithmetic": "double"}, {"engine": "words"}, {"engine": "words", "arithmetic": "double"})
        ),
    ],
    ids=str,
)
def test_the_optima(wide, options):
    n, product, _ = wide
    for maximize, value, choice in ((True, BEST, n - 1), (False, LEAST, 0)):
        optimum = stl.check(product, maximize=maximize, **options)
        assert first(product, optimum.policy) == choice
        for found in (optimum, stl.check(product, optimum.policy, **options)):
            assert found.lower <= value <= found.upper
            assert found.probability == pytest.approx(float(value))
            assert found.fraction == (value if "exact" in options else None)


def test_fractions_in_pythons_integers(wide):
    n, product, _ = wide
    numerator, denominator = product.model.exact().numerator, 100 * 2**40
    finer = product.model.with_rows(exact=Shares(numerator * 2**40, denominator))
    best = stl.check(stl.build_product(finer, TASK), exact=True)
    assert best.fraction == BEST
    assert first(product, best.policy) == n - 1


def test_intervals(wide):
    n, product, _ = wide
    rows = product.model.row_start
    sure = np.diff(rows)[np.repeat(np.arange(n + 1), np.diff(rows))] == 1
    points = product.model.probability
    ends = Intervals(np.where(sure, 1, points - 0.05), np.where(sure, 1, points + 0.05))
    loose = product.model.with_rows(probability=ends.nominal(rows), intervals=ends)
    uncertain = stl.build_product(loose, TASK)
    best = stl.robust_check(uncertain)
    assert first(product, best.policy) == n - 1
    for found in (best, stl.robust_check(uncertain, best.policy)):
        assert found.probability == pytest.approx(1 - 0.15**2)


def test_runs(wide):
    n, product, best = wide
    mixture = np.zeros((*product.shape, n))
    mixture[0, :, -1], mixture[1, :, 0] = 1, 1
    for policy in (best.policy, stl.Policy(product, mixture)):
        found = stl.estimate(product, policy, epsilon=0.05, seed=0)
        assert found.lower <= float(BEST) <= found.upper
        assert stl.check(product, policy).probability == pytest.approx(float(BEST))
    likely = stl.likely_runs(product, best.policy, satisfied=True, count=1).runs[0]
    assert (likely.probability, likely.actions) == (pytest.approx(0.9), (str(n - 1),))


def test_the_surrogate(wide):
    n, product, _ = wide
    found = stl.surrogate_optimum(product, "episode")
    assert first(found.greatest.product, found.greatest.policy) == n - 1
    assert found.greatest.probability == pytest.approx(float(BEST))


def test_trade_offs(wide):
    _, product, _ = wide
    joint = stl.build_joint_product(product.model, {"soon": stl.parse("F[0,1] goal"), "late": stl.parse("F[0,2] goal")})
    assert stl.pareto(joint).corners[-1].point == pytest.approx((0.9, float(BEST)))


def test_files(wide, tmp_path):
    _, product, best = wide
    best.policy.save(tmp_path / "policy.npz")
    loaded = stl.load_policy(tmp_path / "policy.npz", product)
    assert loaded.table.dtype == best.policy.table.dtype
    assert np.array_equal(loaded.table, best.policy.table)
    stl.write_certificate(stl.check(product, loaded), tmp_path / "certificate.json")
    stl.certify(tmp_path / "certificate.json")
    require_certificate_of(tmp_path / "certificate.json", product, loaded)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.uint32, np.int64, np.uint64])
def test_tables_of_any_integers(wide, dtype):
    n, product, best = wide
    given = best.policy.table.astype(dtype)
    assert np.array_equal(stl.Policy(product, given).table, given)
    most = int(np.iinfo(dtype).max)
    for beyond in {n, min(2**16 + n - 1, most), most}:
        wrong = given.copy()
        wrong[0, 0, 0] = beyond
        with pytest.raises(PolicyError, match=f"takes choice {beyond} in state 0, which has {n}"):
            stl.Policy(product, wrong)


# ------------------------------------------------------------------------------------------------------- learners


def test_learned_tables(wide):
    n, product, _ = wide
    problem, q = Problem.of(product), product.enter(0, product.automaton.initial)
    entries = Entries(problem)
    table = ClockedTable(entries, 0.1, 0.1)
    table.visits[0, -1], table.Q[0, -1] = 100, 0.9
    assert table.policy_table()[0, 0, q] == n - 1
    assert table.best(0, 0, q, 0.0) == n - 1

    counts, learner = Counts(product.model.n_choices, 2), ModelBased()
    counts.add(np.full(100, n - 1), np.ones(100, dtype=np.int64))
    form = learner.policy(learner.start(problem, counts, np.random.default_rng(0)))
    assert form.at(0, np.array([0]), np.array([q])).tolist() == [n - 1]


def test_a_policy_from_counts(wide):
    n, product, _ = wide
    counts = Counts(product.model.n_choices, 2)
    counts.add(np.full(500, n - 1), np.ones(500, dtype=np.int64))
    promised = stl.guarantee(product, None, counts)
    assert first(product, promised.policy) == n - 1
    assert promised.lower > 0.8


@pytest.mark.parametrize("method", ["cfer", "naive", "naive-er", "model-based"])
def test_learning_runs(wide, method):
    _, product, _ = wide
    run = stl.learn(product, method, episodes=3, seed=0)
    assert stl.check(product, run.policy).probability >= float(LEAST) - 1e-9


def test_updates_are_counted_beyond_int32(wide):
    _, product, _ = wide
    entries = Entries(Problem.of(product))
    table = ClockedTable(entries, 0.1, 0.1)
    q = product.enter(0, product.automaton.initial)
    table.visits[0, 0] = 2**31 - 1
    table.update(0, 0, q, 0, 1)
    assert table.visits[0, 0].max() == 2**31
    assert 0 <= table.Q.max() <= 1
