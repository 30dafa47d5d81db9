"""Shortest sums of products against all sets of cubes."""

from hypothesis import example, given
from hypothesis import strategies as st

from stltool.automata.cover import literals, shortest_cover


def holds(n, cube, code):
    return all((code >> i & 1) != negated for i, negated in literals(n, cube))


def length(n, cubes):
    return sum(1 + len(literals(n, cube)) for cube in cubes)


def shortest(n, wanted, allowed):
    """The least length of cubes within `allowed` that cover `wanted`: a shortest path over what is covered."""
    codes = range(1 << n)
    cubes = [(value, free) for free in codes for value in codes if not value & free]
    least = {frozenset(): 0}
    for cube in cubes:
        covered = {code for code in codes if holds(n, cube, code)}
        if covered <= allowed:
            for found, cost in list(least.items()):
                both = found | (covered & wanted)
                least[both] = min(least.get(both, 10**6), cost + length(n, [cube]))
    return least[frozenset(wanted)]


@given(st.sets(st.integers(0, 7), min_size=1), st.sets(st.integers(0, 7)), st.just(3))
@example({0, 1, 5, 8, 11, 12}, {2, 3, 7, 14}, 4)  # as few cubes can have more literals
@example({2, 5, 7, 9, 10, 14}, {0, 12, 13, 15}, 4)
def test_the_cover_holds_where_it_must_and_is_the_shortest(wanted, spare, n):
    spare -= wanted
    cubes = shortest_cover(n, wanted, spare)
    found = {code for code in range(1 << n) if any(holds(n, cube, code) for cube in cubes)}
    assert wanted <= found <= wanted | spare
    assert length(n, cubes) == shortest(n, wanted, wanted | spare)
    assert shortest_cover(n, sorted(wanted, reverse=True), spare) == cubes


def test_covers_in_order():
    assert shortest_cover(2, [1, 2, 3]) == [(1, 2), (2, 1)]  # a | b
    assert shortest_cover(2, [1, 2]) == [(1, 0), (2, 0)]  # a & !b | !a & b
    assert shortest_cover(2, [0, 1, 2, 3]) == [(0, 3)]
    assert literals(2, (1, 0)) == [(0, False), (1, True)]
