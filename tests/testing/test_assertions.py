"""Assertions fail with an explanation: why a trace fails, what makes a policy fail, where two formulas differ."""

import inspect
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.logic.formula import And, Not
from stltool.testing import (
    FormulasDiffer,
    ProbabilityViolation,
    StlAssertionError,
    TraceViolation,
    assert_equivalent,
    assert_probability,
    assert_refines,
    assert_trace,
    assertions,
    formulas,
    traces,
)
from tests.conftest import many


def message(kind, function, *given, **options):
    with pytest.raises(AssertionError) as raised:
        function(*given, **options)
    assert type(raised.value) is kind
    return str(raised.value)


def test_a_trace_that_violates_is_diagnosed():
    phi = stl.parse("G[0,20] (request -> F[0,5] level > 3)")
    trace = {"level": [0.0] * 30, "request": [step == 7 for step in range(30)]}
    assert (
        message(TraceViolation, assert_trace, phi, trace)
        == """\
G[0,20] (request -> (F[0,5] (level > 3))) fails at step 0, robustness -3

  G[0,20] (request -> (F[0,5] (level > 3))) fails at step 0:
    request -> (F[0,5] (level > 3)) fails at step 7:
      request is true at step 7
      F[0,5] (level > 3) fails at step 7:
        level > 3 fails throughout steps 7 … 12 with level = 0; never held before, not again, needed by 12
  causes: level at steps 7 … 12, request at step 7 (7 samples, a minimal set)

  step                                  012345678901234567890123456789
  G[0,20] (request -> (F[0,5] (leve...  .....
  request -> (F[0,5] (level > 3))       #######.#################
  F[0,5] (level > 3)                    .........................
  request                               .......#......................
  level > 3                             ..............................
  causes                                       ^^^^^^"""
    )
    assert_trace(phi, {**trace, "level": [4.0] * 30})


def test_the_timeline_shows_the_steps_around_the_causes():
    values = np.ones(500)
    values[321] = 0
    text = message(TraceViolation, assert_trace, stl.parse("G[0,400] x > 0"), {"x": values})
    assert "\n  step 313 …        34567890123" in text
    assert "\n  x > 0             ########.##" in text
    assert "\n  causes                    ^" in text
    many_parts = stl.parse(" & ".join(f"F[0,{n}] l{n}" for n in range(12)))
    text = message(TraceViolation, assert_trace, many_parts, {f"l{n}": [0] * 12 for n in range(12)})
    assert text.endswith("more parts")


def test_traces_are_judged_as_monitors_judge_them():
    x = {"x": [1.0, 1.0, 0.0]}
    assert_trace(stl.parse("F[0,9] x < 1"), x, end="cut")
    assert_trace(stl.parse("G[0,9] x < 1"), x, t=2, end="hold")
    with pytest.raises(TraceViolation, match="fails at step 1"):
        assert_trace(stl.parse_task("low := G[0,1] x < 1"), x, 1)
    with pytest.raises(TraceViolation, match="fails at step 2") as raised:
        assert_trace(stl.parse("F[0,9] x > 0.5"), x, 2, end="hold")
    assert raised.value.diagnosis.causes["x"].tolist() == [2]
    with pytest.raises(TraceError):
        assert_trace(stl.parse("F[0,9] x < 1"), x)
    with pytest.raises(NameLookupError):
        assert_trace(stl.parse("F[0,9] y < 1"), x)
    assert_trace(stl.parse("true"), x)
    assert message(TraceViolation, assert_trace, stl.parse("false"), x).startswith("false fails at step 0")


@given(phi=formulas(max_leaves=3, longest=2, past=True), data=st.data())
@settings(max_examples=many(60))
def test_a_trace_passes_if_and_only_if_it_satisfies(phi, data):
    trace = data.draw(traces(stl.horizon(phi) + 1))
    if stl.satisfies(phi, trace):
        assert_trace(phi, trace)
    else:
        assert "causes" in message(TraceViolation, assert_trace, phi, trace)


@pytest.fixture(scope="module")
def product():
    model = stl.MDP.from_arrays([[["0.1", "0.9"], ["0.2", "0.8"]]], {"x": [0, 1]}, labels={"goal": [0, 1]})
    return stl.build_product(model, stl.parse("F[0,2] goal"))


def test_a_probability_fails_with_the_most_probable_run(product):
    assert (
        message(ProbabilityViolation, assert_probability, product, at_least=0.995)
        == """\
P(F[0,2] goal) = 0.99, the maximum over all policies, is not at least 0.995
  enclosure  0.99 … 0.9900000000000001
  the most probable violation, probability 0.01, 100 % of P(violation), violated at step 2:
    2 × 0 0 → 0
    before the verdict: goal not seen yet"""
    )
    text = message(ProbabilityViolation, assert_probability, product, at_most=Fraction(19, 20))
    assert "is not at most 0.95\n" in text
    assert "the most probable satisfaction, probability 0.9, 90.9 %" in text
    with pytest.raises(ProbabilityViolation, match="of the policy, is not at least") as raised:
        assert_probability(product, stl.check(product).policy, at_least=1)
    assert raised.value.result.question == "policy"
    assert raised.value.likely.runs[0].states == (0, 0, 0)


def test_a_bound_inside_the_enclosure_is_decided_by_the_fraction(product, monkeypatch):
    exactly = Fraction(99, 100)
    assert assert_probability(product, at_least=exactly).fraction == exactly
    assert assert_probability(product, at_least=exactly, at_most=exactly).probability == 0.99
    assert assert_probability(product, at_least=0.98).fraction is None
    monkeypatch.setattr(assertions, "_PATIENCE", 0.0)
    assert "is not known to be at least 0.99: the bound lies inside the enclosure" in message(
        ProbabilityViolation, assert_probability, product, at_least=exactly
    )


