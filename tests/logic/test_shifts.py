"""Comparisons that read other steps: x[t+k], x[t-k], against reading those samples directly."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import StlSyntaxError
from stltool.logic.formula import Comparison, Eventually, Interval, Number, Once, Variable
from stltool.logic.rewrite import negation_normal_form, simplify
from stltool.logic.shifts import delayed

# texts, the samples that each reads after t, and its margin given their values
READS = [
    ("x[t+1] > 1", [("x", 1)], lambda a: a - 1),
    ("x[t-2] > 1", [("x", -2)], lambda a: a - 1),
    ("x[t+1] - x[t] > 0", [("x", 1), ("x", 0)], lambda a, b: a - b),
    ("x[t] - x[t-1] >= y", [("x", 0), ("x", -1), ("y", 0)], lambda a, b, c: a - b - c),
    ("x[t+2] > y[t-1]", [("x", 2), ("y", -1)], lambda a, b: a - b),
    ("x[t-1] + y[t-3] <= 2", [("x", -1), ("y", -3)], lambda a, b: 2 - a - b),
    ("max(x, x[t-1], x[1+t]) < 2", [("x", 0), ("x", -1), ("x", 1)], lambda *a: 2 - max(a)),
]
values = st.integers(-2, 3)


def direct(read, n, held, trace, t):
    """The margin of a comparison at step t; −inf where a sample does not exist."""
    _, places, margin = read
    steps = [min(t + shift, n - 1) if held else t + shift for _, shift in places]
    if any(step < 0 or step >= n for step in steps):
        return -math.inf
    return float(margin(*(trace[name][step] for (name, _), step in zip(places, steps, strict=True))))


@st.composite
def traces(draw):
    n = draw(st.integers(6, 9))
    return {name: draw(st.lists(values, min_size=n, max_size=n)) for name in "xy"}


@given(read=st.sampled_from(READS), trace=traces(), end=st.sampled_from(["error", "cut", "hold"]))
def test_monitors_read_the_samples_of_other_steps(read, trace, end):
    n = len(trace["x"])
    phi = stl.parse(read[0])
    for psi, sign, fold in (
        (phi, 1, None), (~phi, -1, None), (stl.G(phi, 0, 2), 1, min), (stl.F(~phi, 1, 2), -1, max),
    ):  # fmt: skip
        found = stl.monitor(psi, trace, end)
        assert (found.formula, found.n_steps) == (psi, n)
        window = [(0, 1)] if fold is None else [(0, 3)] if fold is min else [(1, 3)]
        for t in range(len(found.verdicts)):
            steps = [t + j for j in range(*window[0])]
            margins = [sign * direct(read, n, end == "hold", trace, u) for u in steps if u < n or end == "hold"]
            expected = (fold or (lambda m: m[0]))(margins) if margins else (math.inf if fold is min else -math.inf)
            assert found.robustness[t] == expected
            if expected not in (0, 0.0):
                assert found.verdicts[t] == (expected > 0)
            if end == "error":
                assert stl.satisfies(psi, trace, t) == found.verdicts[t]
                assert stl.robustness(psi, trace, t) == expected


@given(read=st.sampled_from(READS), trace=traces(), end=st.sampled_from(["error", "cut", "hold"]))
def test_running_monitors_decide_the_same(read, trace, end):
    phi = stl.parse(read[0])
    for psi in (phi, ~phi, stl.F(~phi, 1, 2)):
        online = stl.OnlineMonitor(psi, wait=True)
        decisions = []
        for x, y in zip(trace["x"], trace["y"], strict=True):
            with pytest.raises(stl.errors.StlToolError):
                online.feed({})
            decisions += online.feed({"x": x, "y": y})
        decisions += online.finish(end) if end != "error" else []
        found = stl.monitor(psi, trace, end)
        assert [decision.step for decision in decisions] == list(range(len(found.verdicts)))
        assert [decision.verdict for decision in decisions] == found.verdicts.tolist()
        assert [decision.robustness for decision in decisions] == found.robustness.tolist()
        early = stl.OnlineMonitor(psi)
        verdicts = dict(decision[:2] for decision in early.feed(trace))
        verdicts.update(decision[:2] for decision in early.finish(end if end != "error" else "cut"))
        decided = len(stl.monitor(psi, trace).verdicts) if len(trace["x"]) > online.horizon else 0
        assert [verdicts[t] for t in range(decided)] == found.verdicts[:decided].tolist()


@given(read=st.sampled_from(READS), trace=traces(), data=st.data())
def test_rewriting_keeps_truth_and_robustness_from_step_0_on(read, trace, data):
    phi = stl.parse(read[0])
    other = stl.parse(data.draw(st.sampled_from(READS))[0])
    psi = data.draw(st.sampled_from([
        ~phi, ~stl.F(phi | ~other, 0, 1), ~(phi >> other), ~stl.U(phi, other, 0, 2), (phi & ~phi) | other,
    ]))  # fmt: skip
    for rewritten in (negation_normal_form(psi), simplify(psi), stl.parse(str(psi)), stl.parse(str(simplify(psi)))):
        for t in range(len(trace["x"]) - stl.horizon(psi)):
            assert stl.satisfies(rewritten, trace, t) == stl.satisfies(psi, trace, t)
            assert stl.robustness(rewritten, trace, t) == stl.robustness(psi, trace, t)


def test_the_normal_form_reads_its_latest_sample_now():
    x, y = Variable("x"), Variable("y")
    one = Interval(1, 1)
    assert stl.parse("x[t-1] > 3") == Once(one, Comparison(">", x, Number(3.0))) == stl.parse("prev (x > 3)")
    assert stl.parse("x[t+1] > y") == Eventually(one, Comparison(">", x, Variable("y", 1)))
    assert stl.parse("x[t-1] > y[t-2]") == Once(one, Comparison(">", x, Variable("y", 1)))
    assert str(stl.parse("x[t+3] > y[t+1]")) == "F[3,3] (x > y[t-2])"
    assert [stl.horizon(stl.parse(text)) for text in ("x[t+3] > y", "x[t-3] > y", "G[0,4] x[t+1] > y[t-1]")] == [
        3,
        0,
        5,
    ]
    assert [stl.lookback(stl.parse(text)) for text in ("x[t+3] > y", "x[t-3] > y", "G[2,4] x[t-3] > y")] == [0, 3, 1]
    assert y == Variable("y", 0)


@given(read=st.sampled_from(READS), trace=traces(), end=st.sampled_from(["cut", "hold"]), data=st.data())
def test_causes_are_samples_of_the_signals_themselves(read, trace, end, data):
    """With them fixed, other samples may change freely: those of a second trace."""
    phi = stl.G(stl.parse(read[0]), 0, 1)
    n = len(trace["x"])
    t = data.draw(st.integers(0, n - 1))
    why = stl.diagnose(phi, trace, t, end=end)
    assert (why.formula, why.verdict) == (phi, stl.monitor(phi, trace, end).verdicts[t])
    assert set(why.causes) <= {"x", "y"}
    other = {name: data.draw(st.lists(values, min_size=n, max_size=n)) for name in "xy"}
    for name, step, value in why.samples:
        assert trace[name][step] == value
        other[name][step] = trace[name][step]
    assert stl.monitor(phi, other, end).verdicts[t] == why.verdict


def test_shifts_are_steps_or_times():
    same = stl.parse("x[t+3] > y")
    for text, given_ in [
        ("x[t+0.3s] > y", {"step": "0.1s"}), ("x[t+0.3] > y", {"step": "0.1s", "unit": "s"}),
        ("x[t+3 steps] > y", {"step": "0.1s"}), ("x[t+k] > y", {"params": {"k": 3}}), ("x[t+2+1] > y", {}),
        ("x[1+t+2] > y", {}), ("x[t-(1-4)] > y", {}),
    ]:  # fmt: skip
        assert stl.parse(text, **given_) == same
    task = stl.parse_task("step = 0.5s\nunit = s\nparam dt = 1\nslope := (x[t+dt] - x[t]) / dt\nr := slope > 2")
    assert task.formula == stl.parse("(x[t+2] - x) / 1 > 2")
    assert task.definitions["slope"] != stl.parse_task("d := (x - x[t]) / 1\nr := a").definitions["d"]
    for text, says in [
        ("x[3] > 0", r"write x\[t\], x\[t\+1\] or x\[t-1\]"), ("x[2*t] > 0", "a sample is read at the step t"),
        ("x[2-t] > 0", "a sample is read at the step t"), ("x[t+0.5] > 0", "not an integer number of steps"),
        ("x[t+1s] > 0", "no step is declared"), ("x[t+k] > 0", "k is not a param"), ("a[t+1]", "found a number"),
    ]:  # fmt: skip
        with pytest.raises(StlSyntaxError, match=says):
            stl.parse(text)
    with pytest.raises(StlSyntaxError, match=r"2 could be 2s \(2 steps\) or 2 steps"):
        stl.parse("x[t+2] > y", step="1s")


def test_layout_and_text_keep_shifts():
    assert stl.format_task('r:=x[t+2 * k]-x[ t ]>0 & "a b"[t-1 step]<1') == (
        'r := x[t + 2 * k] - x[t] > 0 & "a b"[t - 1 step] < 1\n'
    )
    for text in ("x - x[t-1] > 0", '"a b"[t-2] > x', "prev (x > y[t-1])"):
        assert str(stl.parse(text)) == text


def test_what_is_made_has_names_of_its_own():
    phi = stl.parse('x - x[t-1] > "x[t-1]" & "step >= 1"')
    made = delayed(phi, once=True)
    assert made.signals == {"x[t-1]'": ("x", 1)}
    assert made.starts == {"step >= 1'": 1}
    assert delayed(stl.parse("G[0,3] a")).formula == stl.parse("G[0,3] a")
    trace = {"x": [1.0, 5.0, 6.0], "x[t-1]": [3.0, 3.0, 3.0], "step >= 1": [1, 1, 1]}
    assert stl.monitor(phi, trace).verdicts.tolist() == [False, True, False]
    assert str(made.formula) == """("step >= 1'" & x - "x[t-1]'" > "x[t-1]") & "step >= 1\""""


def test_faults_of_signals_are_told_by_their_own_names():
    with pytest.raises(stl.errors.NameLookupError, match="have no signal x; known names: z"):
        stl.monitor(stl.parse("x[t+1] > x"), {"z": np.zeros(4)})
    with pytest.raises(stl.errors.TraceError, match="unequal lengths"):
        stl.monitor(stl.parse("x[t+1] > x"), {"x": [[1, 2], [3]]})
    with pytest.raises(stl.errors.TraceError, match=r"x\[t-1\] is nan at step 2|x is nan at step 1"):
        stl.monitor(stl.parse("y[t+1] > x"), {"x": [0, math.nan, 0, 1.0], "y": np.zeros(4)})
    with pytest.raises(stl.errors.TraceError, match=r"no value for the operands 1, 0"):
        stl.monitor(stl.parse("G[0,1] 1 / x[t-1] > x"), {"x": [1.0, 0.0, 2.0, 3.0]})
    batch = stl.monitor(stl.parse("x[t+1] > x"), {"x": [[1, 2, 3], [3, 2, 4]]}, "hold")
    assert batch.verdicts.tolist() == [[True, True, False], [False, True, False]]
