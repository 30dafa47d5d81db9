"""Which truth assignments occur: none that does is left out, and all that are told do, whatever given signals are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.feasible import feasible_valuations, leaves
from stltool.logic.formula import Number, Variable
from stltool.logic.occurring import occurring
from stltool.logic.shifts import with_variables
from tests.conftest import many

TERMS = ("x", "y", "z", "x - y", "x + 2 * y", "abs(x) - z", "max(x, y)", "y - z", "x - y - 2", "x * y", "x * x")
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
        ("x * y > 1 & x > y", (), "00 01 10 11", True),
        ("x * x > 4 & x^3 <= 8", (), "00 01 10 11", False),  # 00 does not occur
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
