"""Families of tasks beyond the paper's floor: noise, doors, long corridors, lakes, random models.

Each is a product with a number of environment steps, in which a learner should come close to the optimum. A random
family draws its model from the seed, all others have one model.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

import stltool as stl

FACTORY = Path(__file__).resolve().parent.parent / "examples" / "factory"
KING = ((0, 0), (0, 1), (0, -1), (-1, 0), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1))
SIDES = (
    (0, 0, 0), (0, 5, 7), (0, 6, 8), (0, 5, 6), (0, 7, 8), (0, 1, 3), (0, 2, 3), (0, 1, 4), (0, 2, 4),
)  # fmt: skip
WALLS = """
CCC....#.......
CCC....#.......
CCC....#.......
.......#.......
####.#####.####
.......#.......
.......#.......
...............
.......#.......
##.#######.####
.......#.......
.......#.......
.......#.......
...............
S......#.......
"""
DOORS = """
BB...#......
BB...#......
.....#......
............
.....#......
##.#####.###
.....#......
.....#......
............
.....#......
.....#....AA
S....#....AA
"""


@dataclass(frozen=True)
class Family:
    """product(seed), and the environment steps a learner may take.

    seeds    at most so many: fewer where a run takes a minute
    without  methods that are left out, as each of their plans takes a second
    """

    product: Callable[[int], stl.Product]
    steps: int
    seeds: int = 20
    without: tuple[str, ...] = ()


def good_or_bad() -> stl.Product:
    """Three states, a leads to the good one with probability .9, b with .5."""
    stay = np.eye(3)
    a, b = stay.copy(), stay.copy()
    a[0], b[0] = [0, 0.9, 0.1], [0, 0.5, 0.5]
    model = stl.MDP.from_arrays(np.array([a, b]), {}, labels={"good": [False, True, False]}, action_names=["a", "b"])
    return stl.build_product(model, stl.parse("F[0,1] good"))


def random_mdp(n: int, seed: int) -> stl.Product:
    """n states, four actions with three successors each, one state in five labelled A; the task is possible."""
    rng = np.random.default_rng([n, seed])
    while True:
        P = np.zeros((4, n, n))
        for a in range(4):
            for s in range(n):
                P[a, s, rng.choice(n, 3, replace=False)] = rng.dirichlet(np.ones(3))
        labelled = np.zeros(n, dtype=bool)
        labelled[rng.choice(np.arange(1, n), max(n // 5, 1), replace=False)] = True
        product = stl.build_product(stl.MDP.from_arrays(P, {}, labels={"A": labelled}), stl.parse("F[0,10) G[0,5) A"))
        if stl.check(product).probability > 0:
            return product


def grid(text: str, task: str, slip: str = "7/300", success: str = "93/100", cell: str = "1") -> stl.Product:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "floor.toml"
        file.write_text(
            f'kind = "grid"\nmoves = "king"\ncell = "{cell}"\nsuccess = "{success}"\nslip = "{slip}"\n'
            f'map = """\n{text.strip()}\n"""\n'
        )
        return stl.build_product(stl.load_model(file), stl.parse(task))


def factory_with_slip(success: str, slip: str, task: str) -> stl.Product:
    lines = (FACTORY / "floor-10x10.toml").read_text()
    return grid(lines.split("'''")[1], task, slip, success, "1/10")


def wind(task: str) -> stl.Product:
    """The 10 × 10 floor with a wind of its own in every cell: moves succeed with .6 … .95, slips are uneven."""
    calm = stl.load_model(FACTORY / "floor-10x10.toml")
    rng = np.random.default_rng(1)
    layout = calm.layout
    assert layout is not None
    places = list(zip(layout.column.tolist(), layout.row.tolist(), strict=True))
    number = {place: s for s, place in enumerate(places)}
    n = len(places)
    P = np.zeros((9, n, n))
    for s, (x, y) in enumerate(places):
        success, shares = rng.uniform(0.6, 0.95), rng.dirichlet(np.ones(3))
        for a, move in enumerate(KING):
            slips = [((1 - success) * share, KING[i]) for share, i in zip(shares, SIDES[a], strict=True)]
            for p, (dx, dy) in [(success, move), *slips]:
                P[a, s, number.get((x + dx, y + dy), s)] += p
    P /= P.sum(axis=2, keepdims=True)
    model = stl.MDP.from_arrays(
        [sp.csr_array(one) for one in P], dict(calm.signals), initial=int(np.flatnonzero(calm.initial)[0]),
        labels={name: np.asarray(values) for name, values in calm.labels.items()},
    )  # fmt: skip
    return stl.build_product(model, stl.parse(task))


def gymnasium(name: str, labels: dict[str, Any], task: str, **options: Any) -> stl.Product:
    import gymnasium as gym

    model = stl.from_gymnasium(gym.make(name, **options), labels, ends="apart" if name.startswith("Taxi") else "merged")
    return stl.build_product(model, stl.parse(task))


def lake(size: int, task: str) -> stl.Product:
    from gymnasium.envs.toy_text.frozen_lake import MAPS

    tiles = "".join(MAPS[f"{size}x{size}"])
    return gymnasium(
        "FrozenLake-v1", {"goal": {tiles.index("G")}, "hole": {i for i, t in enumerate(tiles) if t == "H"}}, task,
        map_name=f"{size}x{size}", is_slippery=True, max_episode_steps=1000,
    )  # fmt: skip


def taxi() -> stl.Product:
    """Whoever waits is delivered: passenger at the destination, which is only so after the end."""
    delivered = {s for s in range(500) if (s // 4) % 5 == s % 4 and (s // 4) % 5 < 4}
    return gymnasium("Taxi-v4", {"delivered": delivered}, "F[0,25] delivered")


def corridor(n: int, T: int) -> stl.Product:
    """n cells in a row, ten actions a cell: one leads on, one back, the others stay."""
    left, right, stay = np.zeros((3, n, n))
    for s in range(n):
        left[s, max(s - 1, 0)] = right[s, min(s + 1, n - 1)] = stay[s, s] = 1
    model = stl.MDP.from_arrays(
        np.array([left, right, stay]), {}, labels={"end": np.arange(n) == n - 1}, action_names=["left", "right", "stay"]
    )
    return stl.build_product(model, stl.parse(f"F[0,{T}] end"))


def fixed(make: Callable[[], stl.Product], steps: int) -> Family:
    return Family(lambda seed: make(), steps)


def patrolling(T: int, tau: int) -> str:
    return f"G[0,{T}) (F[0,{tau}) A & F[0,{tau}) (x < 0.4 & y > 0.6))"


FAMILIES: dict[str, Family] = {
    "three states": fixed(good_or_bad, 2000),
    **{f"random, {n} states": Family(lambda seed, n=n: random_mdp(n, seed), 7500) for n in (10, 20, 40, 60)},
    "FrozenLake 4 × 4": fixed(lambda: lake(4, "!hole U[0,80] goal"), 12_000),
    "FrozenLake 8 × 8": fixed(lambda: lake(8, "!hole U[0,200] goal"), 60_000),
    "Taxi": fixed(taxi, 24_000),
    "CliffWalking": fixed(
        lambda: gymnasium("CliffWalking-v1", {"goal": {47}}, "F[0,30] goal"), 3000
    ),
    "corridor of 30": fixed(lambda: corridor(30, 60), 3000),
    "15 × 15 with walls": fixed(lambda: grid(WALLS, "F[0,30) F[0,5) C"), 17_500),
    "P3, slip .2": fixed(lambda: factory_with_slip("4/5", "1/15", patrolling(10, 10)), 10_000),
    "patrolling 12, slip .5": fixed(lambda: factory_with_slip("1/2", "1/6", patrolling(12, 12)), 12_000),
    "P3 with wind": fixed(lambda: wind(patrolling(10, 10)), 10_000),
    "12 × 12 with doors": Family(
        lambda seed: grid(DOORS, "G[0,25) (F[0,25) A & F[0,25) B)"), 25_000, seeds=2, without=("UCBVI",)
    ),
}  # fmt: skip
