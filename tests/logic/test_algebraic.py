"""Numbers with roots: against the field Q(√2, √3), where equality is equality of coefficients, and against decimals."""

import math
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import TraceError
from stltool.logic import algebraic
from stltool.logic.algebraic import Algebraic, TooCloseError, power, root

F = Fraction
fractions = st.fractions(-4, 4, max_denominator=9)


class Field:
    """a + b√2 + c√3 + d√6: the slow twin."""

    def __init__(self, *parts):
        self.parts = tuple(map(F, parts))

    def __add__(self, other):
        return Field(*(x + y for x, y in zip(self.parts, other.parts, strict=True)))

    def __mul__(self, other):
        (a, b, c, d), (e, f, g, h) = self.parts, other.parts
        return Field(
            a * e + 2 * b * f + 3 * c * g + 6 * d * h,
            a * f + b * e + 3 * (c * h + d * g),
            a * g + c * e + 2 * (b * h + d * f),
            a * h + d * e + b * g + c * f,
        )

    def sign(self):
        if not any(self.parts):
            return 0
        with localcontext() as context:
            context.prec = 200
            value = sum(
                Decimal(part.numerator) / Decimal(part.denominator) * Decimal(n).sqrt()
                for part, n in zip(self.parts, (1, 2, 3, 6), strict=True)
            )
            return 1 if value > 0 else -1


@st.composite
def pairs(draw, depth=3):
    """The same number as an expression with roots and in the field."""
    kind = draw(st.sampled_from(["leaf", "+", "*", "-"])) if depth else "leaf"
    if kind == "leaf":
        part, n = draw(fractions), draw(st.sampled_from([0, 1, 2, 3]))
        field = Field(*(part if i == n else 0 for i in range(4)))
        return part * root(F((1, 2, 3, 6)[n])), field
    (a, x), (b, y) = draw(pairs(depth - 1)), draw(pairs(depth - 1))
    if kind == "+":
        return a + b, x + y
    if kind == "*":
        return a * b, x * y
    return a - b, x + Field(-1, 0, 0, 0) * y


def sign(value):
    return (value > 0) - (value < 0)


@given(pairs())
def test_signs_are_those_of_the_field(pair):
    value, field = pair
    assert sign(value) == field.sign()
    assert (value == 0) == (field.sign() == 0)


@given(pairs(), pairs(depth=2))
def test_order_is_that_of_differences_and_quotients_invert_products(pair, other):
    (value, field), (divisor, its) = pair, other
    assert sign(value - divisor) == (field + Field(-1, 0, 0, 0) * its).sign()
    assert (value < divisor) == (divisor > value)
    assert (value <= divisor) == (divisor >= value)
    assert (value == divisor) != (value != divisor)
    if its.sign():
        assert value / divisor * divisor == value
        assert power(divisor, F(-2)) * divisor * divisor == 1
    else:
        with pytest.raises(ZeroDivisionError):
            value / divisor


@given(pairs(depth=2))
def test_squares_have_the_absolute_value_as_their_root(pair):
    value, _ = pair
    assert root(value * value) == abs(value)
    assert power(power(value, F(3)), F(1)) == value * value * value


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (root(3 + 2 * root(F(2))), 1 + root(F(2))),
        (root(5 + 2 * root(F(6))), root(F(2)) + root(F(3))),
        (power(7 + 5 * root(F(2)), F(1, 3)), 1 + root(F(2))),  # Cardano's
        (power(F(2), F(1, 2)) * power(F(2), F(1, 3)), power(F(2), F(5, 6))),
        (power(F(8, 27), F(-2, 3)), F(9, 4)),
        (power(root(F(2)), F(0)), F(1)),
        (root(root(F(81, 16))), F(3, 2)),
        (power(power(F(2), F(1, 12)), F(12)), F(2)),  # the largest root
    ],
)
def test_identities(left, right):
    assert left == right
    assert not left < right
    assert not left > right
    tiny = F(1, 10**60)
    assert left < right + tiny
    assert left > right - tiny


@given(st.fractions(0, 10**6, max_denominator=10**6), st.integers(2, 12))
def test_roots_of_fractions_are_rational_where_they_can_be(value, index):
    assert root(value**index, index) == value
    assert isinstance(root(value**index, index), Fraction)
    assert power(root(value, index), F(index)) == value


