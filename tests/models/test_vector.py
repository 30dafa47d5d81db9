"""Gymnasium's vector environments: run by run the same as their environments one by one."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import stltool as stl
from stltool.errors import ModelError, SettingsError
from tests.models.gymnasium_envs import Scripted

pytestmark = pytest.mark.filterwarnings("ignore:.*not having a spec.*:UserWarning")


class Walk(gymnasium.Env):
    """A pair (place, doors opened): actions walk at random or open a door; the last place ends the episode."""

    observation_space = spaces.Tuple([spaces.Discrete(4, start=1), spaces.Discrete(2)])
    action_space = spaces.Discrete(2, start=5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.here, self.door = 1, 0
        return (self.here, self.door), {}

    def step(self, action):
        assert self.here < 4, "stepped after its end"
        if action == 6:
            self.door = 1
        else:
            self.here += int(self.np_random.integers(2))
        return (self.here, self.door), 0.0, self.here == 4, False, {}


def vector(n, mode):
    return SyncVectorEnv([Walk] * n, autoreset_mode=mode)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("ends", ["merged", "apart"])
def test_every_run_is_that_of_its_environment(mode, ends):
    n = 5
    model = stl.from_gymnasium(vector(n, mode), {"open": lambda o: o[1] == 1}, ends=ends)
    assert model.n_states == 8 * (2 if ends == "apart" else 1)
    assert model.action_names == ("5", "6")
    runs = model.blackbox(np.random.default_rng(3), 40)
    seeds, rng = np.random.default_rng(3), np.random.default_rng(0)
    assert runs.batch == n
    for live in (n, 2, n):
        alone = [Walk() for _ in range(n)]
        for env, seed in zip(alone, seeds.integers(2**31, size=n).tolist(), strict=True):
            env.reset(seed=seed)
        assert runs.reset(live).tolist() == [0] * live
        ended, over = np.zeros(live, dtype=bool), np.zeros(live, dtype=bool)
        for _ in range(40):
            actions = np.where(over, -1, rng.integers(2, size=live))
            found = runs.step(actions)
            for i in np.flatnonzero(~over).tolist():
                if not ended[i]:
                    ended[i] = alone[i].step(5 + int(actions[i]))[2]
                apart = 8 if ended[i] and ends == "apart" else 0
                assert found[i] == 2 * (alone[i].here - 1) + alone[i].door + apart
            over |= rng.random(live) < 0.02  # nobody asks for it any more
        assert ended.any()


@pytest.mark.soak(only=True)
def test_learning_and_judging_take_as_many_as_there_are():
    labels = {"goal": {15}, "hole": {5, 7, 11, 12}}
    model = stl.from_gymnasium(gymnasium.make_vec("FrozenLake-v1", 8), labels)
    product = stl.build_product(model, stl.parse("!hole U[0,12] goal"))
    run = stl.learn(product, "model-based", episodes=200, evaluate_every=200)
    assert run.counts.visits.sum() == run.environment_steps
    known = stl.build_product(stl.from_gymnasium(gymnasium.make("FrozenLake-v1"), labels), product.formula)
    exact = stl.check(known, stl.Policy(known, run.policy.form)).probability
    assert exact > 0.1 * stl.check(known).probability
    found = stl.estimate(product, run.policy, runs=400, confidence=0.999999)
    assert found.lower <= exact <= found.upper
    again = stl.learn(product, "model-based", episodes=200, evaluate_every=200)
    assert (again.counts.seen == run.counts.seen).all()


def test_what_does_not_fit_is_refused():
    def of(env, **options):
        return stl.from_gymnasium(SyncVectorEnv([lambda: env] * 2), **options)

    with pytest.raises(ModelError, match="is a vector environment, which has no table; give one of its environments"):
        of(Walk(), table=True)
    with pytest.raises(SettingsError, match="give one of its environments for cells"):
        of(Walk(), cells=lambda o: 0, n_cells=1)
    with pytest.raises(SettingsError, match="give one of its environments for cells and labels of steps"):
        of(Walk(), labels={"lost": "info.lost"})
    product = stl.build_product(of(Walk(), labels={"end": lambda o: o[0] == 4}), stl.parse("F[0,5] end"))
    first, second = (product.model.blackbox(np.random.default_rng(i), 5) for i in range(2))
    first.reset(2)
    second.reset(2)
    with pytest.raises(ModelError, match="another run has reset this environment in the middle of an episode"):
        first.step(np.array([0, 0]))
    cut = stl.from_gymnasium(SyncVectorEnv([lambda: Scripted((0, {}), [(1, 0.0, False, True, {})] * 3)] * 2))
    runs = cut.blackbox(np.random.default_rng(0), 3)
    runs.reset(2)
    runs.step(np.array([0, -1]))
    assert runs.step(np.array([-1, -1])).tolist() == [1, 0]  # nobody needs what was cut off
    runs.reset(2)
    runs.step(np.array([0, -1]))
    with pytest.raises(ModelError, match=r"cut off \(truncated\) after 1 steps, and the task needs 3; make it with"):
        runs.step(np.array([0, -1]))
    both = stl.from_gymnasium(SyncVectorEnv([lambda: Scripted((0, {}), [(0, 0.0, True, False, {})])] * 2))
    runs = both.blackbox(np.random.default_rng(0), 1)
    runs.reset(2)
    with pytest.raises(ModelError, match="the observation 0 occurred both during an episode and at its end"):
        runs.step(np.array([0, 0]))
    short = stl.from_gymnasium(gymnasium.make_vec("FrozenLake-v1", 2), {"a": {1}})
    with pytest.raises(ModelError, match=r"its episodes are cut off .* after 100 steps"):
        stl.learn(stl.build_product(short, stl.parse("F[0,200] a")), episodes=1)
