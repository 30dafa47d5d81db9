"""Trade-offs against the points of all deterministic history-dependent policies, and their mixtures, in fractions."""

import dataclasses
import itertools
import json
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.joint import DECIDED
from stltool.checking.occupation import policy_of, programme, solve
from stltool.checking.pareto import Corner, _undominated
from stltool.checking.weighted import Criteria, Figure, best, of_policy
from stltool.choices import Table
from stltool.errors import InfeasibleError, NameLookupError, PolicyError, SettingsError, SizeError, SolverError
from stltool.testing import flag_formulas, formulas, mdps
from tests import oracles
from tests.conftest import FACTORY, many

SMALL = Fraction(1, 10**7)
ENCLOSED = Fraction(1, 10**12)


@st.composite
def joints(draw, n_tasks=2, longest=2, **options):
    """Tiny models with tasks of any kind, of different horizons, and a signal `fuel` that is a cost."""
    model = draw(mdps(actions=2, **options))
    kinds = st.one_of(
        flag_formulas(longest=longest, equal=False, horizon=3), formulas(longest=longest, max_leaves=4, horizon=3)
    )
    phis = [draw(kinds) for _ in range(n_tasks)]
    assume(max(map(stl.horizon, phis)) >= 1)
    fuel = draw(st.lists(st.sampled_from([0.0, 0.5, 1.0, 3.0]), min_size=model.n_states, max_size=model.n_states))
    model = stl.MDP.from_arrays(
        dense(model), {**model.signals, "fuel": fuel}, model.initial, model.labels, model.action_names
    )
    return stl.build_joint_product(model, {f"task{i}": phi for i, phi in enumerate(phis)})


def dense(model):
    transitions = np.zeros((model.n_actions, model.n_states, model.n_states))
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            row = slice(model.row_start[c], model.row_start[c + 1])
            transitions[model.choice_action[c], s, model.target[row]] = model.probability[row]
    return transitions


def points_of(joint, cost=None):
    points = oracles.achievable(joint.model, [task.formula for task in joint.tasks], cost)
    assume(len(points) < 2000)
    return points


def encloses(figure, exact):
    assert Fraction(figure.lower) <= exact <= Fraction(figure.upper)
    assert figure.upper - figure.lower < 1e-11


# --------------------------------------------------------------------------------------------------- memory


@given(joints(n_tasks=3), st.data())
@settings(max_examples=many(30))
def test_the_joint_automaton_tells_every_verdict_once(joint, data):
    """Along any run each task's verdict falls on the step at which its own automaton says so, and never again."""
    automaton = joint.automaton
    steps = st.lists(st.integers(0, joint.model.n_states - 1), min_size=joint.horizon + 1, max_size=joint.horizon + 1)
    run = data.draw(steps)
    layer, column, q = automaton.start, 0, automaton.initial
    fell = {}
    for t, s in enumerate(run):
        letter = joint.letter[s]
        for i in range(3):
            was, now = layer.states[column, i], automaton.layers[t].states[layer.delta[letter, column], i]
            if was != DECIDED and now == DECIDED:
                fell[i] = (bool(layer.holds[i, letter, column]), t)
            else:
                assert not layer.holds[i, letter, column]
        layer, column, q = automaton.layers[t], layer.delta[letter, column], automaton.delta[letter, q]
        assert q == automaton.offsets[t] + column
        assert automaton.describe(q).startswith(f"after step {t}: ")
    assert fell == {i: task.automaton.judge(task.letter[run]) for i, task in enumerate(joint.tasks)}
    assert layer.decided.all()
    assert (automaton.delta[:, q] == q).all()


def test_verdicts_that_an_automaton_forgets_are_kept():
    """The paper's flags of G F A recover after a violation; the joint memory does not."""
    model = stl.MDP.from_arrays([[[0, 1], [1, 0]]], {"x": [0, 1]}, 0, {"A": [1, 0]})
    phi = stl.parse("G[0,3) F[0,1) A")
    joint = stl.build_joint_product(model, {"never": phi, "soon": stl.parse("F[0,4) !A")}, encoding="paper")
    figures = best(Criteria(joint), (1, 0))[1]
    assert [f.value for f in figures] == [0, 1]


# --------------------------------------------------------------------------------------------------- weighted sums


