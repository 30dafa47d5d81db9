"""`guarantee` against its spelled-out twin, on data gathered adaptively, and against what it must never read."""

import itertools
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

import stltool as stl
from stltool.automata import FALSE, TRUE
from stltool.errors import PolicyError, SettingsError, SizeError
from stltool.learning.confidence import entry_interval, unseen_mass
from stltool.learning.counts import Counts
from stltool.models.environment import simulator
from stltool.product import with_outcome
from stltool.testing import formulas, interval_mdps, mdps
from tests import oracles
from tests.checking.test_check import random_policy
from tests.conftest import many
from tests.learning.test_planner import early

SUPPORTS = ("unknown", "known")


def counts_of(model, rows):
    """Counts from (choice, successor, how often)."""
    counts = Counts(model.n_choices, model.n_states)
    seen = sorted((int(choice) * model.n_states + int(target), int(n)) for choice, target, n in rows if n)
    codes, numbers = np.array(seen, dtype=np.int64).reshape(-1, 2).T
    counts.restore({"codes": codes, "contexts": np.zeros_like(codes), "seen": numbers})
    return counts


def sampled(model, rng, tries):
    """Every choice c tried tries[c] times."""
    rows = []
    for c, (a, b) in enumerate(itertools.pairwise(model.row_start.tolist())):
        seen = rng.multinomial(tries[c], model.probability[a:b] / model.probability[a:b].sum())
        rows += [(c, int(s), int(n)) for s, n in zip(model.target[a:b], seen, strict=True)]
    return counts_of(model, rows)


def explored(product, rng, episodes, done=lambda counts: False):
    """Data gathered adaptively: least tried choices where states are new, then where they led to successes.

    Stops, too, when `done` says so of the data.
    """
    model = product.model
    env, counts = simulator(model, rng), Counts(model.n_choices, model.n_states)
    tries, good = np.zeros(model.n_choices), np.zeros(model.n_choices)
    for _ in range(episodes):
        s, taken = env.reset(), []
        q = product.enter(s, product.automaton.initial)
        for _ in range(product.horizon):
            options = slice(model.choice_start[s], model.choice_start[s + 1])
            value = good[options] / np.maximum(tries[options], 1) + 1 / np.sqrt(1 + tries[options])
            i = int(rng.integers(len(value))) if rng.random() < 0.2 else int(value.argmax())
            c = int(model.choice_start[s]) + i
            s = env.step(i)
            q = product.enter(s, q)
            counts.add(np.array([c]), np.array([s]))
            tries[c] += 1
            taken.append(c)
        good[taken] += product.automaton.verdicts(product.horizon)[q] == TRUE
        if done(counts):
            break
    return counts


# ------------------------------------------------------------------------------------------------ the slow twin


def polytopes(model, counts, alpha, support):
    """For each choice its successors (None: failure) and nature's corners, from intervals spelled out one by one."""
    S, M = model.n_states, model.n_choices
    table = np.zeros((M, S), dtype=int)
    table[counts.choice, counts.target] = counts.seen
    graph = [sorted(set(model.target[a:b].tolist())) for a, b in itertools.pairwise(model.row_start.tolist())]
    needed = {1: 0, 2: 1}
    if support == "known":
        level = math.log(max(sum(needed.get(len(row), len(row)) for row in graph), 1) / alpha)
    else:
        level = math.log(max(M * needed.get(S, S), 1) / (alpha / 2))
    found = []
    for c in range(M):
        n = int(table[c].sum())
        targets = graph[c] if support == "known" else np.flatnonzero(table[c]).tolist()
        ends = []
        for s in targets:
            (lower,), (upper,) = entry_interval(table[c, [s]], np.array([n]), level)
            sure = len(graph[c]) == 1 if support == "known" else S == 1
            ends.append((Fraction(1 if sure else float(lower)), Fraction(float(upper))))
        if support == "unknown" and len(targets) < S:
            lost = unseen_mass(np.array([len(targets)]), np.array([n]), S, math.log(M / (alpha / 2)))
            targets, ends = [*targets, None], [*ends, (Fraction(0), Fraction(float(lost[0])))]
        found.append((targets, oracles.vertices(ends)))
    return found


