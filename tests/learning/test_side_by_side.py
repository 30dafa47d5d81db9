"""Learning on black boxes that take many runs at once: the same episodes, whether alone or side by side."""

import threading
from dataclasses import dataclass

import numpy as np
import pytest

import stltool as stl
from stltool.errors import ModelError, SettingsError
from stltool.learning.model_based import Planner
from tests import oracles
from tests.checking.test_batched import OneByOne, SideBySide
from tests.checking.test_black_box import hidden
from tests.conftest import many

LEARNERS = [stl.Cfer(), stl.Naive(), stl.NaiveER(), stl.ModelBased()]


@pytest.fixture(scope="module")
def product(floor5):
    return stl.build_product(floor5, stl.parse("F[0,4] (A & F[0,3] x < 0.5)"))


@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.name)
def test_one_at_a_time_is_the_same_to_the_bit(product, learner):
    """The machinery of turns changes nothing: a batch of one plays what a box without batches plays."""
    alone = stl.learn(product, learner, episodes=12, environment=OneByOne(product.model))
    fleet = SideBySide(product.model, 1)
    lanes = stl.learn(product, learner, episodes=12, environment=fleet)
    assert lanes.history == alone.history
    assert (lanes.policy.table == alone.policy.table).all()
    assert (lanes.counts.seen == alone.counts.seen).all()
    assert fleet.begun == 12


@dataclass(frozen=True)
class Rule(stl.Learner):
    """Does what a rule says, and notes what it sees; what it sees does not depend on other episodes."""

    def start(self, problem, counts, rng):
        self.seen.clear()
        return {}

    seen = []  # noqa: RUF012 - of the class, as a test may have it

    def episode(self, state, episode):
        told = [(episode.s, episode.q)]
        while not episode.over and episode.verdict is None:
            episode.step((3 * episode.t + episode.s + episode.number) % episode.n_choices)
            told.append((episode.s, episode.q))
        self.seen.append((episode.number, episode.verdict, told, threading.active_count()))

    def policy(self, state):
        return np.zeros((18, 0), dtype=int)


@pytest.fixture(autouse=True)
def nobody_is_left():
    before = threading.active_count()
    yield
    assert threading.active_count() == before


@pytest.mark.parametrize("batch", [3, 8, 20])
def test_every_episode_is_the_one_it_would_be_alone(product, batch, monkeypatch):
    monkeypatch.setattr(Rule, "policy", lambda self, state: np.zeros(product.shape, dtype=int))
    alone = stl.learn(product, Rule(), episodes=20, evaluate_every=5, environment=OneByOne(product.model))
    one = sorted(found[:3] for found in Rule.seen)
    fleet = SideBySide(product.model, batch)
    lanes = stl.learn(product, Rule(), episodes=20, evaluate_every=5, environment=fleet)
    assert sorted(found[:3] for found in Rule.seen) == one
    assert len({tuple(told) for _, _, told in one}) > 5  # episodes differ
    assert (lanes.counts.seen == alone.counts.seen).all()
    assert (lanes.counts.target == alone.counts.target).all()
    assert lanes.environment_steps == alone.environment_steps
    assert fleet.calls <= -(-20 // batch) * product.horizon
    assert lanes.history[-1].episode == 20
    assert [p.episode for p in lanes.history] == {3: [6, 12, 15, 20], 8: [8, 16, 20], 20: [20]}[batch]


@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.name)
def test_side_by_side_is_learned_too(product, learner):
    found = [
        stl.learn(product, learner, episodes=150, seed=3, environment=SideBySide(product.model, 25)) for _ in range(2)
    ]
    assert found[0].history == found[1].history  # threads take turns: the same seed, the same result
    assert (found[0].policy.table == found[1].policy.table).all()
    best = stl.check(product).probability
    if learner.name in ("cfer", "model-based"):
        assert found[0].history[-1].probability > 0.9 * best


GOOD, BAD = 0.9, 0.5