def test_a_task_that_cannot_be_violated(product):
    sure = stl.build_product(product.model, stl.parse("F[0,2] (goal | x >= 0)"))
    assert_probability(sure, at_least=1)
    assert "probability 1" in message(ProbabilityViolation, assert_probability, sure, at_most=0.5)
    with pytest.raises(SettingsError, match="has no bound; give at_least=0.95"):
        assert_probability(sure)
    with pytest.raises(SettingsError, match="assert_probability's at_least is 'high'"):
        assert_probability(sure, at_least="high")


def test_probabilities_in_intervals_are_judged_at_their_worst():
    lower, upper = [[[0, 0.5], [0, 1]]], [[[0.5, 1], [0, 1]]]
    model = stl.MDP.from_intervals(lower, upper, {}, labels={"goal": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,1] goal"))
    assert assert_probability(product, at_least=0.49, at_most=1).nature == "with"
    text = message(ProbabilityViolation, assert_probability, product, at_least=0.6)
    assert "is not at least 0.6\n" in text
    assert text.endswith("with adversarial nature")
    assert "with cooperative nature" in message(ProbabilityViolation, assert_probability, product, at_most=0.9)


def test_formulas_that_differ_have_a_trace():
    text = message(FormulasDiffer, assert_equivalent, stl.parse("F[0,3] a"), stl.parse("F[0,2] a"))
    assert text.startswith(
        "F[0,3] a and F[0,2] a differ; F[0,3] a holds and F[0,2] a fails on\n\n  {'a': [False, False, False, True]}\n"
    )
    assert "needed by 2" in text
    with pytest.raises(FormulasDiffer, match="does not refine") as raised:
        assert_refines(stl.parse("F[0,3] x > 1"), stl.parse("F[0,3] x > 2"), {"x": (0, 9)})
    assert 1 < raised.value.trace["x"].max() <= 2
    assert_refines(stl.parse("F[0,3] x > 1"), stl.parse("F[0,3] x > 2"), {"x": (5, 9)})
    assert_refines(stl.parse("F[0,2] x > 2"), stl.parse("F[0,3] x > 1"))
    assert_equivalent(stl.parse("a U[0,3] b"), stl.parse("!(!a release[0,3] !b)"))
    assert_equivalent(stl.parse("G[0,2] abs(x - y) < 1"), stl.parse("G[0,2] (x - y < 1 & y - x < 1)"))
    assert_equivalent(stl.parse("x > 1"), stl.parse("x > 1"))
    assert_refines(stl.parse("false"), stl.parse("a"))


def test_what_is_not_decided_fails_and_says_so():
    left, right = stl.parse("F[0,2] x * y > 2"), stl.parse("F[0,2] y * x > 2")
    text = message(FormulasDiffer, assert_equivalent, left, right)
    assert text.startswith("not decided whether F[0,2] (x * y > 2) and F[0,2] (y * x > 2) differ: no trace was found")
    assert "not linear" in text
    assert message(FormulasDiffer, assert_refines, stl.parse("7 * x + 3 * y == 1"), stl.parse("false"))
    faster, rising = stl.parse("G[1,2] x[t] - x[t-1] > 1"), stl.parse("G[1,2] x[t] - x[t-1] > 0")
    assert_refines(faster, rising)
    assert "several steps" in message(FormulasDiffer, assert_refines, rising, faster)
    with pytest.raises(FormulasDiffer, match="holds and F"):
        assert_refines(left, stl.parse("F[0,2] x * y > 3"), {"x": (0, 2), "y": (0, 2)})
    with pytest.raises(stl.StlToolError, match="interval"):
        assert_refines(stl.parse("F a", unbounded=True), left)


@given(phi=formulas(labels=("a",), signals={"x": (0, 3)}, max_leaves=2, longest=2), data=st.data())
@settings(max_examples=many(60))
def test_formulas_differ_if_and_only_if_a_trace_says_so(phi, data):
    psi = data.draw(formulas(labels=("a",), signals={"x": (0, 3)}, max_leaves=2, longest=2))
    try:
        assert_equivalent(phi, psi, {"x": (0, 3)})
    except FormulasDiffer as error:
        assert stl.satisfies(phi, error.trace) != stl.satisfies(psi, error.trace)
    else:
        steps = max(stl.horizon(phi), stl.horizon(psi)) + 1
        trace = data.draw(traces(steps, labels=("a",), signals={"x": (0, 3)}))
        assert stl.satisfies(phi, trace) == stl.satisfies(psi, trace)
    assert_equivalent(Not(Not(phi)), phi)


@given(
    phi=formulas(labels=("a",), signals={"x": (0, 1)}, max_leaves=2, longest=1, past=True),
    psi=formulas(labels=("a",), signals={"x": (0, 1)}, max_leaves=2, longest=1, past=True),
)
@settings(max_examples=many(60))
def test_formulas_refine_each_other_if_and_only_if_the_contrary_has_no_meaning(phi, psi):
    try:
        assert_refines(phi, psi)
        refines = True
    except FormulasDiffer:
        refines = False
    can_hold = stl.meaning(And((phi, Not(psi)))).can_hold  # decided by other means (automata/vacuity.py)
    assert can_hold is None or can_hold != refines


def test_every_assertion_is_one_and_hides_its_frames():
    kinds = [TraceViolation, ProbabilityViolation, FormulasDiffer]
    assert all(issubclass(kind, StlAssertionError) and issubclass(kind, AssertionError) for kind in kinds)
    for function in (assert_trace, assert_probability, assert_equivalent, assert_refines):
        assert "__tracebackhide__ = True" in inspect.getsource(function)
