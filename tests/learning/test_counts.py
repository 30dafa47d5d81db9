from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
