"""The coarsest partition that agrees on outputs and is closed under every letter (Moore's refinement).

    C₀ = states by output;   C_{i+1} = states by (C_i, C_i ∘ δ_λ for every λ);   stop when no class splits

At most n rounds of O(n·|Λ|·log n); counters of length τ take τ rounds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def coarsest_partition(delta: NDArray[np.int32], outputs: NDArray[np.int8]) -> NDArray[np.int64]:
    """Class numbers (n_states,); `outputs` (n_states,) or (n_rows, n_states). State 0 is in class 0."""
    rows = np.atleast_2d(outputs)
    classes = np.zeros(delta.shape[1], dtype=np.int64)
    for row in np.unique(rows, axis=0):
        classes = _refine(classes, row.astype(np.int64) - int(row.min()))
    distinct = np.unique(delta, axis=0)
    n_classes = int(classes.max()) + 1
    while True:
        before = classes
        for successors in distinct:
            classes = _refine(classes, before[successors])
        grown = int(classes.max()) + 1
        if grown == n_classes:
            return _in_order(classes)
        n_classes = grown


def _refine(classes: NDArray[np.int64], by: NDArray[np.int64]) -> NDArray[np.int64]:
    _, refined = np.unique(classes * (int(by.max()) + 1) + by, return_inverse=True)
    result: NDArray[np.int64] = refined.astype(np.int64)
    return result


def _in_order(classes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the classes by their first state."""
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
