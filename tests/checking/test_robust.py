"""`robust_check` against trees of histories with nature's corners, exact integers, a convex programme, and its laws."""

import inspect
import itertools
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.robust import rows_defect
from stltool.errors import ModelError, PolicyError, SettingsError, SizeError
from stltool.logic.formula import Not
from stltool.models import Intervals
from stltool.models.environment import simulator
from stltool.policy import with_flags
from stltool.testing import flag_formulas, formulas, interval_mdps, mdps
from tests import dense, oracles
from tests.checking.test_check import close, random_policy
from tests.conftest import many, some

QUESTIONS = [(maximize, nature) for maximize in (True, False) for nature in ("against", "with")]


def minimizes(maximize, nature):
    """Whether nature wants the probability small."""
    return maximize == (nature == "against")


@st.composite
def products(draw, longest=2, most=3, **options):
    model = draw(interval_mdps(**options))
    flags = flag_formulas(longest=longest, equal=False, horizon=most)
    phi = draw(st.one_of(flags, formulas(longest=longest, max_leaves=5, horizon=most)))
    return stl.build_product(model, phi)


@given(products())
@settings(max_examples=many(25))
def test_values_equal_the_tree_of_all_histories(product):
    for maximize, nature in QUESTIONS:
        result = stl.robust_check(product, maximize=maximize, nature=nature)
        exact = oracles.robust_optimum(product.model, product.formula, maximize, minimizes(maximize, nature))
        close(result, exact)
        assert stl.robust_check(product, maximize=maximize, nature=nature, exact=True).fraction == exact
        assert (result.question, result.nature) == ("maximum" if maximize else "minimum", nature)


@given(products(longest=1, most=2, states=2, single_start=True), st.sampled_from(QUESTIONS))
@settings(max_examples=many(25))
def test_values_equal_the_enumeration_of_all_policies_and_natures(product, question):
    """Literally: the best over every policy of the worst over every strategy of nature, history-dependent both."""
    maximize, nature = question
    model, phi = product.model, product.formula
    start, length = int(np.flatnonzero(model.initial)[0]), stl.horizon(phi) + 1
    nodes = [(start, *rest) for n in range(length - 1) for rest in itertools.product(range(model.n_states), repeat=n)]
    rows = {node: oracles.interval_choices(model, node[-1]) for node in nodes}
    places = [(node, c) for node in nodes for c in range(len(rows[node]))]

    def value(history, policy, strategy):
        if len(history) == length:
            return Fraction(oracles.holds(model, phi, history))
        c = policy[history]
        chances = zip(rows[history][c][0], strategy[history, c], strict=True)
        return sum(p * value((*history, s), policy, strategy) for s, p in chances if p)

    def values(policy):
        for corners in itertools.product(*(rows[node][c][1] for node, c in places if policy[node] == c)):
            taken = [place for place in places if policy[place[0]] == place[1]]
            yield value((start,), policy, dict(zip(taken, corners, strict=True)))

    inner = min if minimizes(maximize, nature) else max
    policies = itertools.product(*(range(len(rows[node])) for node in nodes))
    best = (max if maximize else min)(inner(values(dict(zip(nodes, picks, strict=True)))) for picks in policies)
    close(stl.robust_check(product, maximize=maximize, nature=nature), best)


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.sampled_from(QUESTIONS))
@settings(max_examples=many(40))
def test_a_policys_value_equals_the_tree_of_its_runs(product, seed, timed, mixed, question):
    maximize, nature = question
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    result = stl.robust_check(product, policy, maximize=maximize, nature=nature)
    exact = oracles.robust_policy_value(product, policy, minimizes(maximize, nature))
    close(result, min(exact, Fraction(1)))
    exactly = stl.robust_check(product, policy, maximize=maximize, nature=nature, exact=True)
    assert exactly.fraction == exact
    assert (result.question, result.policy) == ("policy", policy)
    bound = stl.robust_check(product, maximize=maximize, nature=nature)
    assert result.lower <= bound.upper if maximize else result.upper >= bound.lower


# ------------------------------------------------------------------------------------------- the enclosure


