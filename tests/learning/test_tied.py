"""Bounds if rows are tied by parameters: evidence in fractions, coverage with an adversary, and the alarm."""

import itertools
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import binomtest

import stltool as stl
from stltool.errors import SettingsError, TieError
from stltool.learning.counts import Counts
from stltool.learning.tied import _OFFSETS, Evidence, _Likelihood, _log_mean
from stltool.models.environment import simulator
from tests.conftest import FACTORY, many
from tests.learning.test_guarantee import counts_of, sampled

FLOOR = stl.load_model(FACTORY / "floor-5x5.toml")


@pytest.fixture(scope="module")
def patrolling():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    return stl.build_product(FLOOR, task)


def walls(success="1/4"):
    """Two cells: every row merges outcomes that a wall sends back."""
    table = {"kind": "grid", "map": "SA", "success": success, "slip": f"{(1 - Fraction(success)) / 3}"}
    return stl.models.grid.grid_from_table(table)


@pytest.mark.parametrize("success", ["1/4", "3/5"])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_evidence_is_a_supermartingale_from_one(success, sign):
    """E[M_n] <= 1 over all sequences of six steps, with choices that depend on what was seen; merged outcomes count
    once."""
    model, steps = walls(success), 6
    family, x = model.family, float(Fraction(success))
    exact = model.exact()
    rows = [
        [(int(model.target[k]), Fraction(int(exact.numerator[k]), exact.denominator)) for k in range(a, b)]
        for a, b in itertools.pairwise(model.row_start.tolist())
    ]
    for n in range(1, steps + 1):
        total = 0.0
        for moves in itertools.product(range(2), repeat=n):
            chance, s, seen = Fraction(1), 0, []
            for t, move in enumerate(moves):
                c = int(model.choice_start[s]) + (3 * sum(moves[:t]) + 4 * t) % 9  # adaptive
                if move >= len(rows[c]):
                    chance = Fraction(0)
                    break
                s2, p = rows[c][move]
                chance, s = chance * p, s2
                seen.append((c, s2, 1))
            if chance:
                evidence = Evidence(family, counts_of(model, merged(seen)))
                likelihood = _Likelihood(evidence._ends, evidence._class, evidence._seen)
                here = float(likelihood(np.array([x]))[0])
                total += float(chance) * float(np.exp(_log_mean(likelihood(x + sign * _OFFSETS)) - here))
        assert total <= 1 + 1e-9
    assert total > 0.1  # it is not vacuous


def merged(seen):
    known = {}
    for c, s, n in seen:
        known[c, s] = known.get((c, s), 0) + n
    return [(c, s, n) for (c, s), n in known.items()]


def test_a_set_ends_where_the_evidence_reaches_the_level():
    counts = sampled(FLOOR, np.random.default_rng(0), np.full(FLOOR.n_choices, 20))
    evidence = Evidence(FLOOR.family, counts)
    (found,) = evidence.sets(Fraction(1, 100))
    assert 0.85 < found.lower < found.estimate < found.upper < 0.97
    likelihood = _Likelihood(evidence._ends, evidence._class, evidence._seen)
    for end, sign in ((float(found.lower), 1), (float(found.upper), -1)):
        inward = _log_mean(likelihood(end + sign * (_OFFSETS + 1e-9))) - likelihood(np.array([end + sign * 1e-9]))[0]
        outward = _log_mean(likelihood(end + sign * _OFFSETS)) - likelihood(np.array([end]))[0]
        assert inward < np.log(200) <= outward < np.log(200) + 1e-6
    informative = [c for c in range(FLOOR.n_choices) if FLOOR.action_names[FLOOR.choice_action[c]] != "stay"]
    assert found.transitions <= 20 * len(informative)


