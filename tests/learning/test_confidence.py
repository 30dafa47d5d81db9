"""Confidence sequences against fractions: the martingale, the ends of intervals, and how often they are ever wrong."""

import functools
import itertools
import math
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stltool.learning.confidence import entry_interval, unseen_mass

PI = Decimal("3.14159265358979323846264338327950288419716939937511")


def mixture(k, n):
    """B(k+½, n−k+½) / π: the mixture's probability of one sequence with k successes."""
    return Fraction(math.comb(2 * k, k) * math.comb(2 * (n - k), n - k), 4**n * math.comb(n, k))


def evidence(k, n, p):
    """M_n(p)"""
    return mixture(k, n) / (p**k * (1 - p) ** (n - k))


def interval(k, n, alpha):
    (lower,), (upper,) = entry_interval(np.array([k]), np.array([n]), -math.log(alpha))
    return lower, upper


@given(st.integers(1, 30), st.integers(0, 40), st.data())
def test_the_evidence_is_a_martingale_that_starts_at_one(share, n, data):
    k, p = data.draw(st.integers(0, n)), Fraction(share, 31)
    later = p * evidence(k + 1, n + 1, p) + (1 - p) * evidence(k, n + 1, p)
    assert later == evidence(k, n, p)
    chances = (math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(n + 1))
    assert sum(chance * evidence(i, n, p) for i, chance in enumerate(chances)) == 1 == evidence(0, 0, p)


@given(st.integers(0, 300), st.integers(0, 300), st.integers(1, 60))
def test_ends_are_surely_outside_and_barely_so(k, missed, nats):
    """In fractions: M_n ≥ 1/α at both ends, and below 1/α a little further in."""
    n, alpha = k + missed, Fraction(1, math.ceil(math.exp(nats / 2)))
    lower, upper = interval(k, n, alpha)
    assert 0 <= lower <= upper <= 1
    assert (lower == 0) == (k == 0)
    assert (upper == 1) == (missed == 0)
    for end, count in ((Fraction(lower), k), (1 - Fraction(upper), missed)):
        if count:
            further = end + Fraction(count, n) / 10**9
            beyond = [evidence(count, n, p) >= 1 / alpha for p in (end, further)]
            assert beyond == [True, False]


def log_factorial(n):
    """ln n! in fifty digits: Stirling's series."""
    if n < 1000:
        return Decimal(math.factorial(n)).ln()
    x, half_log = Decimal(n), (2 * PI * n).ln() / 2
    return x * x.ln() - x + half_log + 1 / (12 * x) - 1 / (360 * x**3) + 1 / (1260 * x**5)


@pytest.mark.parametrize("n", [600_000, 2_000_000_000])
@pytest.mark.parametrize("failures", [0, 1, 70_000, 300_000])
def test_large_samples_do_not_lose_digits_that_matter(n, failures):
    """ln M_n in fifty digits: ends are outside, and not by more than 10⁻¹² of what is added up."""
    alpha = 1e-6
    with localcontext(prec=50):
        for k in {failures, n - failures} - {0}:
            lower = Decimal(interval(k, n, alpha)[0])
            twice, once = (log_factorial(2 * k) + log_factorial(2 * (n - k)), log_factorial(k) + log_factorial(n - k))
            found = twice - n * Decimal(4).ln() - once - log_factorial(n)
            found -= k * lower.ln() + (n - k) * (1 - lower).ln()
            assert 0 <= found + Decimal(alpha).ln() < Decimal("1e-11") * log_factorial(n)


def test_one_call_is_many_and_nothing_is_known_without_tries():
    k, n = np.array([0, 3, 3, 7, 0]), np.array([0, 9, 9, 7, 4])
    levels = np.array([1.0, 2.0, 3.0, 1.0, 5.0])
    lower, upper = entry_interval(k, n, levels)
    rows = [entry_interval(k[[i]], n[[i]], levels[i]) for i in range(5)]
    assert [(lower[i], upper[i]) for i in range(5)] == [(low[0], high[0]) for low, high in rows]
    assert (lower[0], upper[0]) == (0, 1)
    assert lower[1] > lower[2]  # less may fail
    assert upper[1] < upper[2]


@functools.cache
def intervals(longest, alpha):
    """The ends of 0 … n successes in n tries, of n = 1 … longest."""
    tries = np.repeat(np.arange(1, longest + 1), np.arange(2, longest + 2))
    successes = np.concatenate([np.arange(n + 1) for n in range(1, longest + 1)])
    cuts = np.cumsum(np.arange(2, longest + 1))
    ends = entry_interval(successes, tries, -math.log(alpha))
    return list(zip(*(np.split(array, cuts) for array in ends), strict=True))


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("p", [0.01, 0.3, 0.5, 0.93])
@pytest.mark.parametrize("alpha", [0.5, 0.1])
def test_an_interval_is_ever_wrong_no_more_often_than_stated(p, alpha):
    """Exactly: the probability that some n up to 400 has an interval without p, over all sequences."""
    alive, wrong = np.array([1.0]), 0.0
    for lower, upper in intervals(400, alpha):
        alive = np.append(alive * (1 - p), 0) + np.append(0, alive * p)
        outside = (p < lower) | (p > upper)
        wrong += alive[outside].sum()
        alive[outside] = 0
    assert alive.sum() + wrong == pytest.approx(1)
    assert alpha / 20 < wrong <= alpha


@pytest.mark.parametrize("weights", [(8, 4, 3, 1), (13, 1, 1, 1), (97, 1, 1, 1), (5, 5, 0, 0), (4, 4, 4, 4)])
@pytest.mark.parametrize("alpha", [0.9, 0.2])
def test_unseen_mass_is_ever_wrong_no_more_often_than_stated(weights, alpha):
    """Exactly: sets of successors seen are a Markov chain; some n up to 600 has a mass over its bound."""
    p = np.array(weights) / sum(weights)
    sets = [frozenset(c) for size in range(5) for c in itertools.combinations(range(4), size)]
    move = np.zeros((len(sets), len(sets)))
    for i, known in enumerate(sets):
        for s in range(4):
            move[i, sets.index(known | {s})] += p[s]
    outside = np.array([p[[s for s in range(4) if s not in known]].sum() for known in sets])
    sizes = np.array([len(known) for known in sets])
    alive, wrong = np.eye(len(sets))[0], 0.0
    for n in range(1, 601):
        alive = alive @ move
        bad = outside > unseen_mass(sizes, np.full(len(sets), n), 4, -math.log(alpha))
        wrong += alive[bad].sum()
        alive[bad] = 0
    assert wrong <= alpha
    assert wrong > 0 or weights in ((5, 5, 0, 0), (4, 4, 4, 4)) or alpha < 0.5


@given(st.integers(1, 12), st.integers(1, 10_000), st.integers(1, 40), st.data())
def test_unseen_mass_is_its_equation_rounded_up(possible, tries, nats, data):
    seen = data.draw(st.integers(1, min(possible, tries)))
    (bound,) = unseen_mass(np.array([seen]), np.array([tries]), possible, float(nats))
    if seen == possible:
        assert bound == 0
        return
    sets = math.comb(possible, seen) * seen * (seen + 1)
    exact = -math.expm1(-(math.log(sets) + nats) / tries)
    assert exact * (1 - 1e-15) <= bound <= min(exact * (1 + 1e-10), 1)


def test_without_tries_all_mass_is_unseen():
    assert unseen_mass(np.array([0]), np.array([0]), 5, 3.0).tolist() == [1]
