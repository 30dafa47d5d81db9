"""`likely_runs` against the enumeration of all runs in fractions, and against networkx."""

import itertools
import math
from fractions import Fraction

import networkx as nx
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.errors import PolicyError, SettingsError, SizeError
from tests import oracles
from tests.checking.test_check import products, random_policy
from tests.conftest import many

ALL = 10**6


def weights(product, policy, s, q, t):
    """(action name, weight, row) of every choice that the policy takes, in fractions."""
    model, entry = product.model, policy.row(t)[s, q]
    for i, row in enumerate(oracles.choices(model, s)):
        w = Fraction(int(i == entry)) if policy.deterministic else Fraction(float(entry[i]))
        if w:
            yield model.action_names[model.choice_action[model.choice_start[s] + i]], w, row


def all_runs(product, policy):
    """Every run of positive probability up to its verdict: (probability, states, actions, satisfied)."""
    automaton, found = product.automaton, []

    def walk(p, states, actions, q):
        verdict = automaton.verdicts(len(actions))[q]
        if verdict != UNDECIDED:
            found.append((p, states, actions, bool(verdict == TRUE)))
            return
        for action, w, row in weights(product, policy, states[-1], q, len(actions)):
            for s2, p2 in row:
                walk(p * w * p2, (*states, s2), (*actions, action), product.enter(s2, q))

    for s, p in oracles.initial(product.model):
        walk(p, (s,), (), product.enter(s, automaton.initial))
    return found


@st.composite
def cases(draw):
    product = draw(products())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    policy = random_policy(product, rng, timed=draw(st.booleans()), mixed=draw(st.booleans()))
    return product, policy, draw(st.booleans())


def close(value, exact):
    assert value == pytest.approx(float(exact), rel=1e-12, abs=0)


@given(cases(), st.integers(1, 12))
@settings(max_examples=many(60))
def test_runs_equal_the_enumeration(case, count):
    """The probabilities in order, every run one of those there are, the totals, and what is left to find."""
    product, policy, satisfied = case
    runs = {(states, actions): p for p, states, actions, verdict in all_runs(product, policy) if verdict == satisfied}
    result = stl.likely_runs(product, policy, satisfied=satisfied, count=count)
    close(result.probability, sum(runs.values()))
    assert result.exhausted == (len(runs) <= count)
    assert len(result.runs) == min(count, len(runs))
    assert len({(run.states, run.actions) for run in result.runs}) == len(result.runs)
    for run, p in zip(result.runs, sorted(runs.values(), reverse=True), strict=False):
        close(run.probability, runs[run.states, run.actions])
        close(run.probability, p)  # of ties any
        assert run.log_probability == pytest.approx(math.log(p), abs=1e-12)
        assert (run.satisfied, run.step) == (satisfied, len(run.states) - 1)
        q = product.automaton.initial
        for s, memory in zip(run.states, run.memory, strict=True):
            q = product.enter(s, q)
            assert memory == product.automaton.describe(q)
    logs = [run.log_probability for run in result.runs]
    assert logs == sorted(logs, reverse=True)
    assert result.mass == pytest.approx(sum(run.probability for run in result.runs), rel=1e-12)
    if runs:
        assert result.covered == pytest.approx(result.mass / result.probability, rel=1e-12)


@given(cases())
@settings(max_examples=many(40))
def test_engines_find_the_same_to_the_bit(case):
    product, policy, satisfied = case
    nodes, words = (
        stl.likely_runs(product, policy, satisfied=satisfied, count=20, engine=engine) for engine in ("nodes", "words")
    )
    assert nodes.runs == words.runs
    assert (nodes.probability, nodes.exhausted) == (words.probability, words.exhausted)


@pytest.mark.parametrize("engine", ["nodes", "words"])
def test_steps_that_repeat_share_their_values(engine):
    """Of half a million steps a few hundred differ: after so many the goal is reached but for what doubles tell."""
    product = stl.build_product(line(0.25), stl.parse("F[0,500000] goal"))
    result = stl.likely_runs(product, satisfied=True, count=3, engine=engine)
    assert [(run.step, run.probability) for run in result.runs] == [(1, 0.25), (2, 0.1875), (3, 0.140625)]
    assert result.probability == pytest.approx(1, abs=1e-12)


