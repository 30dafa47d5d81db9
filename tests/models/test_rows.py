"""Rows that are made when they are asked for are those held in memory, and give the same answers to the bit."""

import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.models.grid import grid_from_table
from stltool.models.rows import Demand

STEPS = {"stay": (0, 0), "N": (0, 1), "NE": (1, 1), "E": (1, 0), "SE": (1, -1), "S": (0, -1), "SW": (-1, -1),
         "W": (-1, 0), "NW": (-1, 1)}  # fmt: skip
MOVES = {"king": ("stay", "N", "S", "W", "E", "NW", "SW", "NE", "SE"), "cross": ("stay", "N", "S", "W", "E")}
NOISES = [
    ("93/100", "7/300"),
    ("1", "0"),
    ("[8/10, 95/100]", "[1/100, 1/10]"),
    ("[9/10, 1]", "[0, 1/30]"),
    ("1/7", "2/7"),
]
ONE = (Fraction(1), Fraction(1))


def random_map(rng, height=None, width=None):
    shape = (height or rng.integers(1, 9), width or rng.integers(1, 9))
    cells = rng.choice(list("#..ab"), size=shape)
    cells[rng.integers(shape[0]), rng.integers(shape[1])] = "S"
    return ["".join(row) for row in cells]


def grid(rows, moves="king", noise=NOISES[0]):
    return grid_from_table({
        "kind": "grid", "map": "\n".join(rows), "moves": moves, "success": noise[0], "slip": noise[1],
    })  # fmt: skip


def ends(text):
    parts = [Fraction(part) for part in text.strip("[]").split(",")]
    return parts[0], parts[-1]


def by_hand(rows, moves, noise):
    """(state, action) → successor → ends, in plain Python."""
    height = len(rows)
    cells = [(c, height - 1 - line) for line, row in enumerate(rows) for c, cell in enumerate(row) if cell != "#"]
    index = {cell: s for s, cell in enumerate(cells)}
    circle = [name for name in STEPS if name in MOVES[moves] and name != "stay"]
    success, slip = map(ends, noise)
    for s, (c, r) in enumerate(cells):
        for a, move in enumerate(MOVES[moves]):
            outcomes = [(move, ONE)]
            if move != "stay":
                i = circle.index(move)
                others = ("stay", circle[i - 1], circle[(i + 1) % len(circle)])
                outcomes = [(move, success), *((other, slip) for other in others)]
            row = {}
            for direction, (lower, upper) in outcomes:
                dx, dy = STEPS[direction]
                there = index.get((c + dx, r + dy), s)
                before = row.get(there, (0, 0))
                row[there] = before[0] + lower, before[1] + upper
            yield (s, a), {k: v for k, v in sorted(row.items()) if v[1] > 0}


@pytest.mark.parametrize("seed", range(30))
def test_grids_against_plain_python(seed):
    rng = np.random.default_rng(seed)
    rows, moves = random_map(rng), rng.choice(["king", "cross"])
    noise = NOISES[seed % len(NOISES)]
    model = grid(rows, moves, noise)
    n_moves, wanted = len(MOVES[moves]), dict(by_hand(rows, moves, noise))
    assert len(wanted) == model.n_choices == model.n_states * n_moves
    assert model.source.n_transitions == sum(map(len, wanted.values())) == model.n_transitions
    for (s, a), row in wanted.items():
        c = s * n_moves + a
        here = slice(model.row_start[c], model.row_start[c + 1])
        assert model.choice_action[c] == a
        assert model.target[here].tolist() == list(row)
        if model.intervals is None:
            assert [Fraction(int(k), model.rows.denominator) for k in model.rows.numerator[here]] == [
                lower for lower, _ in row.values()
            ]
            assert model.probability[here].tolist() == [float(lower) for lower, _ in row.values()]
        else:
            assert model.intervals.lower[here].tolist() == [float(lower) for lower, _ in row.values()]
            assert model.intervals.upper[here].tolist() == [float(min(upper, 1)) for _, upper in row.values()]


