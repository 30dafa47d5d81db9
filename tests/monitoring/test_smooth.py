"""Soft robustness against sums of exponentials written out, and its enclosure against the exact one."""

import functools
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, SettingsError, SizeError, TraceError
from stltool.logic.formula import (
    Always,
    And,
    Eventually,
    Historically,
    Iff,
    Implies,
    Interval,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Until,
    is_bounded,
)
from stltool.testing import formulas, traces
from tests.monitoring.test_monitor import batches, perhaps_endless

BETAS = st.sampled_from([0.01, 1.0, 7.5, 50.0, 1e6])


@given(phi=formulas(past=True), beta=BETAS, data=st.data())
def test_the_exact_robustness_is_enclosed(phi, beta, data):
    n = stl.horizon(phi) + data.draw(st.integers(1, 3))
    trace = data.draw(traces(n))
    soft = stl.smooth_robustness(phi, trace, beta)
    for t in range(n - stl.horizon(phi)):
        assert soft.lower[t] <= stl.robustness(phi, trace, t) <= soft.upper[t]
        assert soft.lower[t] <= soft.values[t] <= soft.upper[t]


@given(phi=perhaps_endless(), beta=BETAS, end=st.sampled_from(["cut", "hold"]), data=st.data())
def test_and_at_the_end_of_the_trace(phi, beta, end, data):
    batch = data.draw(batches(data.draw(st.integers(1, 5))))
    if end == "hold" and not is_bounded(phi):
        with pytest.raises(SettingsError, match="no value"):
            stl.smooth_robustness(phi, batch, beta, end)
        return
    soft, exact = stl.smooth_robustness(phi, batch, beta, end), stl.monitor(phi, batch, end).robustness
    assert (soft.lower <= exact).all()
    assert (exact <= soft.upper).all()


def smax(values, beta):
    high = max(values)
    if math.isinf(high):
        return high
    return high + math.log(math.fsum(math.exp(beta * (v - high)) for v in values)) / beta


def smin(values, beta):
    return -smax([-v for v in values], beta)


