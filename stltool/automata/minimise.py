"""The coarsest partition that agrees on outputs and is closed under every letter.

    C₀ = states by output;   C_{i+1} = states by (C_i, C_i ∘ δ_λ for every λ);   stop when no class splits

First come whole rounds (Moore), vectorised, as long as each finds many new classes. A counter of length τ splits one
class in each of its τ rounds: from then on, only states with a successor in a renumbered class are re-examined. The
largest piece of a class keeps its number, so a state is renumbered at most log₂ n times, and at most |Λ| n log₂ n
states are re-examined in total. Source: [Jacobs23].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata.rows import distinct_rows

_WORTH_A_ROUND = 1.5  # growth in the number of classes below which whole rounds are too expensive


def coarsest_partition(delta: NDArray[np.int32], outputs: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Class numbers (n_states,), ordered by the first state of each class.

    `outputs` (n_states,) or (n_rows, n_states): states of one class agree on every row.
    """
    rows = np.atleast_2d(outputs)
    classes = np.zeros(delta.shape[1], dtype=np.int64)
    for row in rows[distinct_rows(rows)[0]]:
        classes = _refine(classes, row.astype(np.int64) - int(row.min()))
    distinct = delta[distinct_rows(delta)[0]]
    n_classes = int(classes.max()) + 1
    while True:
        before = classes
        for successors in distinct:
            classes = _refine(classes, before[successors])
        grown = int(classes.max()) + 1
        if grown == n_classes:
            return _in_order(classes)
        if grown < _WORTH_A_ROUND * n_classes:
            return _in_order(_refine_by_changes(distinct, classes))
        n_classes = grown


def _refine(classes: NDArray[np.int64], by: NDArray[np.int64]) -> NDArray[np.int64]:
    _, refined = np.unique(classes * (int(by.max()) + 1) + by, return_inverse=True)
    result: NDArray[np.int64] = refined.astype(np.int64)
    return result


def _refine_by_changes(delta: NDArray[np.int32], coarse: NDArray[np.int64]) -> NDArray[np.int64]:
    """The coarsest refinement of the classes `coarse` that is closed under every letter.

    What makes it cheap: all states of a class that are not stale have the same signature (the classes of their
    successors), so only the signatures of stale states need to be examined.
    """
    n_letters, n = delta.shape
    after = np.ascontiguousarray(delta.T)
    order = np.argsort(after, axis=None, kind="stable")
    before = order // n_letters  # the predecessors of q: before[start[q] : start[q + 1]]
    start = np.searchsorted(after.ravel()[order], np.arange(n + 1)).tolist()
    classes = coarse.astype(np.int32)
    members: list[set[int]] = [set() for _ in range(int(classes.max()) + 1)]
    for q, c in enumerate(classes.tolist()):
        members[c].add(q)
    width = n_letters * classes.itemsize
    stale = list(range(n))
    while stale:
        signatures = classes[after[stale]].tobytes()
        found: dict[int, dict[bytes, list[int]]] = {}
        for i, (q, c) in enumerate(zip(stale, classes[stale].tolist(), strict=True)):
            if len(members[c]) > 1:
                found.setdefault(c, {}).setdefault(signatures[i * width : (i + 1) * width], []).append(q)
        renumbered: list[int] = []
        for c, by_signature in found.items():
            for piece in _but_the_largest(members[c], list(by_signature.values())):
                members[c].difference_update(piece)
                classes[piece] = len(members)
                members.append(set(piece))
                renumbered += piece
        into: set[int] = set()
        for q in renumbered:
            into.update(before[start[q] : start[q + 1]].tolist())
        stale = list(into)
    return classes.astype(np.int64)


def _but_the_largest(whole: set[int], pieces: list[list[int]]) -> list[list[int]]:
    """The parts of `whole`, split into `pieces` and the rest, without the largest one."""
    left = len(whole) - sum(map(len, pieces))
    largest = max(pieces, key=len)
    if left >= len(largest):
        return pieces
    others = [piece for piece in pieces if piece is not largest]
    return [*others, list(whole.difference(*pieces))] if left else others


def _in_order(classes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The classes, renumbered by their first state."""
    _, first, inverse = np.unique(classes, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    ordered: NDArray[np.int64] = rank[inverse]
    return ordered


def quotient(delta: NDArray[np.int32], classes: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """delta over the classes, and a representative state of each."""
    _, representative = np.unique(classes, return_index=True)
    small = classes[delta[:, representative]].astype(np.int32)
    return np.ascontiguousarray(small), representative.astype(np.int64)
