"""Monitors that read one sample at a time against those that see the whole trace, and against all its continuations."""

import copy
import gc
import inspect
import itertools
import math
import os
import pickle
import re
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, StlSyntaxError, TraceError
from stltool.kernels import objects
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    label_names,
    lookback,
    variables,
)  # fmt: skip
from stltool.logic.regions import Constraint, Linear
from stltool.monitoring import Decision, early, searched, starts, stream
from stltool.monitoring import online as online_module
from stltool.monitoring.tied import _Constraints
from stltool.numbers import shortest
from stltool.testing import formulas, traces
from tests.conftest import many
from tests.diagnosis.test_causes import CASES, random_formula


def looking_back(**options):
    """Formulas of the future and the past, whose windows have ends."""
    return formulas(past=True, **options).filter(lambda phi: lookback(phi) is not None)


def decisions(result):
    """What an offline result says, step by step."""
    steps = range(result.verdicts.size)
    return [stl.Decision(*d) for d in zip(steps, result.verdicts.tolist(), result.robustness.tolist(), strict=True)]


@given(phi=formulas() | looking_back(), data=st.data())
def test_every_prefix_is_judged_as_the_offline_monitor_does(phi, data):
    n = stl.horizon(phi) + data.draw(st.integers(0, 5))
    trace = data.draw(traces(n))
    online, so_far = stl.OnlineMonitor(phi, wait=True), []
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
        online = stl.OnlineMonitor(phi, wait=True)
        found = [decision for pair in zip(x, y, strict=True) for decision in online.feed({"x": pair[0], "y": pair[1]})]
        assert found == decisions(stl.monitor(phi, {"x": x, "y": y}))


def test_memory_is_bounded_by_the_horizon():
    phi = stl.parse("G[0,50] (F[2,20] (x > 0.5) & ((x < 0.9) U[3,20] (y > 0.5)) <-> y + x < 1.5)")
    online, rng = stl.OnlineMonitor(phi), np.random.default_rng(0)
    before = online.nbytes
    for x, y in rng.random((2000, 2)).tolist():
        online.feed({"x": x, "y": y})
    assert online.nbytes == before < 500 * (stl.horizon(phi) + 1)


def test_memory_is_bounded_by_the_samples():
    phi = stl.parse("G[0,100000000] (x > 0 | F[0,10000000] y > 0)")
    online = stl.OnlineMonitor(phi)
    for _ in range(1500):
        online.feed({"x": 1.0, "y": 1.0})
    assert online.nbytes < 1_000_000


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
            before = online.n_steps, online.bounds(0), online.finish()
            with pytest.raises(kind, match=says):
                online.feed(sample)
            assert (online.n_steps, online.bounds(0), online.finish()) == before
        assert online.feed(right) == wanted.feed(right)


def test_what_an_online_monitor_refuses():
    with pytest.raises(StlSyntaxError, match="no horizon"):
        stl.OnlineMonitor(Eventually(Interval(0, None), stl.parse("a")))
    with pytest.raises(SettingsError, match="end is 'error'; choose cut or hold"):
        stl.OnlineMonitor(stl.parse("a")).finish("error")
    with pytest.raises(TraceError, match="the signals of feed's block differ in shape"):
        stl.OnlineMonitor(stl.parse("once (x > y)")).feed({"x": [1.0], "y": 1.0})


def test_a_task_and_a_formula_that_looks_at_one_sample():
    online = stl.OnlineMonitor(stl.parse_task("low := x <= 2"))
    assert online.finish() == []
    assert online.feed({"x": 2}) == [stl.Decision(0, True, 0.0)]
    assert online.feed({"x": 2.5, "y": None}) == [(1, False, -0.5)]
    assert (online.finish("hold"), online.horizon, online.n_steps) == ([], 0, 2)


# ------------------------------------------------------------------------------------------------- early verdicts


def fed(online, trace):
    """Each decision with the number of samples that were read when it came."""
    n = len(next(iter(trace.values())))
    return {
        decision.step: (t + 1, decision.verdict)
        for t in range(n)
        for decision in online.feed({name: values[t] for name, values in trace.items()})
    }


def earliest(phi, trace, values):
    """What `fed` should be: the samples after which every continuation over `values`, from the start on, agrees."""
    names = sorted(values)
    letters = list(itertools.product(*(values[name] for name in names)))
    h, n = stl.horizon(phi), len(next(iter(trace.values())))
    codes = np.array(list(itertools.product(range(len(letters)), repeat=h + 1)))
    table = np.array(letters, dtype=float)[codes]  # (traces, h + 1, names)
    signals = {name: table[:, :, i] for i, name in enumerate(names)}
    verdicts = stl.monitor(phi, signals, semantics="boolean").verdicts[:, 0].reshape((len(letters),) * (h + 1))
    numbers = {letter: i for i, letter in enumerate(letters)}
    read = [numbers[tuple(trace[name][t] for name in names)] for t in range(n)]
    found = {}
    for t in range(n):
        for end in range(t + 1, min(n, t + h + 1) + 1):
            possible = verdicts[tuple(read[t:end])]
            if possible.all() or not possible.any():
                found[t] = (end, bool(possible.flat[0]))
                break
    return found


TRICKY = [
    "p | !p", "F[0,1] p & G[0,1] !p", "(F[0,2] p) | (G[0,2] !p)", "G[0,2] (p -> F[0,1] q) & F[0,2] (p & !q)",
    "(p U[0,2] q) | F[1,3] (q & !p)", "G[0,3] true", "F[1,2] false | p", "(p <-> F[0,2] q) & (q <-> F[1,2] p)",
    "G[0,1] (x > 2) | F[0,1] (x <= 3)", "F[0,2] (x > 3) -> F[0,2] (x > 2)", "G[0,2] (x > 2 -> F[0,1] (x < 1))",
    "(x > 3 U[1,2] x < 2) | G[0,2] x >= 2", "F[0,1] (x == 2) & G[0,1] (x != 2)", "2*x > 4 & F[0,2] x <= 2",
    "(p U[1,3] q) -> F[0,1] q", "q & F[1,3] q", "G[1,2] p | q", "q -> F[2,2] !q",
]  # fmt: skip
CELLS = {"x": (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0), "p": (0.0, 1.0), "q": (0.0, 1.0)}


@pytest.mark.parametrize("text", TRICKY)
@pytest.mark.parametrize("kind", ["coalesced", "each"])
def test_verdicts_come_as_soon_as_all_continuations_agree(text, kind, monkeypatch):
    if kind == "each":
        monkeypatch.setattr(early, "_decided_from", lambda automaton, runs: None)
    phi = stl.parse(text)
    names = {name for name in CELLS if name in text} or {"p"}
    values, rng = {name: CELLS[name] for name in names}, np.random.default_rng(len(text))
    for _ in range(4):
        online = stl.OnlineMonitor(phi)
        assert online.early.exact
        assert online.early.engine == "automaton"
        trace = {name: rng.choice(values[name], 12).tolist() for name in names}
        assert fed(online, trace) == earliest(phi, trace, values)


TIED = [  # what can come next depends on the values of earlier samples
    "G[0,2] (x[t+1] > x & x < 3)", "G[0,1] (x[t+1] > x) & F[1,2] x < 1", "F[0,1] (x[t+1] < x & x > 2)",
    "G[0,1] (x[t+2] >= x | x > 1)", "G[0,1] (x[t+1] - x <= 1) & F[1,2] x > 2", "F[0,2] (x == 2 & x[t+1] != x & p)",
    "G[0,1] (abs(x[t+1] - x) <= 1 -> x > 0)", "F[0,1] (x[t+1] > 2*y & y[t+1] > x & x > 1)",
    "prev (x > 1) & G[0,1] (x[t+1] < x | x > 2)", "G[0,2] (max(x, x[t+1]) <= 2 & x > 0)",
]  # fmt: skip