def same_rows(found, wanted):
    for name in ("choice_start", "row_start", "target", "probability"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name
    if wanted.intervals is not None:
        assert np.array_equal(found.intervals.lower, wanted.intervals.lower)
        assert np.array_equal(found.intervals.upper, wanted.intervals.upper)
    elif wanted.given_exactly:
        assert found.denominator == wanted.denominator
        assert np.array_equal(found.numerator, wanted.numerator)


@pytest.mark.parametrize("noise", NOISES)
def test_any_part_of_the_rows_is_a_part_of_all(noise):
    rng = np.random.default_rng(1)
    model = grid(random_map(rng, 7, 6), noise=noise)
    whole = model.rows
    for _ in range(20):
        states = rng.permutation(model.n_states)[: rng.integers(model.n_states + 1)]
        same_rows(model.source.rows(states), whole.some(states))
    demand = Demand(model.source)
    for _ in range(5):
        states = rng.permutation(model.n_states)[: rng.integers(model.n_states + 1)]
        numbers = demand.at(states)  # which makes them
        same_rows(demand.rows.some(numbers), whole.some(states))


@pytest.mark.parametrize("noise", NOISES)
def test_kinds_stand_for_all_rows(noise):
    model = grid(random_map(np.random.default_rng(2), 8, 8), noise=noise)
    kinds, rows = model.source.kinds, model.rows
    assert len(kinds) < len(rows)
    assert (kinds.longest, kinds.widest, kinds.least) == (rows.longest, rows.widest, rows.least)
    assert (kinds.missing, kinds.most_choices) == (rows.missing, rows.most_choices)
    if not model.uncertain:
        assert kinds.defect == rows.defect == 0


@pytest.mark.parametrize("noise", NOISES)
def test_a_digest_is_of_the_rows_whichever_way_they_are_made(noise, monkeypatch):
    rows = random_map(np.random.default_rng(3), 8, 8)
    made, held = grid(rows, noise=noise), grid(rows, noise=noise).with_rows()
    assert made.digest() == held.digest()
    assert made.nominal().digest() == held.nominal().digest()
    monkeypatch.setattr("stltool.models.rows._BLOCK", 100)
    assert grid(rows, noise=noise).digest() == held.digest()
    other = rows[0].replace(".", "#") if "." in rows[0] else rows[0].replace("a", "#")
    assert grid([other, *rows[1:]], noise=noise).digest() != held.digest()


def on_demand_and_stored(rows, noise, monkeypatch, task):
    """The same product twice: of rows that are made when they are needed, and of rows in memory."""
    monkeypatch.setattr("stltool.models.mdp._FEW", 0)
    models = grid(rows, noise=noise), grid(rows, noise=noise).with_rows()
    assert [model.source.on_demand for model in models] == [True, False]
    return [stl.build_product(model, stl.parse(task)) for model in models]


def was_never_whole(product):
    return "rows" not in vars(product.model)


def told(result):
    arrays = result.policy.form.arrays() if result.policy is not None else {}
    return (result.probability, result.lower, result.upper), {k: v.tolist() for k, v in arrays.items()}


TASKS = ["F[0,6] a & G[0,5] !b", "G[0,4] F[0,3] (a | x < 3)", "!b U[0,9] a"]


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize("seed", range(6))
def test_checks_are_those_of_rows_in_memory(seed, engine, monkeypatch):
    rng = np.random.default_rng(seed)
    rows, noise = random_map(rng, 6, 7), NOISES[seed % 2 * 4]
    made, held = on_demand_and_stored(rows, noise, monkeypatch, TASKS[seed % 3])
    for maximize in (True, False):
        for arithmetic in ("double", "fixed"):
            options = {"maximize": maximize, "engine": engine, "arithmetic": arithmetic}
            assert told(stl.check(made, **options)) == told(stl.check(held, **options))
        assert was_never_whole(made)
        one, other = (stl.check(p, maximize=maximize, exact=True, engine=engine) for p in (made, held))
        assert one.fraction == other.fraction
        best = stl.check(held, maximize=maximize).policy
        for exact in (False, True):
            one, other = (
                stl.check(p, stl.Policy(p, best.form), exact=exact, engine=engine) for p in (made, held)
            )  # fmt: skip
            assert (told(one), one.fraction) == (told(other), other.fraction)
    shape = (*held.shape, held.model.most_choices)
    table = rng.random(shape)
    mixed = [stl.check(p, stl.Policy(p, table / table.sum(axis=2, keepdims=True)), engine=engine) for p in (made, held)]
    assert (mixed[0].lower, mixed[0].probability, mixed[0].upper) == (
        mixed[1].lower,
        mixed[1].probability,
        mixed[1].upper,
    )
    values = [stl.check(p, values="all", engine=engine).values for p in (made, held)]
    for what in ("value", "lower", "upper"):
        assert np.array_equal(*(getattr(each, what) for each in values))


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize("seed", range(4))
def test_robust_checks_are_those_of_rows_in_memory(seed, engine, monkeypatch):
    rows, noise = random_map(np.random.default_rng(seed), 5, 5), NOISES[2 + seed % 2]
    made, held = on_demand_and_stored(rows, noise, monkeypatch, TASKS[seed % 3])
    for maximize in (True, False):
        for nature in ("against", "with"):
            options = {"maximize": maximize, "nature": nature, "engine": engine}
            assert told(stl.robust_check(made, **options)) == told(stl.robust_check(held, **options))
    assert was_never_whole(made)


LARGE = r"""
import resource
import psutil
import stltool as stl

def floor(n):
    rows = [["." if (3 * (x - n // 2) + 5 * (y - n // 2) + 1) % 31 else "#" for x in range(n)] for y in range(n)]
    rows[n // 2][n // 2], rows[n // 2][n // 2 + 4] = "S", "A"
    text = "\n".join(map("".join, rows))
    return f'kind = "grid"\nsuccess = "93/100"\nslip = "7/300"\nmap = \'\'\'\n{text}\'\'\''

for n in (20, 1000):  # the first loads what is needed
    with open("floor.toml", "w") as file:
        file.write(floor(n))
    if n == 1000:
        before = psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (before + 200_000_000, resource.RLIM_INFINITY))
    model = stl.load_model("floor.toml")
    found = stl.check(stl.build_product(model, stl.parse("F[0,12] A")))
    print(n, model.n_states, model.state_name(model.n_states - 1), found.probability)
"""


@pytest.mark.soak(only=True)
def test_a_million_cells_take_little_memory(tmp_path):
    """All their rows would take 33 million entries, 400 MB without any structure."""
    done = subprocess.run([sys.executable, "-c", LARGE], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    small, large = (line.split() for line in done.stdout.splitlines())
    assert int(large[1]) > 960_000
    assert large[2] == "(999,0)"
    assert 0.9 < float(large[3]) == float(small[3]) < 1