@pytest.mark.parametrize("batch", [20])
@pytest.mark.parametrize("seed", range(many(3)))
def test_model_based_recovers_from_an_unlucky_beginning_in_batches(batch, seed):
    """The first action is better, but fails four times, while the second one succeeds four times."""
    rows = [[[0, p, 1 - p], [0, 1, 0], [0, 0, 1]] for p in (GOOD, BAD)]
    product = stl.build_product(stl.MDP.from_arrays(rows, {}, labels={"good": [0, 1, 0]}), stl.parse("F[0,1] good"))
    rng, tries, last = np.random.default_rng(seed), [0, 0], []

    class Unlucky:
        def reset(self, n):
            return np.zeros(n, dtype=int)

        def step(self, actions):
            found = np.empty(len(actions), dtype=int)
            for i, a in enumerate(actions.tolist()):
                lucky = a == 1 if tries[a] < 4 else rng.random() < (GOOD, BAD)[a]
                tries[a] += 1
                found[i] = 1 if lucky else 2
            last.append(actions.mean())
            return found

    Unlucky.batch = batch
    run = stl.learn(product, "model-based", episodes=600, evaluate_every=600, seed=seed,
                    environment=Unlucky())  # fmt: skip
    assert run.history[-1].probability == pytest.approx(GOOD)
    assert np.mean(last[-200 // batch :]) < 0.2


def test_model_based_explores_deeply_in_batches():
    """Only the way right, to the end of the corridor, satisfies the task."""
    model = oracles.corridor(12)
    product = stl.build_product(model, stl.parse("F[0,15] end"))
    run = stl.learn(product, "model-based", episodes=160, evaluate_every=160, environment=SideBySide(model, 16))
    assert run.history[-1].probability == 1.0


def test_a_batch_takes_as_many_plans_as_models_are_drawn(product, monkeypatch):
    """Of a small product after every step, by what has been seen by then; of a large one once, until it is left."""
    made, plan_from = [], Planner.plan_from
    monkeypatch.setattr(Planner, "plan_from", lambda self, *rest: made.append(rest[1]) or plan_from(self, *rest))
    fleet = SideBySide(product.model, 48)
    stl.learn(product, "model-based", episodes=48, evaluate_every=48, environment=fleet)
    assert 16 <= made.count(0) == max(map(made.count, made))
    assert len(set(made)) > 1
    made.clear()
    monkeypatch.setattr(Planner.__init__, "__defaults__", (0,))  # situations of a small one
    stl.learn(product, "model-based", episodes=96, evaluate_every=96, environment=OneByOne(product.model))
    assert made.count(0) == 96
    made.clear()
    stl.learn(product, "model-based", episodes=96, evaluate_every=96, environment=fleet)
    assert made.count(0) == 2 * 16


def test_budgets_hold(product):
    fleet = SideBySide(product.model, 50)
    run = stl.learn(product, "cfer", most_steps=100, episodes=50, environment=fleet)
    assert run.environment_steps <= 100
    assert run.status == "out of steps"


def test_a_black_box_resumes(product, tmp_path):
    def fleet(rng):
        class Fleet:
            batch, generator = 6, rng

            def reset(self, n):
                self.here = np.full(n, int(product.model.initial.argmax()))
                return self.here

            def step(self, actions):
                self.here = (self.here + (rng.random(len(actions)) < 0.5) + np.maximum(actions, 0)) % 18
                return self.here

        return Fleet()

    blind = stl.build_product(hidden(product.model, environment=fleet), product.formula)
    path = tmp_path / "run.ckpt"
    stl.learn(blind, "cfer", episodes=12, checkpoint=path, evaluate_every=12)
    more = stl.learn(blind, "cfer", episodes=24, checkpoint=path, resume=True, evaluate_every=12)
    whole = stl.learn(blind, "cfer", episodes=24, evaluate_every=12)
    assert more.history == whole.history
    assert (more.policy.table == whole.policy.table).all()


@dataclass(frozen=True)
class Failing(stl.Learner):
    """Fails in its third episode's second step, or takes what is not there."""

    how: str = "raise"

    def start(self, problem, counts, rng):
        return {}

    def episode(self, state, episode):
        while not episode.over:
            if episode.number == 2 and episode.t == 1:
                if self.how == "raise":
                    raise ZeroDivisionError
                if self.how == "leave":
                    return
                episode.step(99)
            episode.step(0)

    def policy(self, state):
        return np.zeros((18, 3), dtype=int)


def test_faults_end_all_episodes(product, monkeypatch):
    monkeypatch.setattr(Failing, "policy", lambda self, state: np.zeros(product.shape, dtype=int))
    with pytest.raises(ZeroDivisionError):
        stl.learn(product, Failing(), environment=SideBySide(product.model, 5))
    with pytest.raises(SettingsError, match="the learner took choice 99 at step 1 in state"):
        stl.learn(product, Failing("wrong"), environment=SideBySide(product.model, 5))
    run = stl.learn(product, Failing("leave"), episodes=5, environment=SideBySide(product.model, 5))
    assert run.environment_steps == 4 * product.horizon + 1

    class Lost(SideBySide):
        def step(self, actions):
            return super().step(actions) + 100 * (self.calls == 2)

    with pytest.raises(
        ModelError, match=r"step\(actions\) returned 1\d\d for run 0, which is not a state of floor-5x5"
    ):
        stl.learn(product, Failing("leave"), environment=Lost(product.model, 5))