def robust_value(product, rows, policy=None):
    """Backward over (s, q) in fractions; a policy's value, or the best."""
    model, automaton = product.model, product.automaton

    def decided(t, q):
        verdict = automaton.verdicts(t)[q]
        return None if verdict < 0 else Fraction(int(verdict))

    def value(t, s, q):
        if s is None:
            return Fraction(0)
        if decided(t, q) is not None:
            return decided(t, q)
        first, last = model.choice_start[s], model.choice_start[s + 1]
        options = []
        for i, (targets, corners) in enumerate(rows[first:last]):
            weight = Fraction(1)
            if policy is not None:
                entry = policy.row(t)[s, q]
                weight = Fraction(int(i == entry)) if policy.deterministic else Fraction(float(entry[i]))
            if weight:
                after = [value(t + 1, s2, product.enter(s2, q) if s2 is not None else q) for s2 in targets]
                options.append(weight * min(sum(p * v for p, v in zip(c, after, strict=True)) for c in corners))
        return max(options) if policy is None else sum(options)

    start = automaton.initial
    return sum((p * value(0, s, product.enter(s, start)) for s, p in oracles.initial(model)), Fraction(0))


@st.composite
def cases(draw):
    model = draw(mdps(signals=()))
    phi = draw(formulas(signals=(), longest=2, max_leaves=4))
    assume(1 <= stl.horizon(phi) <= 3)
    product = stl.build_product(model, phi)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    tries = rng.choice([0, 1, 5, 40, 3000], model.n_choices)
    return product, sampled(model, rng, tries), rng


@given(cases(), st.sampled_from(SUPPORTS), st.sampled_from([0.01, 0.5, 0.99]), st.booleans(), st.booleans())
@settings(max_examples=many(40))
def test_the_bound_is_its_equation(case, support, confidence, timed, mixed):
    product, counts, rng = case
    rows = polytopes(product.model, counts, 1 - confidence, support)
    policy = random_policy(product, rng, timed, mixed)
    for given_policy in (policy, None):
        found = stl.guarantee(product, given_policy, counts, confidence=confidence, support=support)
        exact = robust_value(early(product), rows, given_policy)
        assert exact - Fraction(1, 10**9) <= found.lower <= exact + Fraction(1, 10**12)
    # the best policy for the guarantee has it
    again = stl.guarantee(product, found.policy, counts, confidence=confidence, support=support)
    assert again.lower == pytest.approx(found.lower, abs=1e-12)
    assert (found.transitions, found.choices) == (int(counts.seen.sum()), product.model.n_choices)
    assert found.never_tried == sum(n == 0 for n in counts.visits.tolist())


@given(cases(), st.integers(0, 2**32 - 1))
@settings(max_examples=many(30))
def test_the_models_probabilities_are_never_read(case, seed):
    product, counts, rng = case
    model, policy = product.model, random_policy(product, rng, timed=True, mixed=False)
    other = np.random.default_rng(seed)
    weight = other.random(model.n_transitions) + 0.01
    total = np.add.reduceat(weight, model.row_start[:-1])
    scrambled = model.with_rows(probability=weight / np.repeat(total, np.diff(model.row_start)), exact=None)
    strange = stl.Product(scrambled, product.automaton, product.letter)
    # another graph, too: every choice leads to state 0
    lost = scrambled.with_rows(
        row_start=np.arange(model.n_choices + 1), target=np.zeros(model.n_choices, dtype=np.int32),
        probability=np.ones(model.n_choices),
    )  # fmt: skip
    without = stl.Product(lost, product.automaton, product.letter)
    for home, supports in ((strange, SUPPORTS), (without, ("unknown",))):
        for support in supports:
            for table in (policy.table, None):
                here = stl.guarantee(product, policy if table is not None else None, counts, support=support)
                there = stl.guarantee(home, stl.Policy(home, table) if table is not None else None, counts,
                                      support=support)  # fmt: skip
                assert here.lower == there.lower
                assert (here.policy.table == there.policy.table).all()


# ------------------------------------------------------------------------------------------------ laws


def test_without_data_nothing_is_guaranteed(patrolling):
    model = patrolling.model
    empty = Counts(model.n_choices, model.n_states)
    policy = stl.check(patrolling).policy
    for given_policy, support in itertools.product((policy, None), SUPPORTS):
        found = stl.guarantee(patrolling, given_policy, empty, support=support)
        assert (found.lower, found.transitions, found.never_tried) == (0, 0, model.n_choices)
    decided = stl.build_product(model, stl.parse("F[0,3] (A | !A)"))
    assert stl.guarantee(decided, None, empty).lower == pytest.approx(1, abs=1e-12)  # by the first state
    now = stl.build_product(model, stl.parse("!A"))
    assert now.horizon == 0
    assert stl.guarantee(now, None, empty).lower == pytest.approx(1, abs=1e-12)


