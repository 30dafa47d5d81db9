import math
from fractions import Fraction

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, FileError, SettingsError, StlSyntaxError
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Or,
    Until,
    Variable,
    horizon,
    walk,
    with_children,
)
from stltool.logic.syntax import TERMINAL_WORDS, _lark
from stltool.testing import formulas, predicates

A, B, C = Label("a"), Label("b"), Label("c")


@given(formulas(longest=12))
def test_text_of_a_formula_parses_back_to_it(phi):
    assert stl.parse(str(phi)) == phi


@given(predicates())
def test_text_of_a_predicate_parses_back_to_it(psi):
    assert stl.parse(str(psi)) == psi


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("a or b -> c", Implies(Or((A, B)), C)),
        ("a -> b -> c", Implies(A, Implies(B, C))),
        ("a & b | c", Or((And((A, B)), C))),
        ("a and b and c", And((A, B, C))),
        ("(a and b) and c", And((And((A, B)), C))),
        ("G[0,2] a and b", And((Always(Interval(0, 2), A), B))),
        ("!a U[1,4) b", Until(Interval(1, 3), Not(A), B)),
        ("a U[0,1] b & c", And((Until(Interval(0, 1), A, B), C))),
        ("not x > 0", Not(Comparison(">", Variable("x"), Number(0.0)))),
        ("a <-> b", Iff(A, B)),
        ("a xor b", Not(Iff(A, B))),
        ("ev [0:3] alw (0..3) a", Eventually(Interval(0, 3), Always(Interval(1, 2), A))),
        ("◇[0,1] □(0,1] ¬a", Eventually(Interval(0, 1), Always(Interval(1, 1), Not(A)))),
        ("<>[0,1] [] [0,1] a /\\ b \\/ c", Or((And((Eventually(Interval(0, 1), Always(Interval(0, 1), A)), B)), C))),
        ("-2 <= x", Comparison("<=", Negate(Number(2.0)), Variable("x"))),
        ("x ≥ 1 # a comment", Comparison(">=", Variable("x"), Number(1.0))),
        ("a // and\n& b", And((A, B))),
        ("a<=>b", Iff(A, B)),
        ("a<->b", Iff(A, B)),
        ("a=>b", Implies(A, B)),
        ("a->!b", Implies(A, Not(B))),
        ("a/\\b||c", Or((And((A, B)), C))),
        ("x<-1", Comparison("<", Variable("x"), Negate(Number(1.0)))),
        (
            "x!=1&x<=1",
            And((Comparison("!=", Variable("x"), Number(1.0)), Comparison("<=", Variable("x"), Number(1.0)))),
        ),
        ("Gate & Format & Under", And((Label("Gate"), Label("Format"), Label("Under")))),
    ],
)
def test_precedence_and_spellings(text, meaning):
    assert stl.parse(text) == meaning


def test_params_are_exact_in_bounds():
    phi = stl.parse("F[0, 10*step) a & G[T/3, 3^2] x < tau", params={"step": "0.3", "T": 12, "tau": -0.5})
    assert phi == stl.parse("F[0,3) a & G[4,9] x < -0.5")


def test_horizon_counts_steps_after_now():
    assert stl.horizon(stl.parse("G[0,15) (F[0,15) A & F[0,15) (x < 0.4 & y > 0.6))")) == 28
    assert stl.horizon(stl.parse("a U[2,5] F[1,3] b")) == 8
    assert stl.horizon(stl.parse("x > 0")) == 0


def test_an_interval_without_an_end_has_no_horizon():
    open_ended = Always(Interval(2, None), A)
    assert str(open_ended) == "G[2,inf) a"
    for question in (stl.horizon, stl.compile_automaton, stl.check_fragment):
        with pytest.raises(StlSyntaxError, match="always has no interval with an end"):
            question(Or((B, open_ended)))
    with pytest.raises(StlSyntaxError, match="write one, such as"):
        len(open_ended.interval)


@given(formulas())
def test_horizon_is_bounded_by_its_operands(phi):
    assert all(horizon(node) <= horizon(phi) for node in walk(phi))


@given(formulas())
def test_children_rebuild_their_parent(phi):
    from stltool.logic.formula import children

    assert with_children(phi, children(phi)) == phi


def test_every_terminal_of_the_grammar_has_words():
    named = {terminal.name for terminal in _lark().terminals}
    ignored = {name for name in named if name.startswith("__IGNORE")}
    assert named - ignored <= set(TERMINAL_WORDS)
    assert set(TERMINAL_WORDS) - named == {"$END"}


