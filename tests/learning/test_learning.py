import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.choices import Table
from stltool.cli.steps import read_learner
from stltool.errors import ModelError, SettingsError
from stltool.kernels import exploring, lanes, planning, warm_up
from stltool.kernels import learning as kernels
from stltool.learning import LEARNERS, Counts, Episode, Problem
from stltool.learning.explorer import Explorer
from stltool.learning.methods import budget_table, class_of, make, methods_table, settings_table
from stltool.learning.model_based import Belief, Planner
from stltool.learning.optimism import NEXT_TO_NOTHING, doubt, level, paradise, unrefuted
from stltool.learning.replay import ReplayMemory
from stltool.learning.settings import settings_of, shown_value
from stltool.learning.swept import CautiousTable, HopefulTable, Transitions
from stltool.learning.tables import Entries, SurrogateTable
from stltool.models.environment import Environment, simulator
from stltool.policy import with_flags
from stltool.product import first_verdicts
from stltool.randomness import Purpose, generator
from tests import oracles
from tests.checking.test_check import products
from tests.conftest import FACTORY, ROOT, many, some
from tests.learning.test_planner import early


@pytest.fixture(scope="module")
def p1(floor5):
    return stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl"))


@pytest.fixture(scope="module")
def p1_flags(floor5):
    """The same with all the paper's flag vectors, reachable or not, as the published learners have them."""
    return stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl"), encoding="paper")


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("seed", some(range(5)))
def test_cfer_learns_p1_within_a_twentieth_of_the_papers_steps(p1, seed):
    run = stl.learn(p1, "cfer", episodes=220, evaluate_every=110, seed=seed)
    assert run.environment_steps <= 4000 * 20 / 20
    assert run.history[-1].probability >= 0.99 * stl.check(p1).probability
    assert run.history[-1].probability == stl.check(p1, run.policy).probability


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("seed", some(range(5)))
def test_the_model_based_learner_does_within_a_fiftieth(p1, seed):
    run = stl.learn(p1, "model-based", episodes=90, evaluate_every=90, seed=seed)
    assert run.environment_steps <= 4000 * 20 / 50 + 20
    assert run.history[-1].probability >= 0.99 * stl.check(p1).probability


def begun(learner, product):
    """The state of a run that has just begun, and random numbers for an episode of 20 steps."""
    state = learner.start(Problem.of(product), Counts(product.model.n_choices, product.model.n_states), None)
    return state, np.random.default_rng(0).random((20, getattr(learner, "batch", 1)))


RUNS = [(method, False) for method in ("naive", "naive-er", "cfer", "model-based")]
RUNS += [(method, True) for method in ("naive", "naive-er", "cfer", "cfper")]


def small(method, faithful, **settings):
    """Of these settings, or of some for short runs, those that the method has."""
    settings = settings or {"batch": 8, "memory": 150, "decay": 10}
    return {name: value for name, value in settings.items() if name in settings_of(class_of(method, faithful))}


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_same_seed_same_result(floor5, method, faithful):
    product = stl.build_product(floor5, stl.load_task(FACTORY / "reaching.stl"))
    settings = {"faithful": faithful, "episodes": 40, "evaluate_every": 10, **small(method, faithful, decay=10)}
    first, again, other = (stl.learn(product, method, seed=seed, **settings) for seed in (3, 3, 4))
    assert first.history == again.history
    assert np.array_equal(first.policy.table, again.policy.table)
    assert first.counts.seen.tolist() == again.counts.seen.tolist() != other.counts.seen.tolist()
    assert [point.episode for point in first.history] == [10, 20, 30, 40]
    if faithful:
        assert first.environment_steps == 40 * (product.horizon + 2)
    assert first.counts.seen.sum() == first.environment_steps <= 40 * (product.horizon + 2)
    assert all(point.probability <= stl.check(product).upper for point in first.history)


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_whole_episodes_are_single_steps(p1, method, faithful):
    """Compiled episodes in a simulated model, and the same model as a black box: the same bits."""
    settings = {"faithful": faithful, "episodes": 6, "evaluate_every": 3, **small(method, faithful)}
    seeds = np.random.SeedSequence(5).spawn(2)
    black_box = dataclasses.replace(simulator(p1.model, np.random.default_rng(seeds[0])), tables=None)
    whole, stepped = (stl.learn(p1, method, seed=5, environment=e, **settings) for e in (None, black_box))
    assert whole.history == stepped.history
    assert np.array_equal(whole.policy.table, stepped.policy.table)
    assert whole.counts.seen.tolist() == stepped.counts.seen.tolist()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_share_of_each_batch_can_be_factual(p1_flags, share):
    run, draws = begun(stl.PublishedCfer(factual_share=share, batch=8, memory=500), p1_flags)
    q2 = int(p1_flags.automaton.delta[p1_flags.letter[4], 5])
    run.observe(1, 3, 5, 2, 4, q2, draws)
    assert run.replay.place.tolist() == [100, 100]
    assert run.replay.facts_place[1] == (share > 0)
    before = run.table.Q.copy()
    run.observe(4, 3, 5, 2, 4, q2, draws)
    changed = np.argwhere(before != run.table.Q)
    assert ((changed[:, [0, 2]] == [3, 2]).all(), len(changed) > 1) == (True, share < 1)


def test_every_learner_finds_a_sure_way(patrolling):
    """Two states, one good action: all methods must get it."""
    go = np.array([[0.0, 1.0], [0.0, 1.0]])
    model = stl.MDP.from_arrays([np.eye(2), go], {"x": [0, 1]}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,3) G[0,2) A"))
    for method, faithful in RUNS:
        run = stl.learn(product, method, faithful=faithful, episodes=200, **small(method, faithful, decay=50))
        assert run.history[-1].probability == 1.0, (method, faithful)


def test_training_ends_when_the_gap_is_small_enough(p1):
    run = stl.learn(p1, "model-based", episodes=1000, evaluate_every=10, stop_gap=0.05)
    assert run.stopped_early
    assert run.episodes == run.history[-1].episode < 1000
    gaps = [stl.check(p1).probability - point.probability for point in run.history]
    assert gaps[-1] <= 0.05 < min(gaps[:-1], default=1)


@pytest.mark.parametrize("method", ["cfer", "model-based"])
def test_a_learner_needs_nothing_but_reset_and_step(p1, method):
    """The environment is scripted: no model stands behind it, and nothing but labels and sizes is handed over."""
    assert {field.name for field in dataclasses.fields(Problem.of(p1))} == {"automaton", "letter", "n_choices"}
    seen = []

    def step(action):
        seen.append(action)
        return (seen[-1] * 5 + len(seen)) % p1.model.n_states

    run = stl.learn(p1, method, episodes=3, evaluate_every=1, environment=Environment(lambda: 0, step))
    assert len(seen) == run.environment_steps == run.counts.seen.sum()


