"""`sensitivity` against difference quotients in fractions: rows moved by ±1/10⁶, the policy held fixed."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.errors import SizeError
from tests import oracles
from tests.checking.test_check import products, random_policy
from tests.conftest import many

H = Fraction(1, 10**6)


def entries(model):
    """Every entry of the rows as a fraction."""
    return [Fraction(float(p)) for p in model.probability]


def value(product, policy, probability):
    """P and the expected visits of each state with other probabilities in the rows, by walking all runs."""
    model, automaton = product.model, product.automaton
    visits = [Fraction(0)] * model.n_states

    def walk(p, s, q, t):
        verdict = automaton.verdicts(t)[q]
        if verdict != UNDECIDED:
            return p * (verdict == TRUE)
        visits[s] += p
        entry, total = policy.row(t)[s, q], Fraction(0)
        for i in range(model.choice_start[s + 1] - model.choice_start[s]):
            w = Fraction(int(i == entry)) if policy.deterministic else Fraction(float(entry[i]))
            c = model.choice_start[s] + i
            if w:
                for k in range(model.row_start[c], model.row_start[c + 1]):
                    s2 = int(model.target[k])
                    total += walk(p * w * probability[k], s2, product.enter(s2, q), t + 1)
        return total

    start = oracles.initial(model)
    return sum((walk(p, s, product.enter(s, automaton.initial), 0) for s, p in start), Fraction(0)), visits


def tilted(model, choices, by):
    """The entries with the rows of these choices tilted: the most probable entry gets `by`, the others lose it."""
    moved = entries(model)
    for c in choices:
        row = range(model.row_start[c], model.row_start[c + 1])
        top = max(row, key=lambda k: moved[k])
        if len(row) > 1:
            rest = sum(moved[k] for k in row if k != top)
            for k in row:
                moved[k] *= 1 if k == top else 1 - by / rest
            moved[top] += by
    return moved


def slope(product, policy, move):
    up, down = (value(product, policy, move(by))[0] for by in (H, -H))
    return float((up - down) / (2 * H))


@st.composite
def cases(draw):
    product = draw(products())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return product, random_policy(product, rng, timed=draw(st.booleans()), mixed=draw(st.booleans()))


def near(value):
    return pytest.approx(value, rel=1e-8, abs=1e-8)


@given(cases())
@settings(max_examples=many(40))
def test_engines_find_the_same_to_the_bit(case):
    product, policy = case
    nodes, words = (stl.sensitivity(product, policy, engine=engine) for engine in ("nodes", "words"))
    assert nodes.probability == words.probability
    for name in ("gradient", "tilt", "visits", "times"):
        assert np.array_equal(getattr(nodes, name), getattr(words, name))


@given(cases(), st.data())
@settings(max_examples=many(50))
def test_derivatives_equal_difference_quotients(case, data):
    product, policy = case
    model = product.model
    result = stl.sensitivity(product, policy)
    p, visits = value(product, policy, entries(model))
    assert result.probability == pytest.approx(float(p), abs=1e-12)
    assert result.visits == pytest.approx([float(v) for v in visits], abs=1e-12)
    s = data.draw(st.integers(0, model.n_states - 1))
    rows = range(model.choice_start[s], model.choice_start[s + 1])
    assert result.derivative[s] == near(slope(product, policy, lambda by: tilted(model, rows, by)))
    c = data.draw(st.sampled_from(rows))
    assert result.tilt[c] == near(slope(product, policy, lambda by: tilted(model, [c], by)))
    k = data.draw(st.integers(0, model.n_transitions - 1))

    def one_entry(by):
        return [p + by * (i == k) for i, p in enumerate(entries(model))]

    assert result.gradient[k] == near(slope(product, policy, one_entry))


@given(cases())
@settings(max_examples=many(30))
def test_laws(case):
    """No tilt beats the steepest move; visits and choices count the same steps; where nobody goes nothing moves."""
    product, policy = case
    model = product.model
    result = stl.sensitivity(product, policy)
    assert (abs(result.derivative) <= result.steepest + 1e-12).all()
    assert np.add.reduceat(result.times, model.choice_start[:-1]) == pytest.approx(result.visits, abs=1e-12)
    assert result.visits.sum() <= product.horizon + 1e-9
    never = result.visits == 0
    assert not result.derivative[never].any()
    sure = np.diff(model.row_start) == 1
    assert not result.tilt[sure].any()
    ranked = result.ranked()
    sizes = [abs(row.derivative) for row in ranked]
    assert sizes == sorted(sizes, reverse=True)
    assert {row.state for row in ranked} == set(np.flatnonzero(~never).tolist())
    assert result.ranked(1) == ranked[:1]
    for row in ranked:
        assert row.derivative == pytest.approx(sum(action.derivative for action in row.actions), abs=1e-12)
        assert row.visits == pytest.approx(sum(action.times for action in row.actions), abs=1e-12)
        assert all(action.times > 0 for action in row.actions)


def test_one_try_after_another():
    """P = 1 − (1 − p)³ for three tries with success p: dP/dp = 3 (1 − p)²; the answer in the user's names."""
    rows = [[[0.25, 0.75, 0], [0, 1, 0], [0, 0, 1]]]
    model = stl.MDP.from_arrays(
        rows, {"x": [0, 1, 2]}, labels={"goal": [0, 1, 0]}, action_names=["try"], state_names=["door", "hall", "pit"]
    )
    result = stl.sensitivity(stl.build_product(model, stl.parse("F[0,3] goal")))
    assert result.probability == pytest.approx(1 - 0.25**3)
    assert result.derivative == pytest.approx([3 * 0.25**2, 0, 0])
    assert result.steepest == pytest.approx(result.derivative)
    (row,) = result.ranked()
    assert (row.state, row.name) == (0, "door")
    assert row.visits == pytest.approx(1 + 0.25 + 0.25**2)
    (action,) = row.actions
    assert (action.action, action.intended, action.success) == ("try", "hall", 0.75)