REFUSED = [
    ("G[0,3] (a &\n  & b)", "line 2, column 3", "expected a formula"),
    ("G a", "line 1, column 1", "such as G[0,10]"),
    ("F (a & b)", "line 1, column 1", "such as F[0,10]"),
    ("a & b U c", "line 1, column 7", "until needs an interval with an end here, such as U[0,10]"),
    ("G[2,inf) a", "line 1, column 2", "such as G[2,12]"),
    ("F[] a", "line 1, column 2", "could be an empty interval"),
    ("F[3] a", "line 1, column 4", "an interval needs two bounds; from now to 3, as in MLTL, is F[0,3]"),
    ("F[a > 3] b", "line 1, column 5", "an interval needs two integer bounds"),
    ("a b", "line 1, column 3", "expected an operator between 'a' and 'b'"),
    ("2 < x < 4", "line 1, column 1", "write (x > 2 & x < 4)"),
    ("x + 1", "line 1, column 1", "x + 1 > 0"),
    ("sqrt(a & b) > 1", "line 1, column 6", "expected a number, found a Boolean expression"),
    ("F[0,2.5] a", "line 1, column 5", "2.5 is not an integer number of steps; write 2 or 3"),
    ("F[3,3) a", "line 1, column 2", "the interval [3,3) is empty"),
    ("F[5,2] a", "line 1, column 2", "the interval [5,2] is empty; write, for example, [2,5]"),
    ("F[5,-1] a", "line 1, column 2", "the interval [5,-1] is empty; write, for example, [0,5]"),
    ("G[5,0] a", "line 1, column 2", "the interval [5,0] is empty; write, for example, [0,5]"),
    ("F[-1,2] a", "line 1, column 3", "steps count from 0"),
    ("F[0,T] a", "line 1, column 5", "T is not a param; give it a value: param T = 10"),
    ("F[0,1/0] a", "line 1, column 5", "division by zero"),
    ("F[0,1e999999] a", "line 1, column 5", "out of range"),
    ("F[0,sqrt(4)] a", "line 1, column 5", "no exact value"),
    ("x = 3", "line 1, column 3", "write == to compare"),
    ("a U[0,1] b U[0,2] c", "line 1, column 12", "until cannot be chained"),
    ("foo(x) > 2", "line 1, column 4", "foo is not a function"),
    ("a § b", "line 1, column 3", "unexpected character '§'"),
    ("3x > 2", "line 1, column 1", "runs into letters"),
    (
        "(a",
        "line 1, column 3",
        "the text ends here; the parenthesis opened at line 1, column 1 is not closed; write )",
    ),
    (
        "F[0,T b",
        "line 1, column 7",
        "the interval opened at line 1, column 2 is not closed; write ] or ) before 'b'",
    ),
    ("F[0,5 -x > 3", "line 1, column 10", "the interval opened at line 1, column 2 is not closed; write ] or )"),
    ("G[0,5] (F[0,3 a)", "line 1, column 15", "the interval opened at line 1, column 10 is not closed"),
    ("F[0,3 F[0,5] a", "line 1, column 7", "the interval opened at line 1, column 2 is not closed"),
    (
        "F[0, (2+1] a",
        "line 1, column 10",
        "the parenthesis opened at line 1, column 6 is not closed; write ) before ']'",
    ),
    ("F(0,5 x > 3", "line 1, column 7", "the interval opened at line 1, column 2 is not closed; write ] or )"),
    ("always (mode = 2 -> v <= 3)", "line 1, column 14", "unexpected '='; write == to compare, := to define\n"),
    ("always (mode = 2", "line 1, column 14", "define; the parenthesis opened at line 1, column 8 is not closed"),
    ("G (sin(x) > 3)", "line 1, column 7", "unexpected '('; sin is not a function"),
    ("[] (output(0) < 4750)", "line 1, column 11", "as in FalCAuN; write the name of the signal"),
    ("signal(0) < 4750 & a", "line 1, column 7", "as in FalCAuN; write the name of the signal"),
    ("a & O[0,3] b", "line 1, column 8", "there is no operator O; write once[0,3] a"),
    ("G[0,9] (a S[2,T] b)", "line 1, column 11", "there is no operator S; write a since[2,T] b"),
    ("F[0,9] H a", "line 1, column 10", "there is no operator H; write historically[0,5] a"),
    ("mode in {1,2}", "line 1, column 9", "a set is written as comparisons"),
    ("x <> 5", "line 1, column 3", "write != for not equal"),
    ("x ~= 5", "line 1, column 3", "write != for not equal"),
    ("F<=5 a", "line 1, column 2", 'for PRISM\'s F<=5, write F[0,5]; for a signal called F, write "F" <= 5'),
    ("a U>5 b", "line 1, column 4", "write U(5,inf)"),
    ("F != 5", "line 1, column 3", 'for a signal of that name, write "F" != 5'),
    ("Pmax=? [ F<=5 a ]", "line 1, column 6", "write the formula alone and use stltool check"),
    ("P>=0.9 [ F[0,5] a ]", "line 1, column 8", "P >= 0.9 […] bounds a probability, as in PRISM; write the formula"),
    ("G{0,5} a", "line 1, column 2", "unexpected '{'; an interval is in brackets: G[0,5]"),
    ("F[0,3] {a & b}", "line 1, column 8", "group with parentheses"),
    ("a imply b", "line 1, column 3", "write implies, or ->"),
    ("x => 5", "line 1, column 1", "to compare, write x >= 5"),
    ("x =< 5", "line 1, column 3", "write <= for =<"),
    ("F[0 a", "line 1, column 5", "such as F[0,10]; the interval opened at line 1, column 2 is not closed"),
    ("x[t > 3", "line 1, column 5", "the bracket opened at line 1, column 2 is not closed; write ] before '>'"),
    ("abs(x > 3", "line 1, column 10", "the parenthesis opened at line 1, column 4 is not closed; write )"),
    ("(a b", "line 1, column 4", "between 'a' and 'b'; the parenthesis opened at line 1, column 1 is not closed"),
    ("G[0,5] (a &", "line 1, column 12", "expected a formula; the parenthesis opened at line 1, column 8 is not"),
    ("a)", "line 1, column 2", "there is no open parenthesis here; remove it, or open one earlier"),
    ("F[0,5]] a", "line 1, column 7", "there is no open bracket here; remove it, or open one earlier"),
    ("abs(x, y) > 1", "line 1, column 1", "abs takes one argument, not 2"),
    ("x > 1e400", "line 1, column 5", "too large for a double"),
]


