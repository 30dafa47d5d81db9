"""`order` against random runs: what it proves of two formulas holds on all of them."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.formula import FUTURE, Comparison, Interval, Number, children, with_children
from stltool.logic.implied import EQUAL, UNKNOWN, Order, order
from stltool.testing import formulas
from tests.conftest import many

STEPS = 24


@st.composite
def changed(draw, phi):
    """The formula with other windows and numbers."""
    if isinstance(phi, Comparison):
        right = Number(draw(st.sampled_from((0.0, 0.5, 1.0, 2.0)))) if isinstance(phi.right, Number) else phi.right
        return Comparison(phi.op, phi.left, right)
    phi = with_children(phi, tuple(draw(changed(child)) for child in children(phi))) if children(phi) else phi
    if getattr(phi, "interval", None) is not None and phi.interval.b is not None:
        a = draw(st.integers(0, 2))
        fields = {name: getattr(phi, name) for name in ("arg", "left", "right") if hasattr(phi, name)}
        return type(phi)(interval=Interval(a, a + draw(st.integers(0, 2))), **fields)
    return phi


@given(st.data(), formulas(longest=2, max_leaves=4, horizon=6), st.integers(0, 2**32 - 1))
@settings(max_examples=many(300))
def test_what_is_proved_holds_on_random_runs(data, one, seed):
    other = data.draw(changed(one))
    found = order(one, other)
    assert order(other, one) == found.reverse
    assert order(one, one) == EQUAL
    assume(found != UNKNOWN)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        trace = {name: rng.choice([0.0, 0.5, 1.0, 2.0], STEPS) for name in stl.testing.names.SIGNALS}
        trace |= {name: rng.random(STEPS) < rng.random() for name in stl.testing.names.LABELS}
        first, second = (stl.satisfies(phi, trace) for phi in (one, other))
        assert not found.up or second or not first
        assert not found.down or first or not second


@pytest.mark.parametrize(
    ("text", "weaker"),
    [
        ("F[0,{}] A", 1), ("G[0,{}] A", -1), ("!F[0,{}] A", -1), ("F[0,{}] A -> B", -1), ("B -> F[0,{}] A", 1),
        ("F[0,{}] A <-> B", 0), ("F[{},9] A", -1), ("G[{},9] A", 1), ("A U[0,{}] B", 1), ("A U[{},9] B", -1),
        ("A release[0,{}] B", -1), ("once[0,{}] A", 1), ("historically[0,{}] A", -1), ("A since[0,{}] B", 1),
        ("A trigger[0,{}] B", -1), ("F[{0},{0}] A", 0), ("rise(F[0,{}] A)", 0), ("G[0,{0}] F[0,{0}] A", 0),
        ("x > {}", -1), ("x < {}", 1), ("{} < x", -1), ("2*x - {} >= 1", -1), ("-x < y - {}", -1), ("x == {}", 0),
        ("-2*(x - {}) > 0", 1), ("(x - {}) * -2 > y", 1), ("(x - {}) / 2 > y", -1), ("(x - {}) / y > 1", 0),
        ("min(x, {}) > y", 1),
        ("abs(x - {}) < 1", 0), ("x/2 <= max({}, y)", 1), ("x*y > {}", -1),
    ],
)  # fmt: skip
def test_directions_of_every_operator(text, weaker):
    """What is larger by one makes it weaker (1), stronger (−1), or neither is proved."""
    one, other = (stl.parse(text.format(n)) for n in (3, 4))
    assert order(one, other) == Order(weaker == 1, weaker == -1)
    assert order(other, one) == Order(weaker == -1, weaker == 1)


def test_windows_of_the_future_are_all_tried():
    assert {kind.__name__ for kind in FUTURE} == {"Eventually", "Always", "Until", "Release"}
