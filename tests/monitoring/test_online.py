"""Monitors that read one sample at a time against those that see the whole trace."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, StlSyntaxError, TraceError
from stltool.logic.formula import Always, Eventually, Interval, Until
from stltool.testing import formulas, traces


def decisions(result):
    """What an offline result says, step by step."""
    steps = range(result.verdicts.size)
    return [stl.Decision(*d) for d in zip(steps, result.verdicts.tolist(), result.robustness.tolist(), strict=True)]


@given(phi=formulas(), data=st.data())
def test_every_prefix_is_judged_as_the_offline_monitor_does(phi, data):
    n = stl.horizon(phi) + data.draw(st.integers(0, 5))
    trace = data.draw(traces(n))
    online, so_far = stl.OnlineMonitor(phi), []
    for t in range(n):
        so_far += online.feed({name: values[t] for name, values in trace.items()})
        prefix = {name: values[: t + 1] for name, values in trace.items()}
        if t >= stl.horizon(phi):
            assert str(so_far) == str(decisions(stl.monitor(phi, prefix)))  # 0.0 and -0.0 are told apart
        for end in ("cut", "hold"):
            assert str(so_far + online.finish(end)) == str(decisions(stl.monitor(phi, prefix, end)))


@given(a=st.integers(0, 5), width=st.integers(1, 12), seed=st.integers(0, 99))
def test_each_operator_over_any_window(a, width, seed):
    interval, rng = Interval(a, a + width - 1), np.random.default_rng(seed)
    p, q = stl.parse("x > 0"), stl.parse("F[0,3] (y > 0)")
    x, y = rng.integers(-2, 9, 40) + 0.5, rng.integers(-9, 2, 40) + 0.5
    for phi in (Eventually(interval, q), Always(interval, p), Until(interval, p, q), Until(interval, q, p)):
        online = stl.OnlineMonitor(phi)
        found = [decision for pair in zip(x, y, strict=True) for decision in online.feed({"x": pair[0], "y": pair[1]})]
        assert found == decisions(stl.monitor(phi, {"x": x, "y": y}))


def test_memory_is_bounded_by_the_horizon():
    phi = stl.parse("G[0,50] (F[2,20] (x > 0.5) & ((x < 0.9) U[3,20] (y > 0.5)) <-> y + x < 1.5)")
    online, rng = stl.OnlineMonitor(phi), np.random.default_rng(0)
    held = []
    for x, y in rng.random((2000, 2)).tolist():
        online.feed({"x": x, "y": y})
        held.append(online.stored)
    assert max(held) <= 6 * (stl.horizon(phi) + 1)
    assert max(held[:200]) == max(held)


@pytest.mark.parametrize(
    ("sample", "kind", "says"),
    [
        ({"x": 1.0, "ab": True}, NameLookupError, "sample at step 1 has no value of a; did you mean ab"),
        ({"a": True}, NameLookupError, "step 1 has no value of x; known names: a"),
        ({"x": math.nan, "a": True}, TraceError, "x is nan at step 1"),
        ({"x": -math.inf, "a": True}, TraceError, "x is -inf at step 1"),
        ({"x": 1.0, "a": 2}, TraceError, "a is 2 at step 1; it is used as a label"),
        ({"x": 1.0, "a": "1"}, TraceError, "a is '1' at step 1"),
        ({"x": "1", "a": True}, TraceError, "x is '1' at step 1; give a float"),
        ({"x": Fraction(1, 3), "a": True}, TraceError, "x is 1/3 at step 1; give a float"),
        ({"x": np.longdouble(1), "a": True}, TraceError, "x is .* at step 1; give a float"),
        ({"x": 2**53 + 1, "a": True}, TraceError, "x is 9007199254740993 at step 1: integers beyond"),
        ({"x": 0, "a": True}, TraceError, "step 1: .*no value for the operands 1, 0"),
        ({"x": -1.5e308, "a": True}, TraceError, "step 1: .*margin is beyond"),
    ],
)
def test_a_refused_sample_leaves_the_monitor_as_it_was(sample, kind, says):
    phi = stl.parse("F[0,1] (a & 1 / x > 0.25) & F[1,2] (x > 1e308)")
    good = [
        {"x": x, "a": a} for x, a in [(1, 1), (2.0, False), (np.float32(5), np.bool_(1)), (np.int8(3), 0.0), (1, 1)]
    ]
    wanted, online = stl.OnlineMonitor(phi), stl.OnlineMonitor(phi)
    for t, right in enumerate(good):
        if t == 1:
            before = online.n_steps, online.stored, online.finish()
            with pytest.raises(kind, match=says):
                online.feed(sample)
            assert (online.n_steps, online.stored, online.finish()) == before
        assert online.feed(right) == wanted.feed(right)


def test_what_an_online_monitor_refuses():
    with pytest.raises(StlSyntaxError, match="no horizon"):
        stl.OnlineMonitor(Eventually(Interval(0, None), stl.parse("a")))
    with pytest.raises(SettingsError, match="end is 'error'; choose cut or hold"):
        stl.OnlineMonitor(stl.parse("a")).finish("error")


def test_a_task_and_a_formula_that_looks_at_one_sample():
    online = stl.OnlineMonitor(stl.parse_task("low := x <= 2"))
    assert online.finish() == []
    assert online.feed({"x": 2}) == [stl.Decision(0, True, 0.0)]
    assert online.feed({"x": 2.5, "y": None}) == [(1, False, -0.5)]
    assert (online.finish("hold"), online.horizon, online.n_steps, online.stored) == ([], 0, 2, 0)
