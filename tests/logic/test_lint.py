"""Texts that other tools would read differently are told, with the reading that holds here; others are not."""

import itertools
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given

import stltool as stl
from stltool.logic.format import format_task
from stltool.logic.lint import ambiguities
from stltool.logic.syntax import read
from stltool.source import Source
from stltool.testing import formulas


def found(text, start="formula"):
    return ambiguities(read(Source("t", text), start))


@pytest.mark.parametrize(
    ("text", "reading"),
    [
        ("a and b or c", "(a & b) | c"),
        ("a or b and c", "a | (b & c)"),
        ("a -> b -> c", "a -> (b -> c)"),
        ("a or b -> c", "(a | b) -> c"),
        ("a -> b <-> c", "(a -> b) <-> c"),
        ("a <-> b xor c", "(a <-> b) xor c"),
        ("G[0,2] a and b", "(G[0,2] a) & b"),
        ("F[0,2] a U[0,3] b", "(F[0,2] a) U[0,3] b"),
        ("!G[0,2] a | b", "(!G[0,2] a) | b"),
        ("G[0,2] x > 0 -> b", "(G[0,2] (x > 0)) -> b"),
        ("a U[0,1] b & c", "(a U[0,1] b) & c"),
        ("x^2^3 > 1", "x^(2^3)"),
        ("b & (a and b or c)", "(a & b) | c"),
    ],
)
def test_an_ambiguous_text_is_told_with_its_reading(text, reading):
    (advice,) = found(text)
    assert advice.message.endswith(f"here it means {reading}")
    span = advice.span
    assert stl.parse(f"{text[: span.start]}({reading}){text[span.end :]}") == stl.parse(text)


@pytest.mark.parametrize(
    ("text", "far"),
    [
        ("G[0,2] a and b", "G[0,2] (a & b)"),
        ("G[0,2] a and b and c", "G[0,2] (a & b & c)"),
        ("F[0,2] a U[0,3] b", "F[0,2] (a U[0,3] b)"),
        ("!G[0,2] F[0,1] a | b", "!G[0,2] F[0,1] (a | b)"),
        ("c & F[0,1] a & G[0,1] b & d", "c & (F[0,1] (a & G[0,1] b & d))"),
        ("G[0,2] x > 0 -> b", "G[0,2] (x > 0 -> b)"),
    ],
)
def test_the_reading_of_storm_and_prism_is_told_as_a_text(text, far):
    (advice,) = found(text)
    told = advice.message.split("which is written ")[1].split("; here it means")[0]
    assert stl.parse(told) == stl.parse(far) != stl.parse(text)


def test_the_other_definitions_of_until_are_told_as_texts():
    """Against their definitions, on every trace of two labels over five steps."""
    a, b = 1, 3
    (note,) = stl.conventions(stl.parse_task("param a = 1\nr := p U[a,3] q"))
    mltl, breach = (stl.parse(part.split(";")[0]) for part in note.message.split("which is written ")[1:])
    assert (note.span.text(), "in MLTL" in note.message, "in Breach" in note.message) == ("p U[a,3] q", True, True)
    differ = 0
    for p in itertools.product((False, True), repeat=5):
        for q in itertools.product((False, True), repeat=5):
            trace = {"p": p, "q": q}
            windows = [(q[u], p[a:u], p[:u], p[: u + 1]) for u in range(a, b + 1)]
            assert stl.satisfies(mltl, trace) == any(right and all(left) for right, left, _, _ in windows)
            assert stl.satisfies(breach, trace) == any(right and all(left) for right, _, _, left in windows)
            ours = stl.satisfies(stl.parse("p U[1,3] q"), trace)
            assert ours == any(right and all(left) for right, _, left, _ in windows)
            differ += len({ours, stl.satisfies(mltl, trace), stl.satisfies(breach, trace)}) > 1
    assert differ > 0


@pytest.mark.parametrize(
    "text", ["p U[0,3] (p & q)", "(p | q) U[0,3] q", "p U[0,3] p", "true U[2,3] q", "F[2,3] p", "(p | q) U[0,3] q & p"]
)
def test_an_until_that_all_define_alike_is_not_told(text):
    assert stl.conventions(stl.parse_task(f"r := {text}")) == []


@pytest.mark.parametrize(
    ("text", "near"),
    [
        ("v * i == p", "abs(v * i - p) <= 1e-09"),
        ("s != x + y", "abs(s - (x + y)) > 1e-09"),
        ("sqrt(x) == y", "abs(sqrt(x) - y) <= 1e-09"),
        ("min(x^2, 3) == -(x / y)", "abs(min(x^2, 3) - -(x / y)) <= 1e-09"),
    ],
)
def test_an_equality_of_computed_values_is_told_with_one_that_holds(text, near):
    (note,) = stl.conventions(stl.parse_task(f"r := G[0,2] (p -> {text})"))
    assert note.span.text() == text
    assert stl.parse(note.message.split("write ")[1]) == stl.parse(near)
    assert stl.conventions(stl.parse_task(f'model "floor.toml"\nr := G[0,2] {text}')) == []  # a model's own numbers


