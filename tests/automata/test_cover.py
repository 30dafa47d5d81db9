"""Shortest sums of products against all sets of cubes."""

from hypothesis import given
from hypothesis import strategies as st

from stltool.automata.cover import literals, shortest_cover

CODES = range(8)


def holds(cube, code):
    return all((code >> i & 1) != negated for i, negated in literals(3, cube))


def length(cubes):
    return sum(1 + len(literals(3, cube)) for cube in cubes)


def shortest(wanted, allowed):
    """The least length of cubes within `allowed` that cover `wanted`: a shortest path over what is covered."""
    cubes = [(value, free) for free in CODES for value in CODES if not value & free]
    inside = [(cube, {code for code in CODES if holds(cube, code)}) for cube in cubes]
    least = {frozenset(): 0}
    for cube, covered in inside:
        if covered <= allowed:
            for found, cost in list(least.items()):
                both = found | covered
                least[both] = min(least.get(both, 10**6), cost + length([cube]))
    return min(cost for found, cost in least.items() if wanted <= found)


@given(st.sets(st.integers(0, 7), min_size=1), st.sets(st.integers(0, 7)))
def test_the_cover_holds_where_it_must_and_is_the_shortest(wanted, spare):
    spare -= wanted
    cubes = shortest_cover(3, wanted, spare)
    found = {code for code in CODES if any(holds(cube, code) for cube in cubes)}
    assert wanted <= found <= wanted | spare
    assert length(cubes) == shortest(wanted, wanted | spare)
    assert shortest_cover(3, sorted(wanted, reverse=True), spare) == cubes


def test_covers_in_order():
    assert shortest_cover(2, [1, 2, 3]) == [(1, 2), (2, 1)]  # a | b
    assert shortest_cover(2, [1, 2]) == [(1, 0), (2, 0)]  # a & !b | !a & b
    assert shortest_cover(2, [0, 1, 2, 3]) == [(0, 3)]
    assert literals(2, (1, 0)) == [(0, False), (1, True)]
