"""One seed, independent streams: no two purposes draw the same numbers."""

import itertools
import sys

import numpy as np
import pytest

import stltool as stl
from stltool import randomness
from stltool.errors import SettingsError
from stltool.models.environment import simulator
from stltool.randomness import Purpose, generator
from tests.sources import sources

# searches and trials that are always the same: their numbers are not data
FIXED = {
    "automata/samples.py", "diagnosis/causes.py", "kernels/exploring.py", "logic/feasible.py",
    "models/formats/explicit.py", "models/gymnasium/replay.py",
}  # fmt: skip
# from a seed that the episode's generator drew, or Hypothesis, so that the same numbers can be drawn again
AGAIN = {"learning/model_based.py", "testing/models.py"}


def test_streams_differ_in_purpose_part_and_seed():
    parts = [(), (0,), (0, 0), (1,)]
    keys = [(seed, purpose, *part) for seed in (0, 1, 2**64) for purpose in Purpose for part in parts]
    draws = {key: tuple(generator(*key).random(4)) for key in keys}
    assert len(set(draws.values())) == len(keys)
    assert draws[0, Purpose.LEARNER] == tuple(generator(np.int32(0), Purpose.LEARNER).random(4))


def test_nobody_makes_generators_elsewhere():
    makers = {"default_rng", "SeedSequence", "RandomState", "PCG64", "seed"}
    found = {path.as_posix() for path, source in sources().items() if source.attributes & makers}
    assert found == {"randomness.py", *FIXED, *AGAIN}


@pytest.fixture
def black_box(patrolling):
    """The same floor of which nothing is known but how to reset and step it."""
    model = patrolling.model
    unknown = stl.MDP.black_box(
        model.n_states, list(model.action_names), lambda rng: simulator(model, rng),
        signals=model.signals, labels=model.labels,
    )  # fmt: skip
    return stl.build_product(unknown, patrolling.formula)


def test_what_one_seed_is_used_for_shares_nothing(patrolling, black_box, monkeypatch):
    """Every use of seed 7: the streams asked for by different functions, known or black box, differ."""
    asked = []

    def recording(seed, purpose, *part):
        asked.append((purpose, *part))
        return generator(seed, purpose, *part)

    policy = stl.learn(patrolling, episodes=2, seed=7).policy
    for module in ("learning.learn", "checking.rollouts", "checking.sampling"):
        monkeypatch.setattr(sys.modules[f"stltool.{module}"], "generator", recording)
    assert np.array_equal(stl.learn(patrolling, episodes=2, seed=7).policy.table, policy.table)
    unknown = stl.learn(black_box, episodes=2, seed=7).policy
    learned = set(asked)
    used = [learned]
    for use in (
        lambda: stl.estimate(patrolling, policy, runs=40_000, seed=7),
        lambda: stl.sprt(patrolling, policy, 0.5, seed=7),
        lambda: stl.estimate(black_box, unknown, runs=3, seed=7),
        lambda: stl.sprt(black_box, unknown, 0.5, seed=7),
        lambda: stl.sample_run(patrolling, policy, seed=7),
    ):
        asked.clear()
        use()
        used.append(set(asked))
    assert learned == {(Purpose.LEARNING_ENVIRONMENT,), (Purpose.LEARNER,)}
    assert all(used)
    assert all(not one & other for one, other in itertools.combinations(used, 2))


def test_fresh_runs_are_not_the_runs_learned_from(patrolling, monkeypatch):
    """The first number an estimate draws is not the first that the learner's environment drew, under one seed."""
    first = []

    class Spy:
        def __init__(self, rng):
            self._rng = rng

        def random(self, *size):
            drawn = self._rng.random(*size)
            first.append(float(np.ravel(drawn)[0]))
            return drawn

    monkeypatch.setattr("stltool.checking.rollouts.generator", lambda *key: Spy(generator(*key)))
    best = stl.check(patrolling)
    stl.estimate(patrolling, best.policy, runs=2, seed=3)
    assert first
    assert first[0] != np.random.default_rng(np.random.SeedSequence(3).spawn(1)[0]).random()


@pytest.mark.parametrize("seed", [-1, 1.5, True, "1", None, 2**128, np.int64(-1)])
def test_what_is_no_seed_is_refused_everywhere(patrolling, seed):
    policy = stl.check(patrolling).policy
    for use in (
        lambda: randomness.require_seed(seed),
        lambda: stl.learn(patrolling, episodes=1, seed=seed),
        lambda: stl.estimate(patrolling, policy, runs=1, seed=seed),
        lambda: stl.sprt(patrolling, policy, 0.5, seed=seed),
    ):
        with pytest.raises(SettingsError, match=r"seed is .*; give an integer from 0"):
            use()


def test_seeds_are_recorded_as_integers(patrolling):
    policy = stl.check(patrolling).policy
    seed = np.uint8(3)
    for result in (
        stl.learn(patrolling, episodes=1, seed=seed),
        stl.estimate(patrolling, policy, runs=10, seed=seed),
        stl.sprt(patrolling, policy, 0.5, seed=seed),
    ):
        assert (result.seed, type(result.seed)) == (3, int)
