"""Black boxes that take many runs at once: the same verdicts, run by run, as from a box that takes them one by one."""

import numpy as np
import pytest

import stltool as stl
from stltool.checking.rollouts import Rollouts
from stltool.errors import ArgumentError, ModelError, PolicyError, SettingsError
from stltool.models.environment import simulator
from tests.checking.test_black_box import hidden


class Numbered:
    """Run k of all has the k-th generator, however runs are taken."""

    def __init__(self, model):
        self.model, self.begun, self.runs, self.calls = model, 0, [], 0

    def new(self):
        self.begun += 1
        return simulator(self.model, np.random.default_rng(self.begun))


class OneByOne(Numbered):
    def reset(self):
        self.run = self.new()
        return self.run.reset()

    def step(self, action):
        return self.run.step(action)


class SideBySide(Numbered):
    """Answers nonsense for runs that are over."""

    def __init__(self, model, batch):
        super().__init__(model)
        self.batch = batch

    def reset(self, n):
        assert 1 <= n <= self.batch
        self.runs = [self.new() for _ in range(n)]
        return [run.reset() for run in self.runs]

    def step(self, actions):
        assert actions.shape == (len(self.runs),)
        self.calls += 1
        found = [run.step(a) if a >= 0 else -7 for run, a in zip(self.runs, actions.tolist(), strict=True)]
        actions[:] = -9  # which is nobody else's array
        return np.array(found, dtype=np.int16)


@pytest.fixture(scope="module")
def product(floor5):
    return stl.build_product(floor5, stl.parse("G[0,5) (F[0,5) A & F[0,5) (x < 0.4 & y > 0.6))"))


@pytest.fixture(scope="module")
def policy(product):
    return stl.check(product).policy


@pytest.mark.parametrize("batch", [1, 7, 40, 64])
def test_verdicts_are_those_of_runs_one_by_one(product, policy, batch):
    one, many = OneByOne(product.model), SideBySide(product.model, batch)
    alone = Rollouts(product, policy, 40, 0, one)
    together = Rollouts(product, policy, 40, 0, many)
    assert np.concatenate(list(alone)).tolist() == np.concatenate(list(together)).tolist()
    assert alone.steps == together.steps
    assert many.begun == 40
    assert many.calls <= -(-40 // batch) * product.horizon
    assert 0 < np.concatenate(list(together)).sum() < 40


@pytest.mark.parametrize("encoding", ["exact", "history"])
def test_estimates_and_tests_take_runs_together(product, policy, encoding):
    other = stl.build_product(product.model, product.formula, encoding)
    found = stl.estimate(other, policy, runs=300, environment=SideBySide(product.model, 128))
    assert found.satisfied == stl.estimate(product, policy, runs=300, environment=OneByOne(product.model)).satisfied
    verdicts = [stl.sprt(other, policy, 0.3, environment=kind) for kind in
                (SideBySide(product.model, 128), OneByOne(product.model))]  # fmt: skip
    assert verdicts[0].verdict == "holds"
    assert verdicts[0].runs == verdicts[1].runs  # of the last batch no more is read than is needed
    assert verdicts[0].satisfied == verdicts[1].satisfied


def test_a_mixture_is_followed_with_its_weights(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,5] A"))
    share = np.arange(1.0, 10.0) ** 2  # of the nine moves
    policy = stl.Policy(product, np.tile(share / share.sum(), (*product.shape, 1)))
    exact = stl.check(product, policy).probability
    assert 0.05 < exact < 0.95
    found = stl.estimate(product, policy, runs=3000, confidence=0.999999, environment=SideBySide(floor5, 1000))
    assert found.lower <= exact <= found.upper


def test_a_black_box_may_be_batched_and_answers_every_question(product, policy):
    made = []

    def fleet(rng):
        made.append(SideBySide(product.model, 16))
        return made[-1]

    blind = stl.build_product(hidden(product.model, environment=fleet), product.formula)
    moved = stl.Policy(blind, policy.table)
    assert (
        stl.estimate(blind, moved, runs=50).satisfied
        == stl.estimate(product, policy, runs=50, environment=OneByOne(product.model)).satisfied
    )
    assert made[-1].begun == 50
    run = stl.sample_run(blind, moved)
    box = OneByOne(product.model)
    assert run.states[0] == box.reset()
    for before, action, after in zip(run.states, run.actions, run.states[1:], strict=False):
        assert box.step(product.model.action_names.index(action)) == after, before


class Answers:
    batch = 3

    def __init__(self, first=(0, 0, 0), then=(0, 0, 0)):
        self.first, self.then = first, then

    def reset(self, n):
        return self.first

    def step(self, actions):
        return self.then


@pytest.mark.parametrize(
    ("box", "says"),
    [
        (Answers(first=[0, 99, 0]), r"reset\(3\) returned 99 for run 1, which is not a state of floor-5x5; return the"),
        (Answers(first=[0, 0]), r"reset\(3\) returned int64 of shape \(2,\), not the states of 3 runs of floor-5x5; r"),
        (Answers(first=4), r"reset\(3\) returned 4, not the states of 3 runs"),
        (Answers(first=[[0], [0, 0]]), r"reset\(3\) returned float64 of shape \(0,\)"),
        (Answers(then=[0.0, 0.0, 0.0]), r"step\(actions\) returned float64 of shape \(3,\)"),
        (Answers(then=[0, 0, -1]), r"step\(actions\) returned -1 for run 2"),
        (Answers(then=None), r"step\(actions\) returned None"),
    ],
)
def test_answers_are_checked(product, policy, box, says):
    with pytest.raises(ModelError, match=says):
        stl.estimate(product, policy, runs=3, environment=box)


def test_the_size_of_a_batch_is_checked(product, policy):
    for batch in (0, 2.5, "all"):
        box = SideBySide(product.model, batch)
        with pytest.raises(
            SettingsError, match="the batch of estimate's environment is .*; it must be an integer from"
        ):
            stl.estimate(product, policy, environment=box)
    blind = stl.build_product(hidden(product.model, environment=lambda rng: object()), product.formula)
    with pytest.raises(ArgumentError, match=r"the environment of hidden is .*, which has no reset\(\) and step"):
        stl.estimate(blind, stl.Policy(blind, policy.table), runs=1)


def test_a_policy_without_an_action_is_named(product, floor5):
    table = np.full(product.shape, -1)
    with pytest.raises(PolicyError, match=r"the policy defines no action at step 0, state .*reachable under it"):
        stl.estimate(product, stl.Policy(product, table), runs=3, environment=SideBySide(floor5, 2))