@pytest.mark.parametrize("most_steps", [None, 333])
def test_many_episodes_at_once_are_those_one_by_one(floor5, most_steps):
    """One call of a kernel for many episodes, one for each, and steps: with the same numbers of the same generators."""
    model = dataclasses.replace(floor5, initial=np.full(floor5.n_states, 1 / floor5.n_states))
    product = stl.build_product(model, stl.parse("F[0,4) G[0,3) C | G[0,4) F[0,3) A"))
    settings = {"episodes": 70, "evaluate_every": 33, "seed": 4, "most_steps": most_steps}
    runs = [stl.learn(product, **settings), stl.learn(product, progress=lambda *_: None, **settings)]
    world = simulator(model, generator(4, Purpose.LEARNING_ENVIRONMENT))
    runs.append(stl.learn(product, environment=dataclasses.replace(world, tables=None), **settings))
    one, *others = ([run.history, *(column.tolist() for column in run.counts.in_context)] for run in runs)
    assert [other == one for other in others] == [True, True]
    assert runs[0].episodes == (70 if most_steps is None else runs[1].episodes)
    assert all((run.policy.table == runs[0].policy.table).all() for run in runs)


def test_products_of_medium_size_are_explored_like_small_ones(patrolling, monkeypatch):
    """Only their batches and judged policies are planned in another way."""
    small = stl.learn(patrolling, episodes=40, evaluate_every=40, seed=2)
    situations = float(np.prod(Problem.of(patrolling).shape))
    monkeypatch.setattr(Planner.__init__, "__defaults__", (situations / 15,))
    planner = Planner(Problem.of(patrolling), small.counts)
    assert (planner.small, planner.charted) == (False, True)
    medium = stl.learn(patrolling, episodes=40, evaluate_every=40, seed=2)
    assert [x.tolist() for x in medium.counts.in_context] == [x.tolist() for x in small.counts.in_context]
    monkeypatch.setattr(Planner.__init__, "__defaults__", (situations / 15.1,))
    assert not Planner(Problem.of(patrolling), small.counts).charted


def test_others_hear_of_every_episode(patrolling):
    """A learner that is asked for one at a time plays one at a time."""
    heard = []
    stl.learn(patrolling, episodes=5, evaluate_every=5, progress=lambda *told: heard.append(told[0]))
    assert heard == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("answer", [-1, 18, 0.5, None])
def test_an_environment_that_leaves_the_model_is_told(p1, answer):
    with pytest.raises(ModelError, match=r"step\(\d\) in state 0 returned .* 0 … 17"):
        stl.learn(p1, episodes=3, environment=Environment(lambda: 0, lambda i: answer))
    with pytest.raises(ModelError, match=r"reset\(\) returned"):
        stl.learn(p1, episodes=3, environment=Environment(lambda: answer, lambda i: 0))


def open_pairs(product):
    """(letter, t, q) that some sequence of letters leads to undecided, by the definition."""
    automaton, pairs = product.automaton, set()
    before = {automaton.initial}
    for t in range(product.horizon):
        verdicts, after = automaton.verdicts(t), set()
        for letter in range(automaton.n_letters):
            for q in before:
                q2 = int(automaton.delta[letter, q])
                if verdicts[q2] == UNDECIDED:
                    pairs.add((letter, t, q2))
                    after.add(q2)
        before = after
    return pairs


def induction(product, seen, share, worth):
    """Q (h, S, Q, C) by the definition, with seen (S, C, S), and share (S, C) of a choice's value as given by worth."""
    problem, automaton, h = Problem.of(product), product.automaton, product.horizon
    Q = np.zeros((h, *product.shape, problem.most_choices))

    def value(t, s, q):
        verdict = automaton.verdicts(t)[q]
        return float(verdict) if verdict != UNDECIDED else Q[t, s, q, : problem.n_choices[s]].max()

    for t in reversed(range(h)):
        for one, _, q in sorted(pair for pair in open_pairs(product) if pair[1] == t):
            after = [int(automaton.delta[letter, q]) for letter in product.letter]
            ahead = [value(t + 1, s2, after[s2]) for s2 in range(problem.n_states)]
            for s in np.flatnonzero(product.letter == one):
                for a in range(problem.n_choices[s]):
                    n = seen[s, a].sum()
                    Q[t, s, q, a] = (1 - share[s, a]) * (seen[s, a] @ ahead) / max(n, 1) + share[s, a] * worth(t)
    return Q


def some_transitions(product, rng, n):
    """Rows (n, 3) of s, a, s'."""
    problem = Problem.of(product)
    s, s2 = rng.integers(problem.n_states, size=(2, n))
    return np.stack([s, rng.integers(problem.n_choices[s]), s2], axis=1).tolist()


@given(products(longest=3), st.integers(0, 2**32 - 1))
def test_tables_are_inductions_over_all_transitions(product, seed):
    """With caution swept after every few transitions, and swept once; with hope from some situation on."""
    if product.horizon == 0:
        return
    rng, h, caution = np.random.default_rng(seed), product.horizon, 0.1
    product, problem = early(product), Problem.of(product)
    entries, letter, pairs = Entries(problem), product.letter, sorted(open_pairs(product))
    assert sum(entries.numbers) == len(pairs)
    table, at_once, hopeful = CautiousTable(entries, caution), CautiousTable(entries, caution), HopefulTable(entries)
    counts = Counts(product.model.n_choices, problem.n_states)
    transitions, seen = (
        Transitions(problem, counts),
        np.zeros((problem.n_states, problem.most_choices, problem.n_states)),
    )
    for _ in range(4):
        for s, a, s2 in some_transitions(product, rng, 4):
            assert transitions.add(s, a, s2) == (seen[s, a, s2] == 0)
            seen[s, a, s2] += 1
            counts.add([problem.first_choice[s] + a], [s2])
        table.sweep(transitions)
        for where in [pairs[i] for i in rng.integers(len(pairs), size=2)] if pairs else []:
            s, epsilon = int(rng.choice(np.append(np.flatnonzero(letter == where[0]), -1))), float(rng.random())
            if s >= 0:
                hopeful.look_ahead(transitions, epsilon, where[1], s, where[2])
                share = np.where(seen.sum(axis=2) > 0, unrefuted(seen.sum(axis=2), epsilon), 1.0)
                mine = induction(product, seen, share, lambda t: paradise(t, h))[where[1], s, where[2]]
                found = hopeful.Q[s, :, entries.index[where]]
                assert np.allclose(found[: problem.n_choices[s]], mine[: problem.n_choices[s]], atol=1e-12)
                assert mine[hopeful.best(where[1], s, where[2], 0.0)] >= mine.max() - 1e-12
    at_once.sweep(Transitions(problem, counts))
    assert np.array_equal(at_once.Q, table.Q)
    assert np.array_equal(at_once.V, table.V)
    Q = induction(product, seen, doubt(seen.sum(axis=2), caution), lambda t: NEXT_TO_NOTHING)
    policy = table.policy_table()
    for one, t, q in pairs:
        for s in np.flatnonzero(letter == one):
            entry, mine = entries.index[one, t, q], Q[t, s, q, : problem.n_choices[s]]
            assert np.allclose(table.Q[s, : len(mine), entry], mine, atol=1e-12)
            assert table.V[s, entry] == table.Q[s, : len(mine), entry].max()
            assert mine[policy[t, s, q]] >= mine.max() - 1e-12


