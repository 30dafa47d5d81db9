"""Products as Gymnasium environments: their returns are the task, their counterfactuals what would have happened."""

import itertools

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.errors import ArgumentError, ModelError, SettingsError
from tests import oracles
from tests.checking.test_black_box import hidden
from tests.conftest import many

pytestmark = pytest.mark.filterwarnings("ignore:.*not having a spec.*:UserWarning")
TASKS = ["F[0,3] A", "G[0,2) F[0,2) A", "A U[0,3] B", "F[0,2] (A & F[0,2] B)", "A", "!A & F[1,2] B"]


def random_product(seed, text, size=5, encoding="exact"):
    return stl.build_product(oracles.random_model(np.random.default_rng(seed), size), stl.parse(text), encoding)


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(30))
def test_an_episodes_return_is_the_tasks_truth(seed, text):
    product = random_product(seed, text)
    env = stl.to_gymnasium(product)
    for episode in range(4):
        observation, info = env.reset(seed=seed % 1000 if not episode else None)
        states, total, over = [int(observation["state"])], 0.0, False
        while not over:
            assert env.observation_space.contains(observation)
            options = np.flatnonzero(env.action_masks())
            assert options.tolist() == np.flatnonzero(info["action_mask"]).tolist()
            assert "is_success" not in info
            observation, reward, over, truncated, info = env.step(int(options[len(states) % len(options)]))
            total += reward
            states.append(int(observation["state"]))
            assert not truncated
        decided = [q for q in (0, 1) if total == q]
        read = states if product.horizon else states[:1]
        read = read + [read[-1]] * (product.horizon + 1 - len(read))  # decided: whatever follows changes nothing
        signal = {name: column[read] for name, column in {**product.model.labels, **product.model.signals}.items()}
        assert decided == [int(stl.satisfies(product.formula, signal))]
        assert info["is_success"] == bool(total)
        with pytest.raises(ModelError, match="after the end of an episode; call reset"):
            env.step(0)


def test_spaces_and_names(patrolling):
    env = stl.to_gymnasium(patrolling)
    check_env(env)
    S, Q = patrolling.shape
    assert env.observation_space == spaces.Dict(
        state=spaces.Discrete(S), memory=spaces.Discrete(Q), to_go=spaces.Discrete(patrolling.horizon + 1)
    )
    observation, info = env.reset(seed=3)
    assert (info["state"], int(observation["to_go"])) == ("(1,0)", 8)
    assert info["memory"] == patrolling.automaton.describe(int(observation["memory"]))
    with pytest.raises(ModelError, match="action 9 is not one of 0 … 8"):
        env.step(9)
    with pytest.raises(ModelError, match="call reset"):
        stl.to_gymnasium(patrolling).step(0)
    first = [env.reset(seed=5)[0], *(env.step(a)[0] for a in (1, 2))]
    assert first == [env.reset(seed=5)[0], *(env.step(a)[0] for a in (1, 2))]


@pytest.mark.soak(only=True)
def test_the_mean_return_of_a_policy_is_its_probability(patrolling):
    policy = stl.learn(patrolling, "model-based", episodes=30, seed=0).policy
    exact = stl.check(patrolling, policy).probability
    assert 0.05 < exact < 0.95
    env, total, runs = stl.to_gymnasium(patrolling), 0.0, 500
    for run in range(runs):
        observation, _ = env.reset(seed=0 if not run else None)
        over = False
        while not over:
            t = patrolling.horizon - int(observation["to_go"])
            action = policy.at(t, [observation["state"]], [observation["memory"]])[0]
            observation, reward, over, _, _ = env.step(int(action))  # on the floor, choices are actions
            total += reward
    assert abs(total / runs - exact) < 4.5 * np.sqrt(exact * (1 - exact) / runs)


