"""Gaps to the optimum from data: against exact checks, members of the set, and runs that stop when they may."""

import importlib
import itertools
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import binomtest

import stltool as stl
from stltool.errors import SettingsError, TieError
from stltool.learning.counts import Counts
from stltool.learning.gap import Certifier, UntiedGaps, due
from stltool.learning.guarantee import interval_model
from stltool.learning.tied import Evidence
from stltool.models.environment import simulator
from stltool.reporting import render, report_data
from tests import oracles
from tests.conftest import FACTORY, many
from tests.learning.test_guarantee import counts_of, sampled
from tests.reporting.svg import Picture

FLOOR = stl.load_model(FACTORY / "floor-5x5.toml")


@pytest.fixture(scope="module")
def patrolling():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    return stl.build_product(FLOOR, task)


def mutated(policy, t, s, q):
    """Another action at one place."""
    table = np.stack([policy.row(step) for step in range(policy.home.horizon)])
    table = np.maximum(table, 0)
    table[t, s, q] = (table[t, s, q] + 1) % 9
    return stl.Policy(policy.home, table)


def test_the_tied_gap_is_the_greatest_difference_on_the_set(patrolling):
    counts = sampled(FLOOR, np.random.default_rng(0), np.full(FLOOR.n_choices, 3))
    best = stl.check(patrolling).policy
    start = int(np.flatnonzero(FLOOR.initial)[0])
    q = patrolling.enter(start, patrolling.automaton.initial)
    for policy in (None, best, mutated(best, 0, start, q)):
        found = stl.optimality_gap(patrolling, policy, counts, parameters="model")
        (known,) = found.parameters
        differences = []
        for i in range(21):
            p = known.lower + (known.upper - known.lower) * i / 20
            member = replace(patrolling, model=FLOOR.at(success=p))
            own = stl.check(member, stl.Policy(member, found.policy.form)).probability
            differences.append(stl.check(member).probability - own)
        assert max(differences) - 1e-12 <= found.upper <= 1.2 * max(differences) + 1e-6
    assert found.upper > 1e-3  # the mutated policy is not optimal
    assert "(from none: " in found.statement
    assert "the same everywhere" in found.assumes


def test_the_set_may_contain_a_crossing():
    """With p one action is better, without it the other: near the crossing neither is proved to be best."""
    rows = [[["p", "1-p", 0], [0, 1, 0], [0, 0, 1]], [["1/2", 0, "1/2"], [0, 1, 0], [0, 0, 1]]]
    rows[0][0] = ["0", "1-p", "p"]
    rows[1][0] = ["0", "1/2", "1/2"]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    for wins, losses in ((5, 5), (80, 20), (20, 80)):
        counts = counts_of(model, [(0, 1, losses), (0, 2, wins)])
        found = stl.optimality_gap(product, None, counts, parameters="model")
        (known,) = found.parameters
        action = int(found.policy.row(0)[0, product.enter(0, product.automaton.initial)])
        worst = max(known.upper - Fraction(1, 2), 0) if action == 1 else max(Fraction(1, 2) - known.lower, 0)
        assert found.upper == pytest.approx(float(worst), abs=1e-6)
        assert found.upper >= worst


def two_parameters():
    """Success p where the floor is dry, q where it is wet; both actions of a state share one of them."""
    rows = [
        [["1-p", "p", 0, 0], [0, "q", "1-q", 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [["p", 0, "1-p", 0], ["1-q", 0, 0, "q"], [0, 0, 1, 0], [0, 0, 0, 1]],
    ]
    return stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 0, 1]}, parameters={"p": (0, 1), "q": ("1/4", 1)})


@pytest.mark.parametrize("seed", range(many(10)))
def test_the_gap_of_several_parameters_holds_on_their_box(seed):
    rng, model = np.random.default_rng(seed), two_parameters()
    product = stl.build_product(model, stl.parse("F[0,4] A"))
    member = model.at(p="2/5", q="3/5")
    counts = sampled(member, rng, np.full(model.n_choices, int(rng.integers(5, 400))))
    policy = stl.Policy(product, rng.integers(2, size=(product.horizon, *product.shape))) if seed % 2 else None
    found = stl.optimality_gap(product, policy, counts, parameters="model", confidence=0.5)
    box = [[one.lower + (one.upper - one.lower) * i / 6 for i in range(7)] for one in found.parameters]
    gaps = []
    for p, q in itertools.product(*box):
        there = replace(product, model=model.at(p=p, q=q))
        gaps.append(stl.check(there).probability - stl.check(there, stl.Policy(there, found.policy.form)).probability)
    assert max(gaps) - 1e-12 <= found.upper <= found.without_data + 1e-12 or policy is not None
    assert max(gaps) - 1e-12 <= found.upper
    assert found.looser.startswith("bounded row by row, as if each row had a value of 2 parameters of its own")
    assert found.looser in found.statement
    if policy is None:  # optimal at the estimates
        there = replace(product, model=model.at(**{one.name: one.estimate for one in found.parameters}))
        best = stl.check(there).probability
        assert stl.check(there, stl.Policy(there, found.policy.form)).probability == pytest.approx(best, abs=1e-12)


