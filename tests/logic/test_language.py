"""What users of other tools write: Breach's files, times with units, several faults at once, params changed late."""

import contextlib
import re
import sys
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FileError, SettingsError, StlSyntaxError
from stltool.grammar import grammar_text
from stltool.logic import syntax
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Historically,
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
    label_names,
    variables,
)
from stltool.logic.quantities import Duration, duration, quantity
from stltool.source import Source, Span
from stltool.streams import control_character
from tests.conftest import DATA, OUTSIDE, needs_outside

A, B = Label("a"), Label("b")


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("alw_[0,3] ev_[1,2] a", Always(Interval(0, 3), Eventually(Interval(1, 2), A))),
        ("[]_[0,3] <>_(0,3] a", Always(Interval(0, 3), Eventually(Interval(1, 3), A))),
        ("a until_[0,3] b", stl.parse("a U[0,3] b")),
        ("a 𝒰_[0,3] b", stl.parse("a U[0,3] b")),
        ("G_[0 .. 3] a", Always(Interval(0, 3), A)),
        ("x[t] > 0.5", Comparison(">", Variable("x"), Number(0.5))),
        ("gear [ t ] == 3", Comparison("==", Variable("gear"), Number(3.0))),
        ("(((((a)))))", A),
        ("G_ & b", stl.parse("b & G_").__class__((Label("G_"), B))),
    ],
)
def test_spellings_of_other_tools(text, meaning):
    assert stl.parse(text) == meaning


def test_names_in_quotes_are_labels_and_signals():
    for text, meaning in [
        ('"at goal"', Label("at goal")),
        ('F[0,3] "goal"', Eventually(Interval(0, 3), Label("goal"))),
        ('"Engine Speed (rpm)" > 900', Comparison(">", Variable("Engine Speed (rpm)"), Number(900.0))),
        ('"G" > 70', Comparison(">", Variable("G"), Number(70.0))),
        ('"until"', Label("until")),
        ('"say ""hi"""', Label('say "hi"')),
        ('"x y"[t] == "z"', Comparison("==", Variable("x y"), Variable("z"))),
        ("r1.x > 900", Comparison(">", Variable("r1.x"), Number(900.0))),
        ("G.x", Label("G.x")),
        ("signal.rate[t] < 1", Comparison("<", Variable("signal.rate"), Number(1.0))),
    ]:
        assert stl.parse(text) == meaning
    text = (
        'input signal "Engine Speed", a\noutput signal b\nparam goal = 3, low.v = 2\nfast := "Engine Speed" > low.v\n'
    )
    text += 'goals := "goal" & "fast"\nr.s := goals & fast & a > goal\n'
    task = stl.parse_task(text)
    assert str(task) == 'r.s := (goal & fast) & "Engine Speed" > 2 & a > 3'
    assert task.definitions["goals"] == stl.parse('"goal" & "fast"')
    assert stl.format_task(text) == text
    assert stl.parse('"T" & F[0,T] a', {"T": 3}) == stl.parse('"T" & F[0,3] a')
    assert stl.parse_task('model "a b.toml"\nr := "a b.toml"').model.name == "a b.toml"


@given(st.text(st.characters(exclude_characters="\r\n", exclude_categories=["Cs"]), min_size=1).filter(
    lambda name: not control_character(name) and name not in ("d", "r", "s")  # those of the text below
))  # fmt: skip
def test_any_name_can_be_written(name):
    x = Variable(name)
    for phi in (
        Label(name),
        Comparison(">", x, x),
        Always(Interval(0, 3), Until(Interval(0, 1), Label(name), Label(name))),
    ):
        assert stl.parse(str(phi)) == phi
        assert stl.parse_task(f"signal s\nd := {phi}\nr := d").formula == phi
    assert stl.label(name) == Label(name)
    assert str(stl.signal(name) > 2) == str(Comparison(">", x, Number(2.0)))


def test_every_word_of_the_grammar_can_be_a_name():
    words = set(re.findall(r"[A-Za-z_]+", grammar_text("stl.lark")))
    assert {"until", "F", "alw", "model", "sqrt", "iff", "unit"} <= words
    for word in sorted(words | {f"{word}_" for word in words} | {word.upper() for word in words}):
        assert stl.parse(str(Label(word))) == Label(word)
        text = str(stl.signal(word) > 1)
        assert stl.parse(f"a & {text}") == stl.parse("a") & (stl.signal(word) > 1)
        assert len(stl.parse_task(f"r0 := a & {Label(word)}\nq := a").definitions) == 2
    assert [str(Label(name)) for name in ("x_", "inc", "Gate", "model_", "a.b")] == [
        "x_",
        "inc",
        "Gate",
        "model_",
        "a.b",
    ]


