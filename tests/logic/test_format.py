"""The canonical layout: the meaning stays, comments stay, and laying out twice is laying out once."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, StlSyntaxError
from stltool.logic.format import WIDTH, format_task
from stltool.logic.syntax import read
from stltool.source import Source
from stltool.testing import formulas, predicates
from tests.conftest import DATA, OUTSIDE, needs_outside

SPELLINGS = {
    "&": ["and", "&&", "∧", "/\\"], "|": ["or", "||", "∨"], "!": ["not ", "~", "¬"], "->": ["=>", "→", "implies"],
    "<->": ["iff", "↔", "<=>"], "F": ["ev_", "eventually", "<>", "◇", "finally"], "G": ["alw_", "always ", "[] ", "□"],
    "U": ["until", "until_", "𝒰"], "<=": ["≤"], "!=": ["≠"], ":": [","],
}  # fmt: skip


TOKEN = re.compile(r"\d+e-\d+|<->|->|<=|>=|==|!=|[\w.]+|\S")


@st.composite
def spelled(draw, phi):
    """Some text that a person might write for a formula: other words, spaces, line ends, comments."""
    words = []
    for piece in TOKEN.findall(str(phi)):
        words.append(draw(st.sampled_from([piece, *SPELLINGS.get(piece, [])])))
        words.append(draw(st.sampled_from([" ", " ", "  ", "\n  ", " # why\n", "\n // so\n\n"])))
    return "".join(words)


@given(formulas(longest=12), st.data())
def test_the_layout_keeps_meaning_and_comments_and_is_final(phi, data):
    text = f"# first\n\n\nr := {data.draw(spelled(phi))}\n# last"
    once = format_task(text)
    assert stl.parse_task(once).formula == phi == stl.parse_task(text).formula
    assert format_task(once) == once
    before, after = ([c.text.lstrip("#/ ") for c in read(Source("t", t), "task").comments] for t in (text, once))
    assert before == after
    assert once.endswith("# last\n")


@given(predicates())
def test_a_formula_of_one_line_is_laid_out_as_it_prints(psi):
    text = f"r := {psi}"
    assert format_task(text) == text + "\n" or len(text) > WIDTH


LONG = """
# a patrol
param   T=10 , tau   =T/2   // in steps
model "floor.toml";   step=0.1s
signal x,y


at_A:=A


patrolling := alw_[0,T) (ev_[0,tau) at_A and ev_[0 : tau) (x[t]<0.4 && y > 0.6)
    and ((ev_(0 .. tau] at_A)) or not alw at_A or near_the_charger) // always
short := alw_[0,T) (ev_[0,tau) at_A and ev_[0 : tau) (x[t]<0.4 && y > 0.6) and (ev_(0 .. tau] at_A) or near_the_dock)
"""

LAID_OUT = """# a patrol
param T = 10, tau = T / 2  # in steps
model "floor.toml"
step = 0.1s
signal x, y

at_A := A

patrolling :=
    G[0,T) (
        ((F[0,tau) at_A) & (F[0,tau) (x[t] < 0.4 & y > 0.6)) & (F(0,tau] at_A))
        | (!G at_A)
        | near_the_charger
    )  # always
short :=
    G[0,T) (((F[0,tau) at_A) & (F[0,tau) (x[t] < 0.4 & y > 0.6)) & (F(0,tau] at_A)) | near_the_dock)
"""


def test_the_layout_of_everything():
    assert format_task(LONG) == LAID_OUT


COMMENTED = """param T = 3, # horizon
  tau = 5
signal x, # metres
 y
r := # the task
  A
  # first this
  & (B # or that
     | C)   # together
  & F[0, # from now
      T] D
"""

COMMENTS_KEPT = """param T = 3  # horizon
param tau = 5
signal x  # metres
signal y
r :=  # the task
    A
    # first this
    & (
        B  # or that
        | C
    )  # together
    & (  # from now
        F[0,T] D
    )
"""


def test_lines_on_time_and_names_in_quotes():
    text = 'step=1us;unit = µs\ninput   signal a,"b c" # c\noutput signal d\nr:=F[0,3   steps]"x # y">a[t+2*1 step]\n'
    assert format_task(text) == (
        'step = 1us\nunit = µs\ninput signal a, "b c"  # c\noutput signal d\n'
        'r := F[0,3 steps] ("x # y" > a[t + 2 * 1 step])\n'
    )


def test_comments_stay_where_they_were():
    assert format_task(COMMENTED) == COMMENTS_KEPT


def test_old_line_ends_marks_and_blank_files():
    assert format_task("r := A\r\n\r\n\r\n#  c\r\nq := B\r\n") == "r := A\n\n#  c\nq := B\n"
    assert format_task("r := A # c\rq := B\r") == "r := A  # c\nq := B\n"
    assert format_task("") == ""
    assert format_task("\n\n#only\n") == "# only\n"
    assert format_task("#!/usr/bin/env x\n##\nr := A ## b\n") == "#!/usr/bin/env x\n##\nr := A  ## b\n"


def test_numbers_intervals_and_names_are_as_they_were_written():
    plain = "r := x + y * 2 - z / 3 > -x * (y - 1) - (z - 2) & (x / y) / z > x / (y / z)\n"
    assert format_task(plain) == plain.replace("(x / y) / z", "x / y / z")
    assert str(stl.parse_task(plain)) + "\n" == format_task(plain)
    text = "param T = 3., u = .5e3\nr := F[0,T) a & (G(1,u / 2] (x > 1e-10 & y^(2^3) != -z - (2 - 1))) & (A xor B)\n"
    assert format_task(text) == text.replace("F[0,T) a", "(F[0,T) a)")


@pytest.mark.parametrize(
    "body", ["(a > 2) > 3", "(F[0,1] a) > 3", "(a < b) == (c < d)", "F[0,(a < b)] c", "min((a & b), 2) > x[(a & b)]"]
)
def test_what_will_be_refused_later_is_laid_out_all_the_same(body):
    once = format_task(f"r := {body}")
    assert format_task(once) == once


def test_a_comment_behind_a_mark_in_quotes():
    assert format_task('model "a#b.toml" # where\n# own\n') == 'model "a#b.toml"  # where\n# own\n'


def test_what_does_not_parse_is_not_laid_out():
    with pytest.raises(StlSyntaxError, match=r"x\.stl, line 1, column 9: the text ends here"):
        format_task("r := A &", "x.stl")
    with pytest.raises(StlSyntaxError, match="line 2, column 9"):
        format_task("s := B\nr := A &")  # what could be read is not laid out alone
    with pytest.raises(StlSyntaxError, match="nested too deeply to be formatted"):
        format_task("r := " + "!" * 5000 + "A")
    with pytest.raises(ArgumentError, match="format_task's text is 3, not text; write it in quotes"):
        format_task(3)


def lays_out(text):
    once = format_task(text)
    assert format_task(once) == once
    assert once.count("#") == text.count("#")
    assert once.count(":=") == text.count(":=")


@pytest.mark.parametrize("name", ["boiler", "lift", "patterns", "pendulum"])
def test_dialects_of_other_tools_are_laid_out(name):
    """Also those that are no tasks of ours: laying out asks for syntax alone."""
    lays_out((DATA / "dialects" / f"{name}.stl").read_text())


@needs_outside("stl")
@pytest.mark.parametrize("name", ["breach/AFC_simple_spec", "breach/Autotrans_spec", "breach/stlib", "rlrom/cartpole"])
def test_files_of_other_tools_are_laid_out(name):
    lays_out((OUTSIDE / "stl" / f"{name}.stl").read_text())