def random_ends(rng, n, denominator):
    """Lower and upper ends over a denominator, Σ lower <= 1 <= Σ upper, often with equality."""
    cuts = np.sort(rng.integers(0, denominator + 1, n - 1))
    inside = np.diff([0, *cuts, denominator])
    reach = denominator // int(rng.choice([1, 5, 50]))
    lower = np.maximum(inside - rng.integers(0, reach + 1, n) * (rng.random() < 0.8), 0)
    upper = np.minimum(inside + rng.integers(0, reach + 1, n) * (rng.random() < 0.8), denominator)
    return lower, upper


def exact_nature(lower, upper, denominator, values, minimize):
    """denominator · opt Σ p·v in integers, v integers: the budget goes to the best entries first."""
    left = denominator - sum(lower)
    total = sum(lo * v for lo, v in zip(lower, values, strict=True))
    for k in sorted(range(len(values)), key=values.__getitem__, reverse=not minimize):
        take = min(upper[k] - lower[k], left)
        total, left = total + take * values[k], left - take
    assert left == 0
    return total


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=many(200))
def test_the_exact_greedy_takes_the_best_corner(seed, minimize):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    lower, upper = (ends.tolist() for ends in random_ends(rng, n, 12))
    values = rng.integers(0, 5, n).tolist()
    ends = [(Fraction(a, 12), Fraction(b, 12)) for a, b in zip(lower, upper, strict=True) if b]
    kept = [v for v, b in zip(values, upper, strict=True) if b]
    worths = [sum(p * v for p, v in zip(corner, kept, strict=True)) for corner in oracles.vertices(ends)]
    greedy = exact_nature(lower, upper, 12, values, minimize)
    assert Fraction(greedy, 12) == (min if minimize else max)(worths)