PAST_TEXTS = [
    ("once[0,3] a", Once(Interval(0, 3), A)),
    ("once_(0,3] a", Once(Interval(1, 3), A)),
    ("once a", Once(Interval(0, None), A)),
    ("once(a)", Once(Interval(0, None), A)),
    ("historically[2,inf) a", Historically(Interval(2, None), A)),
    ("a since b", Since(Interval(0, None), A, B)),
    ("a since_[1,2] !b", Since(Interval(1, 2), A, Not(B))),
    ("a trigger[1,2] b", Trigger(Interval(1, 2), A, B)),
    ("prev a", Once(Interval(1, 1), A)),
    ("rise(a)", Rise(A)),
    ("fall a", Rise(Not(A))),
    ("a release[1,2] b", Release(Interval(1, 2), A, B)),
    ("a weak_until[1,3] b", Or((Until(Interval(1, 3), A, B), Always(Interval(0, 3), A)))),
    ("rise prev once[0,1] a", Rise(Once(Interval(1, 1), Once(Interval(0, 1), A)))),
    ("prev a & b", And((Once(Interval(1, 1), A), B))),
    ("!prev a since b", Since(Interval(0, None), Not(Once(Interval(1, 1), A)), B)),
]


@pytest.mark.parametrize(("text", "meaning"), PAST_TEXTS)
def test_words_of_the_past(text, meaning):
    assert stl.parse(text) == meaning
    assert stl.parse(str(meaning)) == meaning
    assert stl.parse_task(stl.format_task(f"r := {text}")).formula == meaning


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("rise & once", {"rise", "once"}),
        ("G[0,5] since", {"since"}),
        ("F[0,2] (release -> F(0,2) trigger)", {"release", "trigger"}),
        ("once[t] > 3 & prev < 2", {"once", "prev"}),
        ("(fall | a) since rise", {"fall", "a", "rise"}),
        ("rise once", {"once"}),
        ("since since since", {"since"}),
        ("O & H | S -> (Y <-> R & W)", {"O", "H", "S", "Y", "R", "W"}),
    ],
)
def test_words_of_the_past_are_names_where_no_operator_can_stand(text, names):
    phi = stl.parse(text)
    assert {*variables(phi), *label_names(phi)} == names
    assert stl.parse(str(phi)) == phi


def test_words_of_the_past_give_way_to_definitions_params_and_signals():
    task = stl.parse_task("signal prev, x\nparam since = 3\nrise := x > 1\nr := G[0,since] rise | prev - 1 > 2")
    assert str(task.formula) == '(G[0,3] (x > 1)) | "prev" - 1 > 2'
    advice = [str(one) for one in stl.ambiguities(task)]
    assert any("rise is a definition here, not the operator" in one for one in advice)
    assert any("since is a param here" in one for one in advice)
    assert any("prev is a signal here" in one for one in advice)
    assert stl.parse_task(
        "step = 1s\nunit = step\nrise := x > 1\nfall := x < 0\nspike := rise and (ev_[0, 2] fall)"
    ).formula == (stl.parse("x > 1 & (F[0,2] (x < 0))"))


def test_prev_is_told_to_be_weak_in_rtamt():
    (advice,) = stl.ambiguities(stl.parse_task("r := G[0,3] ((prev a) -> (prev b))"))
    assert "prev is false at step 0, where RTAMT's prev is true" in str(advice)
    assert stl.ambiguities(stl.parse_task("r := G[0,3] ((once[1,1] a) -> b)")) == []


def test_times_are_whole_multiples_of_the_step():
    text = "F[0,2s] a & G[0.5s,1min) b"
    assert stl.parse(text, step="0.1s") == stl.parse("F[0,20] a & G[5,600) b")
    assert stl.parse(text, step="500ms") == stl.parse("F[0,4] a & G[1,120) b")
    assert stl.parse("F[0,T] a", params={"T": "3s"}, step="0.5s") == stl.parse("F[0,6] a")
    task = stl.parse_task("step = 0.1s\nunit = step\nparam T = 2s, n = T / 0.5s\nr := F[0,T + 2*500ms - T/2] G[0,n] A")
    assert task.formula == stl.parse("F[0,20] G[0,4] A")
    assert task.step == Duration(Fraction(1, 10))
    assert task.params == {"T": Duration(Fraction(2)), "n": Fraction(4)}
    assert str(task.params["T"]) == "2s"