def places(product, s):
    """Every undecided (t, q) of a run that has just read s, by all words of letters that lead there."""
    automaton, found = product.automaton, set()
    letters = range(automaton.n_letters)
    for t in range(product.horizon):
        for word in itertools.product(letters, repeat=t):
            q, undecided = automaton.initial, True
            for step, letter in enumerate((*word, product.letter[s])):
                q = int(automaton.delta[letter, q])
                undecided &= automaton.verdicts(step)[q] == UNDECIDED
            if undecided:
                found.add((t, q))
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(8))
def test_counterfactuals_are_all_that_could_have_been(seed, text):
    product = random_product(seed, text, 3)
    env, h = stl.to_gymnasium(product), product.horizon
    for s, a, s2 in itertools.product(range(product.model.n_states), [0], range(product.model.n_states)):
        found = env.counterfactuals(s, a, s2)
        seen = set()
        for before, action, reward, after, done in found.rows():
            t, q, q2 = h - before["to_go"], before["memory"], after["memory"]
            seen.add((t, q))
            assert (before["state"], action, after["state"], after["to_go"]) == (s, a, s2, h - t - 1)
            assert q2 == product.enter(s2, q)
            verdict = product.automaton.verdicts(t + 1)[q2]
            assert (reward, done) == (float(verdict == 1), verdict >= 0)
        assert len(found.actions) == len(seen)
        assert seen == places(product, s)


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(8))
def test_values_from_counterfactuals_alone_are_the_optimum(seed, text):
    """Every transition of the model once, weighted by its probability: Q-learning from these arrays ends at P*."""
    product = random_product(seed, text, 4)
    model, h = product.model, product.horizon
    env, Q = stl.to_gymnasium(product), {}
    tuples = []
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            for e in range(model.row_start[c], model.row_start[c + 1]):
                found = env.counterfactuals(s, int(model.choice_action[c]), int(model.target[e]))
                tuples += [(model.probability[e], *row) for row in found.rows()]
    key = lambda o: (o["to_go"], o["state"], o["memory"])  # noqa: E731
    for share, before, action, reward, after, done in sorted(tuples, key=lambda one: one[1]["to_go"]):
        ahead = 0.0 if done else max(Q[key(after)].values())
        here = Q.setdefault(key(before), {})
        here[action] = here.get(action, 0.0) + share * (reward + ahead)
    best = 0.0
    for s in np.flatnonzero(model.initial):
        q = product.enter(int(s), product.automaton.initial)
        verdict = product.automaton.verdicts(0)[q]
        best += model.initial[s] * (float(verdict) if verdict >= 0 else max(Q[h, int(s), q].values()))
    assert best == pytest.approx(stl.check(product).probability, abs=1e-12)


def test_counterfactuals_in_info(patrolling):
    env = stl.to_gymnasium(patrolling, counterfactuals=5)
    check_env(env)
    before, _ = env.reset(seed=0)
    after, reward, over, _, info = env.step(7)
    told = info["crm-experience"]
    assert len(told) == 6
    assert told[0] == (before, 7, reward, after, over)
    every = env.counterfactuals(before["state"], 7, after["state"]).rows()
    assert all(row in every for row in told)
    again = stl.to_gymnasium(patrolling, counterfactuals=5)
    again.reset(seed=0)
    assert again.step(7)[4]["crm-experience"] == told  # drawn from the environment's own generator
    assert "crm-experience" not in stl.to_gymnasium(patrolling).reset(seed=0)[1]
    for s, a, s2, most in ((99, 0, 0, None), (0, 9, 0, None), (0, 0, -1, None), (0, 0, 0, -1)):
        with pytest.raises(SettingsError, match="must be an integer from 0"):
            env.counterfactuals(s, a, s2, most)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_several_side_by_side(patrolling, mode):
    """Rewards and ends of vectorised environments are those of single ones, episode after episode."""
    n, steps = 3, 40
    fleet = SyncVectorEnv(
        [lambda: stl.to_gymnasium(patrolling, counterfactuals=2) for _ in range(n)], autoreset_mode=mode
    )
    alone = [stl.to_gymnasium(patrolling, counterfactuals=2) for _ in range(n)]
    fleet.reset(seed=[1, 2, 3])
    waiting = [False] * n
    for one, seed in zip(alone, (1, 2, 3), strict=True):
        one.reset(seed=seed)
    ends = 0
    for step in range(steps):
        actions = np.array([(step + i) % 9 for i in range(n)])
        observations, rewards, terminated, truncated, infos = fleet.step(actions)
        for i, one in enumerate(alone):
            if waiting[i]:
                seen, reward, over = one.reset()[0], 0.0, False
            else:
                seen, reward, over, _, info = one.step(int(actions[i]))
                assert len(infos["crm-experience"][i] if mode == AutoresetMode.NEXT_STEP or not over else
                           infos["final_info"]["crm-experience"][i]) == 3  # fmt: skip
            if over and mode == AutoresetMode.SAME_STEP:
                assert infos["final_obs"][i] == seen
                assert infos["final_info"]["is_success"][i] == info["is_success"] == bool(reward)
                seen = one.reset()[0]
            waiting[i] = over and mode == AutoresetMode.NEXT_STEP
            ends += over
            assert {key: int(values[i]) for key, values in observations.items()} == seen
            assert (rewards[i], terminated[i], truncated[i]) == (reward, over, False)
    assert ends > n