@pytest.mark.soak
@pytest.mark.parametrize(("denominator", "n_block"), some(itertools.product([10, 1000, 3**7, 10**17, 2**52], [3, 12])))
@pytest.mark.parametrize("part", range(many(1)))
def test_thousands_of_exact_values_lie_in_their_enclosures(denominator, n_block, part):
    """Many small models in one, ends read from fractions; the exact values in integers. Never outside, never wide."""
    rng = np.random.default_rng((denominator, n_block, part))
    n_blocks, horizon = 48 // n_block, 8
    n = n_blocks * n_block
    ends = np.zeros((2, 2, n, n), dtype=object)
    for s in range(n):
        block = slice(s // n_block * n_block, (s // n_block + 1) * n_block)
        for a in range(2):
            ends[0, a, s, block], ends[1, a, s, block] = random_ends(rng, n_block, denominator)
    goal, bad = rng.random(n) < 0.25, rng.random(n) < 0.15
    doubles = [[[float(Fraction(int(x), denominator)) for x in row] for row in m] for m in (*ends[0], *ends[1])]
    model = stl.MDP.from_intervals(doubles[:2], doubles[2:], {}, labels={"goal": goal, "bad": bad})
    product = stl.build_product(model, stl.parse(f"!bad U[0,{horizon}] goal"))
    automaton = product.automaton
    compared = 0
    for maximize, nature in QUESTIONS:
        best = max if maximize else min
        exact = {}
        for t in range(horizon, -1, -1):
            for s, q in itertools.product(range(n), range(automaton.n_states)):
                verdict = automaton.verdicts(t)[q]
                if verdict != UNDECIDED:
                    exact[t, s, q] = int(verdict == TRUE) * denominator ** (horizon - t)
                    continue
                block = slice(s // n_block * n_block, (s // n_block + 1) * n_block)
                after = [exact[t + 1, s2, product.enter(s2, q)] for s2 in range(block.start, block.stop)]
                exact[t, s, q] = best(
                    exact_nature(
                        [int(x) for x in ends[0, a, s, block]], [int(x) for x in ends[1, a, s, block]],
                        denominator, after, minimizes(maximize, nature),
                    )
                    for a in range(2)
                )  # fmt: skip
        for s in np.flatnonzero(~goal & ~bad):
            here = replace(product, model=replace(model, initial=np.eye(n)[s], exact_initial=None))
            result = stl.robust_check(here, maximize=maximize, nature=nature, keep_policy=False)
            value = Fraction(exact[0, int(s), product.enter(int(s), automaton.initial)], denominator**horizon)
            assert Fraction(result.lower) <= value <= Fraction(result.upper)
            assert result.upper - result.lower < 1e-12
            compared += 1
    assert compared > 75


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("nature", ["against", "with"])
def test_errors_that_add_up_over_many_steps_stay_inside(nature):
    """Staying alive for 400 steps at 0.9983, …: every step repeats the error of reading that decimal."""
    horizon, worst = 400, Fraction(0)
    for thousandths in range(9981, 9999):
        low, high = Fraction(thousandths, 10000), Fraction(thousandths + 1, 10000)
        lower = [[float(low), float(1 - high)], [0, 1]]
        upper = [[float(high), float(1 - low)], [0, 1]]
        model = stl.MDP.from_intervals([lower], [upper], {}, labels={"a": [1, 0]})
        result = stl.robust_check(stl.build_product(model, stl.parse(f"G[0,{horizon}] a")), nature=nature)
        exact = (low if nature == "against" else high) ** horizon
        assert Fraction(result.lower) <= exact <= Fraction(result.upper)
        worst = max(worst, abs(Fraction(result.probability) / exact - 1) * 2**53)
    assert worst > 20  # roundings: the initial sum's three would not cover them


def test_the_enclosure_is_narrow_over_a_thousand_steps():
    rng = np.random.default_rng(0)
    inside = rng.dirichlet(np.ones(10), size=(2, 10))
    model = stl.MDP.from_intervals(inside * 0.9, np.minimum(inside * 1.1, 1), {}, labels={"a": np.arange(10) < 9})
    for nature in ("against", "with"):
        result = stl.robust_check(stl.build_product(model, stl.parse("G[0,1000] F[0,3] a")), nature=nature)
        assert 0 < result.upper - result.lower < 1e-9
        assert result.lower <= result.probability <= result.upper


def test_what_the_ends_of_a_row_miss_by_rounding_is_found():
    """0.3 + 0.7 is a little less than 1 in doubles, ten tenths are a little more; both are 1 where they are added."""
    for ends in ([0.3, 0.7], [0.1] * 10):
        model = stl.MDP.from_intervals([[ends] * len(ends)], [[ends] * len(ends)], {})
        assert rows_defect(model.rows) == abs(sum(map(Fraction, ends)) - 1) > 0


def test_rows_that_miss_one_widen_the_enclosure():
    """[0.1, 0.1] ten times, in doubles, sums to a little over 1: what is too much may belong to any entry."""
    tenth = np.full((1, 10, 10), 0.1)
    off = tenth * (1 + 1e-10)
    labels = {"a": [1] * 5 + [0] * 5}
    widths = []
    for ends in (tenth, off):
        product = stl.build_product(stl.MDP.from_intervals(ends, ends, {}, labels=labels), stl.parse("F[1,1] a"))
        result = stl.robust_check(product)
        assert result.lower <= 0.5 <= result.upper
        widths.append(result.upper - result.lower)
    assert widths[0] < 1e-13
    assert 3.9e-10 < widths[1] < 4.1e-10


def test_exact_answers_name_the_initial_distribution_where_it_is_at_fault():
    ends = np.tile(np.eye(10)[None], (1, 1, 1))
    model = stl.MDP.from_intervals(ends, ends, {}, [0.1 + 1e-12] * 10, labels={"a": [1] * 5 + [0] * 5})
    product = stl.build_product(model, stl.parse("F[1,1] a"))
    with pytest.raises(ModelError, match=r"^the initial distribution: no probabilities within the ends sum to 1"):
        stl.robust_check(product, exact=True)


def test_the_weights_of_a_mixture_may_miss_one():
    """Nine choices of 1/9 each in doubles: a defect of the policy widens too."""
    ends = np.tile([[0.99, 0.01], [0, 1]], (9, 1, 1))
    model = stl.MDP.from_intervals(ends, ends, {}, labels={"a": [1, 0]})
    product = stl.build_product(model, stl.parse("G[0,50] a"))
    assume_defect = 1e-10
    weights = np.full((*product.shape, 9), (1 + assume_defect) / 9)
    result = stl.robust_check(product, stl.Policy(product, weights))
    assert result.lower <= 0.99**50 <= result.upper
    assert result.upper - result.lower > 50 * assume_defect
    even = stl.robust_check(product, stl.Policy(product, np.full((*product.shape, 9), 1 / 9)))
    assert even.upper - even.lower < 1e-12


def test_ends_in_fractions_and_decimals_mean_exactly_that(tmp_path):
    """1/3 … 2/3 tried twice fails with (2/3)², however the ends were given."""
    lower, upper = [[["1/3", "1/3"], [0, 1]]], [[["2/3", "2/3"], [0, 1]]]
    model = stl.MDP.from_intervals(lower, upper, {}, labels={"goal": [0, 1]})
    (tmp_path / "m.drn").write_text(
        "@type: DTMC\n@parameters\n\n@reward_models\n\n@nr_states\n2\n@nr_choices\n2\n@model\n"
        "state 0 init\n\taction 0\n\t\t0 : [1/3, 2/3]\n\t\t1 : [1/3, 2/3]\n"
        "state 1 goal\n\taction 0\n\t\t1 : [1, 1]\n"
    )
    for read in (model, stl.load_model(tmp_path / "m.drn")):
        product = stl.build_product(read, stl.parse("F[0,2] goal"))
        found = stl.robust_check(product, exact=True, values="all")
        assert found.fraction == 1 - Fraction(2, 3) ** 2
        assert found.values.fractions == (found.fraction, 1)
        assert stl.robust_check(product, exact=True, nature="with").fraction == 1 - Fraction(1, 3) ** 2
        assert found.policy is not None
    tenths = stl.MDP.from_intervals([[[0.1, 0.7], [0, 1]]], [[[0.3, 0.9], [0, 1]]], {}, labels={"goal": [0, 1]})
    assert stl.robust_check(stl.build_product(tenths, stl.parse("F[0,2] goal")), exact=True).fraction == Fraction(
        91, 100
    )
    (tmp_path / "m.tra").write_text("2 2 3\n0 0 0 [1/3,2/3]\n0 0 1 [1/3,2/3]\n1 0 1 [1,1]\n")
    (tmp_path / "m.lab").write_text('0="init" 1="goal"\n0: 0\n1: 1\n')
    product = stl.build_product(stl.load_model(tmp_path / "m.tra"), stl.parse("F[0,2] goal"))
    with pytest.raises(ModelError, match="the ends of the intervals were rounded when they were read"):
        stl.robust_check(product, exact=True)


# ------------------------------------------------------------------------------------------- laws


@given(mdps(states=4), st.sampled_from(QUESTIONS))
@settings(max_examples=many(60))
def test_points_as_intervals_are_the_ordinary_check(model, question):
    maximize, nature = question
    points = Intervals(model.probability.copy(), model.probability.copy())
    same = model.with_rows(intervals=points)
    phi = stl.parse("G[0,2] (F[0,2] a | b)")
    robust = stl.robust_check(stl.build_product(same, phi), maximize=maximize, nature=nature)
    plain = stl.check(stl.build_product(model, phi), maximize=maximize)
    assert robust.probability == pytest.approx(plain.probability, abs=1e-14)
    assert robust.lower <= plain.upper
    assert plain.lower <= robust.upper


@given(products(states=4, actions=3))
@settings(max_examples=many(40))
def test_intervals_enclose_the_nominal_model(product):
    """max–min <= the nominal maximum <= max–max; and the same policy's values."""
    nominal = replace(product, model=product.model.nominal())
    for maximize in (True, False):
        inside = stl.check(nominal, maximize=maximize)
        policy = stl.Policy(product, inside.policy.table)
        for given_policy in (None, policy):
            ends = [
                stl.robust_check(product, given_policy, maximize=maximize, nature=nature)
                for nature in ("against", "with")
            ]
            low, high = ends if maximize else ends[::-1]
            assert low.lower <= inside.upper
            assert inside.lower <= high.upper


@given(products(states=4), st.sampled_from(QUESTIONS))
@settings(max_examples=many(60))
def test_wider_intervals_give_nature_more(product, question):
    maximize, nature = question
    model = product.model
    wide = Intervals(model.intervals.lower / 2, np.minimum(model.intervals.upper * 1.5, 1))
    wider = replace(
        product,
        model=model.with_rows(intervals=wide, probability=wide.nominal(model.row_start)),
    )
    a, b = (stl.robust_check(p, maximize=maximize, nature=nature).probability for p in (product, wider))
    assert b <= a + 1e-14 if minimizes(maximize, nature) else b >= a - 1e-14


@given(products(states=4))
@settings(max_examples=many(40))
def test_maximum_and_minimum_are_dual(product):
    """max–min of Φ = 1 − min–max of ¬Φ; max–max of Φ = 1 − min–min of ¬Φ."""
    negated = stl.build_product(product.model, Not(product.formula))
    for nature in ("against", "with"):
        best, worst = stl.robust_check(product, nature=nature), stl.robust_check(negated, maximize=False, nature=nature)
        assert best.probability == pytest.approx(1 - worst.probability, abs=1e-13)


@given(products(states=4, actions=3), st.sampled_from(QUESTIONS))
@settings(max_examples=many(40))
def test_the_optimal_policy_attains_the_optimum(product, question):
    options = dict(zip(("maximize", "nature"), question, strict=True))
    best = stl.robust_check(product, **options)
    assert stl.robust_check(product, best.policy, **options).probability == best.probability
    unkept = stl.robust_check(product, keep_policy=False, **options)
    assert (unkept.probability, unkept.policy) == (best.probability, None)


@given(products(states=4, actions=3), st.integers(0, 2**32 - 1), st.sampled_from(QUESTIONS))
@settings(max_examples=many(40))
def test_engines_agree_with_a_dense_one(product, seed, question):
    options = dict(zip(("maximize", "nature"), question, strict=True))
    minimal = options["maximize"] == (options["nature"] == "against")
    rng = np.random.default_rng(seed)
    policies = [None] + [random_policy(product, rng, timed, mixed) for timed in (0, 1) for mixed in (0, 1)]
    for policy in policies:
        one, other = (stl.robust_check(product, policy, engine=engine, **options) for engine in ("nodes", "words"))
        assert (one.probability, one.lower, one.upper) == (other.probability, other.lower, other.upper)
        dense_value = dense.at_start(product, dense.robust_layers(product, options["maximize"], minimal, policy))
        assert one.probability == pytest.approx(float(dense_value), abs=1e-14)


@pytest.mark.soak(only=True)
def test_long_rows_are_sorted_too():
    rng = np.random.default_rng(3)
    inside = rng.dirichlet(np.ones(60), size=(2, 60))
    model = stl.MDP.from_intervals(inside * 0.5, np.minimum(inside * 1.7, 1), {}, labels={"a": rng.random(60) < 0.1})
    product = stl.build_product(model, stl.parse("F[0,2] (a & F[0,1] a)"))
    for maximize, nature in QUESTIONS:
        wanted = dense.at_start(product, dense.robust_layers(product, maximize, maximize == (nature == "against")))
        for engine in ("nodes", "words"):
            found = stl.robust_check(product, maximize=maximize, nature=nature, engine=engine)
            assert found.probability == pytest.approx(float(wanted), abs=1e-14)


def wide_product(seed):
    """Rows of one to seven entries; states in pairs of equal values; more than a word of automaton states."""
    rng = np.random.default_rng(seed)
    n, lower, upper = 40, np.zeros((3, 40, 40)), np.zeros((3, 40, 40))
    for a, s in itertools.product(range(3), range(0, n, 2)):
        there = rng.choice(n, size=rng.integers(1, 8), replace=False)
        inside = rng.dirichlet(np.ones(len(there)))
        by = rng.choice([0, 0.02, 0.3, 1]) * rng.random(len(there))
        for twin in (s, s + 1):
            lower[a, twin, there] = np.maximum(inside - by, 0)
            upper[a, twin, there] = np.minimum(inside + by, 1)
    pair = np.arange(n) // 2
    labels = {"a": pair % 5 == 0, "b": pair % 7 == 1}
    model = stl.MDP.from_intervals(lower, upper, {}, initial=np.ones(n) / n, labels=labels)
    formula = ("G[0,4] ((F[0,9] a) & (F[0,9] b))", "G[0,80] F[0,9] a", "F[0,70] (a & F[0,3] b)")[seed % 3]
    return stl.build_product(model, stl.parse(formula))


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(3)))
def test_eight_at_a_time_give_the_bits_of_one_by_one(seed):
    """kernels/nature.py against numpy: optima with their policies, and policies that differ within a tile."""
    product = wide_product(seed)
    rng = np.random.default_rng(seed)
    other, between = random_policy(product, rng, timed=True, mixed=False), 0
    for maximize, nature in QUESTIONS:
        for policy in (None, other):
            asked = {"policy": policy, "maximize": maximize, "nature": nature}
            slow, quick = (stl.robust_check(product, engine=engine, **asked) for engine in ("nodes", "words"))
            assert (slow.engine, quick.engine) == ("nodes", "tiles")
            assert (slow.probability, slow.lower, slow.sweeps) == (quick.probability, quick.lower, quick.sweeps)
            between += 0 < slow.probability < 1
            for t in range(product.horizon):
                assert np.array_equal(slow.policy.row(t), quick.policy.row(t))
    assert between > 2