REFUSED = [
    ("r := F[0,2s] A", "this bound is a time, but no step is declared; add a line step = 0.1s"),
    ("step = 0.1s\nr := F[0,0.25s] A", "0.25s is not a multiple of the step, 0.1s; write 0.2s or 0.3s"),
    ("r := F[0,0.25s] A", "add a line step = 0.25s"),
    ("r := F[0,104.05] A", "write 104 or 105; for times in seconds, add the lines step = 0.05s and unit = s"),
    ("step = 0.1s\nr := F[0,104.05] A", "104.05s, a multiple of the step, 0.1s; write 104s or 104.1s"),
    (
        "step = 0.1s\nunit = s\nr := F[0,104.05] A",
        "104.05s is not a multiple of the step, 0.1s; write 104 or 104.1",
    ),
    ("step = 0.1s\nparam d = 52\nr := F[0,d+52.05] A", "d + 52.05 = 104.05 is neither an integer number of steps nor"),
    ("step = 0.1s\nr := F[0,0.5] A", "0.5 could be 0.5s (5 steps): a step is declared, but no unit"),
    ("step = 0.1s\nr := F[0,5] A", "5 could be 5s (50 steps) or 5 steps (0.5s)"),
    ("step = 0.1s\nr := F[0,5] A", "write 5s or 5 steps, or add a line unit = s or unit = step"),
    ("r := F[0,5] A\nstep = 0.1s", "5 could be 5s (50 steps) or 5 steps (0.5s)"),
    (
        "step = 10ms\nparam hold = 1\nr := F[0,hold] A",
        "write param hold = 1s or param hold = 1 step, or add a line",
    ),
    ("step = 5min\nr := F[0,60] A", "60 could be 60min (12 steps) or 60 steps (18000s)"),
    ("step = 5min\nr := F[0,3] A", "3 could be 3 steps (900s): a step is declared"),
    ("r := F[0,2.5 steps] A", "the bound 2.5 is not an integer number of steps; write 2 steps or 3 steps"),
    ("r := F[0,2 steps + 1] A", "a time and a plain number cannot be combined"),
    ("r := F[0,2 steps + 1s] A", "no step is declared; add a line step = 0.1s"),
    ("unit = s\nr := F[0,2] A", "this bound is a time, but no step is declared; add a line step = 0.1s"),
    ("unit = -1s\nr := A", "the unit must be a unit of time, or step"),
    ("unit = 0s\nr := A", "the unit must be a unit of time, or step"),
    ("unit = sec\nr := A", "the unit must be a unit of time, or step; write, for example, unit = s or unit = step"),
    ("unit = 3\nr := A", "the unit must be a unit of time, or step"),
    ("unit = s\nunit = s\nr := A", "this is a second unit line"),
    ("step = 5 steps\nr := A", "the step must be a positive time"),
    ("step = 0.1s\nr := F[0,2s + 1] A", "a time and a plain number cannot be combined"),
    ("step = 0.1s\nr := F[0,2s * 3s] A", "this is not a time"),
    ("step = 0.1s\nr := F[0,2s^2] A", "this is not a time"),
    ("step = 0.1s\nr := F[0,2/3s] A", "this is not a time"),
    ("step = 0.1s\nr := F[0,max(2s, 3)] A", "a time and a plain number cannot be combined"),
    ("step = 0.1s\nparam T = 2s\nr := x > T", "expected a plain number, found a time"),
    ("step = 0.1s\nr := x > 2s", "expected a plain number, found a time"),
    ("step = 0.1\nr := F[0,2] A", "the step must be a positive time with a unit"),
    ("step = -1s\nr := F[0,2] A", "the step must be a positive time with a unit"),
    ("step = 1s\nstep = 1s\nr := F[0,2] A", "this is a second step line"),
    ("r := F[0,2 s] A", "expected an operator between '2' and 's'"),
    ("r := x[3] > 0", "write x[t], x[t+1] or x[t-1]"),
    ("r := x[t] & A", "compare it, as in x[t] > 0"),
    ("param x = 3\nr := x[t] > 0", "x is a param, not a signal; drop [t]"),
    ("signal x\nr := x & A", "expected a Boolean expression, but x is a signal; compare it, as in x > 0"),
    ("signal x\nparam x = 3\nr := A", "x is a signal (line 1); rename this param"),
    ("r := x > 0\nsignal r", "r is a signal (line 2); rename this definition"),
    ("r := O[0,3] A", "there is no operator O; write once[0,3] a"),
    ("r := H (A & B)", "there is no operator H; write historically[0,5] a"),
    ("r := !Y A", "there is no operator Y; write prev a"),
    ("r := A S[0,3] B", "there is no operator S; write a since[0,3] b"),
    ("r := A & (B S A)", "there is no operator S; write a since[0,5] b"),
    ("r := A R[0,3] B", "there is no operator R; write a release[0,3] b"),
    ("r := A W B", "there is no operator W; write a weak_until[0,5] b"),
    ("r := previous(A)", "there is no operator previous; write prev a"),
    ("r := prev[0,3] A", "prev takes no interval; for a window of the past, write once[0,5] a"),
    ("r := A since B since A", "since cannot be chained; put one of them in parentheses"),
    ("r := Once[0,3] A", "did you mean once?"),
    ("r := A Since B", "keywords are lower case; write since"),
    ("r := prev -x > 3", "prev before a sign may be the operator or a signal"),
    ("since := A\nr := A since B", "since is a name here, not the operator"),
    ("r := once[3,1] A", "the interval [3,1] is empty"),
    ("r := once (A + 1)", "expected a Boolean expression, found a number"),
    ("r := 1 + (once A) > 0", "expected a number, found a Boolean expression"),
    ("r := next(A)", "for the next step, write F[1,1] a"),
    ("r := pow(x, 2) > 1", "write a^b"),
    ("r := alwayss[0,3] A", "alwayss does not take an interval; did you mean always?"),
    ("r := foo[0,3] A", "F, G, U and their words do"),
    ("r := foo[min(1, 2),3] A", "foo does not take an interval"),
    ("r := True", "keywords are lower case; write true"),
    ("r := A AND B", "keywords are lower case; write and"),
    ("r := NOT A", "keywords are lower case; write not"),
    ("r := Always[0,3] A", "did you mean always?"),
    ("r := x < inf", "inf is not a number with which a signal can be compared"),
    ("params T = 3\nr := A", "did you mean param?"),
    ("r := A\nq = F[0,3] A", "write q := … to define it"),
    ("r := F[0,3 A", "unexpected 'A'"),
    ("r := F[0,T[t]] A", "expected a constant, found a signal"),
    ("r := [0,3] A", "unexpected '['"),
    ("r := A [0,3] B", "A does not take an interval"),
    ("r := G[0,3] A G[0,3] B", "expected an operator before 'G'"),
    ("r := A &\nq := B", "line 1, column 9: the statement ends here; expected a formula"),
    ('r := A "floor"', "expected an operator between 'A' and '\"floor\"'"),
    ('"r" := A', "a definition has a name without quotes"),
    ('r := ""', "these quotes hold no name"),
    ('signal ""\nr := A', "these quotes hold no name"),
    ('signal "a b"\nr := "a b" & A', 'but "a b" is a signal; compare it, as in "a b" > 0'),
    ("r := 'at goal'", 'names that need quotes have double ones; write "at goal"'),
    ('r := "at goal', 'close it on the same line, as in F[0,5] "at goal"'),
    ('r := F[0,"T"] A', "expected a constant, found a signal"),
    ('model "floor\nr := A', "close it on the same line"),
    ("r := F[0...50] A", "dots occur in numbers, such as 0.5, and in intervals, such as [0..5]"),
    ("r := F[0...5e1] A", "dots occur in numbers"),
    ("r := x² > 4", "write ^2 for a power"),
    ("r := F[0,٣] A", "use the digits 0 to 9"),
    ("größe := x > 3", "the name of a definition or a param cannot contain 'ö'; use a-z, A-Z, 0-9 and _"),
    ("param größe = 3", "the name of a definition or a param cannot contain 'ö'"),
    ("r := F[0,n] A\nparam n = 2", "n is a param of line 2, which comes later; move it up"),
    ("param T = n, n = 2\nr := F[0,T] A", "n is a param of line 1, which comes later; move it up"),
    ("param n = n\nr := F[0,n] A", "n is not a param; give it a value"),
    ("once := A\nr := once & once[0,1] A", "once is a name in this file, as line 1 defines it; rename it there"),
    ("r := größe > 3", "a name cannot contain 'ö' unless it is in quotes; write \"größe\""),
    ("r := car. > 3", "unexpected dot; in a name, a letter follows it, as in car.speed"),
    ("model floor.toml\nr := A", "in double quotes on a model line"),
    ("r := F_[] A", "could be an empty interval"),
    ("r := A U_[] B", "could be an empty interval"),
    ("param e = (10^-64)^8\nr := x > e", "too small to be compared with a signal"),
    ("param T = (10^64)^18/7\nr := F[0,T] A", "this bound is out of range"),
    ("param T := 5\nr := F[0,T] A", "a param line uses =; write param T = 5"),
    ("param T = (10^64)^18\nparam V = T*T*T\nr := F[0,V] x", "this value is out of range"),
    ("param T = 10^64\nr := F[0,T/7] A", "this bound is out of range"),
    ("c := 5\nr := F[0,c] A", "c is a definition; for a number in bounds, write param c"),
    ("x := x > 2", "x is defined in terms of itself"),
    ("r := x !== 3", "write != without the second ="),
    ("step = 5\nr := F[0,1s] A", "the step must be a positive time"),
    ("r := A % a comment", "begin comments with # or //"),
    ("r := " + "(" * 18 + "A" + ") weak_until[0,1] B" * 18, "more than 50000 operators; use definitions less often"),
]


