"""Arithmetics for rows that depend on parameters (models/parameters.py), over a box: every parameter in an interval.

Let u and v be a row's entries at the two ends of its parameter's interval; in between they are u(1−x) + v·x.

**Polynomials** of one parameter, in Bernstein's basis B_i^n(x) = C(n,i) x^i (1−x)^(n−i): after step t a value is
Σ_i c_i B_i^n(x) of degree n = h − t, and one step earlier, for each choice,

    c'_i = Σ_k [ u_k · (n+1−i)/(n+1) · c_i(child_k)  +  v_k · i/(n+1) · c_{i−1}(child_k) ],        i = 0 … n+1

Decided values have equal coefficients. All terms are nonnegative: nothing cancels. For a policy this is P itself as a
function of the parameter. The basis is nonnegative too, so the coefficientwise maximum over choices is a polynomial
that no policy exceeds, and equals the optimum at both ends; the minimum likewise.

Exactly: with u and v over a denominator D and b_i = C(n,i) · D^n · c_i, the same step needs no division,

    b'_i = Σ_k [ u_k · b_i(child_k) + v_k · b_{i−1}(child_k) ]

**Tied rows**: nature takes a value of the parameter in the interval again at every row. A row's sum is linear in x, so
one of the ends is worst.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.arithmetic import Arithmetic, Doubles, Integers, Values, row_sums, whole_weights
from stltool.checking.induction.edges import SURE, Edges
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Words
from stltool.models.parameters import Values as Point
from stltool.models.rows import Rows


class Bernstein(Arithmetic):
    """A layer is (n + 2, degree + 1): the coefficients, over the box from `first` to `last`.

    `horizon`, of the game, determines the degree; `maximize`: the direction whose goals the layers have.
    """

    repeats = False

    def __init__(self, horizon: int, first: Point, last: Point, maximize: bool) -> None:
        self._horizon, self._box = horizon, (first, last)
        self._ends = (0.0, 1.0) if maximize else (1.0, 0.0)

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        self._first, self._last = (rows.tied_at(end) for end in self._box)

    def ends(self, t: int) -> tuple[Values, Values]:
        rest, sure = (np.full(self._horizon - t + 1, end) for end in self._ends)
        return rest, sure

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        from scipy.sparse import csr_array

        n = self._horizon - t  # the degree of the sums
        if ahead.shape[1] < n:  # all was decided after this step: constants, as they were made after the last one
            ahead = np.repeat(ahead[:, :1], n, axis=1)
        shape = len(edges.choice), len(ahead)
        i = np.arange(n)
        found = np.zeros((shape[0], n + 1))
        for ends, lift in ((self._first, 0), (self._last, 1)):
            moved = csr_array((ends[edges.entry], edges.child, edges.start), shape=shape) @ ahead
            found[:, lift : n + lift] += moved * ((i + 1 if lift else n - i) / n)
        return found

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        sums = self.sums(t, edges, ahead)
        if edges.weight is not None:
            return np.add.reduceat(edges.weight[:, None] * sums, edges.choices[:-1], axis=0), None
        if len(sums) == len(edges):
            return sums, None
        return (np.maximum if maximize else np.minimum).reduceat(sums, edges.choices[:-1], axis=0), None


class ExactBernstein(Arithmetic):
    """The same in Python's integers: a layer is (n + 2, degree + 1) of the numbers b_i above, for the steps that were
    made so far. The weights of a mixture enter as in `Integers`.

    one          the integer for 1: D^degree, times the denominators of mixtures
    denominator  D, after `begin`
    """

    repeats = False

    def __init__(self, first: Point, last: Point, maximize: bool) -> None:
        self._box, self._maximize = (first, last), maximize
        self.one, self.degree, self._made = 1, 0, -1

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        (first, last), self.denominator = rows.tied_over(*self._box)
        self._first, self._last = first.astype(object), last.astype(object)

    def ends(self, t: int) -> tuple[Values, Values]:
        sure = np.array([math.comb(self.degree, i) * self.one for i in range(self.degree + 1)], dtype=object)
        return (0 * sure, sure) if self._maximize else (sure, 0 * sure)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        found = np.zeros((len(edges.choice), ahead.shape[1] + 1), dtype=object)
        children = ahead[edges.child]
        for ends, part in ((self._first, found[:, :-1]), (self._last, found[:, 1:])):
            part += np.add.reduceat(ends[edges.entry][:, None] * children, edges.start[:-1], axis=0)
        return found

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        shares, shared = None, 1
        if edges.weight is not None:
            shares, shared = whole_weights(edges.weight, edges.choices)
        if self._made != t:  # not again for another part of the step
            self.one, self.degree, self._made = self.one * self.denominator * shared, self.degree + 1, t
        sums = self.sums(t, edges, ahead)
        if shares is not None:
            return np.add.reduceat(shares[:, None] * sums, edges.choices[:-1], axis=0), None
        if len(sums) == len(edges):
            return sums, None
        return (np.maximum if maximize else np.minimum).reduceat(sums, edges.choices[:-1], axis=0), None


class ExactAt(Integers):
    """Probabilities without any rounding where the parameters have these values."""

    def __init__(self, values: Point, maximize: bool) -> None:
        super().__init__(1, maximize)
        self._values = values

    def begin(self, rows: Rows) -> None:
        (numerator,), self.denominator = rows.tied_over(self._values)
        self._numerator = numerator.astype(object)


class At(Doubles):
    """Probabilities in doubles where the parameters have these values."""

    def __init__(self, values: Point, maximize: bool) -> None:
        super().__init__(maximize)
        self._values = values

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        self._probability = rows.tied_at(self._values)

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        return row_sums(self._probability[edges.entry] * ahead[edges.child], edges.start)

    def tiles(self, engine: Words) -> Tiles:
        return Tiles(engine, self._probability, 1, self._ends, self._ends[SURE] == 1.0)


class Tied(Arithmetic):
    """Nature picks each row's parameter in the box from `first` to `last`; `minimal`: whether it minimises."""

    def __init__(self, first: Point, last: Point, minimal: bool, maximize: bool) -> None:
        self._box, self._worst = (first, last), np.minimum if minimal else np.maximum
        self._ends = (0.0, 1.0) if maximize else (1.0, 0.0)

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        self._at: list[Any] = [rows.tied_at(end) for end in self._box]

    def ends(self, t: int) -> tuple[float, float]:
        return self._ends

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        values = ahead[edges.child]
        first, last = (row_sums(end[edges.entry] * values, edges.start) for end in self._at)
        return self._worst(first, last)
