"""Which truth assignments can occur: nothing is missing, and nothing is superfluous where one variable is compared."""

import functools
import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import TraceError
from stltool.logic.feasible import feasible_valuations, leaves
from stltool.logic.formula import (
    COMPARATORS,
    Arithmetic,
    Call,
    Comparison,
    Constant,
    Label,
    Negate,
    Number,
    Variable,
    children,
    walk,
)
from stltool.logic.occurrences import occurrences, polarities, with_replaced
from stltool.testing import formulas, traces
from stltool.testing.formulas import terms


def rows(read, most=10**6):
    table, complete = feasible_valuations(read, most)
    assert complete
    found = [tuple(row) for row in table.tolist()]
    assert len(found) == len(set(found))
    return set(found)


TERMS = (
    "x", "y", "2 - x", "x / 2 + 1", "abs(x - 1)", "1 / x", "max(x, 1)", "min(2, x, 0.5)", "-3 * x", "sqrt(x)", "0 * x",
    "x - y", "1", "0.5", "-2", "1 / 0", "2 / 4",
)  # fmt: skip


@given(data=st.data())
def test_nothing_that_occurs_is_missing(data):
    values = st.sampled_from([-math.inf, -2.0, -1.0, 0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 40.0, math.inf])
    few = st.sampled_from(TERMS).map(lambda text: stl.parse(f"{text} > 0").left)
    term = few | terms()
    read = data.draw(st.lists(st.builds(Comparison, st.sampled_from(COMPARATORS), term, term), min_size=1, max_size=4))
    trace = {"x": [data.draw(values)], "y": [data.draw(values)]}
    try:
        occurring = tuple(stl.satisfies(leaf, trace) for leaf in read)
    except TraceError:
        assume(False)
    assert occurring in rows(read)


@given(data=st.data())
def test_nothing_is_superfluous_where_one_variable_is_compared(data):
    number = st.sampled_from(["0", "0.5", "-1", "3 / 4", "2 * 1"])
    texts = st.builds("{} {} {}".format, st.sampled_from(["x", "-x", "2 * x", "x + 1", "1 - x", "x / 2"]),
                      st.sampled_from(COMPARATORS), number)  # fmt: skip
    drawn = data.draw(st.lists(texts, min_size=1, max_size=4))
    brute = {(*truths, a) for truths in zip(*map(over_the_grid, drawn), strict=True) for a in (False, True)}
    assert rows([*map(stl.parse, drawn), Label("a")]) == brute


@functools.cache
def over_the_grid(text):
    """Whether a comparison holds at x = −6 … 6: every border, and values on both sides of each."""
    leaf = stl.parse(text)
    return [stl.satisfies(leaf, {"x": [x]}) for x in np.arange(-6, 6.01, 1 / 16)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x > 5 & x < 3", "00 01 10"),
        ("x > 5 & 3 > x & a", "000 001 010 011 100 101"),
        ("2 * x + 1 > 4 & x < 1.5 & x == 1.5", "010 100 001"),
        ("x * 4 >= 1 & x < 0.25", "01 10"),
        ("3 - x > 1 & x < 2", "00 11"),
        ("x - 3 > 1 & x < 4 & x != 4", "000 011 101"),
        ("-x / 2 > 1 & x >= -2", "01 10"),
        ("abs(x) < 3 & x > 2 & x > -4", "000 001 011 101 111"),
        ("abs(x) < -1 & x > 0", "00 01"),
        ("min(x, 3) > 2 & max(1, x, 0) <= 2 & x > 0", "010 011 101"),
        ("max(x, 3) > 2 & x > 0", "10 11"),
        ("0 * x > 1 & x > 0", "00 01"),
        ("x > y & y > x & x == y", "001 010 100"),
        ("x >= y & x - y < 0", "01 10"),
        ("y5 - y4 >= 8 & y5 - y4 < 3 & y5 > 0", "000 001 010 011 100 101"),
        ("x^2 > 4 & x^2 < 1", "00 01 10"),
        ("sqrt(x) > y & y >= sqrt(x)", "01 10"),
        ("sqrt(x) + 1 > 3 & sqrt(x) < 1", "00 01 10"),
            ("x^0.123 + 1 > 3 & x^0.123 < 1", "00 01 10 11"),  # rounded: not related
        ("3 > 2 & 1 == 2 & 0 - 1 < abs(0 - 2)", "101"),
        ("1 / x > 2 & x > 0 & x / 0 > 1", "000 001 010 011 100 101 110 111"),
        ("sqrt(x) > y & sqrt(x) - y > 0 & b < sqrt(x) & b - sqrt(x) < 0", "0000 0011 1100 1111"),
        ("min(x, y) > 2 & x > 2", "00 01 10 11"),
        ("x > 2 + 0 & x < 1 - 0", "00 01 10"),
        ("1 / 0 > 1", "0 1"),
        ("2^2 > 5", "0 1"),
    ],
)  # fmt: skip
def test_what_can_occur(text, expected):
    phi = stl.parse(text)
    assert rows(leaves(phi)) == {tuple(c == "1" for c in row) for row in expected.split()}