def test_a_syntax_error_says_where_what_and_what_to_write():
    for text, place, says in REFUSED:
        with pytest.raises(StlSyntaxError) as caught:
            stl.parse(text)
        message = str(caught.value)
        assert place in message, text
        assert says in message, text
        line, caret = message.splitlines()[-2:]
        assert line.strip() in text
        assert set(caret.strip()) == {"^"}
        assert caret.index("^") - 4 == int(place.rsplit(" ", 1)[1]) - 1, text


@given(phi=formulas(), data=st.data())
def test_a_missing_bracket_is_named_with_the_one_it_should_close(phi, data):
    text = str(phi)
    closers = [place for place, character in enumerate(text) if character in "])"]
    assume(closers)
    place = data.draw(st.sampled_from(closers))
    broken = text[:place] + text[place + 1 :]
    with pytest.raises(StlSyntaxError, match=r"opened at line 1, column (\d+) is not closed") as caught:
        stl.parse(broken)
    column = int(str(caught.value).split("opened at line 1, column ")[1].split(" ")[0])
    assert broken[column - 1] in "[("
    at = int(str(caught.value).split("line 1, column ")[1].split(":")[0])
    assert column < at


def test_brackets_of_a_statement_are_its_own():
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task('model "floor.toml\na := (b & F[0,3] c\nd := G[0,2 a\n')
    message = str(caught.value)
    assert "line 1, column 7: this quote is not closed; close it on the same line" in message
    assert "line 2, column 19: the statement ends here; the parenthesis opened at line 2, column 6 is not" in message
    assert "line 3, column 12: unexpected 'a'; the interval opened at line 3, column 7 is not closed" in message
    assert message.endswith("3 errors")


@given(phi=formulas(), data=st.data())
def test_no_foreign_character_is_ever_dropped(phi, data):
    text = str(phi)
    place = data.draw(st.integers(0, len(text)))
    foreign = data.draw(st.sampled_from("§$@?`'%€\\{}\0\u200b"))
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse(text[:place] + foreign + text[place:])
    column = int(str(caught.value).split("column ")[1].split(":")[0])
    assert column <= place + 1
    assert " " not in text[column - 1 : place]  # at that place, or at the token that it broke


@given(st.text(max_size=40))
def test_any_text_parses_or_is_refused_in_words(text):
    try:
        phi = stl.parse(text)
    except StlSyntaxError as error:
        assert str(error)
    else:
        assert stl.parse(str(phi)) == phi


def test_old_line_ends_end_comments():
    assert stl.parse_task("r := F[0,3] A # c\rq := F[0,9] A\r").name == "q"


def test_params_may_be_fractions():
    assert (
        stl.parse("x > c", params={"c": Fraction(1, 4)})
        == stl.parse("x > c", params={"c": "1/4"})
        == stl.parse("x > 0.25")
    )


def test_what_parses_can_be_printed_and_walked_however_deep():
    for text in ("(" * 150 + "a" + " & b)" * 150, "!" * 190 + "a", "x + (" * 150 + "x" + ")" * 150 + " > 0"):
        phi = stl.parse(text)
        assert stl.parse(str(phi)) == phi
        assert stl.horizon(phi) == 0
    for text in ("(" * 300 + "a" + " & b)" * 300, "x + (" * 900 + "x" + ")" * 900 + " > 0"):
        with pytest.raises(StlSyntaxError, match="nested too deeply"):
            stl.parse(text)