@pytest.mark.parametrize("text", TIED)
def test_values_of_earlier_samples_decide_as_soon_as_all_continuations_agree(text):
    phi = stl.parse(text)
    rng = np.random.default_rng(len(text))
    many = np.concatenate([np.arange(-0.5, 3.6, 0.5 if "y" in text else 0.25), (-20.0, 20.0)]).tolist()
    values = dict.fromkeys(variables(phi), many) | dict.fromkeys(label_names(phi), (0.0, 1.0))
    decided_here = 0
    for _ in range(3):
        online, plain = stl.OnlineMonitor(phi), stl.OnlineMonitor(phi)
        assert online.early[:2] == ("automaton", True)
        trace = {name: rng.integers(0, 4 if name in variables(phi) else 2, 7).astype(float).tolist() for name in values}
        found = fed(online, trace)
        assert found == earliest_with_past(phi, trace, values)
        plain._tied = None
        decided_here += sum(end < fed(plain, trace).get(t, (99, None))[0] for t, (end, _) in found.items())
    assert decided_here, "the automaton alone is as early"


def test_decisions_by_values_are_told_once_and_in_blocks_too():
    phi = stl.parse("G[0,3] (x[t+1] > x & x < 3)")
    x = np.array([0.0, 1.0, 2.5, 3.0, 1.0, 0.5, 2.0, 2.5, 2.75, 2.875, 2.9, 2.95, 0.0, 1.0])
    single, blocks = stl.OnlineMonitor(phi), stl.OnlineMonitor(phi)
    found = [decision for value in x for decision in single.feed({"x": value})]
    halves = [decision for part in (x[:5], x[5:6], x[6:]) for decision in blocks.feed({"x": part})]
    assert [(d.step, d.verdict) for d in found] == [(d.step, d.verdict) for d in halves]
    assert sorted(d.step for d in found) == list(range(len(found)))
    truth = stl.monitor(phi, {"x": x}, "cut").verdicts
    assert all(truth[d.step] == d.verdict for d in found if d.step < len(x) - 4)
    told = {d.step for d in found}
    assert [d.step for d in single.finish()] == [t for t in range(len(x)) if t not in told]
    copied = pickle.loads(pickle.dumps(single))
    assert copied.feed({"x": 9.0}) == single.feed({"x": 9.0}) != []


@given(
    rows=st.lists(
        st.tuples(*[st.fractions(-3, 3, max_denominator=20)] * 3, st.sampled_from(["<", "<=", "="])),
        min_size=1, max_size=6,
    ),
    samples=st.lists(st.sampled_from([0.1, 0.2, 0.3, -0.1, 1e-9, 1e9, 0.0, 5e-324, 1e308]), min_size=2, max_size=2),
)  # fmt: skip
@example(rows=[(Fraction(1), Fraction(1), Fraction(-3, 10), "<=")], samples=[0.1, 0.2])
@example(rows=[(Fraction(1, 3**800), Fraction(0), Fraction(0), "<=")], samples=[1e308, 0.2])
def test_linear_constraints_are_judged_as_in_fractions(rows, samples):
    names = [f"x\n{i}" for i in range(2)]
    given_ = [Constraint(Linear.of(dict(zip(names, row, strict=False)), row[2]), row[3]) for row in rows]
    given_ = list(dict.fromkeys(given_))
    exact = dict(zip(names, map(shortest, samples), strict=True))
    holds = [Constraint(Linear((), one.term.at(exact)), one.relation).decided for one in given_]
    assert _Constraints(given_).at({"x": samples}) == holds


def test_what_is_too_large_for_values_is_possibly_late():
    for text in ("G[0,200] (x[t+1] > x & x < 3)", "G[0,2] (x[t+1] * x > 1 & x < 3)"):
        assert not stl.OnlineMonitor(stl.parse(text)).early.exact


@pytest.mark.soak
@given(phi=formulas(labels=("p", "q"), signals=(), longest=2, max_leaves=5), seed=st.integers(0, 999))
def test_any_formula_is_decided_as_soon_as_all_continuations_agree(phi, seed):
    if stl.horizon(phi) > 5:
        return
    trace = {name: np.random.default_rng(seed).integers(0, 2, 10).astype(float).tolist() for name in "pq"}
    assert fed(stl.OnlineMonitor(phi), trace) == earliest(phi, trace, {"p": (0.0, 1.0), "q": (0.0, 1.0)})


def earliest_with_past(phi, trace, values):
    """`earliest` for a formula that reads samples before the start: continuations are appended to the whole trace.

    `values` of a signal may be a function that gives those of the first, second, … step ahead.
    """
    names = sorted(values)

    def letters(j):
        return list(itertools.product(*(values[n](j) if callable(values[n]) else values[n] for n in names)))

    h, n = stl.horizon(phi), len(next(iter(trace.values())))
    found = {}
    for t in range(n):
        for end in range(t + 1, min(n, t + h + 1) + 1):
            rest = t + h + 1 - end
            tails = np.array(list(itertools.product(*map(letters, range(rest)))), dtype=float)
            tails = tails.reshape(-1, rest, len(names)) if rest else np.empty((1, 0, len(names)))
            columns = {
                name: np.concatenate([np.tile(np.array(trace[name][:end], float), (len(tails), 1)), tails[:, :, i]], 1)
                for i, name in enumerate(names)
            }
            possible = stl.monitor(phi, columns, semantics="boolean").verdicts[:, t]
            if possible.all() or not possible.any():
                found[t] = (end, bool(possible[0]))
                break
    return found


LOOKING_BACK = [
    "F[0,2] once[0,2] p", "G[0,2] (p -> once[0,3] q)", "F[1,2] (p since[1,3] q) | G[0,2] !p",
    "G[0,2] prev p & F[0,1] !p", "F[0,2] rise (F[0,1] p) <-> q",
    "once[1,3] F[0,2] p & G[0,1] q", "once[0,2] (p & F[0,2] !p)", "F[0,2] fall p",
    "G[0,1] (x > 2) | prev F[0,2] (x <= 3)", "historically[2,4] (p U[0,2] q) -> F[0,2] (q & !p)",
    "F[0,2] prev prev p | once[1,2] F[0,2] q", "G[0,2] (x > 2 -> once[0,1] x <= 3)",
    # without a limit
    "F[0,2] once p", "G[0,2] (p -> once q)", "F[1,2] (p since q) | G[0,2] !p", "G[0,2] historically p & F[0,1] !p",
    "once F[0,2] p & G[0,1] q", "F[0,1] x > 2 & historically[2,inf] (x < 3)", "F[0,2] (q & once[1,inf] p) & F[0,2] !q",
    "(once (p & F[0,2] q)) -> F[0,1] p", "q & F[1,2] (q since p)",
]  # fmt: skip


@pytest.mark.parametrize("text", LOOKING_BACK)
@pytest.mark.parametrize("kind", ["coalesced", "each"])
def test_what_looks_back_is_decided_as_soon_as_all_continuations_agree(text, kind, monkeypatch):
    if kind == "each":
        monkeypatch.setattr(early, "_decided_from", lambda automaton, runs: None)
    phi = stl.parse(text)
    cells = {"x": (1.0, 2.0, 2.5, 3.0, 4.0), "p": (0.0, 1.0), "q": (0.0, 1.0)}
    values = {name: cells[name] for name in {**variables(phi), **label_names(phi)}}
    rng = np.random.default_rng(len(text))
    for _ in range(2):
        online = stl.OnlineMonitor(phi)
        assert online.early[:2] == ("automaton", True)
        trace = {name: rng.choice(values[name], 9).tolist() for name in values}
        assert fed(online, trace) == earliest_with_past(phi, trace, values)