@given(joints(), st.lists(st.sampled_from([0.0, 0.25, 1.0, 3.0]), min_size=3, max_size=3))
@settings(max_examples=many(20))
def test_the_best_weighted_sum_is_that_of_all_points(joint, weights):
    fuel = joint.model.signals["fuel"]
    criteria = Criteria(joint, ("fuel",))
    most = Fraction(float(fuel.max())) * joint.horizon
    points = {(p, q, most - cost) for p, q, cost in points_of(joint, fuel)}
    top, each, chosen = best(criteria, weights)
    exact = [tuple(map(Fraction, weights)), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    encloses(top, max(sum(w * x for w, x in zip(exact[0], p, strict=True)) for p in points))
    attained = [sum(Fraction(w) * Fraction(f.value) for w, f in zip(weights, each, strict=True))]
    assert abs(attained[0] - Fraction(top.value)) < ENCLOSED
    near = min(max(abs(x - Fraction(f.value)) for x, f in zip(p, each, strict=True)) for p in points)
    assert near < ENCLOSED
    for i, w in enumerate(exact[1:]):
        encloses(best(criteria, [float(x) for x in w])[0], max(p[i] for p in points))
    weights = np.eye(joint.model.most_choices)[[chosen.row(t) for t in range(joint.horizon)]]
    for form in (chosen, Table(weights)):
        assert [f.value for f in of_policy(criteria, form)] == pytest.approx([f.value for f in each], abs=1e-13)


@given(joints(), st.lists(st.sampled_from([0.0, 0.25, 1.0, 3.0]), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=many(25))
def test_engines_agree_on_weighted_sums_to_the_bit(joint, weights, seed):
    one, other = (Criteria(joint, ("fuel",), engine) for engine in ("nodes", "words"))
    found, again = best(one, weights), best(other, weights)
    assert found[:2] == again[:2]
    for (name, mine), theirs in zip(found[2].arrays().items(), again[2].arrays().values(), strict=True):
        assert np.array_equal(mine, theirs), name
    shares = np.random.default_rng(seed).dirichlet(
        np.ones(joint.model.most_choices), size=(joint.horizon, *found[2].shape)
    )
    shares *= np.arange(joint.model.most_choices) < np.diff(joint.model.choice_start)[:, None, None]
    form = Table(shares / shares.sum(axis=-1, keepdims=True))
    assert of_policy(one, form) == of_policy(other, form)
    assert programme(one).size == programme(other).size
    assert abs(programme(one).flow - programme(other).flow).nnz == 0


@given(joints(), st.integers(0, 2**32 - 1))
@settings(max_examples=many(25))
def test_criteria_of_any_mixture_are_those_of_its_histories(joint, seed):
    """Weights by step and automaton state, in fractions over all runs."""
    criteria, automaton, model = Criteria(joint, ("fuel",)), joint.automaton, joint.model
    shape = (joint.horizon, model.n_states, criteria.game.automaton.n_states, model.most_choices)
    shares = np.random.default_rng(seed).integers(1, 4, size=shape).astype(float)
    shares *= np.arange(model.most_choices) < np.diff(model.choice_start)[:, None, None]
    form = Table(shares / shares.sum(axis=-1, keepdims=True))
    most, fuel = float(model.signals["fuel"].max()), model.signals["fuel"]

    def walk(t, s, j):
        """The criteria to come after step t."""
        if t == joint.horizon:
            return [Fraction(0)] * 3
        total, layer = [Fraction(0), Fraction(0), Fraction(most - fuel[s])], automaton.layers[t]
        entry = [Fraction(float(w)) for w in form.row(t)[s, j]]
        for i, row in enumerate(oracles.choices(model, s)):
            for n, p in row:
                after = walk(t + 1, n, int(layer.delta[joint.letter[n], j]))
                falls = [*layer.holds[:, joint.letter[n], j].tolist(), 0]
                for m in range(3):
                    total[m] += entry[i] / sum(entry) * p * (after[m] + falls[m])
        return total

    exact = [Fraction(0)] * 3
    for s, p in oracles.initial(model):
        after = walk(0, s, int(automaton.start.delta[joint.letter[s], 0]))
        falls = [*automaton.start.holds[:, joint.letter[s], 0].tolist(), 0]
        exact = [x + p * (a + f) for x, a, f in zip(exact, after, falls, strict=True)]
    for figure, value in zip(of_policy(criteria, form), exact, strict=True):
        encloses(figure, value)


@pytest.mark.parametrize("excess", [9e-10, -8e-10])
def test_rows_that_do_not_sum_to_one_widen_the_enclosure(excess):
    """What a row lacks or exceeds may belong to any successor: of three sure steps, three times the excess."""
    rows = [[[0.5, 0.5 + excess], [0, 1]]]
    model = stl.MDP.from_arrays(rows, {"x": [0, 1]}, labels={"A": [1, 1]})
    joint = stl.build_joint_product(model, {"A": stl.parse("G[0,3] A"), "B": stl.parse("G[0,3] x < 0.5")})
    top, (sure, _), chosen = best(Criteria(joint), (4, 0))
    followed = of_policy(Criteria(joint), Table(np.ones((joint.horizon, *chosen.shape, 1))))[0]
    for figure, most in ((sure, 1), (followed, 1), (top, 4)):
        assert figure.lower <= most <= figure.upper
        assert figure.upper - figure.lower == pytest.approx(2 * 3 * most * abs(excess), rel=0.01)


def test_a_probability_below_all_doubles_is_enclosed():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {}, labels={"a": [1, 0]})
    joint = stl.build_joint_product(model, {"A": stl.parse("G[0,1100] a"), "B": stl.parse("F[0,1] a")})
    rare, _ = best(Criteria(joint), (1, 0))[1]
    assert rare.lower <= Fraction(1, 2**1100) <= rare.upper < 1e-300


# --------------------------------------------------------------------------------------------------- the programme


@given(joints(n_tasks=1))
@settings(max_examples=many(12))
def test_one_objective_is_backward_induction(joint):
    result = stl.tradeoff(joint, "task0")
    optimum = stl.check(joint.tasks[0])
    assert result.probability == pytest.approx(optimum.probability, abs=1e-7)
    assert result.bound >= optimum.lower
    assert result.bound == pytest.approx(optimum.probability, abs=1e-12)
    assert (result.status, result.randomised) == ("complete", 0)


@given(joints(), st.fractions(0, 1, max_denominator=64))
@settings(max_examples=many(20))
def test_the_constrained_optimum_is_the_best_mixture(joint, part):
    points = points_of(joint)
    low, high = min(y for _, y in points), max(y for _, y in points)
    floor = float(low + part * (high - low))
    assume(Fraction(floor) <= high)
    exact = oracles.best_mixture(points, Fraction(floor))
    result = stl.tradeoff(joint, "task0", at_least={"task1": floor})
    figure, kept = result.probabilities["task0"], result.probabilities["task1"]
    assert Fraction(figure.value) == pytest.approx(exact, abs=1e-7)
    assert exact <= Fraction(result.bound) <= exact + SMALL
    assert Fraction(kept.lower) >= Fraction(floor) or "P(task1) misses its bound by" in result.status
    assert kept.value >= floor - 1e-8
    assert result.gap < 1e-6
    assert result.multipliers["task1"] >= 0
    assert result.randomised <= 1  # a corner of the programme: no more than constraints
    # the policy's figures, judged task by task by the checker
    for task, name in zip(joint.tasks, joint.names, strict=True):
        judged = stl.check(task, result.policy)
        assert judged.probability == pytest.approx(result.probabilities[name].value, abs=1e-13)
        exact_value = oracles.policy_value(*result.policy.on(task))
        encloses(result.probabilities[name], min(exact_value, Fraction(1)))


@given(joints(), st.fractions(0, 1, max_denominator=64))
@settings(max_examples=many(15))
def test_a_budget_is_kept_by_the_best_mixture(joint, part):
    fuel = joint.model.signals["fuel"]
    points = {(p, -cost) for p, _, cost in points_of(joint, fuel)}
    low, high = min(y for _, y in points), max(y for _, y in points)
    budget = float(-(low + part * (high - low)))
    exact = oracles.best_mixture(points, -Fraction(budget))
    result = stl.tradeoff(joint, "task0", budget={"fuel": budget})
    assert Fraction(result.probability) == pytest.approx(exact, abs=1e-7)
    assert exact <= Fraction(result.bound) <= exact + SMALL
    assert result.costs["fuel"].value <= budget + 1e-7
    assert Fraction(result.costs["fuel"].upper) <= Fraction(budget) or "E[fuel] misses" in result.status
    assert expected_cost(result, fuel) == pytest.approx(result.costs["fuel"].value, abs=1e-12)


def expected_cost(result, cost):
    """Σ over runs, forwards."""
    joint, total = result.joint, 0.0
    model, automaton = joint.model, joint.automaton
    here = {}
    for s, p in oracles.initial(model):
        here[s, int(automaton.delta[joint.letter[s], 0])] = float(p)
    for _ in range(joint.horizon):
        total += sum(p * cost[s] for (s, _), p in here.items())
        after = {}
        for (s, q), p in here.items():
            for w, row in zip(result.policy.table[s, q], oracles.choices(model, s), strict=False):
                for n, probability in row:
                    place = n, int(automaton.delta[joint.letter[n], q])
                    after[place] = after.get(place, 0.0) + p * w * float(probability)
        here = after
    return total


@given(joints(), st.fractions(0, 1, max_denominator=8), st.fractions(0, 1, max_denominator=8))
@settings(max_examples=many(10))
def test_task_and_budget_together_are_certified(joint, part, other):
    """A mixture keeps both bounds; the certificate is above it and above every mixture that keeps them."""
    fuel = joint.model.signals["fuel"]
    points = sorted(points_of(joint, fuel))
    inside = [
        sum(c * x for c, x in zip((part, 1 - part), pair, strict=True))
        for pair in zip(points[0], points[-1], strict=True)
    ]
    floor, budget = float(inside[1]) - 1e-6, float(inside[2]) + 1e-6
    result = stl.tradeoff(joint, "task0", at_least={"task1": max(floor, 0.0)}, budget={"fuel": budget})
    assert result.probability >= float(inside[0]) - 1e-7
    assert result.gap < 1e-6
    lam, mu = Fraction(result.multipliers["task1"]), Fraction(result.multipliers["fuel"])
    c, b = Fraction(max(floor, 0.0)), Fraction(budget)
    dual = max(p + lam * (q - c) + mu * (b - cost) for p, q, cost in points)
    assert Fraction(result.bound) >= min(dual, 1)
    assert Fraction(result.bound) <= min(dual, 1) + ENCLOSED
    assert result.randomised <= 2


# --------------------------------------------------------------------------------------------------- fronts


@given(joints())
@settings(max_examples=many(20))
def test_the_front_is_that_of_all_points(joint):
    points = points_of(joint)
    best = oracles.undominated(points)
    front = stl.pareto(joint)
    assert front.status == "complete"
    assert 0 <= front.gap <= 1e-9
    corners = [corner.point for corner in front.corners]
    assert corners == sorted(corners, key=lambda p: (-p[0], p[1]))
    assert len(set(corners)) == len(corners)
    for corner, policy in zip(front.corners, front.policies, strict=True):  # judged by itself, it has that point
        for task, figure in zip(joint.tasks, corner.probabilities, strict=True):
            judged = stl.check(task, policy)
            assert judged.lower <= figure.upper
            assert figure.lower <= judged.upper
            assert judged.probability == pytest.approx(figure.value, abs=1e-13)
    for x, y in corners:
        assert min(max(abs(p - Fraction(x)), abs(q - Fraction(y))) for p, q in points) < ENCLOSED
        assert Fraction(x) >= oracles.best_mixture(best, Fraction(y) - ENCLOSED) - SMALL
    for w1, w2, u in front.lines:
        assert all(Fraction(w1) * p + Fraction(w2) * q <= Fraction(u) for p, q in points)
    ends = max(p for p, _ in points), max(q for _, q in points)
    assert corners[0][0] == pytest.approx(float(ends[0]), abs=1e-12)
    assert corners[-1][1] == pytest.approx(float(ends[1]), abs=1e-12)
    for y in {y for _, y in points}:
        achieved, above = front.at_least(min(float(y), corners[-1][1]))
        exact = oracles.best_mixture(best, min(Fraction(float(y)), ends[1]))
        assert Fraction(above) >= exact - ENCLOSED
        assert abs(Fraction(achieved) - exact) < SMALL


@given(joints(), st.floats(0, 1))
@settings(max_examples=many(8))
def test_front_and_programme_agree(joint, part):
    front = stl.pareto(joint)
    low, high = front.corners[0].point[1], front.corners[-1].point[1]
    floor = low + part * (high - low) * 0.999
    achieved, above = front.at_least(floor)
    result = stl.tradeoff(joint, "task0", at_least={"task1": floor}, keep_policy=False)
    assert result.policy is None
    assert result.probability == pytest.approx(achieved, abs=1e-7)
    assert result.bound == pytest.approx(above, abs=1e-7)


def factory(name, T=5, tau=6):
    return stl.load_task(FACTORY / "tradeoff.stl", {"T": T, "tau": tau}, name)


@pytest.fixture(scope="module")
def shift(floor5):
    return stl.build_joint_product(floor5, [factory("charging"), factory("patrolling")])


def test_the_factorys_front(shift, floor5):
    """The example of the documentation; ends are the tasks' own optima, and the programme meets every segment."""
    front = stl.pareto(shift)
    assert front.status == "complete"
    assert len(front.corners) >= 3
    for i, task in enumerate(shift.tasks):
        assert front.corners[-i].point[i] == pytest.approx(stl.check(task).probability, abs=1e-12)
    for a, b in itertools.pairwise(front.corners):
        floor = (a.point[1] + b.point[1]) / 2
        result = stl.tradeoff(shift, "charging", at_least={"patrolling": floor}, keep_policy=False)
        assert result.status == "complete"
        assert front.at_least(floor)[0] == pytest.approx(result.probability, abs=1e-7)
        slope = (a.point[0] - b.point[0]) / (b.point[1] - a.point[1])
        assert result.multipliers["patrolling"] == pytest.approx(slope, rel=1e-4)


def test_the_programme_holds_what_is_reachable_and_open(shift):
    """Nine choices a place. Without costs it ends where all is decided; with costs it goes on to the horizon."""
    small = stl.tradeoff(shift, "charging", keep_policy=False).size
    large = stl.tradeoff(shift, "charging", budget={"x": 100.0}, keep_policy=False).size
    model, automaton = shift.model, shift.automaton
    layers = [{(int(s), int(automaton.start.delta[shift.letter[s], 0])) for s in np.flatnonzero(model.initial)}]
    for layer in automaton.layers[:-2]:
        successors = {(n, j) for s, j in layers[-1] for row in oracles.choices(model, s) for n, _ in row}
        layers.append({(n, int(layer.delta[shift.letter[n], j])) for n, j in successors})
    open_ = sum(
        not layer.decided[j] for layer, places in zip(automaton.layers, layers, strict=False) for _, j in places
    )
    assert (small["rows"], large["rows"]) == (open_, sum(map(len, layers)))
    assert open_ < large["rows"]
    assert (small["variables"], large["variables"]) == (9 * small["rows"], 9 * large["rows"])


def test_a_refused_size_is_the_true_one(shift):
    lp = programme(Criteria(shift))
    size, nodes = lp.size, np.concatenate([s for s, _ in lp.nodes])
    successors = [sum(map(len, oracles.choices(shift.model, s))) for s in range(shift.model.n_states)]
    with pytest.raises(SizeError) as caught:
        stl.tradeoff(shift, "charging", most_variables=10)
    told = [int(number) for number in re.findall(r"\d+", str(caught.value))[:3]]
    assert told[:2] == [size["variables"], size["rows"]]
    assert told[2] == size["variables"] + sum(successors[s] for s in nodes) >= size["nonzeros"]


def test_a_bound_on_the_maximised_task_itself(shift):
    free = stl.tradeoff(shift, "charging", keep_policy=False)
    bounded = stl.tradeoff(shift, "charging", at_least={"charging": 0.5}, keep_policy=False)
    assert bounded.probability == pytest.approx(free.probability, abs=1e-12)
    assert bounded.gap < 1e-12


def test_the_solvers_noise_is_no_draw(shift):
    criteria = Criteria(shift)
    lp = programme(criteria)
    x = solve(lp, 0, {}).x
    otherwise = best(criteria, (1, 0))[2]
    clean = policy_of(lp, x, otherwise).row(0)
    first = slice(lp.firsts[0], lp.firsts[1])  # step 0 is reached surely
    x[first] += 1e-10 * np.random.default_rng(0).random(first.stop)
    noisy = policy_of(lp, x, otherwise).row(0)
    assert np.array_equal(noisy, clean)
    assert set(clean.ravel()) == {0.0, 1.0}


def test_points_that_differ_by_rounding_are_one(shift):
    (policy, *_) = stl.pareto(shift, points=2).policies

    def corner(x, y):
        return Corner((Figure(x, x, x), Figure(y, y, y)), (0.5, 0.5), 1.0, policy)

    points = [(0.5, 0.2), (0.5 - 1e-16, 0.6), (0.3, 0.6), (0.2, 0.9), (0.1, 0.9 + 1e-16), (0.2, 0.9)]
    kept = _undominated([corner(*point) for point in points])
    assert [c.point for c in kept] == [(0.5 - 1e-16, 0.6), (0.2, 0.9)]


def test_a_front_that_stops_early_says_so(shift):
    front = stl.pareto(shift, points=3)
    assert front.inductions == 3
    assert front.status == "stopped after 3 points; raise points to continue"
    whole = stl.pareto(shift)
    assert whole.inductions > 3
    assert front.gap > 1e-6
    for corner in whole.corners:  # the gap tells the truth
        achieved, above = front.at_least(corner.point[1])
        assert achieved <= corner.point[0] + 1e-12
        assert above >= corner.point[0] - 1e-12


def test_progress_counts_points_and_constraints(shift):
    calls = []
    stl.pareto(shift, points=3, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]
    calls.clear()
    bounds = {"at_least": {"patrolling": 0.1}, "budget": {"x": 100}}
    stl.tradeoff(shift, "charging", **bounds, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 2), (2, 2)]


