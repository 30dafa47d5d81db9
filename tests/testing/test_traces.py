"""Traces: in their ranges, no faster than allowed, with the wanted verdict, none of them rejected."""

import collections
import itertools
import random
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, find, given, settings, statistics
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import InfeasibleError, NameLookupError, SettingsError, SizeError
from stltool.logic.formula import Not, horizon
from stltool.numbers import shortest
from stltool.testing import (
    expectations,
    flag_formulas,
    formulas,
    interval_mdps,
    mdps,
    satisfying_traces,
    task_files,
    traces,
    violating_traces,
)
from stltool.testing.constructive import Constructor, NoTraceError, near
from stltool.testing.traces import slowed
from tests.conftest import many

RESPONSE = stl.parse("G[0,3] (request -> F[0,1] level > 3)")
RANGES = {"x": (-1, 2), "y": (0, 1)}


def drawn(strategy, n=25):
    """What Hypothesis draws, and how the test cases ended."""
    found, ended = [], []
    quiet = settings(max_examples=n, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
    test = quiet(given(strategy)(lambda one: found.append(one)))
    with statistics.collector.with_value(ended.append):
        test()
    return found, collections.Counter(case["status"] for one in ended for case in one["generate-phase"]["test-cases"])


@given(
    phi=formulas(labels=("a", "b"), signals=RANGES, longest=2, max_leaves=3, past=True),
    verdict=st.booleans(),
    within=st.sampled_from([None, None, 0.5, 0]),
    data=st.data(),
)
@settings(max_examples=many(100))
def test_traces_have_the_verdict_asked_for(phi, verdict, within, data):
    build = satisfying_traces if verdict else violating_traces
    try:
        strategy = build(phi, RANGES, labels=("a", "b"), within=within)
    except InfeasibleError as nothing:
        assert nothing.sure
        trace = data.draw(traces(horizon(phi) + 1, labels=("a", "b"), signals=RANGES))
        assert stl.satisfies(phi, trace) != verdict or (within is not None and abs(stl.robustness(phi, trace)) > within)
        return
    trace = data.draw(strategy)
    assert stl.satisfies(phi, trace) == verdict
    assert set(trace) == {"a", "b", "x", "y"}
    assert all(RANGES[name][0] <= value <= RANGES[name][1] for name in RANGES for value in trace[name])
    if within is not None:
        assert 0 <= stl.robustness(phi, trace) * (1 if verdict else -1) <= within


@pytest.mark.parametrize("verdict", [True, False])
@pytest.mark.parametrize("text", ["F[0,3] x^2 + y^2 <= 1", "a U[0,3] 2 * x + y == 4.1"])
def test_comparisons_of_all_kinds(text, verdict):
    phi = stl.parse(text)
    made = Constructor(
        phi if verdict else Not(phi), {"x": (Fraction(0), Fraction(4)), "y": (Fraction(-2), Fraction(2))}
    )
    rng = random.Random(1)
    for _ in range(10):
        trace = made.build(rng.randrange)
        assert stl.satisfies(phi, trace) == verdict


@pytest.mark.parametrize(
    "text",
    [
        *(f"x * x {op} 4" for op in ("<", "<=", ">", ">=", "==", "!=")),
        "min(x, y) > 2", "min(x, y) <= 2", "max(x, y, 3) < 5", "max(x, 2 * y) >= 7", "abs(x - y) < 1",
        "3 * x >= 2 & 5 * x < 4", "x > 7 & 4 * x < 29",
        "x > 2 & x >= 2", "x >= 2 & x > 2", "x < 3 & x <= 3", "x + y < 3 & x + y <= 3 & y >= 1",
    ],
)  # fmt: skip
def test_borders_are_on_the_right_side(text):
    """Simplest values, ends of intervals and others, for the formula and its negation."""
    rng, ranges = np.random.default_rng(0), {name: (Fraction(0), Fraction(9)) for name in "xy"}
    for phi in (stl.parse(text), Not(stl.parse(text))):
        made = Constructor(phi, ranges)
        for draw in (lambda n: 0, *[lambda n: int(rng.integers(n))] * 40):
            assert stl.satisfies(phi, made.build(draw))


def test_every_part_of_a_region_is_drawn_from():
    rng, made = np.random.default_rng(0), Constructor(stl.parse("x != 4"), {"x": (Fraction(0), Fraction(9))})
    drawn_ = [made.build(lambda n: int(rng.integers(n)))["x"][0] for _ in range(60)]
    assert min(drawn_) < 4 < max(drawn_)


def test_near_misses_are_near_and_no_nearer_than_they_can_be():
    phi = stl.parse("G[0,9] level < 7")
    for build, sign in ((satisfying_traces, 1), (violating_traces, -1)):
        found, _ = drawn(build(phi, {"level": (0, 9)}, within="1/100"), 20)
        assert all(0 <= sign * stl.robustness(phi, trace) <= 0.01 for trace in found)
    with pytest.raises(InfeasibleError, match=r"no trace violates F\[0,2\] a with robustness within 0.1 of 0,"):
        violating_traces(stl.parse("F[0,2] a"), within=0.1)  # the margins of labels are infinite
    assert NoTraceError("", True).sure
    again = near(phi, Fraction(1, 100))
    assert stl.satisfies(again, {"level": [0.0] * 9 + [6.995]})
    assert not stl.satisfies(again, {"level": [0.0] * 10})


@pytest.mark.parametrize(
    "strategy",
    [
        satisfying_traces(RESPONSE),
        violating_traces(RESPONSE, {"level": (0, 9)}, within=0.25),
        violating_traces(stl.parse("F[0,5] (a & prev b)"), steps=9),
        traces(8, signals={"x": st.floats(0, 9)}, most_change={"x": 0.5}),
        traces(st.integers(1, 9), signals={"x": (0, 9)}, most_change={"x": 0.5}),
        formulas(past=True), formulas(depth=2, horizon=4), flag_formulas(), mdps(), mdps(exact=True), interval_mdps(),
        task_files(), expectations(),
    ],
    ids=range(13),
)  # fmt: skip
def test_no_draw_is_rejected(strategy):
    found, ended = drawn(strategy)
    assert ended["invalid"] == 0
    assert ended["valid"] == len(found) > 5


def test_the_step_at_which_the_verdict_becomes_certain_is_uniform():
    made = Constructor(stl.parse("F[0,9] a"), {})
    assert made.certain == list(range(10))
    rng, n = random.Random(2), 1000
    first = collections.Counter(int(np.argmax(made.build(rng.randrange)["a"])) for _ in range(n))
    assert all(abs(first[d] - n / 10) < 5 * (n * 0.1 * 0.9) ** 0.5 for d in range(10))


def shortest_of(strategy, condition):
    return find(strategy, condition, settings=settings(max_examples=many(250), database=None))


def test_shrunk_traces_are_short_and_simple():
    trace = shortest_of(violating_traces(RESPONSE), lambda trace: True)
    assert np.flatnonzero(trace["request"]).tolist() == [0]
    assert set(trace["level"].tolist()) == {0.0}
    trace = shortest_of(satisfying_traces(stl.parse("F[0,3] (b & x > 3)")), lambda trace: trace["b"].sum() >= 2)
    assert (trace["b"].sum(), sorted(trace["x"].tolist())) == (2, [0.0, 0.0, 0.0, 4.0])
    trace = shortest_of(traces(3, signals={"x": (0, 9)}), lambda trace: (trace["x"] > 5).any())
    assert sorted(trace["x"].tolist())[:2] == [0.0] * 2
    assert len(str(trace["x"].max())) == 3


@given(data=st.data(), change=st.sampled_from([0, 0.1, 0.5, "1/3"]))
@settings(max_examples=many(100))
def test_signals_move_no_faster_than_allowed(data, change):
    values = data.draw(st.sampled_from([(0, 9), (-0.1, None), st.floats(0, 9), st.sampled_from([0, 5]), (0.3, 0.3)]))
    trace = data.draw(traces(6, ["a"], {"x": values, "y": (0, 1)}, {"x": change}))
    column = [shortest(value) for value in trace["x"].tolist()]
    assert all(abs(after - before) <= Fraction(change if change == "1/3" else str(change))
               for before, after in itertools.pairwise(column))  # fmt: skip
    assert min(column) >= Fraction("-0.1")
    assert values == (-0.1, None) or max(column) <= 9


def test_rounding_moves_no_signal_too_fast():
    rng = random.Random(3)
    column = [shortest(value) for value in slowed([rng.uniform(0, 9) for _ in range(300)], Fraction(1, 3))]
    assert max(abs(after - before) for before, after in itertools.pairwise(column)) <= Fraction(1, 3)


def test_ranges_and_names():
    assert {tuple(trace) for trace in drawn(traces(2), 3)[0]} == {("a", "b", "c", "x", "y")}
    assert {tuple(trace) for trace in drawn(traces(2, signals={"x": (0, 1)}), 3)[0]} == {("x",)}
    found, _ = drawn(satisfying_traces(stl.parse("F[0,2] x > 1"), {"x": st.floats(0, 3), "speed": (5, 6)}, ["on"], 5))
    assert all(len(trace["on"]) == 5 and trace["speed"].min() >= 5 and trace["x"].max() <= 3 for trace in found)


@pytest.mark.parametrize(
    ("make", "kind", "said"),
    [
        (lambda: traces(-1), SettingsError, "traces' steps is -1; it must be an integer from 0"),
        (lambda: traces(3, signals={"x": (9, 0)}), SettingsError, "the range of x is empty: 9 is above 0"),
        (lambda: traces(3, signals={"x": 5}), SettingsError, "the range of x is 5; give the lowest and the highest"),
        (lambda: traces(3, signals={"x": ("a", 1)}), SettingsError, "the range of x: 'a' is not a number"),
        (lambda: traces(3, signals={"x": ("1/3", "1/3")}), SettingsError, "has no value that a double can hold"),
        (lambda: traces(3, most_change={"x": 1}), NameLookupError, "most_change names x, which has no range"),
        (lambda: traces(3, signals={"x": (0, 1)}, most_change={"x": -1}), SettingsError, "give 0 or more"),
        (lambda: find(traces(3, signals={"x": st.just("a")}), bool), SettingsError, "the strategy of x drew 'a'"),
        (lambda: find(traces(3, signals={"x": st.just(np.nan)}), bool), SettingsError, "allow_nan=False"),
        (lambda: satisfying_traces(stl.parse("G x > 1")), stl.StlToolError, "needs an interval with an end"),
        (lambda: satisfying_traces("F[0,2] a"), stl.StlToolError, "parse it: stl.parse"),
        (lambda: satisfying_traces(stl.parse("x - x[t-1] > 1")), SettingsError, "give the change a signal of its own"),
        (lambda: satisfying_traces(stl.parse("F[0,9] x > 1"), steps=3), SettingsError, "an integer from 10"),
        (lambda: satisfying_traces(stl.parse("x > 1"), within=-1), SettingsError, "within is -1; give 0 or more"),
        (lambda: satisfying_traces(stl.parse("x > 1"), within="much"), SettingsError, "give a robustness"),
        (lambda: satisfying_traces(stl.parse("x > 1"), {"x": st.integers(0, 9)}), SettingsError,
         "or a strategy that has them"),
        (lambda: satisfying_traces(stl.parse("G[0,3] x > 20"), {"x": (0, 9)}), InfeasibleError,
         r"no trace satisfies G\[0,3\] \(x > 20\) with signals in their ranges; give other ranges"),
        (lambda: violating_traces(stl.parse("x^2 + 1 >= 0")), InfeasibleError, "no trace was found that violates"),
        (lambda: satisfying_traces(stl.parse(" & ".join(f"l{i}" for i in range(20)))), SizeError, "20 labels"),
        (lambda: satisfying_traces(stl.parse("a & a > 0.5")), SettingsError, "a: a name is either a label"),
        (lambda: satisfying_traces(stl.parse("a"), {"a": (0, 1)}), SettingsError, "a: a name is either a label"),
        (lambda: satisfying_traces(stl.parse("x > 1"), labels=["x"]), SettingsError, "x: a name is either a label"),
        (lambda: satisfying_traces(stl.parse("F[0,100000] a")), SizeError, "over 100000 steps are not built"),
        (lambda: satisfying_traces(stl.parse("x*y*z*w*u*v > 1")), SettingsError, "compare fewer of them"),
    ],
)  # fmt: skip
def test_what_is_not_a_range_or_has_no_trace_is_told(make, kind, said):
    with pytest.raises(kind, match=said):
        make()


SPEEDS = [Fraction(1, 2), Fraction(1), Fraction(3, 2)]


def slow_enough(column, most):
    values = [shortest(float(value)) for value in column]
    return all(abs(b - a) <= most for a, b in itertools.pairwise(values))


@given(
    phi=formulas(labels=("a",), signals={"x": (-2, 2), "y": (-1, 1)}, longest=2, max_leaves=3, past=True, horizon=4),
    verdict=st.booleans(),
    most=st.sampled_from(SPEEDS),
    more=st.integers(0, 2),
    data=st.data(),
)
@settings(max_examples=many(60))
def test_traces_with_a_verdict_change_as_slowly_as_asked(phi, verdict, most, more, data):
    build, n = satisfying_traces if verdict else violating_traces, horizon(phi) + 1 + more
    ranges, changes = {"x": (-2, 2), "y": (-1, 1)}, {"x": most, "y": Fraction(1, 4)}
    try:
        trace = data.draw(build(phi, ranges, ("a",), steps=n, most_change=changes))
    except InfeasibleError as nothing:
        assert nothing.sure
        return  # test_what_is_possible_slowly_is_found
    assert stl.satisfies(phi, trace) == verdict
    assert len(trace["x"]) == n
    for name, change in changes.items():
        assert slow_enough(trace[name], change)
        assert all(ranges[name][0] <= value <= ranges[name][1] for value in trace[name])


@given(
    phi=formulas(labels=(), signals={"x": (-2, 2)}, longest=2, max_leaves=3, past=True, horizon=3),
    verdict=st.booleans(),
    most=st.sampled_from(SPEEDS),
)
@settings(max_examples=many(40))
def test_what_is_possible_slowly_is_found(phi, verdict, most):
    """Against every trace over a grid: if one has the verdict, some trace is found; if none is found, none has it."""
    grid = [Fraction(k, 2) for k in range(-4, 5)]
    columns = [column for column in itertools.product(grid, repeat=horizon(phi) + 1) if slow_enough(column, most)]
    some = any(
        stl.satisfies(phi, {"x": np.array(column, dtype=float)}) == verdict
        for column in columns[:: 1 + len(columns) // 400]
    )
    try:
        (satisfying_traces if verdict else violating_traces)(phi, {"x": (-2, 2)}, most_change={"x": most})
    except InfeasibleError:
        assert not some


def test_a_slow_signal_takes_its_time():
    """By hand: from 0 at most to 6 within three steps of 2, and back again as slowly."""
    phi = stl.parse("x <= 0 & F[0,3] x >= 6 & F[4,6] x <= 0")
    (trace, *_), _ = drawn(satisfying_traces(phi, {"x": (0, 9)}, most_change={"x": 2}), 1)
    assert trace["x"].tolist() == [0, 2, 4, 6, 4, 2, 0]
    with pytest.raises(InfeasibleError, match="no trace satisfies"):
        satisfying_traces(phi, {"x": (0, 9)}, most_change={"x": 1.9})
    strictly = stl.parse("x < 1 & F[1,1] x > 2")
    with pytest.raises(InfeasibleError):
        satisfying_traces(strictly, {"x": (0, 9)}, most_change={"x": 1})
    assert drawn(satisfying_traces(strictly, {"x": (0, 9)}, most_change={"x": 1.001}), 5)[1]["invalid"] == 0


def test_slow_signals_are_compared_with_numbers_alone():
    for text in ("G[0,3] x + y > 1", "G[0,3] x * x > 2"):
        with pytest.raises(SettingsError, match="most_change of x: .* compared with numbers alone, linearly"):
            satisfying_traces(stl.parse(text), {"x": (0, 9), "y": (0, 9)}, most_change={"x": 1})
    with pytest.raises(NameLookupError, match="most_change names z"):
        satisfying_traces(stl.parse("x > 1"), {"x": (0, 9)}, most_change={"z": 1})
    with pytest.raises(SizeError, match="most_change is too much work"):
        violating_traces(stl.parse("G[0,9000] (x > 1 -> F[0,50] x > 2)"), {"x": (0, 9)}, most_change={"x": 1})