def test_deep_nesting_is_refused_in_words():
    with pytest.raises(StlSyntaxError, match="nested too deeply"):
        stl.parse("!" * 5000 + "a")
    with pytest.raises(StlSyntaxError, match="empty"):
        stl.parse("   ")


# ------------------------------------------------------------------------------------------- task files

TASK = """
# comment
model "floor.toml"
param T = 10, tau = T/2;   // exact arithmetic
near := abs(x - 0.5)
at_A := A
at_B := near < 0.25 & y > 0.6;
charging := F[0,T) G[0,tau) at_A
patrolling := G[0,T) (F[0,tau) at_A & F[0,tau) at_B)
"""


def test_a_task_file_has_model_params_definitions(tmp_path):
    path = tmp_path / "task.stl"
    path.write_text(TASK, encoding="utf-8-sig")
    task = stl.load_task(path)
    assert task.name == "patrolling"
    assert task.model == tmp_path / "floor.toml"
    assert task.params == {"T": Fraction(10), "tau": Fraction(5)}
    assert task.formula == stl.parse("G[0,9] (F[0,4] A & F[0,4] (abs(x - 0.5) < 0.25 & y > 0.6))")
    with pytest.raises(ArgumentError, match="load_task's task is 3"):
        stl.load_task(path, task=3)
    other = stl.load_task(path, params={"T": 20}, task="charging")
    assert other.formula == stl.parse("F[0,19] G[0,9] A")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file defines no task"),
        ("param T = 3", "the file defines no task"),
        (
            "a := F[0,3] B\nB := x > 0",
            "B is used as a label or signal on line 1, before this definition; rename this definition",
        ),
        ("a := F[0,3] (x > 2)\nparam x = 3\nb := x > 2", "x is used as a label or signal on line 1, before this param"),
        ("param T = 3, T = 4\na := b", "T is defined twice"),
        (
            "a0 := F[0,1] (x > 0)\n" + "".join(f"a{i + 1} := a{i} & a{i}\n" for i in range(30)),
            "more than 50000 operators",
        ),
        ("param a = 10^64, b = a^64, c = b^64\nd := x > 3", "this power is out of range"),
        ("param a = 10^64, b = a^10\nd := x > b", "too large to be compared with a signal"),
        ("param a = 10^64\nd := F[0,a] b", "this bound is out of range"),
        ("d := x > 1e-400", "too small for a double"),
        ("a := b\na := c", "a is defined twice"),
        ('model "a"\nmodel "b"\na := b', "this is a second model line"),
        ("n := 3 + x", "n is a number, not a task"),
        ("n := 3 + x\na := n", "a is a number, not a task"),
        ("param T = 3\na := T", "a is a number, not a task"),
        ("param T = 3\na := T & b", "expected a Boolean expression, but T is a param"),
        ("b := c\na := b > 3", "expected a number, but b is Boolean"),
        ("a := b +", "expected a number, a signal or an arithmetic expression"),
    ],
)
def test_a_task_file_with_a_slip_is_refused(text, says):
    with pytest.raises(StlSyntaxError) as caught:
        stl.parse_task(text)
    assert says in str(caught.value)


def test_unknown_overrides_and_definitions_name_near_misses():
    with pytest.raises(StlSyntaxError, match="there is no param tua to override; did you mean tau"):
        stl.parse_task(TASK, params={"tua": 3})
    with pytest.raises(StlSyntaxError, match="there is no definition patroling; did you mean patrolling"):
        stl.parse_task(TASK, task="patroling")
    with pytest.raises(SettingsError, match="param T: 'many' is not a number"):
        stl.parse_task(TASK, params={"T": "many"})
    with pytest.raises(SettingsError, match="param T: 'nan' is not a finite number"):
        stl.parse_task(TASK, params={"T": math.nan})


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n\0\0\0", b"a := \xff\xfe b", b"PK\x03\x04\0"])
def test_a_binary_file_is_no_task(tmp_path, data):
    path = tmp_path / "task.stl"
    path.write_bytes(data)
    with pytest.raises(FileError, match="not a task file"):
        stl.load_task(path)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileError, match="no such task file"):
        stl.load_task(tmp_path / "none.stl")
    with pytest.raises(FileError, match="this is a folder; name a task file"):
        stl.load_task(tmp_path)


def test_comparisons_in_a_chain_are_advised_with_the_number_last():
    for text, told in (("1 < x <= y < 3", "x > 1 & x <= y & y < 3"), ("x < y < z", "x < y & y < z")):
        with pytest.raises(StlSyntaxError) as refused:
            stl.parse(text)
        assert f"write ({told})" in str(refused.value)