def test_row_by_row_the_actions_of_a_state_share_their_parameter():
    """Both actions succeed with p: nothing is lost by either, whatever p is, and row by row proves it."""
    rows = [[["1-p", "p", 0], [0, 1, 0], ["q", 0, "1-q"]], [["1-p", "p", 0], [0, 1, 0], ["q", 0, "1-q"]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1, 0]}, parameters={"p": (0, 1), "q": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    counts = counts_of(model, [(0, 1, 3), (0, 0, 3)])
    assert stl.optimality_gap(product, None, counts, parameters="model").upper < 1e-9
    best = stl.check(replace(product, model=model.at(p=1, q=1))).policy
    assert UntiedGaps(product, 0.99).of(counts, stl.Policy(product, best.form)).upper > 0.5


def test_a_polynomial_that_takes_too_long_is_said_to(patrolling, monkeypatch):
    counts = sampled(FLOOR, np.random.default_rng(0), np.full(FLOOR.n_choices, 3))
    best = stl.check(patrolling).policy
    together = stl.optimality_gap(patrolling, best, counts, parameters="model")
    assert together.looser is None
    monkeypatch.setattr(importlib.import_module("stltool.learning.guarantee"), "_MOST_WORK", 1e3)
    rows = stl.optimality_gap(patrolling, best, counts, parameters="model")
    assert rows.upper > together.upper
    assert rows.upper < stl.optimality_gap(patrolling, best, counts).upper
    assert "multiply-adds, more than 1e+03" in rows.looser
    assert rows.looser in rows.statement
    assert rows.parameters == together.parameters


def test_a_tied_and_an_untied_gap_share_the_error(patrolling):
    """While learning, either of the two may be given, and both may be wrong: each has half."""
    certifier = Certifier(patrolling, patrolling, counts := Counts(FLOOR.n_choices, FLOOR.n_states), 0.01, 0.9)
    learners = stl.check(patrolling).policy
    few = sampled(FLOOR, np.random.default_rng(0), np.full(FLOOR.n_choices, 3))
    counts.add(np.repeat(few.choice, few.seen), np.repeat(few.target, few.seen))
    found = certifier(lambda: learners.form)
    assert found.parameters == Evidence(FLOOR.family, counts).sets(Fraction(1, 20))
    assert (found.confidence, found.refused) == (0.9, None)
    odd = odd_cell()
    counts.add(np.repeat(odd.choice, odd.seen), np.repeat(odd.target, odd.seen))
    found = certifier(lambda: learners.form)
    assert found.upper == UntiedGaps(patrolling, Fraction(95, 100)).of(counts, learners).upper
    assert found.upper > UntiedGaps(patrolling, 0.9).of(counts, learners).upper
    assert (found.confidence, found.parameters) == (0.9, ())
    assert found.refused.startswith("the data contradict the assumption that the same success holds in every row")
    assert "not the same everywhere" in found.statement


def test_an_alarm_while_learning_stays_when_the_run_is_resumed(patrolling, tmp_path, monkeypatch):
    """Nine cells succeed in a third of their moves; later looks find nothing."""
    probability, worse = FLOOR.probability.copy(), FLOOR.at(success="1/3")
    probability[: FLOOR.row_start[FLOOR.choice_start[9]]] = worse.probability[: FLOOR.row_start[FLOOR.choice_start[9]]]
    strange = FLOOR.with_rows(probability=probability, exact=None)
    given = {"episodes": 200, "evaluate_every": 200, "until_gap": 1e-300, "checkpoint": tmp_path / "run.ckpt"}
    run = stl.learn(patrolling, environment=simulator(strange, np.random.default_rng(0)), **given)
    assert run.gap.refused is not None
    assert run.counts.alarms
    monkeypatch.setattr(Evidence, "against_the_tie", (0.0, 0))
    again = stl.learn(patrolling, environment=simulator(strange, np.random.default_rng(0)), resume=True, **given)
    assert again.gap.refused == run.gap.refused
    assert again.counts.alarms == run.counts.alarms
    with pytest.raises(TieError):
        stl.guarantee(patrolling, None, again.counts, parameters="model")


def odd_cell():
    """Data that contradict the tie: cell 8 succeeds in a third of its moves."""
    rng, here = np.random.default_rng(0), np.repeat(np.arange(FLOOR.n_states), np.diff(FLOOR.choice_start)) == 8
    parts = [sampled(member, rng, tries) for member, tries in
             ((FLOOR, np.where(here, 0, 40)), (FLOOR.at(success="1/3"), np.where(here, 40, 0)))]  # fmt: skip
    return counts_of(FLOOR, [row for one in parts for row in zip(one.choice, one.target, one.seen, strict=True)])


@pytest.mark.parametrize("seed", range(many(10)))
def test_the_untied_gap_holds_for_every_member(seed):
    rng = np.random.default_rng(seed)
    model = oracles.random_model(rng, 8)
    product = stl.build_product(model, stl.parse(["F[0,3] A", "G[0,2] !B", "(!B) U[0,3] A"][seed % 3]))
    counts = sampled(model, rng, rng.integers(0, 200, size=model.n_choices))
    policy = stl.Policy(product, rng.integers(2, size=(product.horizon, *product.shape)))
    found = stl.optimality_gap(product, policy, counts)
    intervals = interval_model(model, model.initial, counts, 0.99).intervals
    inside = interval_model(model, model.initial, counts, 0.99)
    for _ in range(5):
        rows = []
        for a, b in zip(inside.row_start[:-1].tolist(), inside.row_start[1:].tolist(), strict=True):
            row, left = intervals.lower[a:b].copy(), 1 - intervals.lower[a:b].sum()
            for k in rng.permutation(b - a):  # nature's corners
                take = min(intervals.upper[a + k] - intervals.lower[a + k], left)
                row[k], left = row[k] + take, left - take
            rows.append(row / row.sum())
        flat = np.concatenate(rows[: model.n_choices])
        member = product if (flat <= 0).any() else replace(product, model=model.with_rows(probability=flat, exact=None))
        own = stl.check(member, stl.Policy(member, policy.form)).probability
        assert stl.check(member).probability - own <= found.upper + 1e-9
    assert found.without_data == 1 or found.upper <= found.without_data


def test_the_untied_gap_of_much_data_is_the_exact_one():
    model = oracles.random_model(np.random.default_rng(3), 4)
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    counts = counts_of(model, [
        (c, int(model.target[k]), round(10**13 * model.probability[k]))
        for c in range(model.n_choices) for k in range(model.row_start[c], model.row_start[c + 1])
    ])  # fmt: skip
    for seed in range(5):
        table = np.random.default_rng(seed).integers(2, size=(product.horizon, *product.shape))
        policy = stl.Policy(product, table)
        exact = stl.check(product).probability - stl.check(product, policy).probability
        found = stl.optimality_gap(product, policy, counts)
        assert exact - 1e-12 <= found.upper
        assert found.upper <= exact + 1e-3 or found.upper <= 1  # a sum over the run of what single choices lose
    best = stl.optimality_gap(product, stl.check(product).policy, counts)
    assert best.upper < 1e-4


def test_learning_stops_when_the_gap_is_certified(patrolling, tmp_path):
    run = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.001, seed=0)
    assert run.status == "gap certified"
    assert run.gap.upper <= 0.001
    assert run.environment_steps < 200
    assert stl.check(patrolling).probability - stl.check(patrolling, run.policy).probability <= run.gap.upper
    assert [point.gap for point in run.history][-1] == run.gap.upper
    assert all(point.gap > 0.001 for point in run.history[:-1])
    data = report_data([stl.check(patrolling, run.policy)], run)
    page = render(data)
    assert "<b>Certified</b>: with confidence 99 %" in page
    assert '<td class="number">without data</td>' in page
    pictures = [Picture(f"<svg{text[: text.index('</svg>')]}</svg>") for text in page.split("<svg")[1:]]
    (panel,) = [panel for picture in pictures for panel in picture.panels if "gap" in panel.names()]
    assert panel.markers("gap") == pytest.approx(np.array([(p.steps, p.gap) for p in run.history]), rel=2e-2)
    assert panel.levels("without-data") == pytest.approx([run.gap.without_data], rel=2e-2)
    assert json.loads(json.dumps(data))["training"]["gap"]["transitions"] == run.environment_steps
    # the same, stopped and resumed
    path = tmp_path / "run.checkpoint"
    part = stl.learn(patrolling, "model-based", episodes=1, until_gap=0.001, seed=0, checkpoint=path)
    assert part.status == "complete"
    whole = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.001, seed=0, checkpoint=path, resume=True)
    again = stl.learn(patrolling, "model-based", episodes=500, until_gap=0.001, seed=0, checkpoint=path, resume=True)
    for other in (whole, again):
        assert other.environment_steps == run.environment_steps
        assert other.gap.upper == run.gap.upper


