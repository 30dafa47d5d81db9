"""How often each transition was seen: what a model can be estimated from, and bounded (learning/guarantee.py)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

_WAITING = 1 << 16  # transitions that wait to be counted together


class Counts:
    """Sparse counts of (choice, successor); a choice is a model state with one of its available actions.

    `choice`, `target` and `seen` are the rows, sorted by choice, then target; reading them counts what waits.
    """

    def __init__(self, n_choices: int, n_states: int) -> None:
        self.n_choices, self.n_states = n_choices, n_states
        self._codes = np.empty(0, dtype=np.int64)  # choice · n_states + target, ascending
        self._seen = np.empty(0, dtype=np.int64)
        self._waiting: list[NDArray[np.int64]] = []
        self._n_waiting = 0

    def add(self, choice: NDArray[np.int64], target: NDArray[np.int64]) -> None:
        """Count transitions (n,)."""
        self._waiting.append(choice * self.n_states + target)
        self._n_waiting += len(choice)
        if self._n_waiting > _WAITING:
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
        return np.bincount(self.choice, self.seen, minlength=self.n_choices).astype(np.int64)

    def arrays(self) -> dict[str, NDArray[np.int64]]:
        """Everything, for a checkpoint."""
        self._settle()
        return {"codes": self._codes, "seen": self._seen}

    def restore(self, arrays: Mapping[str, NDArray[np.int64]]) -> None:
        """Take what `arrays` gave."""
        self._codes, self._seen = arrays["codes"], arrays["seen"]
        self._waiting, self._n_waiting = [], 0

    def _settle(self) -> None:
        if not self._waiting:
            return
        codes, place = np.unique(np.concatenate([self._codes, *self._waiting]), return_inverse=True)
        one_each = np.ones(self._n_waiting, dtype=np.int64)
        seen = np.bincount(place.ravel(), np.concatenate([self._seen, one_each]))
        self._codes, self._seen = codes, seen.astype(np.int64)
        self._waiting, self._n_waiting = [], 0