def test_a_known_graph_without_choice_is_a_guarantee():
    walk = stl.MDP.from_arrays([[[0, 1, 0], [0, 0, 1], [0, 0, 1]]], {}, labels={"goal": [0, 0, 1]})
    product = stl.build_product(walk, stl.parse("F[0,2] goal"))
    empty = Counts(3, 3)
    assert stl.guarantee(product, None, empty, support="known").lower == pytest.approx(1, abs=1e-12)
    assert stl.guarantee(product, None, empty).lower == 0


@given(cases(), st.sampled_from(SUPPORTS))
@settings(max_examples=many(30))
def test_bounds_grow_with_data_and_shrink_with_confidence(case, support):
    product, counts, _ = case
    rows = list(zip(counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist(), strict=True))
    more = counts_of(product.model, [(c, s, 7 * n) for c, s, n in rows])
    lowers = [
        stl.guarantee(product, None, data, confidence=confidence, support=support).lower
        for data, confidence in ((counts, 0.999), (counts, 0.9), (counts, 0.1), (more, 0.1))
    ]
    assert all(low <= high + 1e-12 for low, high in itertools.pairwise(lowers))
    known, unknown = (stl.guarantee(product, None, counts, support=which).lower for which in ("known", "unknown"))
    assert known >= unknown - 1e-12


def test_bounds_approach_the_optimum(patrolling):
    model = patrolling.model
    counts = sampled(model, np.random.default_rng(0), np.full(model.n_choices, 10**8))
    best = stl.check(patrolling)
    for support in SUPPORTS:
        found = stl.guarantee(patrolling, None, counts, support=support)
        assert best.probability - 0.01 < found.lower < best.probability
        assert stl.check(patrolling, found.policy).probability > best.probability - 1e-3


# ------------------------------------------------------------------------------------------------ calibration


def coin(p):
    """One choice that matters, with two successors: the guarantee is one interval's lower end."""
    model = stl.MDP.from_arrays([[[0, p, 1 - p], [0, 1, 0], [0, 0, 1]]], {}, labels={"win": [0, 1, 0]})
    return stl.build_product(model, stl.parse("F[0,1] win"))


@pytest.mark.soak
@pytest.mark.parametrize("alpha", [0.5, 0.2])
def test_an_adversary_who_stops_at_the_worst_time_wins_no_more_often_than_stated(alpha):
    """Stops as soon as the bound is wrong, knowing the truth. It wins now and then: the test is a sharp one."""
    p, runs, longest = 0.6, many(1000), 200
    product = coin(p)
    policy = stl.Policy(product, np.zeros(product.shape, dtype=int))
    rng = np.random.default_rng(7)
    n = np.arange(1, longest + 1)
    wins = 0
    sums = (rng.random((runs, longest)) < p).cumsum(axis=1)
    lowers = entry_interval(sums.ravel(), np.tile(n, runs), -math.log(alpha))[0].reshape(runs, longest)
    for k, lower in zip(sums, lowers, strict=True):
        stop = int((lower > p).argmax()) if (lower > p).any() else longest - 1
        if lower[stop] > p:  # asked of the real one
            counts = counts_of(product.model, [(0, 1, int(k[stop])), (0, 2, int(n[stop] - k[stop]))])
            found = stl.guarantee(product, policy, counts, confidence=1 - alpha, support="known")
            wins += found.lower > p
    assert binomtest(wins, runs, alpha, alternative="greater").pvalue > 1e-3
    assert wins > 0.02 * runs


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("support", SUPPORTS)
def test_bounds_from_adaptive_data_hold_as_often_as_stated(support):
    """Explored greedily, stopped when the bound looks good, the policy chosen from the data; confidence 0.5."""
    rng = np.random.default_rng(3)
    wrong = positive = runs = 0
    for _ in range(many(60)):
        model = oracles.random_model(rng, 8)
        product = stl.build_product(model, stl.parse("F[0,2] A"))
        good = float(rng.random())

        def done(counts, product=product, good=good):
            n = int(counts.seen.sum())
            every = n % 64 == 0
            return every and stl.guarantee(product, None, counts, confidence=0.5, support=support).lower > good

        counts = explored(product, rng, 200, done)
        found = stl.guarantee(product, None, counts, confidence=0.5, support=support)
        truth = stl.check(product, found.policy)
        wrong += found.lower > truth.upper
        positive += found.lower > 0.1
        runs += 1
    assert binomtest(wrong, runs, 0.5, alternative="greater").pvalue > 1e-3
    assert positive > runs / 2