def test_the_surrogate_reward_counts_true_steps(floor5):
    for text, low, high in (("F[0,3) G[0,2) C", -1.0, 1.0), ("G[0,3) F[0,2) A", -0.5, 0.5)):
        product = stl.build_product(floor5, stl.parse(text), encoding="paper")
        env = stl.to_gymnasium(product, reward="surrogate")
        check_env(env)
        observation, _ = env.reset(seed=1)
        over, steps = False, 0
        while not over:
            observation, reward, over, _, info = env.step(steps % 9)
            steps += 1
            assert reward == (high if product.automaton.verdict_rows[-1][observation["memory"]] else low)
        assert steps == product.horizon  # a verdict does not end the episode
        assert isinstance(info["is_success"], bool)
        found = env.counterfactuals(0, 1, 2)
        assert set(found.rewards.tolist()) <= {low, high}
        assert found.terminated.tolist() == [to_go == 0 for to_go in found.next_observations["to_go"]]
    with pytest.raises(SettingsError, match="has the encoding exact; build it with encoding='paper'"):
        stl.to_gymnasium(stl.build_product(floor5, product.formula), reward="surrogate")
    with pytest.raises(SettingsError, match="reward is 'paper'; choose exact or surrogate"):
        stl.to_gymnasium(product, reward="paper")
    with pytest.raises(SettingsError, match="give a product of model and task"):
        stl.to_gymnasium(floor5, counterfactuals=3)


def test_several_tasks_are_refused_and_cells_are_not(floor5):
    first, second = stl.parse("F[0,2] A"), stl.parse("F[0,3] G[0,1] A")
    joint = stl.build_joint_product(floor5, {"first": first, "second": second})
    with pytest.raises(ArgumentError, match=r"take that of one, joint\.tasks\[0\], or build a product with all"):
        stl.to_gymnasium(joint)
    for way_out in (joint.tasks[0], stl.build_product(floor5, first & second)):
        observation, _ = stl.to_gymnasium(way_out).reset(seed=0)
        assert int(observation["to_go"]) == way_out.horizon
    cells = stl.from_gymnasium(gymnasium.make("CartPole-v1"), signals={"angle": 2}, cells={"angle": [-0.05, 0, 0.05]})
    env = stl.to_gymnasium(cells)
    observation, info = env.reset(seed=0)
    assert info["state"] == cells.state_name(int(observation))
    assert env.observation_space.contains(observation)
    real = stl.to_gymnasium(stl.build_product(cells, stl.parse("G[0,5] angle < 0.1")))
    assert real.reset(seed=0)[0]["observation"].shape == (4,)


