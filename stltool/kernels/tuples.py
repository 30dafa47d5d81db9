"""Grouped arguments of kernels: named tuples of arrays and numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tables(NamedTuple):
    """A model ready to be sampled by inversion: the MDP's arrays, `sums` within rows, `first` the initial states'."""

    choice_start: NDArray[np.int64]
    row_start: NDArray[np.int64]
    target: NDArray[np.int32]
    sums: NDArray[np.float64]
    first: NDArray[np.float64]


def one_state() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """choice_start, row_start, target of a model of one state, to warm kernels up: read-only as a model's arrays, which
    numba tells apart."""
    rows = np.array([0, 1], dtype=np.int64), np.array([0, 1], dtype=np.int64), np.zeros(1, dtype=np.int32)
    for array in rows:
        array.setflags(write=False)
    return rows


class Surrogate(NamedTuple):
    """Q (S, N, C) on the surrogate reward (N,), with its learning rate and discount."""

    Q: NDArray[np.float64]
    reward: NDArray[np.float64]
    alpha: float
    gamma: float


class Replay(NamedTuple):
    """A published method's memory. Rows are (s, q, a, s', q'); places are (next row, number of rows).

    online     whether each step updates at once
    period     0: no replay; else every period-th step of the episode draws a batch
    imagined   (k,) the flag vectors that counterfactual tuples start from; none: the factual tuple is kept
    after      (n_letters, k) where they lead;  closeness (N, k) exp(−‖f̃ − f‖₁), the weight of a tuple (`weighted`)
    n_facts    how many of a batch are drawn from `facts`, a separate memory of factual tuples
    """

    online: bool
    period: int
    rows: NDArray[np.int32]
    weight: NDArray[np.float64]
    place: NDArray[np.int64]
    imagined: NDArray[np.int32]
    after: NDArray[np.int32]
    weighted: bool
    closeness: NDArray[np.float64]
    n_facts: int
    facts: NDArray[np.int32]
    facts_place: NDArray[np.int64]