# ------------------------------------------------------------------------------------------------ policies and input


def test_policies_of_every_kind_are_judged(patrolling, flagged):
    counts = explored(patrolling, np.random.default_rng(0), 400)
    best = stl.check(patrolling).policy
    one = stl.guarantee(patrolling, best, counts, support="known")
    assert 0 < one.lower < stl.check(patrolling).probability
    assert one.policy is best
    weights = np.zeros((*best.table.shape, 9))
    np.put_along_axis(weights, np.maximum(best.table, 0)[..., None].astype(int), 1.0, axis=-1)
    mixed = stl.Policy(patrolling, weights)
    assert stl.guarantee(patrolling, mixed, counts, support="known").lower == pytest.approx(one.lower, abs=1e-12)
    with_flags = stl.check(flagged).policy  # remembers another way: judged on the join
    assert stl.guarantee(patrolling, with_flags, counts, support="known").lower == pytest.approx(one.lower, rel=0.2)
    somewhen = (best.table != 0).argmax(axis=0)  # a step at which the choice matters
    stationary = stl.Policy(patrolling, np.take_along_axis(best.table, somewhen[None], axis=0)[0])
    assert stl.guarantee(patrolling, stationary, counts).lower < stl.check(patrolling, stationary).upper
    joint = stl.build_joint_product(patrolling.model, {"a": patrolling.formula, "b": stl.parse("F[0,3] B")})
    table = np.zeros(joint.shape, dtype=int)
    found = stl.guarantee(patrolling, stl.Policy(joint, table), counts)
    assert found.lower <= stl.check(patrolling, stl.Policy(joint, table)).upper


@given(interval_mdps(states=3), st.integers(0, 99))
@settings(max_examples=many(20))
def test_models_with_intervals_lend_their_graph(model, seed):
    product = stl.build_product(model, stl.parse("F[0,2] a"))
    rng = np.random.default_rng(seed)
    counts = sampled(model.nominal(), rng, np.full(model.n_choices, 50))
    exact = robust_value(product, polytopes(model, counts, 0.01, "known"))
    assert stl.guarantee(product, None, counts, support="known").lower == pytest.approx(float(exact), abs=1e-9)


def test_statements_round_down_and_say_what_they_rest_on(patrolling):
    counts = explored(patrolling, np.random.default_rng(0), 50)
    found = replace(stl.guarantee(patrolling, None, counts, confidence=0.95), lower=0.12345678)
    assert found.statement == (
        "with confidence 95 % the probability is at least 0.123456, from 400 transitions seen while learning; "
        "assumed: nothing about the transitions"
    )
    assert "possible successors are known" in replace(found, support="known").statement


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"confidence": 1}, "confidence is 1; give a number between 0 and 1"),
        ({"confidence": 0.0}, "confidence is 0.0"),
        ({"confidence": float("nan")}, "confidence is nan; a finite number is needed"),
        ({"support": "graph"}, "support is 'graph'; choose unknown or known"),
    ],
)
def test_settings_out_of_range_are_refused(patrolling, options, says):
    counts = Counts(patrolling.model.n_choices, patrolling.model.n_states)
    with pytest.raises(SettingsError, match=says):
        stl.guarantee(patrolling, None, counts, **options)


def test_what_does_not_belong_together_is_refused(patrolling, floor10):
    model = patrolling.model
    counts = Counts(model.n_choices, model.n_states)
    with pytest.raises(SettingsError, match=r"the counts are of 3 choices and 2 states, the model has 162 and 18"):
        stl.guarantee(patrolling, None, Counts(3, 2))
    other = stl.build_product(floor10, patrolling.formula)
    with pytest.raises(PolicyError, match="is for the model"):
        stl.guarantee(patrolling, stl.check(other).policy, counts)
    another = stl.build_product(model, stl.parse("F[0,2] A"))
    with pytest.raises(PolicyError, match="is for the task"):
        stl.guarantee(patrolling, stl.check(another).policy, counts)
    silent = stl.Policy(patrolling, np.full(patrolling.shape, -1))
    with pytest.raises(PolicyError, match=r"the policy defines no action at step 0, state \(1,0\)"):
        stl.guarantee(patrolling, silent, counts)
    with pytest.raises(SizeError, match="checking 513 product states would take"):
        stl.guarantee(patrolling, silent, counts, memory_limit=10)


