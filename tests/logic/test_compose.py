"""Formulas put together in Python are those that the text language writes."""

import math
import time
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, SettingsError, StlSyntaxError, StlToolError
from stltool.logic.formula import Always, And, Eventually, Implies, Interval, Not, Or, Until
from stltool.testing import formulas

A, B, C = map(stl.parse, "ABC")
x, y = stl.signal("x"), stl.signal("y")
INTERVALS = st.tuples(st.integers(0, 5), st.integers(0, 5)).map(sorted)


@given(phi=formulas(), psi=formulas(), bounds=INTERVALS)
def test_what_operators_make_parses_back(phi, psi, bounds):
    for composed in (
        phi & psi, phi | psi, ~phi, phi >> psi, stl.F(phi, *bounds), stl.G(phi, *bounds), stl.U(phi, psi, *bounds),
    ):  # fmt: skip
        assert stl.parse(str(composed)) == composed
        assert hash(stl.parse(str(composed))) == hash(composed)


@given(phi=formulas(), psi=formulas(), chi=formulas(), bounds=INTERVALS)
def test_operators_make_the_nodes_of_the_text(phi, psi, chi, bounds):
    a, b = bounds
    assert stl.F(phi, a, b) == Eventually(Interval(a, b), phi)
    assert stl.G(phi, a, b) == Always(Interval(a, b), phi)
    assert stl.U(phi, psi, a, b) == Until(Interval(a, b), phi, psi)
    assert ~phi == Not(phi)
    assert phi >> psi == Implies(phi, psi)
    assert (phi & psi) & chi == phi & (psi & chi)
    assert (phi | psi) | chi == phi | (psi | chi)


@given(phi=formulas(max_leaves=4, past=True), psi=formulas(max_leaves=4, past=True), bounds=INTERVALS)
def test_what_looks_back_is_composed_as_the_text_reads(phi, psi, bounds):
    a, b = bounds
    for composed, text in (
        (stl.once(phi, a, b), f"once[{a},{b}] (p)"), (stl.historically(phi, a, b), f"historically[{a},{b}] (p)"),
        (stl.since(phi, psi, a, b), f"(p) since[{a},{b}] (q)"), (stl.once(phi), "once (p)"),
        (stl.trigger(phi, psi, a, b), f"(p) trigger[{a},{b}] (q)"), (stl.since(phi, psi, a), f"(p) since[{a},inf] (q)"),
        (stl.release(phi, psi, a, b), f"(p) release[{a},{b}] (q)"), (stl.prev(phi), "prev (p)"),
        (stl.weak_until(phi, psi, a, b), f"(p) weak_until[{a},{b}] (q)"), (stl.rise(phi), "rise (p)"),
        (stl.fall(phi), "fall (p)"),
    ):  # fmt: skip
        meant = stl.parse(text.replace("(q)", f"({psi})").replace("(p)", f"({phi})"))
        assert composed == meant
        assert stl.parse(str(composed)) == composed


def test_conjunctions_lie_in_one_level_like_those_of_a_text():
    assert A & B & C == stl.parse("A & B & C") == And((A, B, C))
    assert A | B | C == stl.parse("A | B | C") == Or((A, B, C))
    assert stl.parse("A & B | C") == A & B | C
    assert stl.parse("(A -> B) & !C") == (A >> B) & ~C


def test_a_task_stands_for_its_formula():
    task = stl.parse_task("param T = 3\nreach := F[0,T] A")
    assert task & B == task.formula & B == stl.parse("(F[0,3] A) & B")
    assert B | task == stl.parse("B | (F[0,3] A)")
    assert ~task == Not(task.formula)
    assert task >> task == Implies(task.formula, task.formula)
    assert stl.G(task, 0, 2) == stl.parse("G[0,2] F[0,3] A")
    assert stl.horizon(task) == 3
    assert stl.simplify(~~task.formula) == task.formula


@pytest.mark.parametrize(
    ("composed", "text"),
    [
        (x > 0.4, "x > 0.4"),
        (0.4 > x, "x < 0.4"),  # noqa: SIM300 - the number on the left
        (x >= y, "x >= y"),
        (x == 0.5, "x == 0.5"),
        (x != y, "x != y"),
        (-x + 2 * y**2 / 3 - 0.1 <= abs(y), "-x + 2 * y^2 / 3 - 0.1 <= abs(y)"),
        (1 - x < 2 / y, "1 - x < 2 / y"),
        (2**x > +y, "2^x > y"),
        (x > -0.4, "x > -0.4"),
        (x > Fraction(1, 3), "x > 1 / 3"),
        (x > Fraction(-1, 10), "x > -0.1"),
        (x > Decimal("0.1"), "x > 0.1"),
        (x > np.float32(0.1), "x > 0.1"),
        (np.float64(0.4) < x, "x > 0.4"),
        (np.int8(3) * x > 0, "3 * x > 0"),
        (x > 0.1 + 0.2, "x > 0.30000000000000004"),
        (x > 1e300, "x > 1e+300"),
        (x > -0.0, "x > 0"),
    ],
    ids=str,
)
def test_comparisons_of_signals(composed, text):
    assert str(composed) == text
    assert stl.parse(text) == composed


@given(value=st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53) | st.fractions())
def test_a_number_means_what_it_prints(value):
    try:
        phi = x > value
    except SettingsError:
        assert isinstance(value, Fraction)
        assert max(abs(value.numerator), value.denominator) > 10**15
        return
    assert stl.parse(str(phi)) == phi
    exact = Fraction(repr(value)) if isinstance(value, float) else Fraction(value)
    assert stl.parse(f"y == {phi}".partition(" == ")[2]) == phi
    low, high = math.nextafter(float(exact), -math.inf), math.nextafter(float(exact), math.inf)
    assert not math.isfinite(low) or not stl.satisfies(phi, {"x": [low]})
    assert not math.isfinite(high) or stl.satisfies(phi, {"x": [high]})