def test_a_refusal_says_what_to_write():
    for text, says in REFUSED:
        with pytest.raises(StlSyntaxError) as caught:
            stl.parse_task(text)
        assert says in str(caught.value), text


def test_plain_numbers_mean_what_the_unit_line_says():
    text = "param T = 2\nr := F[0,T] G[1,2*T+1] (x > T)"
    for lines, same in [
        ("", "F[0,2] G[1,5] (x > 2)"),
        ("unit = step", "F[0,2] G[1,5] (x > 2)"),
        ("step = 0.5s\nunit = step", "F[0,2] G[1,5] (x > 2)"),
        ("step = 0.5s\nunit = s", "F[0,4] G[2,10] (x > 2)"),
        ("step = 0.5s; unit = min", "F[0,240] G[120,600] (x > 2)"),
        ("unit = 500ms\nstep = 0.25s", "F[0,4] G[2,10] (x > 2)"),
        ("step = 1us\nunit = µs", "F[0,2] G[1,5] (x > 2)"),
    ]:
        assert stl.parse_task(f"{lines}\n{text}").formula == stl.parse(same)
        assert stl.parse_task(f"{text}\n{lines}", task="r").formula == stl.parse(same)  # wherever the lines stand
    task = stl.parse_task(f"step = 0.5s\nunit = s\n{text}")
    assert (task.step, task.unit) == (Duration(Fraction(1, 2)), Duration(Fraction(1)))
    assert stl.parse("F[0,2] a", step="0.5s", unit="s") == stl.parse("F[0,2] a", step="0.1s", unit="0.2s")
    assert (
        stl.parse("F[0,2] a", step="0.5s", unit="step") == stl.parse("F[0,2] a", unit="step") == stl.parse("F[0,2] a")
    )
    for unit in ("parsec", "-1s", "0s", 3, "1/0s"):
        with pytest.raises(SettingsError, match="is not a unit of time"):
            stl.parse("a", unit=unit)