DEPENDENT = [
    "x > y & F[0,2] x * y < 1", "F[0,1] (x + y > 3 & x < 1) | G[0,2] y < 1", "F[0,2] max(x, y) > 3 | G[0,1] x < 2",
    "F[0,2] abs(x) + abs(y) <= 1 & G[0,2] x < 3", "(G[0,2] x > y) -> F[0,1] (x > 2 | y < 2)",
    "F[0,1] x * y == 0 -> y > 2", "F[0,2] x * x > 1 | G[0,3] x ^ 3 <= 1",
    "(G[0,2] x * x < 2) -> F[0,2] (x <= 1 & x^3 >= 1)",
    "F[0,1] (x > y & y > 2 & x < 2) | G[0,2] x > y", "F[0,2] once[0,1] x > y & G[0,1] (x <= 2 | y > 2)",
]  # fmt: skip
SHIFTED = [
    "G[0,2] (x[t+1] - x <= 1)", "F[0,2] (x - x[t-1] > 1) & G[0,1] x - x[t-1] > -2", "G[0,2] (x > x[t-1] -> y > x[t-2])",
    "F[0,1] (x - 2*x[t-1] + x[t-2] > 1) <-> F[1,2] y < y[t-1]", "G[0,2] (prev x > 2 -> y > y[t-1])",
    "once (x > x[t-1]) & F[0,2] x <= x[t-1]",
]  # fmt: skip


@pytest.mark.parametrize("text", DEPENDENT + SHIFTED)
def test_comparisons_of_several_samples_are_decided_as_soon_as_all_continuations_agree(text):
    phi, shifted = stl.parse(text), text in SHIFTED
    few = (-2.0, 0.0, 0.5, 1.0, 2.0, 2.5, 4.0)
    ahead = {True: lambda j: (-(20.0 ** (j + 1)), 20.0 ** (j + 1)), False: few}[shifted]  # from any value on
    names = sorted(variables(phi))
    rng = np.random.default_rng(len(text))
    online = stl.OnlineMonitor(phi)
    assert online.early[:2] == ("automaton", True)
    trace = {name: rng.choice(few, 8 if shifted else 5).tolist() for name in names}
    assert fed(online, trace) == earliest_with_past(phi, trace, dict.fromkeys(names, ahead))


@pytest.mark.soak
@given(phi=formulas(labels=("p", "q"), signals=(), longest=2, max_leaves=5, past=True), seed=st.integers(0, 999))
def test_any_formula_that_looks_back_is_decided_as_soon_as_all_continuations_agree(phi, seed):
    if stl.horizon(phi) > 4:
        return
    trace = {name: np.random.default_rng(seed).integers(0, 2, 8).astype(float).tolist() for name in "pq"}
    online = stl.OnlineMonitor(phi)
    assert online.early.exact
    assert fed(online, trace) == earliest_with_past(phi, trace, {"p": (0.0, 1.0), "q": (0.0, 1.0)})


@pytest.mark.parametrize("text", ["(p U[1,3] q) -> F[0,1] q", "q & F[1,3] q"])
def test_starts_in_a_state_with_two_outcomes_or_open_again_at_a_later_clock_share_no_list(text):
    engine = early.engine_of(stl.parse(text))
    assert engine.first is None
    assert engine.closed is not None


def test_the_example_of_the_documentation():
    online = stl.OnlineMonitor(stl.parse("G[0,1000] (x > 0)"))
    for x in (3.0, 2.0, 1.0):
        assert online.feed({"x": x}) == []
    assert online.feed({"x": -1.0}) == [stl.Decision(t, False, None) for t in range(4)]


# ------------------------------------------------------------------------------------------------ the structure


def structural(monkeypatch, search=False):
    monkeypatch.setattr(early, "_of_automaton", lambda *arguments: None)
    if not search:
        monkeypatch.setattr(early, "LONGEST", -1)


def kleene(phi, trace, t, n):
    """Three-valued truth at step t of a trace of which n samples are known: True, False or None."""
    match phi:
        case Constant(value):
            return value
        case Label(name):
            return bool(trace[name][t]) if t < n else None
        case Comparison() if not variables(phi):
            return stl.satisfies(phi, {})
        case Comparison():
            return stl.satisfies(phi, {name: values[t : t + 1] for name, values in trace.items()}) if t < n else None
        case Not(arg):
            value = kleene(arg, trace, t, n)
            return None if value is None else not value
        case And() | Or():
            found = [kleene(child, trace, t, n) for child in children(phi)]
            return combined(found, isinstance(phi, Or))
        case Implies(left, right):
            return kleene(Or((Not(left), right)), trace, t, n)
        case Iff(left, right):
            return kleene(And((Or((Not(left), right)), Or((left, Not(right))))), trace, t, n)
        case Eventually(interval, arg) | Always(interval, arg):
            found = [kleene(arg, trace, u, n) for u in range(t + interval.a, t + interval.b + 1)]
            return combined(found, isinstance(phi, Eventually))
        case Once(interval, arg) | Historically(interval, arg):
            found = [kleene(arg, trace, u, n) for u in range(max(0, t - interval.b), t - interval.a + 1)]
            return combined(found, isinstance(phi, Once))
        case Since(interval, left, right):
            witnesses = range(max(0, t - interval.b), t - interval.a + 1)
            found = [
                combined([kleene(right, trace, u, n), *(kleene(left, trace, v, n) for v in range(u + 1, t + 1))], False)
                for u in witnesses
            ]
            return combined(found, True)
        case Trigger(interval, left, right):
            return kleene(Not(Since(interval, Not(left), Not(right))), trace, t, n)
        case Rise(arg):
            return kleene(And((arg, Not(Once(Interval(1, 1), arg)))), trace, t, n)
        case Release(interval, left, right):
            return kleene(Not(Until(interval, Not(left), Not(right))), trace, t, n)
        case Until(interval, left, right):
            held = [kleene(left, trace, u, n) for u in range(t, t + interval.b)]
            return combined(
                [
                    combined([kleene(right, trace, u, n), *held[: u - t]], False)
                    for u in range(t + interval.a, t + interval.b + 1)
                ],
                True,
            )


def combined(found, some):
    """The disjunction (or conjunction) of three truth values."""
    if some in found:
        return some
    return None if None in found else not some


@given(phi=formulas(signals=("x",), longest=3, max_leaves=5) | looking_back(max_leaves=5), data=st.data())
def test_the_structural_engine_is_three_valued_truth(phi, data):
    n = stl.horizon(phi) + data.draw(st.integers(1, 4))
    trace = data.draw(traces(n))
    with pytest.MonkeyPatch.context() as patch:
        structural(patch)
        online = stl.OnlineMonitor(phi)
    as_soon_as_kleene(online, phi, trace, n)


def test_verdicts_of_differences_come_as_soon_as_the_last_sample_says():
    """It rises by less than 1 a step: over 5 two steps on if it is over 3 now, and then over 4."""
    phi, rng = stl.parse("G[0,2] (x - x[t-1] < 1) & F[2,2] x > 5"), np.random.default_rng(0)
    for _ in range(20):
        x = rng.integers(0, 8, 14).tolist()
        found = fed(stl.OnlineMonitor(phi), {"x": x})
        for t in range(12):
            false = [k for k in range(t, t + 3) if k == 0 or x[k] - x[k - 1] >= 1 or x[k] <= 3 + k - t]
            assert found[t] == ((min(false) if false else t + 2) + 1, not false)


def as_soon_as_kleene(online, phi, trace, n):
    assert online.early.engine == "structure"
    found = fed(online, trace)
    for t in range(n):
        when, verdict = found.get(t, (n + 1, None))
        assert kleene(phi, trace, t, min(when, n)) is verdict
        if when > t + 1:
            assert kleene(phi, trace, t, when - 1) is None


