import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.errors import ModelError, SettingsError
from stltool.kernels import learning as kernels
from stltool.learning import Settings
from stltool.learning.cfer import FaithfulCfer
from stltool.learning.cfper import FaithfulCfper
from stltool.learning.model_based import ModelBased
from stltool.learning.naive import FaithfulNaive
from stltool.learning.naive_er import FaithfulNaiveER
from stltool.learning.problem import Problem
from stltool.learning.replay import ReplayMemory
from stltool.learning.schedule import epsilon
from stltool.learning.tables import ClockedTable, SurrogateTable
from stltool.models.environment import Environment, simulator
from stltool.policy import with_flags
from tests.checking.test_check import products
from tests.conftest import FACTORY


@pytest.fixture(scope="module")
def p1(floor5):
    return stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl"))


@pytest.fixture(scope="module")
def p1_flags(floor5):
    """The same with all the paper's flag vectors, reachable or not, as the published learners have them."""
    return stl.build_product(floor5, stl.load_task(FACTORY / "patrolling.stl"), encoding="paper")


@pytest.mark.parametrize("seed", range(5))
def test_cfer_learns_p1_within_a_twentieth_of_the_papers_steps(p1, seed):
    run = stl.learn(p1, "cfer", episodes=220, evaluate_every=110, seed=seed)
    assert run.environment_steps <= 4000 * 20 / 20
    assert run.history[-1].probability >= 0.99 * stl.check(p1).probability
    assert run.history[-1].probability == stl.check(p1, run.policy).probability


@pytest.mark.parametrize("seed", range(5))
def test_the_model_based_learner_does_within_a_fiftieth(p1, seed):
    run = stl.learn(p1, "model-based", episodes=90, evaluate_every=90, seed=seed)
    assert run.environment_steps <= 4000 * 20 / 50 + 20
    assert run.history[-1].probability >= 0.99 * stl.check(p1).probability


RUNS = [(method, False) for method in ("naive", "naive-er", "cfer", "model-based")]
RUNS += [(method, True) for method in ("naive", "naive-er", "cfer", "cfper")]


@pytest.mark.parametrize(("method", "faithful"), RUNS)
def test_same_seed_same_result(floor5, method, faithful):
    product = stl.build_product(floor5, stl.load_task(FACTORY / "reaching.stl"))
    settings = {"faithful": faithful, "episodes": 40, "evaluate_every": 10, "decay": 10}
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
    settings = {"faithful": faithful, "episodes": 6, "evaluate_every": 3, "batch": 8, "replays": 20, "memory": 150}
    seeds = np.random.SeedSequence(5).spawn(2)
    black_box = dataclasses.replace(simulator(p1.model, np.random.default_rng(seeds[0])), tables=None)
    whole, stepped = (stl.learn(p1, method, seed=5, environment=e, **settings) for e in (None, black_box))
    assert whole.history == stepped.history
    assert np.array_equal(whole.policy.table, stepped.policy.table)
    assert whole.counts.seen.tolist() == stepped.counts.seen.tolist()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_share_of_each_batch_can_be_factual(p1_flags, share):
    settings = Settings(factual_share=share, batch=8, memory=500)
    learner = FaithfulCfer(Problem.of(p1_flags), settings, "G", np.random.default_rng(0))
    learner.begin_episode(0.5, 20)
    q2 = int(p1_flags.automaton.delta[p1_flags.letter[4], 5])
    learner.observe(1, 3, 5, 2, 4, q2)
    assert learner.replay.place.tolist() == [100, 100]
    assert learner.replay.facts_place[1] == (share > 0)
    before = learner.table.Q.copy()
    learner.observe(4, 3, 5, 2, 4, q2)
    changed = np.argwhere(before != learner.table.Q)
    assert ((changed[:, [0, 2]] == [3, 2]).all(), len(changed) > 1) == (True, share < 1)
    with pytest.raises(SettingsError, match="leave it out"):
        stl.learn(p1_flags, "naive", faithful=True, factual_share=0.5)


