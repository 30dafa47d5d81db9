"""The edges of one step: from the open pairs of a layer along their choices to the layer ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

REST, SURE, OPEN = 0, 1, 2
"""Slots of a layer's values: unlisted pairs, sure pairs, and from OPEN on the open pairs in order."""


@dataclass(frozen=True, eq=False)
class Edges:
    """n pairs with m choices in total and e edges; pairs in order of (s, q), choices and entries in the model's.

    s, q     (n,) int64: the pairs
    choices  (n+1,) int64: pair i has the choices choices[i] … choices[i+1]−1 of this list
    choice   (m,) int64: their numbers among the engine's rows (`Layers.rows`)
    weight   (m,) the policy's probability of each, or None if one of them is taken
    start    (m+1,) int64: choice j has the edges start[j] … start[j+1]−1
    entry    (e,) int64: its index among the entries of these rows
    child    (e,) int64: the slot ahead that it leads to
    """

    s: NDArray[np.int64]
    q: NDArray[np.int64]
    choices: NDArray[np.int64]
    choice: NDArray[np.int64]
    weight: NDArray[np.float64] | None
    start: NDArray[np.int64]
    entry: NDArray[np.int64]
    child: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.choices) - 1

    @property
    def nbytes(self) -> int:
        weight = 0 if self.weight is None else self.weight.nbytes
        arrays = (self.s, self.q, self.choices, self.choice, self.start, self.entry, self.child)
        return sum(array.nbytes for array in arrays) + weight


@dataclass(frozen=True, eq=False)
class Fan:
    """The same before the slots ahead are known; s_ahead, q_ahead (e,) int64: the pairs that edges lead to."""

    s: NDArray[np.int64]
    q: NDArray[np.int64]
    choices: NDArray[np.int64]
    choice: NDArray[np.int64]
    weight: NDArray[np.float64] | None
    start: NDArray[np.int64]
    entry: NDArray[np.int64]
    s_ahead: NDArray[np.int64]
    q_ahead: NDArray[np.int64]

    def edges(self, child: NDArray[np.int64]) -> Edges:
        return Edges(self.s, self.q, self.choices, self.choice, self.weight, self.start, self.entry, child)