def test_states_and_actions_in_order():
    """The largest change first, up or down; of the actions those that the policy takes, the most telling first."""
    good, bad = [0, 0, 0.75, 0.25], [0, 0, 0.25, 0.75]
    goal, pit = [0, 0, 1, 0], [0, 0, 0, 1]
    model = stl.MDP.from_arrays(
        [[good, good, goal, pit], [bad, bad, goal, pit], [good, good, goal, pit]], {"x": range(4)},
        initial=[0.25, 0.75, 0, 0], labels={"goal": [0, 0, 1, 0]}, action_names=["up", "down", "never"],
    )  # fmt: skip
    product = stl.build_product(model, stl.parse("F[0,1] goal"))
    weights = np.zeros((*product.shape, 3))
    weights[..., 0] = 1
    weights[1] = [0.25, 0.75, 0]
    result = stl.sensitivity(product, stl.Policy(product, weights))
    first, second = result.ranked()
    assert (first.state, second.state) == (1, 0)
    assert (first.derivative, second.derivative) == pytest.approx((0.75 * (0.25 - 0.75), 0.25))
    assert [(action.action, action.intended) for action in first.actions] == [("down", "3"), ("up", "2")]
    assert [action.derivative for action in first.actions] == pytest.approx([-0.75 * 0.75, 0.75 * 0.25])
    assert first.steepest == pytest.approx(0.75)


def test_for_an_optimal_policy_it_is_the_optimums_derivative(patrolling):
    """Envelope theorem: the floor's best P with another success probability in one state, policies free."""
    model = patrolling.model
    result = stl.sensitivity(patrolling)
    assert result.probability == pytest.approx(stl.check(patrolling).probability, abs=1e-12)
    (top,) = result.ranked(1)
    assert top.name == "(2,2)"

    def optimum(by):
        rows = range(model.choice_start[top.state], model.choice_start[top.state + 1])
        moved = np.array([float(p) for p in tilted(model, rows, Fraction(by))])
        changed = model.with_rows(probability=moved, exact=None)
        return stl.check(stl.build_product(changed, patrolling.formula)).probability

    assert (optimum(1e-6) - optimum(-1e-6)) / 2e-6 == pytest.approx(top.derivative, rel=1e-6)


def test_a_policy_with_other_memory_is_judged_on_the_join(patrolling, flagged):
    policy = stl.check(flagged).policy
    joined, same = stl.sensitivity(patrolling, policy), stl.sensitivity(flagged, policy)
    assert joined.gradient == pytest.approx(same.gradient, abs=1e-12)
    assert joined.derivative == pytest.approx(same.derivative, abs=1e-12)


def test_a_formula_that_the_first_state_decides(floor5):
    result = stl.sensitivity(stl.build_product(floor5, stl.parse("!A")))
    assert (result.probability, result.ranked(), result.derivative.any()) == (1.0, (), False)


def test_what_would_not_fit_is_refused(patrolling):
    policy = stl.check(patrolling).policy
    with pytest.raises(SizeError, match="derivatives for"):
        stl.sensitivity(patrolling, policy, memory_limit=1000)