def test_models_without_parameters_are_certified_untied():
    rows = [[[0.9, 0.1], [0, 1]], [[0.5, 0.5], [0, 1]]]
    product = stl.build_product(stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}), stl.parse("F[0,2] A"))
    run = stl.learn(product, "model-based", episodes=3000, until_gap=0.3, seed=0)
    assert run.gap.assumes == "the possible successors are known, their probabilities are not"
    exact = stl.check(product).probability - stl.check(product, run.policy).probability
    assert exact <= run.gap.upper
    assert run.status == "gap certified"
    assert run.episodes < 3000


def test_certificates_are_due_ever_more_rarely():
    times = [n for n in range(1, 10_000) if due(n)]
    assert times[:20] == list(range(1, 21))
    assert len(times) < 200
    assert all(later <= 1.11 * earlier + 1 for earlier, later in itertools.pairwise(times))


@pytest.mark.soak(only=True)
def test_runs_are_given_a_gap_that_is_too_small_no_more_often_than_stated():
    """A hard instance, and an adversary: p is close to where the better action changes, and whoever gathers the data
    knows it, tries what misleads most, and stops as soon as a gap is too small. 2000 runs in `make soak`."""
    rows = [
        [["0", "1-p", "p"], [0, 1, 0], [0, 0, 1]],
        [["0", "1/2", "1/2"], [0, 1, 0], [0, 0, 1]],
        [["0", "(1+p)/2", "(1-p)/2"], [0, 1, 0], [0, 0, 1]],  # worse than either, and evidence on p
    ]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    start = product.enter(0, product.automaton.initial)
    p, wrong, alarms, runs = 0.47, 0, 0, many(67)  # the first action loses 0.03, the third 0.235
    learners = np.zeros((1, *product.shape), dtype=np.int64)  # what is judged after an alarm: the first action
    for seed in range(runs):
        rng, counts = np.random.default_rng(seed), Counts(model.n_choices, model.n_states)
        certifier, wins, tries = Certifier(product, product, counts, 0.02, 0.8), np.zeros(3), np.ones(3)
        refused = False
        for _ in range(6):
            share = wins / tries
            action = 2 if seed % 2 and abs(share[0] - p) + abs(1 - 2 * share[2] - p) > 0.1 else 0
            won = int(rng.binomial(60, (p, 0.5, (1 - p) / 2)[action]))
            wins[action], tries[action] = wins[action] + won, tries[action] + 60
            counts.add([action] * 60, [2] * won + [1] * (60 - won))
            found = certifier(lambda: learners)
            refused |= found.refused is not None
            loss = (0.03, 0.0, 0.235)[int(found.policy.row(0)[0, start])]
            if loss > found.upper:
                wrong += 1
                break
        alarms += refused
    assert binomtest(wrong, runs, 0.2, "greater").pvalue > 1e-4
    assert binomtest(alarms, runs, 0.2, "greater").pvalue > 1e-4


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"until_gap": 0}, "until_gap is 0; give a probability between 0 and 1"),
        ({"until_gap": 2}, "until_gap is 2; give a probability between 0 and 1"),
        ({"until_gap": 0.1, "confidence": 1}, "confidence is 1"),
        ({"until_gap": 0.1, "faithful": True}, "until_gap is not for methods as published"),
    ],
)
def test_settings_out_of_range_are_refused(patrolling, options, says):
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, episodes=1, **options)


def test_what_does_not_fit_is_refused(patrolling):
    counts = Counts(FLOOR.n_choices, FLOOR.n_states)
    with pytest.raises(SettingsError, match="needs a policy"):
        stl.optimality_gap(patrolling, None, counts)
    with pytest.raises(SettingsError, match="leave out successors or parameters"):
        stl.optimality_gap(patrolling, None, counts, parameters="model", successors=lambda s, a: [s])
    hidden = stl.MDP.black_box(3, 2, lambda rng: None, labels={"A": [0, 0, 1]})
    box = stl.build_product(hidden, stl.parse("F[0,2] A"))
    with pytest.raises(SettingsError, match="possible successors are not known"):
        stl.learn(box, until_gap=0.1)
    mixed = stl.Policy(patrolling, np.full((*patrolling.shape, 9), 1 / 9))
    with pytest.raises(SettingsError, match="deterministic"):
        stl.optimality_gap(patrolling, mixed, counts)
    odd = odd_cell()
    with pytest.raises(TieError):
        stl.optimality_gap(patrolling, None, odd, parameters="model")
    assert UntiedGaps(patrolling, 0.99).of(odd, stl.check(patrolling).policy).upper > 0.3
