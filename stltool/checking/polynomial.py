"""Polynomials on an interval in Bernstein's basis: coefficients c_0 … c_n of C(n,i) x^i (1−x)^(n−i), x in [0, 1].

A polynomial lies between its least and its greatest coefficient, and c_0 and c_n are its values at the ends. De
Casteljau's algorithm gives the coefficients on the two parts of a divided interval: sums of nonnegative terms, one
rounding a level if the interval is halved [Farouki12].
"""

from __future__ import annotations

import heapq
import itertools
import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.numbers import number_text

Floats: TypeAlias = NDArray[np.float64]

_MOST = 10_000  # halvings


@dataclass(frozen=True)
class Polynomial:
    """A polynomial on [lower, upper], exactly.

    coefficients  c_0 … c_n in Bernstein's basis, on this interval
    """

    lower: Fraction
    upper: Fraction
    coefficients: tuple[Fraction, ...] = field(repr=False)

    @property
    def ends(self) -> tuple[Fraction, Fraction]:
        """The values at both ends."""
        return self.coefficients[0], self.coefficients[-1]

    def at(self, p: Fraction) -> Fraction:
        """The value at p, in [lower, upper]."""
        c, n = self.coefficients, len(self.coefficients) - 1
        if self.lower == self.upper:
            return c[0]
        x = (p - self.lower) / (self.upper - self.lower)
        a, d = x.numerator, x.denominator
        terms = (math.comb(n, i) * a**i * (d - a) ** (n - i) * c[i] for i in range(n + 1))
        return sum(terms, Fraction(0)) / Fraction(d) ** n

    def raised(self, degree: int) -> Polynomial:
        """The same polynomial with coefficients of a higher degree."""
        c = self.coefficients
        for n in range(len(c), degree + 1):
            share = [Fraction(i, n) for i in range(n + 1)]
            c = tuple(x * a + (1 - x) * b for x, a, b in zip(share, (c[0], *c), (*c, c[-1]), strict=True))
        return replace(self, coefficients=c)

    @cached_property
    def powers(self) -> tuple[Fraction, ...]:
        """a_0, a_1, …: the same polynomial as Σ a_k p^k; the last one is not 0, unless it is the only one."""
        c, n = list(self.coefficients), len(self.coefficients) - 1
        if self.lower == self.upper:
            return (c[0],)
        of_x = []
        for k in range(n + 1):  # of x^k: C(n,k) times the k-th difference at c_0
            of_x.append(math.comb(n, k) * c[0])
            c = [b - a for a, b in itertools.pairwise(c)]
        scale = 1 / (self.upper - self.lower)
        found: list[Fraction] = []
        for one in reversed(of_x):  # Horner's rule, in x = scale · (p − lower)
            raised = [Fraction(0), *(scale * a for a in found)]
            found = [b - self.lower * scale * a for a, b in zip([*found, Fraction(0)], raised, strict=True)]
            found[0] += one
        while len(found) > 1 and not found[-1]:
            found.pop()
        return tuple(found)

    def text(self, name: str) -> str:
        """The polynomial in powers of `name`, highest first, such as 3*p^2 - p + 1/2."""
        terms = [(a, k) for k, a in enumerate(self.powers) if a]
        found = ""
        for a, k in reversed(terms):
            power = "" if k == 0 else name if k == 1 else f"{name}^{k}"
            size = number_text(abs(a))
            factor = power if size == "1" and power else f"{size}*{power}" if power else size
            sign = ("- " if a < 0 else "+ ") if found else "-" if a < 0 else ""
            found += f"{' ' if found else ''}{sign}{factor}"
        return found or "0"


def halves(c: Floats) -> tuple[Floats, Floats]:
    """The coefficients on [0, ½] and on [½, 1]."""
    left, right = np.empty_like(c), np.empty_like(c)
    n = len(c)
    for i in range(n):
        left[i], right[n - 1 - i] = c[0], c[-1]
        c = 0.5 * c[:-1] + 0.5 * c[1:]
    return left, right


def value(c: Floats, x: float, rest: float) -> float:
    """The polynomial at x, where rest is 1 − x."""
    while len(c) > 1:
        c = rest * c[:-1] + x * c[1:]
    return float(c[0])


def least(c: Floats, tolerance: float) -> tuple[float, float, int]:
    """(bound, attained, depth): up to the roundings of `depth` halvings, bound ≤ minimum ≤ attained; their difference
    is at most `tolerance`, unless that takes too many halvings."""
    attained = float(min(c[0], c[-1]))
    queue = [(float(c.min()), 0, 0, c)]
    number = deepest = 0
    while queue[0][0] < attained - tolerance and number < _MOST:
        _, _, depth, worst = heapq.heappop(queue)
        deepest = max(deepest, depth + 1)
        for half in halves(worst):
            number += 1
            attained = min(attained, float(half[0]), float(half[-1]))
            heapq.heappush(queue, (float(half.min()), number, depth + 1, half))
    return queue[0][0], attained, deepest


def greatest(c: Floats, tolerance: float) -> tuple[float, float, int]:
    """(bound, attained, depth): attained ≤ maximum ≤ bound, likewise."""
    bound, attained, depth = least(-c, tolerance)
    return -bound, -attained, depth