def test_replays_are_their_slow_twins(patrolling):
    """Bit for bit, and so are sweeps after every few transitions, and what is stored in another order."""
    problem, rng = Problem.of(patrolling), np.random.default_rng(0)
    counts, entries = Counts(patrolling.model.n_choices, problem.n_states), Entries(problem)
    added, table, often = Transitions(problem, counts), *(CautiousTable(entries, 0.1) for _ in range(2))
    hopeful = HopefulTable(entries)
    for s, a, s2 in some_transitions(patrolling, rng, 300):
        if added.add(s, a, s2):
            often.sweep(added)
        counts.add([problem.first_choice[s] + a], [s2])
    often.sweep(added)
    counted, calls = Transitions(problem, counts), []
    assert added.stored.size[0] == counted.stored.size[0] > 64  # more than there was room for
    assert np.array_equal(added.stored.visits, counted.stored.visits)

    def watched(kernel):
        def called(Q, V, stored, *rest):
            calls.append((kernel, Q, V, [a.copy() if isinstance(a, np.ndarray) else a for a in (Q, V, *rest)]))
            return kernel(Q, V, stored, *rest)

        return called

    with pytest.MonkeyPatch.context() as patch:
        for name in ("clocked_sweep", "clocked_ahead"):
            patch.setattr(kernels, name, watched(getattr(kernels, name)))
        table.sweep(added)
        hopeful.look_ahead(added, 0.4, 1, 3, patrolling.enter(3, patrolling.automaton.initial))
    assert np.array_equal(often.Q, table.Q)
    assert np.array_equal(often.V, table.V)
    assert len(calls) == 2
    for kernel, Q, V, before in calls:
        for stored in (added.stored, counted.stored):
            slow_Q, slow_V, *rest = (a.copy() if isinstance(a, np.ndarray) else a for a in before)
            getattr(kernel, "py_func", kernel)(slow_Q, slow_V, stored, *rest)
            assert np.array_equal(slow_Q, Q)
            assert np.array_equal(slow_V, V)


@given(products(longest=3), st.integers(0, 2**32 - 1))
def test_the_cautious_table_is_the_cautious_plan(product, seed):
    """The values, and the policy, are those of the plan by the counts."""
    problem = Problem.of(product)
    if product.horizon == 0 or (first_verdicts(early(product), np.arange(problem.n_states)) != UNDECIDED).all():
        return
    rng, counts = np.random.default_rng(seed), Counts(product.model.n_choices, problem.n_states)
    table, planner = CautiousTable(Entries(problem), 0.3), Planner(problem, counts)
    for c in range(counts.n_choices):
        n = int(rng.integers(6))
        counts.add([c] * n, rng.integers(problem.n_states, size=n))
    table.sweep(Transitions(problem, counts))
    for s in range(problem.n_states):
        q = product.enter(s, product.automaton.initial)
        entry = table.entries.index[product.letter[s], 0, q]
        if entry >= 0:
            planner.starts[:] = np.arange(problem.n_states) == s
            best = planner.value(planner.judged(0.3), 0.3)
            assert table.V[s, entry] == pytest.approx(best, abs=1e-9)
            assert planner.value(Table(table.policy_table()), 0.3) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(many(2)))
def test_the_judged_policy_of_cfer_is_the_plan_by_its_data(p1, seed):
    run = stl.learn(p1, "cfer", episodes=60, evaluate_every=20, seed=seed)
    planned = Planner(Problem.of(p1), run.counts)
    planned.starts[:] = p1.model.initial > 0
    best = planned.value(planned.judged(stl.Cfer().caution), stl.Cfer().caution)
    assert planned.value(run.policy.form, stl.Cfer().caution) == pytest.approx(best, abs=1e-9)


def test_plans_are_the_checkers(p1):
    """With every frequency right and no caution, the model-based policy is the optimum."""
    learner = stl.ModelBased(caution=0)
    state, _ = begun(learner, p1)
    model, scale = p1.model, 30_000
    choice = np.repeat(np.arange(model.n_choices), np.diff(model.row_start))
    seen = np.rint(model.probability * scale).astype(np.int64)
    state.counts.add(np.repeat(choice, seen), np.repeat(model.target, seen))
    best = stl.check(p1).probability
    assert stl.check(p1, stl.Policy(p1, learner.policy(state))).probability == pytest.approx(best, abs=1e-9)
    first = int(np.flatnonzero(model.initial)[0])
    drawn = Belief(state, 1e-9, 0).learned(state.counts.visits)  # hope is next to nothing, and the posterior narrow
    state.follow(drawn, 0, first, p1.enter(first, p1.automaton.initial), state.counts.visits)
    assert stl.check(p1, stl.Policy(p1, state.plan.form.astype(int))).probability == pytest.approx(best, abs=1e-5)


