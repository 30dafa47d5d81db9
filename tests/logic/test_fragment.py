import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FragmentError, StlSyntaxError
from stltool.logic.formula import Always, Eventually, Interval, children, temporal_depth, with_children
from stltool.testing import flag_formulas, traces
from tests.conftest import DATA


def test_decomposition():
    fragment = stl.check_fragment(stl.parse("G[0,15) (F[0,10) A & !G[0,10) (x < 0.4))"))
    assert (fragment.outer, fragment.T) == ("G", 15)
    assert [str(part) for part in fragment.parts] == ["F[0,10) A", "G[0,10) x < 0.4"]
    assert fragment.uniform
    assert fragment.combine([True, False])
    assert not fragment.combine([True, True])


def test_negations_flip_the_outer_operator():
    fragment = stl.check_fragment(stl.parse("!F[0,4) !(a & G[0,3) b)"))
    assert (fragment.outer, fragment.T) == ("G", 4)
    assert [str(part) for part in fragment.parts] == ["G[0,1) a", "G[0,3) b"]
    assert not fragment.uniform
    assert fragment.combine([True, True])
    assert not fragment.combine([True, False])


def test_boolean_roots_and_bare_predicates():
    root = stl.check_fragment(stl.parse("a -> F[0,3] b"))
    assert (root.outer, root.T, [str(p) for p in root.parts]) == ("G", 1, ["G[0,1) a", "F[0,4) b"])
    single = stl.check_fragment(stl.parse("F[0,9] a"))
    assert (single.outer, single.T, [str(p) for p in single.parts]) == ("F", 10, ["G[0,1) a"])


@given(phi=flag_formulas(equal=False), data=st.data())
def test_the_decomposition_means_the_formula(phi, data):
    fragment = stl.check_fragment(phi)
    trace = data.draw(traces(stl.horizon(phi) + 1))
    operators = {"F": Eventually, "G": Always}

    def body_at(k):
        return fragment.combine(
            [stl.satisfies(operators[p.operator](Interval(0, p.tau - 1), p.psi), trace, k) for p in fragment.parts]
        )

    some_or_all = any if fragment.outer == "F" else all
    assert stl.satisfies(phi, trace) == some_or_all(body_at(k) for k in range(fragment.T))


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ("G[0,5] F[0,3] G[0,2] a", "line 1, column 8", "depth 3"),
        ("G[0,5] (a &\n F[0,3] (a U[0,2] b))", "line 2, column 2", "depth 3"),
        ("F[0,3] (a U[0,2] b)", "line 1, column 9", "until"),
        ("G[1,5] a", "line 1, column 1", "starts at step 1"),
        ("G[0,5] F[2,3] a", "line 1, column 8", "starts at step 2"),
    ],
)
def test_a_refusal_names_the_sub_formula_at_fault(text, place, says):
    with pytest.raises(FragmentError) as caught:
        stl.check_fragment(stl.parse(text))
    assert place in str(caught.value)
    assert says in str(caught.value)
    assert "use the exact encoding" in str(caught.value)


REQUIREMENTS = tomllib.loads((DATA / "arch-comp.toml").read_text(encoding="utf-8"))["requirement"]


def test_arch_comp_requirements_get_the_verdicts_of_the_list():
    """All 25, with steps of a millisecond; the list does not mind where windows start, so they are shifted to 0."""
    inside, outside = [], []
    for requirement in REQUIREMENTS:
        name, text = requirement["name"], requirement["formula"]
        if requirement.get("next"):
            with pytest.raises(StlSyntaxError, match=r"for the next step, write F\[1,1\] a"):
                stl.parse(text, step="1ms")
            continue
        phi = stl.parse(text, step="1ms")
        assert requirement["depth"] == temporal_depth(phi), name
        if requirement["fragment"]:
            assert stl.check_fragment(_from_zero(phi)).parts, name
            inside.append(name)
        else:
            with pytest.raises(FragmentError, match="depth"):
                stl.check_fragment(_from_zero(phi))
            outside.append(name)
    assert (len(inside), outside) == (19, ["AT51", "CC4", "CC5", "NN", "NNx"])


def _from_zero(phi):
    below = tuple(_from_zero(child) for child in children(phi))
    if isinstance(phi, Eventually | Always):
        return type(phi)(Interval(0, len(phi.interval) - 1), *below)
    return with_children(phi, below)