# --------------------------------------------------------------------------------------------------- policies


def test_a_joint_policy_survives_its_file(shift, floor5, tmp_path):
    result = stl.tradeoff(shift, "charging", at_least={"patrolling": 0.3})
    path = tmp_path / "policy.npz"
    result.policy.save(path)
    assert result.policy.kind == "time-dependent, mixed"
    for name in ("charging", "patrolling"):
        for encoding in ("exact", "paper"):
            product = stl.build_product(floor5, factory(name), encoding)
            again = stl.load_policy(path, product)
            assert np.array_equal(again.table, result.policy.table)
            value = stl.check(product, again).probability
            assert value == pytest.approx(result.probabilities[name].value, abs=1e-12)
            run = stl.sample_run(product, again, seed=0)
            assert len(run.states) > 1
    other = stl.build_product(floor5, stl.parse("F[0,5) A"))
    with pytest.raises(PolicyError, match=r"is for the task F\[0.* and the task G\[0.*, not for F\[0,4\] A"):
        stl.load_policy(path, other)
    timed = np.zeros((shift.horizon, *shift.shape), dtype=int)
    both = stl.Policy(shift, timed)
    first = stl.Policy(shift, timed[0])
    for task in shift.tasks:
        assert stl.check(task, both).probability == stl.check(task, first).probability