@given(st.fractions(0, 10**9, max_denominator=10**9))
def test_the_nearest_double_of_a_root(value):
    found = float(root(value))
    below, above = (F(math.nextafter(found, to)) for to in (-1.0, math.inf))
    assert ((F(found) + below) / 2) ** 2 <= value or found == 0
    assert ((F(found) + above) / 2) ** 2 >= value


def test_signs_where_what_is_enclosed_is_wide():
    """p² − 2q² = ±1: no fraction with as small a denominator is nearer to √2, and q times its enclosure is as wide."""
    p, q = 1, 1
    for _ in range(120):
        side = 1 if p * p < 2 * q * q else -1
        for exponent in (1, 2, 3):  # of a number that has not been enclosed more closely before
            assert sign(power(q * root(F(2)) - p, F(exponent))) == side**exponent
            assert power(q * (root(F(2)) * root(F(3)) - root(F(6))), F(exponent)) == 0
        p, q = p + 2 * q, p + q


def test_a_double_half_way_goes_to_the_even_one():
    half = root(F(2)) * root(F(2)) / 2 + F(1, 2**53)  # 1 + 2⁻⁵³, as an expression with roots
    assert isinstance(half, Algebraic)
    assert float(half) == 1.0
    assert float(half + F(1, 2**53)) == math.nextafter(1, 2)
    odd = half + F(1, 2**52)  # half-way between the next two, of which the larger is even
    for near, below, above in ((half, 1.0, math.nextafter(1, 2)), (odd, math.nextafter(1, 2), 1 + 2.0**-51)):
        assert (float(near - F(1, 2**2000)), float(near + F(1, 2**2000))) == (below, above)
    assert float(root(F(2)) * root(F(2)) - 2) == 0.0
    with pytest.raises(OverflowError):
        float(root(F(2)) * 10**400)


def test_doubles_and_infinities_beside_roots():
    two = root(F(2))
    assert two + math.inf == math.inf
    assert math.inf - two == math.inf
    assert two < math.inf
    assert two > -math.inf
    assert two * -math.inf == -math.inf
    assert two / math.inf == 0.0
    assert 1.0 / two == 1 / math.sqrt(2)
    assert two + 0.5 == math.sqrt(2) + 0.5
    assert two != math.sqrt(2)
    assert two * 0.5 == math.sqrt(2) / 2
    assert repr(two) == "Algebraic(1.4142135623730951)"


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: root(F(-1)), ValueError),
        (lambda: power(F(-8), F(1, 3)), ValueError),
        (lambda: power(F(0), F(-1, 2)), ZeroDivisionError),
        (lambda: power(-root(F(2)), F(1, 2)), ValueError),
        (lambda: power(F(-8), F(1, 13)), ValueError),
        (lambda: power(F(0), F(-1, 13)), ValueError),
    ],
)
def test_what_has_no_value(make, error):
    with pytest.raises(error):
        make()


def test_what_cannot_be_decided_is_told(monkeypatch):
    monkeypatch.setattr(algebraic, "MOST_BITS", 96)
    left = sum((root(F(n)) for n in (2, 3, 5, 7, 11)), F(0))
    right = sum((root(F(n)) for n in (11, 7, 5, 3, 2)), F(0))
    with pytest.raises(TooCloseError, match="agree to 96 bits"):
        left == right  # noqa: B015
    text = "sqrt(a) + sqrt(b) + sqrt(c) <= sqrt(c) + sqrt(b) + sqrt(a)"
    with pytest.raises(TraceError, match="fewer roots") as told:
        stl.satisfies(stl.parse(text), {"a": [2.3], "b": [3.7], "c": [5.9]})
    assert text in str(told.value)


def test_the_sides_of_right_triangles():
    """(3s, 4s, 5s) in two and more decimals: the root's nearest double got 39 % of these wrong."""
    scale = np.arange(1, 400, 9)
    for places in (2, 3, 5):
        trace = {name: np.round(k * scale / 10.0**places, places) for name, k in zip("xyz", (3, 4, 5), strict=True)}
        for text, true in (
            ("sqrt(x^2 + y^2) <= z", True), ("sqrt(x^2 + y^2) < z", False), ("sqrt(x^2 + y^2) == z", True),
            ("z >= (x^2 + y^2)^0.5", True), ("sqrt(x*x + y*y) - z != 0", False),
        ):  # fmt: skip
            phi = stl.parse(text)
            assert {stl.satisfies(phi, trace, t) for t in range(len(scale))} == {true}, text
            assert {stl.robustness(phi, trace, t) for t in range(len(scale))} == {0.0}, text