def test_every_learner_finds_a_sure_way(patrolling):
    """Two states, one good action: all methods must get it."""
    go = np.array([[0.0, 1.0], [0.0, 1.0]])
    model = stl.MDP.from_arrays([np.eye(2), go], {"x": [0, 1]}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,3) G[0,2) A"))
    for method, faithful in RUNS:
        run = stl.learn(product, method, faithful=faithful, episodes=200, decay=50)
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


@given(products(longest=3), st.integers(0, 2**32 - 1))
def test_transitions_update_every_pair_they_speak_for(product, seed):
    """The entries' updates against a loop over all (t, q), by the definition."""
    if product.horizon == 0:
        return
    rng = np.random.default_rng(seed)
    problem, settings = Problem.of(product), Settings()
    table = ClockedTable(problem, settings, count_every_entry=False)
    automaton, letter, pairs = product.automaton, product.letter, open_pairs(product)
    Q = np.zeros((product.horizon, *product.shape, problem.most_choices))

    def value(t, s, q):
        verdict = automaton.verdicts(t)[q]
        return float(verdict) if verdict != UNDECIDED else Q[t, s, q, : problem.n_choices[s]].max()

    for _ in range(5):
        s, s2 = rng.integers(problem.n_states, size=2).tolist()
        a = int(rng.integers(problem.n_choices[s]))
        table.visits[s, a] += 1
        table.update_all(np.array([[s, a, s2]], dtype=np.int32))
        alpha = max(settings.least_step, 1 / table.visits[s, a])
        for t in reversed(range(product.horizon)):
            for q in range(automaton.n_states):
                if (letter[s], t, q) in pairs:
                    target = value(t + 1, s2, int(automaton.delta[letter[s2], q]))
                    Q[t, s, q, a] += alpha * (target - Q[t, s, q, a])
        for place in pairs:
            for state in np.flatnonzero(letter == place[0]):
                entry = table._index[place]
                assert np.allclose(table.Q[state, :, entry], Q[place[1], state, place[2]], atol=1e-15)
                assert table.V[state, entry] == table.Q[state, : problem.n_choices[state], entry].max()
    assert sum(table.entries) == len(pairs)
    policy = table.policy_table()
    for one, t, q in pairs:
        for state in np.flatnonzero(letter == one):
            visits = table.visits[state]
            tried = np.flatnonzero(visits)
            if len(tried):
                trusted = visits[tried] / (visits[tried] + settings.caution) * Q[t, state, q, tried]
                assert trusted[tried == policy[t, state, q]] >= trusted.max() - 1e-12


def test_plans_are_the_checkers(p1):
    """With every frequency right and no caution, the model-based policy is the optimum."""
    learner = ModelBased(Problem.of(p1), Settings(caution=0), np.random.default_rng(0))
    model, scale = p1.model, 30_000
    choice = np.repeat(np.arange(model.n_choices), np.diff(model.row_start))
    seen = np.rint(model.probability * scale).astype(np.int64)
    learner._counts.add(np.repeat(choice, seen), np.repeat(model.target.astype(np.int64), seen))
    learner._visits[:] = scale
    best = stl.check(p1).probability
    assert stl.check(p1, stl.Policy(p1, learner.policy_table())).probability == pytest.approx(best, abs=1e-9)
    learner._replan(0)
    assert stl.check(p1, stl.Policy(p1, learner._plan)).probability == pytest.approx(best, abs=1e-9)