def test_a_policy_with_a_budget_over_one_task_survives_too(floor5, tmp_path):
    joint = stl.build_joint_product(floor5, [factory("charging")])
    assert joint.task("charging") == 0
    result = stl.tradeoff(joint, "charging", budget={"A": 1.0})
    assert result.costs["A"].upper <= 1.0
    result.policy.save(tmp_path / "policy.npz")
    again = stl.load_policy(tmp_path / "policy.npz", joint.tasks[0])
    assert stl.check(joint.tasks[0], again).probability == pytest.approx(result.probability, abs=1e-12)


def test_a_header_with_tasks_that_are_no_texts_is_refused(shift, tmp_path):
    path = tmp_path / "policy.npz"
    result = stl.tradeoff(shift, "charging")
    result.policy.save(path)
    with np.load(path) as archive:
        header, table = json.loads(archive["header"].tobytes()), archive["table"]
    for tasks, says in (([1, 2], "not a policy file"), (header["tasks"][::-1], "made with another automaton")):
        changed = json.dumps({**header, "tasks": tasks}).encode()
        np.savez(path, header=np.frombuffer(changed, dtype=np.uint8), table=table)
        with pytest.raises(PolicyError, match=says):
            stl.load_policy(path, shift.tasks[0])


# --------------------------------------------------------------------------------------------------- bad input


