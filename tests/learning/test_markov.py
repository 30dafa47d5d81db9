"""`markov_test`: its level on data that are Markov, whoever gathered them; what it finds in data that are not."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import binom

import stltool as stl
from stltool.errors import SettingsError
from stltool.learning import markov
from stltool.models.environment import Environment
from tests.conftest import many


def counted(rows, n_choices=1, n_states=4, n_contexts=8):
    """Counts of transitions (choice, target, context)."""
    counts = stl.Counts(n_choices, n_states, n_contexts)
    counts.add(*np.array(rows, dtype=np.int64).reshape(-1, 3).T)
    return counts


def from_table(table):
    rows = [(0, s, g) for g, row in enumerate(table) for s, n in enumerate(row) for _ in range(n)]
    return counted(rows)


def ratio(table):
    """G, written out."""
    n, found = sum(map(sum, table)), 0.0
    for row in table:
        for j, k in enumerate(row):
            if k:
                found += 2 * k * math.log(k * n / (sum(row) * sum(r[j] for r in table)))
    return found


def exact_p(table):
    """The share of all pairings of contexts with outcomes whose G is at least that of the table."""
    contexts = [g for g, row in enumerate(table) for _ in range(sum(row))]
    outcomes = [s for row in table for s, n in enumerate(row) for _ in range(n)]
    observed, reached, total = ratio(table), 0, 0
    for order in itertools.permutations(outcomes):
        other = [[0] * len(table[0]) for _ in table]
        for g, s in zip(contexts, order, strict=True):
            other[g][s] += 1
        total += 1
        reached += ratio(other) >= observed - 1e-9
    return Fraction(reached, total)


@pytest.mark.parametrize("table", [[[3, 0], [1, 3]], [[2, 1, 0], [0, 1, 3]], [[1, 1], [2, 1], [0, 2]]])
def test_p_is_the_share_of_pairings_as_extreme(table):
    draws = 20_000
    found = stl.markov_test(from_table(table), draws=draws)
    share = float(exact_p(table))
    assert found.statistic == pytest.approx(ratio(table))
    assert found.choices == 1
    # of one choice, both statistics order the tables alike, and twice the smaller p-value counts
    slack = 2 * 6 * math.sqrt(share * (1 - share) / draws) + 2 / draws
    assert found.p_value == pytest.approx(min(1, 2 * share), abs=slack)


def level(p_values, alpha):
    """Whether p ≤ α occurs no more often than stated; a test of level α fails this once in a million times."""
    return (np.array(p_values) <= alpha).sum() <= binom.isf(1e-6, len(p_values), alpha)


@pytest.mark.soak
def test_markov_data_are_rejected_no_more_often_than_stated():
    rng, p_values = np.random.default_rng(), []
    for _ in range(many(300)):
        rows = []
        for choice in range(3):
            n, law = int(rng.integers(2, 40)), rng.dirichlet(np.full(4, 0.3))
            rows += zip(
                [choice] * n, rng.choice(4, n, p=law), rng.choice(8, n, p=rng.dirichlet(np.ones(8))), strict=True
            )
        p_values.append(stl.markov_test(counted(rows, 3), draws=199, seed=int(rng.integers(2**32))).p_value)
    assert all(level(p_values, alpha) for alpha in (0.02, 0.05, 0.1, 0.3))


def random_product(rng):
    laws = rng.dirichlet(np.full(4, 0.5), size=(2, 4))
    model = stl.MDP.from_arrays(laws, {}, labels={"goal": np.arange(4) == 3})
    return stl.build_product(model, stl.parse("G[0,4] F[0,3] goal"))


@pytest.mark.soak
@pytest.mark.parametrize("method", ["cfer", "model-based"])
def test_learners_data_are_rejected_no_more_often_than_stated(method):
    rng, p_values = np.random.default_rng(), []
    for _ in range(many(15)):
        seed, episodes = int(rng.integers(2**32)), int(rng.integers(5, 40))
        run = stl.learn(random_product(rng), method, episodes=episodes, evaluate_every=episodes, seed=seed)
        p_values.append(stl.markov_test(run.counts, draws=199, seed=seed).p_value)
    assert all(level(p_values, alpha) for alpha in (0.02, 0.05, 0.1, 0.3))


def inertial(strength):
    """Two rooms: `move` succeeds with probability .8, or .8 − strength right after another move."""

    def environment(rng):
        here = moved = 0

        def reset():
            nonlocal here, moved
            here = moved = 0
            return here

        def step(action):
            nonlocal here, moved
            here = 1 - here if action and rng.random() < 0.8 - strength * moved else here
            moved = action
            return here

        return Environment(reset, step)

    model = stl.MDP.black_box(2, ["stay", "move"], environment, labels={"goal": [False, True]})
    return stl.build_product(model, stl.parse("G[0,6] F[0,3] goal"))


def test_a_choice_that_remembers_the_one_before_is_found():
    run = stl.learn(inertial(0.4), episodes=300, seed=0)
    found = stl.markov_test(run.counts)
    assert found.rejected
    assert found.p_value == 2 / 1000
    assert "p <= 0.002" in found.statement
    assert {choice for choice, deviations in found.most if deviations > 5} <= {1, 3}  # the moves
    assert not stl.markov_test(
        stl.learn(inertial(0.0), episodes=300, seed=0).counts, confidence=0.9999, draws=19_999
    ).rejected


def test_the_dependence_is_what_contexts_move():
    n = 20_000
    table = [[n * 6 // 10, n * 4 // 10], [n * 5 // 10, n * 5 // 10]]  # .05 from the mean of both, either way
    assert stl.markov_test(from_table(table)).dependence == pytest.approx(0.05, abs=0.005)
    same = [[n // 2, n // 2], [n // 2, n // 2]]
    assert stl.markov_test(from_table(same)).dependence == 0


def test_one_choice_of_many_that_depends_is_found():
    rng, rows = np.random.default_rng(0), []
    for choice in range(300):
        context, target = rng.integers(0, 8, 100), rng.integers(0, 4, 100)
        if choice == 7:
            target = np.where(rng.random(100) < 0.6, context % 4, target)
        rows += zip([choice] * 100, target, context, strict=True)
    found = stl.markov_test(counted(rows, 300), draws=499)
    assert found.rejected
    assert found.most[0][0] == 7


@pytest.mark.parametrize(("confidence", "draws"), [(0.99, 199), (0.999, 1999), (0.9, 19)])
def test_the_least_p_value_that_rejects_does(confidence, draws):
    found = stl.markov_test(from_table([[30, 0], [0, 30]]), confidence=confidence, draws=draws)
    assert found.p_value == 2 / (draws + 1)
    assert found.rejected


def test_the_same_seed_gives_the_same_result():
    counts = from_table([[9, 3, 2], [4, 6, 2], [1, 7, 3]])
    first, again, other = (stl.markov_test(counts, seed=seed) for seed in (5, 5, 6))
    assert (first.p_value, first.expected) == (again.p_value, again.expected)
    assert first.expected != other.expected


def test_tables_drawn_in_batches_are_those_drawn_at_once(monkeypatch):
    counts = from_table([[9, 3, 2], [4, 6, 2], [1, 7, 3]])
    at_once = stl.markov_test(counts)
    monkeypatch.setattr(markov, "_CELLS", 90)
    assert stl.markov_test(counts).p_value == at_once.p_value


@pytest.mark.parametrize(
    "rows", [[], [(0, 1, 0), (0, 2, 0)], [(0, 1, 0), (0, 1, 3)]], ids=["no data", "one context", "one outcome"]
)
def test_data_that_say_nothing_are_not_rejected(rows):
    found = stl.markov_test(counted(rows))
    assert (found.p_value, found.choices, found.transitions, found.rejected) == (1, 0, 0, False)
    assert found.statement.startswith("nothing to test")
    assert "nothing to test" in repr(found)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"confidence": 1.0}, "confidence"),
        ({"draws": 0}, "draws is 0"),
        ({"draws": 100}, "no p-value is less than 0.0198.*draws=199"),
        ({"confidence": 0.9999}, "use draws=19999"),
        ({"seed": -1}, "seed is -1"),
    ],
)  # fmt: skip
def test_settings_that_cannot_be(options, says):
    with pytest.raises(SettingsError, match=says):
        stl.markov_test(from_table([[1, 2], [2, 1]]), **options)


def test_counts_without_contexts_are_refused():
    counts = stl.Counts(1, 2)
    counts.add([0, 0], [0, 1])
    with pytest.raises(SettingsError, match="no contexts"):
        stl.markov_test(counts)


def test_progress_counts_choices():
    seen = []
    stl.markov_test(from_table([[1, 2], [2, 1]]), progress=lambda done, of: seen.append((done, of)))
    assert seen == [(1, 1)]


def test_a_report_names_the_choices_that_depend_most(tmp_path):
    product = inertial(0.4)
    run = stl.learn(product, episodes=300, seed=0)
    stl.report([], run, tmp_path / "report.html", guarantees=[stl.estimate(product, run.policy, runs=50)])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "the next state depends on more than state and action (p &lt;= 0.002" in page
    assert "Most dependent (standard deviations): state " in page
