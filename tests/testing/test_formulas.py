"""What the strategies give, and that they are not made again for every example that is drawn."""

import pytest
from hypothesis import Phase, find, given, settings

import stltool as stl
from stltool.logic.formula import And, Iff, Implies, Not, Or
from stltool.testing import flag_formulas, formulas, predicates
from stltool.testing.formulas import terms
from tests.conftest import many


def test_a_strategy_is_made_once_for_each_set_of_options():
    for strategy in (formulas, predicates, terms):
        assert strategy() is strategy()
        assert strategy(signals=["x"]) is strategy(signals=("x",)) is not strategy()
    assert formulas(longest=2) is not formulas(longest=3)


@pytest.mark.parametrize("node", [And, Or, Implies, Iff, Not])
def test_formulas_with_flags_combine_their_parts_in_every_way(node):
    found = settings(max_examples=2000, phases=[Phase.generate])  # not shrunk, which takes long
    phi = find(flag_formulas(), lambda phi: isinstance(getattr(phi, "arg", None), node), settings=found)
    assert stl.check_fragment(phi)


@given(flag_formulas(equal=False))
@settings(max_examples=many(100))
def test_formulas_with_flags_are_in_the_fragment(phi):
    assert stl.check_fragment(phi).parts