def test_optimism_goes_for_what_is_unknown_and_caution_does_not(patrolling):
    """Two ways: one seen once to satisfy, one never tried; and one that has proved itself."""
    rows = np.zeros((3, 3, 3))
    rows[:, [1, 2], [1, 2]] = 1
    rows[0, 0, 1] = rows[1, 0, 2] = rows[2, 0, 2] = 1
    model = stl.MDP.from_arrays(rows, {"x": [0, 1, 2]}, labels={"A": [0, 0, 1]})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    learner = stl.ModelBased()
    state, _ = begun(learner, product)
    q = product.enter(0, product.automaton.initial)
    for action, successor, times in ((0, 1, 5), (1, 2, 1), (2, 2, 9)):
        state.counts.add([action] * times, [successor] * times)  # state 0's choices are the first
    assert int(learner.policy(state).at(0, np.array([0]), np.array([q]))[0]) == 2
    taken = []
    environment = Environment(lambda: 0, lambda action: taken.append(action) or action)
    episode = Episode(Problem.of(product), environment, state.counts, np.random.default_rng(0), 0, 1)
    learner.episode(state, episode)
    assert taken == [2]  # known to satisfy: better than the unknown by a hair
    state.counts.add([2] * 40, [1] * 40)
    learner.episode(state, Episode(Problem.of(product), environment, state.counts, np.random.default_rng(0), 0, 1))
    assert taken == [2, 1]
    assert int(learner.policy(state).at(0, np.array([0]), np.array([q]))[0]) == 1


@pytest.fixture(scope="module")
def hold():
    """In A (state 0), "walk" stays with .9, "stay" surely; outside, both actions stay there."""
    walk, stay = np.array([[0.9, 0.1], [0.0, 1.0]]), np.eye(2)
    model = stl.MDP.from_arrays([walk, stay], {}, labels={"A": [True, False]}, action_names=["walk", "stay"])
    return stl.build_product(model, stl.parse("F[0,2] G[0,2] A"))


@pytest.mark.parametrize("optimism", [0.01, 0.3])
def test_nobody_hopes_for_a_success_where_none_is_possible(hold, optimism):
    """Outside A after step 2, all is lost, whatever has not been tried there: "stay", tried once, is better."""
    state, _ = begun(stl.ModelBased(), hold)
    state.counts.add([0] * 30 + [1], [0] * 27 + [1] * 3 + [0])
    visits, q = state.counts.visits, hold.automaton.initial
    for s in (1, 0, 0):
        q = hold.enter(s, q)
    state.follow(Belief(state, optimism, 0).learned(visits), 2, 0, q, visits)
    assert state.action(2, 0, q, visits) == 1
    cfer, _ = begun(stl.Cfer(), hold)
    open_ = cfer.hopeful.entries.is_open(np.array([1, 3]), np.array([1, 1]), np.full(2, hold.enter(1, q)))
    assert open_.tolist() == [True, False]


@pytest.mark.parametrize("method", ["model-based", "cfer", "naive", "naive-er"])
def test_tasks_that_the_models_labels_decide(method):
    """Before the horizon, as B is everywhere; and at once, as C is nowhere."""
    model = stl.MDP.from_arrays([np.eye(2)] * 2, {}, labels={"A": [1, 0], "B": [1, 1], "C": [0, 0]}, initial=0)
    product = stl.build_product(model, stl.parse("F[1,2] A & F[5,6] B"))
    run = stl.learn(product, method, episodes=3)
    assert (run.status, run.history[-1].probability, run.environment_steps) == ("complete", 1.0, 3)
    never = stl.build_product(model, stl.parse("F[0,5] (A & C)"))
    run = stl.learn(never, method, episodes=3)
    assert (run.status, run.history[-1].probability, run.environment_steps) == ("nothing to learn", 0.0, 0)


GOOD, BAD = 0.9, 0.5  # of a and b


@pytest.fixture(scope="module")
def good_or_bad():
    """Three states: a leads to the good one with probability .9, b with .5."""
    rows = np.zeros((2, 3, 3))
    rows[:, [1, 2], [1, 2]] = 1
    rows[:, 0, 1:] = [[GOOD, 1 - GOOD], [BAD, 1 - BAD]]
    model = stl.MDP.from_arrays(rows, {}, labels={"good": [False, True, False]}, action_names=["a", "b"])
    return stl.build_product(model, stl.parse("F[0,1] good"))


@pytest.mark.parametrize("drawn", [True, False], ids=["model-based", "cfer"])
def test_an_unlucky_beginning_does_not_last(drawn):
    """a failed twice, b succeeded twice, in 1000 runs of the learners' rules: frequencies, drawn or not, and hope."""
    rng, runs = np.random.default_rng(0), 1000
    seen = np.zeros((runs, 2, 2))  # runs, a and b, failures and successes
    seen[:, 0, 0] = seen[:, 1, 1] = 2
    late = 0
    for episode in range(2500):
        n = seen.sum(axis=2)
        weight = rng.standard_gamma(seen) if drawn else seen
        share = unrefuted(n, level(0.3, rng.random((runs, 1))))
        value = (1 - share) * weight[:, :, 1] / weight.sum(axis=2) + share * paradise(0, 1)
        a = value.argmax(axis=1)
        good = rng.random(runs) < np.where(a == 0, GOOD, BAD)
        seen[np.arange(runs), a, good.astype(int)] += 1
        late += int((a == 1).sum()) if episode >= 1500 else 0
    judged = (seen[:, :, 1] / (seen.sum(axis=2) + 0.1)).argmax(axis=1)
    assert (judged == 0).mean() >= 0.998  # a failed five times in a row, at most once in a thousand runs
    assert late <= 0.01 * 1000 * runs


@pytest.mark.parametrize("method", ["model-based", "cfer"])
@pytest.mark.parametrize("seed", range(many(3)))
def test_learners_recover_from_an_unlucky_beginning(good_or_bad, method, seed):
    """The same by the learners themselves: the environment fails a twice, and b succeeds twice."""
    rng, choices = np.random.default_rng(seed), []

    def step(action):
        choices.append(action)
        lucky = action == 1 if choices.count(action) <= 2 else rng.random() < (GOOD, BAD)[action]
        return 1 if lucky else 2

    run = stl.learn(
        good_or_bad, method, episodes=600, evaluate_every=600, seed=seed, environment=Environment(lambda: 0, step)
    )
    assert run.history[-1].probability == pytest.approx(GOOD)
    assert np.mean(choices[-100:]) < 0.2


@pytest.mark.parametrize("method", ["model-based", "cfer"])
def test_exploration_is_deep(method):
    """Only the way right, to the end of the corridor, satisfies the task."""
    model = oracles.corridor(12)
    product = stl.build_product(model, stl.parse("F[0,15] end"))
    run = stl.learn(product, method, episodes=60, evaluate_every=60)
    assert run.history[-1].probability == 1.0