def test_optimism_goes_for_what_is_unknown_and_caution_does_not(patrolling):
    """Two ways: one seen once to satisfy, one never tried; and one that has proved itself."""
    rows = np.zeros((3, 3, 3))
    rows[:, [1, 2], [1, 2]] = 1
    rows[0, 0, 1] = rows[1, 0, 2] = rows[2, 0, 2] = 1
    model = stl.MDP.from_arrays(rows, {"x": [0, 1, 2]}, labels={"A": [0, 0, 1]})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    learner = ModelBased(Problem.of(product), Settings(known_after=2), np.random.default_rng(0))
    q = product.enter(0, product.automaton.initial)
    for action, successor, times in ((0, 1, 5), (1, 2, 1), (2, 2, 9)):
        for _ in range(times):
            learner.observe(1, 0, q, action, successor, q)
    assert learner.policy_table()[0, 0, q] == 2
    learner.begin_episode(0.0, 1)
    assert learner.act(0, 0, q, 0.0, 0.0) == 2  # known to satisfy: better than the unknown by a hair
    for _ in range(40):
        learner.observe(1, 0, q, 2, 1, q)
    learner.begin_episode(0.0, 1)
    assert learner.act(0, 0, q, 0.0, 0.0) == 1
    assert learner.policy_table()[0, 0, q] == 1


def test_values_are_fixed_where_the_verdict_has_fallen(patrolling):
    table = ClockedTable(Problem.of(patrolling), Settings(), count_every_entry=False)
    rng = np.random.default_rng(0)
    rows = np.stack([rng.integers(n, size=300) for n in (18, 9, 18)], axis=1).astype(np.int32)
    np.add.at(table.visits, (rows[:, 0], rows[:, 1]), 1)
    table.update_all(rows)
    assert (table.V[:, -2:] == [0, 1]).all()
    assert ((table.V >= 0) & (table.V <= 1)).all()


def test_kernels_equal_their_python_twins(p1_flags, monkeypatch):
    """Every method, its compiled loops replaced by plain Python."""
    settings = {"episodes": 2, "evaluate_every": 2, "batch": 6, "replays": 10, "memory": 300, "seed": 2}
    runs = [run for run in RUNS if run[0] != "model-based"]
    fast = [stl.learn(p1_flags, m, faithful=f, **settings).policy.table for m, f in runs]
    names = [name for name, value in vars(kernels).items() if hasattr(value, "py_func")]
    assert len(names) >= 8
    for name in names:
        monkeypatch.setattr(kernels, name, getattr(kernels, name).py_func)
    for (method, faithful), table in zip(runs, fast, strict=True):
        slow = stl.learn(p1_flags, method, faithful=faithful, **settings).policy.table
        assert np.array_equal(slow, table), (method, faithful)


# ------------------------------------------------------------------------------------------- as published


def test_the_published_reward(floor5):
    charging = stl.build_product(floor5, stl.parse("F[0,10) G[0,5) C"), encoding="paper")
    outer_f = SurrogateTable(Problem.of(charging), Settings(), "F")
    assert outer_f.reward.tolist() == [-1, -1, -1, -1, -1, 1]
    patrol = stl.build_product(floor5, stl.parse("G[0,10) F[0,2) A"), encoding="paper")
    assert SurrogateTable(Problem.of(patrol), Settings(), "G").reward.tolist() == [-0.5, 0.5, 0.5]
    printed = SurrogateTable(Problem.of(patrol), Settings(scale="paper"), "G").reward
    assert np.allclose(printed, [-0.9, 0.1, 0.1])


def test_published_naive_update_by_hand(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,10) F[0,2) A"), encoding="paper")
    run = stl.learn(product, "naive", faithful=True, episodes=1)
    learner = FaithfulNaive(Problem.of(product), Settings(), "G", np.random.default_rng(0))
    learner.table.Q[7, 1] = np.arange(9)
    learner.observe(3, 4, 2, 3, 7, 1)
    assert learner.table.Q[4, 2, 3] == pytest.approx(0.01 * (0.5 + 0.999 * 8))
    assert np.count_nonzero(learner.table.Q) == 8 + 1
    assert run.environment_steps == 10 + 2