def test_what_one_constraint_makes_impossible(shift):
    most = stl.check(shift.tasks[1]).probability
    with pytest.raises(InfeasibleError) as caught:
        stl.tradeoff(shift, "charging", at_least={"patrolling": 0.99})
    assert str(caught.value) == f"P(patrolling) >= 0.99 cannot be met: its maximum is {most:.6g}"
    just_over = most + 1e-10
    with pytest.raises(InfeasibleError) as caught:
        stl.tradeoff(shift, "charging", at_least={"patrolling": just_over})
    assert float(str(caught.value).split()[-1]) < just_over
    exactly = stl.tradeoff(shift, "charging", at_least={"patrolling": most})
    assert exactly.probabilities["patrolling"].value == pytest.approx(most, abs=1e-9)


def test_what_constraints_make_impossible_together(shift):
    charge, patrol = (stl.check(task).probability for task in shift.tasks)
    with pytest.raises(InfeasibleError) as caught:
        stl.tradeoff(shift, "charging", at_least={"charging": charge, "patrolling": patrol})
    most = stl.tradeoff(shift, "patrolling", at_least={"charging": charge}).probability
    beginning, _, figure = str(caught.value).rpartition(" ")
    assert beginning == (
        f"P(charging) >= {charge!r} and P(patrolling) >= {patrol!r} cannot be met together: "
        f"with P(charging) >= {charge!r}, P(patrolling) is at most"
    )
    assert float(figure) == pytest.approx(most, abs=1e-6)
    with pytest.raises(InfeasibleError, match=r"with P\(patrolling\) >= 0.3, E\[A\] is at least [0-9.]+$"):
        stl.tradeoff(shift, "charging", at_least={"patrolling": 0.3}, budget={"A": 0.1})
    with pytest.raises(InfeasibleError, match=r"^E\[x\] <= 0.1 cannot be met: its minimum is [0-9.]+$"):
        stl.tradeoff(shift, "charging", budget={"x": 0.1})


