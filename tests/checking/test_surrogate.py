"""The surrogate's optimum against policy iteration with linear solves, all stationary policies, and all histories."""

import itertools
import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.induction import Budget
from stltool.checking.surrogate import _discounted, _episode, _extreme, _uniform
from stltool.choices import Table
from stltool.errors import FragmentError, SettingsError, SizeError
from stltool.learning.problem import Problem
from stltool.logic.fragment import check_fragment
from stltool.testing import flag_formulas, interval_mdps, mdps
from tests import dense, oracles
from tests.conftest import FACTORY, many

GAMMA = 0.9
CLEAR = 1e-7  # the oracle's own rounding; choices that lose less are not told apart there


@st.composite
def flagged(draw, longest=2, equal=True, **options):
    """Tiny models with tasks of the fragment, on their flags."""
    phi = draw(flag_formulas(longest=longest, equal=equal, horizon=3))
    assume(stl.horizon(phi) >= 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return stl.build_product(draw(mdps(**options)), phi, encoding="paper")


def chi_of(product):
    """The inner formula's truth at every flag vector, by the paper's eq. 11."""
    fragment = check_fragment(product.formula)
    rows = []
    for flags in product.automaton.registers.tolist():
        held = [f > 0 if part.operator == "F" else f == part.tau for part, f in zip(fragment.parts, flags, strict=True)]
        rows.append(float(fragment.combine(held)))
    return np.array(rows)


def explicit(product):
    """rows[(s,q)] = for every choice a distribution over product states, as a dense array."""
    n_q = product.automaton.n_states
    rows = []
    for s, q in itertools.product(range(product.model.n_states), range(n_q)):
        dense = []
        for row in oracles.choices(product.model, s):
            p = np.zeros(product.n_states)
            for s2, share in row:
                p[s2 * n_q + product.enter(s2, q)] += float(share)
            dense.append(p)
        rows.append(dense)
    return rows


def value_of(rows, picks, reward, gamma):
    """(I − γP)⁻¹ P r of a stationary deterministic policy."""
    P = np.array([row[pick] for row, pick in zip(rows, picks, strict=True)])
    return np.linalg.solve(np.eye(len(rows)) - gamma * P, P @ reward)


def policy_iteration(rows, reward, gamma):
    picks = [0] * len(rows)
    while True:
        V = value_of(rows, picks, reward, gamma)
        options = [[p @ (reward + gamma * V) for p in row] for row in rows]
        better = [i for i, o in enumerate(options) if max(o) > o[picks[i]] + 1e-11]
        if not better:
            return V, options
        for i in better:
            picks[i] = int(np.argmax(options[i]))


def compare(product, left, V, options):
    """`left` has every choice that loses nothing by the oracle, and none that clearly loses."""
    start = product.model.choice_start
    n_q = product.automaton.n_states
    for i, values in enumerate(options):
        s, q = divmod(i, n_q)
        for c, value in enumerate(values):
            loses = V[i] - value
            if loses > CLEAR:
                assert not left[start[s] + c, q]
            if loses < 1e-10:
                assert left[start[s] + c, q]


@given(flagged(equal=False))
@settings(max_examples=many(50))
def test_choices_left_are_those_of_policy_iteration(product):
    reward = np.tile(chi_of(product), product.model.n_states)
    left, reached, sweeps = _discounted(product, GAMMA, 1e-9, None)
    assert 0 <= reached <= 1e-9
    assert sweeps <= 1 + np.log(1e-9 * (1 - GAMMA) / GAMMA / 2) / np.log(GAMMA) + 1
    compare(product, left, *policy_iteration(explicit(product), reward, GAMMA))


@given(flagged(), st.sampled_from([0.5, 0.9, 0.99]), st.sampled_from([0.9, 0.1, 1e-3]))
@settings(max_examples=many(60))
def test_stopping_early_never_drops_an_optimal_choice(product, gamma, tolerance):
    left, reached, _ = _discounted(product, gamma, tolerance, None)
    assert reached <= tolerance
    V, options = policy_iteration(explicit(product), np.tile(chi_of(product), product.model.n_states), gamma)
    for i, values in enumerate(options):
        s, q = divmod(i, product.automaton.n_states)
        for c, value in enumerate(values, start=product.model.choice_start[s]):
            if V[i] - value < 1e-10:
                assert left[c, q]
            if V[i] - value > 2 * tolerance:
                assert not left[c, q]


def test_a_late_reward_is_not_dropped_when_iteration_stops_before_it_is_seen():
    """Early: A with 0.001 a step, ten steps long. Late: nothing for 14 steps, then A with 0.002 a step for ever.

    A chain that leads to A keeps the iteration going until the early way has gathered more than one sweep's span.
    """
    m, small = 12, 1e-3
    early, late, chain = range(1, m), range(m, m + 14), range(m + 14, m + 22)
    rich, A, out, n = m + 22, m + 23, m + 24, m + 25
    go = np.zeros((2, n, n))
    go[0, 0, early[0]] = go[1, 0, late[0]] = 1
    for s in early:
        go[:, s, A], go[:, s, s + 1 if s + 1 in early else out] = small, 1 - small
    for s in late:
        go[:, s, s + 1 if s + 1 in late else rich] = 1
    for s in chain:
        go[:, s, s + 1 if s + 1 in chain else A] = 1
    go[:, rich, A], go[:, rich, rich] = 2 * small, 1 - 2 * small
    go[:, A, out] = go[:, out, out] = 1
    model = stl.MDP.from_arrays(go, {"x": np.arange(n)}, labels={"A": np.arange(n) == A})
    product = stl.build_product(model, stl.parse("F[0,2) F[0,1) A"), encoding="paper")
    coarse, _, sweeps = _discounted(product, 0.99, 0.6, None)
    fine, _, _ = _discounted(product, 0.99, 1e-9, None)
    assert sweeps < 14
    assert (fine[:2, 0].tolist(), coarse[:2, 0].tolist()) == ([False, True], [True, True])


@given(flagged(states=2, longest=1))
@settings(max_examples=many(30))
def test_the_optimum_is_that_of_all_stationary_policies(product):
    assume(product.n_states <= 8)
    rows, reward = explicit(product), np.tile(chi_of(product), product.model.n_states)
    every = [value_of(rows, picks, reward, GAMMA) for picks in itertools.product(*[range(len(r)) for r in rows])]
    best = np.max(every, axis=0)
    left, _, _ = _discounted(product, GAMMA, 1e-9, None)
    compare(product, left, best, [[p @ (reward + GAMMA * best) for p in row] for row in rows])


@given(flagged(), st.sampled_from(["published", "printed", "shifted"]))
@settings(max_examples=many(30))
def test_neither_scale_nor_outer_operator_moves_the_optimum(product, scale):
    """The learners' rewards, at every scale, leave the same choices."""
    reward = stl.PublishedNaive(scale=scale).start(Problem.of(product), None, None).table.reward
    left, _, _ = _discounted(product, GAMMA, 1e-9, None)
    compare(product, left, *policy_iteration(explicit(product), np.tile(reward, product.model.n_states), GAMMA))


def among(product, kept):
    """(least, greatest) P in Fractions over all policies of (t, s, q) with choices in kept(t, s, q)."""
    model, automaton = product.model, product.automaton
    rows = [oracles.choices(model, s) for s in range(model.n_states)]
    found = []
    for best in (min, max):

        def value(t, s, q, best=best):
            verdict = automaton.verdicts(t)[q]
            if verdict >= 0:
                return Fraction(int(verdict))
            return best(sum(p * value(t + 1, s2, product.enter(s2, q)) for s2, p in rows[s][c]) for c in kept(t, s, q))

        start = automaton.initial
        found.append(sum(p * value(0, s, product.enter(s, start)) for s, p in oracles.initial(model)))
    return found


TASKS = [
    "F[0,2) F[0,2) A", "F[0,3) G[0,2) A", "G[0,2) F[0,2) B", "G[0,2) (F[0,2) A & F[0,2) B)", "F[0,1) G[0,3) A",
    "F[0,2) (G[0,2) A | G[0,2) B)", "G[0,2) (F[0,3) A & F[0,2) B)", "F[0,2) (F[0,3) A & G[0,2) B)",
]  # fmt: skip


def random_product(seed, text):
    """Three states, two actions, shares in quarters: ties and clear losses both occur."""
    model = oracles.random_model(np.random.default_rng(seed), 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return stl.build_product(model, stl.parse(text), encoding="paper")


def close(result, exact):
    assert abs(Fraction(result.probability) - exact) < Fraction(1, 10**12)


@given(st.integers(0, 2**32 - 1), st.sampled_from([text for text in TASKS if "3)" not in text or "G[0,3)" in text]))
@settings(max_examples=many(60))
def test_the_range_is_that_of_all_policies_of_the_choices_left(seed, text):
    product = random_product(seed, text)
    assert product.automaton.exact
    result = stl.surrogate_optimum(product, gamma=GAMMA)
    left, _, _ = _discounted(product, GAMMA, 1e-9, None)
    start = product.model.choice_start

    def kept(t, s, q):
        return [c for c in range(start[s + 1] - start[s]) if left[start[s] + c, q]]

    least, greatest = among(product, kept)
    close(result.least, least)
    close(result.greatest, greatest)
    n_kept = [[len(kept(0, s, q)) for q in range(product.automaton.n_states)] for s in range(product.model.n_states)]
    assert np.allclose(result.policy.table.max(axis=2), 1 / np.array(n_kept))
    close(result.at_random, oracles.policy_value(product, result.policy))
    assert result.least.lower <= result.at_random.upper
    assert result.at_random.lower <= result.greatest.upper
    assert result.greatest.lower <= result.optimum.upper
    assert result.gap == result.optimum.probability - result.at_random.probability


@given(st.integers(0, 2**32 - 1), st.sampled_from([*TASKS, "G[0,3) (F[0,3) A & F[0,4) B)", "F[0,3) F[0,4) (A & !B)"]))
@settings(max_examples=many(40))
def test_where_every_choice_is_left_the_range_is_that_of_all_policies(seed, text):
    product = random_product(seed, text)
    every = _uniform(product, np.ones((product.model.n_choices, product.automaton.n_states), dtype=np.bool_))
    for maximize, engine in itertools.product((False, True), ("nodes", "words")):
        found = stl.check(product, _extreme(product, every, maximize, engine=engine))
        assert found.probability == pytest.approx(stl.check(product, maximize=maximize).probability, abs=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(40))
def test_only_choices_left_are_taken_and_the_best_of_them(seed, text):
    """Any choices left, by step: the extremes of all policies of these, in fractions, and by every engine."""
    product, rng = random_product(seed, text), np.random.default_rng(seed)
    weights = (
        rng.integers(2, size=(product.horizon, *product.shape, 2)) + np.eye(2)[rng.integers(2, size=product.shape)]
    )
    form = Table(weights / weights.sum(axis=-1, keepdims=True))
    extremes = among(product, lambda t, s, q: np.flatnonzero(form.row(t)[s, q]))
    for (maximize, exact), engine in itertools.product(enumerate(extremes), ("nodes", "words")):
        policy = _extreme(product, form, bool(maximize), engine=engine)
        close(stl.check(product, policy), exact)
        for t, pairs in enumerate(dense.reached(product, policy)):
            for s, q in pairs:
                assert form.row(t)[s, q][policy.row(t)[s, q]] > 0


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(30))
def test_engines_leave_the_same_choices_of_episodes(seed, text):
    product = random_product(seed, text)
    one, other = (_episode(product, Budget("choices"), engine)[0] for engine in ("nodes", "words"))
    for t in range(product.horizon):
        assert np.array_equal(one.row(t), other.row(t))


def shown(fragment, trace, length):
    """χ after every step, from what each window that ends there has seen."""
    held = []
    for t in range(length):
        seen = []
        for part in fragment.parts:
            window = [stl.satisfies(part.psi, trace, t=u) for u in range(max(0, t - part.tau + 1), t + 1)]
            seen.append(any(window) if part.operator == "F" else all(window) and len(window) == part.tau)
        held.append(fragment.combine(seen))
    return held


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@example(2, TASKS[-2])  # windows that count from the shortest one on would tell other policies here
@example(15, TASKS[-1])
@settings(max_examples=many(60))
def test_episodes_maximise_the_number_of_starts_where_the_inner_formula_holds(seed, text):
    """Whole histories in Fractions: first the number of starts, then P, judged by the formula itself."""
    product = random_product(seed, text)
    model, phi = product.model, product.formula
    fragment, length = check_fragment(phi), stl.horizon(phi) + 1
    first = max(part.tau for part in fragment.parts) - 1

    def count(history):
        trace = oracles.trace_of(model, history)
        held = shown(fragment, trace, length)[first:]
        if fragment.uniform:
            assert held == [stl.satisfies(fragment.body, trace, t=k) for k in range(fragment.T)]
        return Fraction(sum(held))

    def value(history):
        """(the greatest expected count, the least and the greatest P that go with it)"""
        if len(history) == length:
            p = Fraction(int(oracles.holds(model, phi, history)))
            return count(history), p, p
        options = []
        for row in oracles.choices(model, history[-1]):
            after = [(p, value((*history, s2))) for s2, p in row]
            options.append([sum(p * figures[i] for p, figures in after) for i in range(3)])
        most = max(option[0] for option in options)
        left = [option for option in options if option[0] == most]
        return most, min(option[1] for option in left), max(option[2] for option in left)

    result = stl.surrogate_optimum(product, "episode")
    starts = [(p, value((s,))) for s, p in oracles.initial(model)]
    close(result.least, sum(p * figures[1] for p, figures in starts))
    close(result.greatest, sum(p * figures[2] for p, figures in starts))
    assert result.policy.table.ndim == 4
    assert result.gamma is None
    assert result.sweeps == product.horizon


def sure_or_bold(p, steps):
    """From the start: `sure` is in A for one step; `bold` with probability p for so many, else never."""
    go = np.zeros((2, steps + 3, steps + 3))
    out = steps + 2
    go[0, 0, 1] = 1
    go[1, 0, [2, out]] = p, 1 - p
    for s in range(1, steps + 3):
        go[:, s, out if s in (1, steps + 1, out) else s + 1] = 1
    in_A = [0] + [1] * (steps + 1) + [0]
    model = stl.MDP.from_arrays(go, {"x": np.arange(steps + 3)}, labels={"A": in_A}, action_names=["sure", "bold"])
    return stl.build_product(model, stl.parse("F[0,4) F[0,1) A"))


@pytest.mark.parametrize("reading", ["discounted", "episode"])
def test_a_surrogate_that_counts_takes_the_bold_way(reading):
    """One start for sure against three with 0.6: the count says 1.8, the task says 0.6."""
    result = stl.surrogate_optimum(sure_or_bold(0.6, 3), reading)
    assert result.optimum.probability == 1
    for check in (result.at_random, result.least, result.greatest):
        assert check.probability == pytest.approx(0.6)
    assert result.gap == pytest.approx(0.4)
    assert result.status == "complete"


@pytest.mark.parametrize(("reading", "p"), [("discounted", 0.8 + 1e-8), ("episode", 0.5 + 1e-8)])
def test_a_small_advantage_is_no_tie(reading, p):
    result = stl.surrogate_optimum(sure_or_bold(p, 2), reading, gamma=0.25)
    assert result.greatest.probability == pytest.approx(p)


@pytest.mark.parametrize(("reading", "p"), [("discounted", 0.8), ("episode", 0.5)])
def test_ties_are_told(reading, p):
    """One start for sure is worth as much as two with 0.5, discounted by 0.25 as two with 0.8."""
    result = stl.surrogate_optimum(sure_or_bold(p, 2), reading, gamma=0.25)
    assert result.greatest.probability == result.optimum.probability == 1
    assert result.least.probability == pytest.approx(p)
    assert result.at_random.probability == pytest.approx((1 + p) / 2)
    assert (result.policy.row(0)[0] == 0.5).all()


def test_flags_that_are_not_the_formula_are_judged_by_the_formula(floor5):
    """Different windows: the surrogate follows the paper's flags, P is the task's own."""
    phi = stl.parse("F[0,6) (F[0,4) A & G[0,2) A)")
    exact = stl.build_product(floor5, phi)
    with pytest.warns(match="only approximates"):
        flags = stl.build_product(floor5, phi, encoding="paper")
    for reading in ("discounted", "episode"):
        ours, theirs = (stl.surrogate_optimum(product, reading) for product in (exact, flags))
        assert ours.product.automaton.exact
        assert theirs.product.automaton.exact
        assert theirs.at_random.probability == pytest.approx(ours.at_random.probability, abs=1e-12)
        assert ours.policy.home.automaton.encoding == "paper"
        assert ours.optimum.probability == pytest.approx(stl.check(exact).probability, abs=1e-12)
        assert ours.least.lower <= ours.at_random.upper
        assert ours.greatest.lower <= ours.optimum.upper
        assert stl.check(exact, ours.policy).probability == pytest.approx(ours.at_random.probability, abs=1e-12)


SCENARIOS = [
    ("reaching", 5, 10, 5), ("charging", 10, 10, 10), ("patrolling", 5, 10, 10), ("patrolling", 10, 10, 10),
]  # fmt: skip


@pytest.mark.parametrize(("task", "n", "T", "tau"), SCENARIOS)
def test_on_the_papers_floors_the_surrogate_is_not_what_holds_learning_back(floor5, floor10, task, n, T, tau):
    task = stl.load_task(FACTORY / f"{task}.stl", params={"T": T, "tau": tau})
    product = stl.build_product(floor5 if n == 5 else floor10, task)
    for reading in ("discounted", "episode"):
        result = stl.surrogate_optimum(product, reading)
        assert -1e-12 < result.gap < 1e-4
        assert result.optimum.probability - result.least.probability < 1e-4
        assert result.product.task_name == task.name


def test_tolerances_that_rounding_does_not_allow_are_said(patrolling):
    result = stl.surrogate_optimum(patrolling, tolerance=1e-16)
    assert result.status.startswith("limited by rounding: choices that lose up to ")
    assert 1e-16 < result.tolerance < 1e-8


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"reading": "published"}, "reading is 'published'; choose discounted or episode"),
        ({"gamma": 1.0}, "gamma is 1.0; it must be between 0 and 1, both excluded"),
        ({"gamma": 0.0}, "gamma is 0.0"),
        ({"gamma": float("nan")}, "gamma is nan"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
    ],
)
def test_impossible_settings_are_refused(patrolling, arguments, says):
    with pytest.raises(SettingsError, match=says):
        stl.surrogate_optimum(patrolling, **arguments)


def test_tasks_without_flags_and_sizes_that_do_not_fit_are_refused(floor5, patrolling):
    with pytest.raises(FragmentError, match="until"):
        stl.surrogate_optimum(stl.build_product(floor5, stl.parse("F[0,3) (A U[0,2) B)")))
    with pytest.raises(SizeError, match="value iteration on 648 product states"):
        stl.surrogate_optimum(patrolling, memory_limit=1000)
    with pytest.raises(SizeError, match="value iteration of"):
        stl.surrogate_optimum(patrolling, gamma=1 - 1e-12)


@given(interval_mdps(states=2))
@settings(max_examples=many(5))
def test_intervals_are_refused(model):
    with pytest.raises(SettingsError, match="intervals"):
        stl.surrogate_optimum(stl.build_product(model, stl.parse("F[0,2) F[0,2) a")))