@pytest.mark.parametrize("text", ["x == 3", "x + 1 == y", "2 * x != 4", "x == y", "abs(x) == max(x, y)", "x * y <= p"])
def test_an_equality_of_recorded_values_is_not_told(text):
    assert stl.conventions(stl.parse_task(f"r := {text}")) == []


@pytest.mark.parametrize("text", ["x >= 1/3", "1 / 3 == x", "x < -2/7", "x > -(2/7)", "x <= 0.1/3"])
def test_a_quotient_that_no_double_is_is_told_with_the_double_next_to_it(text):
    """Signals are doubles: one that was written as 1/3 is not a third, and a param is."""
    for model in ("", 'model "floor.toml"\n'):
        (note,) = stl.conventions(stl.parse_task(f"{model}r := G[0,2] {text}"))
        near, quotient = re.search(r"written so are (\S+); .* param c = (.*)$", note.message).groups()
        numerator, divisor = quotient.split(" / ")
        assert stl.monitor(
            stl.parse(f"x == {near}"), {"x": [float(Fraction(numerator) / Fraction(divisor))]}
        ).verdicts.all()
        assert not stl.monitor(stl.parse(f"x == {quotient}"), {"x": [float(near)]}).verdicts.any()
        assert stl.monitor(stl.parse_task(f"param c = {quotient}\nr := x == c"), {"x": [float(near)]}).verdicts.all()
    for plain in ("x >= 1/4", "x / 3 > 1", "x >= 3/10", "x > 1/0", "x > 1e300 / 1e-300"):
        assert stl.conventions(stl.parse_task(f"r := {plain}")) == []


def test_an_equality_of_computed_doubles_hardly_ever_holds():
    v, i = np.random.default_rng(0).random((2, 1000))
    assert stl.monitor(stl.parse("v * i == p"), {"v": v, "i": i, "p": v * i}).verdicts.sum() < 10
    assert stl.monitor(stl.parse("abs(v * i - p) <= 1e-9"), {"v": v, "i": i, "p": v * i}).verdicts.all()


@pytest.mark.parametrize(
    "text",
    ["a & b & c", "(a & b) | c", "a -> (b -> c)", "b and G[0,2] a", "!a & b", "G[0,2] x > 0", "!x > 0", "x - 1 - 1 > 0",
     "(a U[0,1] b) & c", "x > 2^-1", "(G[0,2] a) and b", "a & !(F[0,1] b)"],
)  # fmt: skip
def test_a_text_with_one_reading_everywhere_is_not_told(text):
    assert found(text) == []


@given(formulas(longest=12))
def test_what_is_laid_out_has_one_reading(phi):
    assert found(str(phi)) == []
    assert found(format_task(f"r := {phi}"), "task") == []


def test_every_ambiguous_place_of_a_file_is_told_once():
    advice = found("p := a and b or c and (d -> e -> f)\nq := x > 5 // 2\nr := a // 2 of them\n", "task")
    assert [(a.span.line, a.span.column) for a in advice] == [(1, 6), (1, 24), (2, 12)]
    assert [a.message.startswith("// begins a comment") for a in advice] == [False, False, True]


def test_signals_on_no_signal_line_are_told_where_there_are_such_lines():
    text = "signal speed, gear\nparam x = 3\nslow := speed < 30\nphi := slow & speeed[t] > x & flag & F[0,9) gears == 2"
    told = [(str(a.span.text()), a.message) for a in found(text, "task") if "signal line" in a.message]
    assert told == [
        ("speeed", "speeed is not declared on a signal line; did you mean speed?"),
        ("gears", "gears is not declared on a signal line; did you mean gear?"),
    ]
    assert found(text.replace("signal speed, gear\n", "").replace(" & F[0,9) gears == 2", ""), "task") == []


def test_a_name_that_nearly_is_a_definition_is_told():
    text = "signal patrollin\nparam T = 3\npatrolling := A\ngear2 := B\nvisits_a := B\n"
    text += "r := patroling & gear1 & (F[0,T] patroling) & visit_a & patrollin > 3 // 10 steps"
    (advice,) = found(text, "task")
    assert advice.message == "patroling is read as a signal or label; did you mean patrolling?"
    assert (advice.span.line, advice.span.column) == (6, 6)


def test_a_name_that_nearly_is_a_param_is_told():
    (advice,) = found("param threshold = 3\nr := F[0,3] (x > 0 & treshold & threshold > 2)", "task")
    assert advice.message == "treshold is read as a signal or label; did you mean threshold?"


def test_a_quoted_name_of_a_definition_is_told():
    text = 'param T = 3\ngoal := x > T\nr := "goal" & goal & "T" & "other"'
    told = [(a.span.text(), a.message) for a in found(text, "task")]
    assert told == [
        (f'"{name}"', f"in quotes, {name} is the label or signal of that name, not the {what}; leave out the quotes if "
                      "that is meant")
        for name, what in (("goal", "definition on line 2"), ("T", "param on line 1"))
    ]  # fmt: skip


def test_a_long_reading_is_cut():
    (advice,) = found(" & ".join(f"label_{i}" for i in range(100)) + " | z")
    assert len(advice.message) < 500
    assert advice.message.endswith("…")