@pytest.mark.parametrize("method", [FaithfulCfer, FaithfulCfper])
def test_published_cfer_stores_one_tuple_for_every_flag_below_tau(p1_flags, method):
    p1 = p1_flags
    learner = method(Problem.of(p1), Settings(memory=1000), "G", np.random.default_rng(0))
    learner.observe(1, 3, 5, 2, 4, int(p1.automaton.delta[p1.letter[4], 5]))
    replay = learner.replay
    rows = replay.rows[: replay.place[1]]
    assert len(rows) == 100  # flags 0 … 9, twice: the published off-by-one leaves 10 out
    flags = p1.automaton.registers[rows[:, 1]]
    assert set(map(tuple, flags.tolist())) == set(np.ndindex(10, 10))
    assert (rows[:, [0, 2, 3]] == [3, 2, 4]).all()
    assert np.array_equal(rows[:, 4], p1.automaton.delta[p1.letter[4], rows[:, 1]])
    distance = np.abs(flags - p1.automaton.registers[5]).sum(axis=1)
    assert np.allclose(replay.weight[: len(rows)], np.exp(-distance) if method is FaithfulCfper else 1)


def test_cfper_draws_by_weight(p1_flags):
    """Weights e^-0, e^-1, e^-2 on three tuples: how often each is drawn."""
    learner = FaithfulCfper(Problem.of(p1_flags), Settings(alpha=1e-9), "G", np.random.default_rng(0))
    replay, weights = learner.replay, np.exp([0.0, -1.0, -2.0])
    replay.rows[:3] = [[1, 0, 0, 1, 0], [2, 0, 0, 1, 0], [3, 0, 0, 1, 0]]
    replay.weight[:3], replay.place[:] = weights, 3
    kernels.replay_batch(learner.table.kernel, replay, np.random.default_rng(1).random(100_000))
    drawn = learner.table.Q[1:4, 0, 0]
    assert np.allclose(drawn / drawn.sum(), weights / weights.sum(), atol=0.005)


@pytest.mark.parametrize("method", [FaithfulNaiveER, FaithfulCfer])
def test_published_replay_draws_at_every_fourth_step_only(p1, method):
    problem = Problem.of(with_flags(p1))
    learner = method(problem, Settings(alpha=0.001), "G", np.random.default_rng(0))
    learner.begin_episode(0.5, 20)
    for t, replayed in ((0, True), (1, False), (2, False), (3, False), (4, True)):
        before = learner.table.Q.copy()
        learner.observe(t, 3, 5, 2, 4, 6)
        changed = int((before != learner.table.Q).sum())
        assert changed >= 1 if replayed else changed == (method is FaithfulCfer)


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
    settings = Settings()
    values = [epsilon(settings, episode) for episode in (0, 400, 4000)]
    assert values == pytest.approx([0.99, 0.01 + 0.98 / np.e, 0.01], abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"method": "sarsa"}, "there is no method 'sarsa'"),
        ({"method": "cefr"}, "did you mean cfer"),
        ({"episode": 3}, "no setting 'episode'; did you mean episodes"),
        ({"episodes": 0}, "episodes is 0; it must be a whole number from 1"),
        ({"episodes": 2.5}, "episodes is 2.5"),
        ({"replays": -1}, "replays is -1"),
        ({"decay": 0}, "decay is 0; it must be positive"),
        ({"gamma": 1.5}, "gamma is 1.5; it must be between 0 and 1"),
        ({"alpha": 0}, "alpha is 0"),
        ({"scale": "both"}, "scale is 'both'; it must be published or paper"),
        ({"factual_share": 1.5}, "factual_share is 1.5; it must be between 0 and 1"),
        ({"caution": -1}, "caution is -1"),
        ({"known_after": 0}, "known_after is 0"),
        ({"method": "cfper"}, "exists as published only"),
        ({"method": "model-based", "faithful": True}, "no published method"),
        ({"resume": True}, "needs the checkpoint"),
    ],
)
def test_impossible_settings_are_refused(patrolling, arguments, says):
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, **arguments)


def test_a_task_decided_by_the_first_state_leaves_nothing_to_learn(floor5):
    with pytest.raises(SettingsError, match="nothing to learn"):
        stl.learn(stl.build_product(floor5, stl.parse("A | B")))