def test_threads_change_nothing(floor5, monkeypatch):
    product = stl.build_product(blurred(floor5), stl.parse("G[0,10) (F[0,8) A & F[0,8) B)"))
    for nature in ("against", "with"):
        alone = stl.robust_check(product, nature=nature, engine="words", threads=1)
        with monkeypatch.context() as patch:
            patch.setattr("stltool.checking.induction.words._WORTH_WORDS", 1)
            together = stl.robust_check(product, nature=nature, engine="words", threads=4)
        assert together.probability == alone.probability
        assert np.array_equal(together.policy.table, alone.policy.table)


def test_progress_counts_the_sweeps(floor5):
    calls = []
    product = stl.build_product(blurred(floor5), stl.parse("F[0,4] A"))
    stl.robust_check(product, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(t, 8) for t in [*range(4), *range(5, 9)]]


# ------------------------------------------------------------------------------------------- a convex programme


def programme_value(product, maximize, minimal):
    """Backward induction whose inner problem is one cvxpy programme a step: all rows and automaton states at once."""
    import cvxpy as cp

    model, automaton = product.model, product.automaton
    n_q = automaton.n_states
    p = cp.Variable((model.n_transitions, n_q))
    successor = cp.Parameter((model.n_transitions, n_q))
    in_row = np.repeat(np.eye(model.n_choices), np.diff(model.row_start), axis=1)
    lower, upper = (np.repeat(ends[:, None], n_q, axis=1) for ends in (model.intervals.lower, model.intervals.upper))
    worth = cp.sum(cp.multiply(p, successor))
    problem = cp.Problem(
        cp.Minimize(worth) if minimal else cp.Maximize(worth), [p >= lower, p <= upper, in_row @ p == 1]
    )
    values = np.tile(automaton.verdicts(product.horizon) == TRUE, (model.n_states, 1)).astype(float)
    for t in range(product.horizon - 1, -1, -1):
        gathered = np.array([[values[s, product.enter(s, q)] for q in range(n_q)] for s in range(model.n_states)])
        successor.value = gathered[model.target]
        problem.solve(solver=cp.CLARABEL)
        per_choice = in_row @ (p.value * successor.value)
        verdicts = automaton.verdicts(t)
        for s in range(model.n_states):
            options = per_choice[model.choice_start[s] : model.choice_start[s + 1]]
            values[s] = options.max(axis=0) if maximize else options.min(axis=0)
            values[s] = np.where(verdicts == UNDECIDED, values[s], verdicts == TRUE)
    return sum(model.initial[s] * values[s, product.enter(s, automaton.initial)] for s in range(model.n_states))