def test_a_contradiction_among_three_names_the_first(floor5):
    tasks = {name: stl.parse(f"F[0,4] G[0,1] {name}") for name in ("A", "B", "C")}
    joint = stl.build_joint_product(floor5, tasks)
    with pytest.raises(InfeasibleError, match=r"P\(A\) >= 0.9 and P\(B\) >= 0.9 cannot be met together"):
        stl.tradeoff(joint, "C", at_least={"A": 0.9, "B": 0.9, "C": 0.9})


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ({"objective": "chargin"}, NameLookupError, "there is no task chargin; did you mean charging?"),
        ({"at_least": {"resting": 0.5}}, NameLookupError, "there is no task resting"),
        ({"at_least": {"patrolling": 1.5}}, SettingsError, r"P\(patrolling\) >= 1.5: give a probability between"),
        ({"at_least": {"patrolling": float("nan")}}, SettingsError, "at_least of patrolling is nan; a finite number"),
        ({"budget": {"x": -1}}, SettingsError, r"E\[x\] <= -1.0: give a finite budget"),
        ({"budget": {"x": float("inf")}}, SettingsError, "finite"),
        ({"budget": {"z": 1}}, NameLookupError, "the model has no signal z for this cost; known names: A, B, C, x, y"),
        ({"most_variables": 10}, SizeError, r"a linear programme of \d+ variables, .* over the limit of 10 variables"),
    ],
)
def test_bad_arguments(shift, arguments, error, says):
    with pytest.raises(error, match=says):
        stl.tradeoff(shift, **{"objective": "charging", **arguments})