def test_expressions_at_other_steps():
    x, y = stl.signal("x"), stl.signal("y")
    for composed, text in [
        (x.at(1) - x > 0, "x[t+1] - x[t] > 0"),
        ((x + y.at(-2)).at(1) >= 2 * x, "x[t+1] + y[t-1] >= 2 * x"),
        (abs(x.at(3)) < 1, "abs(x[t+3]) < 1"),
        (x.at(2).at(-2) == y, "x == y"),
    ]:
        assert composed == stl.parse(text)
    assert str(x.at(2)) == "x[t+2]"


@pytest.mark.parametrize(
    ("slip", "says"),
    [
        (lambda: A and B, "write phi & psi"),
        (lambda: A or B, "phi | psi"),
        (lambda: not A, "~phi"),
        (lambda: stl.parse_task("t := A") and B, "write phi & psi"),
        (lambda: 0.2 < x < 0.6, r"\(0.2 < x\) & \(x < 0.6\) for 0.2 < x < 0.6"),
        (lambda: x == y == 0.5, "has no truth value by itself"),
        (lambda: x in [y], "has no truth value by itself"),
        (lambda: bool(x), "x is a number at every step, not true or false; compare it, as in x > 0.5"),
        (lambda: A & x > 0.4, r"an operand of & is an Expression, not a Formula; put the comparison in parentheses"),
        (lambda: x > 0.4 & A, r"an operand of & is 0.4, not a Formula; put the comparison in parentheses"),
        (lambda: x > 0.4 | x, "put the comparison in parentheses"),
        (lambda: ~x, "is an Expression, not a Formula"),
        (lambda: A > 0.4, r"A is Boolean and cannot be compared; for a signal, write stl.signal\('x'\) > 0.5"),
        (lambda: A <= B, "cannot be compared"),
        (lambda: A & "B", r"an operand of & is 'B', not a Formula; parse it: stl.parse\(text\)"),
        (lambda: "A" >> B, "parse it"),
        (lambda: A & (B == C), "is False, not a Formula; == and != between formulas give True or False"),
        (lambda: np.bool_(True) | A, "is True, not a Formula; == and !="),
        (lambda: np.array([True]) & A, r"an array of shape \(1,\), not a Formula"),
        (lambda: A | None, "is None, not a Formula"),
        (lambda: x > "0.4", "'0.4', which is neither a number nor a signal"),
        (lambda: x > True, "True, which is neither a number nor a signal"),
        (lambda: x + A, "a Formula, which is neither a number nor a signal"),
        (lambda: x > math.nan, "an operand of > is nan; a finite number is needed"),
        (lambda: x > 2**53 + 1, "9007199254740993 cannot be written exactly"),
        (
            lambda: x > Decimal("0.30000000000000000001"),
            "cannot be written exactly; the nearest number that can is 0.3",
        ),
        (lambda: stl.F(A, 3, 1), r"\[3,1\] is empty"),
        (lambda: stl.F(A, 0, 1.5), "F's last step b is 1.5; it must be an integer from 0"),
        (lambda: stl.U(A, B, -1, 1), "U's first step a is -1"),
        (lambda: stl.G(A, 0, 10**16), "from 0 up to 1000000000000000"),
        (lambda: stl.G(x, 0, 1), r"G's formula is an Expression, not a Formula; compare it: stl.signal\('x'\) > 0.5"),
        (lambda: stl.U(A, 3, 0, 1), "U's second formula is 3, not a Formula"),
        (lambda: x.at(1.5), "at's steps is 1.5; it must be an integer"),
        (lambda: stl.label(""), "'' cannot be the name of a label"),
        (lambda: stl.label("a\nb"), "cannot be the name of a label or signal, which is neither empty nor longer"),
        (lambda: stl.signal("a\rb"), "use another name"),
        (lambda: stl.signal(3), "signal's name is 3, not text; write it in quotes"),
    ],
)
def test_slips_are_refused_with_a_sentence(slip, says):
    with pytest.raises((StlToolError, TypeError), match=says):
        slip()


def test_an_interval_without_end_is_for_monitors():
    phi = stl.G(x < 0.9, 0, None)
    assert stl.parse(str(phi), unbounded=True) == phi
    with pytest.raises(StlSyntaxError, match="only monitors of whole traces judge it"):
        stl.horizon(phi)
    assert stl.monitor(phi, {"x": [0.5, 0.95, 0.5]}, end="cut").verdicts.tolist() == [False, False, True]


def test_formulas_without_end_in_depth_or_size_are_refused():
    nested = A
    for _ in range(199):
        nested = ~nested
    assert stl.parse(str(nested)) == nested
    with pytest.raises(StlSyntaxError, match=r"nested too deeply \(over 200 levels\)"):
        _ = ~nested
    doubled = A
    for _ in range(14):
        doubled = doubled >> doubled
    with pytest.raises(StlSyntaxError, match="more than 50000 operators"):
        _ = doubled >> doubled


def test_thousands_of_parts_are_put_together_in_no_time():
    start, phi = time.process_time(), A
    for t in range(5000):
        phi = phi & stl.F(B, t, t)
    assert time.process_time() - start < 2  # 0.1 s on an idle core; quadratic, 5 s
    assert len(phi.args) == 5001
    assert stl.horizon(phi) == 4999


def test_expressions_show_themselves():
    assert repr(2 * x + 1) == "Expression('2 * x + 1')"
    assert str(2 * x + 1) == "2 * x + 1"
    with pytest.raises(TypeError, match="unhashable"):
        hash(x)
    assert issubclass(ArgumentError, TypeError)