@pytest.mark.parametrize("seed", range(4))
def test_values_agree_with_a_convex_programme(seed):
    rng = np.random.default_rng(seed)
    inside = rng.dirichlet(np.ones(4), size=(2, 4))
    lower, upper = np.maximum(inside - rng.random(inside.shape) / 3, 0), np.minimum(inside + rng.random() / 3, 1)
    labels = {name: rng.random(4) < 0.5 for name in "ab"}
    model = stl.MDP.from_intervals(lower, upper, {}, initial=np.full(4, 0.25), labels=labels)
    product = stl.build_product(model, stl.parse("G[0,2] F[0,2] a & F[0,3] (b U[0,2] a)"))
    for maximize, nature in QUESTIONS:
        result = stl.robust_check(product, maximize=maximize, nature=nature)
        assert result.probability == pytest.approx(
            programme_value(product, maximize, minimizes(maximize, nature)), abs=1e-7
        )


# ------------------------------------------------------------------------------------------- policies, bad input


def blurred(model, by=0.01):
    """The model with every probability known up to `by`."""
    ends = Intervals(np.maximum(model.probability - by, 0), np.minimum(model.probability + by, 1))
    return model.with_rows(intervals=ends, probability=ends.nominal(model.row_start))


def test_a_value_by_hand():
    """Two tries at [0.6, 0.9]: nature takes 0.6 against us and 0.9 with us, at every step."""
    model = stl.MDP.from_intervals(
        [[[0.1, 0.6], [0, 1]]], [[[0.4, 0.9], [0, 1]]], {}, labels={"goal": [0, 1]}, action_names=["try"]
    )
    product = stl.build_product(model, stl.parse("F[0,2] goal"))
    figures = [stl.robust_check(product, nature=nature).probability for nature in ("against", "with")]
    assert figures == pytest.approx([1 - 0.4**2, 1 - 0.1**2])