@given(cases())
@settings(max_examples=many(30))
def test_all_runs_together_are_the_verdict(case):
    """Every full history that violates (satisfies) the formula begins with exactly one of them; they add up to P."""
    product, policy, satisfied = case
    result = stl.likely_runs(product, policy, satisfied=satisfied, count=ALL)
    p = stl.check(product, policy).probability
    assert result.probability == pytest.approx(p if satisfied else 1 - p, abs=1e-12)
    assert (result.exhausted, result.covered, result.status) == (True, 1.0, "complete")
    assert result.mass == pytest.approx(result.probability, rel=1e-12)
    prefixes = {(run.states, run.actions) for run in result.runs}
    length = product.horizon + 1

    def walk(states, actions, q):
        if len(states) == length:
            begun = sum((states[:n], actions[: n - 1]) in prefixes for n in range(1, length + 1))
            assert begun == (oracles.holds(product.model, product.formula, states) == satisfied)
            return
        for action, _, row in weights(product, policy, states[-1], q, len(actions)):
            for s2, _ in row:
                walk((*states, s2), (*actions, action), product.enter(s2, q))

    model = product.model
    assume(model.n_states**length * np.diff(model.choice_start).max() ** product.horizon < 20_000)
    for s, _ in oracles.initial(model):
        walk((s,), (), product.enter(s, product.automaton.initial))


@given(cases(), st.fractions(0, 1, max_denominator=64).filter(bool))
@settings(max_examples=many(30))
def test_a_masss_set_is_smallest(case, mass):
    """No smaller set of runs, of all sets, has the mass; and the set has it."""
    product, policy, satisfied = case
    runs = [p for p, _, _, verdict in all_runs(product, policy) if verdict == satisfied]
    assume(runs)
    result = stl.likely_runs(product, policy, satisfied=satisfied, mass=float(mass))
    goal, slack = mass * sum(runs), Fraction(1, 10**11) * sum(runs)
    n = len(result.runs)
    assert Fraction(result.mass) >= goal - slack
    assert result.covered >= float(mass) - 1e-11
    assert result.status == "complete"
    if len(runs) <= 10:  # literally
        assert all(sum(some) < goal for some in itertools.combinations(runs, n - 1))
    else:
        assert sum(sorted(runs, reverse=True)[: n - 1]) < goal


@pytest.mark.parametrize(("mass", "n"), [(0.3, 1), (0.5, 1), (0.51, 2), (0.9, 2), (0.901, 3), (1.0, 3)])
def test_a_mass_that_a_set_has_exactly(mass, n):
    """0.5, 0.4, 0.1: rounding neither adds a run nor spares one; several first states."""
    model = stl.MDP.from_arrays([np.eye(3)], {"x": [0, 1, 2]}, initial=[0.1, 0.5, 0.4])
    result = stl.likely_runs(stl.build_product(model, stl.parse("x < 5")), satisfied=True, mass=mass)
    assert [run.states for run in result.runs] == [(1,), (2,), (0,)][:n]


@given(cases())
@settings(max_examples=many(30))
def test_certain_is_where_no_other_verdict_is_left(case):
    product, policy, satisfied = case
    every = all_runs(product, policy)
    for run in stl.likely_runs(product, policy, satisfied=satisfied, count=5).runs:
        for n in range(len(run.states)):
            verdicts = {v for _, s, a, v in every if (s[: n + 1], a[:n]) == (run.states[: n + 1], run.actions[:n])}
            assert (verdicts == {satisfied}) == (n >= run.certain)