@pytest.mark.parametrize(
    ("bound", "step", "says"),
    [
        ("3", "0.1s", r"3 could be 3s \(30 steps\) or 3 steps \(0.3s\)"),
        ("2", "0.3s", r"2 could be 2 steps \(0.6s\): .*; write 2 steps, or give unit='step'"),
        ("2.5", "0.1s", r"2.5 could be 2.5s \(25 steps\): .*; write 2.5s, or give unit='s'"),
        ("2.5", "0.3s", "2.5 is neither an integer number of steps nor, as 2.5s, a multiple of the step, 0.3s"),
    ],
)
def test_a_plain_number_next_to_a_step_is_told_what_it_could_be(bound, step, says):
    with pytest.raises(StlSyntaxError, match=says):
        stl.parse(f"F[0,{bound}] a", step=step)


def test_the_step_that_is_advised_fits_every_bound():
    text = "param t1 = 0.3, slack = 0.001\na := F[0,0.02] (x > slack)\nr := F[0.05,t1] a"
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task(text)
    assert str(caught.value).count("add the lines step = 0.01s and unit = s") == 2
    assert stl.parse_task(f"step = 0.01s\nunit = s\n{text}").formula == stl.parse("F[5,30] F[0,2] (x > 0.001)")


def test_a_unit_of_time_is_so_many_of_a_smaller_one():
    thousands = [("us", "ns"), ("µs", "ns"), ("μs", "ns"), ("ms", "us"), ("s", "ms")]
    for n, pairs in ((1000, thousands), (60, [("min", "s"), ("h", "min")])):
        for unit, smaller in pairs:
            assert stl.parse(f"F[0,1{unit}] A", step=f"1{smaller}") == stl.parse(f"F[0,{n}] A"), unit
    assert stl.parse_task("step = 1s\nr := A").step == Duration(Fraction(1))


def test_steps_are_a_time():
    for text, same in [
        ("F[0,5 steps] A", "F[0,5] A"),
        ("F[1 step,5steps] A", "F[1,5] A"),
        ("F[0,2 * 3 steps - 1 step] A", "F[0,5] A"),
        ("F[0,max(2 steps, 1 step)] A", "F[0,2] A"),
        ("F[0,abs(1 step - 3 steps)] A", "F[0,2] A"),
        ("F[2*abs(1/2),2*abs(1/2 - 1) + abs(-1)] A", "F[1,2] A"),
        ("F[0,6 steps / 2 steps] A", "F[0,3] A"),
    ]:
        assert stl.parse(text) == stl.parse(same)
        assert stl.parse_task(stl.format_task(f"r := {text}")).formula == stl.parse(same)
    for text, steps in [
        ("1s + 3 steps", 13),
        ("min(1s, 3 steps)", 3),
        ("1s / 2 steps * 1 step", 5),
        ("2s - 3 steps", 17),
    ]:
        assert stl.parse(f"F[0,{text}] A", step="0.1s") == stl.parse(f"F[0,{steps}] A")
    assert stl.parse("F[0,T] A", {"T": "5 steps"}) == stl.parse("F[0,5] A")
    assert str(Duration(Fraction(2), Fraction(1))) == "2s + 1 step"
    assert stl.format_task("r := F[0,5   steps] step") == "r := F[0,5 steps] step\n"


def test_all_faults_of_a_file_are_told_at_once_and_nothing_else():
    text = """param T = 10, T = 11
near := x <
model "floor.toml"
model "floor.toml"
r := F[0,T] near
s := F[0,tau] A & § B
q := G[5,3] (A & near)
fine := F[0,3] A
v := near & fine & B > A
"""
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task(text)
    told = [line.split(":")[0] for line in str(caught.value).splitlines() if line.startswith("task, line")]
    # near is faulty, so r and v (whose own fault hides behind it) are passed over; T = 10 is taken
    assert told == [f"task, line {n}, column {m}" for n, m in [(1, 15), (2, 12), (4, 1), (6, 19), (7, 7)]]
    assert str(caught.value).endswith("5 errors")


def test_numbers_defined_from_each_other_do_not_explode():
    text = "t0 := x + x\n" + "".join(f"t{i + 1} := t{i} + t{i}\n" for i in range(40)) + "r := t40 > 2"
    with pytest.raises(StlSyntaxError, match="more than 50000 operators"):
        stl.parse_task(text)


def test_values_for_names_that_a_formula_does_not_have_are_refused():
    with pytest.raises(StlSyntaxError, match="this formula has no param G; no such name occurs in it"):
        stl.parse("G[0,5] (x > y)", params={"G": 3})
    with pytest.raises(StlSyntaxError, match="this formula has no param Q"):
        stl.parse("F[0,5] a", params={"Q": 3})
    with pytest.raises(SettingsError, match="is not a positive time"):
        stl.parse("a", step=5)


