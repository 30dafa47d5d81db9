"""What a layer's numbers are, and how a backward step is computed from them: an arithmetic, which works with any
engine.

    V_t(i) = opt or Σ_j weight_j ·  over choices j of pair i of   Σ_k share_k · V_{t+1}(child_k)

A layer is an array (n + 2, …): slot REST holds the value of unlisted pairs, SURE that of sure pairs, then come the open
pairs.
"""

from __future__ import annotations

import itertools
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.edges import SURE, Edges
from stltool.checking.induction.tiled import NaturesTiles, Tiles
from stltool.checking.induction.words import Words
from stltool.models.fractions import LARGEST_SUM, over_one
from stltool.models.rows import Rows

Values = NDArray[Any]


class Arithmetic(ABC):
    """One kind of arithmetic.

    repeats   whether equal values under equal edges give equal values again at any step: then the induction may stop
              early
    """

    repeats = True

    def begin(self, rows: Rows) -> None:
        """Called before the first backward step, with the rows that edges refer to (`Layers.rows`)."""
        self.rows = rows

    def tiles(self, engine: Words) -> Tiles | None:
        """The same by tiles of eight automaton states, if supported."""
        return None

    @abstractmethod
    def ends(self, t: int) -> tuple[Any, Any]:
        """The values after step t of unlisted pairs, and of sure pairs."""

    @abstractmethod
    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        """(m, …): the value of every choice of step t."""

    def start(self, t: int) -> Values:
        """The layer after step t if no pair is open."""
        return np.array(self.ends(t))

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        """The values of the pairs of step t and, if asked for, the index of each pair's first best choice."""
        values, choice = select(self.sums(t, edges, ahead), edges, maximize, keep)
        return self.settled(values), choice

    def settled(self, values: Values) -> Values:
        """Convert the best sums to values in the layer's own unit."""
        return values

    def layer(self, t: int, values: Sequence[Values]) -> Values:
        """The layer of step t, from the values of its open pairs in parts; called after `back` for each of them."""
        return np.concatenate([self.start(t), *values])


def select(sums: Values, edges: Edges, maximize: bool, keep: bool) -> tuple[Values, NDArray[np.int64] | None]:
    """The best of each pair's choices, the first of equals; or their mixture, if choices have weights."""
    if edges.weight is not None:
        return np.add.reduceat(edges.weight * sums, edges.choices[:-1]), None
    count = np.diff(edges.choices)
    if len(sums) == len(count):
        return sums, np.zeros(len(count), dtype=np.int64) if keep else None
    best = (np.maximum if maximize else np.minimum).reduceat(sums, edges.choices[:-1])
    if not keep:
        return best, None
    attained = np.flatnonzero(sums == np.repeat(best, count))
    return best, attained[np.searchsorted(attained, edges.choices[:-1])] - edges.choices[:-1]


def row_sums(terms: Values, start: NDArray[np.int64]) -> Values:
    """Σ terms[start[j]:start[j+1]] for every j, added one by one from the first, as the kernels do, so that the engines
    agree to the last bit."""
    length = np.diff(start)
    order = np.argsort(-length, kind="stable")
    sums = terms[start[:-1]]
    longest = int(length.max(initial=0))
    still = np.searchsorted(-length[order], -np.arange(min(longest, _LONG)))  # how many rows have more than k terms
    for k in range(1, min(longest, _LONG)):
        rows = order[: still[k]]
        sums[rows] += terms[start[rows] + k]
    for j in order[: np.searchsorted(-length[order], -_LONG)].tolist():
        sums[j] = np.cumsum(terms[start[j] : start[j + 1]])[-1]
    return sums


_LONG = 64  # terms; longer rows are added one by one


class Probabilities(Arithmetic):
    """Probabilities in doubles, for callers that need the sums of all choices."""

    def __init__(self, maximize: bool) -> None:
        self._ends = (0.0, 1.0) if maximize else (1.0, 0.0)

    def ends(self, t: int) -> tuple[float, float]:
        return self._ends

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        return row_sums(self.rows.probability[edges.entry] * ahead[edges.child], edges.start)