@pytest.mark.parametrize(
    "text",
    [
        f"{window} ({of})"
        for window in ("F[1,3]", "G[1,3]", "F[70,75]", "G[70,75]")
        for of in (
            "p <-> 1 > 0",
            "1 > 0 <-> p",
            "p <-> 0 > 1",
            "0 > 1 <-> p",
            "p | false",
            "p & true",
            "F[0,1] p <-> p",
        )
    ],
)
def test_constants_are_known_before_their_samples(text, monkeypatch):
    structural(monkeypatch)
    phi = stl.parse(text)
    for p in ([0] * 9, [1] * 9, [0, 0, 1, 0, 0, 0, 1, 1, 1]):
        as_soon_as_kleene(stl.OnlineMonitor(phi), phi, {"p": list(map(bool, p))}, 9)


@pytest.mark.soak
def test_structure_and_automaton_agree_over_long_windows(monkeypatch):
    rng = np.random.default_rng(3)
    texts = (
        "G[0,200] F[0,70] p", "G[3,90] (p -> F[1,64] q)", "(p U[5,130] q) -> F[0,10] q", "F[64,128] G[0,63] p",
        "G[0,150] (p -> F[0,30] (q & G[0,5] p))",
    )  # fmt: skip
    for text in texts:
        phi = stl.parse(text)
        trace = {"p": (rng.random(900) < 0.9).tolist(), "q": (rng.random(900) < 0.05).tolist()}
        exact = fed(stl.OnlineMonitor(phi), trace)
        with pytest.MonkeyPatch.context() as patch:
            structural(patch)
            other = stl.OnlineMonitor(phi)
        found = fed(other, trace)
        if other.early.exact:
            assert found == exact
        truth = stl.monitor(phi, trace, semantics="boolean").verdicts
        for t, holds in enumerate(truth.tolist()):
            assert exact[t][1] is found[t][1] is holds
            assert exact[t][0] <= found[t][0] <= t + stl.horizon(phi) + 1


def test_what_is_said_about_exactness():
    large = "G[0,1000] (x > 5 -> F[0,100] (y > 3 & G[0,20] {}))"
    assert stl.OnlineMonitor(stl.parse(large.format("p"))).early[:2] == ("structure", True)
    mixed = stl.OnlineMonitor(stl.parse(large.format("x > 4"))).early
    assert mixed[:2] == ("search", True)
    assert "depends on another" in mixed.why
    assert stl.OnlineMonitor(stl.parse(large.format("x > 4").replace("1000", "5000"))).early[:2] == ("structure", False)
    for text in ("F[0,2] x * y > 4 & G[0,3] x * x + y * y <= 2", "G[0,3] (x * x[t-1] <= 1) & F[0,2] x > 3"):
        assert stl.OnlineMonitor(stl.parse(text)).early[:2] == ("automaton", False)
    many_labels = " & ".join(f"F[0,2] p{i}" for i in range(13))
    one = stl.OnlineMonitor(stl.parse(many_labels)).early
    assert one == ("structure", True, "the formula has 13 labels and comparisons, over 12; every predicate occurs in "
                   "one polarity")  # fmt: skip
    assert stl.OnlineMonitor(stl.parse(f"{many_labels} & (F[0,2] x > 3) & G[0,5] x > 2")).early.exact
    assert not stl.OnlineMonitor(stl.parse(f"{many_labels} & (F[0,2] x > 3) & G[0,5] x < 2")).early.exact


def test_long_windows_are_given_up_before_they_take_long(monkeypatch):
    deep = "(p U[0,900] q) release[0,900] (q release[0,400] p)"  # nested deeper than Python calls functions
    wide = "(G[0,578] F[0,207] p) U[0,313] ((q & F[0,233] p) release[299,583] (G[0,16] q & p))"
    for text, most in ((deep, math.inf), (wide, 2000)):
        monkeypatch.setattr(early, "_MOST_COMPARED", most)
        found = stl.OnlineMonitor(stl.parse(text)).early
        assert found[:2] == ("structure", True)
        assert "too large" in found.why


# ------------------------------------------------------------------------------------------------------- the search


@pytest.mark.parametrize("text", TRICKY + DEPENDENT[:-1])
def test_the_search_decides_as_soon_as_all_continuations_agree(text, monkeypatch):
    structural(monkeypatch, search=True)
    phi = stl.parse(text)
    few = {"x": (-2.0, 0.0, 0.5, 1.0, 2.0, 2.5, 4.0)}
    cells = few | {"y": few["x"]} if "y" in text else CELLS
    names = [name for name in cells if name in text] or ["p"]
    values, rng = {name: cells[name] for name in names}, np.random.default_rng(len(text))
    for _ in range(1 if "y" in text else 4):
        online = stl.OnlineMonitor(phi)
        trace = {name: rng.choice(values[name], 5 if "y" in text else 12).tolist() for name in names}
        assert fed(online, trace) == earliest(phi, trace, values)
        assert online.early.engine in ("search", "structure")
        assert online.early.exact


@pytest.mark.soak
@pytest.mark.parametrize("most", [500, 1])
def test_any_formula_is_searched_for_continuations_of_both_verdicts(most, monkeypatch):
    structural(monkeypatch, search=True)
    monkeypatch.setattr(searched, "_MOST_VISITED", most)
    rng, exact, sooner = np.random.default_rng(most), 0, 0
    for texts, values, n in (CASES[0], CASES[2], CASES[3]):
        atoms = [stl.parse(text) for text in texts]
        for _ in range(cases := max(40, many(60))):
            phi = random_formula(rng, atoms, int(rng.integers(2, 5)), n - 1)
            names = sorted({*variables(phi), *label_names(phi)})
            trace = {name: rng.choice(values[name], 9).tolist() for name in names}
            online = stl.OnlineMonitor(phi)
            found = fed(online, trace)
            wanted = earliest(phi, trace, {name: values[name] for name in names})
            assert not online.early.exact or found == wanted
            assert all(
                found[t][0] >= end and found[t][1] == verdict for t, (end, verdict) in wanted.items() if t in found
            )
            with pytest.MonkeyPatch.context() as patch:
                structural(patch)
                plain = fed(stl.OnlineMonitor(phi), trace)
            assert all(found[t][0] <= end for t, (end, _) in plain.items())
            sooner += any(found[t][0] < end for t, (end, _) in plain.items())
            exact += online.early.exact
    assert sooner
    assert exact == 3 * cases if most > 1 else 0 < exact < 3 * cases


def test_a_search_in_blocks_and_with_copies(monkeypatch):
    structural(monkeypatch, search=True)
    rng = np.random.default_rng(0)
    for text in (TRICKY[3], TRICKY[7], "F[0,9] (x > 3) -> F[0,7] (x > 2)"):
        phi = stl.parse(text)
        names = {*variables(phi), *label_names(phi)}
        trace = {name: rng.integers(0, 5 if name == "x" else 2, 150).astype(float) for name in names}
        single, blocks, so_far, told = stl.OnlineMonitor(phi), stl.OnlineMonitor(phi), set(), set()
        for start, end in itertools.pairwise([0, 1, 2, 9, 10, 20, 21, 24, 140, 150]):
            for t in range(start, end):
                so_far |= {d[:2] for d in single.feed({name: values[t] for name, values in trace.items()})}
            found = blocks.feed({name: values[start:end] for name, values in trace.items()})
            assert [d.step for d in found] == sorted({d.step for d in found} - {step for step, _ in told})
            told |= {d[:2] for d in found}
            assert told == so_far
            single = pickle.loads(pickle.dumps(single))
            assert {d.step for d in single.finish()} == {*range(end)} - {step for step, _ in told}
            for step in range(max(0, end - stl.horizon(phi)), end):
                lower, upper = single.bounds(step)
                assert (step, True) not in told or lower >= 0
                assert (step, False) not in told or upper <= 0
        assert single.early.exact


# ------------------------------------------------------------------------------------------------ bounds and blocks


