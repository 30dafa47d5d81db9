"""Causes of verdicts against the enumeration of all traces: they force the verdict, and none can be left out."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.diagnosis.causes import by_automaton, by_kleene, each_is_needed
from stltool.diagnosis.knowledge import knowledge_of, one_sided
from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.logic.feasible import leaves
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
    Trigger,
    Until,
)  # fmt: skip
from stltool.monitoring.program import compile_formula
from stltool.monitoring.samples import read_traces
from stltool.testing import formulas, traces
from tests.conftest import many
from tests.oracles import least_cause

BITS = (0.0, 1.0)
CELLS = (1.0, 2.0, 2.5, 3.0, 4.0)  # what comparisons with 2 and 3 can tell apart
WINDOWED, JOINED = (Eventually, Always), (And, Or)


def random_formula(rng, atoms, depth, room, past=False):
    """A formula of this depth whose horizon is at most `room`."""
    if depth == 0:
        return atoms[rng.integers(len(atoms))]
    kind = rng.integers(12 if past else 8)
    a = int(rng.integers(0, room + 1))
    b = int(rng.integers(a, room + 1))

    def below(left):
        return random_formula(rng, atoms, depth - 1, left, past)

    if kind < 4:
        return WINDOWED[kind % 2](Interval(a, b), below(room - b))
    if kind == 4:
        return (Until, Release)[rng.integers(2)](Interval(a, b), below(room - b), below(room - b))
    if kind == 5:
        return Not(below(room))
    if kind == 6:
        return JOINED[rng.integers(2)](tuple(below(room) for _ in range(2)))
    if kind == 7:
        return (Implies, Iff)[rng.integers(2)](below(room), below(room))
    if kind == 8:
        return Rise(below(room))
    if kind == 9:
        return (Since, Trigger)[rng.integers(2)](Interval(a, b), below(room), below(room))
    return (Once, Historically)[kind % 2](Interval(a, b), below(room))


def knowledge(phi, trace):
    n = stl.horizon(phi) + 1
    return knowledge_of(phi, read_traces(compile_formula(phi), trace).block(slice(0, 1), slice(0, n), "open"))


CASES = [
    (["a", "b"], {"a": BITS, "b": BITS}, 5),
    (["a", "b", "a & b"], {"a": BITS, "b": BITS}, 5),
    (["x > 3", "x > 2", "x <= 3", "x == 2"], {"x": CELLS}, 5),
    (["a", "x > 3", "x > 2 & a", "2 < x & x <= 3"], {"a": BITS, "x": CELLS}, 3),
    (["x + y > 0", "a", "x + y <= 0"], {"x": (-1.0, 1.0, -3.0, 3.0), "y": (-2.0, 0.0, 2.0), "a": BITS}, 3),
    (["max(x, y) >= 3", "x > y", "y > 2", "x * y == 0"], dict.fromkeys("xy", (0.0, 2.0, 3.0, -9.0, 2.5, 9.0)), 2),
]


@pytest.mark.soak
@pytest.mark.parametrize(
    ("texts", "values", "n"), CASES, ids=["labels", "past", "dependent", "mixed", "sums", "sharing"]
)
def test_the_least_cause_is_found(texts, values, n):
    past = "a & b" in texts
    rng, checked, mixed = np.random.default_rng(7), 0, 0
    atoms = [stl.parse(text) for text in texts]
    while checked < max(12, many(60)):
        phi = random_formula(rng, atoms, int(rng.integers(1, 4)), n - 1 - past, past)
        if not leaves(phi) or (h := stl.horizon(phi)) == 0 or (past and not stl.lookback(phi)):
            continue
        names = sorted({*stl.logic.formula.variables(phi), *stl.logic.formula.label_names(phi)})
        drawn = {"x + y > 0": {"x": 2}, "max(x, y) >= 3": {"x": 3, "y": 3}}.get(
            texts[0], {}
        )  # the others are for changes
        trace = {name: rng.choice(values[name][: drawn.get(name)], n) for name in names}
        t = int(rng.integers(0, n - h))
        told = stl.diagnose(phi, trace, t)
        least, forces = least_cause(phi, trace, t, "error", values)
        found = {name: steps.tolist() for name, steps in told.causes.items()}
        assert told.verdict == stl.satisfies(phi, trace, t)
        assert forces(found)
        assert told.minimal, told.doubt
        assert found == least, (str(phi), trace, t, one_sided(phi))
        checked += 1
        mixed += not one_sided(phi)
    assert mixed < checked
    assert mixed > 0 or "x + y > 0" in texts  # its mixed formulas are few


@pytest.mark.parametrize("end", ["cut", "hold"])
def test_causes_force_the_verdict_where_windows_pass_the_end(end):
    texts, values, n = CASES[0]
    rng, minimal = np.random.default_rng(3), 0
    for i in range(cases := many(60)):
        phi = random_formula(rng, [stl.parse(text) for text in texts], int(rng.integers(1, 4)), 6, past=i % 2 > 0)
        names = sorted(stl.logic.formula.label_names(phi))
        trace = {name: rng.choice(values[name], n) for name in names}
        told = stl.diagnose(phi, trace, t := int(rng.integers(n)), end=end)
        least, forces = least_cause(phi, trace, t, end, values)
        found = {name: steps.tolist() for name, steps in told.causes.items()}
        assert told.verdict == stl.monitor(phi, trace, end).verdicts[t]
        assert forces(found)
        assert told.minimal or end == "cut", told.doubt
        if told.minimal:  # the least of all where Kleene's evaluation or the automaton is exact
            assert found == least or (end == "cut" and not one_sided(phi))
            for name, steps in found.items():
                assert not any(forces(found | {name: [other for other in steps if other != step]}) for step in steps)
        minimal += told.minimal
    assert cases / 2 < minimal <= cases


@pytest.mark.parametrize(
    ("text", "causes"),
    [
        ("a -> F[1,1] a", {"a": []}),
        ("a & F[1,3] !a", {"a": []}),
        ("a <-> F[1,1] b", {"a": [1], "b": [1]}),
        ("F[0,2] (a & b) <-> G[1,2] b", {"a": [1], "b": []}),
        ("G[0,3] (b <-> F[1,2] b) & once[0,1] (a <-> F[2,2] b)", {"a": [0, 1], "b": []}),  # either b
    ],
)
def test_a_sample_that_is_held_is_one_sample(text, causes):
    told = stl.diagnose(stl.parse(text), {"a": [0, 1], "b": [0, 1]}, 1, end="hold")
    assert {name: steps.tolist() for name, steps in told.causes.items()} == causes
    assert told.minimal


@given(phi=formulas(past=True), data=st.data())
def test_other_samples_may_change_freely(phi, data):
    end = data.draw(st.sampled_from(["error", "cut", "hold"]))
    n = stl.horizon(phi) + data.draw(st.integers(1, 4)) if end == "error" else data.draw(st.integers(1, 9))
    trace, other = data.draw(traces(n)), data.draw(traces(n))
    t = data.draw(st.integers(0, n - 1 - (stl.horizon(phi) if end == "error" else 0)))
    told = stl.diagnose(phi, trace, t, end=end)
    assert told.verdict == stl.monitor(phi, trace, end, "boolean").verdicts[t]
    assert told.sentences
    changed = {name: np.array(values) for name, values in other.items()}
    for name, steps in told.causes.items():
        changed[name][steps] = np.asarray(trace[name])[steps]
    assert stl.monitor(phi, changed, end, "boolean").verdicts[t] == told.verdict


@pytest.mark.parametrize("text", ["false", "F[0,1] true", "rise (false -> false)", "G[0,1] 1 < 2"])
def test_what_reads_no_sample_needs_none(text):
    told = stl.diagnose(stl.parse(text), {"a": [1, 0]})
    assert (told.n_causes, told.minimal, told.verdict) == (0, True, text != "false")
    assert told.sentences


def test_both_ways_agree_on_longer_traces():
    rng = np.random.default_rng(1)
    for text in ("G[0,40] F[0,7] a", "F[3,30] (a & G[0,4] b)", "G[0,30] (a -> F[0,5] b)", "a U[2,40] (b U[0,5] !a)"):
        phi = stl.parse(text)
        n = stl.horizon(phi) + 1
        for p in (0.1, 0.5, 0.9):
            trace = {name: rng.random(n) < p for name in stl.logic.formula.label_names(phi)}
            known = knowledge(phi, trace)
            verdict = stl.satisfies(phi, trace)
            swept = by_automaton(known, 0, verdict).kept
            assert swept.any()
            if one_sided(phi):
                np.testing.assert_array_equal(by_kleene(known, 0, verdict), swept)


def test_each_sample_is_shown_to_be_needed_where_no_automaton_is_small_enough():
    rng = np.random.default_rng(0)
    trace = {"a": rng.random(1100) < 0.1, "b": rng.random(1100) < 0.5, "x": rng.random(1100) * 6}
    for text in ("G[0,1000] (a <-> F[0,10] b)", "(F[0,1000] x > 3) <-> (F[0,1000] x > 4)"):
        told = stl.diagnose(stl.parse(text), trace)
        assert told.minimal
        assert told.n_causes > 0
    texts, values, n = CASES[3]
    for _ in range(many(60)):
        phi = random_formula(rng, [stl.parse(text) for text in texts], int(rng.integers(1, 4)), n - 1)
        names = sorted({*stl.logic.formula.variables(phi), *stl.logic.formula.label_names(phi)})
        trace = {name: rng.choice(values[name], n) for name in names}
        known, verdict = knowledge(phi, trace), stl.satisfies(phi, trace)
        kept = by_kleene(known, 0, verdict)
        if each_is_needed(known, 0, verdict, kept):
            _, forces = least_cause(phi, trace, 0, "error", values)
            found = {name: np.flatnonzero(column).tolist() for name, column in zip(known.names, kept.T, strict=True)}
            for name, steps in found.items():
                assert not any(forces(found | {name: [other for other in steps if other != step]}) for step in steps)


def test_what_several_signals_decide_together():
    both = {"x": [1.0, 5.0], "y": [2.0, 2.0], "a": [1, 0]}
    sums = stl.diagnose(stl.parse("F[0,1] (x + y > 6)"), both)
    assert {name: steps.tolist() for name, steps in sums.causes.items()} == {"x": [1], "y": [1]}
    assert sums.minimal
    for text, x, y in (
        ("F[0,1] (x + y > 6 & x > 2)", [1], [1]),
        ("F[0,1] max(x, y) >= 3", [1], []),
        ("F[0,1] (x > y | y > 3)", [1], []),  # whatever y is, as x is 5
        ("F[0,1] x * y == 0 | G[0,1] y < 3", [], [0, 1]),
        ("(G[0,1] x + y <= 3) | F[0,1] x > 4", [1], []),
        ("(F[0,1] (x - y > 1)) <-> G[0,1] y < 3", [1], [0, 1]),
    ):
        told = stl.diagnose(stl.parse(text), both)
        assert {name: steps.tolist() for name, steps in told.causes.items()} == {"x": x, "y": y}, text
        assert told.minimal
    assert str(stl.diagnose(stl.parse("F[0,1] max(x, y) >= 3"), both)).splitlines()[0].endswith("with x = 5, y = 2")
    round_ = stl.diagnose(stl.parse("F[0,1] x * x + y * y > 24"), both)
    assert ({name: steps.tolist() for name, steps in round_.causes.items()}, round_.minimal) == (
        {"x": [1], "y": []},
        True,
    )
    always = stl.diagnose(stl.parse("F[0,1] x * x + y * y > x * y - 1"), both)
    assert "known in part only" in always.doubt
    rng = np.random.default_rng(0)
    many_values = stl.diagnose(stl.parse("G[0,1500] max(x, y) < 2"), {name: rng.random(1501) for name in "xy"})
    assert "too many" in many_values.doubt
    assert many_values.n_causes == 3002
    unneeded = stl.diagnose(stl.parse("G[0,1] (x > 2 | x <= 3)"), both)
    assert (unneeded.n_causes, unneeded.minimal) == (0, True)
    assert str(unneeded).endswith("causes: none: the verdict is the same on every trace")
    gap = {"x": [0.0, 1.0], "a": [1, 0]}
    guarded = stl.diagnose(stl.parse("a | F[0,1] 1 / x > 3"), gap)
    assert {name: steps.tolist() for name, steps in guarded.causes.items()} == {"a": [0], "x": []}


def test_what_the_trace_does_not_decide_is_not_told():
    log = {"a": [1, 0, 0, 0, 0, 0], "x": [1.0, 0, 2, 2, 2, 2]}
    leaf = stl.diagnose(stl.parse("F[0,2] a"), log, 1)
    assert leaf.sentences[-1].endswith("; last true at 0, not again, needed by 3")
    windowed = stl.diagnose(stl.parse("F[0,2] G[0,1] a"), log, 1)  # at step 5, G[0,1] a is open
    assert windowed.sentences[1] == (
        "  G[0,1] a fails at steps 1 … 3; never held before, needed by 3: a is false at steps 1 and 3"
    )
    undefined = stl.diagnose(stl.parse("F[0,1] 1 / x > 3"), log, 2)
    assert undefined.sentences[0].endswith("with x = 2; needed by 3")


def test_comparisons_of_several_steps():
    log = {"x": [0, 1, 5, 6.0], "a": [0, 1, 1, 1]}
    jump = stl.diagnose(stl.parse("G[0,2] (x[t+1] - x[t] <= 1)"), log)
    assert {name: steps.tolist() for name, steps in jump.causes.items()} == {"x": [1, 2]}
    assert "several steps" in jump.doubt
    assert jump.sentences[-1] == (
        "    x - x[t-1] <= 1 fails at step 2 with x = 5, x[t-1] = 1, short by 3; last held at 1, next at 3, needed by 2"
    )
    before = stl.diagnose(stl.parse("G[1,2] (x[t-1] > 1)"), log)
    assert ({name: steps.tolist() for name, steps in before.causes.items()}, before.minimal) == ({"x": [0]}, True)
    start = stl.diagnose(stl.parse("a & x[t-1] > 1"), log)  # false at step 0 on every trace
    assert (start.verdict, start.n_causes, start.minimal) == (False, 0, True)


def test_long_traces_take_no_time():
    rng = np.random.default_rng(0)
    trace = {"a": rng.random(100_000) < 0.1, "b": rng.random(100_000) < 0.5, "x": np.ones(100_000)}
    start = time.process_time()
    for text, most in (
        ("G[0,10000] F[0,100] a", 300),
        ("G[0,10000] (b -> F[0,100] a)", 300),
        ("F[0,9999] x < 1", 10_000),
    ):
        told = stl.diagnose(stl.parse(text), trace, 7)
        assert told.minimal
        assert 0 < told.n_causes <= most
    assert time.process_time() - start < 3  # a tenth of that here, on an idle machine


@pytest.mark.parametrize(
    ("call", "kind", "says"),
    [
        (
            lambda phi: stl.diagnose(phi, {"a": [1, 0, 1]}, 2),
            SettingsError,
            "step 2 is not judged: the trace has 3 samples",
        ),
        (lambda phi: stl.diagnose(phi, {"a": [[1, 0], [0, 1]]}), TraceError, "diagnose explains one trace"),
        (lambda phi: stl.diagnose(stl.parse("F[0,1] 1 / x > 2"), {"x": [0.0, 0]}), TraceError, "no value"),
        (lambda phi: stl.diagnose(phi, {"b": [1, 0]}), NameLookupError, "no signal a"),
        (lambda phi: stl.diagnose(phi, {"a": [1, 0]}, end="wrap"), SettingsError, "end"),
    ],
)
def test_bad_questions_are_refused(call, kind, says):
    with pytest.raises(kind, match=says):
        call(stl.parse("F[0,1] a"))