def test_nature_sees_the_choice_of_a_mixture():
    """Each action reaches a with [0, 1]; nature spoils whichever was taken, or both help."""
    rows = [[[0, 1, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, 1], [0, 1, 0], [0, 0, 1]]]
    free = [[0, 1, 1], [0, 1, 0], [0, 0, 1]]
    lower = [[[0, 0, 0], *rows[0][1:]], [[0, 0, 0], *rows[1][1:]]]
    model = stl.MDP.from_intervals(lower, [free, free], {}, labels={"a": [0, 1, 0]})
    product = stl.build_product(model, stl.parse("F[1,1] a"))
    coin = stl.Policy(product, np.full((*product.shape, 2), 0.5))
    assert stl.robust_check(product, coin).probability == 0
    assert stl.robust_check(product, coin, nature="with").probability == 1
    assert stl.robust_check(product, coin, maximize=False, nature="against").probability == 1
    assert stl.robust_check(product, coin, maximize=False, nature="with").probability == 0


def test_policies_go_between_a_model_its_intervals_and_encodings(floor5, tmp_path):
    phi = stl.parse("F[0,8) G[0,2) A")
    product = stl.build_product(blurred(floor5), phi)
    nominal = replace(product, model=product.model.nominal())
    learned = stl.learn(nominal, "cfer", episodes=200, seed=0).policy
    guaranteed, hoped = (stl.robust_check(product, learned, nature=nature) for nature in ("against", "with"))
    usual = stl.check(nominal, learned).probability
    assert guaranteed.probability < usual < hoped.probability
    best = stl.robust_check(product)
    best.policy.save(tmp_path / "robust.npz")
    assert stl.check(nominal, stl.load_policy(tmp_path / "robust.npz", nominal)).probability >= best.lower
    flagged = with_flags(product)
    by_flags = stl.robust_check(flagged)
    assert by_flags.probability == pytest.approx(best.probability, abs=1e-13)
    judged = stl.robust_check(product, by_flags.policy)  # translated by a join with the flags
    assert judged.probability == pytest.approx(best.probability, abs=1e-13)
    with pytest.raises(PolicyError, match="is for the model"):
        stl.robust_check(stl.build_product(blurred(floor5, by=0.02), phi), best.policy)


