"""The pairs of states that two machines can reach on the same letters; where a run can be with nothing decided."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import UNDECIDED, TaskAutomaton
from stltool.sizes import require_numbered

_CELLS = 1 << 20  # successors computed at a time


def reachable_pairs(
    left: NDArray[np.int32], right: NDArray[np.int32], starts: Sequence[tuple[int, int]], guard: Callable[[int], None]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """The pairs reachable from `starts`, in lexicographic order: p (n,), q (n,) and delta (n_letters, n) over them.

    `left` and `right` are (n_letters, n_states). `guard` is called with the number of known pairs after each step and
    raises if there are too many. Raises SizeError if there are more than int32 can number.
    """
    n_letters, width = right.shape
    after_left = np.ascontiguousarray(left.T).astype(np.int64) * width
    after_right = np.ascontiguousarray(right.T)
    known = {p * width + q for p, q in starts}
    waiting = list(known)
    batch = max(1, _CELLS // n_letters)
    while waiting:
        p, q = np.divmod(np.array(waiting[-batch:], dtype=np.int64), width)
        del waiting[-batch:]
        found = set((after_left[p] + after_right[q]).ravel().tolist()) - known
        known |= found
        waiting += found
        guard(len(known))
        require_numbered(len(known), "combinations of automaton states", "shorten the windows")
    codes = np.sort(np.fromiter(known, dtype=np.int64, count=len(known)))
    p, q = np.divmod(codes, width)
    delta = np.empty((n_letters, len(codes)), dtype=np.int32)
    for row, a, b in zip(delta, left, right, strict=True):
        row[:] = np.searchsorted(codes, a[p].astype(np.int64) * width + b[q])
    return p, q, delta


def open_pairs(automaton: TaskAutomaton) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """For each letter the pairs (t, q), later steps first: q after reading it at step t, nothing decided so far."""
    pairs: list[list[tuple[int, NDArray[np.int64]]]] = [[] for _ in range(automaton.n_letters)]
    before = np.array([automaton.initial])
    for t in range(automaton.horizon):
        undecided = automaton.verdicts(t) == UNDECIDED
        reached = [np.unique(row[before]) for row in automaton.delta]
        for letter, q in enumerate(reached):
            pairs[letter].append((t, q[undecided[q]]))
        before = np.unique(np.concatenate([q[undecided[q]] for q in reached]))
    return [
        (
            np.repeat(np.array([t for t, _ in reversed(steps)], dtype=np.int64), [len(q) for _, q in reversed(steps)]),
            np.concatenate([np.empty(0, dtype=np.int64), *(q for _, q in reversed(steps))]).astype(np.int64),
        )
        for steps in pairs
    ]