def test_what_a_faulty_line_defines_is_missed_nowhere():
    """Only the line itself is at fault: not those that use its names."""
    for line in (
        "param T := 5",
        "param T 5",
        "param T == 5",
        "T = §",
        "param T = §",
        "T := §3",
        "param T = 1/0",
        "T := 3 +",
        "param T = 5 5",
    ):
        with pytest.raises(StlSyntaxError) as caught:
            stl.parse_task(f"{line}\nr := F[0,T] (x > T)\nq := r & F[0,2*T] G[0,abs(T)] T")
        assert str(caught.value).count("task, line") == 1, line
        assert "line 1" in str(caught.value)


def test_many_faults_are_cut_short():
    with pytest.raises(StlSyntaxError, match="40 errors; the first 20 are shown"):
        stl.parse_task("".join(f"a{i} := F[2,1] A\n" for i in range(40)))
    with pytest.raises(StlSyntaxError, match="20 errors"):
        stl.parse("§ " * 1000)


LINES = ["a := F[0,3] A", "b := G[3,2] A", "c := A &", "d := § A", "e := x > y + 1", ""]


@given(st.lists(st.sampled_from(LINES), max_size=6))
def test_errors_are_counted_line_by_line(lines):
    """Each faulty line is told once, wherever it stands; the others never."""
    lines = [line.replace(" :=", f"{i} :=", 1) for i, line in enumerate(lines)]
    faulty = [i + 1 for i, line in enumerate(lines) if line[:1] in ("b", "c", "d")]
    try:
        stl.parse_task("\n".join([*lines, "z := A"]))
        told = []
    except StlSyntaxError as error:
        told = [int(line.split()[2].strip(",")) for line in str(error).splitlines() if line.startswith("task, line")]
    assert told == faulty


# ------------------------------------------------------------------------------------------- no interval, no end


def test_operators_without_an_interval_are_for_monitors():
    for text, meaning in [
        ("always a", Always(Interval(0, None), A)),
        ("G[2,inf) a", Always(Interval(2, None), A)),
        ("F(2,inf] a", Eventually(Interval(3, None), A)),
        ("a until b", stl.parse("a U[0,inf) b", unbounded=True)),
        ("F G a", Eventually(Interval(0, None), Always(Interval(0, None), A))),
        ("<>[]a", Eventually(Interval(0, None), Always(Interval(0, None), A))),
        ("alw (a & b)", stl.parse("G[0,inf) (a & b)", unbounded=True)),
    ]:
        phi = stl.parse(text, unbounded=True)
        assert phi == meaning
        assert stl.parse(str(phi), unbounded=True) == phi
        with pytest.raises(StlSyntaxError, match="needs an interval with an end here, such as"):
            stl.parse(text)
    for end in ("inf", "Inf", "INF", "infinity", "Infinity", "∞", "+inf", "(inf)"):
        assert stl.parse(f"G[2,{end}) a", unbounded=True) == Always(Interval(2, None), A)
        assert stl.format_task(f"r := G[2,{end}) a") == "r := G[2,inf) a\n"
    for name in ("inf", "Inf", "infinity", "∞"):
        with pytest.raises(StlSyntaxError, match=f"{name} is not a number with which a signal"):
            stl.parse(f"x < {name}")
    for name in ("inf", "Inf", "infinity"):
        with pytest.raises(StlSyntaxError, match=f"{name} is reserved for intervals without an end"):
            stl.parse_task(f"param {name} = 3\nr := F[0,{name}] a")


# ------------------------------------------------------------------------------------------- params, late


def test_params_change_without_reading_again(monkeypatch):
    text = "step = 0.5s\nunit = step\nparam T = 10, tau = T/2, d = 3s\nr := F[0,T) G[0,tau] (A & F[0,d] B)\nq := A"
    task = stl.parse_task(text, task="r", params={"d": "1s"})
    fresh = stl.parse_task(text, task="r", params={"d": "1s", "T": 20})
    expected = [stl.parse(f"F[0,20) G[0,10] (A & F[0,{d}] B)") for d in (2, 4)]
    monkeypatch.setattr("stltool.logic.parser.read", None)  # nothing may be read from here on
    later = task.with_params(T=20)
    assert later == fresh
    assert [later.formula, later.with_params(d="2s").formula] == expected
    with pytest.raises(StlSyntaxError, match="there is no param tua to override; did you mean tau"):
        task.with_params(tua=3)
    with pytest.raises(StlSyntaxError, match="the bound 2.5 is not an integer number"):
        task.with_params(T=5)
    with pytest.raises(StlSyntaxError, match="d is a time; override it with a unit, as in -p d=3s"):
        task.with_params(d=3)
    with pytest.raises(StlSyntaxError, match="T is a plain number; override it without a unit"):
        task.with_params(T="3s")


def test_a_task_of_no_text_has_no_params_to_change():
    from stltool.logic.task import Task

    with pytest.raises(SettingsError, match="not parsed from text"):
        Task("r", A).with_params(T=3)


def test_a_param_may_be_repeated_with_its_value_only():
    assert stl.parse_task("param t1=1, t2=2\nparam t1=1.0\nr := F[0,t1] A", params={"t1": 3}).formula == stl.parse(
        "F[0,3] A"
    )
    with pytest.raises(StlSyntaxError, match="t1 is defined twice"):
        stl.parse_task("param t1=1\nparam t1=2\nr := F[0,t1] A")


# ------------------------------------------------------------------------------------------- sizes