@pytest.mark.parametrize("method", ["model-based", "cfer"])
@pytest.mark.parametrize("seed", range(many(10)))
def test_small_hopes_close_by_do_not_outdo_one_far_away(method, seed):
    """In a corridor of 30 cells; if each choice draws a hope of its own, one run in five never gets to its end, and if
    values are off by a hair at each step, few do."""
    product = stl.build_product(oracles.corridor(30), stl.parse("F[0,60] end"))
    run = stl.learn(product, method, episodes=50, evaluate_every=50, seed=seed)
    assert run.history[-1].probability == 1.0


def test_the_level_of_hope_is_drawn():
    """For a choice seen once the share of hope is Beta(b, 1): P(share ≤ x) = x^b; less the more it was seen."""
    rng, runs = np.random.default_rng(1), 10_000
    drawn = unrefuted(np.array([0, 1, 2, 50]), level(0.3, rng.random((runs, 1))))
    assert (drawn[:, 0] == 1).all()
    assert (np.diff(drawn, axis=1) <= 0).all()
    for x in (0.01, 0.1, 0.5, 0.9):
        assert (drawn[:, 1] <= x).mean() == pytest.approx(x**0.3, abs=4 * 0.5 / runs**0.5)


@pytest.mark.parametrize("method", ["model-based", "cfer"])
def test_an_episode_ends_where_nothing_is_left_to_learn(method):
    """The first move loses the task. Nothing leaves a pit: that it is tried five times is all that later episodes need
    to know. What has a way out is explored to the end."""
    steps = []
    for after in (1, 0):
        rows = np.zeros((1, 2, 2))
        rows[:, 0, 1] = rows[:, 1, after] = 1
        model = stl.MDP.from_arrays(rows, {}, labels={"pit": [0, 1]}, initial=0)
        run = stl.learn(stl.build_product(model, stl.parse("G[0,19] !pit")), method, episodes=3)
        steps.append(run.environment_steps)
    assert steps == [6 + 2 + 2, 3 * 19]


def test_values_are_fixed_where_the_verdict_has_fallen(patrolling):
    problem, rng = Problem.of(patrolling), np.random.default_rng(0)
    table, counts = CautiousTable(Entries(problem), 0.1), Counts(patrolling.model.n_choices, 18)
    transitions = Transitions(problem, counts)
    for s, a, s2 in some_transitions(patrolling, rng, 300):
        transitions.add(s, a, s2)
    table.sweep(transitions)
    assert (table.V[:, -2:] == [0, 1]).all()
    assert ((table.V >= 0) & (table.V <= 1)).all()


@pytest.mark.parametrize("most", [1e6, 0])
@pytest.mark.parametrize("method", ["model-based", "cfer"])
def test_where_the_data_promise_nothing_the_policy_takes_what_is_untried(most, method, monkeypatch):
    """The slip into state 1 was seen once, and what was then tried stayed there."""
    monkeypatch.setattr(Planner.__init__, "__defaults__", (most,))
    stay, go = np.eye(3), np.eye(3)
    stay[0], go[:2] = [0, 0.1, 0.9], [[0, 0.1, 0.9], [0, 0, 1]]
    model = stl.MDP.from_arrays([stay, go], {}, labels={"end": [0, 0, 1]}, action_names=["stay", "go"], initial=0)
    product = stl.build_product(model, stl.parse("F[0,4] end"))
    learner = make(class_of(method, False), {})
    state, _ = begun(learner, product)
    transitions = [(0, 0, 2)] * 9 + [(0, 0, 1), (1, 0, 1)]
    for s, a, s2 in transitions:
        state.counts.add([2 * s + a], [s2])
    if method == "model-based":
        state.starts[0] = 10
    assert stl.check(product, stl.Policy(product, learner.policy(state))).probability == 1.0


def sweep_one_by_one(rules, walked, route, chart, room, since):
    """`exploring.sweep` for one choice after the other; both add what leads outside last."""
    h, letters, twice = len(rules.worth), len(rules.occurring), np.zeros(int(chart.layer[len(rules.worth)]) + 1, int)
    states = chart.touched[: len(twice) - 1]
    twice[1:] = np.cumsum(np.diff(route.first[: len(twice)]) * np.diff(chart.begin)[states])
    room.value[:2], room.best[0] = (0.0, 1.0), 0.0
    for t in range(h - 1, since - 1, -1):
        for peak in range(chart.peaks[t], chart.peaks[t + 1]):
            feeds = chart.feeds[peak * letters : (peak + 1) * letters]
            room.top[peak] = min(max(chart.basis[peak], room.best[feeds].max()), rules.worth[t])
        room.best[chart.kinds[t] : chart.kinds[t + 1]] = 0.0
        for g in range(chart.layer[t], chart.layer[t + 1]):
            s, children = states[g], twice[g]
            n = chart.begin[s + 1] - chart.begin[s]
            situations = route.first[g + 1] - route.first[g]
            for i in range(route.first[g], route.first[g + 1]):
                values = room.value[chart.child[children + i - route.first[g] :][: situations * n : situations]]
                sums = []
                for c in range(rules.first_choice[s], rules.first_choice[s + 1]):
                    total = 0.0
                    for e in range(walked.start[c], walked.start[c + 1]):
                        total += room.chance[e] * values[chart.slot[e]]
                    total += room.hope[c] * room.top[chart.peak[i]]
                    sums.append(total + room.fresh[c] * rules.worth[t])
                room.value[2 + i] = max(sums)
                route.choice[i] = int(np.argmax(sums)) if max(sums) > 0 else -2
                room.best[chart.kind[i]] = max(room.best[chart.kind[i]], max(sums))


def test_an_explorer_equals_its_python_twin(good_or_bad, floor5, monkeypatch):
    """Whole episodes of the model-based learner: of a task that is soon lost, on the way to what is unknown, and with
    more memories than a vector has lanes."""
    patrolling = stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl", params={"T": 7, "tau": 7}))
    products = [good_or_bad, stl.build_product(oracles.corridor(4), stl.parse("F[0,5] end")), patrolling]
    settings, made, begin = {"episodes": 12, "evaluate_every": 4, "seed": 2}, [], Explorer.__init__

    def keep(explorer, *given):
        made.append(explorer)
        begin(explorer, *given)

    monkeypatch.setattr(Explorer, "__init__", keep)
    fast = [stl.learn(product, **settings) for product in products]
    route, chart = made[-1].route, made[-1].chart
    assert np.diff(route.first[: chart.layer[patrolling.horizon] + 1]).max() > 2 * lanes.N
    names = [name for name, value in vars(exploring).items() if hasattr(value, "py_func")]
    assert len(names) >= 8
    for name in names:
        monkeypatch.setattr(exploring, name, getattr(exploring, name).py_func)
    monkeypatch.setattr(exploring, "sweep", sweep_one_by_one)  # its vectors are not for Python, nor are these
    monkeypatch.setattr(exploring, "at", lambda values, i: values[i])
    monkeypatch.setattr(exploring, "put", lambda values, i, x: values.__setitem__(i, x))
    monkeypatch.setattr(exploring, "trailing", lambda word: (int(word) & -int(word)).bit_length() - 1)
    for product, run in zip(products, fast, strict=True):
        slow = stl.learn(product, **settings)
        assert slow.history == run.history
        assert [rows.tolist() for rows in slow.counts.in_context] == [rows.tolist() for rows in run.counts.in_context]


