"""How often each transition was seen: the data from which a model is estimated and bounded (learning/guarantee.py)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError

_WAITING = 1 << 16  # transitions buffered before they are counted together
_MOST = np.iinfo(np.int64).max


class Counts(Displayed):
    """Sparse counts of (choice, successor); a choice is a model state with one of its available actions.

    `choice`, `target` and `seen` are the rows, sorted by choice, then target; reading them counts buffered transitions.
    """

    def __init__(self, n_choices: int, n_states: int) -> None:
        for name, value in (("n_choices", n_choices), ("n_states", n_states)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise SettingsError(f"{name} is {value!r}; give an integer from 1")
        self.n_choices, self.n_states = int(n_choices), int(n_states)
        if self.n_choices * self.n_states > _MOST:
            raise SettingsError(f"{n_choices} choices of {n_states} states are too many to count; use a smaller model")
        self._codes = np.empty(0, dtype=np.int64)  # choice · n_states + target, ascending
        self._seen = np.empty(0, dtype=np.int64)
        self._waiting: list[NDArray[np.int64]] = []
        self._n_waiting = 0
        self._single: list[int] = []

    def _card(self) -> Card:
        visits = self.visits
        return Card(
            f"Counts: {counted(int(visits.sum()), 'transition')} of {counted(self.n_choices, 'choice')}",
            [{"states": self.n_states, "choices never tried": int((visits == 0).sum())}],
        )

    def add(self, choice: ArrayLike, target: ArrayLike) -> None:
        """Count transitions: choices (n,) and their successors (n,).

        Raises SettingsError, counting none of them, unless both are integers in range and of equal number.
        """
        choices = _indices("choice", choice, self.n_choices)
        targets = _indices("target", target, self.n_states)
        if len(choices) != len(targets):
            raise SettingsError(f"{len(choices)} choices with {len(targets)} targets; give one target for each choice")
        self.add_known(choices, targets)

    def add_known(self, choice: NDArray[np.int64], target: NDArray[Any]) -> None:
        """The same if they are known to be in range."""
        self._waiting.append(choice * self.n_states + target)
        self._n_waiting += len(choice)
        if self._n_waiting > _WAITING:
            self._settle()

    def add_one(self, choice: int, target: int) -> None:
        """Count one transition that is known to be in range."""
        self._single.append(choice * self.n_states + target)
        if len(self._single) > _WAITING:
            self._settle()

    @property
    def choice(self) -> NDArray[np.int64]:
        self._settle()
        return self._codes // self.n_states

    @property
    def target(self) -> NDArray[np.int64]:
        self._settle()
        return self._codes % self.n_states

    @property
    def seen(self) -> NDArray[np.int64]:
        self._settle()
        return self._seen

    @property
    def visits(self) -> NDArray[np.int64]:
        """(n_choices,): how often each choice was taken."""
        # integers throughout: weights of bincount would be doubles
        visits = np.zeros(self.n_choices, dtype=np.int64)
        np.add.at(visits, self.choice, self.seen)
        return visits

    def contains(self, other: Counts) -> bool:
        """Whether every transition was seen here at least as often as in `other`."""
        self._settle()
        other._settle()
        place = np.minimum(np.searchsorted(self._codes, other._codes), max(len(self._codes) - 1, 0))
        if not len(self._codes):
            return not len(other._codes)
        return bool(((self._codes[place] == other._codes) & (self._seen[place] >= other._seen)).all())

    def arrays(self) -> dict[str, NDArray[np.int64]]:
        """Everything, for a checkpoint."""
        self._settle()
        return {"codes": self._codes, "seen": self._seen}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the result of `arrays`; ValueError if it cannot be one."""
        codes, seen = arrays["codes"], arrays["seen"]
        for name, array in (("codes", codes), ("seen", seen)):
            if array.dtype != np.int64 or array.ndim != 1 or len(array) != len(codes):
                raise ValueError(f"{name} is {array.dtype} of shape {array.shape}; it must be int64 of {codes.shape}")
        outside = (codes < 0) | (codes >= self.n_choices * self.n_states)
        if outside.any() or (codes[1:] <= codes[:-1]).any():
            raise ValueError("the counted transitions are out of range or out of order")
        if (seen < 1).any() or sum(seen.tolist()) > _MOST:
            raise ValueError("a transition was seen less than once, or too often to be counted")
        self._codes, self._seen = codes.copy(), seen.copy()
        self._waiting, self._n_waiting, self._single = [], 0, []

    def _settle(self) -> None:
        if not self._waiting and not self._single:
            return
        waiting = [*self._waiting, np.array(self._single, dtype=np.int64)]
        codes, place = np.unique(np.concatenate([self._codes, *waiting]), return_inverse=True)
        seen = np.zeros(len(codes), dtype=np.int64)
        np.add.at(seen, place.ravel(), np.concatenate([self._seen, np.ones(len(place) - len(self._seen), np.int64)]))
        self._codes, self._seen = codes, seen
        self._waiting, self._n_waiting, self._single = [], 0, []


def _indices(name: str, given: ArrayLike, n: int) -> NDArray[np.int64]:
    try:
        array = np.atleast_1d(np.asarray(given))
    except ValueError:  # rows of different lengths
        raise SettingsError(f"{name} is not an array; give integers (n,)") from None
    if array.size == 0:
        return np.empty(0, dtype=np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise SettingsError(f"{name} is {array.dtype} of shape {array.shape}; give integers (n,)")
    outside = np.flatnonzero((array < 0) | (array >= n))
    if outside.size:
        raise SettingsError(f"{name}[{outside[0]}] is {array[outside[0]]}; indices run from 0 to {n - 1}")
    return array.astype(np.int64)
