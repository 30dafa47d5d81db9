"""`expect` lines of task files: they print and parse back, keep their comments, and are refused with a sentence."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import StlSyntaxError
from stltool.logic.format import format_task
from stltool.logic.lint import ambiguities
from stltool.logic.parser import survey_task
from stltool.logic.syntax import read
from stltool.source import Source
from stltool.testing import expectations
from tests.conftest import many


def of(text):
    return stl.parse_task(text).expectations


@given(expectations())
def test_an_expectation_prints_and_parses_back(expected):
    (again,) = of(f"r := a\n{expected}")
    assert again == expected
    assert str(again) == str(expected)


@settings(max_examples=many(40))
@given(st.lists(expectations(), max_size=3), st.sampled_from(["\n", " ; ", " # why\n", "\n// so\n\n"]))
def test_the_layout_keeps_expectations_and_comments(expected, between):
    text = between.join(["r := a", *map(str, expected)])
    laid_out = format_task(text)
    assert of(laid_out) == tuple(expected)
    assert format_task(laid_out) == laid_out
    before, after = ([c.text.lstrip("#/ ") for c in read(Source("t", t), "task").comments] for t in (text, laid_out))
    assert before == after


def test_what_a_file_expects():
    task = stl.parse_task(
        "param p = 19/20, T = 5\nexpect Pmax( patrolling )≥p // before its definition\npatrolling := F[0,T] A\n"
        'expect robust Pmin(patrolling and B) < 1/3; expect P(patrolling, policy "out/p.npz") > p - 1/20\n'
        'expect holds(G x > 0, trace "log 1.csv")',
        {"T": 7},
    )
    assert task.name == "patrolling"
    assert [str(expectation) for expectation in task.expectations] == [
        "expect Pmax(patrolling) >= 0.95",
        "expect robust Pmin((F[0,7] A) & B) < 1/3",
        'expect P(patrolling, policy "out/p.npz") > 0.9',
        'expect holds(G[0,inf) (x > 0), trace "log 1.csv")',
    ]
    assert [(e.name, e.bound, e.span.line) for e in task.expectations] == [
        ("patrolling", Fraction(19, 20), 2), (None, Fraction(1, 3), 4), ("patrolling", Fraction(9, 10), 4),
        (None, None, 5),
    ]  # fmt: skip
    assert all(e.formula == task.formula for e in task.expectations if e.name is not None)
    assert [str(e) for e in task.with_params(p=1).expectations][:1] == ["expect Pmax(patrolling) >= 1"]


def test_what_is_counted():
    task = stl.parse_task(
        "param n = 3\npremise := request & !busy\nanswers := G[0,12] (premise -> F[0,4] level > n)\n"
        "limit := G[0,3] level < 9\nexpect cover(premise, of answers) >= 100; expect cover(limit) > n\n"
        'expect cover( level>n , trace "a b.csv",mattered, of answers) > 2*5; expect cover(answers, vacuous) <= 0\n'
    )
    assert [str(expectation) for expectation in task.expectations] == [
        "expect cover(request & !busy, of answers) >= 100",
        "expect cover(limit, of limit) > 3",
        'expect cover(level > 3, mattered, of answers, trace "a b.csv") > 10',
        "expect cover(answers, vacuous, of answers) <= 0",
    ]
    assert [(e.name, e.measure, e.part == e.formula, e.trace) for e in task.expectations] == [
        ("answers", "held", False, None), ("limit", "held", True, None), ("answers", "mattered", False, "a b.csv"),
        ("answers", "vacuous", True, None),
    ]  # fmt: skip
    again = stl.parse_task(format_task(task.document.source.text))
    assert again.expectations == task.expectations


def test_a_faulty_definition_is_told_once():
    for line in ("expect cover(r) > 1", "expect cover(level < 3) > 1"):
        with pytest.raises(StlSyntaxError) as refused:
            stl.parse_task(f"r := G[0,3] level <\n{line}")
        assert "line 2" not in str(refused.value)


def test_only_formulas_have_parts():
    with pytest.raises(StlSyntaxError, match="limit is a number; write of NAME with a definition that is a formula"):
        stl.parse_task("r := a\nlimit := 3 * x\nexpect cover(a) >= 1")
    with pytest.raises(StlSyntaxError, match="the file has none; write one, such as r := F"):
        stl.parse_task("expect cover(a) >= 1")


@pytest.mark.parametrize(
    "text",
    [
        "expect := G[0,5] a\nr := expect & b",
        "r := F[0,3] expect",
        "a := b & expect\nholds := c | expect\nr := a",
        "r := expect U[0,3] b",
        "r := expect until_(0,3) b",
        "r := F[0,2] expect and (b)",
        "r := F[0,3] expect // so\nparam T = 3",
        'r := expect\nmodel "x.toml"',
        "r := expect\nstep = 3s",
        "signal expect\nr := expect > 3",
        "param expect = 3\nr := x > expect",
        "r := expect\nsignal x",
        "r := b -> expect; s := r",
    ],
)
def test_an_old_file_may_use_the_name(text):
    task = stl.parse_task(text)
    assert task.expectations == ()
    assert format_task(format_task(text)) == format_task(text)


def test_the_name_and_the_word_in_one_file():
    (expected,) = of("r := b -> expect\nexpect Pmax(r) >= 0.5")
    assert str(expected) == "expect Pmax(r) >= 0.5"


@pytest.mark.parametrize(
    ("line", "place", "told"),
    [
        ("expect", 1, "begins with its question; write, for example, expect Pmax(name) >= 0.95"),
        ("expects Pmax(r) >= .5", 1, "begins with its question; write, for example, expect Pmax(name) >= 0.95"),
        ("expect .5 <= Pmax(r)", 1, "begins with its question; write, for example, expect Pmax(name) >= 0.95"),
        ("expect Pmax(r) = .5", 16, "for equality, write two lines, one with >= and one with <="),
        ("expect Pmax(r) >= goal", 19, "goal is not a param; give it a value: param goal = 0.95"),
        ("expect Pmax(r) > .5 & expect Pmin(r) > .5", 21, "write each on a line of its own"),
        ("expect r", 9, "such as expect Pmax(name) >= 0.95"),
        ("expect Pmax r >= .5", 15, "such as expect Pmax(name) >= 0.95"),
        ("expect Pmx(r) >= .5", 8, "did you mean Pmax?"),
        ("expect probability(r) >= .5", 8, "write Pmax, Pmin, P (of a policy), holds (on a trace) or cover (a count)"),
        ("expect robst Pmax(r) > .5", 8, "did you mean robust?"),
        ("expect Pmax(r)", 8, "write, for example, expect Pmax(r) >= 0.95"),
        ("expect Pmax(r) >= 1.5", 19, "1.5 is not a probability, which lies between 0 and 1"),
        ("expect Pmax(r) >= 0 - 1/2", 19, "-0.5 is not a probability"),
        ("expect Pmax(r) == 1/2", 16, "write both expect Pmax(r) >= 1/2 and expect Pmax(r) <= 1/2"),
        ("expect Pmax(r) ≠ .5  # why", 16, "for !=, write expect Pmax(r) > .5, or expect Pmax(r) < .5"),
        ("expect Pmax(r) > T", 18, "T is not a param"),
        ("expect Pmax(r) > 3s", 18, "write a number such as 0.95 or 19/20"),
        ("expect Pmax(r) .5", 16, "expected an operator"),
        ("expect Pmax(3) > .5", 13, "expected a Boolean expression, found a number"),
        ("expect Pmax(G a) > .5", 13, "needs an interval with an end"),
        ("expect Pmax(r >= .5", 20, "the parenthesis opened at line 2, column 12 is not closed"),
        ("expect Pmax(r) >= 95%", 21, "such as 0.95 or 95/100"),
        ('expect Pmax(r, policy "p.npz") > .5', 16, 'write P(…, policy "p.npz")'),
        ('expect Pmin(r, trace "p.csv") > .5', 16, "takes no trace"),
        ("expect P(r) > .5", 8, 'write P(…, policy "p.npz"), or Pmax or Pmin'),
        ('expect P(r, trace "x") >= .5', 13, 'write policy "p.npz"'),
        ('expect P(r, policy "") > .5', 20, "this names no file"),
        ("expect P(r, policy p) > .5", 20, 'write policy "p.npz"'),
        ("expect P(r, policy p.npz) > .5", 20, 'write policy "p.npz"'),
        ('expect P(r, "p.npz") > .5', 13, 'write, for example, policy "p.npz"'),
        ("expect holds(r)", 8, 'write holds(…, trace "log.csv")'),
        ('expect robust holds(r, trace "x")', 8, "leave robust out"),
        ('expect holds(r, trace "x") >= .5', 28, "leave the bound out"),
        ('expect holds(r, policy "x")', 17, 'write trace "log.csv"'),
        ("expect holds(r, trace)", 17, 'write trace "log.csv"'),
        ('expect P(r, policy "x", trace "y") > .5', 25, "P takes one file at most"),
        ("expect Pmax(r, policy) > .5", 16, "Pmax is over all policies and takes no policy"),
        ("expect cover(r)", 8, "write, for example, expect cover(r) >= 100"),
        ("expect robust cover(r) >= 1", 8, "leave robust out"),
        ("expect cover(b) >= 1", 14, "b is not a part of r; it has no parts; for another definition, write of NAME"),
        ("expect cover(r, of s) >= 1", 20, "there is no definition s; known names: r"),
        ("expect cover(r, of) >= 1", 17, "of takes the name of a definition, without quotes"),
        ('expect cover(r, of "r") >= 1', 20, "of takes the name of a definition, without quotes"),
        ("expect cover(r, trace log) >= 1", 23, 'write trace "log.csv"'),
        ('expect cover(r, trace "") >= 1', 23, "this names no file"),
        ('expect cover(r, held "x") >= 1', 22, "nothing follows held; write held"),
        ("expect cover(r, hold) >= 1", 17, "hold is not something to say of a count; did you mean held?"),
        ("expect cover(r, held, failed) >= 1", 23, "failed is said after held; leave one of them out"),
        (
            "expect cover(r, mattered) >= 1",
            17,
            "not counted of the whole; write held, failed, vacuous, premises, parts",
        ),
        ("expect cover(r) >= 1.5", 20, "expected a count, an integer from 0 up, found 1.5; write 100"),
        ("expect cover(r) >= 3s", 20, "expected a count, an integer from 0 up, found 3s; write 100"),
        ("expect cover(r) >= -1", 20, "expected a count, an integer from 0 up, found -1; write 100"),
        ("expect cover(r) == 3", 17, "a count is compared by >=, <=, > or <; for ==, write both expect cover(r) >= 3"),
    ],
)
def test_a_slip_is_refused_with_its_place_and_a_remedy(line, place, told):
    with pytest.raises(StlSyntaxError) as refused:
        stl.parse_task(f"r := a\n{line}")
    assert told in str(refused.value)
    assert f"line 2, column {place}:" in str(refused.value)


@pytest.mark.parametrize(
    ("params", "told"),
    [
        ("T = 3", "goal is not a param; give it a value: param goal = 0.95; known names: T"),
        ("T = 3, gaol = 1", "goal is not a param; did you mean gaol?"),
    ],
)
def test_a_missing_param_of_a_bound_is_advised_whatever_else_the_file_has(params, told):
    for bound in ("goal", "1 - goal", "min(goal, 1)"):
        with pytest.raises(StlSyntaxError) as refused:
            stl.parse_task(f"param {params}\nr := F[0,T] a\nexpect Pmax(r) >= {bound}")
        assert told in str(refused.value)
    with pytest.raises(StlSyntaxError, match="T is not a param; give it a value: param T = 10; known names: lag"):
        stl.parse_task("param lag = 3\nr := F[0,T] a")


def test_a_fault_elsewhere_does_not_hide_those_of_expectations():
    with pytest.raises(StlSyntaxError) as refused:
        stl.parse_task("r := a &\nexpect Pmax(r) >= 2\nexpect Pmax(s) >= 3\n")
    assert [line for line in str(refused.value).splitlines() if "task, line" in line or "errors" in line] == [
        "task, line 1, column 9: the statement ends here; expected a formula",
        "task, line 3, column 19: 3 is not a probability, which lies between 0 and 1; write another bound",
        "2 errors",
    ]  # of line 2 nothing can be said, since r is faulty


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("expect Pmax(patrolling) >= 0", "every probability is from 0 up, so this always holds; write another bound"),
        ("expect Pmin(patrolling) <= 1", "every probability is at most 1, so this always holds; write another bound"),
        ("expect Pmin(patrolling) > p + 1", "every probability is at most 1, so this never holds; write another bound"),
        ("expect Pmin(patrolling) < p", "every probability is from 0 up, so this never holds; write another bound"),
        ("expect cover(patrolling) >= 0", "every count is from 0 up, so this always holds; write another bound"),
        ("expect cover(patrolling) < p", "every count is from 0 up, so this never holds; write another bound"),
        ("expect Pmax(patroling) >= 0.5", "patroling is read as a signal or label; did you mean patrolling?"),
        ("expect Pmax(A) >= 0.5", "A is not defined here and is read as a label at step 0; known names: patrolling"),
    ],
)
def test_what_is_suspicious_is_told(line, told):
    (advice,) = ambiguities(stl.parse_task(f"param p = 0\npatrolling := F[0,3] A\n{line}\n"))
    assert advice.message == told
    assert advice.span.line == 3


def test_what_is_defined_is_known_whether_or_not_it_can_be_built():
    text = 'forever := G a\nwrong := F[0,T] a\nexpect holds(forever, trace "log.csv")\nexpect Pmax(wrong) > 1/2\n'
    assert ambiguities(read(Source("t", text), "task")) == []


def test_a_file_read_for_its_expectations_may_be_unbounded_also_with_other_params(tmp_path):
    (tmp_path / "log.stl").write_text("param T = 2\nr := F G[0,T] a\n")
    task = survey_task(tmp_path / "log.stl").task
    assert task.formula == stl.parse("F G[0,2] a", unbounded=True)
    assert task.with_params(T=3).formula == stl.parse("F G[0,3] a", unbounded=True)


def test_signals_of_expectations_are_declared_too():
    task = stl.parse_task("signal x\nr := x > 0\nparam p = 1/2\nexpect Pmax(r & y > 0) >= p")
    assert [advice.message for advice in ambiguities(task)] == ["y is not declared on a signal line; known names: x"]


@given(expectations())
def test_what_prints_is_told_only_for_its_bound(expected):
    found = ambiguities(stl.parse_task(f"r := a\n{expected}"))
    assert all(expected.trivial is not None or "label at step 0" in advice.message for advice in found)
    assert (expected.trivial is not None) == any("probability is" in advice.message for advice in found)