def test_transitions_that_the_graph_excludes_are_told(patrolling):
    model = patrolling.model
    far = int(np.setdiff1d(np.arange(model.n_states), model.target[: model.row_start[1]])[-1])
    counts = counts_of(model, [(0, far, 3)])
    with pytest.raises(SettingsError, match=rf"{'state'} .*: it was seen to lead to state .* graph excludes"):
        stl.guarantee(patrolling, None, counts, support="known")
    assert stl.guarantee(patrolling, None, counts).lower == 0


def test_a_black_box_needs_no_rows_but_a_start(patrolling):
    """Of a model without rows and without a start, only states and choices are read."""
    model = patrolling.model
    box = stl.MDP.black_box(
        model.n_states, model.action_names, lambda rng: simulator(model, rng), signals=model.signals,
        labels=model.labels,
    )  # fmt: skip
    product = stl.build_product(box, patrolling.formula)
    counts = explored(patrolling, np.random.default_rng(0), 3000)
    first = int(np.flatnonzero(model.initial)[0])
    table = stl.check(patrolling).policy.table
    for chosen in (table, None):
        here = stl.guarantee(product, stl.Policy(product, table) if chosen is not None else None, counts, start=first)
        there = stl.guarantee(patrolling, stl.Policy(patrolling, table) if chosen is not None else None, counts)
        assert here.lower == there.lower > 0.001
    with pytest.raises(SettingsError, match="does not say where runs start"):
        stl.guarantee(product, None, counts)
    with pytest.raises(SettingsError, match="the model does not say where this leads; use support='unknown'"):
        stl.guarantee(product, None, counts, start=first, support="known")
    for wrong in (-1, model.n_states, 0.5, "A"):
        with pytest.raises(SettingsError, match="start is"):
            stl.guarantee(product, None, counts, start=wrong)


# ------------------------------------------------------------------------------------------------ with_outcome


@given(formulas(signals=(), longest=2, max_leaves=5), st.sampled_from([FALSE, TRUE]), st.data())
@settings(max_examples=many(40))
def test_the_outcome_decides_what_is_undecided(phi, verdict, data):
    model = stl.MDP.from_arrays(
        [np.full((5, 5), 0.2)], {}, labels={"a": [0, 0, 1, 1, 0], "b": [0, 1, 0, 1, 0], "c": [0, 0, 0, 1, 1]}
    )
    product = stl.build_product(model, phi)
    leaky = stl.MDP.from_arrays([np.full((6, 6), 1 / 6)], {})
    extended = with_outcome(product, leaky, verdict)
    assert extended.shape == (6, product.shape[1] + 1)
    automaton = early(product).automaton
    states = data.draw(st.lists(st.integers(0, 5), min_size=product.horizon + 1, max_size=product.horizon + 1))
    judged = extended.automaton.judge(extended.letter[states].tolist())
    if 5 in states:
        before = automaton.judge(product.letter[states[: states.index(5)]].tolist())
        assert judged == (before or (verdict == TRUE, states.index(5)))
    else:
        assert judged == automaton.judge(product.letter[states].tolist())


@pytest.mark.parametrize("support", ["known", "unknown"])
@pytest.mark.parametrize(("text", "share"), [("F[0,2] !A", 0.5), ("A | !A", 1.0), ("F[0,1] (A & !A)", 0.0), ("A", 0.5)])
def test_what_the_first_state_decides_needs_no_data(support, text, share):
    """Half of the runs begin in A; nothing was ever tried."""
    model = stl.MDP.from_arrays([np.eye(2)], {"x": [0, 1]}, initial=[0.5, 0.5], labels={"A": [1, 0]})
    product = stl.build_product(model, stl.parse(text))
    counts = Counts(2, 2)
    policy = stl.learn(product, episodes=1).policy
    for chosen in (policy, None):
        found = stl.guarantee(product, chosen, counts, support=support).lower
        assert share - 1e-12 <= found <= share
        assert found == share or 0 < share < 1
