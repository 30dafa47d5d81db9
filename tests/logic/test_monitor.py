"""Monitors against the slow semantics, step by step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, StlSyntaxError, TraceError
from stltool.logic.formula import Always, Eventually, Interval, Until, children, with_children
from stltool.testing import formulas, traces
from tests.oracles import judged_to_the_end


@st.composite
def batches(draw, n_steps):
    """Some traces of one length: name → (n_traces, n_steps)."""
    rows = draw(st.lists(traces(n_steps), min_size=1, max_size=3))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def close(value, wanted):
    return value == wanted or abs(value - wanted) <= 1e-12 * max(1.0, abs(wanted))


@given(phi=formulas(), data=st.data())
def test_every_decided_step_is_judged_as_the_slow_semantics_does(phi, data):
    n = stl.horizon(phi) + data.draw(st.integers(1, 4))
    batch = data.draw(batches(n))
    result = stl.monitor(phi, batch)
    for row, (verdicts, margins) in enumerate(zip(result.verdicts, result.robustness, strict=True)):
        trace = {name: values[row] for name, values in batch.items()}
        steps = range(n - stl.horizon(phi))
        assert verdicts.tolist() == [stl.satisfies(phi, trace, t) for t in steps]
        assert all(close(m, stl.robustness(phi, trace, t)) for t, m in zip(steps, margins, strict=True))


@st.composite
def perhaps_endless(draw):
    """A formula, some of whose intervals have no end."""

    def change(phi):
        phi = with_children(phi, tuple(change(child) for child in children(phi)))
        if isinstance(phi, Eventually | Always | Until) and draw(st.booleans()):
            return type(phi)(Interval(phi.interval.a, None), *children(phi))
        return phi

    return change(draw(formulas(max_leaves=5)))


@given(phi=perhaps_endless(), end=st.sampled_from(["cut", "hold"]), n=st.integers(1, 5), data=st.data())
def test_windows_cut_or_held_at_the_end(phi, end, n, data):
    batch = data.draw(batches(n))
    result = stl.monitor(phi, batch, end)
    for row, (verdicts, margins) in enumerate(zip(result.verdicts, result.robustness, strict=True)):
        trace = {name: values[row] for name, values in batch.items()}
        wanted = [judged_to_the_end(phi, trace, end, t) for t in range(n)]
        assert verdicts.tolist() == [true for true, _ in wanted]
        assert all(close(m, w) for m, (_, w) in zip(margins, wanted, strict=True))


def test_a_term_without_value_names_trace_step_place_and_operands():
    phi = stl.parse("G[0,1] (x > 0 -> 1 / x > 0.1)")
    batch = {"x": [[1.0, 2.0, 3.0], [1.0, 0.0, 3.0]]}
    with pytest.raises(TraceError, match=r"trace 1, step 1: .*line 1, column 18: this has no value .* 1, 0"):
        stl.monitor(phi, batch)
    assert stl.monitor(phi, batch, semantics="boolean").verdicts.all()  # guarded
    with pytest.raises(TraceError, match="step 1: .* 1, 0"):
        stl.monitor(stl.parse("F[0,1] (1 / x > 0.9)"), {"x": [0.5, 0.0, 3.0]}, semantics="boolean")


def test_the_first_violation():
    phi = stl.parse("F[0,1] a")
    assert stl.monitor(phi, {"a": [1, 0, 0, 1]}).first_violation == 1
    assert stl.monitor(phi, {"a": [1, 0, 1]}).first_violation is None
    assert stl.monitor(phi, {"a": [[1, 0, 0, 1], [1, 0, 1, 0]]}).first_violation.tolist() == [1, -1]
    with pytest.raises(SettingsError, match="there are no verdicts"):
        _ = stl.monitor(phi, {"a": [1, 0]}, semantics="robustness").first_violation


@pytest.mark.parametrize(
    ("text", "signals", "kind", "says"),
    [
        ("F[0,4] a", {"a": [0, 1, 0]}, TraceError, '3 samples; this formula needs 5 .*end="cut"'),
        ("x > y", {"x": [1.0], "y": [1.0, 2.0]}, TraceError, r"x has shape \(1,\), signal y \(2,\)"),
        ("x > 0", {"x": [[1.0], [1.0, 2.0]]}, TraceError, "x have unequal lengths"),
        ("x > 0", {"x": [[1.0, 2.0], [1.0, np.nan]]}, TraceError, "x is nan at trace 1, step 1"),
        ("x > 0", {"x": [1.0, -np.inf]}, TraceError, "x is -inf at step 1"),
        ("a", {"a": [0, 2]}, TraceError, "a is 2 at step 1: .* as in a > 0"),
        ("x > 0", {"x": [2**53 + 1]}, TraceError, "x is 9007199254740993 at step 0: whole numbers beyond"),
        ("x > 0", {"x": ["one"]}, TraceError, "not numbers"),
        ("x > 0", {"x": [[[1.0]]]}, TraceError, r"\(n_traces, n_steps\)"),
        ("sped > 0", {"speed": [1.0]}, NameLookupError, r"line 1, column 1: .* no signal sped; did you mean speed\?"),
        ("true", {}, TraceError, "no signal to take the number of steps from"),
    ],
)
def test_traces_that_cannot_be_judged(text, signals, kind, says):
    with pytest.raises(kind, match=says):
        stl.monitor(stl.parse(text), signals)


def test_options_that_do_not_exist():
    with pytest.raises(SettingsError, match="there is no end 'stop'; choose error, cut, hold"):
        stl.monitor(stl.parse("a"), {"a": [1]}, end="stop")
    with pytest.raises(SettingsError, match="there is no semantics 'truth'; choose both, boolean, robustness"):
        stl.monitor(stl.parse("a"), {"a": [1]}, semantics="truth")
    with pytest.raises(StlSyntaxError, match="only monitors judge it, with end cut or hold"):
        stl.monitor(Eventually(Interval(0, None), stl.parse("a")), {"a": [1]})
    with pytest.raises(StlSyntaxError, match=r"call stltool\.parse on the text first"):
        stl.monitor("a", {"a": [1]})