def test_bad_tasks_and_fronts(floor5, shift):
    charging = factory("charging")
    with pytest.raises(SettingsError, match="two tasks are called charging"):
        stl.build_joint_product(floor5, [charging, factory("charging", T=3)])
    with pytest.raises(SettingsError, match=r"F\[0,3\] A has no name"):
        stl.build_joint_product(floor5, [stl.parse("F[0,3] A")])
    with pytest.raises(SettingsError, match="no task"):
        stl.build_joint_product(floor5, [])
    with pytest.raises(SettingsError, match="needs exactly two tasks, found 1"):
        stl.pareto(stl.build_joint_product(floor5, [charging]))
    for options, says in (
        ({"points": 1}, "give at least 2, the best corner for each task"),
        ({"tolerance": 0}, "tolerance is 0.0"),
        ({"tolerance": float("nan")}, "tolerance is nan; a finite number"),
    ):
        with pytest.raises(SettingsError, match=says):
            stl.pareto(shift, **options)
    front = stl.pareto(shift)
    assert front.at_least(0.999999) is None
    with pytest.raises(SettingsError, match="give a probability between 0 and 1"):
        front.at_least(1.5)


def test_negative_costs_are_refused():
    model = stl.MDP.from_arrays([[[0, 1], [1, 0]]], {"x": [0, -2.5]}, 0, {"A": [1, 0]})
    joint = stl.build_joint_product(model, {"task": stl.parse("F[0,3] A")})
    with pytest.raises(SettingsError, match=r"signal x is -2.5 in state 1, but a cost must be at least 0"):
        stl.tradeoff(joint, "task", budget={"x": 1})


def test_sizes_are_refused_before_memory_is_taken(floor5):
    with pytest.raises(SizeError, match=r"a joint automaton of 11 automaton states over \d+ steps would take"):
        stl.build_joint_product(floor5, {"long": stl.parse("G[0,10^12) F[0,10) A")})
    tasks = {f"within {tau}": factory("patrolling", T=tau, tau=tau) for tau in (9, 10)}
    with pytest.raises(SizeError, match=r"a joint automaton of 82 × 101 automaton states over 18 steps would take"):
        stl.build_joint_product(floor5, tasks, memory_limit=60_000)


def test_a_solver_that_gives_up_is_named(shift):
    lp = programme(Criteria(shift))
    with pytest.raises(SolverError, match=r"programme of \d+ variables and \d+ rows: HiGHS found no optimum within 1 "):
        solve(lp, 0, {1: 0.1}, most_iterations=1)
    with pytest.raises(SolverError, match=r"HiGHS found no optimum \(infeasible\); shorten the windows"):
        solve(lp, 0, {1: 1.5})


def test_the_solver_prints_nothing(shift, capfd):
    """Nor does what it is written in, which knows descriptors, not sys.stdout."""
    stl.tradeoff(shift, "charging", at_least={"patrolling": 0.1})
    assert capfd.readouterr() == ("", "")


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.99), st.floats(0, 0.99))
@settings(max_examples=many(8))
def test_the_programme_agrees_with_another_solver_and_with_its_own_multipliers(seed, part, other):
    """An interior-point solver finds the same value; the multipliers' bound, by backward induction, meets it."""
    import cvxpy as cp

    rng = np.random.default_rng(seed)
    transitions = rng.random((3, 5, 5)) * (rng.random((3, 5, 5)) < 0.5) + 0.01 * np.eye(5)
    transitions /= transitions.sum(axis=2, keepdims=True)
    labels = {name: rng.random(5) < 0.4 for name in "abc"}
    model = stl.MDP.from_arrays(transitions, {"fuel": rng.choice([0.0, 0.5, 1.0, 3.0], 5)}, 0, labels)
    tasks = {"visits": stl.parse("G[0,4] F[0,2] (a | b)"), "safe": stl.parse("(!c) U[0,5] b")}
    joint = stl.build_joint_product(model, tasks)
    criteria = Criteria(joint, ("fuel",))
    lp = programme(criteria)
    assume(lp.size["variables"] > 0)
    # between what the best policy of the objective has of each, and the best of either alone: near the front
    own, tops = ([figure.value for figure in figures] for figures in (
        best(criteria, (1, 0, 0))[1], [best(criteria, np.eye(3)[i])[0] for i in range(3)]
    ))  # fmt: skip
    bounds = {i: (own[i] + share * (tops[i] - own[i])) * 0.999 for i, share in ((1, part), (2, other))}
    x = cp.Variable(lp.size["variables"], nonneg=True)
    values = lp.reward @ x + lp.constant
    problem = cp.Problem(
        cp.Maximize(values[0]), [lp.flow @ x == lp.inflow, *(values[i] >= bound for i, bound in bounds.items())]
    )
    problem.solve(solver=cp.CLARABEL)
    if problem.status == cp.INFEASIBLE:
        with pytest.raises(SolverError, match="infeasible"):
            solve(lp, 0, bounds)
        return
    found = solve(lp, 0, bounds)
    value = lp.reward[[0]].toarray()[0] @ found.x + lp.constant[0]
    assert value == pytest.approx(problem.value, abs=1e-6)
    assert ((lp.reward @ found.x + lp.constant)[1:] >= np.array(list(bounds.values())) - 1e-8).all()
    weights = (1.0, *found.multipliers)
    upper = best(criteria, weights)[0].upper - np.dot(weights[1:], list(bounds.values()))
    assert value - 1e-9 <= upper <= value + 1e-6


