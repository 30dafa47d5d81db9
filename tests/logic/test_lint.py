"""Texts that other tools would read differently are told, with the reading that holds here; others are not."""

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
