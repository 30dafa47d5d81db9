"""Monitors against RTAMT: its recorded answers, and RTAMT itself where it is installed."""

import json
import tomllib
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import StlToolError
from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    Call,
    Comparison,
    Eventually,
    Historically,
    Implies,
    Interval,
    Not,
    Number,
    Once,
    Or,
    Rise,
    Since,
    Until,
    Variable,
)
from tests.conftest import DATA, OUTSIDE, many, needs_outside
from tests.monitoring.test_monitor import close

RECORDED = tomllib.loads((DATA / "rtamt.toml").read_text(encoding="utf-8"))
CASES = "stl/rtamt_tests_discrete_offline.json"
POSITIVE_A, POSITIVE_B = stl.parse("a > 0"), stl.parse("b > 0")
ENDLESS = Interval(0, None)

# RTAMT's formula: ours, a number f standing for f > 0
SAME = {
    "abs(a)": "abs(a) > 0", "a + b": "a + b > 0", "a * b": "a * b > 0", "a / b": "a / b > 0", "(a - b)": "a - b > 0",
    "sqrt(a)": "sqrt(a) > 0", "pow(a, b)": "a ^ b > 0", "5.0": "5 > 0", "not(a)": "!(a > 0)",
    "a and b": "a > 0 & b > 0", "a or b": "a > 0 | b > 0", "a -> b": "a > 0 -> b > 0",
    "a > b": "a > b", "a >= b": "a >= b", "a < b": "a < b", "a <= b": "a <= b", "a == b": "a == b", "a !== b": "a != b",
    "next(a)": "G[1,1] (a > 0)",  # true at the last step
    "always[0,1](a)": "G[0,1] (a > 0)", "eventually[0,1](a)": "F[0,1] (a > 0)",
    "a until[0,1] b": "a > 0 U[0,1] (b > 0)",
    "always(a)": Always(ENDLESS, POSITIVE_A), "eventually(a)": Eventually(ENDLESS, POSITIVE_A),
    "always[1,3](a)": "G[1,3] (a > 0)", "eventually[2,4](a)": "F[2,4] (a > 0)",
    "a until[1,3] b": "a > 0 U[1,3] (b > 0)",
    "a until b": Until(ENDLESS, POSITIVE_A, POSITIVE_B),
}  # fmt: skip
PAST = {
    "historically(a)": "historically (a > 0)", "historically[0,1](a)": "historically[0,1] (a > 0)",
    "historically[1,2](a)": "historically[1,2] (a > 0)", "once(a)": "once (a > 0)", "once[0,1](a)": "once[0,1] (a > 0)",
    "once[1,2](a)": "once[1,2] (a > 0)", "prev(a)": "historically[1,1] (a > 0)",  # RTAMT's prev is true at step 0
    "rise(a)": "rise (a > 0)", "fall(a)": "fall (a > 0)", "a since b": "a > 0 since (b > 0)",
    "a since[0,1] b": "a > 0 since[0,1] (b > 0)",
}  # fmt: skip
OTHERS = {"exp(a)"}  # a function that we do not have
ANOTHER = {"a iff b": "a > 0 <-> b > 0", "a xor b": "a > 0 xor b > 0"}  # RTAMT has -|a - b| and |a - b|


def agrees(text, signals, expected):
    """Ours on the same trace: the same robustness, or what is known to differ."""
    if text in PAST:
        found = [stl.robustness(stl.parse(PAST[text]), signals, t) for t in range(len(expected))]
        assert found == stl.monitor(stl.parse(PAST[text]), signals).robustness.tolist() == expected
    elif text in OTHERS:
        for number in (text, f"{text} > 0"):
            with pytest.raises(StlToolError):
                stl.parse(number)
    elif text in SAME:
        ours = SAME[text]
        found = stl.monitor(stl.parse(ours) if isinstance(ours, str) else ours, signals, end="cut")
        assert found.robustness == pytest.approx(expected, rel=1e-15), text
        assert all(v == (m > 0) for v, m in zip(found.verdicts, expected, strict=True) if m != 0), text
    else:
        a, b = (np.array(signals[name]) for name in "ab")
        assert expected == ((-1) ** (text == "a iff b") * np.abs(a - b)).tolist()
        found = stl.monitor(stl.parse(ANOTHER[text]), signals, end="cut").robustness
        both = np.minimum(np.maximum(-a, b), np.maximum(a, -b))
        assert found.tolist() == (both if text == "a iff b" else -both).tolist() != expected


@pytest.mark.parametrize("text", RECORDED["robustness"])
def test_recorded_answers_of_rtamt(text):
    answer = RECORDED["robustness"][text]
    agrees(text, RECORDED["signals"][answer["on"]], answer["values"])


