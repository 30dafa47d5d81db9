"""Which choices count in a pair (s, q) after step t: all of them, a policy's, or any given set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.graph import I64, U64
from stltool.choices import Choices, Form, Table
from stltool.models.rows import Demand, Rows

if TYPE_CHECKING:
    from stltool.checking.induction.words import Graph, Sets


class Allowed:
    """All choices. Subclasses allow fewer.

    everything   whether all choices count everywhere
    mixed        whether chance picks among the allowed choices (a mixed policy); otherwise the optimiser does
    """

    everything = True
    mixed = False

    def choices(self, rows: Rows | Demand, t: int, s: I64, q: I64) -> tuple[I64, I64, NDArray[np.float64] | None]:
        """The choices of pairs (s, q): the pair that each belongs to (ascending), its number in `rows`, its weight."""
        here, start = rows.at(s), rows.choice_start
        count = start[here + 1] - start[here]
        owner = np.repeat(np.arange(len(s)), count)
        offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        return owner, start[here][owner] + offset, None

    def weights(self, t: int, s: I64, q: I64, number: I64) -> NDArray[np.float64]:
        """For a mixture: the probability of each choice, by its number within its state."""
        raise NotImplementedError

    def masks(self, t: int, graph: Graph, sets: Sets) -> tuple[I64, U64]:
        """For word j of a layer, the automaton states in which choice i of its state counts: words[first[j] + i]."""
        return np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.uint64)

    def first_alike(self, t: int) -> int:
        """The first step such that from there to step t the same choices count."""
        return 0

    def last_alike(self, t: int) -> int:
        """The last step such that from step t to there the same choices count."""
        return 2**62


EVERYTHING = Allowed()


class Following(Allowed):
    """The choices that a policy takes. Raises `Silent` if a reached pair has none."""

    everything = False

    def __init__(self, form: Form) -> None:
        self._form, self.mixed = form, not form.deterministic

    def choices(self, rows: Rows | Demand, t: int, s: I64, q: I64) -> tuple[I64, I64, NDArray[np.float64] | None]:
        taken, here = self._form.at(t, s, q), rows.at(s)
        start = rows.choice_start[here]
        if taken.ndim == 2:
            _require_weights(taken)
            owner, number = np.nonzero(taken)
            return owner, start[owner] + number, taken[owner, number] if self.mixed else None
        if (taken < 0).any():
            raise Silent
        return np.arange(len(s)), start + taken, None

    def weights(self, t: int, s: I64, q: I64, number: I64) -> NDArray[np.float64]:
        taken = self._form.at(t, s, q)
        weight: NDArray[np.float64] = taken[np.arange(len(s)), number]
        return weight

    def masks(self, t: int, graph: Graph, sets: Sets) -> tuple[I64, U64]:
        from stltool.kernels import words

        form, layer = self._form, (sets.states, sets.start, sets.word, sets.bits)
        if isinstance(form, Choices):
            first, masks, silent = words.choice_masks(
                *layer, graph.states, graph.choice_start, form.n_words, *form.words(t)
            )
        elif isinstance(form, Table):
            of_row = words.table_masks if form.deterministic else words.mixture_masks
            first, masks, silent = of_row(*layer, graph.states, graph.choice_start, form.row(t))
        else:
            taken = form.at(t, *sets.pairs(graph))
            _require_weights(taken)
            of_pairs = words.taken_masks if form.deterministic else words.weighted_masks
            first, masks, silent = of_pairs(*layer, graph.choice_start, taken)
        if silent:
            raise Silent
        return first, masks

    def first_alike(self, t: int) -> int:
        return self._form.alike(t)[0]

    def last_alike(self, t: int) -> int:
        return self._form.alike(t)[1]


def _require_weights(taken: NDArray[Any]) -> None:
    """Silent if some of the weights (n, C) are all zero: a mixture that was read from text lists situations."""
    if taken.ndim == 2 and not taken.any(axis=1).all():
        raise Silent


class Among(Following):
    """The choices to which a mixture gives weight; the optimiser picks among them."""

    def __init__(self, form: Form) -> None:
        super().__init__(form)
        self.mixed = False


class Silent(Exception):
    """A policy has no choice in some reachable pair: the caller finds out which and reports it."""