def test_kernels_equal_their_python_twins(p1_flags, monkeypatch):
    """Every method, its compiled loops replaced by plain Python."""
    settings = {"episodes": 2, "evaluate_every": 2, "seed": 2}
    runs = [run for run in RUNS if run[0] != "model-based"]
    own = {run: small(*run, batch=6, memory=300) for run in runs}
    fast = [stl.learn(p1_flags, m, faithful=f, **settings, **own[m, f]).policy.table for m, f in runs]
    names = [name for name, value in vars(kernels).items() if hasattr(value, "py_func")]
    assert len(names) >= 8
    for name in names:
        monkeypatch.setattr(kernels, name, getattr(kernels, name).py_func)
    for (method, faithful), table in zip(runs, fast, strict=True):
        slow = stl.learn(p1_flags, method, faithful=faithful, **settings, **own[method, faithful]).policy.table
        assert np.array_equal(slow, table), (method, faithful)


# ------------------------------------------------------------------------------------------- as published


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_what_episodes_call_is_loaded_before_the_first(patrolling, monkeypatch, method, faithful):
    """Every kernel for the types that it gets: nobody waits for a compiler in the middle of learning."""
    from numba import typeof

    needed, called = class_of(method, faithful).kernels, set()
    warm_up(*needed)
    for module in (kernels, planning, exploring):
        for name, kernel in list(vars(module).items()):
            if hasattr(kernel, "py_func"):

                def watched(*given, name=name, kernel=kernel):
                    called.add((name, *map(typeof, given)))
                    return kernel(*given)

                monkeypatch.setattr(module, name, watched)
    warm_up(*needed)
    loaded = called.copy()
    called.clear()
    world = simulator(patrolling.model, np.random.default_rng(0))
    for environment in (None, Environment(world.reset, world.step)):
        settings = small(method, faithful, batch=8, memory=150)
        stl.learn(patrolling, method, faithful=faithful, episodes=2, environment=environment, **settings)
    assert called <= loaded
    assert called
    assert needed


def surrogate(product, **settings) -> SurrogateTable:
    return begun(stl.PublishedNaive(**settings), product)[0].table


def test_the_published_reward(floor5):
    charging = stl.build_product(floor5, stl.parse("F[0,10) G[0,5) C"), encoding="paper")
    outer_f = surrogate(charging)
    assert outer_f.reward.tolist() == [-1, -1, -1, -1, -1, 1]
    patrol = stl.build_product(floor5, stl.parse("G[0,10) F[0,2) A"), encoding="paper")
    assert surrogate(patrol).reward.tolist() == [-0.5, 0.5, 0.5]
    for beta in (50.0, 100.0):
        r = -np.exp(-beta * np.array([0.0, 1.0, 1.0]))
        assert np.allclose(surrogate(patrol, scale="printed").reward, r - 0.9, rtol=0, atol=1e-15)
    assert np.allclose(surrogate(patrol, scale="shifted").reward, [-0.9, 0.1, 0.1], rtol=0, atol=1e-15)
    assert surrogate(charging, scale="printed").reward.tolist() == outer_f.reward.tolist()  # Table I: 2χ − 1


def test_published_naive_update_by_hand(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,10) F[0,2) A"), encoding="paper")
    run = stl.learn(product, "naive", faithful=True, episodes=1)
    state, draws = begun(stl.PublishedNaive(), product)
    state.table.Q[7, 1] = np.arange(9)
    state.observe(3, 4, 2, 3, 7, 1, draws)
    assert state.table.Q[4, 2, 3] == pytest.approx(0.01 * (0.5 + 0.999 * 8))
    assert np.count_nonzero(state.table.Q) == 8 + 1
    assert run.environment_steps == 10 + 2


@pytest.mark.parametrize("method", [stl.PublishedCfer, stl.PublishedCfper])
def test_published_cfer_stores_one_tuple_for_every_flag_below_tau(p1_flags, method):
    p1 = p1_flags
    state, draws = begun(method(memory=1000), p1)
    state.observe(1, 3, 5, 2, 4, int(p1.automaton.delta[p1.letter[4], 5]), draws)
    replay = state.replay
    rows = replay.rows[: replay.place[1]]
    assert len(rows) == 100  # flags 0 … 9, twice: the published off-by-one leaves 10 out
    flags = p1.automaton.registers[rows[:, 1]]
    assert set(map(tuple, flags.tolist())) == set(np.ndindex(10, 10))
    assert (rows[:, [0, 2, 3]] == [3, 2, 4]).all()
    assert np.array_equal(rows[:, 4], p1.automaton.delta[p1.letter[4], rows[:, 1]])
    distance = np.abs(flags - p1.automaton.registers[5]).sum(axis=1)
    assert np.allclose(replay.weight[: len(rows)], np.exp(-distance) if method is stl.PublishedCfper else 1)


def test_cfper_draws_by_weight(p1_flags):
    """Weights e^-0, e^-1, e^-2 on three tuples: how often each is drawn."""
    state, _ = begun(stl.PublishedCfper(alpha=1e-9), p1_flags)
    replay, weights = state.replay, np.exp([0.0, -1.0, -2.0])
    replay.rows[:3] = [[1, 0, 0, 1, 0], [2, 0, 0, 1, 0], [3, 0, 0, 1, 0]]
    replay.weight[:3], replay.place[:] = weights, 3
    kernels.replay_batch(state.table.kernel, replay, np.random.default_rng(1).random(100_000))
    drawn = state.table.Q[1:4, 0, 0]
    assert np.allclose(drawn / drawn.sum(), weights / weights.sum(), atol=0.005)