def test_black_boxes_and_actions_that_are_not_there(floor5):
    product = stl.build_product(hidden(floor5), stl.parse("F[0,3] A"))
    known = stl.to_gymnasium(stl.build_product(floor5, product.formula))
    env = stl.to_gymnasium(product)
    check_env(env)
    assert [env.reset(seed=2)[0], env.step(4)[0]] == [known.reset(seed=2)[0], known.step(4)[0]]
    go, back = np.array([[0.0, 1], [0, 0]]), np.array([[0.0, 0], [1, 0]])
    model = stl.MDP.from_arrays([go, back], {}, labels={"A": [0, 1]}, action_names=["go", "back"])
    some = stl.build_product(model, stl.parse("G[2,3] A"))
    env = stl.to_gymnasium(some)
    env.reset(seed=0)
    assert env.action_masks().tolist() == [True, False]
    with pytest.raises(ModelError, match="action back is not available in state 0"):
        env.step(1)
    staying = stl.to_gymnasium(some, "stay")
    staying.reset(seed=0)
    observation, *_ = staying.step(1)
    assert (observation["state"], observation["to_go"]) == (0, 2)  # time passes


def test_a_policy_function_reads_the_environments_observations(patrolling):
    env = stl.to_gymnasium(patrolling)
    best = stl.check(patrolling).policy

    def agent(observation):
        t = patrolling.horizon - int(observation["to_go"])
        return int(best.at(t, [observation["state"]], [observation["memory"]])[0])

    policy = stl.Policy.from_function(
        patrolling, lambda here: agent(env.observation(here.step, here.state, here.memory))
    )
    assert stl.check(patrolling, policy).probability == pytest.approx(stl.check(patrolling).probability, abs=1e-15)


def test_wrappers_of_gymnasium_work(patrolling):
    env = gymnasium.wrappers.RecordEpisodeStatistics(
        gymnasium.wrappers.FlattenObservation(stl.to_gymnasium(patrolling))
    )
    observation, _ = env.reset(seed=0)
    assert observation.sum() == 3  # one-hot each
    over = False
    while not over:
        _, _, over, _, info = env.step(0)
    assert info["episode"]["r"] == info["is_success"]


@pytest.mark.parametrize("rule", ["static", "ratio"])
def test_whatever_an_agent_does_under_a_shield_the_promise_is_kept(patrolling, rule):
    best = stl.check(patrolling).probability
    shield = stl.shield(patrolling, 0.8 * best, rule, levels=16)
    env = stl.to_gymnasium(patrolling, shield=shield)
    check_env(env)
    rng, total, runs, replaced = np.random.default_rng(0), 0.0, 150, 0
    for run in range(runs):
        observation, info = env.reset(seed=0 if not run else None)
        assert "replaced" not in info
        over = False
        while not over:
            assert ("allowance" in observation) == (rule == "ratio")
            mask = env.action_masks()
            assert mask.tolist() == info["action_mask"].tolist()
            action = int(rng.integers(env.action_space.n))
            observation, reward, over, _, info = env.step(action)
            assert env.observation_space.contains(observation)
            assert info["replaced"] == (not mask[action])
            replaced += info["replaced"]
        total += reward
    assert replaced > 0
    assert total / runs >= shield.at_least - 0.15  # more than three standard deviations


def test_a_shield_may_refuse_instead(patrolling):
    shield = stl.shield(patrolling, 0.9 * stl.check(patrolling).probability)
    env = stl.to_gymnasium(patrolling, shield=shield, refused="error")
    env.reset(seed=1)
    over = False
    while env.action_masks().all():
        over = env.step(0)[2]
        if over:
            env.reset()
    refused = int(np.flatnonzero(~env.action_masks())[0])
    with pytest.raises(ModelError, match="is refused by the shield in state .*, which allows"):
        env.step(refused)
    with pytest.raises(SettingsError, match="leave counterfactuals out, or shield"):
        stl.to_gymnasium(patrolling, shield=shield, counterfactuals=2)
    with pytest.raises(SettingsError, match="shields are those of a task"):
        stl.to_gymnasium(patrolling.model, shield=shield)