@given(phi=formulas(longest=2, max_leaves=5) | looking_back(longest=2, max_leaves=5), data=st.data())
def test_bounds_contain_the_final_robustness_and_shrink(phi, data):
    h = stl.horizon(phi)
    trace = data.draw(traces(h + 1))
    final = stl.robustness(phi, trace)
    online, lower, upper = stl.OnlineMonitor(phi), -math.inf, math.inf
    for t in range(h + 1):
        online.feed({name: values[t] for name, values in trace.items()})
        before = lower, upper
        lower, upper = online.bounds(0)
        assert before[0] <= lower <= upper <= before[1]
        assert lower <= final + 1e-9
        assert final - 1e-9 <= upper
    assert lower == upper == stl.monitor(phi, trace).robustness[0]


def test_bounds_are_reached_where_predicates_occur_in_one_polarity():
    phi = stl.parse("G[0,2] (x > 1 | F[0,2] x < -1 & p)")
    values, rng = {"x": (-3.0, 0.0, 2.0), "p": (0.0, 1.0)}, np.random.default_rng(0)
    letters, h = list(itertools.product(*values.values())), stl.horizon(phi)
    trace = [letters[i] for i in rng.integers(0, len(letters), h + 1)]
    online = stl.OnlineMonitor(phi)
    for known in range(1, h + 2):
        online.feed(dict(zip(values, trace[known - 1], strict=True)))
        ends = [trace[:known] + list(tail) for tail in itertools.product(letters, repeat=h + 1 - known)]
        columns = {name: np.array([[sample[i] for sample in end] for end in ends]) for i, name in enumerate(values)}
        found = stl.monitor(phi, columns).robustness[:, 0]
        lower, upper = online.bounds(0)
        # beyond the samples x may be anything, here it is between -3 and 2
        assert lower == found.min() or (lower == -math.inf and known < h + 1)
        assert upper == found.max() or (upper == math.inf and known < h + 1)


def test_steps_without_bounds():
    online = stl.OnlineMonitor(stl.parse("F[0,2] x > 0"))
    with pytest.raises(SettingsError, match="bounds' step is 0, but no sample was read; feed the first one"):
        online.bounds(0)
    for x in (1.0, 2.0, 3.0, 4.0, 5.0):
        online.feed({"x": x})
    assert online.bounds(2) == (5.0, 5.0)
    assert online.bounds(4) == (5.0, math.inf)
    for step in (1, 5):
        with pytest.raises(SettingsError, match="bounds of steps 2 … 4"):
            online.bounds(step)


@given(phi=formulas(longest=3, max_leaves=5) | looking_back(max_leaves=5), wait=st.booleans(), data=st.data())
def test_blocks_yield_the_decisions_of_single_samples(phi, wait, data):
    n = data.draw(st.integers(1, 40))
    trace = data.draw(traces(n))
    cuts = sorted(data.draw(st.lists(st.integers(0, n), max_size=3)))
    one, other = stl.OnlineMonitor(phi, wait), stl.OnlineMonitor(phi, wait)
    for start, end in itertools.pairwise([0, *cuts, n]):
        singles = [
            decision
            for t in range(start, end)
            for decision in one.feed({name: values[t] for name, values in trace.items()})
        ]
        block = other.feed({name: values[start:end] for name, values in trace.items()})
        assert isinstance(block, stl.Decisions)
        assert [decision[:2] for decision in block] == sorted(decision[:2] for decision in singles)
        final = {d.step: d.robustness for d in singles if d.robustness is not None}
        assert {d.step: d.robustness for d in block if d.step in final} == final
        assert len(block) == len(singles)
        assert other.n_steps == one.n_steps == end
        for step in range(max(0, end - 1 - one.horizon), end):
            assert one.bounds(step) == other.bounds(step)
        assert one.finish("cut") == other.finish("cut")


@pytest.mark.parametrize(
    ("block", "says"),
    [
        ({"x": [1.0, math.nan], "a": [True, False]}, "signal x is nan at step 3"),
        ({"x": [1.0, 2.0], "a": [1, 2]}, "signal a is 2 at step 3"),
        ({"x": [1.0, 2.0], "a": [1]}, "signal x has shape .*, signal a .*; give all signals one shape"),
        ({"x": [1.0, 2.0], "a": True}, "shape"),
        ({"x": [[1.0]], "a": [[True]]}, "feed one trace"),
        ({"x": [1.0, 0.0], "a": [1, 1]}, "step 3: .*no value for the operands 1, 0"),
        ({"x": [1.0, -1.5e308], "a": [1, 1]}, "step 3: .*margin is beyond"),
    ],
)
def test_a_refused_block_leaves_the_monitor_as_it_was(block, says):
    online = stl.OnlineMonitor(stl.parse("F[0,1] (a & 1 / x > 0.25) & F[1,2] (x > 1e308)"))
    online.feed({"x": [1.0, 2.0], "a": [True, False]})
    before = online.n_steps, online.bounds(0), online.finish()
    for longer in (1, 20):  # sample by sample, and as a whole
        rows = {name: [*values, *[values[0]] * (longer - 1)] if isinstance(values, list) else values
                for name, values in block.items()}  # fmt: skip
        with pytest.raises(TraceError, match=says):
            online.feed(rows)
        assert (online.n_steps, online.bounds(0), online.finish()) == before
    assert len(online.feed({"x": [], "a": []})) == 0


# ------------------------------------------------------------------------------------------------ the arrays


@given(
    phi=formulas(longest=6, max_leaves=5) | looking_back(max_leaves=5),
    wait=st.booleans(),
    structure=st.booleans(),
    data=st.data(),
)
def test_arrays_grow_with_the_trace(phi, wait, structure, data):
    n = stl.horizon(phi) + 6
    trace = data.draw(traces(n))
    with pytest.MonkeyPatch.context() as patch:
        if structure:
            structural(patch)
        one = stl.OnlineMonitor(phi, wait)
        patch.setattr(stream.Stream.__init__, "__defaults__", (0, 2))
        other = stl.OnlineMonitor(phi, wait)
    for t in range(n):
        sample = {name: values[t] for name, values in trace.items()}
        assert one.feed(sample) == other.feed(sample)


def test_monitors_are_copied_and_stored():
    online = stl.OnlineMonitor(stl.parse("G[0,3] F[0,2] x > 0.5"))
    xs = np.random.default_rng(0).random(40).tolist()
    for x in xs[:10]:
        online.feed({"x": x})
    for other in (copy.deepcopy(online), pickle.loads(pickle.dumps(online))):
        ahead = copy.deepcopy(online)
        assert [other.feed({"x": x}) for x in xs[10:]] == [ahead.feed({"x": x}) for x in xs[10:]]
    assert online.n_steps == 10


def test_calls_without_numbas_entry_points(monkeypatch):
    xs = np.random.default_rng(0).random(40).tolist()
    expected = stl.OnlineMonitor(stl.parse("G[0,3] F[0,2] x > 0.5"))
    monkeypatch.setattr(stream.k, "entry_point", lambda function: function)
    monkeypatch.setattr(objects, "_defined", lambda doc: None)
    online = stl.OnlineMonitor(stl.parse("G[0,3] F[0,2] x > 0.5"))
    assert not inspect.isbuiltin(online.feed)
    assert [online.feed({"x": x}) for x in xs] == [expected.feed({"x": x}) for x in xs]


# ------------------------------------------------------------------------------- the compiled feed of a dict of floats