@pytest.mark.parametrize("method", [stl.PublishedNaiveER, stl.PublishedCfer])
def test_published_replay_draws_at_every_fourth_step_only(p1, method):
    state, draws = begun(method(alpha=0.001), with_flags(p1))
    for t, replayed in ((0, True), (1, False), (2, False), (3, False), (4, True)):
        before = state.table.Q.copy()
        state.observe(t, 3, 5, 2, 4, 6, draws)
        changed = int((before != state.table.Q).sum())
        assert changed >= 1 if replayed else changed == (method is stl.PublishedCfer)


def test_the_memory_is_first_in_first_out():
    memory = ReplayMemory(5, 1)
    for start in range(0, 12, 3):
        memory.add(np.arange(start, start + 3, dtype=np.int32)[:, None])
    assert sorted(memory.rows.ravel().tolist()) == [7, 8, 9, 10, 11]
    memory.add(np.arange(100, 112, dtype=np.int32)[:, None])
    assert sorted(memory.rows.ravel().tolist()) == [107, 108, 109, 110, 111]
    assert memory.size == 5
    drawn = memory.draw(1000, np.random.default_rng(0))
    assert set(drawn.tolist()) == {0, 1, 2, 3, 4}


def test_exploration_decays_between_its_ends():
    values = [stl.Naive().epsilon(episode) for episode in (0, 400, 4000)]
    assert values == pytest.approx([0.99, 0.01 + 0.98 / np.e, 0.01], abs=1e-4)


# ------------------------------------------------------------------------------------------- methods and settings


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"method": "sarsa"}, "there is no method 'sarsa'"),
        ({"method": "cefr"}, "did you mean cfer"),
        ({"method": 3}, "method is 3; give a learner, or one of the names cfer, "),
        ({"method": stl.Cfer}, r"method is the class Cfer; give a learner, Cfer\(…\)"),
        ({"episode": 3}, "model-based has no setting 'episode'; did you mean episodes"),
        ({"method": "cfer", "optimist": 3}, "cfer has no setting 'optimist'; did you mean optimism"),
        ({"episodes": 0}, "episodes is 0; it must be an integer from 1"),
        ({"episodes": 2.5}, "episodes is 2.5; it must be an integer from 1"),
        ({"episodes": True}, "episodes is True; it must be an integer from 1"),
        ({"evaluate_every": 0}, "evaluate_every is 0"),
        ({"stop_gap": 2}, "stop_gap is 2; it must be a number from 0 to 1, or none"),
        ({"most_steps": 3}, "most_steps is 3, and one episode takes 8; allow at least one"),
        ({"method": "naive-er", "batch": -1}, "batch is -1; it must be an integer from 1"),
        ({"method": "naive-er", "batch": "50"}, "batch is '50'; it must be an integer from 1"),
        ({"method": "naive", "decay": 0}, "decay is 0; it must be a number above 0"),
        ({"method": "naive", "decay": np.inf}, "decay is inf; it must be a number above 0"),
        ({"method": "naive", "decay": np.nan}, "decay is nan; it must be a number above 0"),
        ({"method": "naive", "faithful": True, "gamma": 1.5}, "gamma is 1.5; it must be a number from 0 to 1"),
        ({"method": "naive", "faithful": True, "alpha": 0}, "alpha is 0; it must be a number above 0 and at most 1"),
        (
            {"method": "naive", "faithful": True, "scale": "both"},
            "scale is 'both'; it must be published, printed or shifted",
        ),
        ({"faithful": True, "factual_share": 1.5}, "factual_share is 1.5; it must be a number from 0 to 1, or none"),
        ({"caution": -1}, "caution is -1"),
        ({"method": "model-based", "optimism": 0}, "optimism is 0; it must be a number above 0"),
        ({"method": "cfper"}, "cfper exists only as published; give faithful=True, too"),
        ({"method": "model-based", "faithful": True}, "model-based is not a published method; leave faithful out"),
        ({"resume": True}, "needs the checkpoint"),
        (
            {"method": stl.Cfer(), "optimism": 3},
            r"optimism: give settings to the learner itself, as in Cfer\(optimism",
        ),
        ({"method": stl.Cfer(), "faithful": True}, "faithful=True selects among names"),
    ],
)
def test_impossible_settings_are_refused(patrolling, arguments, says):
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, **arguments)


def test_settings_of_other_methods_are_refused_with_who_has_them(patrolling):
    """For every method and every setting that it does not have."""
    names = {name for cls in LEARNERS for name in settings_of(cls)}
    for cls in LEARNERS:
        for name in names - set(settings_of(cls)):
            owners = [other for other in LEARNERS if name in settings_of(other)]
            with pytest.raises(SettingsError) as caught:
                stl.learn(patrolling, cls.name, faithful=cls.published, **{name: 1})
            text = str(caught.value)
            assert text.startswith(f"{cls.name}{' as published' if cls.published else ''} has no setting {name}; ")
            assert all(owner.name in text for owner in owners)


def test_model_based_is_the_default_and_cfer_as_published(patrolling):
    run, named = (stl.learn(patrolling, *method, episodes=3, seed=1) for method in ([], ["model-based"]))
    assert (run.learner, run.history) == (stl.ModelBased(), named.history)
    assert stl.learn(patrolling, faithful=True, episodes=1).learner == stl.PublishedCfer()
    assert (read_learner(None, False, None), read_learner(None, True, None)) == (stl.ModelBased(), stl.PublishedCfer())


def test_a_name_and_a_learner_are_the_same(patrolling):
    named = stl.learn(patrolling, "cfer", episodes=10, optimism=7, caution=np.float64(0.5), seed=1)
    given = stl.learn(patrolling, stl.Cfer(optimism=np.int64(7), caution=0.5), episodes=10, seed=1)
    assert named.learner == given.learner
    assert np.array_equal(named.policy.table, given.policy.table)
    assert (given.method, given.faithful, given.settings["optimism"]) == ("cfer", False, 7)
    assert json.loads(json.dumps(given.settings)) == named.settings
    other = stl.learn(patrolling, "cfer", episodes=10, optimism=0.01, seed=1)
    assert not np.array_equal(named.policy.table, other.policy.table)
    published = stl.learn(patrolling, "cfer", faithful=True, episodes=2)
    assert (published.learner, published.faithful) == (stl.PublishedCfer(), True)


def test_methods_are_found_by_their_names():
    assert {(cls.name, cls.published) for cls in LEARNERS} == {(method, faithful) for method, faithful in RUNS}
    for cls in LEARNERS:
        assert class_of(cls.name, cls.published) is cls
        assert isinstance(hash(cls()), int)
        for name, declared in settings_of(cls).items():
            assert declared.text
            assert f"{name} = {shown_value(declared.default)}: {declared.text} ({declared.range})" in cls.__doc__
            assert (
                declared.checked(declared.default)
                == getattr(cls(), name)
                == declared.read(shown_value(declared.default))
            )