def test_tasks_that_the_first_state_decides(floor5):
    joint = stl.build_joint_product(floor5, {"here": stl.parse("A"), "not": stl.parse("!A")})
    result = stl.tradeoff(joint, "not", at_least={"here": 0.0}, budget={"x": 0.0})
    assert (result.probability, result.bound, result.size["variables"]) == (1, 1, 0)
    assert result.gap < 1e-14
    assert stl.check(joint.tasks[1], result.policy).probability == 1
    with pytest.raises(InfeasibleError, match=r"P\(here\) >= 0.1 cannot be met: its maximum is 0$"):
        stl.tradeoff(joint, "not", at_least={"here": 0.1})
    front = stl.pareto(joint)
    assert [corner.point for corner in front.corners] == [(0, 1)]


def test_cost_scales_do_not_matter(floor5):
    """The same budget in another unit: the same policy's value, the multiplier in that unit."""
    results = []
    for scale in (1.0, 1e6, 1e-6):
        signals = {**floor5.signals, "watt": floor5.signals["x"] * scale}
        model = stl.MDP.from_arrays(dense(floor5), signals, floor5.initial, floor5.labels, floor5.action_names)
        joint = stl.build_joint_product(model, [factory("charging"), factory("patrolling")])
        result = stl.tradeoff(joint, "charging", budget={"watt": 3.0 * scale})
        assert result.gap < 1e-6
        results.append((result.probability, result.multipliers["watt"] * scale))
    assert results[1] == pytest.approx(results[0], abs=1e-6)
    assert results[2] == pytest.approx(results[0], abs=1e-6)


def test_the_edge_of_the_front_can_be_reached():
    """A bound at the corner itself is not out of reach, though the corner's figure is rounded."""
    x, y = Fraction(3, 7), Fraction(1, 7)
    rows = np.array([[[1 - x, x, 0], [1 - y, 0, y], [0, 0, 1]]], dtype=object)
    model = stl.MDP.from_arrays(rows, {}, labels={"a": [0, 0, 1]})
    front = stl.pareto(stl.build_joint_product(model, {"T": stl.parse("true"), "A": stl.parse("F[0,2] a")}))
    achieved, bound = front.at_least(float(Fraction(3, 49)))
    assert achieved == pytest.approx(1)
    assert bound >= 1 - 1e-12


def test_rare_tasks_have_fronts_too():
    p = 9e-13
    first, second = ([[0, p, 0, 1 - p], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]] for _ in range(2))
    second[0] = [0, 0, p, 1 - p]
    model = stl.MDP.from_arrays([first, second], {}, labels={"a": [0, 1, 0, 0], "b": [0, 0, 1, 0]})
    joint = stl.build_joint_product(model, {"A": stl.parse("F[0,1] a"), "B": stl.parse("F[0,1] b")})
    front = stl.pareto(joint)
    assert [corner.point for corner in front.corners] == [(p, 0), (0, p)]
    assert front.at_least(p / 2)[0] == pytest.approx(p / 2)


def test_costs_that_overflow_and_names_that_clash(floor5):
    model = dataclasses.replace(floor5, signals={**floor5.signals, "g": np.full(18, 1e308)})
    joint = stl.build_joint_product(model, {"one": stl.parse("F[0,3] A"), "A": stl.parse("F[0,3] B")})
    with pytest.raises(SettingsError, match="cost g is up to 1e.308 per step; scale the signal"):
        stl.tradeoff(joint, "one", budget={"g": 1e308})
    with pytest.raises(SettingsError, match="A is the name of both a task and a cost; rename the task"):
        stl.tradeoff(joint, "one", at_least={"A": 0.0}, budget={"A": 1.0})