def test_what_needs_one_distribution_refuses_intervals(floor5, tmp_path):
    product = stl.build_product(blurred(floor5), stl.parse("F[0,3] A"))
    policy = stl.robust_check(product).policy
    joint = stl.build_joint_product(blurred(floor5), {"one": stl.parse("F[0,3] A"), "two": stl.parse("F[0,3] B")})
    rng = np.random.default_rng(0)
    for ask in (
        lambda: stl.check(product),
        lambda: stl.check(product, policy),
        lambda: stl.check(product, engine="nodes"),
        lambda: stl.learn(product, episodes=1),
        lambda: stl.learn(product, faithful=True, episodes=1),
        lambda: stl.sample_run(product, policy),
        lambda: simulator(product.model, rng),
        lambda: product.model.matrix(),
        lambda: product.model.exact(),
        lambda: stl.check(product, exact=True),
        lambda: stl.write_certificate(stl.robust_check(product), tmp_path / "proof.jsonl", cluster="tcp://127.0.0.1:9"),
        lambda: stl.likely_runs(product, policy),
        lambda: stl.sensitivity(product, policy),
        lambda: stl.policy_tree(product, policy),
        lambda: stl.estimate(product, policy, runs=10),
        lambda: stl.sprt(product, policy, 0.5),
        lambda: stl.pareto(joint),
        lambda: stl.tradeoff(joint, "one"),
        lambda: stl.surrogate_optimum(product),
        lambda: stl.expected_cost(product, "x"),
        lambda: stl.long_run(product),
        lambda: stl.frontier(product.model, stl.parse_task("param n = 1\nr := F[0,n] A"), 0.5, {"n": [1]}),
        lambda: stl.robustness_distribution(product.model, stl.parse("F[0,3] x > 0.5")),
        lambda: stl.time_distribution(product.model, stl.parse("F[0,3] x > 0.5"), 1),
        lambda: stl.largest_margin(product.model, stl.parse("F[0,3] x > 0.5"), 0.5),
        lambda: stl.shield(product, at_least=0.5),
        lambda: stl.counterfactual(product, ([0, 0], ["N"])),
        lambda: stl.stationary(product),
        lambda: stl.to_gymnasium(product.model),
    ):
        with pytest.raises(SettingsError, match=r"are intervals; use stl.robust_check, .*: model.nominal\(\)"):
            ask()
    with pytest.raises(SettingsError, match="do not depend on parameters"):
        stl.parametric(product)
    assert list(tmp_path.iterdir()) == []