@pytest.mark.soak(only=True)
def test_large_texts_parse_or_are_refused_in_words(tmp_path):
    many = stl.parse(" & ".join(["(x > 0 | F[0,3] b)"] * 1500))
    assert len(many.args) == 1500
    assert stl.parse("(" * 10_000 + "a" + ")" * 10_000) == A
    for text in (
        "G[0,1] " * 500 + "a",
        " -> ".join("a" * 3000),
        " + ".join("x" * 3000) + " > 0",
        "!" * 3000 + "a",
    ):
        with pytest.raises(StlSyntaxError, match="nested too deeply"):
            stl.parse(text)
        with pytest.raises(StlSyntaxError, match="nested too deeply"):
            stl.parse_task(f"r := {text}")
    with pytest.raises(StlSyntaxError, match=r"more than the limit of 2000000"):
        stl.parse("a & " * 600_000)
    with pytest.raises(StlSyntaxError, match="the text ends here"):
        stl.parse("(" * 10_000)
    path = tmp_path / "task.stl"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(FileError, match="not a task file: it has 100000000 bytes"):
        stl.load_task(path)


# ------------------------------------------------------------------------------------------- quantities


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("0.1s", "1/10"), ("2 min", "120"), ("1e-3ms", "1/1000000"), (".5h", "1800"), ("3us", "3/1000000")],
)
def test_durations(text, seconds):
    assert quantity("tau", text) == Duration(Fraction(seconds))
    assert duration(text) == Duration(Fraction(seconds))


@pytest.mark.parametrize("text", ["", "s", "3", "3 parsecs", "nan s", "3m"])
def test_no_durations(text):
    assert duration(text) is None


@pytest.mark.parametrize(("text", "says"), [("1e9999s", "out of range"), ("0x3s", "not a number"), ("1s/0", "zero")])
def test_durations_with_a_number_that_is_none(text, says):
    with pytest.raises(SettingsError, match=f"param tau: .*{says}"):
        quantity("tau", text)


@given(st.fractions(min_value=-5, max_value=10**6))
def test_durations_print_as_what_they_are(seconds):
    assert duration(str(Duration(seconds))) == Duration(seconds)
    assert stl.parse_task(f"step = {Duration(abs(seconds) + 1)}\nr := A").step == Duration(abs(seconds) + 1)


def test_steps_and_params_from_outside_are_checked():
    with pytest.raises(SettingsError, match="step '3' is not a positive time with a unit"):
        stl.parse("a", step="3")
    with pytest.raises(SettingsError, match="is not a positive time"):
        stl.parse("a", step="0s")
    with pytest.raises(SettingsError, match="param T: '3 parsecs' is not a number"):
        stl.parse("a", params={"T": "3 parsecs"})


# ------------------------------------------------------------------------------------------- files of other tools


def test_a_file_in_rlroms_dialect_is_read_as_it_is():
    task = stl.load_task(DATA / "dialects" / "pendulum.stl")
    assert (task.name, stl.horizon(task.formula)) == ("phi_up_gently", 200)
    assert "abs(angle) < 0.05 & angle_dot > -1" in str(task)


def test_files_in_breachs_dialect_are_read_with_lines_for_step_and_unit():
    text = (DATA / "dialects" / "boiler.stl").read_text()
    with pytest.raises(
        StlSyntaxError, match=r"write 0 or 1; for times in seconds, add the lines step = 0\.1s and unit = s"
    ):
        stl.parse_task(text)
    task = stl.parse_task(f"step = 0.1s\nunit = s\n{text}")
    assert (task.name, stl.horizon(task.formula)) == ("warm_by_then", 400)
    assert "abs(wanted - water) <= 0.05 * wanted | !(water - wanted > 2 * 0.05 * 20)" in str(task)
    assert stl.horizon(task.definitions["flame_out"]) == 365

    text = (DATA / "dialects" / "lift.stl").read_text()
    with pytest.raises(StlSyntaxError, match="always needs an interval"):
        stl.parse_task(text)
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task(text, unbounded=True)
    assert str(caught.value).endswith("2 errors")  # of the three lines with broken seconds, one refers to another
    task = stl.parse_task(f"step = 0.05s\nunit = s\n{text}", unbounded=True)
    assert str(task) == "served := (F[0,900] (floor == 3)) & (G[0,inf) (floor <= 9))"
    closes = "G[0,inf) ((!(door >= 0.9) & (F[1,2] (door >= 0.9))) -> (F[2,70] !(door >= 0.9)))"
    assert str(task.definitions["closes"]) == closes


def test_a_file_in_breachs_dialect_that_reads_other_steps():
    text = (DATA / "dialects" / "patterns.stl").read_text()
    task = stl.parse_task(f"step = 0.05s\nunit = s\n{text}")
    flat = "F[1,1] (abs(y_ - y_[t-1]) < 1e-07 * 0.05)"
    assert str(task.definitions["settles"]) == f"F[0,156] G[0,10] {flat}"
    assert str(task.definitions["bump"]) == "(F[4,4] (y_ - y_[t-4] > 0.5)) & (F[0,12] F[4,4] (y_[t-4] - y_ > 0.5))"
    assert stl.horizon(task.definitions["steeper"]) == stl.lookback(task.definitions["steeper"]) == 1


