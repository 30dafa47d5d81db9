"""How often each transition was seen: the data from which a model is estimated and bounded (learning/guarantee.py)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import require, whole
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError

Whole: TypeAlias = NDArray[np.int64]

_WAITING = 1 << 16  # transitions buffered before they are counted together
_MOST = np.iinfo(np.int64).max


class Counts(Displayed):
    """Sparse counts of (choice, successor); a choice is a model state with one of its available actions.

    `choice`, `target` and `seen` are the rows, sorted by choice, then target; reading them counts buffered transitions.

    n_contexts  with more than one, the context of every transition is counted too: what else was known before it, as an
                integer, such as a robot's heading. `markov_test` tests whether it matters. With one, contexts are
                ignored. In the counts of `learn`, the context is 1 + the choice before, and 0 at an episode's start
    total       the number of transitions
    alarms      the ties of a model's rows that these data contradicted at some look: by tie, the greatest ln of the
                evidence, and where (learning/tied.py)
    """

    def __init__(self, n_choices: int, n_states: int, n_contexts: int = 1) -> None:
        self.n_choices = whole(n_choices, "n_choices", 1)
        self.n_states = whole(n_states, "n_states", 1)
        self.n_contexts = whole(n_contexts, "n_contexts", 1)
        if self.n_choices * self.n_states > _MOST:
            raise SettingsError(f"{n_choices} choices of {n_states} states are too many to count; use a smaller model")
        # one row for each (code, context): ascending, code = choice · n_states + target
        self._codes = np.empty(0, dtype=np.int64)
        self._contexts = np.empty(0, dtype=np.int64)
        self._seen = np.empty(0, dtype=np.int64)
        self._waiting: list[tuple[Whole, Whole]] = []
        self._n_waiting = 0
        self._single: list[tuple[int, int]] = []
        self._together: tuple[Whole, Whole] | None = None  # the rows of all contexts, once asked for
        self._visits: Whole | None = None
        self.total = 0
        self.alarms: dict[str, tuple[float, int]] = {}

    def _card(self) -> Card:
        visits = self.visits
        return Card(
            f"Counts: {counted(int(visits.sum()), 'transition')} of {counted(self.n_choices, 'choice')}",
            [
                {
                    "states": self.n_states,
                    "choices never tried": int((visits == 0).sum()),
                    "contexts": self.n_contexts if self.n_contexts > 1 else None,
                }
            ],
        )

    def add(self, choice: ArrayLike, target: ArrayLike, context: ArrayLike | None = None) -> None:
        """Count transitions: choices (n,), their successors (n,) and, with several contexts, those before them (n,).

        Raises SettingsError, counting none of them, unless all are integers in range and of equal number.
        """
        choices = _indices("choice", choice, self.n_choices)
        targets = _indices("target", target, self.n_states)
        if len(choices) != len(targets):
            raise SettingsError(f"{len(choices)} choices with {len(targets)} targets; give one target for each choice")
        if context is None:
            if self.n_contexts > 1:
                raise SettingsError(f"context is not given, and there are {self.n_contexts}; give one for each choice")
            context = np.zeros(len(choices), dtype=np.int64)
        contexts = _indices("context", context, self.n_contexts)
        if len(choices) != len(contexts):
            raise SettingsError(f"{len(choices)} choices in {len(contexts)} contexts; give one context for each choice")
        self.add_known(choices, targets, contexts)

    def add_known(self, choice: Whole, target: NDArray[Any], context: Whole) -> None:
        """The same if they are known to be in range."""
        self.total += len(choice)
        self._waiting.append((choice * self.n_states + target, context))
        self._n_waiting += len(choice)
        if self._n_waiting > max(_WAITING, len(self._codes)):
            self._settle()

    def add_one(self, choice: int, target: int, context: int) -> None:
        """Count one transition that is known to be in range."""
        self.total += 1
        self._single.append((choice * self.n_states + target, context))
        if len(self._single) > max(_WAITING, len(self._codes)):
            self._settle()

    @property
    def choice(self) -> Whole:
        return self._pairs()[0] // self.n_states

    @property
    def target(self) -> Whole:
        return self._pairs()[0] % self.n_states

    @property
    def seen(self) -> Whole:
        return self._pairs()[1]

    @property
    def visits(self) -> Whole:
        """(n_choices,): how often each choice was taken."""
        seen = self.seen
        if self._visits is None:  # integers throughout: weights of bincount would be doubles
            self._visits = np.zeros(self.n_choices, dtype=np.int64)
            np.add.at(self._visits, self.choice, seen)
        return self._visits.copy()

    @property
    def in_context(self) -> tuple[Whole, Whole, Whole, Whole]:
        """(choice, target, context, seen): the same rows with each context apart, sorted in this order."""
        self._settle()
        return self._codes // self.n_states, self._codes % self.n_states, self._contexts, self._seen

    def contains(self, other: Counts) -> bool:
        """Whether every transition was seen here at least as often as in `other`, whatever its context."""
        require(other, Counts, "contains' other")
        (codes, seen), (theirs, times) = self._pairs(), other._pairs()
        if not len(codes):
            return not len(theirs)
        place = np.minimum(np.searchsorted(codes, theirs), len(codes) - 1)
        return bool(((codes[place] == theirs) & (seen[place] >= times)).all())

    def arrays(self) -> dict[str, Whole]:
        """Everything, for a checkpoint."""
        self._settle()
        return {"codes": self._codes, "contexts": self._contexts, "seen": self._seen}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the result of `arrays`; ValueError if it cannot be one."""
        codes, contexts, seen = arrays["codes"], arrays["contexts"], arrays["seen"]
        for name, array in (("codes", codes), ("contexts", contexts), ("seen", seen)):
            if array.dtype != np.int64 or array.ndim != 1 or len(array) != len(codes):
                raise ValueError(f"{name} is {array.dtype} of shape {array.shape}; it must be int64 of {codes.shape}")
        outside = (codes < 0) | (codes >= self.n_choices * self.n_states) | (contexts < 0)
        outside |= contexts >= self.n_contexts
        later = (codes[1:] > codes[:-1]) | ((codes[1:] == codes[:-1]) & (contexts[1:] > contexts[:-1]))
        if outside.any() or not later.all():
            raise ValueError("the counted transitions are out of range or out of order")
        if (seen < 1).any() or sum(seen.tolist()) > _MOST:
            raise ValueError("a transition was seen less than once, or too often to be counted")
        self._codes, self._contexts, self._seen = codes.copy(), contexts.copy(), seen.copy()
        self.total = int(seen.sum())
        self._waiting, self._n_waiting, self._single, self._together, self._visits = [], 0, [], None, None

    def _pairs(self) -> tuple[Whole, Whole]:
        """(codes, seen) of all contexts together, ascending."""
        self._settle()
        if self._together is None:
            self._together = self._codes, self._seen
            if self.n_contexts > 1 and len(self._codes):
                first = np.flatnonzero(np.diff(self._codes, prepend=-1))
                self._together = self._codes[first], np.add.reduceat(self._seen, first)
        return self._together

    def _settle(self) -> None:
        if not self._waiting and not self._single:
            return
        single = np.array(self._single, dtype=np.int64).reshape(-1, 2)
        codes = np.concatenate([self._codes, *(code for code, _ in self._waiting), single[:, 0]])
        contexts = np.concatenate([self._contexts, *(context for _, context in self._waiting), single[:, 1]])
        if self.n_contexts == 1:
            contexts[:] = 0
        seen = np.concatenate([self._seen, np.ones(len(codes) - len(self._seen), dtype=np.int64)])
        order = np.lexsort((contexts, codes))
        codes, contexts, seen = codes[order], contexts[order], seen[order]
        new = np.ones(len(codes), dtype=np.bool_)
        new[1:] = (codes[1:] != codes[:-1]) | (contexts[1:] != contexts[:-1])
        first = np.flatnonzero(new)
        self._codes, self._contexts, self._seen = codes[first], contexts[first], np.add.reduceat(seen, first)
        self._waiting, self._n_waiting, self._single, self._together, self._visits = [], 0, [], None, None


def _indices(name: str, given: ArrayLike, n: int) -> Whole:
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
