"""Which truth assignments occur: none that does is left out, and all that are told do, whatever given signals are."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import TraceError
from stltool.logic.feasible import feasible_valuations, leaves
from stltool.logic.formula import Number, Variable
from stltool.logic.occurring import occurring
from stltool.logic.roots import truths_of_one_signal
from stltool.logic.shifts import with_variables
from tests.conftest import many

TERMS = (
    "x",
    "y",
    "z",
    "x - y",
    "x + 2 * y",
    "abs(x) - z",
    "max(x, y)",
    "y - z",
    "x - y - 2",
    "x * y",
    "x * x",
    "x * (y - 2)",
    "x^2 * abs(y)",
)
VALUES = (-7.0, -2.0, -0.5, 0.0, 0.5, 1.0, 2.0, 2.5, 9.0)
COMPARISONS = st.builds("{} {} {}".format, st.sampled_from(TERMS), st.sampled_from([">", "<=", "=="]), st.sampled_from(
    ["0", "2", "x", "z"]))  # fmt: skip
READ = st.lists(COMPARISONS, min_size=2, max_size=4).map(lambda texts: leaves(stl.parse(" & ".join(texts))))


def rows_of(read, given=()):
    rows, complete = feasible_valuations(read, 1024)
    assert complete
    kept, sure = occurring(read, rows, given)
    return set(map(tuple, kept.tolist())), sure


@settings(max_examples=many(40))
@given(read=READ, data=st.data())
def test_no_assignment_that_occurs_is_left_out(read, data):
    kept, _ = rows_of(read)
    behind, _ = rows_of(read, ("y",))
    for _ in range(5):
        point = {name: np.array([data.draw(st.sampled_from(VALUES))]) for name in "xyz"}
        row = tuple(bool(stl.satisfies(leaf, point)) for leaf in read)
        assert row in kept
        assert row in behind


@settings(max_examples=many(40))
@given(read=READ, data=st.data())
def test_what_occurs_whatever_a_signal_is_occurs_for_each_of_its_values(read, data):
    rows, sure = rows_of(read, ("y",))
    value = data.draw(st.sampled_from([v for v in VALUES if v >= 0]))
    fixed = [
        with_variables(leaf, lambda name: Number(value) if name.name == "y" else Variable(name.name)) for leaf in read
    ]
    found, known = rows_of(fixed)
    if sure and known:
        assert found == rows


@pytest.mark.parametrize(
    ("text", "given_", "expected", "sure"),
    [
        ("x > y & y > z & x > z", (), "000 010 011 100 101 111", True),
        ("x > y & y >= z & x < z", (), "001 010 011 100 101 110", True),
        ("x + y > 3 & x - y > 1 & x > 2", (), "000 010 011 100 101 111", True),
        ("x * y == 0 & x > 0 & y > 2", (), "000 001 010 011 100 101 110", True),
        ("x^2 * (y - 1) < 0 & y > 2 & x > 3", (), "000 001 010 011 100 101", True),
        ("0 < x * x * y & 0 != x & y >= 0", (), "000 001 010 011 111", True),
        ("x * y > 1 & x > y", (), "00 01 10 11", True),
        ("x * x > 4 & x^3 <= 8", (), "01 10 11", True),
        ("x * x == 2 & x > 1", (), "00 01", True),  # no decimal is a root of 2
        ("3 * x^2 - x == 0 & x >= 0", (), "00 01 11", True),  # 0 is a root, and 1/3
        ("10^12 * x^2 - 1 == 0 & x > 0", (), "00 01 10 11", True),
        ("x^2 - 2 * x + 1 <= 0 & x^3 == 1", (), "00 11", True),
        ("1 / x > 2 & x^2 < 0.25", (), "00 01 11", True),  # 0 is not accepted
        ("sqrt(x) > 2 & x * x < 16", (), "00 01 10", True),
        ("sqrt(x + 1) == x & x > 0 & x > 2", (), "000 010 011", True),
        ("sqrt(x) >= sqrt(2 - x) & abs(x * x - 1) < 1 & x > 0", (), "000 011 101 111", True),
        ("x^13 > 4 & x * x > 1", (), "00 01 10 11", False),  # over the largest exponent
        ("sqrt(abs(x) + sqrt(x)) > 2 & x > 1", (), "00 01 11 10", False),
        ("x - w <= 1 & x - w > -1", ("w",), "01 10 11", True),
        ("x - w > 0 & 2 * x - 2 * w <= 0", ("w",), "01 10", True),
        ("x - w <= 1 & y > w", ("w",), "00 01 10 11", True),
        ("x - w <= 1 & x > 3", ("w",), "00 01 10 11", False),
        ("w > 3 & x > 2", ("w",), "00 01 10 11", False),
        ("x == 3 * w & y > w", ("w",), "00 01 10 11", True),
        ("3 * x == w & y > w", ("w",), "00 01 10 11", False),  # no decimal x may solve it
    ],
)
def test_what_is_known(text, given_, expected, sure):
    rows, found = rows_of(leaves(stl.parse(text)), given_)
    assert {"".join(str(int(value)) for value in row) for row in rows} == set(expected.split())
    assert found is sure


HALVES = st.sampled_from([n / 2 for n in range(-4, 5)])
FACTORS = st.lists(HALVES.map(lambda root: f"(x - {root})".replace("- -", "+ ")), min_size=1, max_size=3).map(
    " * ".join
)
TERMS_OF_ONE = st.one_of(
    FACTORS,
    FACTORS.map("abs({}) + (x - x)".format),
    FACTORS.map("sqrt({})".format),
    st.builds("({}) / ({})".format, FACTORS, FACTORS),
    HALVES.map("max(x - 1, {} - x)".format),
    FACTORS.map("({})^2".format),
)
OF_ONE_SIGNAL = st.builds("{} {} 0".format, TERMS_OF_ONE, st.sampled_from([">", "<=", "==", "!=", "<"]))


@settings(max_examples=many(60))
@given(texts=st.lists(OF_ONE_SIGNAL, min_size=2, max_size=3))
def test_what_occurs_of_one_signal_is_found_from_the_roots(texts):
    read = leaves(stl.parse(" & ".join(texts)))
    rows = set()
    for point in np.arange(-5, 5.125, 0.125).tolist():  # all roots, and values between them
        with contextlib.suppress(TraceError):
            rows.add(tuple(stl.satisfies(leaf, {"x": np.array([point])}) for leaf in read))
    assert truths_of_one_signal(read, "x") == rows


@settings(max_examples=many(60))
@given(
    texts=st.lists(
        st.builds(
            "{} {} {}".format,
            st.sampled_from(
                ["x*x", "x^3 - x", "abs(x*x - 2)", "sqrt(x + 3)", "1 / x", "max(x*x, 1 - x)", "x / (x*x + 1)",
                 "1e99 * x"]
            ),
            st.sampled_from([">", "<=", "=="]),
            st.sampled_from(["0", "1", "x", "x + 0.3", "sqrt(2 - x)", "0.25 * x^4", "min(x, x^2)"]),
        ),
        min_size=2, max_size=3,
    ),
    data=st.data(),
)  # fmt: skip
def test_no_value_of_one_signal_has_another_truth(texts, data):
    read = leaves(stl.parse(" & ".join(texts)))
    rows = truths_of_one_signal(read, "x")
    assert rows is not None
    for _ in range(20):
        value = data.draw(st.integers(-400, 400)) / 100
        with contextlib.suppress(TraceError):
            assert tuple(stl.satisfies(leaf, {"x": np.array([value])}) for leaf in read) in rows


def test_numbers_of_a_hundred_digits_in_polynomials():
    """Minutes, if remainders were not kept small and every interval were narrowed by the whole chain."""
    read = leaves(stl.parse("1e99 * x > sqrt(2 - x) & max(x*x, 1 - x) > sqrt(2 - x) & x*x > 0"))
    rows = truths_of_one_signal(read, "x")
    values = (-2, 0, 1e-99, 2e-99, 0.5, 2)
    judged = {tuple(stl.satisfies(leaf, {"x": np.array([x])}) for leaf in read) for x in values}
    assert len(judged) == 5
    assert rows == judged
