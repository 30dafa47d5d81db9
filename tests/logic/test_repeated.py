"""Which formulas repeat a bounded one, and how."""

import pytest

import stltool as stl
from stltool.errors import StlSyntaxError
from stltool.logic.repeated import repeated


@pytest.mark.parametrize(
    ("text", "form", "inner"),
    [
        ("F[0,3] a", None, "F[0,3] a"),
        ("G F[0,3] a", "always", "F[0,3] a"),
        ("G[2,inf) once a", "always", "F[2,2] once a"),
        ("always eventually a", "recurrence", "a"),
        ("G[3,inf) F[5,inf) (a U[0,2] b)", "recurrence", "a U[0,2] b"),
        ("F G a", "persistence", "a"),
        ("G F G[0,3] historically a", "recurrence", "G[0,3] historically a"),
    ],
)
def test_forms(text, form, inner):
    assert repeated(stl.parse(text, unbounded=True)) == (form, stl.parse(inner))


@pytest.mark.parametrize(
    "text", ["F a", "G G a", "G F G a", "G (a & F b)", "a until b", "(G a) & (G b)", "!(G a)", "G F G F a"]
)
def test_other_formulas_without_end_are_refused(text):
    with pytest.raises(StlSyntaxError, match="only the outermost operators have none: G phi, G F phi or F G phi"):
        repeated(stl.parse(text, unbounded=True))
