"""Comparisons over arrays: decided as the slow semantics decides them, margins within their bound."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import TraceError
from stltool.logic.formula import COMPARATORS, Arithmetic, Call, Comparison, Negate, Number, Variable, horizon
from stltool.logic.semantics import robustness, satisfies
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.doubles import short_decimals


def any_terms():
    """Terms that may have no value, and whose values may meet."""
    leaves = st.sampled_from("xy").map(Variable) | st.sampled_from([0.0, 0.1, 0.3, 1.0, 2.0, 3.0, 1e200]).map(Number)
    exponents = st.sampled_from([0.0, 0.5, 2.0, 3.0, 1001.0]).map(Number)

    def grow(below):
        return st.one_of(
            below.map(Negate),
            st.builds(Arithmetic, st.sampled_from("+-*/"), below, below),
            st.builds(Arithmetic, st.just("^"), below, exponents | exponents.map(Negate) | below),
            st.builds(Call, st.sampled_from(["abs", "sqrt"]), st.tuples(below)),
            st.builds(Call, st.sampled_from(["min", "max"]), st.tuples(below, below) | st.tuples(below, below, below)),
        )

    return st.recursive(leaves, grow, max_leaves=5)


VALUES = st.one_of(
    st.integers(-30, 30).map(lambda k: k / 10),
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-1e-300, 1e-300),
    st.sampled_from([-0.0, 5e-324, 1e154, 1.5e308, -1.5e308, 0.1 + 0.2, math.nextafter(0.3, 0)]),
)


def judged(node, x, y):
    """Truth, margin and where there is no value, of samples (n,), and how far margins may be off."""
    predicate, columns = Predicate(node), {"x": np.array([x]), "y": np.array([y])}
    truth, margin = np.empty((1, len(x)), dtype=np.bool_), np.empty((1, len(x)))
    with np.errstate(all="ignore"):
        unknown, _ = predicate.judge(columns, truth, margin, wide=True)
        error = np.broadcast_to(predicate.error(columns), truth.shape)
        for only in (
            predicate.judge(columns, np.empty_like(truth), None, True)[0],
            predicate.judge(columns, None, np.empty_like(margin), True)[0],
        ):
            assert (only is None) == (unknown is None)
    unknown = np.zeros_like(truth) if unknown is None else unknown
    return truth[0], margin[0], unknown[0], error[0]


@given(
    op=st.sampled_from(COMPARATORS),
    left=any_terms(),
    right=any_terms(),
    samples=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=6),
)
def test_comparisons_are_those_of_the_slow_semantics(op, left, right, samples):
    node = Comparison(op, left, right)
    for (x, y), true, margin, unknown, error in zip(samples, *judged(node, *zip(*samples, strict=True)), strict=True):
        signal = {"x": [x], "y": [y]}
        try:
            wanted = satisfies(node, signal)
        except TraceError:
            assert unknown
            assert math.isnan(margin)
            continue
        assert not unknown
        assert true == wanted
        try:
            distance = robustness(node, signal)
        except TraceError:
            assert math.isnan(margin)
            continue
        assert abs(margin - distance) <= error + 2**-52 * abs(distance)
        assert margin <= 0 or wanted  # the sign is right
        assert margin >= 0 or not wanted
        assert math.copysign(1, margin) == 1 or margin != 0


@given(op=st.sampled_from(COMPARATORS), left=any_terms(), right=any_terms(), x=VALUES, y=VALUES, n=st.integers(1, 40))
def test_one_sample_is_judged_as_many_are(op, left, right, x, y, n):
    """Bit for bit, wherever it stands in an array."""
    predicate = Predicate(Comparison(op, left, right))
    truth, margin, *_ = judged(predicate.node, [x] * n, [y] * n)
    try:
        alone = predicate.at_one_sample()({"x": x, "y": y})
    except TraceError:
        assert np.isnan(margin).all()
    else:
        assert {repr(alone)} == {repr(pair) for pair in zip(margin.tolist(), truth.tolist(), strict=True)}


def test_samples_away_from_borders_are_not_judged_one_by_one(monkeypatch):
    asked = []
    monkeypatch.setattr(Predicate, "_settle", lambda self, *sample: asked.append(sample) or (True, 0.0))
    rng = np.random.default_rng(0)
    x, y = rng.random((2, 1000)) + 0.5
    for text in (
        "x + y > 1.5", "x - y <= 0", "x * y < 1", "x / y != 1", "sqrt(x) >= y", "x^2 + y^3 < 2", "x^-1.5 > y^0.5",
        "abs(x - y) < 0.1", "max(x + 1, y) > min(x * y, 2 * y, x)", "-(x + y) < -2",
    ):  # fmt: skip
        judged(stl.parse(text), x, y)
        assert not asked, text
    judged(stl.parse("x / y > 0.5"), [0.5, 0.7, 1.0] * 2, [1.0, 1.4, 1.0] * 2)
    assert asked == [(0.5, 1.0), (0.7, 1.4)]  # each once, and not the third


def test_a_comparison_of_numbers_alone():
    truth, margin, *_ = judged(stl.parse("0.1 + 0.2 == 0.3"), [1.0, 2.0], [0.0, 0.0])
    assert (truth.tolist(), margin.tolist()) == ([True, True], [0.0, 0.0])
    assert judged(stl.parse("1 / 0 > 1"), [1.0], [0.0])[2].tolist() == [True]
    assert horizon(stl.parse("0.1 + 0.2 == 0.3")) == 0


def test_a_margin_beyond_the_doubles_has_its_message():
    phi = stl.parse("x > y")
    with pytest.raises(TraceError, match=r"line 1, column 1: the margin is beyond the range of doubles"):
        stl.robustness(phi, {"x": [1e308], "y": [-1e308]})
    assert stl.satisfies(phi, {"x": [1e308], "y": [-1e308]})


def test_short_decimals_are_whole_numbers_of_a_power_of_ten():
    whole, places = short_decimals(np.array([0.5, -0.25, 3.0]))
    assert (whole.tolist(), places) == ([50, -25, 300], 2)
    assert short_decimals(np.array([1.0, 1e15])) is None  # 16 digits
    assert short_decimals(np.array([1.0, -1e15])) is None
    assert short_decimals(np.array([0.1] * 200 + [1 / 3])) is None
