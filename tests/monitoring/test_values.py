"""Comparisons of several steps over the finitely many values of a model, against the semantics and enumerated paths."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FragmentError, SizeError
from stltool.logic.formula import Comparison, Number, Variable
from stltool.monitoring.values import by_values
from tests.logic.test_shifts import READS

TEXTS = [*(text for text, _, _ in READS), "x[t+1] * y[t+1] > x + y", "x[t+1] + x[t+2] > x & !(y[t+2] == y)",
         "x - x[t-1] <= 1", "x > x + 1 + y[t+1] - y[t+1]", "x[t+1] >= x[t+1]"]  # fmt: skip


@given(
    text=st.sampled_from(TEXTS),
    states=st.lists(st.tuples(st.integers(-2, 3), st.integers(0, 2)), min_size=1, max_size=5),
    path=st.lists(st.integers(0, 4), min_size=7, max_size=7),
)
def test_the_cases_are_equivalent_on_the_values_of_a_model(text, states, path):
    phi = stl.parse(text)
    table = np.array(states, dtype=float)
    rewritten, cases = by_values(phi, {"x": table[:, 0], "y": table[:, 1]})
    assert bool(cases) == (rewritten != phi)
    steps = table[[i % len(states) for i in path]]
    trace = {"x": steps[:, 0], "y": steps[:, 1]}
    for t in range(7 - stl.horizon(phi)):
        assert stl.satisfies(rewritten, trace, t) == stl.satisfies(phi, trace, t)


def walks(matrix, n):
    """Every path of n states from state 1, with its probability."""
    for path in itertools.product(range(3), repeat=n):
        p = float(path[0] == 1)
        for s, t in itertools.pairwise(path):
            p *= matrix[0, s, t]
        if p:
            yield path, Fraction(p)


@pytest.mark.parametrize(
    "text",
    ["G[0,3] (x[t+1] - x[t] <= 1)", "F[0,2] (x[t+2] > x[t+1] + x)", "G[0,2] (abs(x[t+1] - x) <= 1 | a)",
     "G[1,3] (x - x[t-1] <= 1)", "F[0,2] !(x - x[t-1] > 0)", "(x[t-1] > 0) U[0,2] (x - x[t-2] > x[t+1])",
     "(x[t+1] > x) U[0,2] (x[t+1] < x)", "!(x[t+1] > x) & x[t+3] != x"],
)  # fmt: skip
def test_probabilities_are_those_of_the_paths(text):
    matrix = np.array([[[0.5, 0.5, 0.0], [0.25, 0.5, 0.25], [0.0, 0.5, 0.5]]])
    signals, labels = {"x": np.array([0.0, 1.0, 3.0])}, {"a": np.array([False, True, False])}
    model = stl.MDP.from_arrays(matrix, signals, initial=1, labels=labels)
    phi = stl.parse(text)
    product = stl.build_product(model, phi)
    expected = sum(
        p for path, p in walks(matrix, stl.horizon(phi) + 1)
        if stl.satisfies(phi, {"x": signals["x"][list(path)], "a": labels["a"][list(path)]})
    )  # fmt: skip
    assert stl.check(product, exact=True).fraction == expected
    assert product.horizon == stl.horizon(phi)
    assert all("3 values of x" in note for note in product.notes)
    assert len(product.notes) > 0


def test_a_comparison_of_one_earlier_step_that_no_value_satisfies_is_false():
    rewritten, _ = by_values(Comparison(">", Variable("x", 1), Number(2.0)), {"x": np.array([0.0, 1.0])})
    assert [stl.satisfies(rewritten, {"x": [0.0, 1.0, 1.0]}, t) for t in range(3)] == [False] * 3


def test_too_many_values_are_refused_with_their_number():
    n = 1100
    matrix = [np.ones((n, 1)) @ np.eye(1, n)]
    model = stl.MDP.from_arrays(np.array(matrix), {"x": np.arange(n, dtype=float)}, initial=0)
    with pytest.raises(SizeError, match=r"1100 of x, 1100 of x: 1\.21e\+06 combinations of values, over 1000000"):
        stl.build_product(model, stl.parse("x[t+1] > x"))
    scattered = {"x": np.arange(300) * 7919.0 % 997, "y": np.arange(300) * 104729.0 % 991}
    model = stl.MDP.from_arrays(np.array([np.ones((300, 1)) @ np.eye(1, 300)]), scattered, initial=0)
    with pytest.raises(SizeError, match="over values of x and y it takes over 10000 comparisons, too many"):
        stl.build_product(model, stl.parse("x[t+1] * y > y[t+1] * x"))
    with pytest.raises(stl.errors.NameLookupError, match="the model has no signal y"):
        stl.build_product(stl.MDP.from_arrays(np.ones((1, 1, 1)), {"x": [0.0]}, initial=0), stl.parse("y[t+1] > y"))


def test_without_a_model_such_comparisons_are_independent_of_others():
    phi = stl.parse("G[0,2] (x[t+1] > x)")
    assert stl.meaning(phi).can_hold
    assert stl.meaning(stl.parse("x - x[t-1] > 0")).can_hold is False  # at step 0
    assert stl.meaning(stl.parse("F[1,1] !(x - x[t-1] > 0)")).can_hold
    assert stl.meaning(stl.parse("G[0,2] (x[t+1] > x & !(x[t+1] > x))")).can_hold is False
    assert stl.compile_automaton(phi).horizon == 3
    with pytest.raises(FragmentError, match=r"the window \[1,1\] starts at step 1"):
        stl.check_fragment(phi)
