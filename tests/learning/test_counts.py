from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stltool.errors import SettingsError
from stltool.learning import counts as module
from stltool.learning.counts import Counts


@given(st.lists(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4)), max_size=8), max_size=8), st.integers(0, 9))
def test_counts_are_a_counters(batches, waiting):
    old, module._WAITING = module._WAITING, waiting
    try:
        counts, slow = Counts(4, 5), Counter()
        for batch in batches:
            rows = np.array(batch, dtype=np.int64).reshape(-1, 2)
            counts.add(rows[:, 0], rows[:, 1])
            slow.update(batch)
    finally:
        module._WAITING = old
    rows = list(zip(counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist(), strict=True))
    assert rows == [(*pair, n) for pair, n in sorted(slow.items())]
    assert counts.visits.tolist() == [sum(n for (c, _), n in slow.items() if c == choice) for choice in range(4)]
    again = Counts(4, 5)
    again.restore(counts.arrays())
    again.add(np.array([1]), np.array([2]))
    assert again.visits[1] == counts.visits[1] + 1


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
    with pytest.raises(ValueError, match="must be int64|out of range|less than once"):
        Counts(4, 5).restore({"codes": np.array(codes), "seen": np.array(seen)})