class Doubles(Probabilities):
    """Probabilities in doubles."""

    def tiles(self, engine: Words) -> Tiles:
        return Tiles(engine, engine.rows.probability, 1, self._ends, self._ends[SURE] == 1.0)


class Fixed(Arithmetic):
    """Integers in units of 1/one, every step rounded up (checking/fixed.py)."""

    def __init__(self, denominator: int, one: int, maximize: bool) -> None:
        self.denominator, self.one, self._maximize = denominator, one, maximize

    def ends(self, t: int) -> tuple[int, int]:
        return (0, self.one) if self._maximize else (self.one, 0)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        return np.add.reduceat(self.rows.numerator[edges.entry] * ahead[edges.child], edges.start[:-1])

    def settled(self, values: Values) -> Values:
        return -((-values) // self.denominator)

    def tiles(self, engine: Words) -> Tiles:
        return Tiles(engine, engine.rows.numerator, self.denominator, self.ends(0), self._maximize)


class Integers(Arithmetic):
    """N_t = V_t · D^(h−t) in Python's integers, without any division (checking/rational.py).

    one   the integer for 1 in the last layer that was made. The weights of a mixture, in proportion to the doubles
          given, enter as integers over their own denominator, step by step
    """

    repeats = False

    def __init__(self, denominator: int, maximize: bool) -> None:
        self.denominator, self._maximize = denominator, maximize
        self.one, self._made = 1, -1

    def begin(self, rows: Rows) -> None:
        self._numerator = rows.numerator.astype(object)

    def ends(self, t: int) -> tuple[int, int]:
        return (0, self.one) if self._maximize else (self.one, 0)

    def start(self, t: int) -> Values:
        return np.array(self.ends(t), dtype=object)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        return np.add.reduceat(self._numerator[edges.entry] * ahead[edges.child], edges.start[:-1])

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        shared = 1
        if edges.weight is not None:
            shares, shared = whole_weights(edges.weight, edges.choices)
            edges = replace(edges, weight=shares)
        if self._made != t:
            self.one, self._made = self.one * self.denominator * shared, t
        return super().back(t, edges, ahead, maximize, keep)

    def number(self, value: Any) -> int:
        """One value as an integer in units of 1/one."""
        return int(value)


def whole_weights(weight: NDArray[np.float64], start: NDArray[np.int64]) -> tuple[Values, int]:
    """Mixtures' weights, each scaled to sum to 1 exactly, as integers over one denominator."""
    known: dict[tuple[float, ...], list[Fraction]] = {}
    shares: list[Fraction] = []
    listed = weight.tolist()
    for a, b in itertools.pairwise(start.tolist()):
        row = tuple(listed[a:b])
        if row not in known:
            total = sum(map(Fraction, row))
            known[row] = [Fraction(share) / total for share in row]
        shares += known[row]
    numerator, denominator = over_one(shares)
    return numerator.astype(object), denominator


class Digits(Arithmetic):
    """The same in digits of a fixed width, for D < 2^40 and deterministic policies (kernels/edges.py)."""

    repeats = False

    def __init__(self, denominator: int, maximize: bool) -> None:
        self.denominator, self._maximize = denominator, maximize
        self.bits = LARGEST_SUM.bit_length() - 1 - denominator.bit_length()
        self.one, self._made = 1, -1

    def begin(self, rows: Rows) -> None:
        self._numerator = rows.numerator.astype(np.int64)

    def ends(self, t: int) -> tuple[Values, Values]:
        one = np.array(self._digits(self.one), dtype=np.int64)
        return (np.zeros_like(one), one) if self._maximize else (one, np.zeros_like(one))

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        raise NotImplementedError  # choices are compared digit by digit while sums are computed

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        from stltool.kernels import edges as kernels

        if self._made != t:
            self.one, self._made = self.one * self.denominator, t
        out = np.zeros((len(edges), len(self._digits(self.one))), dtype=np.int64)
        best = np.zeros(len(edges), dtype=np.int64)
        kernels.digits(
            edges.choices, edges.start, edges.entry, edges.child, self._numerator, ahead, self.bits, maximize,
            0, len(edges), out, best,
        )  # fmt: skip
        return out, best

    def number(self, value: Values) -> int:
        """One value as an integer in units of 1/one."""
        return sum(digit << (self.bits * i) for i, digit in enumerate(value.tolist()))

    def _digits(self, value: int) -> list[int]:
        digits: list[int] = []
        while value or not digits:
            digits.append(value & ((1 << self.bits) - 1))
            value >>= self.bits
        return digits


class Nature(Arithmetic):
    """For interval probabilities: nature picks each row's distribution within them (checking/robust.py).

    `minimal`: whether nature minimises; `maximize`: the direction whose goals the layers have.
    """

    def __init__(self, minimal: bool, maximize: bool) -> None:
        self._minimal, self._maximize, self._summed = minimal, maximize, 0
        self._ends = (0.0, 1.0) if maximize else (1.0, 0.0)

    def ends(self, t: int) -> tuple[float, float]:
        return self._ends

    def tiles(self, engine: Words) -> Tiles:
        return NaturesTiles(engine, self._ends, self._minimal, self._maximize)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        rows = self.rows
        assert rows.intervals is not None
        self._summed += len(edges.child)
        if "numba" not in sys.modules and self._summed <= _FEW_EDGES:  # loading it would take longer
            ends = rows.intervals.lower[edges.entry], rows.width[edges.entry]
            return natures_choice(edges.start, *ends, rows.budget[edges.choice], ahead[edges.child], self._minimal)
        from stltool.kernels import edges as kernels

        out = np.empty(len(edges.choice))
        kernels.nature(
            edges.start, edges.entry, edges.child, rows.intervals.lower, rows.width, rows.budget, edges.choice,
            self._minimal, ahead, 0, len(edges.choice), out,
        )  # fmt: skip
        return out


class ExactNature(Integers):
    """The same without any rounding: N_t = V_t · D^(h−t), for ends over the denominator D."""

    def __init__(self, minimal: bool, denominator: int, maximize: bool) -> None:
        super().__init__(denominator, maximize)
        self._minimal = minimal

    def begin(self, rows: Rows) -> None:
        assert rows.intervals is not None
        lower, upper, denominator = rows.intervals.exact
        scale = self.denominator // denominator  # of all rows; these may be some of them
        self._lower, self._width = lower * scale, (upper - lower) * scale
        self._budget = self.denominator - np.add.reduceat(self._lower, rows.row_start[:-1])

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        _, rank = np.unique(ahead, return_inverse=True)
        rank = (rank if self._minimal else -rank)[edges.child]
        lengths, values = np.diff(edges.start), ahead[edges.child]
        order = np.lexsort((rank, np.repeat(np.arange(len(lengths)), lengths)))
        left, width = self._budget[edges.choice], self._width[edges.entry]
        total = np.add.reduceat(self._lower[edges.entry] * values, edges.start[:-1])
        for i in range(int(lengths.max(initial=0))):
            which = np.flatnonzero(lengths > i)
            edge = order[edges.start[which] + i]
            take = np.minimum(width[edge], left[which])
            left[which] -= take
            total[which] += take * values[edge]
        return total


_FEW_EDGES = 1_000_000


def natures_choice(
    start: NDArray[np.int64], lower: Values, width: Values, budget: Values, ahead: Values, ascending: bool
) -> Values:
    """kernels/edges.py's `nature` in numpy, to the bit: lower, width and ahead (e,) by edge, budget by choice."""
    lengths = np.diff(start)
    order = np.lexsort((ahead if ascending else -ahead, np.repeat(np.arange(len(lengths)), lengths)))  # stable
    left, total = budget.copy(), row_sums(lower * ahead, start)
    for i in range(int(lengths.max(initial=0))):
        which = np.flatnonzero(lengths > i)
        edge = order[start[which] + i]
        take = np.minimum(width[edge], left[which])
        left[which] -= take
        total[which] += take * ahead[edge]
    return np.minimum(total, 1.0)
