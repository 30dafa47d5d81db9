"""Truth and robustness against brute force and against laws (docs/semantics.md §1)."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.logic.formula import Always, And, Eventually, Iff, Implies, Interval, Label, Not, Or, Until
from stltool.monitoring.states import truth
from stltool.testing import formulas, predicates, traces
from tests.conftest import many

A, B = Label("a"), Label("b")


@st.composite
def judged(draw, **options):
    """A formula and a trace long enough to decide it at a drawn step."""
    phi = draw(formulas(past=True, **options))
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


def past_table(phi, trace, t):
    """docs/semantics.md §1 for one operator of the past over a, b, by loops over u alone."""
    a, b = trace["a"].tolist(), trace["b"].tolist()
    kind, low, high = phi
    steps = [u for u in range(t - high, t - low + 1) if u >= 0]
    match kind:
        case "once":
            return any(a[u] for u in steps)
        case "historically":
            return all(a[u] for u in steps)
        case "since":
            return any(b[u] and all(a[u + 1 : t + 1]) for u in steps)
        case "trigger":
            return all(b[u] or any(a[u + 1 : t + 1]) for u in steps)


@pytest.mark.parametrize("kind", ["once", "historically", "since", "trigger"])
def test_operators_of_the_past_against_their_definition(kind):
    """On every trace of 4 steps over two atoms, all windows up to [2,3]."""
    single = kind in ("once", "historically")
    for low, width in itertools.product(range(3), range(2)):
        window = f"[{low},{low + width}]"
        phi = stl.parse(f"{kind}{window} a" if single else f"a {kind}{window} b")
        for bits in range(1 << (4 if single else 8)):
            trace = {
                "a": np.array([bits >> i & 1 for i in range(4)]),
                "b": np.array([bits >> i + 4 & 1 for i in range(4)]),
            }
            t = 3 - bits % 2
            expected = past_table((kind, low, low + width), trace, t)
            assert stl.satisfies(phi, trace, t) == expected
            assert stl.robustness(phi, trace, t) == (math.inf if expected else -math.inf)


@pytest.mark.parametrize(
    ("text", "a", "holds"),
    [
        ("historically[1,2] a", "0000", "1000"),
        ("once[1,2] a", "1111", "0111"),
        ("!prev a", "1111", "1000"),
        ("historically[1,1] a", "0110", "1011"),  # RTAMT's prev
        ("rise a", "1011", "1010"),
        ("rise a", "0110", "0100"),
        ("fall a", "0110", "1001"),
        ("fall a", "1001", "0100"),
        ("rise true", "0000", "1000"),
        ("once a", "0010", "0011"),
        ("once a", "1000", "1111"),
        ("historically a", "1101", "1100"),
        ("!a since a", "0100", "0111"),
    ],
)
def test_the_past_at_the_start_of_a_trace(text, a, holds):
    trace = {"a": [int(x) for x in a]}
    assert "".join(str(int(stl.satisfies(stl.parse(text), trace, t))) for t in range(4)) == holds


@pytest.mark.parametrize(("a", "b", "holds"), [("000", "011", False), ("100", "110", True), ("010", "110", True)])
def test_what_releases_does_so_after_its_step_and_for_good(a, b, holds):
    trace = {name: [int(x) for x in row] for name, row in (("a", a), ("b", b))}
    assert stl.satisfies(stl.parse("a release[0,2] b"), trace) is holds


@pytest.mark.parametrize(("a", "b", "holds"), [("010", "011", True), ("100", "011", False), ("001", "000", False)])
def test_what_triggers_does_so_after_its_step(a, b, holds):
    trace = {name: [int(x) for x in row] for name, row in (("a", a), ("b", b))}
    assert stl.satisfies(stl.parse("a trigger[0,2] b"), trace, 2) is holds


def test_a_window_that_began_before_the_trace_stays_empty_whatever_follows():
    phi = stl.parse("once[2,3] F[0,4] a")
    trace = {"a": np.ones(9)}
    assert [stl.satisfies(phi, trace, t) for t in range(5)] == [False, False, True, True, True]


def test_since_does_not_ask_the_left_side_at_its_witness():
    phi = stl.parse("a since[0,3] b")
    assert stl.satisfies(phi, {"a": [1, 0, 1, 1], "b": [0, 1, 0, 0]}, 3)  # false exactly at u
    assert not stl.satisfies(phi, {"a": [1, 1, 1, 0], "b": [0, 1, 0, 0]}, 3)  # false exactly at t
    assert stl.satisfies(phi, {"a": [1, 1, 1, 0], "b": [0, 1, 0, 1]}, 3)  # b at t


@pytest.mark.parametrize(
    ("text", "ahead", "back"),
    [
        ("a", 0, 0), ("prev a", 0, 1), ("rise a", 0, 1), ("once[2,5] a", 0, 5), ("once a", 0, None),
        ("once[2,5] F[0,4] a", 2, 5), ("F[3,6] once[1,5] a", 6, 2), ("F[3,6] once a", 6, None),
        ("(prev a) since[1,4] b", 0, 4), ("(once[0,3] a) since[1,4] b", 0, 6), ("a since[0,0] once[0,2] b", 0, 2),
        ("(F[0,3] a) since[2,4] F[0,4] b", 3, 4), ("a U[2,3] prev b", 3, 0), ("(prev a) release[0,3] b", 3, 1),
        ("(prev a) & once[0,2] b -> G[0,4] a", 4, 2), ("historically[1,2] prev a", 0, 3), ("a trigger b", 0, None),
    ],
)  # fmt: skip
def test_horizon_and_lookback(text, ahead, back):
    phi = stl.parse(text)
    assert (stl.horizon(phi), stl.lookback(phi)) == (ahead, back)


@given(phi=formulas(max_leaves=5, past=True), data=st.data())
def test_nothing_outside_lookback_and_horizon_matters(phi, data):
    ahead, back = stl.horizon(phi), stl.lookback(phi)
    t = data.draw(st.integers(0, 6))
    one, other = data.draw(traces(t + ahead + 3)), data.draw(traces(t + ahead + 3))
    if back is None:
        return
    inside = slice(max(0, t - back), t + ahead + 1)
    mixed = {name: np.array(values) for name, values in other.items()}
    for name in mixed:
        mixed[name][inside] = one[name][inside]
    assert stl.satisfies(phi, mixed, t) == stl.satisfies(phi, one, t)
    assert stl.robustness(phi, mixed, t) == stl.robustness(phi, one, t)


@settings(max_examples=many(100))
@given(phi=formulas(max_leaves=2, past=True), psi=formulas(max_leaves=2, past=True), data=st.data())
def test_operators_of_the_past_have_their_laws(phi, psi, data):
    """docs/semantics.md §1, cuts at step 0 included."""
    a, width, t = (data.draw(st.integers(0, 2)) for _ in range(3))
    window = f"[{a},{a + width}]"
    trace = data.draw(traces(t + stl.horizon(And((phi, psi))) + 5))

    def same(left, right):
        left, right = (stl.parse(text.replace("P", f"({phi})").replace("Q", f"({psi})")) for text in (left, right))
        assert stl.satisfies(left, trace, t) == stl.satisfies(right, trace, t)
        assert stl.robustness(left, trace, t) == stl.robustness(right, trace, t)

    same(f"historically{window} P", f"!once{window} !P")
    same(f"P trigger{window} Q", f"!(!P since{window} !Q)")
    same(f"P release{window} Q", f"!(!P U{window} !Q)")
    same(f"once{window} P", f"true since{window} P")
    same("rise P", "P & !prev P")
    same("fall P", "!P & !prev !P")
    same(f"once{window} P", f"once[{a},{a}] once[0,{width}] P")
    if a:
        same(f"P since{window} Q", f"(historically[0,{a - 1}] P) & (once[{a},{a}] (P since[0,{width}] Q))")
    same("P since Q", "Q | (P & prev (P since Q))")


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
