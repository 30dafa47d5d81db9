"""Coverage of formulas: premises, windows, parts that mattered, and who is counted."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.internal.observability import with_observability_callback
from hypothesis.stateful import rule

import stltool as stl
from stltool.errors import StlToolError
from stltool.logic.formula import Constant, children, with_children
from stltool.monitoring.coverage import idle_premises
from stltool.testing import (
    Coverage,
    CoverageGap,
    Recorder,
    StlStateMachine,
    assert_covered,
    assert_trace,
    collect_coverage,
    formulas,
    traces,
)

ANSWERS = stl.parse("G[0,3] (request -> F[0,2] (level > 3))")


def trace(request, level):
    return {"request": [c == "r" for c in request], "level": [int(c) for c in level]}


def of(coverage):
    return {part.text: (part.held, part.failed, part.open, part.mattered) for part in coverage.parts}


def test_premises_windows_and_parts_are_counted():
    coverage = Coverage(ANSWERS)
    assert coverage.add(trace("......", "000000")) == ["request"]  # nothing was asked
    assert coverage.add(trace(".r....", "000500")) == []  # answered at step 3
    assert coverage.add(trace("..r...", "000000")) == []  # violated
    assert (coverage.traces, coverage.passed, coverage.vacuous) == (3, 2, 1)
    implication, request, answered, level = (of(coverage)[part.text] for part in coverage.parts)
    # by hand: steps 0 … 3 of each trace; the answer at 3 is in the windows of steps 1, 2 and 3
    assert implication == (11, 1, 0, 3)
    assert request == (2, 10, 0, 3)  # with `true` for it, the first trace would be violated
    assert answered == (3, 9, 0, 2)
    assert level == (1, 17, 0, 2)
    assert "3 traces: 2 passed, 1 of them vacuously (a premise" in coverage.report()


def test_windows_that_do_not_close_are_open():
    coverage = Coverage(stl.parse("a | F[0,4] b"))
    short = {"a": [True, False], "b": [False, False]}
    with pytest.raises(StlToolError, match="needs 5"):
        coverage.add(short)
    with pytest.raises(StlToolError, match="add's every is 1"):
        coverage.add(short, every=1)
    assert coverage.traces == 0
    assert of(coverage)["F[0,4] b"] == (0, 0, 0, 0)
    coverage.add(short, end="cut")
    assert of(coverage) == {"a": (1, 0, 0, 1), "F[0,4] b": (0, 1, 0, 0), "b": (0, 2, 3, 0)}


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("F[1,2] a", {"a": "34"}), ("G a", {"a": "2345"}), ("a U[1,2] b", {"a": "23", "b": "34"}),
        ("a release[0,2] b", {"a": "23", "b": "234"}), ("once[1,2] a", {"a": "01"}), ("historically a", {"a": "012"}),
        ("a since[1,2] b", {"a": "12", "b": "01"}), ("a trigger b", {"a": "012", "b": "012"}),
        ("rise a", {"a": "12"}), ("a & !b", {"a": "2", "b": "2"}), ("a | once[3,4] b", {"a": "2", "b": ""}),
        ("a U[0,0] b", {"a": "", "b": "2"}),
        ("F[1,2] once[0,1] a", {"a": "234"}), ("G[0,1] (a -> F[1,1] b)", {"a": "23", "b": "34"}),
    ],
)  # fmt: skip
def test_steps_are_those_that_the_formula_looks_at(text, steps):
    """At step 2 of six, by hand: at just these steps a signal is true, and so it held everywhere, or else nowhere."""
    phi = stl.parse(text, unbounded=True)
    for inside in (True, False):
        coverage = Coverage(phi)
        coverage.add(
            {name: [(str(t) in steps.get(name, "")) == inside for t in range(6)] for name in "ab"}, 2, end="cut"
        )
        counts = {part.text: (part.held, part.failed) for part in coverage.parts if part.text in steps}
        n = {name: len(at) for name, at in steps.items()}
        assert counts == {name: (n[name], 0) if inside else (0, n[name]) for name in steps}


def test_what_is_not_covered_is_told():
    coverage = Coverage(ANSWERS)
    coverage.add(trace("......", "000000"))
    with pytest.raises(CoverageGap) as gap:
        assert_covered(coverage)
    assert "the premise request held at no step" in str(gap.value)
    assert "level > 3 mattered in no trace" in str(gap.value)
    coverage.add(trace(".r....", "000500"))
    assert_covered(coverage)
    with pytest.raises(CoverageGap, match="the premise request held at 1 step"):
        assert_covered(coverage, at_least=2)


def parts(phi, path=()):
    for i, child in enumerate(children(phi)):
        yield (*path, i), child
        yield from parts(child, (*path, i))


def replaced(phi, path, new):
    if not path:
        return new
    below = list(children(phi))
    below[path[0]] = replaced(below[path[0]], path[1:], new)
    return with_children(phi, tuple(below))


@given(formulas(longest=2, max_leaves=4, past=True), traces(24, labels=["a", "b", "c"]))
def test_a_part_matters_if_a_constant_changes_the_verdict_by_the_reference_semantics(phi, trace):
    coverage = Coverage(phi)
    coverage.add(trace)
    found = [(path, part) for path, part in parts(phi) if not isinstance(part, Constant)]
    assert [counts.text for counts in coverage.parts] == [str(part) for _, part in found]
    for (path, _), counts in zip(found, coverage.parts, strict=True):
        verdicts = {stl.satisfies(replaced(phi, path, Constant(value)), trace) for value in (False, True)}
        assert counts.mattered == (verdicts != {stl.satisfies(phi, trace)})


def test_assertions_recorders_and_machines_are_counted():
    class Machine(StlStateMachine):
        formula, steer = "G (a -> F[0,1] b)", False

        @rule()
        def wait(self):
            """Nothing happens."""

        def observe(self):
            return {"a": True, "b": True}

    with collect_coverage() as found:
        assert_trace(ANSWERS, trace(".r....", "000500"))
        with pytest.raises(AssertionError):
            assert_trace(ANSWERS, trace(".r....", "000000"))
        with Recorder("F[0,9] x > 3", stop=True) as record:  # certain after two of ten samples
            record(x=1)
            record(x=5)
        with pytest.raises(AssertionError), Recorder("G[0,9] x < 3") as record:
            record(x=5)
        machine = Machine()
        machine._specification()
        machine.teardown()
    assert_trace(stl.parse("x > 0"), {"x": [1.0]})  # nobody collects any more
    counted = {text: (coverage.traces, coverage.passed) for text, coverage in found.items()}
    assert counted == {
        str(ANSWERS): (2, 1), "F[0,9] (x > 3)": (1, 1), "G[0,9] (x < 3)": (1, 0), "G[0,inf) (a -> (F[0,1] b))": (1, 1),
    }  # fmt: skip


@pytest.mark.parametrize("at", range(3))
def test_a_premise_that_holds_at_one_step_is_not_idle(at):
    phi = stl.parse("G[0,1] (a -> F[1,1] b)")
    assert idle_premises(phi, {"a": [t == at for t in range(3)], "b": [True] * 3}) == (["a"] if at == 2 else [])


def test_counts_of_several_processes_are_added():
    one, other = Coverage(ANSWERS), Coverage(ANSWERS)
    for coverage in (one, other):
        coverage.add(trace(".r....", "000500"))
        coverage.add(trace("...r", "0000"), end="cut")
        coverage.add(trace("......", "000000"))  # passes vacuously
    assert all(other.counts()[0])
    assert all(sum(counts) for counts in zip(*other.counts()[1:], strict=True))  # none is 0 throughout
    one.merge(other.counts())
    assert one.counts() == [[2 * count for count in row] for row in other.counts()]


def test_hypothesis_observes_what_traces_say():
    observed = []

    @settings(max_examples=4, deadline=None, database=None)
    @given(st.sampled_from((trace("......", "000000"), trace(".rr...", "000500"))))
    def answered(trace):
        assert_trace(ANSWERS, trace)

    with collect_coverage(), with_observability_callback(observed.append):
        answered()
    name = "G[0,3] (request -> (F[0,2] (level > 3)))"
    asked, mattered = f"{name}: steps at which the premise request held", f"{name}: {{}} mattered"
    parts = "request -> (F[0,2] (level > 3))", "request", "F[0,2] (level > 3)", "level > 3"
    told = [one.features for one in observed if one.type == "test_case"]
    idle = {
        f"{name} passes vacuously: request never holds": "",
        asked: 0,
        **dict.fromkeys(map(mattered.format, parts[:2]), ""),
    }
    busy = {asked: 2, **dict.fromkeys(map(mattered.format, parts), "")}
    assert idle in told
    assert busy in told
    assert all(one in (idle, busy) for one in told)


def counted(text, *traces, end=None):
    """What each expect line of a file counts."""
    task = stl.parse_task(text, unbounded=True)
    found = {}
    for expectation in task.expectations:
        coverage = Coverage(expectation.formula)
        for one in traces:
            coverage.add(one, end=end)
        found[expectation.written] = coverage.count(expectation)
    return found


def test_expectations_count_a_part_or_the_whole():
    """By hand: the traces of the first test."""
    text = """
        limit := G[0,3] level < 9
        answers := G[0,3] (request -> F[0,2] level > 3)
        expect cover(request) >= 1
        expect cover(request, failed) >= 1
        expect cover(level > 3, closed) >= 1
        expect cover(F[0,2] level > 3, mattered) >= 1
        expect cover(answers) >= 1
        expect cover(answers, failed) >= 1
        expect cover(answers, vacuous) <= 1
        expect cover(answers, premises) >= 1
        expect cover(answers, parts) >= 1
        expect cover(limit, parts) >= 1
    """
    traces = trace("......", "000000"), trace(".r....", "000500"), trace("..r...", "000000")
    assert list(counted(text, *traces).values()) == [2, 10, 18, 2, 2, 1, 1, 2, 2, 3]


def test_a_part_that_occurs_twice_counts_where_it_is_covered_least():
    text = "r := a & F[1,3] a\nexpect cover(a) >= 1\nexpect cover(a) < 3\nexpect cover(a, failed) > 1"
    assert list(counted(text, {"a": [1, 0, 1, 1]}).values()) == [1, 2, 0]


def test_what_is_not_counted_is_told():
    for text in ("r := a & b\nexpect cover(r, premises) >= 1", "r := a\nexpect cover(r, parts) >= 1"):
        with pytest.raises(StlToolError, match="nothing is counted; write cover with a part of the formula"):
            counted(text, {"a": [1], "b": [1]})


@given(formulas(longest=2, max_leaves=4, past=True), traces(12, labels=["a", "b", "c"]))
def test_every_step_is_counted_as_one_formula_over_all_of_them(phi, trace):
    """Judged at every step, a trace says what it says of G over these steps, judged at the first."""
    every, whole = Coverage(phi), Coverage(stl.G(phi, 0, 11 - stl.horizon(phi)))
    assert every.add(trace, every=True) == whole.add(trace)
    assert (every.passed, every.vacuous) == (whole.passed, whole.vacuous)
    assert of_all(every.parts) == of_all(whole.parts[len(whole.parts) - len(every.parts) :])


def of_all(parts):
    return [(part.text, part.held, part.failed, part.open) for part in parts]