def pure(phi, wait=False):
    """A monitor that has no compiled `feed`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objects, "bound", lambda self, doc: None)
        return stl.OnlineMonitor(phi, wait)


def test_feed_is_compiled_here():
    """So that the other tests test it, and speed is what it is said to be."""
    online = stl.OnlineMonitor(stl.parse("G[0,2] (x > 0 & y > x & a)"))
    assert inspect.isbuiltin(online.feed)
    assert inspect.signature(online.feed) == inspect.signature(lambda sample: None)
    assert online.feed(sample={"x": 1.0, "y": 2.0, "a": True}) == []
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'sample'"):
        online.feed()
    with pytest.raises(TypeError, match="unexpected keyword argument 'samples'"):
        online.feed(samples={})
    assert "Take the next sample" in online.feed.__doc__
    assert not inspect.isbuiltin(stl.OnlineMonitor(stl.parse("x + y > 0")).feed)  # decided in Python


@given(phi=formulas(longest=6, max_leaves=6) | looking_back(max_leaves=5), wait=st.booleans(), data=st.data())
def test_the_compiled_feed_is_the_method(phi, wait, data):
    n = data.draw(st.integers(1, 30))
    trace = data.draw(traces(n))
    one, other = stl.OnlineMonitor(phi, wait), pure(phi, wait)
    for t in range(n):
        sample = {name: values[t].item() for name, values in trace.items()}
        found, expected = one.feed(sample), other.feed(sample)
        assert found == expected
        assert [type(part) for decision in found for part in decision] == [
            type(part) for decision in expected for part in decision
        ]
        assert [hash(decision) for decision in found] == [hash(tuple(decision)) for decision in expected]
        assert {type(decision) for decision in found} <= {Decision}
    assert (one.n_steps, one.finish()) == (other.n_steps, other.finish())


class Odd(dict):
    def __getitem__(self, name):
        return 3.0


class Hash(str):
    """A key that is never x, and says so loudly."""

    def __hash__(self):
        return hash("x")

    def __eq__(self, other):
        raise RuntimeError("compared")


@pytest.mark.parametrize(
    ("sample", "says"),
    [
        ({}, "the sample at step 0 has no value of a"),
        ({"x": 1.0}, "the sample at step 0 has no value of a"),
        ({"x": "1", "a": True}, "x is '1' at step 0; give a float"),
        ({"x": True, "a": 2.0}, "a is 2.0 at step 0; it is used as a label"),
        ({"x": math.nan, "a": True}, "x is nan at step 0"),
        ({"x": 1.0, "a": None}, "a is None at step 0"),
        ("x", "feed's sample"),
        (None, "feed's sample"),
    ],
)
def test_what_the_compiled_feed_leaves_to_the_method(sample, says):
    phi = stl.parse("G[0,1] (x > 0 & a)")
    for online in (stl.OnlineMonitor(phi), pure(phi)):
        with pytest.raises(stl.StlToolError, match=re.escape(says)):
            online.feed(sample)
        assert online.n_steps == 0
        assert online.feed({"x": np.float64(1.0), "a": 1}) == []
        assert online.feed({"b": 0, "x": 1.0, "a": True}) == [(0, True, None)]


def test_other_mappings_are_read_as_they_are():
    phi = stl.parse("x > 2")
    for online in (stl.OnlineMonitor(phi), pure(phi)):
        assert online.feed(Odd(x=3.0)) == [(0, True, 1.0)]
        with pytest.raises(RuntimeError, match="compared"):
            online.feed({Hash("q"): 1.0})
        assert online.feed({"x": 1.0}) == [(1, False, -1.0)]


def test_many_steps_decided_at_once_come_by_step():
    online = stl.OnlineMonitor(stl.parse("G[0,500] (x > 0 & F[0,50] y > 0)"))
    for t in range(400):
        online.feed({"x": 1.0, "y": float(t % 7 == 0)})
    assert [decision.step for decision in online.feed({"x": -1.0, "y": 1.0})] == list(range(401))
    first = np.random.default_rng(0).permutation(600) * 5
    runs = np.stack([np.concatenate([first, first + 2]) << 3 | 1, np.repeat([2, 3], 600)], axis=1)
    made = stl.Decisions._of_runs(runs.tobytes())
    assert (len(made), [decision.step for decision in made]) == (3000, [*range(3000)])
    assert made[7] == (7, False, None) == [*made][7]
    assert made == [*made] == made[:]
    assert made != [*made][1:]
    assert made[5:7] == [(5, False, None), (6, False, None)]
    assert np.array_equal(made.steps, np.arange(3000))
    assert not made.verdicts.any()
    assert np.isnan(made.robustness).all()
    assert pickle.loads(pickle.dumps(made)) == copy.copy(made) == made


def same_as_single_steps(online, engine, trace):
    """Compare lists of runs, which are joined and split, with lists of steps in Python, sample by sample."""
    steps, known = starts.OpenSteps(engine), {}
    for t in range(60):
        found = online.feed({name: values[t].item() for name, values in trace.items()})
        assert [*found] == [(*one, None) for one in steps.read(online._stream.truths(engine.leaves))]
        assert len(found) == len([*found])
        known |= {decision.step: decision.verdict for decision in found}
        oldest = max(0, t - online.horizon)
        assert online._stream.undecided(oldest).tolist() == [u for u in range(oldest, t + 1) if u not in known]
        assert [online._stream.verdict(u) for u in range(oldest, t + 1)] == list(map(known.get, range(oldest, t + 1)))


@given(phi=formulas(longest=9, max_leaves=6) | looking_back(longest=9, max_leaves=5), data=st.data())
@settings(max_examples=many(60))
def test_runs_of_steps_are_those_of_single_ones(phi, data):
    online, trace = stl.OnlineMonitor(phi), data.draw(traces(60))
    engine = early.engine_of(online._judged)
    assume(engine.first is not None and not online._earlier.made.signals and not online.wait)
    same_as_single_steps(online, engine, trace)


@pytest.mark.parametrize("seed", range(30))
def test_runs_that_interleave(seed, monkeypatch):
    """Which no automaton of a formula is known to need: so of one that is drawn."""
    rng, phi = np.random.default_rng(seed), stl.parse("G[0,9] (p & q)")
    n, m = rng.integers(2, 7, 2)
    drawn = replace(
        early.engine_of(phi), delta=rng.integers(0, n, (3, n)), letter=rng.integers(0, 3, 4),
        starts=rng.integers(0, m, (3, m)), begins=rng.integers(0, n, m), first=rng.choice([1, 6, 9], n),
        outcome=rng.integers(1, 3, n),
    )  # fmt: skip
    monkeypatch.setattr(online_module, "engine_of", lambda *arguments: drawn)
    same_as_single_steps(stl.OnlineMonitor(phi), drawn, {name: rng.integers(0, 2, 60) == 1 for name in "pq"})


@pytest.mark.parametrize("wait", [False, True])
@pytest.mark.parametrize(
    ("text", "x"),
    [
        ("1 / (x - x[t-1]) > 0.4", [1.0, 3, 4, 6]),
        ("F[1,1] 1 / (x - x[t-1]) > 0.4", [1.0, 3, 4, 6]),
        ("once 1 / (x - x[t-1]) > 0.4", [1.0, 3, 4, 6]),
        ("F[0,1] (1 / (x - x[t-1]) > 0.4 & x > 3) | once[0,1] (1 / (x - x[t-1]) <= 0.4 & x <= 3)", [4.0, 3, 6, 1]),
        ("F[0,2] (sqrt(x[t-2]) < 1 & 1 / (x[t-1] - x[t-2]) > 0 & x > 1)", [1.0, 3, 4, 6, 2]),
        ("x > -x[t-1]", [1.7e308, 1, 1, 1]),
        # at step 0 neither of two comparisons has a value, of which one holds at all others
        ("F[0,1] (1 / (x - x[t-1]) > 0.4 & y > 3) | G[0,1] (1 / (x - x[t-1]) <= 0.4 | y > 3)", [0.0, 3, 5]),
    ],
)
def test_what_reads_samples_before_the_trace_is_false(text, x, wait):
    phi, trace = stl.parse(text), {"x": x, "y": [1.0, 5, 1, 1, 1][: len(x)]}
    online, found, known = stl.OnlineMonitor(phi, wait), [], stl.monitor(phi, trace, "cut")
    for t, value in enumerate(x):
        found += online.feed({"x": value, "y": trace["y"][t]})
        for step in range(max(0, t - online.horizon), t + 1):
            if step + online.horizon < len(x):
                lower, upper = online.bounds(step)
                assert lower <= known.robustness[step] <= upper
    found += online.finish()
    assert [one.verdict for one in sorted(found)] == known.verdicts.tolist()
    for t in range(len(x) - online.horizon):
        assert known.verdicts[t] == stl.satisfies(phi, trace, t)


def test_room_that_grows_or_is_made_at_once_has_what_was_read():
    """Arrays begin with room for 1024 samples."""
    online = stl.OnlineMonitor(stl.parse("F[0,2000] 1 / (x - x[t-1]) > 2"))  # at step 0, x - 0 is 0
    for t in range(1100):
        assert [*online.feed({"x": float(t)})] == []
    assert [*online.feed({"x": 1099.25})] == [(t, True, None) for t in range(1101)]
    trace = {"x": np.where(np.arange(4500) % 1499 == 7, 1.0, -1.0)}
    online = stl.OnlineMonitor(stl.parse("F[0,1030] x > 0"), wait=True)  # at least four horizons: judged as a whole
    assert online.feed(trace).verdicts.tolist() == stl.monitor(online.formula, trace).verdicts.tolist()
    assert online.finish("hold") == online.finish("hold") != []


@pytest.mark.parametrize(("horizon", "back"), [(62, 1), (63, 1), (63, 2), (64, 1)])
def test_sets_of_steps_have_room_for_what_lies_before_and_ahead(horizon, back):
    """They are bits of words of 64; more than 12 labels are too many for an automaton."""
    rng, names = np.random.default_rng(0), [f"p{i}" for i in range(13)]
    phi = stl.parse(f"G[0,{horizon}] ({' | '.join(names)} | historically[0,{back}] x > 0)")
    trace = {name: rng.random(300) < 0.2 for name in names} | {"x": rng.random(300) - 0.1}
    online, wanted = stl.OnlineMonitor(phi), stl.monitor(phi, trace).verdicts
    told = [one for t in range(0, 200, 50) for one in online.feed({name: x[t : t + 50] for name, x in trace.items()})]
    assert online.early.engine == "structure"
    assert [one.verdict for one in told] == [wanted[one.step] for one in told]
    assert {one.step for one in told} >= {*range(200 - horizon)}
    assert 0 < wanted.sum() < len(wanted)


@pytest.mark.parametrize("more", ["", " | once z > 9"])  # which looks back without a limit
def test_a_since_forgets_what_lies_before_its_window_sample_by_sample(more):
    rng = np.random.default_rng(0)
    trace = {"x": rng.random(80) - 0.1, "y": rng.random(80) - 0.6, "z": np.zeros(80)}
    for a, b in ((0, 1), (0, 4), (1, 3), (2, 2), (2, 6), (5, 9), (8, 8)):
        phi = stl.parse(f"(x > 0 since[{a},{b}] y > 0){more}")
        online = stl.OnlineMonitor(phi, wait=True)
        told = [one for t in range(80) for one in online.feed({name: values[t] for name, values in trace.items()})]
        assert [one.robustness for one in told] == stl.monitor(phi, trace).robustness.tolist()


def test_the_end_of_a_trace_asks_only_for_values_it_depends_on():
    online = stl.OnlineMonitor(stl.parse("(1 / (x - x[t-1]) > 0) since G[2,3] (sqrt(x[t-1]) > 1)"), wait=True)
    trace = {"x": [4.0, 3.0, 2.0, 1.0]}
    told = [one for t in range(4) for one in online.feed({"x": trace["x"][t]})]
    for end in ("cut", "hold"):  # x - x[t-1] is 0 where the last sample is held
        found, wanted = told + online.finish(end), stl.monitor(online.formula, trace, end)
        assert [one[1:] for one in found] == [*zip(wanted.verdicts, wanted.robustness, strict=True)]
    online = stl.OnlineMonitor(stl.parse("once F[0,1] 1 / (x - x[t-1]) > 0"), wait=True)
    online.feed({"x": 4.0})
    online.feed({"x": 3.0})
    with pytest.raises(TraceError, match=r"^step 2: .* no value"):
        online.finish("hold")


def test_a_sample_that_decides_many_steps_tells_one_run():
    online = stl.OnlineMonitor(stl.parse("G[0,1000] (x > 0)"))
    for _ in range(700):
        online.feed({"x": 1.0})
    found = online.feed({"x": -1.0})
    assert len(found) == 701 == len([*found])
    assert len(found._runs) == 16


def test_a_feed_keeps_its_monitor_and_nothing_else():
    phi = stl.parse("G[0,3] (x > 0.3 & a)")
    feed = stl.OnlineMonitor(phi, wait=True).feed
    gc.collect()
    other, early_ = stl.OnlineMonitor(phi, wait=True), stl.OnlineMonitor(phi).feed
    samples = [{"x": x, "a": x > 0.1} for x in np.random.default_rng(0).random(2000).tolist()]
    watched = (Decision, None, True, False, float, dict, samples[0], samples[0]["x"], "x", "a")

    def run():
        for sample in samples:
            assert feed(sample) == other.feed(sample)
            early_(sample)

    run()
    before = [sys.getrefcount(one) for one in watched]
    tracemalloc.start()
    run()
    assert tracemalloc.get_traced_memory()[0] < 20_000
    tracemalloc.stop()
    assert max(abs(sys.getrefcount(one) - then) for one, then in zip(watched, before, strict=True)) < 100  # of 2000


PYTHONS = """
import numpy as np, stltool as stl
from stltool.monitoring import early
automaton = early._of_automaton
for text in ("(x > 0.2 U[1,3] y > 0.7) <-> G[0,1] x + y < 1.5", "F[0,66] (x > 0.99 & y < 0.5)"):
    trace = dict(zip("xy", np.random.default_rng(0).random((2, 70))))
    for early._of_automaton in (automaton, lambda *arguments: None):
        online = stl.OnlineMonitor(stl.parse(text), wait="U" in text)
        for x, y in zip(*trace.values()):
            print([*online.feed({"x": float(x), "y": float(y)})])