def soft(phi, trace, t, beta):
    """The definitions, step by step."""

    def value(psi, u=t):
        return soft(psi, trace, u, beta)

    def earlier(interval):
        return range(0 if interval.b is None else max(t - interval.b, 0), t - interval.a + 1)

    def pair(u, width):
        if width == 1:
            return value(phi.left, u), value(phi.right, u)
        return joined(pair(u, width // 2), pair(u + width // 2, width // 2))

    def joined(x, y):
        return smin([x[0], y[0]], beta), smax([x[1], smin([x[0], y[1]], beta)], beta)

    match phi:
        case Not(arg):
            return -value(arg)
        case And(args):
            return smin([value(arg) for arg in args], beta)
        case Or(args):
            return smax([value(arg) for arg in args], beta)
        case Implies(left, right):
            return smax([-value(left), value(right)], beta)
        case Iff(left, right):
            return smin([value(Implies(left, right)), value(Implies(right, left))], beta)
        case Eventually(interval, arg):
            return smax([value(arg, u) for u in range(t + interval.a, t + interval.b + 1)], beta)
        case Always(interval, arg):
            return smin([value(arg, u) for u in range(t + interval.a, t + interval.b + 1)], beta)
        case Release(interval, left, right):
            return -value(Until(interval, Not(left), Not(right)))
        case Once(interval, arg):
            return smax([value(arg, u) for u in earlier(interval)], beta)
        case Historically(interval, arg):
            return smin([value(arg, u) for u in earlier(interval)], beta)
        case Rise(arg):
            return smin([value(arg), -value(Once(Interval(1, 1), arg))], beta)
        case Until(interval, left, _):
            parts, u = [], t + interval.a
            for k in range(len(interval).bit_length()):
                if len(interval) >> k & 1:
                    parts.append(pair(u, 1 << k))
                    u += 1 << k
            witness = functools.reduce(joined, parts)[1]
            before = [smin([value(left, v) for v in range(t, t + interval.a)], beta)] if interval.a else []
            return smin([*before, witness], beta)
        case _:
            return stl.robustness(phi, trace, t)


@given(phi=formulas(longest=6, max_leaves=5), beta=BETAS, data=st.data())
def test_values_are_the_definitions(phi, beta, data):
    n = data.draw(st.integers(1, 3))
    trace = data.draw(traces(n + stl.horizon(phi)))
    values = stl.smooth_robustness(phi, trace, beta).values
    assert values == pytest.approx([soft(phi, trace, t, beta) for t in range(n)], rel=1e-9, abs=1e-9)
    short = {name: samples[:n] for name, samples in trace.items()}
    held = {name: np.append(samples, [samples[-1]] * stl.horizon(phi)) for name, samples in short.items()}
    values = stl.smooth_robustness(phi, short, beta, "hold").values
    assert values == pytest.approx([soft(phi, held, t, beta) for t in range(n)], rel=1e-9, abs=1e-9)


@given(a=st.integers(0, 5), width=st.integers(1, 12), beta=BETAS, seed=st.integers(0, 99))
def test_each_operator_over_any_window(a, width, beta, seed):
    interval, rng = Interval(a, a + width - 1), np.random.default_rng(seed)
    p, q = stl.parse("x > 0"), stl.parse("y > 0")
    n = interval.last + 4
    trace = {"x": rng.integers(-2, 9, n) / 4, "y": rng.integers(-9, 2, n) / 4}
    for phi in (Eventually(interval, q), Always(interval, p), Until(interval, p, q), Until(interval, q, p)):
        found = stl.smooth_robustness(phi, trace, beta)
        assert found.values == pytest.approx([soft(phi, trace, t, beta) for t in range(4)], rel=1e-9, abs=1e-9)
        exact = stl.monitor(phi, trace).robustness
        assert (found.lower <= exact).all()
        assert (exact <= found.upper).all()
        cut, exact = stl.smooth_robustness(phi, trace, beta, "cut"), stl.monitor(phi, trace, "cut").robustness
        assert np.array_equal(cut.values[:4], found.values)
        assert (cut.lower <= exact).all()
        assert (exact <= cut.upper).all()


@pytest.mark.parametrize(
    ("text", "over", "under"),
    [
        ("F[0,6] (x > 0)", 7, 1),
        ("G[2,6] (x > 0)", 1, 5),
        ("F[0,2] F[1,4] (x > 0)", 12, 1),
        ("G[0,4] (F[0,6] (x > 0) & F[0,2] (x > 1))", 7, 10),
        ("!(x > 0 & x > 1 & x > 2 & x > 3)", 4, 1),
        ("(x > 0) U[2,2] (x > 1)", 1, 3),
    ],
)
def test_how_wide_enclosures_are(text, over, under):
    """log(n)/beta for every extremum, n its operands; nested ones of a kind are one."""
    x = np.linspace(-1, 1, 40)
    soft = stl.smooth_robustness(stl.parse(text), {"x": x}, beta=10.0)
    assert soft.values - soft.lower == pytest.approx(np.log(over) / 10, rel=1e-5, abs=1e-12)
    assert soft.upper - soft.values == pytest.approx(np.log(under) / 10, rel=1e-5, abs=1e-12)


def test_cut_windows_are_less_wide():
    soft = stl.smooth_robustness(stl.parse("F[0,3] (x > 0)"), {"x": np.zeros(6)}, 10.0, "cut")
    assert soft.values == pytest.approx(np.log([4, 4, 4, 3, 2, 1]) / 10)
    assert soft.values - soft.lower == pytest.approx(np.log([4, 4, 4, 3, 2, 1]) / 10, rel=1e-5, abs=1e-12)
    empty = stl.smooth_robustness(Eventually(Interval(3, None), stl.parse("x > 0")), {"x": [1.0, 2.0]}, 10.0, "cut")
    assert [empty.values.tolist(), empty.lower.tolist(), empty.upper.tolist()] == [[-np.inf, -np.inf]] * 3


def test_rounding_is_covered():
    """Where soft and exact extrema agree but for rounding."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=300) * 10.0 ** rng.integers(-9, 9, size=300)
    for text in ("F[0,9] (x + x / 3 > 1e8)", "G[0,9] F[0,2] (x * x - x < 0.1)", "(x < 3) U[1,9] (0.1 * x > 1e-3)"):
        phi = stl.parse(text)
        soft = stl.smooth_robustness(phi, {"x": x}, beta=1e99)
        exact = [stl.robustness(phi, {"x": x}, t) for t in range(len(x) - stl.horizon(phi))]
        assert (soft.lower <= exact).all()
        assert (exact <= soft.upper).all()
        assert (soft.upper - soft.lower <= 1e-11 * np.abs(x).max() ** 2).all()


def test_since_at_once_waits_for_its_right_operand_only():
    trace = {name: np.arange(9) % k < 2 for name, k in (("a", 3), ("b", 4))}
    for text in ("(F[0,5] a) since[0,0] b", "(F[0,2] a) since[0,1] b", "(F[0,2] a) since[1,3] b"):
        for end in ("error", "cut", "hold"):
            found = stl.smooth_robustness(stl.parse(text), trace, 1.0, end)
            assert found.values.tolist() == stl.monitor(stl.parse(text), trace, end).robustness.tolist()


def test_no_steps():
    for end in ("cut", "hold"):
        assert stl.smooth_robustness(stl.parse("F[0,1] (x > 0)"), {"x": [[], []]}, 1.0, end).upper.shape == (2, 0)


def test_what_smooth_robustness_refuses():
    phi = stl.parse("F[0,1] (1 / x > 0)")
    for beta in (0, -1.0, math.inf, math.nan, 1e101):
        with pytest.raises(SettingsError, match=re.escape(f"beta is {float(beta)};")):
            stl.smooth_robustness(phi, {"x": [1.0, 2.0]}, beta)
    with pytest.raises(TraceError, match="step 1: .* 1, 0"):
        stl.smooth_robustness(phi, {"x": [1.0, 0.0]}, 1.0)
    with pytest.raises(TraceError, match="1 samples; this formula needs 2"):
        stl.smooth_robustness(phi, {"x": [1.0]}, 1.0)
    with pytest.raises(TraceError, match="^step 1: "):
        stl.smooth_robustness(phi, {"x": [1.0, 0.0]}, 1.0, "hold")
    with pytest.raises(SizeError, match=f"1 traces held for {10**12} steps"):
        stl.smooth_robustness(Eventually(Interval(0, 10**12), phi.arg), {"x": [1.0]}, 1.0, "hold")


@pytest.mark.parametrize("beta", ["a", None, True, float("nan"), 0, -1.0])
def test_beta_is_a_positive_number(beta):
    with pytest.raises(SettingsError, match="beta is"):
        stl.smooth_robustness(stl.parse("x > 0"), {"x": [1.0]}, beta)


@pytest.mark.parametrize("signals", [[1, 2], None, np.zeros(3)])
def test_signals_are_a_mapping(signals):
    with pytest.raises(ArgumentError, match="not a mapping; write, for example, {"):
        stl.smooth_robustness(stl.parse("x > 0"), signals, 1.0)
    with pytest.raises(ArgumentError, match="not a mapping; write, for example, {"):
        stl.monitor(stl.parse("x > 0"), signals)


@given(a=st.integers(0, 4), width=st.integers(1, 9), beta=BETAS, seed=st.integers(0, 99))
def test_the_past_is_the_future_of_the_reversed_trace(a, width, beta, seed):
    rng = np.random.default_rng(seed)
    trace = {name: rng.integers(-6, 7, 14) / 4 for name in "xy"}
    mirrored = {name: values[::-1] for name, values in trace.items()}
    p, q = stl.parse("x > 0"), stl.parse("y > 0")
    for interval in (Interval(a, a + width - 1), Interval(a, None)):
        for ahead, back in (
            (Eventually(interval, p), Once(interval, p)),
            (Always(interval, p), Historically(interval, p)),
            (Until(interval, p, q), Since(interval, p, q)),
        ):
            found, wanted = (
                stl.smooth_robustness(back, trace, beta),
                stl.smooth_robustness(ahead, mirrored, beta, "cut"),
            )
            assert np.array_equal(found.values, wanted.values[::-1])
            # bounds also hold what rounding can do, which depends on the order of the operations
            assert np.allclose(found.lower, wanted.lower[::-1], rtol=0, atol=1e-9)
            assert np.allclose(found.upper, wanted.upper[::-1], rtol=0, atol=1e-9)