def test_every_formula_has_a_recorded_answer():
    assert set(RECORDED["robustness"]) == {*SAME, *PAST, *OTHERS, *ANOTHER}


@needs_outside(CASES)
def test_the_expected_lists_of_rtamt():
    cases = json.loads((OUTSIDE / CASES).read_text(encoding="utf-8"))["cases"]
    assert len(cases) == 40
    assert {case["formula"] for case in cases} <= {*SAME, *PAST, *OTHERS, *ANOTHER}
    for case in cases:
        agrees(case["formula"], case["signals"], [float(value) for value in case["expected"]])


def rtamt():
    """The package; its parser's run time warns when it is imported, or cannot be, depending on the Python."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("rtamt", exc_type=ImportError)


def rtamt_text(phi):
    match phi:
        case Variable(name):
            return name
        case Number(value):
            return str(value)
        case Call("abs", (arg,)):
            return f"abs({rtamt_text(arg)})"
        case Arithmetic(op, left, right):
            return f"({rtamt_text(left)} {op} {rtamt_text(right)})"
        case Comparison(op, left, right):
            return f"({rtamt_text(left)} {'!==' if op == '!=' else op} {rtamt_text(right)})"
        case Not(arg):
            return f"(not {rtamt_text(arg)})"
        case And(args) | Or(args):
            return "(" + (" and " if isinstance(phi, And) else " or ").join(map(rtamt_text, args)) + ")"
        case Implies(left, right):
            return f"({rtamt_text(left)} -> {rtamt_text(right)})"
        case Eventually(interval, arg) | Always(interval, arg):
            word = "eventually" if isinstance(phi, Eventually) else "always"
            return f"({word}{rtamt_interval(interval)}({rtamt_text(arg)}))"
        case Until(interval, left, right):
            return f"({rtamt_text(left)} until{rtamt_interval(interval)} {rtamt_text(right)})"
        case Once(Interval(1, 1), arg):
            return f"(s_prev({rtamt_text(arg)}))"
        case Once(interval, arg) | Historically(interval, arg):
            word = "once" if isinstance(phi, Once) else "historically"
            return f"({word}{rtamt_interval(interval)}({rtamt_text(arg)}))"
        case Since(interval, left, right):
            return f"({rtamt_text(left)} since{rtamt_interval(interval)} {rtamt_text(right)})"
        case Rise(Not(arg)):
            return f"(fall({rtamt_text(arg)}))"
        case Rise(arg):
            return f"(rise({rtamt_text(arg)}))"
        case _:
            raise ValueError(f"RTAMT means something else by {phi}")


def rtamt_interval(interval):
    return "" if interval.b is None else str(interval)


def common_formulas():
    """What both languages have and mean alike."""
    terms = st.recursive(
        st.sampled_from("xy").map(Variable) | st.sampled_from([0.0, 0.5, 2.0]).map(Number),
        lambda below: (
            st.builds(Arithmetic, st.sampled_from("+-*"), below, below) | below.map(lambda arg: Call("abs", (arg,)))
        ),
        max_leaves=3,
    )
    pairs = st.tuples(st.integers(0, 4), st.integers(0, 4)).map(lambda pair: Interval(min(pair), max(pair)))
    intervals = pairs | st.just(ENDLESS)

    def grow(below):
        return st.one_of(
            below.map(Not),
            st.lists(below, min_size=2, max_size=3).map(tuple).flatmap(lambda a: st.sampled_from([And(a), Or(a)])),
            st.builds(Implies, below, below),
            st.builds(Eventually, intervals, below),
            st.builds(Always, intervals, below),
            st.builds(Until, intervals, below, below),
            st.builds(Once, intervals, below),
            st.builds(Historically, intervals, below),
            st.builds(Since, intervals, below, below),
            below.map(Rise),
            below.map(lambda arg: Rise(Not(arg))),
        )

    comparisons = st.builds(Comparison, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), terms, terms)
    return st.recursive(comparisons, grow, max_leaves=6)


@settings(max_examples=many(60))
@given(phi=common_formulas(), n=st.integers(2, 9), data=st.data())
def test_rtamt_agrees_on_what_both_languages_have(phi, n, data):
    package = rtamt()
    values = st.lists(st.sampled_from([-2.0, -0.25, 0.0, 0.5, 1.0, 2.0]) | st.floats(-9, 9), min_size=n, max_size=n)
    signals = {name: data.draw(values) for name in "xy"}
    specification = package.StlDiscreteTimeOfflineSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = rtamt_text(phi)
    specification.parse()
    expected = [value for _, value in specification.evaluate({"time": list(range(n)), **signals})]
    assert all(map(close, stl.monitor(phi, signals, end="cut").robustness, expected))
