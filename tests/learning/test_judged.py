"""The best policy by a run's own data, against the checker on a model made of the same counts; when a curve rests."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import FALSE, UNDECIDED
from stltool.learning.counts import Counts
from stltool.learning.judged import EVERY, BestSoFar, settled
from stltool.learning.problem import Problem
from stltool.learning.trainer import Point
from stltool.product import first_verdicts, with_outcome
from tests.checking.test_check import products
from tests.conftest import many
from tests.learning.test_planner import counted, early


def counted_model(product, counts, caution, first):
    """The frequencies as a model, with one more state where doubts lead."""
    model, n = product.model, product.model.n_states
    rows = np.zeros((len(model.action_names), n + 1, n + 1))
    rows[0, n, n] = 1
    s = np.repeat(np.arange(n), np.diff(model.choice_start))
    visits = counts.visits
    for c, (state, action) in enumerate(zip(s.tolist(), model.choice_action.tolist(), strict=True)):
        mine = counts.choice == c
        rows[action, state, counts.target[mine]] = counts.seen[mine] / max(visits[c] + caution, 1e-300)
        rows[action, state, n] = 1 - rows[action, state, :n].sum()
    initial = np.append(first / first.sum(), 0.0)
    return stl.MDP.from_arrays(rows, {}, initial=initial, action_names=list(model.action_names))


@given(products(states=4), st.integers(0, 2**32 - 1), st.sampled_from([0.1, 2.0]))
@settings(max_examples=many(40))
def test_the_value_by_the_data_is_the_checkers_on_the_counts(product, seed, caution):
    if product.horizon == 0:
        return
    product, problem, rng = early(product), Problem.of(product), np.random.default_rng(seed)
    counts = counted(product, rng, 0.7)
    best = BestSoFar(problem, counts, caution)
    table = rng.integers(problem.n_choices[:, None], size=problem.shape).astype(problem.choice_type)
    assert best.value(table) == 0  # before any episode
    undecided = first_verdicts(product, np.arange(problem.n_states)) == UNDECIDED
    if not undecided.any():
        return
    best.starts[undecided] = rng.integers(1, 5, size=int(undecided.sum()))
    outside = with_outcome(product, counted_model(product, counts, caution, best.starts), FALSE)
    again = np.zeros((problem.shape[0], problem.shape[1] + 1, problem.shape[2] + 1), dtype=np.int64)
    again[:, :-1, :-1] = table
    exact = stl.check(outside, stl.Policy(outside, again)).probability
    assert best.value(table) == pytest.approx(exact, abs=1e-12)


def test_the_better_of_two_is_kept():
    """Three states: b was seen to be good more often than a."""
    rows = np.zeros((2, 3, 3))
    rows[:, [1, 2], [1, 2]] = 1
    rows[0, 0, 1:] = rows[1, 0, 1:] = 0.5
    model = stl.MDP.from_arrays(rows, {}, labels={"good": [False, True, False]}, action_names=["a", "b"])
    product = stl.build_product(model, stl.parse("F[0,1] good"))
    counts = Counts(product.model.n_choices, 3)
    best = BestSoFar(Problem.of(product), counts, 0.1)
    best.starts[0] = 20
    a, b = (np.full(Problem.of(product).shape, i, dtype=np.int16) for i in (0, 1))
    counts.add([0] * 10 + [1] * 10, [1, 2] * 5 + [1] * 8 + [2] * 2)
    assert best.value(b) == pytest.approx(8 / 10.1)
    best.end(a)
    assert best.better(b) is b
    best.end(b)
    best.end(a)
    assert (best.table == 1).all()
    counts.add([0] * 100, [1] * 100)  # more data, and a is the better one
    assert best.better(a) is a


@pytest.mark.parametrize("method", ["naive", "naive-er"])
def test_a_run_ends_with_the_best_policy_by_its_data(patrolling, method, monkeypatch):
    """None of the policies compared on the way is better by the data at the end."""
    seen, runs = [], []
    genuine = BestSoFar.end

    def end(self, policy):
        seen.append(policy.copy())
        runs.append(self)
        genuine(self, policy)

    monkeypatch.setattr(BestSoFar, "end", end)
    run = stl.learn(patrolling, method, episodes=3 * EVERY + 5, evaluate_every=5)
    assert len(seen) == 3
    found = runs[0].value(run.policy.table)
    assert found >= max(map(runs[0].value, [seen[-1], runs[0].table]))
    assert run.history[-1].probability == stl.check(patrolling, run.policy).probability


def history(*values):
    return [Point(10 * (i + 1), 100 * (i + 1), value) for i, value in enumerate(values)]


@pytest.mark.parametrize(
    ("values", "rests"),
    [
        ([0.1, 0.5, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9], True),
        ([0.1, 0.5, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.88, 0.9], False),  # moved in the last quarter
        ([0.1, 0.5, 0.9, 0.9, 0.9, 0.9, 0.88, 0.9, 0.9, 0.9, 0.9, 0.9], True),  # moved before
        ([0.9, 0.905, 0.909], True),
        ([0.9, 0.905, 0.911], False),
        ([0.0, 0.9, 0.9, 0.9], True),  # at least three are compared
        ([0.0, 0.0, 0.9, 0.9], False),
        ([0.9, 0.9], None),
        ([], None),
        ([None] * 12, None),
    ],
)
def test_a_curve_rests_if_its_last_quarter_does(values, rests):
    assert settled(history(*values)) is rests


def test_advice_is_given_while_the_curve_moves(patrolling):
    run = stl.learn(patrolling, "cfer", episodes=6, evaluate_every=2)
    moving = dataclasses.replace(run, history=history(0.1, 0.2, 0.3))
    assert (moving.settled, moving.advice) == (False, "not settled: more episodes, or model-based")
    assert dataclasses.replace(moving, status="within the gap").advice is None
    assert dataclasses.replace(moving, learner=stl.ModelBased()).advice == "not settled: more episodes"
    assert dataclasses.replace(run, history=history(0.3, 0.3, 0.3)).advice is None
