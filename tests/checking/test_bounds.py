"""The enclosure's arithmetic against exact fractions."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.checking import bounds
from stltool.checking.bounds import can_underflow, enclose, roundings
from stltool.choices import Table


@given(
    st.lists(st.lists(st.floats(1e-300, 1.0), min_size=1, max_size=4), min_size=1, max_size=30),
    st.floats(0.0, 1.0),
)
def test_chains_of_dot_products_stay_inside(rows, end):
    """V ← Σ p·V along a path, once in doubles and once in fractions, rows scaled to sum to at most 1."""
    value, exact = end, Fraction(end)
    for row in rows:
        scaled = [p / (2 * sum(row)) for p in row]
        total = 0.0
        for p in scaled:
            total += p * value
        exact = sum(Fraction(p) * exact for p in scaled)
        value = total
    lower, upper = enclose(value, roundings(len(rows), max(len(row) for row in rows)))
    assert Fraction(lower) <= exact <= Fraction(upper)


@pytest.mark.parametrize("n", [1, 2, 3, 1000])
def test_roundings_that_all_go_one_way_are_covered(n):
    u = Fraction(1, 2**53)
    lower, upper = bounds.around(0.5, n, underflow=False)
    assert lower * (1 + u) ** n <= Fraction(1, 2) <= upper * (1 - u) ** n  # the exact value, rounded n times


@given(st.floats(0, 1), st.integers(1, 10**6))
def test_bounds_surround_the_value_and_grow(value, n):
    lower, upper = enclose(value, n)
    assert 0 <= lower <= value <= upper <= 1
    wider = enclose(value, 2 * n)
    assert wider[0] <= lower
    assert upper <= wider[1]


def test_width_at_horizon_1000_is_far_below_the_promise():
    lower, upper = enclose(0.5, roundings(1000, 9, 9))
    assert 0 < upper - lower < 1e-11


@given(st.lists(st.floats(1e-300, 1.0), min_size=1, max_size=12))
def test_products_that_leave_the_doubles_stay_inside(factors):
    """One way only: rounding and underflow are all there is, and the slack goes only where nothing can underflow."""
    value, exact = 1.0, Fraction(1)
    for p in factors:
        value, exact = p * value, Fraction(p) * exact
    underflow = can_underflow(len(factors), min(factors))
    lower, upper = enclose(value, roundings(len(factors), 1), underflow=underflow)
    assert Fraction(lower) <= exact <= Fraction(upper)


def test_an_underflow_to_zero_is_seen():
    assert can_underflow(2, 1e-200)
    assert not can_underflow(2, 1e-100)
    assert enclose(1e-200 * 1e-200, roundings(2, 1), underflow=can_underflow(2, 1e-200))[1] > 0


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=9), st.floats(-9e-10, 9e-10))
def test_defects_of_large_models_are_bounded_from_above(weights, excess):
    """Where exact sums would take long, sums of doubles with their roundings do."""
    row = np.array(weights) / sum(weights) * (1 + excess)
    model = stl.MDP.from_arrays([np.tile(row, (len(row), 1))], {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounds, "READ_EXACTLY", 0)
        estimated = bounds.row_defect(model.rows)
    exact = abs(sum(map(Fraction, row.tolist())) - 1)
    assert exact <= estimated <= exact + Fraction(1, 10**14)


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 5))
def test_distinct_mixtures_are_all_of_them(seed, n, choices):
    """Against a set of tuples: a mixture left out would leave its defect out of the bound."""
    table = np.random.default_rng(seed).integers(0, 3, size=(n, 2, choices)) / 3
    found = list(map(tuple, Table(table).mixtures().tolist()))
    assert len(found) == len(set(found))
    assert set(found) == {tuple(sorted(row)) for row in table.reshape(-1, choices).tolist()}


def test_mixtures_that_share_a_number_are_told_apart():
    """Bits moved by 1025 and −3 against the factors 3 and 1025 of the number: another row, the same number."""
    one = np.array([0.25, 0.75])
    other = (one.view(np.int64) + np.array([1025, -3])).view(np.float64)
    assert (one != other).all()
    factors = 2 * np.arange(1, 3, dtype=np.uint64) ** 9 + 1
    assert one.view(np.uint64) @ factors == other.view(np.uint64) @ factors
    assert len(Table(np.array([[one, other]])).mixtures()) == 2