"""


def test_kernels_compute_what_their_python_does(capsys, monkeypatch):
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", PYTHONS], capture_output=True, text=True, env=environment, check=True)
    monkeypatch.setattr(early, "_of_automaton", early._of_automaton)
    exec(PYTHONS, {})
    assert done.stdout == capsys.readouterr().out
    assert done.stdout.count("Decision") > 140


@pytest.mark.soak
def test_a_long_stream_neither_grows_nor_changes():
    """Ten million samples in `make soak`; of each hundred thousand, the last ones again one by one."""
    phi = stl.parse("G[0,100] F[0,10] (x > 5)")
    online, rng = stl.OnlineMonitor(phi, wait=True), np.random.default_rng(0)
    bytes_ = online.nbytes
    before = np.empty(0)
    for _ in range(many(3)):
        for _ in range(10):
            x = rng.random(10_000) * 6
            found = online.feed({"x": x})
            assert np.array_equal(found.robustness, stl.monitor(phi, {"x": np.concatenate([before, x])}).robustness)
            before = x[-110:]
        for value in (rng.random(10_000) * 6).tolist():
            online.feed({"x": value})
            before = np.append(before[-109:], value)
    assert online.nbytes == bytes_


# ------------------------------------------------------------------------------------------------- looking back


def endless_past(**options):
    """Formulas that look back without a limit."""
    return formulas(past=True, **options).filter(lambda phi: lookback(phi) is None)


@given(phi=endless_past(), data=st.data())
def test_what_looks_back_is_judged_as_the_offline_monitor_does(phi, data):
    """After every prefix, with both ends; a copy that was pickled on the way goes on alike."""
    n = stl.horizon(phi) + data.draw(st.integers(0, 6))
    trace = data.draw(traces(n))
    online, so_far = stl.OnlineMonitor(phi, wait=True), []
    first, early_ = stl.OnlineMonitor(phi), []
    for t in range(n):
        sample = {name: values[t] for name, values in trace.items()}
        so_far += online.feed(sample)
        early_ += first.feed(sample)
        prefix = {name: values[: t + 1] for name, values in trace.items()}
        if t >= stl.horizon(phi):
            assert str(so_far) == str(decisions(stl.monitor(phi, prefix)))
        held = [decision[:2] for decision in early_ + first.finish("hold")]
        assert sorted(held) == list(enumerate(stl.monitor(phi, prefix, "hold").verdicts.tolist()))
        assert str(so_far + online.finish("hold")) == str(decisions(stl.monitor(phi, prefix, "hold")))
        truth = stl.monitor(phi, prefix, "cut").verdicts
        told = {decision.step for decision in early_}
        assert [d[:2] for d in first.finish("cut")] == [(i, bool(x)) for i, x in enumerate(truth) if i not in told]
        assert str(so_far + online.finish("cut")) == str(decisions(stl.monitor(phi, prefix, "cut")))
        if t == n // 2:
            online, first = pickle.loads(pickle.dumps((online, first)))
    block = stl.OnlineMonitor(phi, wait=True)
    assert str(list(block.feed(dict(trace.items())))) == str(so_far)
    assert block.n_steps == n


@pytest.mark.parametrize(
    "text",
    [
        "x > 0 U[1,3] y > 0", "(x > 0 U[1,3] y > 0) & once (x > 3)", "historically (x > -1 U[2,5] y > 0)",
        "x > 0 since (y > 0 release[2,3] x > 1)", "once (abs(x) > 1) & max(x, y) > 0",
        "min(x, -y) < 1 since abs(y) <= 1",
    ],
)  # fmt: skip
def test_windows_and_choices_sample_by_sample(text):
    phi, rng = stl.parse(text), np.random.default_rng(3)
    for _ in range(4):
        trace = {name: rng.integers(-2, 4, 24).astype(float) for name in "xy"}
        online, found = stl.OnlineMonitor(phi, wait=True), []
        for x, y in zip(trace["x"], trace["y"], strict=True):
            found += online.feed({"x": x, "y": y})
        assert str(found) == str(decisions(stl.monitor(phi, trace)))


@given(phi=endless_past(max_leaves=4), data=st.data())
def test_bounds_of_what_looks_back_hold_the_final_value(phi, data):
    h = stl.horizon(phi)
    trace = data.draw(traces(h + 4))
    final = stl.monitor(phi, trace).robustness
    online, before, decided = stl.OnlineMonitor(phi), {}, {}
    for t in range(h + 4):
        for decision in online.feed({name: values[t] for name, values in trace.items()}):
            decided[decision.step] = decision.verdict
        for step in range(max(0, t - h), min(t + 1, len(final))):
            lower, upper = online.bounds(step)
            assert lower - 1e-9 <= final[step] <= upper + 1e-9
            old = before.get(step, (-math.inf, math.inf))
            assert old[0] <= lower
            assert upper <= old[1]
            before[step] = lower, upper
            if step in decided:
                assert lower >= 0 if decided[step] else upper <= 0
            if t == step + h:
                assert lower == upper == final[step]


def test_memory_of_what_looks_back_is_bounded_by_its_windows():
    phi = stl.parse(
        "G[0,20] ((x > 0.5 since[3,90] F[2,20] (y > 0.5)) | historically[5,60] (x < 0.9) | once (y > 0.99))"
    )
    online, rng = stl.OnlineMonitor(phi), np.random.default_rng(0)
    sizes = []
    for x, y in rng.random((1200, 2)).tolist():
        online.feed({"x": x, "y": y})
        sizes.append(online.nbytes)
    assert max(sizes[400:]) == max(sizes[800:]) < 200_000


@given(a=st.integers(0, 5), width=st.integers(1, 12), seed=st.integers(0, 99))
@settings(max_examples=many(25))
def test_each_operator_of_the_past_over_any_window(a, width, seed):
    rng = np.random.default_rng(seed)
    trace = {name: rng.integers(-5, 6, 25) + 0.5 for name in "xy"}
    p, q = stl.parse("x > 0"), stl.parse("F[0,3] (y > 0)")
    for window in (Interval(a, a + width - 1), Interval(a, None)):
        for phi in (Once(window, q), Historically(window, q), Since(window, p, q), Trigger(window, q, p), Rise(q)):
            online = stl.OnlineMonitor(phi, wait=True)
            fed = [online.feed({"x": x, "y": y}) for x, y in zip(*trace.values(), strict=True)]
            assert list(itertools.chain(*fed)) == decisions(stl.monitor(phi, trace))


@pytest.mark.parametrize("text", ["(a & once a) since[0,0] b", "(once a) U[0,0] b", "(a & once a) trigger[0,0] b"])
def test_an_operand_that_has_no_step_to_hold_at_may_look_back_without_a_limit(text):
    phi, trace = stl.parse(text), {"a": [0, 1, 0], "b": [1, 0, 1]}
    for online in (stl.OnlineMonitor(phi), stl.OnlineMonitor(And((phi, Eventually(Interval(0, 1), phi))))):
        assert [decision.verdict for decision in online.feed(trace)][:2] == [True, False]
    with pytest.raises(NameLookupError, match="no value of a"):
        stl.OnlineMonitor(phi).feed({"b": 1.0})


@pytest.mark.parametrize(
    "text",
    ["once a & (!b U[0,3] a)", "(!a U[1,3] historically b) | G[2,3] a", "G[0,2] ((b U[1,2] F[0,2] a) since b)",
     "F[0,3] (b & !(a U[2,4] G[0,1] once b))", "once (F[1,2] a & G[1,2] b)"],
)  # fmt: skip
def test_windows_of_the_future_are_cut_over_an_endless_past(text):
    phi, rng = stl.parse(text), np.random.default_rng(len(text))
    trace = {"a": rng.random(40) < 0.3, "b": rng.random(40) < 0.8}
    online = stl.OnlineMonitor(phi, wait=True)
    for t in range(40):
        online.feed({name: values[t] for name, values in trace.items()})
        truth = stl.monitor(phi, {name: values[: t + 1] for name, values in trace.items()}, "cut").verdicts
        wanted = list(enumerate(truth.tolist()))[max(0, t + 1 - stl.horizon(phi)) :]
        assert [decision[:2] for decision in online.finish("cut")] == wanted


def test_what_looks_back_without_a_limit_ends_either_way():
    online = stl.OnlineMonitor(stl.parse("(once a) & F[0,2] b"))
    online.feed({"a": [1, 0, 0, 0], "b": [0, 0, 1, 0]})
    assert [decision[:2] for decision in online.finish("cut")] == [(3, False)]
    assert [decision[:2] for decision in online.finish("hold")] == [(3, False)]  # step 2 was told at once
    with pytest.raises(SettingsError, match="there are bounds of steps 1 … 3"):
        online.bounds(0)
    with pytest.raises(TraceError, match="a is 2 at step 5"):
        online.feed({"a": [1, 2], "b": [0, 0]})
    assert online.n_steps == 4


def test_shifted_samples_in_what_looks_back():
    phi = stl.parse("once (x[t-1] > x) | F[1,1] (x > 3)")
    trace = {"x": [1.0, 2.0, 2.0, 2.0, 2.0, 4.0, 1.0, 0.0]}
    online = stl.OnlineMonitor(phi, wait=True)
    found = [decision for x in trace["x"] for decision in online.feed({"x": x})]
    assert found == decisions(stl.monitor(phi, trace))
    assert found + online.finish("hold") == decisions(stl.monitor(phi, trace, "hold"))
