"""Numbers in bytes, against Python's own: the nearest double, or left to Python."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from stltool.kernels import cells


def read(text, point="."):
    data = np.frombuffer(text.encode(), np.uint8)
    value, end = cells.number(data, 0, len(data), ord(point))
    return None if end < 0 else (value, text[end:])


DIGITS = st.text("0123456789", max_size=40)


@given(
    sign=st.sampled_from(["", "-", "+"]),
    before=DIGITS,
    after=st.none() | DIGITS,
    power=st.none() | st.integers(-330, 330) | st.integers(-20, 20),
)
@example("", "9007199254740993", None, None)
@example("", "0", "1", None)
@example("-", "0" * 30, "0" * 30 + "5", None)
@example("", "", "", None)
def test_a_number_is_the_nearest_double(sign, before, after, power):
    text = sign + before + ("" if after is None else f".{after}") + ("" if power is None else f"e{power}")
    found = read(text)
    if found is not None:
        assert (repr(found[0]), found[1]) == (repr(float(text)), "")
    elif (before or after) and len(before + (after or "")) <= 36:
        value = abs(float(text))
        if 1e-270 < value < 1e290 and abs((power or 0) - len(after or "")) <= 290:
            off = 2 * abs(abs(Fraction(text)) - Fraction(value))
            assert off in (math.ulp(value), math.ulp(value) / 2)  # below a power of two, a narrower gap


def test_doubles_and_their_neighbours_are_read_back():
    """Shortest decimals of doubles of every size, of powers of two and of what is next to them: none goes to Python."""
    rng = np.random.default_rng(0)
    some = rng.normal(size=300) * 10.0 ** rng.integers(-250, 250, 300)
    powers = 2.0 ** np.arange(-60, 60)
    values = [*some, *powers, *np.nextafter(powers, 0), *np.nextafter(powers, math.inf), *rng.random(300)]
    for value in map(float, values):
        assert read(repr(value)) == (value, "")


def test_halves_between_doubles_are_left_to_python():
    for n in (2**53 + 1, 2**54 + 2, 2**60 + 2**7):
        assert read(str(n)) is None
    assert read("9007199254740992.5") == (9007199254740992.0, "")


@pytest.mark.parametrize(
    ("text", "rest"),
    [("1.5,2", ",2"), ("1 ", " "), ("12e", None), ("1e+", None), ("x", None), ("-", None), ("1.2.3", ".3"),
     ("1_0", "_0"), ("nan", None), ("inf", None), ("0x10", "x10"), ("1" * 37, None), ("", None), (".", None)],
)  # fmt: skip
def test_where_a_number_ends(text, rest):
    found = read(text)
    assert (found and found[1]) == rest


def test_a_decimal_comma():
    assert read("2,5;", ",") == (2.5, ";")
    assert read("2.5", ",") == (2.0, ".5")