@needs_outside("stl")
@pytest.mark.parametrize("name", ["rlrom/cartpole", "rlrom/minigrid"])
def test_rlrom_files_are_read_as_they_are(name):
    assert stl.horizon(stl.load_task(OUTSIDE / "stl" / f"{name}.stl").formula) in (500, 1000)


@needs_outside("stl")
def test_breach_files_are_read_with_lines_for_step_and_unit():
    text = (OUTSIDE / "stl" / "breach" / "AFC_simple_spec.stl").read_text()
    with pytest.raises(StlSyntaxError, match=r"add the lines step = 0\.1s and unit = s"):
        stl.parse_task(text)
    task = stl.parse_task(f"step = 0.1s\nunit = s\n{text}")
    assert (task.name, stl.horizon(task.formula)) == ("AF_overshoot_req", 405)
    assert "AF - AFref > 0.01 * 14.7" in str(task.formula)

    text = (OUTSIDE / "stl" / "breach" / "Autotrans_spec.stl").read_text()
    with pytest.raises(StlSyntaxError, match="always needs an interval"):
        stl.parse_task(text)
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task(text, unbounded=True)
    assert str(caught.value).endswith("3 errors")  # the three lines with broken seconds
    task = stl.parse_task(f"step = 0.01s\nunit = s\n{text}", unbounded=True)
    assert str(task).startswith("phi_return3 := G[0,inf) ((gear == 3 & (F[1,2] !(gear == 3))) -> (G[10,110]")


@needs_outside("stl")
def test_breachs_library_is_read_with_its_own_rise_and_fall():
    text = (OUTSIDE / "stl" / "breach" / "stlib.stl").read_text()
    task = stl.parse_task(f"step = 0.01s\nunit = s\n{text}", task="spike")
    assert str(task.formula) == "(F[20,20] (x_ - x_[t-20] > 0.1)) & (F[0,40] F[20,20] (x_[t-20] - x_ > 0.1))"
    assert len(task.definitions) == text.count(":=")
    assert sum("is a definition here, not the operator" in str(told) for told in stl.ambiguities(task)) == 2


def calls(run):
    """How many Python functions are called: work that no clock measures."""
    count = 0

    def count_one(frame, event, arg):
        nonlocal count
        count += event == "call"

    sys.setprofile(count_one)
    try:
        run()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("piece", ["(always[0,3] (x > 1)) and ", "b or not c and ", "(x - 1) / 2 > 3 -> d) and ("])
def test_reading_takes_work_in_proportion_to_the_text(piece):
    texts = ["(" * ("and (" in piece) + piece * n + "a" + ")" * ("and (" in piece) for n in (100, 200, 400)]
    stl.parse(texts[0])
    first, second, third = (calls(lambda text=text: stl.parse(text)) for text in texts)
    assert (third - second) / (second - first) == pytest.approx(2, rel=0.02)


def lines_run(run):
    """How many lines of Python are run: work that no clock measures, loops without calls among it."""
    count = 0

    def count_one(frame, event, arg):
        nonlocal count
        count += event == "line"
        return count_one

    before = sys.gettrace()
    sys.settrace(count_one)
    try:
        with contextlib.suppress(StlSyntaxError):
            run()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize(("begin", "piece"), [
    ("", "d := F[5,3] A\n"),  # a fault in each statement, found by the builder
    ("", "d := F[0,3 A\n"),  # or by the parser
    ("", "d{} := F[0,3] A\n"),
    ("d := ", "once["),
    ("d := A & ", "once[ a "),
    ("d := A\n", "# c\n"),
    ("d := A\n", "param p{} = 3\n"),
    ("d := A", " & F[0,3] A"),
])  # fmt: skip
@pytest.mark.parametrize("read", [stl.parse_task, stl.format_task])
def test_hostile_texts_take_work_in_proportion_to_their_length(read, begin, piece):
    texts = [begin + "".join(piece.replace("{}", str(i)) for i in range(n)) for n in (50, 100, 200)]
    with contextlib.suppress(StlSyntaxError):
        read(texts[0])
    first, second, third = (lines_run(lambda text=text: read(text)) for text in texts)
    assert third - second <= 2.2 * (second - first)


def test_a_file_of_too_many_statements_is_refused_with_their_number():
    most = syntax.MOST_STATEMENTS
    text = "".join(f"param p{i} = 3\n" for i in range(most))
    with pytest.raises(StlSyntaxError, match=f"the text has {most + 1} statements, more than the limit of {most}"):
        stl.parse_task(text + "d := A")


@given(st.text("ab\r\n\t", max_size=30), st.integers(0, 29))
def test_lines_and_columns_are_counted(text, place):
    place = min(place, len(text))
    before = "".join("\n" if c == "\r" and text[i + 1 : i + 2] != "\n" else c for i, c in enumerate(text))[:place]
    span = Span(Source("text", text), place, place + 1)
    assert span.line == before.count("\n") + 1
    assert span.column == len(before) - (before.rfind("\n") + 1) + 1


def test_lines_of_old_macs_are_counted():
    with pytest.raises(StlSyntaxError, match="line 3, column 8"):
        stl.parse_task("a := B\r# c\rr := A §\rq := C\r")
