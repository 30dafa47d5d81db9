"""Monitors against the slow semantics, step by step."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

import stltool as stl
from stltool.errors import ArgumentError, NameLookupError, SettingsError, StlSyntaxError, TraceError
from stltool.logic.formula import (
    FUTURE,
    PAST,
    Always,
    And,
    Comparison,
    Eventually,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Number,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    Variable,
    children,
    with_children,
)
from stltool.monitoring.blocks import Block, Machine
from stltool.monitoring.program import compile_formula
from stltool.testing import formulas, traces
from tests.conftest import many
from tests.oracles import extremum, judged_to_the_end

ENDS = st.sampled_from(["cut", "hold"])


@st.composite
def batches(draw, n_steps):
    """Some traces of one length: name → (n_traces, n_steps)."""
    rows = draw(st.lists(traces(n_steps), min_size=1, max_size=3))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


SMALL = formulas(max_leaves=5, past=True)


@st.composite
def perhaps_endless(draw):
    """A formula, some of whose intervals have no end."""

    def change(phi):
        phi = with_children(phi, tuple(change(child) for child in children(phi)))
        if isinstance(phi, (*FUTURE, *PAST)) and not isinstance(phi, Rise) and draw(st.booleans()):
            return type(phi)(Interval(phi.interval.a, None), *children(phi))
        return phi

    return change(draw(SMALL))


def close(value, wanted):
    """Equal but for the rounding of margins."""
    return value == wanted or abs(value - wanted) <= 1e-12 * max(1.0, abs(wanted))


def in_blocks(samples):
    """As if the cache held so few samples."""
    return mock.patch.multiple("stltool.monitoring.offline", _MARGINS=samples, _TRUTH=samples)


SIZES = st.sampled_from([1, 3, 8, 1000])


@given(phi=formulas(past=True), data=st.data(), size=SIZES)
def test_every_decided_step_is_judged_as_the_slow_semantics_does(phi, data, size):
    n = stl.horizon(phi) + data.draw(st.integers(1, 4))
    batch = data.draw(batches(n))
    with in_blocks(size):
        result = stl.monitor(phi, batch)
    for row, (verdicts, margins) in enumerate(zip(result.verdicts, result.robustness, strict=True)):
        trace = {name: values[row] for name, values in batch.items()}
        steps = range(n - stl.horizon(phi))
        assert verdicts.tolist() == [stl.satisfies(phi, trace, t) for t in steps]
        assert all(close(m, stl.robustness(phi, trace, t)) for t, m in zip(steps, margins, strict=True))


@given(phi=perhaps_endless(), end=ENDS, n=st.integers(1, 6), data=st.data(), size=SIZES)
def test_windows_cut_or_held_at_the_end(phi, end, n, data, size):
    batch = data.draw(batches(n))
    with in_blocks(size):
        result = stl.monitor(phi, batch, end)
    for row, (verdicts, margins) in enumerate(zip(result.verdicts, result.robustness, strict=True)):
        trace = {name: values[row] for name, values in batch.items()}
        wanted = judged_to_the_end(phi, trace, end, range(n))
        assert verdicts.tolist() == [true for true, _ in wanted]
        assert all(close(m, w) for m, (_, w) in zip(margins, wanted, strict=True))


@given(phi=formulas(past=True), end=st.sampled_from(["error", "cut", "hold"]), data=st.data())
def test_semantics_and_shapes(phi, end, data):
    """One semantics alone, a trace alone and arrays of any layout say what a batch with both says; signs agree."""
    n = stl.horizon(phi) + data.draw(st.integers(1, 3))
    batch = data.draw(batches(n))
    both = stl.monitor(phi, batch, end)
    truth, margins = stl.monitor(phi, batch, end, "boolean"), stl.monitor(phi, batch, end, "robustness")
    assert (truth.robustness, margins.verdicts) == (None, None)
    assert np.array_equal(truth.verdicts, both.verdicts)
    assert np.array_equal(margins.robustness, both.robustness)
    assert (both.verdicts[both.robustness > 0]).all()
    assert not both.verdicts[both.robustness < 0].any()
    assert (both.end, both.n_steps, both.horizon) == (end, n, stl.horizon(phi))
    alone = stl.monitor(phi, {name: values[-1] for name, values in batch.items()}, end)
    other = stl.monitor(phi, {name: np.repeat(values, 2, axis=1).T[::2].T for name, values in batch.items()}, end)
    for array in ("verdicts", "robustness"):
        assert np.array_equal(getattr(alone, array), getattr(both, array)[-1])
        assert np.array_equal(getattr(other, array), getattr(both, array))


@settings(max_examples=many(150))
@given(a=st.integers(0, 5), width=st.integers(1, 12), n=st.integers(1, 25), seed=st.integers(0, 99), size=SIZES)
def test_each_operator_over_any_window(a, width, n, seed, size):
    interval, rng = Interval(a, a + width - 1), np.random.default_rng(seed)
    p, q = stl.parse("x > 0"), stl.parse("y > 0")
    values = {p: rng.integers(-2, 9, n) + 0.5, q: rng.integers(-9, 2, n) + 0.5}
    kinds = (Eventually, Always, Once, Historically), (Until, Release, Since, Trigger)
    some = [kind(interval, one) for kind, one in zip(kinds[0], (q, p, q, p), strict=True)]
    for phi in [*some, *(kind(interval, *both) for kind in kinds[1] for both in ((p, q), (q, p)))]:
        for end, steps in (("error", range(n - stl.horizon(phi))), ("cut", range(n)), ("hold", range(n))):
            if not steps:
                continue
            with in_blocks(size):
                result = stl.monitor(phi, {"x": values[p], "y": values[q]}, end)
            wanted = extremum(phi, lambda psi, t: values[psi][t], n, "hold" if end == "hold" else "cut", steps)
            assert result.robustness.tolist() == wanted
            assert np.array_equal(result.verdicts, result.robustness > 0)


def guarded_formulas():
    """Formulas over predicates that have no value everywhere."""
    texts = ["1 / x > 0.6", "sqrt(y) <= 1", "x > 0", "y >= 0", "1 / (x - y) != 1"]
    atoms = st.sampled_from([stl.parse(text) for text in texts])
    window = st.sampled_from([Interval(0, 1), Interval(1, 2), Interval(2, 2), Interval(0, 0)])
    return st.recursive(
        atoms,
        lambda below: st.one_of(
            below.map(Not),
            st.tuples(below, below).map(And),
            st.tuples(below, below).map(Or),
            st.builds(Implies, below, below),
            st.builds(Iff, below, below),
            st.builds(Eventually, window, below),
            st.builds(Always, window, below),
            st.builds(Until, window, below, below),
            st.builds(Release, window, below, below),
            st.builds(Once, window, below),
            st.builds(Historically, window, below),
            st.builds(Since, window, below, below),
            below.map(Rise),
        ),
        max_leaves=6,
    )


def test_a_held_sample_without_value_is_named():
    """The window looks back to it from steps after the end."""
    with pytest.raises(TraceError, match=r"^step 2: formula, line 1, column 18: this term has no value"):
        stl.monitor(stl.parse("F[0,1] once[1,2] 1 / x > 2"), {"x": [1, 1, 0]}, "hold")


@given(phi=guarded_formulas(), end=st.sampled_from(["error", "cut", "hold"]), data=st.data(), size=SIZES)
def test_terms_without_value(phi, end, data, size):
    """A verdict is refused only where it hangs on such a term, robustness wherever it meets one."""
    n = stl.horizon(phi) + data.draw(st.integers(1, 3))
    trace = data.draw(traces(n))
    steps = range(n - stl.horizon(phi)) if end == "error" else range(n)
    wanted = judged_to_the_end(phi, trace, "hold" if end == "hold" else "cut", steps)
    for semantics, values in zip(("boolean", "robustness"), zip(*wanted, strict=True), strict=True):
        with in_blocks(size):
            if None in values:
                with pytest.raises(TraceError, match=r"^step \d+: formula, line 1, column 1: this term has no value"):
                    stl.monitor(phi, trace, end, semantics)
            else:
                result = stl.monitor(phi, trace, end, semantics)
                found = result.verdicts if semantics == "boolean" else result.robustness
                assert all(map(close, found, values))


def test_a_term_without_value_names_trace_step_place_and_operands():
    phi = stl.parse("G[0,1] (x > 0 -> 1 / x > 0.1)")
    batch = {"x": [[1.0, 2.0, 3.0], [1.0, 0.0, 3.0]]}
    with pytest.raises(TraceError, match=r"^trace 1, step 1: formula, line 1, column 18: this term has no .*1, 0"):
        stl.monitor(phi, batch)
    assert stl.monitor(phi, batch, semantics="boolean").verdicts.all()  # guarded
    text = "(y > 0 | 1 / x > 0) & (F[1,3] G[0,1] (y < 9 & 1 / y > 0) | 1 / x > 0)"
    x, y, ones = [0.0, 1, 1, 1, 1, 1, 1], np.array([1.0, 2, 9, 2, 0, 2, 2]), [1.0] * 7
    for signals, semantics, step, column in (
        ({"x": x, "y": y}, "boolean", 4, text.index("1 / y")),  # 1 / x is guarded by y > 0 at step 0
        ({"x": ones, "y": y}, "robustness", 4, text.index("1 / y")),
        ({"x": x, "y": y + 9}, "boolean", 0, text.rindex("1 / x")),
        ({"x": x, "y": y}, "robustness", 0, text.index("1 / x")),
    ):
        with pytest.raises(TraceError, match=rf"^step {step}: formula, line 1, column {column + 1}: .* 1, 0"):
            stl.monitor(stl.parse(text), signals, semantics=semantics)
    until = stl.parse("(1 / x > 0) U[2,5] (1 / y > 0)")
    with pytest.raises(TraceError, match=r"^step 3: formula, line 1, column 21: "):
        stl.monitor(until, {"x": ones[:4], "y": [0.0, 0, 1, 0]}, "hold")
    with pytest.raises(TraceError, match=r"^step 1: formula, line 1, column 2: "):
        stl.monitor(until, {"x": [1.0, 0, 1, 1], "y": ones[:4]}, "cut")


@pytest.mark.parametrize(
    "text", ["!once[2,2] (sqrt(y) <= 1)", "once[2,2] (sqrt(y) <= 1) | x > 0", "!(sqrt(x) > y[t-2])"]
)
def test_samples_before_the_trace_need_no_value(text):
    """At the first two steps, there is none two steps before."""
    phi, trace = stl.parse(text), {"y": [-2.0, -4.0], "x": [1.0, 2.0]}
    wanted = [stl.robustness(phi, trace, t) for t in range(2)]
    for size in (1, 1000):
        with in_blocks(size):
            found = stl.monitor(phi, trace)
            assert found.robustness.tolist() == wanted
            assert found.verdicts.tolist() == [margin > 0 for margin in wanted]
    with pytest.raises(TraceError, match=r"^step 0: .* for the operands -2"):
        stl.monitor(stl.parse("once[2,2] (sqrt(y) <= 1)"), {"y": [-2.0, 0.0, 0.0]})


NO_VALUE = [  # a formula, samples of x, and the only step at which a comparison has no value
    ("once[1,1] 1 / x > 2", [1, 0, 1, 1], 1),
    ("once[2,2] 1 / x > 2 | x > 9", [1, 0, 1, 1], 1),
    ("1 / x[t-2] > 2", [1, 0, 1, 1], 1),
    ("x[t-2] / x[t-1] > 2", [1, 0, 1, 1], 1),
    ("x[t-2] / x > 2", [1, 0, 0, 1], 2),
    ("F[0,2] 1 / (x - x[t-1]) > 9", [1, 2, 2, 3, 4], 2),
    ("F[1,1] 1 / (x - x[t-1]) > 9", [1, 2, 2, 3, 4], 2),
    ("F[0,1] once[1,1] (1 / x > 2)", [1, 0, 1, 1], 1),
    ("once (1 / x[t-1] > 2)", [1, 0, 1, 1], 1),
    ("once[0,1] F[0,1] 1 / (x - x[t-1]) > 9", [1, 2, 2, 3, 4], 2),
]


@pytest.mark.parametrize(("text", "x", "step"), NO_VALUE)
def test_what_has_no_value_is_named_by_the_step_of_its_latest_sample(text, x, step):
    phi, trace = stl.parse(text), {"x": [float(value) for value in x]}
    batch = {"x": [[float(k * k) + 1 for k in range(len(x))], trace["x"]]}

    def blocks(wait):
        return [stl.OnlineMonitor(phi, wait).feed(trace)]

    def samples(wait):
        online = stl.OnlineMonitor(phi, wait)
        return [online.feed({"x": value}) for value in trace["x"]]

    asked = [lambda end=end: stl.monitor(phi, trace, end) for end in ("error", "cut")]
    asked += [lambda read=read, wait=wait: read(wait) for read in (blocks, samples) for wait in (False, True)]
    asked += [lambda: stl.smooth_robustness(phi, trace, 1.0), lambda: stl.monitor(phi, trace, "cut", "boolean")]
    asked += [lambda: [stl.diagnose(phi, trace, t, end="cut") for t in range(len(x))]]
    for judge in asked:
        with pytest.raises(TraceError, match=rf"^step {step}: .* no value"):
            judge()
    with pytest.raises(TraceError, match=rf"^trace 1, step {step}: .* no value"):
        stl.monitor(phi, batch)


def test_one_step_is_judged_whatever_has_no_value_at_others():
    trace = {"x": [1.0] * 8, "y": [1.0, 1, 0, 1, 1, 1, 0, 1]}
    for text, at in (("x / y > 1 | once[3,3] x > 0", 5), ("x / y > 2 | F[0,3] x > 0", 3)):
        phi = stl.parse(text)
        for end in ("error", "cut", "hold"):
            found = stl.monitor(phi, trace, end, at=at)
            assert (found.verdicts[0], found.robustness[0]) == (True, 1.0)
            with pytest.raises(TraceError, match="the traces have 8 samples; at step 8 this formula needs"):
                stl.monitor(phi, trace, end, at=8)


def test_margins_beyond_the_doubles():
    trace = {"x": [1e308, 1.0], "y": [-1e308, 1.0]}
    assert stl.monitor(stl.parse("x > y"), trace, semantics="boolean").verdicts.tolist() == [True, False]
    for text in ("x > y", "x - y > 1", "x != y"):
        with pytest.raises(TraceError, match="^step 0: formula, line 1, column 1: the margin is beyond"):
            stl.monitor(stl.parse(text), trace)
    assert stl.monitor(stl.parse("F[1,1] (x >= y)"), trace).robustness.tolist() == [0.0]  # not looked at
    assert stl.monitor(stl.parse("x > 1"), {"x": [1.7e308]}).robustness.tolist() == [1.7e308]


def test_the_first_violation():
    phi = stl.parse("F[0,1] a")
    assert stl.monitor(phi, {"a": [1, 0, 0, 1]}).first_violation == 1
    assert stl.monitor(phi, {"a": [1, 0, 1]}).first_violation is None
    assert stl.monitor(phi, {"a": [[1, 0, 0, 1], [1, 0, 1, 0]]}).first_violation.tolist() == [1, -1]
    assert stl.monitor(phi, {"a": np.zeros((0, 3))}).first_violation.tolist() == []
    assert stl.monitor(phi, {"a": np.zeros((2, 0))}, "cut").first_violation.tolist() == [-1, -1]
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
        ("x > 0", {"x": [2**53 + 1]}, TraceError, "x is 9007199254740993 at step 0: integers beyond"),
        ("x > 0", {"x": ["one"]}, TraceError, "not numbers"),
        ("x > 0", {"x": np.ones(2, dtype=np.longdouble)}, TraceError, "not numbers that fit a double"),
        ("x > 0", {"x": np.ma.array([1.0, 2.0], mask=[0, 1])}, TraceError, "x has masked samples"),
        ("x > 0", {"x": [10**30]}, TraceError, "x is of object"),
        ("x > 0", {"x": 1.0}, TraceError, r"x has shape \(\)"),
        ("x > 0", {"x": [[[1.0]]]}, TraceError, r"\(n_traces, n_steps\)"),
        ("sped > 0", {"speed": [1.0]}, NameLookupError, r"line 1, column 1: .* no signal sped; did you mean speed\?"),
        ("true", {}, TraceError, "the number of steps is unknown"),
    ],
)
def test_traces_that_cannot_be_judged(text, signals, kind, says):
    with pytest.raises(kind, match=says):
        stl.monitor(stl.parse(text), signals)


def test_options_that_do_not_exist():
    with pytest.raises(SettingsError, match="end is 'stop'; choose error, cut or hold"):
        stl.monitor(stl.parse("a"), {"a": [1]}, end="stop")
    with pytest.raises(SettingsError, match="semantics is 'truth'; choose both, boolean or robustness"):
        stl.monitor(stl.parse("a"), {"a": [1]}, semantics="truth")
    with pytest.raises(StlSyntaxError, match="only monitors of whole traces judge it, with end cut or hold"):
        stl.monitor(Eventually(Interval(0, None), stl.parse("a")), {"a": [1]})
    with pytest.raises(ArgumentError, match="parse it: stl.parse"):
        stl.monitor("a", {"a": [1]})


def test_windows_longer_than_anything():
    phi = Always(Interval(0, 10**30), Eventually(Interval(10**29, 10**31), stl.parse("x > 0")))
    for end, verdicts in (("cut", [False, False]), ("hold", [True, True])):
        assert stl.monitor(phi, {"x": [0, 1]}, end).verdicts.tolist() == verdicts
    online = stl.OnlineMonitor(phi)
    assert [online.feed({"x": 0}), online.feed({"x": 1}), [d.verdict for d in online.finish("hold")]] == [
        [],
        [],
        [1, 1],
    ]


def test_no_traces_and_no_steps():
    phi = stl.parse("F[0,1] (x > 0)")
    for end, decided in (("error", 2), ("cut", 3), ("hold", 3)):
        result = stl.monitor(phi, {"x": np.zeros((0, 3))}, end)
        assert result.verdicts.shape == result.robustness.shape == (0, decided)
    for end in ("cut", "hold"):
        assert stl.monitor(phi, {"x": []}, end).verdicts.shape == (0,)
        assert stl.monitor(phi, {"x": [[], []]}, end).robustness.shape == (2, 0)
    for nothing in ([], [[]], np.zeros((0, 1))):
        with pytest.raises(TraceError, match=r"[01] samples; this formula needs 2"):
            stl.monitor(phi, {"x": nothing})


def test_only_the_names_of_the_formula_are_looked_at():
    signals = {"x": [1.0, 2.0], "y": [np.nan], "z": "anything", "w": [[1, 2], [3]]}
    assert stl.monitor(stl.parse("x > 1"), signals).verdicts.tolist() == [False, True]
    assert stl.monitor(stl.parse("F[0,1] true"), {"x": [[1, 2, 3]] * 2}).verdicts.shape == (2, 2)
    with pytest.raises(TraceError, match="signal z is of"):  # a formula without names takes its steps from all
        stl.monitor(stl.parse("true"), signals)


@pytest.mark.parametrize("kind", [float, np.float32, np.float16, np.int8, np.uint64, np.int64, bool, list])
def test_numbers_of_any_kind(kind):
    given = [0, 1, 1] if kind is list else np.array([0, 1, 1], dtype=kind)
    phi = And((Label("a"), Comparison(">", Variable("a"), Number(0.5))))  # a label and a signal at once
    result = stl.monitor(phi, {"a": given})
    assert result.verdicts.tolist() == [False, True, True]
    assert result.robustness.tolist() == [-np.inf, 0.5, 0.5]
    assert stl.monitor(Label("a"), {"a": given}).robustness.tolist() == [-np.inf, np.inf, np.inf]


def test_the_largest_whole_numbers():
    for x in (2**53, -(2**53)):
        for samples in ([x], np.array([x]), [float(x)]):
            assert stl.monitor(stl.parse("x > 0"), {"x": samples}).robustness.tolist() == [x]
        assert stl.OnlineMonitor(stl.parse("x > 0")).feed({"x": x}) == [(0, x > 0, x)]
        beyond = x + x // 2**53
        for samples in ([beyond], [0.5, beyond], np.array([beyond])):
            with pytest.raises(TraceError, match="integers beyond"):
                stl.monitor(stl.parse("x > 0"), {"x": samples})
    assert stl.monitor(stl.parse("x > 0"), {"x": [1e300, 2**53]}).verdicts.all()


def test_the_arrays_given_are_left_alone():
    signals = {"x": np.array([[0.0, -0.0, 2.0, 0.5]]), "a": np.array([[True, False, True, True]])}
    before = {name: values.copy() for name, values in signals.items()}
    for values in signals.values():
        values.setflags(write=False)
    for text in ("a", "x > 0", "a & x > 0", "!(F[0,1] (x > 0) <-> a)", "(x >= 0) U[1,2] a"):
        for end in ("error", "cut", "hold"):
            result = stl.monitor(stl.parse(text), signals, end)
            for name, values in signals.items():
                assert np.array_equal(values, before[name])
                assert not np.shares_memory(values, result.verdicts)
                assert not np.shares_memory(values, result.robustness)
            assert result.verdicts.flags.writeable
            assert result.robustness.flags.writeable
            assert not np.signbit(result.robustness[result.robustness == 0]).any()


def test_a_task():
    task = stl.parse_task("param T = 2\nlow := F[0,T) (x < 1)")
    result = stl.monitor(task, {"x": [0, 2, 2]})
    assert (result.formula, result.verdicts.tolist()) == (task.formula, [True, False])


@pytest.mark.soak(only=True)
def test_formulas_as_large_as_the_language_allows():
    rng = np.random.default_rng(0)
    x = rng.random(60)
    args, wanted = [], []
    for i in range(10_000):
        interval, bound = Interval(i % 7, i % 13 + 7), i / 1e4
        args.append(Eventually(interval, Comparison(">", Variable("x"), Number(bound))))
        wanted.append(sliding_window_view(x[interval.a :], len(interval)).max(axis=1)[:41] - bound)
    result = stl.monitor(And(tuple(args)), {"x": x})
    assert np.array_equal(result.robustness, np.min(wanted, axis=0))
    deep = stl.parse("x > 0.5")
    for i in range(191):
        deep = Not(Eventually(Interval(0, 0), deep)) if i % 2 else Or((deep, Not(deep)))
    assert stl.monitor(deep, {"x": x}).verdicts.all()
    assert len(compile_formula(deep).instructions) == 383  # a tree of more than 2^95 nodes


def test_equal_parts_are_computed_once():
    program = compile_formula(stl.parse("(F[0,2] (x > 1)) & (F[0,2] (x > 1) | !(x > 1)) & F[0,3] (x > 1)"))
    assert [now.op for now in program.instructions].count("eventually") == 2
    assert sum(now.op == "atom" for now in program.instructions) == 1
    assert program.horizon == 3
    ends = [ended for now in program.instructions for ended in now.ends]
    assert sorted(ends) == list(range(len(program.instructions) - 1))  # everything ends once, but for the result


@given(phi=perhaps_endless(), end=ENDS, data=st.data())
def test_every_buffer_is_given_back_once(phi, end, data):
    columns, machine = data.draw(batches(4)), Machine(compile_formula(phi))
    block = Block(columns, len(columns["x"]), 4, end)
    assert [values.dtype for values in machine.run(block)] == [np.bool_, np.float64]
    for kind in (np.bool_, np.float64):
        free = machine.pool(kind, 0).free
        assert len({id(buffer) for buffer in free}) == len(free)
    with mock.patch("numpy.zeros", side_effect=AssertionError("a second block takes new memory")):
        machine.run(block)


def test_buffers_are_used_again():
    text = " & ".join(
        f"F[0,{i % 9}] (x > {i}) | !(x > {i} <-> y > {i}) & ((x < {i}) U[1,2] (y < {i}))" for i in range(50)
    )
    machine = Machine(compile_formula(stl.parse(text)), truth=False)
    machine.run(Block({name: np.zeros((1, 20)) for name in "xy"}, 1, 20, "cut"))
    assert len(machine.pool(np.float64, 0).free) <= 9


@pytest.mark.parametrize("n_traces", [0, 1, 7])
def test_long_traces(n_traces):
    """Many blocks in time, against windows written down."""
    rng = np.random.default_rng(1)
    shape = (40_000,) if n_traces == 0 else (n_traces, 40_000)
    x, y = rng.random((2, *shape))
    result = stl.monitor(stl.parse("G[3,50] (F[0,20] (x > 0.5) | y < 0.9)"), {"x": x, "y": y})
    margin = np.maximum(sliding_window_view(x - 0.5, 21, axis=-1).max(axis=-1), 0.9 - y[..., :-20])
    wanted = sliding_window_view(margin[..., 3:], 48, axis=-1).min(axis=-1)
    assert np.array_equal(result.robustness, wanted)
    assert np.array_equal(result.verdicts, wanted > 0)


@given(a=st.integers(0, 4), width=st.integers(1, 9), seed=st.integers(0, 999), end=st.sampled_from(["error", "cut"]))
def test_since_is_until_on_the_reversed_trace(a, width, seed, end):
    """Truth and robustness; windows without an end, too."""
    rng = np.random.default_rng(seed)
    trace = {name: rng.integers(-3, 4, (2, 20)) / 2 for name in "xy"}
    mirrored = {name: values[:, ::-1] for name, values in trace.items()}
    for interval in (Interval(a, a + width - 1), Interval(a, None)):
        p, q = stl.parse("x > 0"), stl.parse("y >= 0")
        for ahead, back in (
            (Until(interval, p, q), Since(interval, p, q)),
            (Always(interval, p), Historically(interval, p)),
        ):
            found, wanted = stl.monitor(back, trace, end), stl.monitor(ahead, mirrored, "cut")
            assert np.array_equal(found.verdicts, wanted.verdicts[:, ::-1])
            assert np.array_equal(found.robustness, wanted.robustness[:, ::-1])


def test_the_last_sample_is_held_only_where_that_is_asked_for():
    """Also below an operator of the past."""
    phi, x = stl.parse("G[0,2] once[0,1] (x > 0)"), [1, 0]
    assert stl.monitor(phi, {"x": x}, "cut").verdicts.tolist() == [True, True]
    assert stl.monitor(phi, {"x": x}, "hold").verdicts.tolist() == [False, False]


def test_a_since_forgets_what_lies_before_its_window():
    """Also where the window is nearly as long as the trace."""
    result = stl.monitor(stl.parse("(x > -1) since[1,2] (x > 0)"), {"x": [1, 0, 0, 0]}, "cut")
    assert result.verdicts.tolist() == [False, True, True, False]
    assert result.robustness.tolist() == [-np.inf, 1, 1, 0]


def test_long_windows_of_the_past_in_blocks():
    """Blocks of a long trace begin as far back as their steps look; without a limit there is one block."""
    rng = np.random.default_rng(0)
    trace = {name: rng.integers(-9, 10, 20_000) / 4 for name in "xy"}
    for text in (
        "once[3,700] x > 2",
        "(x > -2) since[10,900] (y > 1)",
        "historically[0,5] F[0,30] (x > 1)",
        "F[0,200] ((x > -2) since[0,40] (y > 2))",
        "(x > -2) since (y > 2)",
    ):
        phi = stl.parse(text)
        with in_blocks(10**9):
            whole = stl.monitor(phi, trace, "cut")
        with in_blocks(512):
            found = stl.monitor(phi, trace, "cut")
        assert np.array_equal(found.robustness, whole.robustness), text
        assert np.array_equal(found.verdicts, whole.verdicts), text


def test_kernels_of_since_are_their_python():
    from stltool.kernels import past

    rng = np.random.default_rng(0)
    for dtype, values in ((np.float64, [-1.0, 0.0, 0.5, np.inf, np.nan]), (np.int8, [-1, 0, 1])):
        left, right = (rng.choice(np.array(values, dtype), 3 * 12) for _ in range(2))
        for b in (0, 1, 3, 9, 10):
            outs = []
            for run in (past.since_within, past.since_within.py_func):
                outs.append(np.zeros(36, dtype))
                run(left, right, 3, 12, 10, b, outs[-1], *(np.empty(10, dtype) for _ in range(3)))
            assert np.array_equal(*outs, equal_nan=dtype == np.float64)
        start, within = np.zeros(36, dtype), np.zeros(36, dtype)
        past.since_start(left, right, 3, 12, 10, start)
        past.since_within(left, right, 3, 12, 10, 9, within, *(np.empty(10, dtype) for _ in range(3)))
        assert np.array_equal(start, within, equal_nan=dtype == np.float64)


@given(phi=formulas(past=True, max_leaves=5), n=st.integers(1, 30), data=st.data())
def test_one_step_is_judged_as_among_all(phi, n, data):
    trace = data.draw(traces(n))
    batch = {name: np.stack([values, values[::-1]]) for name, values in trace.items()}
    for end in ("error", "cut", "hold"):
        if end == "error" and n <= stl.horizon(phi):
            continue
        everything, rows = stl.monitor(phi, trace, end), stl.monitor(phi, batch, end)
        at = data.draw(st.integers(0, len(everything.verdicts) - 1))
        for signals in (trace, {name: values.tolist() for name, values in trace.items()}):
            one = stl.monitor(phi, signals, end, at=at)
            assert one.verdicts.tolist() == [everything.verdicts[at]]
            assert one.robustness.tolist() == [everything.robustness[at]]
            assert one.first_violation == (None if everything.verdicts[at] else at)
            assert one.n_steps == n
        some = stl.monitor(phi, batch, end, at=at)
        assert some.verdicts.tolist() == rows.verdicts[:, at : at + 1].tolist()


def test_one_step_reads_only_what_it_depends_on():
    phi = stl.parse("G[0,3] (x > 0 | once[0,2] y > 0)")
    x, y = np.ones(1000), np.ones(1000)
    x[[97, 104]] = np.nan
    assert stl.monitor(phi, {"x": x, "y": y}, at=100).verdicts.tolist() == [True]
    with pytest.raises(TraceError, match="signal x is nan at step 104"):
        stl.monitor(phi, {"x": x, "y": y}, at=101)
    with pytest.raises(TraceError, match="the traces have 1000 samples; at step 997 this formula needs 1001"):
        stl.monitor(phi, {"x": y, "y": y}, at=997)
    with pytest.raises(TraceError, match="signal x has 1000 samples, signal y 999"):
        stl.monitor(phi, {"x": x, "y": y[:999]}, at=0)
    with pytest.raises(NameLookupError, match="the traces have no signal"):
        stl.monitor(phi, {"z": x}, at=0)
