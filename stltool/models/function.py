"""Rows of a model that is a function of states and actions, computed when needed: nothing is stored.

    step(states, actions) → (successors, probabilities)

Both arguments are arrays (n,) of int64, the pairs whose rows are needed; the results are arrays (n, k): pair i leads to
successors[i, j] with probability probabilities[i, j]. Entries of probability 0 are left out, whatever their successor;
entries with the same successor are added. Every row is checked when it is computed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import described
from stltool.arrays import read_only
from stltool.errors import ModelError
from stltool.models.fractions import Shares, nearest
from stltool.models.rows import I32, I64, ROW_TOLERANCE, Chances, Gathered, Place, Rows, Source, spans, starts

Step: TypeAlias = Callable[[I64, I64], tuple[ArrayLike, ArrayLike]]

_BLOCK = 1 << 20  # entries that a call of `step` may return
_WANTED = "return two arrays of shape (n, k), successors and probabilities, for n states and n actions"


class Function(Source):
    """The rows that `step` gives.

    available     (n_states, n_actions) Booleans: which actions a state has; None: all of them
    denominator   probabilities are integers over it, and exact; None: they are doubles
    """

    def __init__(
        self,
        step: Step,
        n_states: int,
        action_names: tuple[str, ...],
        available: NDArray[np.bool_] | None,
        denominator: int | None,
    ) -> None:
        self._step, self._n_states, self._names = step, n_states, action_names
        self._available, self._denominator = available, denominator
        self._state: Place = str
        self._width: int | None = None
        actions = self._actions(np.zeros(1, dtype=np.int64))[1]
        self._width = self._called(np.zeros(len(actions), dtype=np.int64), actions)[0].shape[1]

    @property
    def n_states(self) -> int:
        return self._n_states

    @property
    def n_choices(self) -> int:
        if self._available is None:
            return self._n_states * len(self._names)
        return int(self.choice_start[-1])

    @property
    def n_transitions(self) -> int:
        """An upper bound."""
        return self.n_choices * (self._width or 0)

    @cached_property
    def choice_start(self) -> I64:
        if self._available is None:
            return read_only(np.arange(self._n_states + 1, dtype=np.int64) * len(self._names))
        return read_only(starts(self._available.sum(axis=1)))

    @cached_property
    def choice_action(self) -> I32:
        if self._available is None:
            return np.tile(np.arange(len(self._names), dtype=np.int32), self._n_states)
        return np.nonzero(self._available)[1].astype(np.int32)

    @property
    def kinds(self) -> None:
        return None

    @property
    def uncertain(self) -> bool:
        return False

    @cached_property
    def most_choices(self) -> int:
        return len(self._names) if self._available is None else int(self._available.sum(axis=1).max())

    @property
    def widest(self) -> int:
        return self.most_choices * (self._width or 0)

    def nominal(self) -> Function:
        return self

    def require_distributions(self, place: Place, state: Place) -> None:
        """Checks the first state; the rows of others are checked when they are computed."""
        self._state = state
        self.rows(np.zeros(1, dtype=np.int64))

    def rows(self, states: I64) -> Rows:
        step = max(_BLOCK // max(self.widest, 1), 1)
        if len(states) <= step:
            return self._some(states)
        gathered = Gathered()
        for lo in range(0, len(states), step):
            gathered.add(self._some(states[lo : lo + step]))
        return gathered.all

    def _some(self, states: I64) -> Rows:
        counts, actions = self._actions(states)
        pairs = np.repeat(states, counts), actions
        where, successors, shares = self._entries(*pairs)
        row_start = starts(np.bincount(where, minlength=len(actions)))
        exact = Shares(shares, self._denominator) if self._denominator is not None else None
        probability = shares / self._denominator if self._denominator is not None else shares
        rows = Rows(starts(counts), row_start, successors, Chances(probability, row_start, exact))
        self._require(rows, pairs)
        return rows

    def _actions(self, states: I64) -> tuple[I64, I64]:
        """The number of actions of each state, and the actions."""
        if self._available is None:
            n = len(self._names)
            return np.full(len(states), n), np.tile(np.arange(n), len(states))
        first, end = self.choice_start[states], self.choice_start[states + 1]
        return end - first, self.choice_action[spans(first, end)].astype(np.int64)

    def _entries(self, states: I64, actions: I64) -> tuple[I64, I32, NDArray[Any]]:
        """Pair, successor and probability of every entry, sorted by pair and successor, once each."""
        if not len(states):
            none = np.zeros(0, dtype=np.int64)
            return none, none.astype(np.int32), none if self._denominator is not None else np.zeros(0)
        successors, shares = self._called(states, actions)
        there = shares != 0
        outside = there & ((successors < 0) | (successors >= self._n_states))
        if outside.any():
            i, j = (int(found[0]) for found in np.nonzero(outside))
            raise ModelError(
                f"{self._place(states[i], actions[i])}: step leads to state {successors[i, j]}; states are numbered "
                f"0 … {self._n_states - 1}"
            )
        successors = np.where(there, successors, self._n_states)  # sorted after all others
        order = np.argsort(successors, axis=1, kind="stable")
        successors, shares = np.take_along_axis(successors, order, axis=1), np.take_along_axis(shares, order, axis=1)
        there = successors < self._n_states
        first = there.copy()
        first[:, 1:] &= successors[:, 1:] != successors[:, :-1]
        if not first.any():
            return self._entries(states[:0], actions[:0])
        added = np.add.reduceat(shares[there], np.flatnonzero(first[there]))
        return np.nonzero(first)[0], successors[first].astype(np.int32), added

    def _called(self, states: I64, actions: I64) -> tuple[I64, NDArray[Any]]:
        """The result of step, as arrays (n, k) of integers, and of doubles or integers."""
        found = self._step(states, actions)
        if not isinstance(found, tuple | list) or len(found) != 2:
            raise ModelError(f"step returned {described(found)}; {_WANTED}")
        try:
            successors, shares = np.asarray(found[0]), np.asarray(found[1])
        except ValueError:
            raise ModelError(f"step returned rows of unequal lengths; {_WANTED}") from None
        for name, array in (("successors", successors), ("probabilities", shares)):
            if array.ndim != 2 or array.shape[0] != len(states) or array.shape[1] < 1:
                raise ModelError(f"step returned {name} of shape {array.shape} for {len(states)} pairs; {_WANTED}")
        if successors.shape != shares.shape:
            raise ModelError(
                f"step returned successors of shape {successors.shape} and probabilities of shape {shares.shape}; "
                f"{_WANTED}"
            )
        if self._width is not None and successors.shape[1] != self._width:
            raise ModelError(
                f"step returned {successors.shape[1]} successors for each pair, but {self._width} before; return as "
                "many every time, some of them with probability 0"
            )
        if successors.dtype.kind not in "iu":
            raise ModelError(f"step returned successors of type {successors.dtype}; return integers")
        return successors.astype(np.int64), self._shares(shares)

    def _shares(self, shares: NDArray[Any]) -> NDArray[Any]:
        if self._denominator is not None:
            if shares.dtype.kind not in "iu":
                raise ModelError(
                    f"step returned probabilities of type {shares.dtype}; with a denominator, return integers"
                )
            return shares.astype(np.int64)
        try:
            doubles: NDArray[Any] = nearest(shares)
        except TypeError:
            raise ModelError(
                f"step returned probabilities of type {shares.dtype}; return doubles, or integers and give their "
                "denominator"
            ) from None
        return doubles

    def _require(self, rows: Rows, pairs: tuple[I64, I64]) -> None:
        """ModelError, naming state and action, unless every row is a distribution."""

        def place(row: int) -> str:
            return self._place(pairs[0][row], pairs[1][row])

        empty = np.flatnonzero(np.diff(rows.row_start) == 0)
        if empty.size:
            raise ModelError(
                f"{place(int(empty[0]))}: all probabilities are 0; define with `available` which actions a state has"
            )
        if not len(rows.target):
            return
        probability = rows.probability
        bad = np.flatnonzero(~((probability > 0) & (probability <= 1 + ROW_TOLERANCE)))
        if bad.size:
            row = int(np.searchsorted(rows.row_start, bad[0], side="right")) - 1
            value, successor = probability[bad[0]], self._state(int(rows.target[bad[0]]))
            raise ModelError(f"{place(row)}: {value:.12g} to state {successor} is not a probability")
        if self._denominator is None:
            sums = np.add.reduceat(probability, rows.row_start[:-1])
            wrong = np.flatnonzero(np.abs(sums - 1) > ROW_TOLERANCE)
        else:
            sums = np.add.reduceat(rows.numerator, rows.row_start[:-1])
            wrong = np.flatnonzero(sums != self._denominator)
        if wrong.size:
            total = f"{sums[wrong[0]]:.12g}" if self._denominator is None else f"{sums[wrong[0]]}/{self._denominator}"
            raise ModelError(f"{place(int(wrong[0]))}: the probabilities sum to {total}, not 1")

    def _place(self, s: Any, a: Any) -> str:
        return f"state {self._state(int(s))}, action {self._names[int(a)]}"
