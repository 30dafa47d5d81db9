"""Confidence sequences: intervals for probabilities that hold at every number of tries at once.

A choice's successors x₁, x₂, … are independent draws from its distribution P, however it was decided to try the
choice again, or to stop: that only determines how many of them are seen. So what holds at all n at once also holds at
the n at hand.

**An entry** p = P(s), of which k of n tries are a sample. Compare p with a coin of unknown bias, mixed over
Beta(½, ½) [Krichevsky81]:

    M_n(p) = ∫ θᵏ(1−θ)ⁿ⁻ᵏ dBeta(θ; ½, ½) / (pᵏ(1−p)ⁿ⁻ᵏ) = B(k+½, n−k+½) / (π · pᵏ(1−p)ⁿ⁻ᵏ),        M₀ = 1

is a nonnegative martingale: the mixture predicts success with probability (k+½)/(n+1), so

    E[M_{n+1} / M_n] = p · (k+½)/((n+1)p) + (1−p) · (n−k+½)/((n+1)(1−p)) = 1.

By Ville's inequality P(some n has M_n(p) ≥ 1/α) ≤ α. All p with M_n(p) < 1/α are an interval around k/n, so both
ends together cost α; it is wider by a factor of order √(ln n) than one for a single n fixed beforehand.

**What was not seen.** A is the set of the j successors seen in n tries, of N possible ones. For a fixed set A, of mass
1 − u outside, P(the first n tries stay in A) = (1−u)ⁿ; the bound 1 − β^(1/n) decreases with n, so it first fails at an
n₀, and it is ever wrong only if n₀ tries stay in A: probability below β. No mixture is needed. As A is random, all sets
are bounded at once: β = α / (j(j+1)·C(N, j)) for each of the C(N, j) sets of j states, Σ_j 1/(j(j+1)) < 1. Hence

    P(outside A) ≤ 1 − exp(−(ln C(N, j) + ln j(j+1) + ln 1/α) / n)        for all n at once, up to α.

**Rounding.** Ends come from bisection: an end is moved only to values that are outside by more than `_SLACK` of the
terms' sizes, a hundred times the error of gammaln. So an interval may be too wide by that, but is never too narrow.

Sources: [Ville39] [Robbins70] [Howard21].
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Whole: TypeAlias = NDArray[np.int64]

_SLACK = 1e-12
_BISECTIONS = 60


def entry_interval(successes: Whole, tries: Whole, log_inverse: Floats | float) -> tuple[Floats, Floats]:
    """(lower, upper) ends (n,) around probabilities of which `successes` of `tries` are a sample; [0, 1] without tries.

    `log_inverse` is ln(1/α): an interval misses its probability at any number of tries with probability at most α.
    """
    rows = np.stack(np.broadcast_arrays(successes, tries, log_inverse), axis=1)
    distinct, place = np.unique(rows, axis=0, return_inverse=True)  # few: samples are small integers
    k, n, level = distinct.T
    lower, upper = _lower_end(k, n, level), np.minimum(np.nextafter(1 - _lower_end(n - k, n, level), 2), 1)
    return lower[place.ravel()], upper[place.ravel()]


def unseen_mass(seen: Whole, tries: Whole, possible: int, log_inverse: float) -> Floats:
    """(n,): upper ends of the mass outside the `seen` different successors of `tries` tries, of `possible` ones."""
    from scipy.special import gammaln

    j = seen.astype(np.float64)
    sizes = gammaln(possible + 1.0) + gammaln(j + 1) + gammaln(possible - j + 1)
    sets = gammaln(possible + 1.0) - gammaln(j + 1) - gammaln(possible - j + 1)
    nats = sets + np.log(np.maximum(j * (j + 1), 1)) + log_inverse + _SLACK * (sizes + abs(log_inverse) + 1)
    bound = -np.expm1(-nats / np.maximum(tries, 1)) * (1 + _SLACK)
    return np.where(seen >= possible, 0.0, np.where(tries > 0, np.minimum(bound, 1), 1.0))


def log_inverse(events: int, alpha: Fraction) -> float:
    """ln(events / α): every one of the events gets an equal share of α."""
    share = alpha / max(events, 1)
    return math.log(share.denominator) - math.log(share.numerator)


def _lower_end(k: Floats, n: Floats, log_inverse: Floats) -> Floats:
    """The largest p below k/n, up to the slack, with M_n(p) ≥ 1/α; 0 if there is none."""
    from scipy.special import betaln, gammaln

    mixture = betaln(k + 0.5, n - k + 0.5) - np.log(np.pi)
    size = gammaln(n + 3) + abs(mixture) + abs(log_inverse) + 10
    outside, inside = np.zeros(len(k)), np.divide(k, n, out=np.zeros(len(k)), where=n > 0)
    for _ in range(_BISECTIONS):
        p = (outside + inside) / 2
        with np.errstate(divide="ignore", invalid="ignore"):  # p = 0 where k = 0: nothing moves there
            hit, missed = k * np.log(p), (n - k) * np.log1p(-p)
            evidence = mixture - hit - missed - log_inverse
            beyond = (k > 0) & (evidence >= _SLACK * (size + abs(hit) + abs(missed)))
        outside, inside = np.where(beyond, p, outside), np.where(beyond, inside, p)
    return outside
