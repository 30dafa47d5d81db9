"""The shortest sum of products: conjunctions of literals that together hold for given valuations and for no others.

A *cube* is a conjunction of literals over n atoms, written (value, free): atom i is unconstrained if bit i of `free`
is set, else it equals bit i of `value`. Quine and McCluskey: cubes that differ in one atom are merged until no more
merge; those that merge with none are *prime*. Choosing primes is a set cover, solved as an integer programme:

    minimise Σ_p (1 + literals of p)·x_p   subject to   Σ_{p covers v} x_p ≥ 1 for each wanted v,   x_p ∈ {0, 1}

Source: McCluskey, "Minimization of Boolean functions", Bell System Technical Journal, 1956.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

Cube = tuple[int, int]


def shortest_cover(n_atoms: int, wanted: Iterable[int], spare: Iterable[int] = ()) -> list[Cube]:
    """Cubes that together hold for all of `wanted`, possibly for some of `spare`, and for no other valuation.

    A valuation is an integer whose bit i is the truth of atom i. The total number of literals and cubes is minimal.
    """
    from scipy.optimize import LinearConstraint, milp
    from scipy.sparse import csr_array

    codes = np.array(sorted(set(wanted)), dtype=np.int64)
    primes = _primes(n_atoms, {*codes.tolist(), *spare})
    value, free = np.array(primes, dtype=np.int64).reshape(-1, 2).T
    covers = csr_array((codes[:, None] & ~free == value).astype(float))
    cost = [1 + len(literals(n_atoms, prime)) for prime in primes]
    ended = milp(cost, integrality=1, bounds=(0, 1), constraints=LinearConstraint(covers, lb=1))
    assert ended.status == 0, ended.message
    chosen = [prime for prime, taken in zip(primes, ended.x, strict=True) if taken > 0.5]
    return sorted(chosen, key=lambda cube: literals(n_atoms, cube))


def literals(n_atoms: int, cube: Cube) -> list[tuple[int, bool]]:
    """The atoms of the cube in order, each with whether it is negated."""
    value, free = cube
    return [(i, not value >> i & 1) for i in range(n_atoms) if not free >> i & 1]


def _primes(n_atoms: int, allowed: set[int]) -> list[Cube]:
    primes: list[Cube] = []
    cubes: set[Cube] = {(code, 0) for code in allowed}
    while cubes:
        merged: set[Cube] = set()
        larger: set[Cube] = set()
        for value, free in cubes:
            for bit in (1 << i for i in range(n_atoms)):
                if not free & bit and not value & bit and (value | bit, free) in cubes:
                    merged |= {(value, free), (value | bit, free)}
                    larger.add((value, free | bit))
        primes += sorted(cubes - merged)
        cubes = larger
    return primes