def markdown(rows):
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


@pytest.mark.parametrize("table", [methods_table, settings_table, budget_table])
def test_the_page_lists_methods_and_settings_as_they_are(table):
    """docs/learning.md has the tables that the classes give."""
    page = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
    assert markdown(table()) in page, f"write into docs/learning.md:\n{markdown(table())}"


@dataclasses.dataclass(frozen=True)
class Alternating(stl.Learner):
    """A learner of a user's own: takes the choices in turn, and keeps the first one that came with luck."""

    turns: int = 2
    start_with: str = "first"

    def start(self, problem, counts, rng):
        return {"table": np.zeros(problem.shape, dtype=np.int64), "turn": np.zeros(())}

    def episode(self, state, episode):
        while episode.verdict is None:
            place = episode.t, episode.s, episode.q
            choice = int(state["turn"]) % min(self.turns, episode.n_choices)
            state["turn"][...] += 1
            episode.step(choice)
            if episode.verdict is not False:
                state["table"][place] = choice

    def policy(self, state):
        return state["table"]


def test_users_bring_their_own_learners(patrolling, tmp_path):
    learner = Alternating(turns=9)
    run = stl.learn(patrolling, learner, episodes=30, evaluate_every=10, seed=2)
    assert (run.method, run.faithful, run.settings) == ("Alternating", False, {"turns": 9, "start_with": "first"})
    assert run.counts.seen.sum() == run.environment_steps
    assert run.history[-1].probability == stl.check(patrolling, run.policy).probability
    with pytest.raises(SettingsError, match="start_with is 5; it must be text"):
        Alternating(start_with=5)

    path = tmp_path / "own.ckpt"
    stl.learn(patrolling, learner, episodes=11, evaluate_every=10, seed=2, checkpoint=path)
    resumed = stl.learn(patrolling, learner, episodes=30, evaluate_every=10, seed=2, checkpoint=path, resume=True)
    assert np.array_equal(resumed.policy.table, run.policy.table)
    with pytest.raises(SettingsError, match="its turns is 9, here it is 2"):
        stl.learn(patrolling, Alternating(), episodes=30, evaluate_every=10, seed=2, checkpoint=path, resume=True)


def test_what_an_own_learner_does_wrong_is_told(patrolling, tmp_path):
    class Bare(stl.Learner):
        start = episode = policy = lambda self, *_: None

    with pytest.raises(SettingsError, match=r"Bare is not a dataclass, .* decorate the class with @dataclass"):
        stl.learn(patrolling, Bare())

    @dataclasses.dataclass(frozen=True)
    class Odd(Alternating):
        choice: object = 0
        keep: object = None

        def start(self, problem, counts, rng):
            return super().start(problem, counts, rng) | ({} if self.keep is None else {"kept": np.array([self.keep])})

        def episode(self, state, episode):
            for _ in range(100):
                episode.step(self.choice)

    told = {9: r"choice 9 at step 0 in state \d+, which has 9", -1: "choice -1", 0.5: "choice 0.5",
            0: "choice 0 at step 8 .* an episode has 8 steps"}  # fmt: skip
    for choice, says in told.items():
        with pytest.raises(SettingsError, match=says):
            stl.learn(patrolling, Odd(choice=choice))
    with pytest.raises(SettingsError, match=r"choice of Odd is an array of shape \(2,\); settings are recorded"):
        stl.learn(patrolling, Odd(choice=np.zeros(2)))
    with pytest.raises(SettingsError, match="Odd cannot be checkpointed: its array kept is of <U1"):
        stl.learn(patrolling, Odd(keep="x", turns=1), episodes=1, checkpoint=tmp_path / "x.ckpt")
    assert not (tmp_path / "x.ckpt").exists()

    @dataclasses.dataclass(frozen=True)
    class Closed(Alternating):
        def start(self, problem, counts, rng):
            return [problem]

    with pytest.raises(SettingsError, match="Closed cannot be checkpointed: its state is a list; make it a dict"):
        stl.learn(patrolling, Closed(), episodes=1, checkpoint=tmp_path / "x.ckpt")


# --------------------------------------------------------------------------------------- decided at the first state


@pytest.mark.parametrize(("method", "faithful"), RUNS)
@pytest.mark.parametrize(("text", "probability"), [("F[0,3] F[0,2] !A", 1.0), ("G[0,3] F[0,0] A", 0.0), ("A", 0.0)])
def test_a_task_decided_by_the_first_state_has_its_probability_at_once(floor5, method, faithful, text, probability):
    product = stl.build_product(floor5, stl.parse(text))
    run = stl.learn(product, method, faithful=faithful, seed=1, most_steps=10)
    assert (run.status, run.episodes, run.environment_steps, run.stopped_early) == ("nothing to learn", 0, 0, False)
    assert [point.probability for point in run.history] == [probability]
    assert stl.check(product, run.policy).probability == probability
    assert run.counts.seen.sum() == 0


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_some_first_states_decide_and_others_do_not(method, faithful):
    """Episodes without a step are episodes; half of the runs are decided at once."""
    rows = np.zeros((2, 3, 3))
    rows[:, [0, 1, 2], [0, 1, 2]] = 1
    rows[1, 1] = [0, 0, 1]
    model = stl.MDP.from_arrays(rows, {"x": [0, 1, 2]}, initial=[0.5, 0.5, 0], labels={"A": [1, 0, 1]})
    product = stl.build_product(model, stl.parse("F[0,3] F[0,0] A"))
    run = stl.learn(product, method, faithful=faithful, episodes=60, **small(method, faithful, decay=5))
    assert (run.status, run.episodes, run.history[-1].probability) == ("complete", 60, 1.0)


def test_black_boxes_that_are_decided_at_once(floor5):
    def unknown(text):
        model = stl.MDP.black_box(2, 1, lambda rng: Environment(lambda: 1, lambda i: 0), labels={"A": [False, True]})
        return stl.learn(stl.build_product(model, stl.parse(text)), episodes=5)

    decided = [unknown(text) for text in ("A | !A", "A & !A", "A", "F[0,2] A")]
    assert [run.history[-1].probability for run in decided] == [1.0, 0.0, None, None]
    assert [run.status for run in decided] == ["nothing to learn"] * 3 + ["complete"]
    assert (decided[3].episodes, decided[3].environment_steps) == (5, 0)
