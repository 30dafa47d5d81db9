"""Polynomials on an interval in Bernstein's basis: coefficients c_0 … c_n of C(n,i) x^i (1−x)^(n−i), x in [0, 1].

A polynomial lies between its least and its greatest coefficient, and c_0 and c_n are its values at the ends. De
Casteljau's algorithm gives the coefficients on the two parts of a divided interval: sums of nonnegative terms, one
rounding a level if the interval is halved [Farouki12].
"""

from __future__ import annotations

import heapq
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]

_MOST = 10_000  # halvings


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
