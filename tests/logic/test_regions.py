"""Values that give comparisons a wanted truth: what is offered has it, and of linear comparisons nothing is missing."""

import itertools
import random
from fractions import Fraction

from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.feasible import leaves
from stltool.logic.formula import Arithmetic, Call, Comparison, Negate, Number, Variable
from stltool.logic.regions import Choices, Span, groups, kept
from tests.conftest import many

GRID = [Fraction(n, 2) for n in range(-6, 7)]
RANGES = {"x": (Fraction(-3), Fraction(3)), "y": (Fraction(-3), Fraction(3)), "z": (Fraction(0), None)}


@st.composite
def linear_terms(draw, deep=2):
    kind = draw(st.integers(0, 7)) if deep else draw(st.integers(0, 1))
    if kind == 0:
        return Variable(draw(st.sampled_from("xyz")))
    if kind == 1:
        return Number(draw(st.sampled_from([0.0, 0.5, 1.0, 3.0])))
    below = linear_terms(deep=deep - 1)
    if kind == 2:
        return Negate(draw(below))
    if kind == 3:
        return Arithmetic("*", Number(draw(st.sampled_from([0.5, 2.0, 3.0]))), draw(below))
    if kind in (4, 5):
        return Arithmetic("+" if kind == 4 else "-", draw(below), draw(below))
    if kind == 6:
        return Call("abs", (draw(below),))
    return Call(draw(st.sampled_from(["min", "max"])), (draw(below), draw(below)))


comparisons = st.builds(Comparison, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), linear_terms(), linear_terms())


def truth(leaf, values):
    return stl.satisfies(leaf, {name: [float(value)] for name, value in values.items()} or {"none": [0.0]})


@given(read=st.lists(comparisons, min_size=1, max_size=3, unique=True), seed=st.integers(0, 999))
@settings(max_examples=many(100))
def test_linear_comparisons_are_solved_and_no_assignment_is_missing(read, seed):
    rng = random.Random(seed)
    for group in groups(read, RANGES):
        for row in group.rows:
            values = group.pick(row, rng.randrange)
            assert [truth(leaf, values) for leaf in group.leaves] == list(row)
            assert all(kept(value) for value in values.values())
            for name, value in values.items():
                low, high = RANGES[name]
                assert low <= value
                assert high is None or value <= high
        axes = [[v for v in GRID if v >= RANGES[name][0]] for name in group.names]
        points = list(itertools.product(*axes))
        for point in rng.sample(points, min(len(points), 20)):
            values = dict(zip(group.names, point, strict=True))
            assert not group.sharp or tuple(truth(leaf, values) for leaf in group.leaves) in group.rows


def test_what_is_solved_and_what_is_sought_among_points():
    for text, rows, sharp in [
        ("x == 0.3 & x > 0.29999999999999999", 3, True),
        ("3 * x == 1", 1, True),  # no decimal is a third
        ("3 * y == x", 2, True),
        ("3 * y == x - 1", 2, True),  # x = 3y + 1: for every decimal y
        ("x + y == 0.8 & x - y > 0.1", 4, True),
        ("7 * x + 3 * y == 1", 1, False),  # some decimals solve it: -2 and 5
        ("1 > 2", 1, True),
        ("sqrt(2) > 1", 1, False),
        ("x^2 == 4 & x > 0", 4, False),
        ("x * y > 8", 2, False),
        ("1 / x > 2", 2, False),  # 1/0 has no value
    ]:
        [group] = groups(leaves(stl.parse(text)), RANGES)
        assert (len(group.rows), group.sharp) == (rows, sharp), text
        for row in group.rows:
            assert tuple(truth(leaf, group.simplest(row)) for leaf in group.leaves) == row, text


def test_points_lie_in_their_ranges_which_may_be_open():
    for text, low, high in [
        ("x^2 > 0.1", "0.3", "0.4"),
        ("x^2 > 0.1", "-0.4", "-0.3"),
        ("x^2 > 99", None, None),
        ("x^2 > 99", None, 500),
        ("x^2 > 99", -500, None),
        ("x^2 > 99", None, -3),
        ("x^2 > 99", 7, None),
    ]:
        low, high = (None if end is None else Fraction(end) for end in (low, high))
        leaf = stl.parse(text)
        [group] = groups([leaf], {"x": (low, high)})
        assert set(group.rows) == {(False,), (True,)}, text
        for row in group.rows:
            for draw in (lambda n: 0, *(random.Random(seed).randrange for seed in range(9))):
                [value] = group.pick(row, draw).values()
                assert truth(leaf, {"x": value}) == row[0]
                assert low is None or low <= value
                assert high is None or value <= high


def test_values_are_short_and_reach_the_ends():
    choices = Choices.within(Span(Fraction(2), Fraction(9), low_open=True))
    assert (choices.simplest, choices.ends) == (3, (Fraction(21, 10), 9))
    found = {choices.pick(random.Random(seed).randrange) for seed in range(300)}
    assert len(found) > 40
    assert all(2 < value <= 9 and len(str(float(value))) <= 4 for value in found)
    assert Choices.within(Span(Fraction(1, 10), Fraction(1, 10))).pick(lambda n: 0) == Fraction(1, 10)
    assert Choices.within(Span(Fraction(1, 3), Fraction(1, 3))) is None
    assert Choices.within(Span(Fraction(1), Fraction(1), low_open=True)) is None
    double = Fraction("0.1")
    assert Choices.within(Span(double, double + Fraction(1, 10**30), low_open=True)) is None  # between two doubles
    largest = Fraction(1.7976931348623157e308)
    widest = Choices.within(Span(-largest, largest))
    assert all(abs(widest.pick(random.Random(seed).randrange)) <= largest for seed in range(20))
    assert Choices.within(Span(largest, 10 * largest, low_open=True)) is None
    assert Choices.within(Span(None, Fraction(10**15))).pick(lambda n: 0) <= 10**15