def test_a_guarantee_from_data_reads_no_probability(floor5):
    product = stl.build_product(blurred(floor5), stl.parse("F[0,3] A"))
    nominal = stl.build_product(blurred(floor5).nominal(), stl.parse("F[0,3] A"))
    counts = stl.learn(nominal, episodes=300, seed=0).counts
    bounds = [stl.guarantee(judge, None, counts).lower for judge in (product, nominal)]
    assert bounds[0] == bounds[1] > 0


def test_explain_reads_no_probability(floor5):
    told = [stl.explain(stl.parse_task("r := F[0,3] A"), model=model) for model in (blurred(floor5), floor5)]
    assert [data["product_states"] for data in told] == [told[0]["states"] * told[0]["automaton_states"]] * 2


def test_every_public_function_on_products_knows_of_intervals():
    """A function that is new here must answer for intervals or refuse them, with a line in the test above."""
    refusing = {"check", "learn", "sample_run", "likely_runs", "sensitivity", "estimate", "sprt", "pareto", "tradeoff",
                "surrogate_optimum", "to_gymnasium", "stationary", "parametric", "policy_tree",
                "expected_cost", "frontier", "robustness_distribution", "largest_margin", "shield", "long_run",
                "counterfactual", "time_distribution"}  # fmt: skip
    fit = {"robust_check", "cost_distribution", "build_product", "build_joint_product", "guarantee", "explain",
           "report", "optimality_gap", "save_model", "product_mdp", "export"}  # fmt: skip
    found = {name: getattr(stl, name) for name in stl.__all__ if inspect.isfunction(getattr(stl, name))}
    models = {"product", "model", "joint"}
    asks = {name for name, ask in found.items() if models & set(inspect.signature(ask).parameters)}
    assert asks - {"load_policy", "certify"} == refusing | fit


def test_bad_questions_are_refused(floor5):
    product = stl.build_product(blurred(floor5), stl.parse("F[0,3] A"))
    with pytest.raises(SettingsError, match="no intervals; use stl.check"):
        stl.robust_check(stl.build_product(floor5, stl.parse("F[0,3] A")))
    with pytest.raises(SettingsError, match="nature is 'kind'; choose against or with"):
        stl.robust_check(product, nature="kind")
    with pytest.raises(SettingsError, match="engine is 'cuda'; choose auto, nodes or words"):
        stl.robust_check(product, engine="cuda")
    with pytest.raises(SizeError, match="100 B may be used"):
        stl.robust_check(product, memory_limit=100)
    silent = np.full(product.shape, -1)
    with pytest.raises(PolicyError, match="defines no action at step 0"):
        stl.robust_check(product, stl.Policy(product, silent))
    table = stl.robust_check(product).policy.table.copy()
    table[2, int(product.model.initial.argmax())] = -1  # the first two moves may leave the robot where it is
    with pytest.raises(PolicyError, match="defines no action at step 2"):
        stl.robust_check(product, stl.Policy(product, table))
