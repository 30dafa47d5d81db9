"""Truth and robustness against brute force and against laws (docs/semantics.md §1)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.logic.formula import Always, And, Eventually, Iff, Implies, Interval, Label, Not, Or, Until
from stltool.monitoring.states import truth
from stltool.testing import formulas, predicates, traces

A, B = Label("a"), Label("b")


@st.composite
def judged(draw, **options):
    """A formula and a trace long enough to decide it at a drawn step."""
    phi = draw(formulas(**options))
    t = draw(st.integers(0, 2))
    return phi, draw(traces(t + stl.horizon(phi) + 1)), t


@given(judged())
def test_robustness_agrees_with_truth(case):
    phi, trace, t = case
    margin, true = stl.robustness(phi, trace, t), stl.satisfies(phi, trace, t)
    assert margin >= 0 if true else margin <= 0
    assert margin <= 0 or true


@given(judged())
def test_negation_and_duality(case):
    phi, trace, t = case
    assert stl.satisfies(Not(phi), trace, t) is not stl.satisfies(phi, trace, t)
    assert stl.robustness(Not(phi), trace, t) == -stl.robustness(phi, trace, t)


@given(phi=formulas(max_leaves=4), psi=formulas(max_leaves=4), data=st.data())
def test_operators_have_their_textbook_laws(phi, psi, data):
    window = Interval(1, 3)
    trace = data.draw(traces(stl.horizon(And((phi, psi))) + 4))

    def same(left, right):
        assert stl.satisfies(left, trace) == stl.satisfies(right, trace)
        assert stl.robustness(left, trace) == stl.robustness(right, trace)

    same(Eventually(window, phi), Not(Always(window, Not(phi))))
    same(Implies(phi, psi), Or((Not(phi), psi)))
    same(Iff(phi, psi), And((Implies(phi, psi), Implies(psi, phi))))
    same(Not(And((phi, psi))), Or((Not(phi), Not(psi))))
    same(Eventually(window, Or((phi, psi))), Or((Eventually(window, phi), Eventually(window, psi))))
    same(Until(window, stl.parse("true"), psi), Eventually(window, psi))


@given(data=st.data(), a=st.integers(0, 3), width=st.integers(0, 3))
def test_temporal_operators_against_their_definition(data, a, width):
    b = a + width
    trace = data.draw(traces(b + 1))
    holds_a, holds_b = trace["a"].tolist(), trace["b"].tolist()
    assert stl.satisfies(Eventually(Interval(a, b), A), trace) == any(holds_a[a : b + 1])
    assert stl.satisfies(Always(Interval(a, b), A), trace) == all(holds_a[a : b + 1])
    expected = False
    for u in range(a, b + 1):
        expected = expected or (holds_b[u] and all(holds_a[:u]))
    assert stl.satisfies(Until(Interval(a, b), A, B), trace) == expected


@given(psi=predicates(), data=st.data())
def test_predicates_over_arrays_agree_with_the_slow_semantics(psi, data):
    n = data.draw(st.integers(1, 5))
    trace = data.draw(traces(n))
    signals = {name: trace[name] for name in ("x", "y")}
    labels = {name: trace[name] for name in ("a", "b", "c")}
    fast = truth(psi, signals, labels, n)
    assert fast.tolist() == [stl.satisfies(psi, trace, t) for t in range(n)]


def test_strictness_is_exact():
    trace = {"x": np.array([0.0])}
    assert [stl.satisfies(stl.parse(f"x {op} 0"), trace) for op in ("<", "<=", ">", ">=", "==", "!=")] == [
        False, True, False, True, True, False,
    ]  # fmt: skip
    assert stl.robustness(stl.parse("x == 3"), trace) == -3
    assert stl.robustness(stl.parse("x != 3"), trace) == 3
    assert stl.robustness(stl.parse("F[0,0] a"), {"a": [True]}) == math.inf


def test_a_trace_too_short_names_both_lengths():
    with pytest.raises(TraceError, match="has 3 samples; this formula at step 1 needs 6"):
        stl.satisfies(stl.parse("F[0,4] a"), {"a": [0, 0, 0]}, t=1)
    with pytest.raises(TraceError, match="the trace has 2 samples"):
        stl.satisfies(stl.parse("F[0,4] true"), {"a": [0, 0]})
    with pytest.raises(SettingsError, match="step t is -1; it must be an integer from 0"):
        stl.satisfies(A, {"a": [0]}, t=-1)


@pytest.mark.parametrize(
    ("text", "signal", "says"),
    [
        ("x > 0", {"x": [math.nan]}, "x is NaN at step 0"),
        ("x > 0", {"x": [[1.0]]}, "one-dimensional"),
        ("x > 0", {"x": ["one"]}, "not numbers"),
        ("a", {"a": [0.5]}, "compare it, as in a > 0"),
        ("1 / x > 0", {"x": [0.0]}, "no value for the operands 1, 0"),
        ("sqrt(x) > 0", {"x": [-1.0]}, "no value"),
        ("x ^ 0.5 > 0", {"x": [-1.0]}, "no value"),
    ],
)
def test_samples_that_cannot_be_judged(text, signal, says):
    with pytest.raises(TraceError, match=says):
        stl.satisfies(stl.parse(text), signal)


def test_a_missing_signal_names_near_misses():
    with pytest.raises(NameLookupError, match=r"line 1, column 1: the trace has no signal sped; did you mean speed\?"):
        stl.robustness(stl.parse("sped > 3"), {"speed": [1.0]})


def test_a_term_without_value_in_some_state_is_an_error():
    x = {"x": np.array([1.0, 0.0])}
    with pytest.raises(TraceError, match="no value for the operands 1, 0"):
        truth(stl.parse("1 / x > 0"), x, {}, 2)
    assert truth(stl.parse("x > 0 & 1 / x > 0"), x, {}, 2).tolist() == [True, False]  # guarded
    with pytest.raises(ValueError, match="temporal"):
        truth(stl.parse("F[0,1] a"), {}, {"a": np.array([True])}, 1)


def test_borders_are_decided_as_written():
    """0.1 + 0.2 is 0.3, whatever doubles make of it."""
    for text in ("x + y == 0.3", "x + 0.2 >= 0.3", "y - x <= 0.1", "3 * x == 0.3", "x / y == 0.5", "x^2 == 0.01"):
        assert stl.satisfies(stl.parse(text), {"x": [0.1], "y": [0.2]}), text
        signals = {"x": np.array([0.1, 0.5]), "y": np.array([0.2, 0.5])}
        assert truth(stl.parse(text), signals, {}, 2)[0], text
    assert stl.robustness(stl.parse("x + y > 0.3"), {"x": [0.1], "y": [0.2]}) == 0.0
    assert stl.satisfies(stl.parse("x^0.5 > 1.4 & x^1000 > 2"), {"x": [2.0]})
    with pytest.raises(TraceError, match="no value"):
        stl.satisfies(stl.parse("x^5000 > 2"), {"x": [2.0]})


def test_what_overflows_has_no_value():
    """Only rounded powers leave the exact numbers; beyond the doubles they are no infinities in disguise."""
    for text, x in (("x^-0.77 / x < 0", 1e-301), ("x^0.77 * x > 1", 1e300)):
        with pytest.raises(TraceError, match="this term has no value for the operands"):
            stl.satisfies(stl.parse(text), {"x": [x]})
    phi = stl.parse("y < -(y + sqrt(x))")
    assert not stl.satisfies(phi, {"x": [0.0], "y": [1e308]})
    with pytest.raises(TraceError, match="the margin is beyond the range of doubles"):
        stl.robustness(phi, {"x": [0.0], "y": [1e308]})
    assert stl.robustness(stl.parse("x > 0"), {"x": [float("inf")]}) == float("inf")