def test_of_equally_probable_runs_the_shorter_comes_first():
    rows = [[0, 0.5, 0.5, 0], [0, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]
    model = stl.MDP.from_arrays([rows], {"x": range(4)}, labels={"A": [0, 0, 1, 1]})
    result = stl.likely_runs(stl.build_product(model, stl.parse("F[0,2] A")), satisfied=True)
    assert [run.states for run in result.runs] == [(0, 2), (0, 1, 3)]


@pytest.mark.soak(only=True)
def test_networkx_finds_the_same(patrolling):
    """On the floor, under a policy that draws its actions: the 200 best paths of the graph of all (t, s, q, action)."""
    policy = random_policy(patrolling, np.random.default_rng(3), timed=True, mixed=True)
    graph, automaton = nx.DiGraph(), patrolling.automaton
    ((first, _),) = oracles.initial(patrolling.model)
    layer = {(first, patrolling.enter(first, automaton.initial))}
    for t in range(patrolling.horizon + 1):
        following = set()
        for s, q in layer:
            verdict = automaton.verdicts(t)[q]
            if verdict != UNDECIDED:
                if verdict != TRUE:
                    graph.add_edge((t, s, q), "violated", length=0.0)
                continue
            for action, w, row in weights(patrolling, policy, s, q, t):
                for s2, p in row:
                    after = s2, patrolling.enter(s2, q)
                    graph.add_edge((t, s, q), (t, s, q, action), length=-math.log(w))
                    graph.add_edge((t, s, q, action), (t + 1, *after), length=-math.log(p))
                    following.add(after)
        layer = following
    start = (0, first, patrolling.enter(first, automaton.initial))
    paths = itertools.islice(nx.shortest_simple_paths(graph, start, "violated", weight="length"), 200)
    lengths = [nx.path_weight(graph, path, "length") for path in paths]
    result = stl.likely_runs(patrolling, policy, count=200)
    assert [run.log_probability for run in result.runs] == pytest.approx([-length for length in lengths], abs=1e-9)


def test_the_optimal_policy_is_the_default(patrolling):
    best = stl.check(patrolling)
    result = stl.likely_runs(patrolling)
    assert result.runs == stl.likely_runs(patrolling, best.policy).runs
    assert result.probability == pytest.approx(1 - best.probability, abs=1e-12)
    first = result.runs[0]  # two slips that hold the robot at its start: from the first on A and B cannot both be met
    assert set(first.states) == {int(patrolling.model.initial.argmax())}
    assert first.probability == pytest.approx(0.07 * 2 / 3)
    assert (first.certain, first.step, first.satisfied) == (1, 4, False)


def test_a_policy_with_other_memory_is_judged_on_the_join(patrolling, flagged):
    policy = stl.check(flagged).policy
    result = stl.likely_runs(patrolling, policy, count=ALL)
    same = stl.likely_runs(flagged, policy, count=ALL)
    assert [(run.states, run.actions) for run in result.runs] == [(run.states, run.actions) for run in same.runs]
    assert result.probability == pytest.approx(1 - stl.check(patrolling, policy).probability, abs=1e-12)


def line(goal):
    """One state after another, `goal` the probability to get on."""
    rows = [[1 - goal, goal], [0, 1]] if goal < 1 else [[0, 1], [0, 1]]
    return stl.MDP.from_arrays([rows], {"x": [0, 1]}, labels={"goal": [0, 1]}, action_names=["go"])


def test_none_of_positive_probability_is_a_result():
    product = stl.build_product(line(1), stl.parse("F[0,3] goal"))
    for mass in (None, 0.5, 1.0):
        none = stl.likely_runs(product, mass=mass)
        assert (none.runs, none.probability, none.mass, none.covered) == ((), 0.0, 0.0, 1.0)
        assert (none.exhausted, none.status) == (True, "complete")
    only = stl.likely_runs(product, satisfied=True, mass=1.0)
    assert [(run.states, run.step, run.probability) for run in only.runs] == [((0, 1), 1, 1.0)]


def test_a_formula_that_the_first_state_decides(floor5):
    result = stl.likely_runs(stl.build_product(floor5, stl.parse("A")))
    assert [(run.step, run.actions, run.certain, run.probability) for run in result.runs] == [(0, (), 0, 1.0)]


def test_the_cap_says_how_much_is_covered():
    product = stl.build_product(line(0.25), stl.parse("F[0,9] goal"))
    result = stl.likely_runs(product, satisfied=True, mass=0.9, most=2)
    assert [run.probability for run in result.runs] == [0.25, 0.1875]
    assert result.status == "covered 0.473 of the requested 0.9 with 2 runs; raise most to continue"
    assert not result.exhausted
    whole = stl.likely_runs(product, satisfied=True, mass=0.9)
    assert (len(whole.runs), whole.status) == (7, "complete")
    assert stl.likely_runs(product, satisfied=True, mass=1.0, most=9).status == "complete"


def test_more_than_there_are_are_all_of_them():
    product = stl.build_product(line(0.25), stl.parse("F[0,9] goal"))
    result = stl.likely_runs(product, satisfied=True, count=100)
    assert (len(result.runs), result.exhausted, result.covered) == (9, True, 1.0)


def test_probabilities_below_the_doubles_keep_their_logarithm():
    model = stl.MDP.from_arrays([[[1 - 1e-9, 1e-9], [1 - 1e-9, 1e-9]]], {"x": [0, 1]}, labels={"A": [0, 1]}, initial=1)
    product = stl.build_product(model, stl.parse("G[0,40] A"))
    result = stl.likely_runs(product, satisfied=True)
    (run,) = result.runs
    assert run.probability == result.probability == 0
    assert run.log_probability == pytest.approx(40 * math.log(1e-9))
    assert result.exhausted
    row = [1 - 2e-9, 1e-9, 1e-9]
    many = stl.MDP.from_arrays([[row, row, row]], {"x": [0, 1, 2]}, labels={"A": [0, 1, 1]}, initial=1)
    one = stl.likely_runs(stl.build_product(many, stl.parse("G[0,40] A")), satisfied=True, count=1)
    assert (len(one.runs), one.covered, one.exhausted) == (1, 0.0, False)
    with pytest.raises(SettingsError, match="less than 1e-300.*ask for a number"):
        stl.likely_runs(product, satisfied=True, mass=0.5)


@pytest.mark.soak(only=True)
def test_long_runs_and_a_short_heap():
    """Rounding and the heap's pruning over a thousand steps: with n slips, whichever steps they fall on."""
    product = stl.build_product(line(0.001), stl.parse("F[0,400] goal"))
    result = stl.likely_runs(product, satisfied=True, count=350)
    for n, run in enumerate(result.runs, start=1):
        assert run.probability == pytest.approx(0.001 * 0.999 ** (n - 1), rel=1e-12)
        assert run.step == n


@pytest.mark.parametrize("count", [1, 7, 350])
def test_pruning_changes_nothing(count):
    """Independent steps, so one run without a 1 among 300, 300 runs with one, and many with two: few may be kept."""
    model = stl.MDP.from_arrays([[[0.6, 0.4], [0.6, 0.4]]], {"x": [0, 1]})
    product = stl.build_product(model, stl.parse("F[300,300] x < 2"))
    result = stl.likely_runs(product, satisfied=True, count=count)
    ones = [sum(run.states) for run in result.runs]
    assert ones == ([0] + [1] * 300 + [2] * count)[:count]
    assert len({run.states for run in result.runs}) == count


def test_undefined_places_are_named_the_reachable_first(patrolling):
    table = stl.check(patrolling).policy.table.copy()
    start = int(patrolling.model.initial.argmax())
    table[1, start] = -1
    table[0, start - 1, 0] = -1  # never there at step 0
    with pytest.raises(PolicyError, match=r"no action at step 1, state \(1,0\); .*which is reachable under it \(\d+ "):
        stl.likely_runs(patrolling, stl.Policy(patrolling, table))
    table = stl.check(patrolling).policy.table.copy()
    table[0, start - 1, 0] = -1
    assert stl.likely_runs(patrolling, stl.Policy(patrolling, table)).runs == stl.likely_runs(patrolling).runs
    silent = stl.Policy(patrolling, np.full(patrolling.shape, -1))
    with pytest.raises(PolicyError, match=rf"state \(1,0\); .*\({patrolling.n_states - 1} others are not\)"):
        stl.sensitivity(patrolling, silent)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"count": 0}, "count is 0; it must be an integer from 1"),
        ({"count": -3}, "count is -3"),
        ({"count": 2.5}, "count is 2.5"),
        ({"most": 0, "mass": 0.5}, "most is 0"),
        ({"mass": 0.0}, "mass is 0.0; give a share of the probability, above 0 and at most 1"),
        ({"mass": 1.5}, "mass is 1.5"),
        ({"mass": math.nan}, "mass is nan"),
    ],
)
def test_numbers_out_of_range(patrolling, options, says):
    with pytest.raises(SettingsError, match=says):
        stl.likely_runs(patrolling, **options)


