"""examples/deep: what its parts do, in small; the same loop on Stable-Baselines3 where it is installed."""

import numpy as np
import pytest
from gymnasium import spaces

import stltool as stl
from examples.deep import dqn


@pytest.fixture(scope="module")
def product():
    """Go to B, half of the time one gets there; a step back is possible. Optimum 3/4."""
    stay, go = np.eye(2), [[0.5, 0.5], [0.5, 0.5]]
    model = stl.MDP.from_arrays([stay, go], {}, labels={"B": [0, 1]}, action_names=["stay", "go"])
    return stl.build_product(model, stl.parse("F[0,2] G[0,1] B"))


def test_gradients_are_those_of_differences():
    rng = np.random.default_rng(0)
    network = dqn.Network(3, 2, rng, hidden=4, rate=1e-6)
    for _, bias in network.layers:
        bias += 0.1 * rng.standard_normal(bias.shape)  # at 0, units without inputs are at their kink
    x, chosen, target = rng.standard_normal((5, 3)), np.array([0, 1, 1, 0, 1]), 0.1 * rng.standard_normal(5)

    def loss():
        error = network(x)[np.arange(5), chosen] - target
        return np.where(abs(error) < 1, error**2 / 2, abs(error) - 0.5).mean()

    before = [[p.copy() for p in layer] for layer in network.layers]
    slopes = []
    for layer in network.layers:
        for p in layer:
            for place in np.ndindex(p.shape):
                p[place] += 1e-6
                above = loss()
                p[place] -= 2e-6
                slopes.append((above - loss()) / 2e-6)
                p[place] += 1e-6
    network.fit(x, chosen, target)
    moved = np.concatenate([(new - old).ravel() for one, two in zip(network.layers, before, strict=True)
                            for new, old in zip(one, two, strict=True)])  # fmt: skip
    clear = abs(np.array(slopes)) > 1e-5
    assert clear.sum() > 10
    assert (np.sign(moved[clear]) == -np.sign(np.array(slopes)[clear])).all()  # Adam begins by signs


def test_the_buffer_keeps_the_newest_rows(product):
    env = stl.to_gymnasium(product, counterfactuals=3)
    space = env.observation_space
    buffer = dqn.ReplayBuffer(6, spaces.flatdim(space))
    env.reset(seed=0)
    told = env.step(1)[4]["crm-experience"]
    dqn.store(buffer, space, told)
    dqn.store(buffer, space, told)
    assert buffer.added == 8
    for row, (before, action, reward, after, done) in zip([4, 5, 0, 1], told, strict=True):
        assert (buffer.before[row] == spaces.flatten(space, before)).all()
        assert (buffer.after[row] == spaces.flatten(space, after)).all()
        assert (buffer.action[row], buffer.reward[row], buffer.done[row]) == (action, reward, done)


def test_situations_are_flattened_as_observations(product):
    env, seen = stl.to_gymnasium(product), []

    def act(here):
        rows = dqn.one_hot(env, here)
        for i in range(len(here)):
            observation = env.observation(here.step, here.state[i], here.memory[i])
            assert (rows[i] == spaces.flatten(env.observation_space, observation)).all()
            seen.append(observation)
        return np.ones(len(here), dtype=int)

    stl.check(product, stl.Policy.from_function(product, act, batched=True))
    assert len(seen) > 3


def test_it_learns_a_small_task(product):
    best = stl.check(product).probability
    for k in (0, 8):
        assert stl.check(product, dqn.train(product, 60, k, seed=1)).probability > 0.9 * best


def test_it_prints_every_seed(capsys):
    dqn.main(["--episodes", "2", "--seeds", "2"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "optimum  0.738"
    assert [line.split(":")[0] for line in lines[1:]] == [
        " 0 counterfactual transitions a step", "16 counterfactual transitions a step",
    ]  # fmt: skip
    assert all(len(line.split(":")[1].split()) == 2 + 2 for line in lines[1:])


def test_stable_baselines_takes_the_same_rows(product):
    pytest.importorskip("stable_baselines3", reason="needs torch, which is too large for CI")
    best = stl.check(product).probability
    assert stl.check(product, dqn.train_sb3(product, 200, 8, seed=1)).probability > 0.9 * best
