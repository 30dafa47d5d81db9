from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import SettingsError
from stltool.learning import counts as module
from stltool.learning.counts import Counts
from stltool.models.environment import Environment, simulator
from stltool.randomness import Purpose, generator

TRANSITIONS = st.tuples(st.integers(0, 3), st.integers(0, 4), st.integers(0, 2))  # choice, target, context


@given(st.lists(st.lists(TRANSITIONS, max_size=8), max_size=8), st.integers(0, 9), st.booleans())
def test_counts_are_a_counters(batches, waiting, single):
    old, module._WAITING = module._WAITING, waiting
    try:
        counts, slow = Counts(4, 5, 3), Counter()
        for batch in batches:
            if single:
                for row in batch:
                    counts.add_one(*row)
            else:
                counts.add(*np.array(batch, dtype=np.int64).reshape(-1, 3).T)
            slow.update(batch)
    finally:
        module._WAITING = old
    pairs = Counter()
    for (choice, target, _), n in slow.items():
        pairs[choice, target] += n
    rows = list(zip(counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist(), strict=True))
    assert rows == [(*pair, n) for pair, n in sorted(pairs.items())]
    rows = list(zip(*(column.tolist() for column in counts.in_context), strict=True))
    assert rows == [(*row, n) for row, n in sorted(slow.items())]
    assert counts.visits.tolist() == [sum(n for (c, _), n in pairs.items() if c == choice) for choice in range(4)]
    again = Counts(4, 5, 3)
    again.restore(counts.arrays())
    assert again.contains(counts)
    again.add([1], [2], [0])
    assert again.visits[1] == counts.visits[1] + 1
    assert not counts.contains(again)


def test_with_one_context_contexts_are_ignored():
    counts = Counts(4, 5)
    for context in (0, 3, 3):
        counts.add_one(1, 2, context)
    assert [column.tolist() for column in counts.in_context] == [[1], [2], [0], [3]]


@pytest.mark.parametrize(
    ("context", "says"),
    [(None, "context is not given, and there are 3"), ([0, 3], r"context\[1\] is 3"), ([0], "2 choices in 1 contexts")],
)
def test_contexts_that_cannot_be(context, says):
    counts = Counts(4, 5, 3)
    with pytest.raises(SettingsError, match=says):
        counts.add([1, 2], [3, 4], context)
    assert not counts.seen.size


def test_learners_count_the_choice_before(patrolling):
    """Episodes that a kernel takes and those taken step by step count the same contexts."""
    walked, env = [], simulator(patrolling.model, generator(3, Purpose.LEARNING_ENVIRONMENT), patrolling.horizon)
    model = patrolling.model
    here = before = 0

    def reset():
        nonlocal here, before
        here, before = env.reset(), 0
        return here

    def step(i):
        nonlocal here, before
        choice = int(model.choice_start[here]) + i
        here = env.step(i)
        walked.append((choice, here, before))
        before = choice + 1
        return here

    whole = stl.learn(patrolling, "cfer", episodes=20, seed=3)
    stepped = stl.learn(patrolling, "cfer", episodes=20, seed=3, environment=Environment(reset, step))
    rows = [(*row, n) for row, n in sorted(Counter(walked).items())]
    for run in (whole, stepped):
        assert list(zip(*(column.tolist() for column in run.counts.in_context), strict=True)) == rows


@pytest.mark.parametrize(
    ("choice", "target", "says"),
    [
        ([0, 4], [0, 0], r"choice\[1\] is 4; indices run from 0 to 3"),
        ([0, -1], [0, 0], r"choice\[1\] is -1"),
        ([0], [5], r"target\[0\] is 5; indices run from 0 to 4"),
        ([0], [np.uint64(2**64 - 1)], r"target\[0\] is 18446744073709551615"),
        ([0.5], [0], "choice is float64 of shape"),
        ([True], [0], "choice is bool"),
        ([[0]], [0], r"choice is int64 of shape \(1, 1\)"),
        ([0, 1], [0], "2 choices with 1 targets"),
        ([[0], [1, 2]], [0], "choice is not an array"),
    ],
)
def test_transitions_that_cannot_be_are_not_counted(choice, target, says):
    counts = Counts(4, 5)
    counts.add([1, 2], [3, 4])
    with pytest.raises(SettingsError, match=says):
        counts.add(choice, target)
    assert (counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist()) == ([1, 2], [3, 4], [1, 1])


@pytest.mark.parametrize("sizes", [(0, 5), (4, -1), (2.0, 5), (True, 5), (2**40, 2**40)])
def test_sizes_that_cannot_be(sizes):
    with pytest.raises(SettingsError):
        Counts(*sizes)


@pytest.mark.parametrize(
    ("codes", "seen"),
    [
        ([3, 1], [1, 1]), ([1, 1], [1, 1]), ([-1, 1], [1, 1]), ([1, 20], [1, 1]), ([1, 2], [1, 0]), ([1, 2], [1]),
        ([1, 2], [2**62, 2**62]), ([1.0], [1]), ([[1]], [[1]]), ([0, 2**62, -(2**62), 5], [1, 1, 1, 1]),
    ],
)  # fmt: skip
def test_counts_that_cannot_be_restored(codes, seen):
    codes, seen = np.array(codes), np.array(seen)
    contexts = np.zeros(codes.shape, dtype=np.int64)
    with pytest.raises(ValueError, match="must be int64|out of range|less than once"):
        Counts(4, 5).restore({"codes": codes, "contexts": contexts, "seen": seen})


@pytest.mark.parametrize("contexts", [[0, 3], [-1, 0], [1, 1], [1, 0], [1], [0.0, 1.0]])
def test_contexts_that_cannot_be_restored(contexts):
    with pytest.raises(ValueError, match="must be int64|out of range"):
        Counts(4, 5, 3).restore({"codes": np.array([7, 7]), "contexts": np.array(contexts), "seen": np.array([1, 1])})


class Fleet:
    """Robots in two rooms, side by side, which write down what they do."""

    batch = 7

    def __init__(self, rng, seen):
        self.generator, self.seen = rng, seen

    def reset(self, n):
        self.here, self.before = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        return self.here

    def step(self, actions):
        live = actions >= 0
        choice = 2 * self.here + actions
        after = np.where((actions == 1) & (self.generator.random(len(actions)) < 0.8), 1 - self.here, self.here)
        self.seen.update(zip(*(one[live].tolist() for one in (choice, after, self.before)), strict=True))
        self.here, self.before = np.where(live, after, self.here), np.where(live, choice + 1, self.before)
        return self.here


@pytest.mark.parametrize("method", ["cfer", "model-based"])
def test_the_choice_before_is_that_of_the_same_run_of_many(method):
    seen = Counter()
    model = stl.MDP.black_box(2, ["stay", "move"], lambda rng: Fleet(rng, seen), labels={"goal": [False, True]})
    run = stl.learn(stl.build_product(model, stl.parse("G[0,4] F[0,2] goal")), method, episodes=20)
    rows = list(zip(*(column.tolist() for column in run.counts.in_context), strict=True))
    assert rows == [(*row, n) for row, n in sorted(seen.items())]
