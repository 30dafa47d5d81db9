"""`frontier` against a check of every combination, for random formulas."""

import itertools
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import SettingsError
from stltool.testing import mdps
from tests.conftest import FACTORY, many

SHAPES = (
    "G[0,m] F[0,n] {}", "F[0,m] G[0,n] {}", "F[0,m] {} & F[0,n] {}", "{} U[0,m] (F[n,3] {})", "G[m,3] (x <= n/2 | {})",
    "!G[0,m] {} | (G[0,n] {})", "(F[0,m] {}) <-> (F[0,n] {})", "F[m,m] G[0,n] {}", "G[0,m] ({} -> F[n,n] {})",
    "G[0,m] x >= n/2", "F[0,m] G[0,m] (x < 2 - n/2 | {})", "{} release[0,m] F[0,n] {}",
)  # fmt: skip
GRID = {"m": range(4), "n": range(4)}


@st.composite
def cases(draw):
    leaf = st.sampled_from(("a", "b", "!a", "(a | b)", "(a & !b)"))
    shape = draw(st.sampled_from(SHAPES))
    text = shape.format(*(draw(leaf) for _ in range(shape.count("{}"))))
    task = stl.parse_task(f"param m = 0\nparam n = 0\nr := {text}")
    bound = draw(st.sampled_from([Fraction(k, 16) for k in range(1, 17)]))
    return draw(mdps(states=3)), task, bound, draw(st.booleans()), draw(st.permutations(["m", "n"]))


@given(cases())
@settings(max_examples=many(60))
def test_the_frontier_equals_the_full_table(case):
    model, task, bound, maximize, names = case
    found = stl.frontier(model, task, bound, {name: GRID[name] for name in names}, maximize=maximize)
    table = {}
    for values in itertools.product(*(GRID[name] for name in names)):
        product = stl.build_product(model, task.with_params(**dict(zip(names, values, strict=True))))
        table[values] = stl.check(product, maximize=maximize, exact=True).fraction
    for probe in found.probes:
        exact = table[tuple(map(int, probe.values))]
        assert Fraction(probe.lower) <= exact <= Fraction(probe.upper)
        assert probe.holds is (exact >= bound)
    first, last = found.params
    for i, param in enumerate(found.params):  # what is said to be a direction is one
        for values in table:
            after = tuple(value + (j == i) for j, value in enumerate(values))
            if after in table and param.direction:
                assert (table[after] - table[values]) * param.direction >= 0
    if found.method == "scan":
        assert last.direction == 0
        assert {probe.values for probe in found.probes} == set(table)
        return
    assert found.method == ("staircase" if first.direction else "bisection")
    assert len(found.probes) <= 4 + 4 + 4 * (found.method == "bisection")
    for value, step in zip(GRID[names[0]], found.steps, strict=True):
        good = [n for n in GRID[names[1]] if table[value, n] >= bound]
        tightest = (min if last.direction > 0 else max)(good, default=None)
        assert (step.others, step.tightest) == ((value,), tightest)


def test_patrolling(floor5):
    """The staircase of 15 × 12 in 21 checks; what each window alone would have to be."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    found = stl.frontier(floor5, task, "0.95", {"T": range(1, 16), "tau": range(1, 13)})
    assert [step.tightest for step in found.steps] == [6] * 9 + [7] * 6
    assert (found.method, len(found.probes), found.undecided) == ("staircase", 21, ())
    assert found.told == {
        "smallest tau for T = 1 … 9": "6", "smallest tau for T = 10 … 15": "7",
        "as written": "tau = 5, at T = 5, must grow to 6",
    }  # fmt: skip
    assert found.table()[0]["smallest tau"] == "6"
    alone = stl.frontier(floor5, task.with_params(tau=6), 0.95, {"T": range(1, 16)})
    assert (alone.method, alone.told) == ("bisection", {"largest T": "9", "as written": "T = 5 could grow to 9"})
    assert "larger is stronger" in repr(alone)
    assert stl.frontier(floor5, task, 0.95, {"T": [3, 4]}).steps[0].tightest is None


def test_a_bound_inside_the_enclosure_is_decided_exactly():
    """P = 1 − (2/3)ⁿ is no double; the bound is P itself, and a little more."""
    model = stl.MDP.from_arrays([[["2/3", "1/3"], [0, 1]]], {}, labels={"up": [0, 1]})
    task = stl.parse_task("param n = 1\nr := F[0,n] up")
    for more, tightest in ((Fraction(0), 5), (Fraction(1, 10**30), 6)):
        found = stl.frontier(model, task, 1 - Fraction(2, 3) ** 5 + more, {"n": range(1, 9)})
        assert (found.steps[0].tightest, found.undecided) == (tightest, ())


def test_a_name_alone_stands_for_the_values_around_its_own_that_are_allowed():
    model = stl.MDP.from_arrays([[["2/3", "1/3"], [0, 1]]], {"x": [0, 1]}, labels={"up": [0, 1]})
    task = stl.parse_task("param T = 4\nparam c = 1/2\nparam n = -30\nr := G[T,5] (up | x > c | x < n)")
    for name, wanted in (
        ("T", [*range(1, 6)]),  # not 6 … 8: the window would be empty
        ("c", [Fraction(k, 20) for k in range(21)]),
        ("n", [*range(-59, 0, 2), -30]),
    ):
        found = stl.frontier(model, task, 0.5, [name])
        assert [*found.params[0].values] == sorted(wanted)


def test_what_cannot_be_decided_is_said():
    """Rows that do not sum to 1 have no exact fraction."""
    model = stl.MDP.from_arrays([[[0.1, 0.9 - 1e-12], [0, 1]]], {}, labels={"up": [0, 1]})
    found = stl.frontier(model, stl.parse_task("param n = 1\nr := F[0,n] up"), 0.9, {"n": [1, 2]})
    assert [probe.holds for probe in found.probes] == [None, True]
    assert found.steps[0].tightest == 2
    assert len(found.undecided) == 1


def test_times_and_bad_questions(floor5):
    task = stl.parse_task("step = 0.5s\nparam T = 1s\nparam c = 1/2\nr := F[0,T] (x > c)")
    found = stl.frontier(floor5, task, 0.5, {"T": ["2s", "1s", "0.5s", "3s"]})
    assert [str(value) for value in found.params[0].values] == ["0.5s", "1s", "2s", "3s"]
    for parameters, says in (
        ({}, "one or two params"),
        ({"U": [1]}, "the task has no param U; known names: T, c"),
        ({"c": []}, "param c has no values"),
        ({"c": "1:3"}, "values of c are not a list"),
        ({"c": [1, "1s"]}, "write all of them alike"),
        ({"c": range(10**9)}, "param c has more than 20000 values"),
        ({"c": range(200), "T": [f"{n}s" for n in range(200)]}, "40000 combinations of values are more than 20000"),
    ):
        with pytest.raises(SettingsError, match=says):
            stl.frontier(floor5, task, 0.5, parameters)
    for bound in (2, "x"):
        with pytest.raises(SettingsError, match="frontier's at_least"):
            stl.frontier(floor5, task, bound, {"c": [0.1]})
