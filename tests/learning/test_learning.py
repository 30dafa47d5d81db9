import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.errors import SettingsError
from stltool.kernels import learning as kernels
from stltool.learning import METHODS, Settings
from stltool.learning.cfer import Cfer, FaithfulCfer
from stltool.learning.naive_er import FaithfulNaiveER
from stltool.learning.problem import Problem
from stltool.learning.replay import ReplayMemory
from stltool.learning.schedule import epsilon
from stltool.learning.tables import ClockedTable, SurrogateTable
from stltool.learning.trainer import train
from stltool.models.environment import Environment
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
def test_corrected_cfer_learns_p1_within_the_papers_budget(p1, seed):
    run = stl.learn(p1, "cfer", episodes=600, evaluate_every=100, seed=seed)
    assert run.history[-1].probability >= 0.95
    assert run.environment_steps == 600 * 18
    assert run.history[-1].probability == stl.check(p1, run.policy).probability


@pytest.mark.parametrize("faithful", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_same_seed_same_result(floor5, method, faithful):
    product = stl.build_product(floor5, stl.load_task(FACTORY / "reaching.stl"))
    settings = {"faithful": faithful, "episodes": 40, "evaluate_every": 10, "decay": 10}
    first, again, other = (stl.learn(product, method, seed=seed, **settings) for seed in (3, 3, 4))
    assert first.history == again.history
    assert np.array_equal(first.policy.table, again.policy.table)
    assert not np.array_equal(first.policy.table, other.policy.table)
    assert [point.episode for point in first.history] == [10, 20, 30, 40]
    length = product.horizon + 2 if faithful else product.horizon
    assert first.environment_steps == 40 * length
    assert all(point.probability <= stl.check(product).upper for point in first.history)


def test_every_learner_finds_a_sure_way(patrolling):
    """Two states, one good action: all methods must get it."""
    go = np.array([[0.0, 1.0], [0.0, 1.0]])
    model = stl.MDP.from_arrays([np.eye(2), go], {"x": [0, 1]}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,3) G[0,2) A"))
    for method in METHODS:
        for faithful in (False, True):
            run = stl.learn(product, method, faithful=faithful, episodes=200, decay=50)
            assert run.history[-1].probability == 1.0, (method, faithful)


def test_a_learner_needs_nothing_but_reset_and_step(p1):
    """The environment is scripted: no model stands behind it, and nothing but labels and sizes is handed over."""
    problem = Problem.of(p1)
    assert {field.name for field in dataclasses.fields(problem)} == {"automaton", "letter", "n_choices"}
    seen = []

    def step(action):
        seen.append(action)
        return (seen[-1] * 5 + len(seen)) % p1.model.n_states

    settings = Settings(episodes=3, evaluate_every=1)
    learner = Cfer(problem, settings, np.random.default_rng(0))
    history = train(
        problem, Environment(lambda: 0, step), learner, settings, np.random.default_rng(0),
        episode_length=10, read_first_state=True, evaluate=lambda table: float(table.shape[0]),
    )  # fmt: skip
    assert len(seen) == 30
    assert [(point.steps, point.probability) for point in history] == [(10, 18), (20, 18), (30, 18)]


@given(products(longest=3), st.integers(0, 2**32 - 1))
def test_one_transition_updates_every_pair_it_speaks_for(product, seed):
    """The vectorised update against a loop over all (t, q), by the definition."""
    if product.horizon == 0:
        return
    rng = np.random.default_rng(seed)
    problem, settings = Problem.of(product), Settings()
    table = ClockedTable(problem, settings, count_every_entry=False)
    automaton, letter = product.automaton, product.letter
    live = automaton.live()
    Q, V = table.Q.copy(), table.V.copy()
    for _ in range(5):
        s, s2 = rng.integers(problem.n_states, size=2).tolist()
        a = int(rng.integers(problem.n_choices[s]))
        table.visits[s, a] += 1
        alpha = max(settings.least_step, 1 / table.visits[s, a])
        table.update_all(s, a, s2)
        for t in reversed(range(product.horizon)):
            for q in np.unique(automaton.delta[letter[s]]):
                if live[t, q]:
                    target = V[s2, t + 1, automaton.delta[letter[s2], q]]
                    Q[s, a, t, q] += alpha * (target - Q[s, a, t, q])
                    V[s, t, q] = Q[s, : problem.n_choices[s], t, q].max()
        reached = live[None] & np.isin(np.arange(automaton.n_states), automaton.delta[letter[s]])
        assert np.allclose(table.Q[s][:, reached[0]], Q[s][:, reached[0]], atol=1e-15)
        assert np.allclose(table.V[:, -1], V[:, -1])


def test_values_are_fixed_where_the_verdict_has_fallen(patrolling):
    table = ClockedTable(Problem.of(patrolling), Settings(), count_every_entry=False)
    for t in range(patrolling.horizon + 1):
        verdicts = patrolling.automaton.verdicts(t)
        assert (table.V[:, t, verdicts == TRUE] == 1).all()
        assert (table.V[:, t, verdicts != TRUE] == 0).all()
    assert not table.live[:, :][patrolling.automaton.verdicts(0)[None].repeat(8, 0) != UNDECIDED].any()


def test_kernels_equal_their_python_twins(p1_flags):
    p1, rng = p1_flags, np.random.default_rng(0)
    problem = Problem.of(p1)
    Q = rng.random((problem.n_states, p1.automaton.n_states, 9))
    tuples = np.stack(
        [rng.integers(n, size=50) for n in (problem.n_states, p1.automaton.n_states, 9, problem.n_states, 121)], axis=1
    ).astype(np.int32)
    drawn, reward = rng.integers(50, size=200), rng.random(121)
    slow = Q.copy()
    kernels.surrogate_updates(Q, reward, tuples, drawn, 0.01, 0.999)
    kernels.surrogate_updates.py_func(slow, reward, tuples, drawn, 0.01, 0.999)
    assert np.array_equal(Q, slow)
    tables = [ClockedTable(problem, Settings(), count_every_entry=True) for _ in range(2)]
    for kernel, table in zip((kernels.clocked_update, kernels.clocked_update.py_func), tables, strict=True):
        choose = np.random.default_rng(1)
        for _ in range(200):
            t, s, q, a, s2, q2 = (int(choose.integers(n)) for n in (18, 18, 121, 9, 18, 121))
            kernel(table.Q, table.V, table.visits, table.live, t, s, q, a, s2, q2, 9, 0.02)
    assert np.array_equal(tables[0].Q, tables[1].Q)
    assert np.array_equal(tables[0].V, tables[1].V)


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
    learner = SurrogateTable(Problem.of(product), Settings(), "G")
    learner.Q[7, 1] = np.arange(9)
    learner.update(np.array([[4, 2, 3, 7, 1]], dtype=np.int32), np.zeros(1, dtype=np.int64))
    assert learner.Q[4, 2, 3] == pytest.approx(0.01 * (0.5 + 0.999 * 8))
    assert np.count_nonzero(learner.Q) == 8 + 1
    assert run.environment_steps == 10 + 2


def test_published_cfer_stores_one_tuple_for_every_flag_below_tau(p1_flags):
    p1 = p1_flags
    problem, settings = Problem.of(p1), Settings(memory=1000)
    learner = FaithfulCfer(problem, settings, "G", np.random.default_rng(0))
    learner.observe(1, 3, 5, 2, 4, int(p1.automaton.delta[p1.letter[4], 5]))
    rows = learner._memory.rows[: learner._memory.size]
    assert len(rows) == 100  # flags 0 … 9, twice: the published off-by-one leaves 10 out
    assert set(map(tuple, p1.automaton.registers[rows[:, 1]].tolist())) == set(np.ndindex(10, 10))
    assert (rows[:, [0, 2, 3]] == [3, 2, 4]).all()
    assert np.array_equal(rows[:, 4], p1.automaton.delta[p1.letter[4], rows[:, 1]])


def test_published_replay_draws_at_every_fourth_step_only(p1):
    learner = FaithfulNaiveER(Problem.of(p1), Settings(), "G", np.random.default_rng(0))
    for t, changed in ((1, False), (2, False), (3, False), (4, True)):
        before = learner.table.Q.copy()
        learner.observe(t, 3, 5, 2, 4, 6)
        assert (not np.array_equal(before, learner.table.Q)) is changed


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
    ],
)
def test_impossible_settings_are_refused(patrolling, arguments, says):
    with pytest.raises(SettingsError, match=says):
        stl.learn(patrolling, **arguments)


def test_a_task_decided_by_the_first_state_leaves_nothing_to_learn(floor5):
    with pytest.raises(SettingsError, match="nothing to learn"):
        stl.learn(stl.build_product(floor5, stl.parse("A | B")))