def test_what_would_not_fit_or_belongs_elsewhere_is_refused(patrolling, floor5):
    with pytest.raises(SizeError, match=r"unfolding 468 product states: \d of 8 steps would take"):
        stl.likely_runs(patrolling, stl.check(patrolling).policy, memory_limit=1500)
    endless = stl.build_product(floor5, stl.parse("G[0,10^12) F[0,10) A"))
    stay = stl.Policy(endless, np.zeros(endless.shape, dtype=int))
    assert stl.likely_runs(endless, stay).runs[0].step == 9  # violated so soon, the longest window takes no time
    product = stl.build_product(line(0.25), stl.parse("G[0,10^12) !goal | F[0,10^12) goal"))
    with pytest.raises(SizeError, match=r"runs of up to 999999999999 steps, 10 of them would take"):
        stl.likely_runs(product, satisfied=True)
    with pytest.raises(SizeError, match=r"derivatives along \d+ pairs, all steps together would take"):
        stl.sensitivity(product)
    other = stl.check(stl.build_product(floor5, stl.parse("F[0,5) A"))).policy
    with pytest.raises(PolicyError, match="the policy is for the task"):
        stl.likely_runs(patrolling, other)


def test_progress_counts_steps_then_runs(patrolling):
    calls = []
    stl.likely_runs(patrolling, mass=0.5, progress=lambda done, total: calls.append((done, total)))
    steps = [call for call in calls if call[1] == 2 * patrolling.horizon]
    assert steps == sorted(set(steps))
    assert steps[-1] == (16, 16)
    assert calls[len(steps) :] == [(n + 1, 10_000) for n in range(len(calls) - len(steps))]


def test_a_weight_and_a_probability_whose_product_underflows():
    p = 1e-200
    model = stl.MDP.from_arrays([[[1 - p, p], [0, 1]], [[1, 0], [0, 1]]], {}, labels={"b": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,1] b"))
    weights = np.zeros((1, *product.shape, 2))
    weights[..., 0], weights[..., 1] = 1e-200, 1
    (run,) = stl.likely_runs(product, stl.Policy(product, weights), satisfied=True).runs
    assert run.log_probability == pytest.approx(2 * np.log(1e-200))
    assert run.probability == 0