@pytest.mark.parametrize("term", ["x + 7", "x - 7", "7 - x", "x * 40", "x / -40", "-x", "abs(x - 9)", "max(x, -9) + 7"])
def test_every_level_is_found(term):
    assert rows(leaves(stl.parse(f"{term} > 3"))) == {(False,), (True,)}


ZERO, TWO = Number(0.0), Number(2.0)


@pytest.mark.parametrize(
    ("term", "value"),
    [
        (Negate(TWO), -2),
        (Arithmetic("+", TWO, ZERO), 2),
        (Arithmetic("-", ZERO, TWO), -2),
        (Arithmetic("*", TWO, TWO), 4),
        (Arithmetic("/", ZERO, TWO), 0),
        (Call("abs", (Negate(TWO),)), 2),
        (Call("min", (TWO, ZERO)), 0),
        (Call("max", (ZERO, TWO)), 2),
        (Arithmetic("/", TWO, ZERO), None),
        (Arithmetic("^", TWO, TWO), None),
        (Call("sqrt", (TWO,)), None),
        (Call("max", (TWO, Variable("y"))), None),
        (Arithmetic("+", TWO, Variable("y")), None),
    ],
)
def test_constants_that_nobody_folded(term, value):
    """The parser folds them; formulas can be made without it."""
    x = Variable("x")
    read = [Comparison(">", x, term), Comparison(">", term, x), Comparison("==", x, Number(abs(value or 0.0)))]
    related = rows(read) != {row for row in itertools.product((False, True), repeat=3) if not (row[0] and row[1])}
    assert related == (value is not None)
    if value is not None:
        trace = [{"x": [float(v)]} for v in range(-5, 6)]
        assert rows(read) == {tuple(stl.satisfies(leaf, case) for leaf in read) for case in trace}


def test_a_root_is_not_rounded_but_a_power_may_be():
    trace = {"x": [2.0], "y": [1.4142135623730951]}  # this decimal is more than the root, and less than its double
    assert stl.satisfies(stl.parse("sqrt(x) < y & sqrt(x) - y < 0"), trace)
    root = leaves(stl.parse("sqrt(x) > y & sqrt(x) - y > 0"))
    assert rows(root) == {(False, False), (True, True)}
    power = leaves(stl.parse("x^0.123 > y & x^0.123 - y > 0"))
    assert rows(power) == {(a, b) for a in (False, True) for b in (False, True)}


def test_leaves_are_told_once_and_left_to_right():
    assert [str(leaf) for leaf in leaves(stl.parse("G[0,2] (b & x > 1) | true U[0,1] (a | b | x > 1)"))] == [
        "b",
        "x > 1",
        "a",
    ]
    assert rows([]) == {()}


def test_of_too_many_some_are_drawn():
    read = leaves(stl.parse(" | ".join(f"l{i}" for i in range(12)) + " | x > 5 | x < 3"))
    every = rows(read)
    table, complete = feasible_valuations(read, 100)
    again, _ = feasible_valuations(read, 100)
    found = [tuple(row) for row in table.tolist()]
    assert not complete
    assert (table == again).all()
    assert 90 < len(found) <= 100
    assert len(set(found)) == len(found)
    assert set(found) <= every
    least = [min(sum(row), len(read) - sum(row)) for row in found]
    assert least == sorted(least)
    for i in range(12):  # what holds alone, and what alone does not
        assert any(row[i] and sum(row[:12]) == 1 for row in found)
        assert any(not row[i] and sum(row[:12]) == 11 for row in found)
    assert len(feasible_valuations([Label(f"l{i}") for i in range(300)], 100)[0]) == 100
    assert len(feasible_valuations(read, 3 * 2**12)[0]) == 3 * 2**12
    assert not feasible_valuations(read, 3 * 2**12 - 1)[1]


# --------------------------------------------------------------------------------------- occurrences


@given(phi=formulas(), data=st.data())
def test_places_and_what_replacing_them_can_do(phi, data):
    places = occurrences(phi)
    assert [place.formula for place in places] == list(walk(phi))
    assert places[0].parent == -1
    for i, place in enumerate(places):
        assert tuple(places[j].formula for j in place.operands) == children(place.formula)
        assert all(places[j].parent == i for j in place.operands)
        assert with_replaced(phi, place.path, place.formula) == phi
    place = data.draw(st.sampled_from(places))
    low, high = (with_replaced(phi, place.path, Constant(value)) for value in (False, True))
    trace = data.draw(traces(stl.horizon(phi) + 1))
    truths = [stl.satisfies(psi, trace) for psi in (low, phi, high)]
    if place.polarity:
        assert truths == sorted(truths, reverse=place.polarity < 0)
    here = phi
    for i in place.path:
        here = children(here)[i]
    assert here == place.formula


def test_polarity():
    signs = [place.polarity for place in occurrences(stl.parse("!a & (b -> !c) & (d <-> !e) & !(f U[0,1] g)"))]
    assert signs == [1, 1, -1, 1, -1, 1, -1, 1, 0, 0, 0, 1, -1, -1, -1]
    found = polarities(stl.parse("F[0,1] !a & !(G[0,1] b) & ((F[0,1] c) <-> d) & (F[0,1] x > 0 -> F[0,2] x > 0)"))
    assert found == {stl.parse(text): sign for text, sign in {"a": -1, "b": -1, "c": 0, "d": 0, "x > 0": 0}.items()}