@pytest.mark.parametrize(("wins", "tries"), [(0, 0), (1, 1), (0, 1), (50, 50), (0, 50)])
def test_extreme_data(wins, tries):
    rows = [[["p", "1-p"], [0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}, parameters={"p": ("1/10", "9/10")})
    (found,) = Evidence(model, counts_of(model, [(0, 0, wins), (0, 1, tries - wins)])).sets(Fraction(1, 20))
    low, high = float(found.lower), float(found.upper)
    assert 0.1 <= low <= float(found.estimate) <= high <= 0.9
    if tries < 2:
        assert (low, high) == (0.1, 0.9)
    elif wins:
        assert low > 0.75
        assert high == 0.9
    else:
        assert low == 0.1
        assert high < 0.25
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    bound = stl.guarantee(product, None, counts_of(model, [(0, 0, wins), (0, 1, tries - wins)]), confidence=0.95,
                          parameters="model")  # fmt: skip
    assert bound.lower == pytest.approx(1 - high**3, abs=1e-6)
    assert bound.lower <= 1 - high**3


@pytest.mark.soak
@pytest.mark.parametrize("p", ["93/100", "1/2"])
def test_sets_are_ever_wrong_no_more_often_than_stated(p):
    """An adversary tries moves of the first state in turn, or any at random, and stops as soon as the set is wrong."""
    model, family, wrong, x = FLOOR.at(success=p), FLOOR.family.rows, 0, float(Fraction(p))
    ties = FLOOR.family.source.ties
    ends = np.array([(float(a), float(b)) for _, a, b in ties.classes])
    which, start, chances = family.tied_class, family.row_start, family.tied_at({"success": Fraction(p)})
    told = ends[:, 0] != ends[:, 1]
    for seed in range(many(20)):
        rng, seen = np.random.default_rng(seed), np.zeros(len(ends), dtype=np.int64)
        for n in range(400):
            c = int(rng.integers(model.n_choices)) if seed % 2 else 1 + n % 8
            a, b = start[c : c + 2]
            seen[which[a + int(rng.choice(b - a, p=chances[a:b] / chances[a:b].sum()))]] += 1
            likelihood = _Likelihood(ends, np.flatnonzero(told), seen[told])
            if likelihood._refused(x, 1, np.log(10)) or likelihood._refused(x, -1, np.log(10)):  # α/2 = 1/10 each
                wrong += 1
                break
    assert binomtest(wrong, many(20), 0.2, "greater").pvalue > 1e-4


def test_bounds_are_above_those_of_untied_rows_and_below_the_truth(patrolling):
    run = stl.learn(patrolling, "model-based", episodes=100, seed=0)
    exact = stl.check(patrolling, run.policy).lower
    tied, known = (
        stl.guarantee(patrolling, run.policy, run.counts, **how)
        for how in ({"parameters": "model"}, {"support": "known"})
    )
    assert known.lower + 0.1 < tied.lower <= exact
    (found,) = tied.parameters
    assert found.lower <= Fraction(93, 100) <= found.upper
    best = stl.guarantee(patrolling, None, run.counts, parameters="model")
    assert best.lower >= tied.lower
    assert stl.check(patrolling, best.policy).upper >= best.lower
    assert "known up to success, the same everywhere, which the data do not contradict" in tied.statement
    assert "not tested" in stl.guarantee(
        patrolling, run.policy, run.counts, parameters="model", test_tie=False).assumes  # fmt: skip
    # the least over the set, not anything weaker: as at 101 points
    least = min(
        stl.parametric(patrolling, run.policy).at(found.lower + (found.upper - found.lower) * i / 100)[0]
        for i in range(101)
    )
    assert least - 1e-6 <= tied.lower <= least


def test_the_files_probabilities_are_never_read(patrolling):
    run = stl.learn(patrolling, "model-based", episodes=30, seed=1)
    bounds = set()
    for success in ("93/100", "1/3", 1):
        product = replace(patrolling, model=FLOOR.at(success=success))
        found = stl.guarantee(product, stl.Policy(product, run.policy.form), run.counts, parameters="model")
        bounds.add((found.lower, *found.parameters, found.evidence))
    assert len(bounds) == 1


def test_a_bound_where_p_is_not_monotone():
    """One action wins with p, the other with 1 − p: the least P is inside the set."""
    rows = [[["0", "p", "1-p", 0], [0, "p", 0, "1-p"], [0, 0, "1-p", "p"], [0, 0, 0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"out": [0, 0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("G[0,2] !out"))
    counts = counts_of(model, [(0, 1, 55), (0, 2, 45)])
    found = stl.guarantee(product, None, counts, parameters="model")
    (one,) = found.parameters
    assert one.lower < Fraction(1, 2) < one.upper
    assert 0.5 - 1e-6 <= found.lower <= 0.5  # nature that picks p again could have 2·p·(1−p) at opposite ends
    assert found.policy.home is product


def test_several_parameters_share_the_error():
    rows = [[["p", "1-p", 0], ["q", 0, "1-q"], [0, 0, 1]]]
    family = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1), "q": (0, 1)})
    counts = counts_of(family, [(0, 0, 30), (0, 1, 70), (1, 0, 20), (1, 2, 80)])
    product = stl.build_product(family, stl.parse("F[0,4] A"))
    found = stl.guarantee(product, None, counts, parameters="model")
    both, alone = found.parameters, []
    for name, row in (("p", 0), ("q", 1)):
        other = {"p": "q", "q": "p"}[name]
        single = stl.MDP.from_family(
            lambda p, name=name, other=other: family.at(**{name: p, other: "1/2"}), {"p": (0, 1)}
        )
        own = counts_of(family, [(c, s, n) for c, s, n in zip(counts.choice, counts.target, counts.seen, strict=True)
                                 if c == row])  # fmt: skip
        alone += Evidence(single, own).sets(Fraction(1, 200))
    assert [(one.lower, one.upper) for one in both] == [(one.lower, one.upper) for one in alone]
    worst = stl.check(stl.build_product(family.at(p=both[0].upper, q=both[1].upper), product.formula))
    assert found.lower == pytest.approx(worst.lower, abs=1e-9)  # here both are worst where they are greatest
    assert found.lower <= worst.upper


def test_data_that_contradict_the_tie_are_refused(patrolling):
    """One cell succeeds in 6 of 10 moves instead of 93 of 100."""
    worse, broken = FLOOR.at(success="3/5"), 8
    probability = FLOOR.probability.copy()
    a, b = FLOOR.row_start[FLOOR.choice_start[broken : broken + 2]]
    probability[a:b] = worse.probability[a:b]
    strange = FLOOR.with_rows(probability=probability, exact=None)
    rng = np.random.default_rng(0)
    env, counts = simulator(strange, rng), Counts(FLOOR.n_choices, FLOOR.n_states)
    state = env.reset()
    for _ in range(4000):
        i = int(rng.integers(9))
        after = env.step(i)
        counts.add([int(FLOOR.choice_start[state]) + i], [after])
        state = after
    with pytest.raises(TieError, match=r"contradict.* most clearly in state \(4,3\)") as refused:
        stl.guarantee(patrolling, None, counts, parameters="model")
    assert FLOOR.state_name(broken) == "(4,3)"
    assert "support='known'" in str(refused.value)
    assert stl.guarantee(patrolling, None, counts, parameters="model", test_tie=False).evidence is None
    assert stl.guarantee(patrolling, None, counts, support="known").lower >= 0


def test_an_alarm_that_rang_stays(patrolling):
    """What contradicts the tie is made up for later, so that its frequencies are right in the end."""
    states = np.repeat(np.arange(FLOOR.n_states), np.diff(FLOOR.choice_start))
    counts = sampled(FLOOR, np.random.default_rng(0), np.where(states == 8, 0, 40))
    choice = int(FLOOR.choice_start[8]) + 1
    row = slice(*FLOOR.row_start[choice : choice + 2].tolist())
    meant = int(FLOOR.target[row][FLOOR.probability[row].argmax()])
    slip = int(FLOOR.target[row][FLOOR.probability[row].argmin()])
    counts.add([choice] * 30, [slip] * 30)
    with pytest.raises(TieError) as first:
        stl.guarantee(patrolling, None, counts, parameters="model", confidence=0.9)
    counts.add([choice] * 400, [meant] * 400)
    again = Counts(counts.n_choices, counts.n_states)
    again.add(np.repeat(counts.choice, counts.seen), np.repeat(counts.target, counts.seen))
    assert stl.guarantee(patrolling, None, again, parameters="model", confidence=0.9).evidence < 10  # nobody had looked
    policy = stl.check(patrolling).policy
    for confidence in (0.9, 0.99):
        for ask in (stl.guarantee, stl.optimality_gap):
            with pytest.raises(TieError) as later:
                ask(patrolling, policy, counts, parameters="model", confidence=confidence)
            assert str(later.value).partition("(refused")[0] == str(first.value).partition("(refused")[0]
    assert stl.guarantee(patrolling, None, counts, parameters="model", test_tie=False).lower > 0


@pytest.mark.soak
def test_the_alarm_is_silent_where_the_tie_is_right():
    alarms = 0
    for seed in range(many(20)):
        counts = sampled(FLOOR, np.random.default_rng(seed), np.full(FLOOR.n_choices, 5))
        alarms += Evidence(FLOOR.family, counts).against_the_tie[0] >= np.log(5)
    assert binomtest(alarms, many(20), 0.2, "greater").pvalue > 1e-4


def test_fresh_runs_can_help(patrolling):
    run = stl.learn(patrolling, "model-based", episodes=50, seed=0)
    fresh = stl.estimate(patrolling, run.policy, runs=2000, side="lower", seed=3)
    for how in ({"parameters": "model"}, {"support": "known"}, {}):
        both = stl.guarantee(patrolling, run.policy, run.counts, fresh=fresh, confidence=0.99, **how)
        alone = stl.guarantee(patrolling, run.policy, run.counts, confidence=0.995, **how)
        half, _ = stl.checking.statistical.clopper_pearson(fresh.satisfied, fresh.runs, Fraction(995, 1000), "lower")
        assert both.lower == max(alone.lower, half)
        assert both.confidence == 0.99
        assert "2000 fresh runs" in both.statement
        assert both.assumes == f"{alone.assumes}; the runs are independent of each other and of the learning"
    with pytest.raises(SettingsError, match="fresh runs are those of one policy"):
        stl.guarantee(patrolling, None, run.counts, fresh=fresh)


def test_successors_may_be_given_for_a_black_box(patrolling):
    run = stl.learn(patrolling, "model-based", episodes=60, seed=0)
    hidden = stl.MDP.black_box(
        FLOOR.n_states,
        FLOOR.action_names,
        lambda rng: simulator(FLOOR, rng),
        signals=FLOOR.signals,
        labels=FLOOR.labels,
    )
    product = stl.build_product(hidden, patrolling.formula)
    graph = np.zeros((FLOOR.n_choices, FLOOR.n_states), dtype=bool)
    graph[np.repeat(np.arange(FLOOR.n_choices), np.diff(FLOOR.row_start)), FLOOR.target] = True
    known = stl.guarantee(patrolling, None, run.counts, support="known")
    start = int(np.flatnonzero(FLOOR.initial)[0])
    first = FLOOR.choice_start

    def possible(s, a):
        return np.flatnonzero(graph[first[s] + a])

    for successors in (graph, graph.astype(int), possible):
        found = stl.guarantee(product, None, run.counts, successors=successors, start=start)
        assert found.lower == known.lower
        assert found.support == "given"
        assert "among those given" in found.statement
    more = graph.copy()
    more[:, 0] = True  # a superset is sound, and costs
    wider = stl.guarantee(product, None, run.counts, successors=more, start=start)
    unknown = stl.guarantee(product, None, run.counts, start=start)
    assert unknown.lower <= wider.lower <= known.lower
    assert stl.guarantee(patrolling, None, run.counts, successors=more).lower == wider.lower


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"successors": np.ones((3, 3))}, r"successors are of shape \(3, 3\); give \(162, 18\) Booleans"),
        ({"successors": lambda s, a: [99]}, r"state \(0,4\), action stay: successors are not indices of states"),
        ({"successors": lambda s, a: 3}, "did not return a list of states"),
        ({"successors": lambda s, a: []}, "no successor is given"),
        ({"successors": lambda s, a: [s]}, "which is not among the successors given"),
        ({"parameters": "all"}, "parameters is 'all'; choose model"),
        ({"parameters": "model", "successors": lambda s, a: [s]}, "leave out successors or parameters"),
    ],
)
def test_what_does_not_fit_is_refused(patrolling, options, says):
    run = stl.learn(patrolling, "model-based", episodes=3, seed=0)
    with pytest.raises(SettingsError, match=says):
        stl.guarantee(patrolling, None, run.counts, **options)


def test_a_model_without_parameters_has_none():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    with pytest.raises(SettingsError, match="do not depend on parameters"):
        stl.guarantee(product, None, Counts(2, 2), parameters="model")
    impossible = counts_of(FLOOR, [(0, 17, 1)])
    with pytest.raises(SettingsError, match="impossible for every value of success"):
        Evidence(FLOOR.family, impossible)
