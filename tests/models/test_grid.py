"""Grid worlds against the motion model written out by hand (docs/reproduction.md)."""

import time
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, ModelError
from stltool.models.grid import grid_from_table

COMPASS = {"stay": (0, 0), "N": (0, 1), "S": (0, -1), "W": (-1, 0), "E": (1, 0),
           "NW": (-1, 1), "SW": (-1, -1), "NE": (1, 1), "SE": (1, -1)}  # fmt: skip
SIDES = {"N": "NW NE", "S": "SW SE", "W": "NW SW", "E": "NE SE", "NW": "N W", "SW": "S W", "NE": "N E", "SE": "S E"}
PAPER = ["BB#CC", "BB.CC", "##.##", "#..AA", ".S#AA"]


@pytest.mark.parametrize("scale", [1, 2])
def test_the_papers_floor(scale, floor5, floor10):
    model = floor5 if scale == 1 else floor10
    n = 5 * scale
    cell = {(c, r): PAPER[4 - r // scale][c // scale] for c in range(n) for r in range(n)}
    free = {place for place, kind in cell.items() if kind != "#"}
    assert model.n_states == len(free) == (18 if scale == 1 else 72)
    assert model.action_names == tuple(COMPASS)
    place_of = [tuple(int(i) for i in model.state_name(s).strip("()").split(",")) for s in range(model.n_states)]
    index = {place: s for s, place in enumerate(place_of)}
    assert place_of[int(model.initial.argmax())] == ((1, 0) if scale == 1 else (3, 1))
    for s, (c, r) in enumerate(place_of):
        x, y = Fraction(2 * c + 1, 2 * n), Fraction(2 * r + 1, 2 * n)
        assert (model.signals["x"][s], model.signals["y"][s]) == (float(x), float(y))
        assert model.labels["A"][s] == (x > Fraction(3, 5) and y < Fraction(2, 5))
        assert model.labels["B"][s] == (x < Fraction(2, 5) and y > Fraction(3, 5))
        assert model.labels["C"][s] == (x > Fraction(3, 5) and y > Fraction(3, 5))
        for a, move in enumerate(COMPASS):
            row = {}
            outcomes = [(move, Fraction(93, 100))] + [
                (other, Fraction(7, 300)) for other in ("stay " + SIDES[move]).split()
            ] if move != "stay" else [("stay", Fraction(1))]  # fmt: skip
            for direction, p in outcomes:
                dx, dy = COMPASS[direction]
                there = (c + dx, r + dy)
                row[index[there if there in free else (c, r)]] = (
                    row.get(index[there if there in free else (c, r)], 0) + p
                )
            choice = model.choice_start[s] + a
            entries = slice(model.row_start[choice], model.row_start[choice + 1])
            found = dict(zip(model.target[entries].tolist(), model.probability[entries].tolist(), strict=True))
            assert found == {s2: float(p) for s2, p in row.items()}


def table(**changes):
    return {"kind": "grid", "map": "A.\nS#", "success": "93/100", "slip": "7/300"} | changes


def test_four_moves_slip_sideways():
    model = grid_from_table(table(moves="cross", map="...\n.S.\n..."))
    assert model.action_names == ("stay", "N", "S", "W", "E")
    middle = int(model.initial.argmax())
    north = model.matrix()[[model.choice_start[middle] + 1]].toarray()[0]
    names = {model.state_name(s): p for s, p in enumerate(north) if p}
    assert names == {"(1,2)": 0.93, "(1,1)": 7 / 300, "(0,1)": 7 / 300, "(2,1)": 7 / 300}


def test_starts():
    assert grid_from_table(table(map="S.\n.S")).initial.tolist() == [0.5, 0, 0, 0.5]
    given = grid_from_table(table(map="..\nA#", start=[0, 0]))
    assert given.state_name(int(given.initial.argmax())) == "(0,0)"


def test_without_noise_every_move_succeeds():
    model = grid_from_table({"kind": "grid", "map": "S."})
    assert set(model.probability) == {1.0}
    assert np.allclose(model.signals["x"], [0.5, 1.5])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"kind": "maze"}, "kind is 'maze'; write kind = \"grid\""),
        ({"sucess": 1}, "unknown key sucess; did you mean success"),
        ({"map": ""}, "the grid has no map"),
        ({"map": "A.\nS"}, "map line 2, column 1: this row has 1 cells, the first has 2"),
        ({"map": "A?\nS."}, "map line 1, column 2: '\\?' is not a cell"),
        ({"map": "##\n##"}, "every cell of the map is blocked"),
        ({"map": "A.\n.#"}, "the map has no start"),
        ({"start": [0, 0]}, "keep one of them"),
        ({"map": "A.\n.#", "start": [1, 0]}, r"start = \[1, 0\] is blocked or off the map"),
        ({"map": "A.\n.#", "start": "A"}, r"write start = \[column, row\]"),
        ({"moves": "knight"}, "moves is 'knight'; choose king, cross, or list them: .*stay"),
        ({"success": "9/10"}, "sum to 0.97, not 1"),
        ({"success": "often"}, "success: 'often': there is no parameter often; declare it"),
        ({"slip": "1/0"}, "slip: '1/0' divides by zero"),
        ({"success": True}, "success: True is not a number"),
        (
            {"success": "1e-99999999"},
            "success: '1e-99999999' is out of range: numbers have at most 1000 digits, .*; write a number",
        ),
        ({"cell": "1e999999999"}, "cell: '1e999999999' is out of range"),
        ({"success": -1, "slip": "2/3"}, "success is -1; a probability lies between 0 and 1"),
        ({"moves": ["king"]}, "moves contain 'king'; known names"),
        ({"moves": []}, r"moves is \[\]; choose king, cross, or list them"),
        ({"moves": ["N", 3]}, "moves contain 3; known names: E, N"),
        ({"moves": ["N", "E", "N"]}, "moves contain N twice; list it once"),
        ({"regions": 3}, r"regions is 3; write \[regions\] and below it wet = \[3, 0, 4, 1\]"),
        ({"regions": {"x": [0, 0]}}, "region x: x is a signal of the grid; choose another name"),
        ({"regions": {"": [0, 0]}}, "region '' cannot be a label"),
        ({"regions": {"w": [2, 0]}}, r"region w: \[2, 0\] is not on the map of 2 × 2 cells"),
        ({"regions": {"w": [0, -1]}}, r"region w: \[0, -1\] is not on the map"),
        ({"regions": {"w": [[0, 0], [1, 0]]}}, r"region w: every cell of \[1, 0\] is blocked; name free cells"),
        ({"regions": {"w": [1, 0, 0, 0]}}, r"region w: \[1, 0, 0, 0\] is no rectangle"),
        ({"regions": {"w": [0, 0, 0]}}, r"region w: \[0, 0, 0\] is no cell; write \[column, row\] or a rectangle"),
        ({"regions": {"w": [True, 0]}}, "is no cell"),
        ({"regions": {"w": []}}, "is no cell"),
        ({"regions": {"w": "A"}}, "region w: 'A' is no cell"),
        ({"regions": {"w": [[0, 0], 3]}}, "is no cell"),
        ({"noise": {"A": 3}}, "noise A is 3; write A = "),
        ({"noise": {"A": {}}}, "noise A is a dict of 0; write A = "),
        ({"noise": {"A": {"sucess": 1}}}, "noise A: unknown key sucess; did you mean success"),
        ({"noise": {"B": {"success": 1}}}, "there is no region B, nor such a letter in the map; known names: A, S"),
        ({"noise": {"A": {"success": 0.9, "slip": 0.1}}}, "success 0.9 and three times slip 0.1 sum to 1.2, not 1"),
        (
            {"regions": {"w": [0, 0, 1, 1]}, "noise": {"A": {"success": 1}, "w": {"success": 1}}},
            r"cell \[0, 1\] has the noise of A and of w; make regions of their own that do not overlap",
        ),
        ({"noise": {"A": {"success": "1/1000000000000000003"}}}, "no common denominator below 2.53; round them"),
        ({"one_way": {"X": [0, 0]}}, "one_way: X is no direction"),
        ({"one_way": {"E": [1, 0]}}, r"one_way E: every cell of \[1, 0\] is blocked"),
        ({"one_way": 3}, r"one_way is 3; write \[one_way\]"),
        ({"noise": {"A": {"success": "p"}}, "parameters": {"q": [0, 1]}}, "there is no parameter p"),
        ({"noise": {"A": {"success": "p"}}, "parameters": {"p": [0, 2]}}, "success is 2 where p is 2"),
        ({"noise": {"A": {"success": "p", "slip": "(1-p)/2"}}, "parameters": {"p": [0, 1]}}, "must sum to 1 for every"),
        ({"cell": 0}, "the side of a cell is positive"),
        ({"success": "1e-30", "slip": "333333333333333333333333333333/1000000000000000000000000000000"}, "round them"),
    ],
)
def test_bad_grids_are_refused(changes, says):
    with pytest.raises(ModelError, match=says):
        grid_from_table(table(**changes))


FAULTY = """\
# a floor
kind = "grid"
map = '''
  BB?C
  BB.C.

  #é.A
'''
moves = "knight"
success = 1.2  # too much
slip = "often"
cell = 0
slpi = 3
"""


def test_all_faults_of_a_file_are_told_at_once(tmp_path):
    path = tmp_path / "floor.toml"
    path.write_text(FAULTY, encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        stl.load_model(path)
    assert (
        str(caught.value).replace(str(path), "F")
        == """\
F, line 4, column 5: '?' is not a cell; use # (blocked), . (free), S (start) or a letter (label)
      BB?C
        ^
F, line 5, column 3: this row has 5 cells, the first has 4
      BB.C.
      ^
F, line 7, column 4: 'é' is not a cell; use # (blocked), . (free), S (start) or a letter (label)
      #é.A
       ^
F, line 9: moves is 'knight'; choose king, cross, or list them: ["stay", "N", "E"]
F, line 10: success is 1.2; a probability lies between 0 and 1
F, line 11: slip: 'often': there is no parameter often; declare it at the end of the model file:
  [parameters]
  often = [0.5, 1]
F, line 12: cell is 0; the side of a cell is positive, between 1e-100 and 1e100
F, line 13: unknown key slpi; did you mean slip?
8 errors"""
    )


@pytest.mark.parametrize("quotes", ["'''", '"""'])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_maps_are_pointed_at_however_they_are_written(tmp_path, quotes, end):
    path = tmp_path / "floor.toml"
    for before, line, column in (("", 2, 10), (end, 3, 1)):
        lines = ['kind = "grid"', f"map = {quotes}{before}?S", "..", f"{quotes}  # map = '''", "[x]"]
        path.write_bytes(end.join(lines).encode())
        with pytest.raises(ModelError) as caught:
            stl.load_model(path)
        assert f"line {line}, column {column}: '?' is not a cell" in str(caught.value)
        assert f"line {line + 3}: unknown key x" in str(caught.value)
    path.write_text('kind = "grid"\nmap = "?S\\n.."\n')
    with pytest.raises(ModelError, match=r"floor.toml, line 2: map line 1, column 1: '\?' is not a cell"):
        stl.load_model(path)


def test_many_faults_are_counted_in_linear_time(tmp_path):
    path = tmp_path / "floor.toml"
    rows = "\n".join("?" * 300 for _ in range(1000))
    path.write_text(f"kind = \"grid\"\nmap = '''\n{rows}\n'''\n" + "\n".join(f"k{i} = 1" for i in range(3000)))
    started = time.perf_counter()
    with pytest.raises(ModelError) as caught:
        stl.load_model(path)
    assert time.perf_counter() - started < 20  # seconds; a quadratic reader takes many minutes
    lines = str(caught.value).splitlines()
    assert len(lines) == 3 * 20 + 1
    assert lines[-1] == "303000 errors; the first 20 are shown"


def test_several_starts_are_uniform_and_told():
    model = grid_from_table(table(map="S.\n.S"))
    assert model.initial_text() == "2 states with probability 0.5 each: (0,1), (1,0)"
    assert (
        grid_from_table(table(map="SSS")).initial_text().startswith("3 states with probability 1/3 each: (0,0), (1,0)")
    )
    assert grid_from_table(table()).initial_text() == "(0,0)"
    many = grid_from_table(table(map="S" * 12)).initial_text()
    assert many == f"12 states with probability 1/12 each: {', '.join(f'({i},0)' for i in range(8))}, and 4 more"


def test_bad_files_are_named(tmp_path):
    path = tmp_path / "floor.toml"
    with pytest.raises(FileError, match="no such model file"):
        stl.load_model(path)
    path.write_text("kind = \n")
    with pytest.raises(ModelError, match=r"floor.toml: not valid TOML: .*line 1"):
        stl.load_model(path)
    path.write_text('kind = "grid"\nmap = "A"\nmove = "king"')
    with pytest.raises(ModelError, match="floor.toml, line 3: unknown key move; did you mean moves"):
        stl.load_model(path)


def test_decimals_in_a_file_mean_those_decimals(tmp_path):
    path = tmp_path / "floor.toml"
    path.write_text('kind = "grid"\nmap = "S."\nsuccess = 0.7\nslip = 0.1')
    assert set(stl.load_model(path).probability.tolist()) == {0.1, 0.3, 0.7, 0.9, 1.0}


MOVES = {"king": list(COMPASS), "cross": ["stay", "N", "S", "W", "E"]}
RING = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"]


def slowly(table):
    """(cell, move) → cell → [lower, upper] of a grid with regions, noise and one-way cells, cell by cell in plain
    Python."""
    lines = table["map"].split("\n")
    cells = {
        (c, len(lines) - 1 - i): kind for i, line in enumerate(lines) for c, kind in enumerate(line) if kind != "#"
    }
    moves = MOVES[table["moves"]] if isinstance(table["moves"], str) else table["moves"]
    around = [name for name in RING if len(name) == 1 or any(len(move) == 2 for move in moves)]

    def inside(cell, area):
        if all(isinstance(one, list) for one in area):
            return any(inside(cell, one) for one in area)
        left, bottom, right, top = area if len(area) == 4 else area * 2
        return left <= cell[0] <= right and bottom <= cell[1] <= top

    def ends(cell):
        found = table
        for name, noise in table.get("noise", {}).items():
            if cells[cell] == name or (name in table["regions"] and inside(cell, table["regions"][name])):
                found = noise
        success = [Fraction(part) for part in found["success"].strip("[]").split(",")]
        slip = [Fraction(part) for part in found["slip"].strip("[]").split(",")]
        return [success[0], success[-1]], [slip[0], slip[-1]]

    def allowed(cell, there, move):
        if there not in cells:
            return False
        own = [name for name, area in table["one_way"].items() if inside(cell, area)]
        if own and move not in own:
            return False
        ways = [COMPASS[name] for name, area in table["one_way"].items() if inside(there, area)]
        return all(COMPASS[move][0] * x + COMPASS[move][1] * y >= 0 for x, y in ways)

    for cell in cells:
        for move in moves:
            success, slip = ends(cell)
            outcomes = [("stay", [Fraction(1)] * 2)]
            if move != "stay":
                i = around.index(move)
                sides = around[i - 1], around[(i + 1) % len(around)]
                outcomes = [(move, success), ("stay", slip), (sides[0], slip), (sides[1], slip)]
            row = {}
            for direction, chance in outcomes:
                there = tuple(np.add(cell, COMPASS[direction]).tolist())
                if direction == "stay" or not allowed(cell, there, direction):
                    there = cell
                before = row.get(there, [0, 0])
                row[there] = [before[0] + chance[0], before[1] + chance[1]]
            yield (cell, move), {there: pair for there, pair in row.items() if pair[1]}


@pytest.mark.parametrize("seed", range(30))
def test_regions_noise_and_one_way_cells_against_plain_python(seed):
    rng = np.random.default_rng(seed)
    width, height = rng.integers(2, 7, 2).tolist()
    letters = rng.choice(list("#..ab"), (height, width), p=[0.15, 0.25, 0.25, 0.2, 0.15])
    letters[rng.integers(height), rng.integers(width)] = "S"
    free = [[c, height - 1 - i] for i, c in np.argwhere(letters != "#").tolist()]

    def area():
        some = [free[k] for k in rng.integers(0, len(free), 2)]
        whole = [*np.min(some, axis=0).tolist(), *np.max(some, axis=0).tolist()]
        return [some[0], whole] if rng.random() < 0.5 else whole if rng.random() < 0.5 else some[0]

    noises = [("9/10", "1/30"), ("1/7", "2/7"), ("[6/10, 9/10]", "[1/30, 2/15]")][: 2 + seed % 2]
    own = [name for name in rng.permutation(list(COMPASS)).tolist() if rng.random() < 0.5] or ["E"]
    table = {
        "kind": "grid", "map": "\n".join(map("".join, letters)), "success": "93/100", "slip": "7/300",
        "moves": [own, "king", "cross"][seed % 3],
        "regions": {"wet": area(), "a": area(), "shelf": area()},
        "one_way": {name: area() for name in rng.choice(RING, rng.integers(0, 3), replace=False).tolist()},
    }  # fmt: skip
    if "b" in table["map"]:
        success, slip = noises[-1]
        table["noise"] = {"b": {"success": success, "slip": slip}}
    else:
        table["noise"] = {"wet": {"success": noises[0][0], "slip": noises[0][1]}}
    model = grid_from_table(table)
    place = {tuple(int(i) for i in model.state_name(s)[1:-1].split(",")): s for s in range(model.n_states)}
    wanted = dict(slowly(table))
    assert len(wanted) == model.n_choices
    for (cell, move), row in wanted.items():
        s = place[cell]
        c = model.choice_start[s] + model.action_names.index(move)
        here = slice(model.row_start[c], model.row_start[c + 1])
        expected = {place[there]: pair for there, pair in row.items()}
        if model.uncertain:
            pairs = zip(model.intervals.lower[here].tolist(), model.intervals.upper[here].tolist(), strict=True)
            assert dict(zip(model.target[here].tolist(), pairs, strict=True)) == {
                s2: (float(lower), float(min(upper, 1))) for s2, (lower, upper) in expected.items()
            }
        else:
            exact = [Fraction(int(k), model.rows.denominator) for k in model.rows.numerator[here]]
            assert dict(zip(model.target[here].tolist(), exact, strict=True)) == {
                s2: pair[0] for s2, pair in expected.items()
            }
    for name, given in table["regions"].items():
        rectangles = given if isinstance(given[0], list) else [given]
        for cell, s in place.items():
            kind = table["map"].split("\n")[height - 1 - cell[1]][cell[0]]
            inside = any(one[0] <= cell[0] <= one[-2] and one[1] <= cell[1] <= one[-1] for one in rectangles)
            assert model.labels[name][s] == (inside or kind == name)


def test_noise_of_a_region_may_depend_on_the_parameter():
    given = table(
        map="A.B\nS#.", success="p", slip="(1-p)/3", noise={"A": {"success": "1/2"}, "B": {"success": "2*p-1"}},
        parameters={"p": ["3/4", 1]},
    )  # fmt: skip
    model = grid_from_table(given)
    assert (len(model.parameters), model.family) == (1, model)
    for value in (Fraction(3, 4), Fraction(9, 10)):
        at = model.at(p=value)
        wanted = table(
            map="A.B\nS#.", success=str(value), slip=str((1 - value) / 3),
            noise={"A": {"success": "1/2"}, "B": {"success": str(2 * value - 1)}},
        )  # fmt: skip
        assert at.digest() == grid_from_table(wanted).digest()
    narrow = model.within(p=("9/10", "9/10")).nominal()
    assert narrow.rows.probability.tolist() == pytest.approx(model.at(p="9/10").probability.tolist())
    assert grid_from_table(table(noise={"A": {"success": "1/2"}})).family is None


def test_many_regions_and_rectangles_take_linear_time():
    side = 400
    rows = "\n".join("." * side for _ in range(side - 1)) + "\n" + "S" + "." * (side - 1)
    area = [[0, 0, side - 1, side - 1] for _ in range(100_000)]
    started = time.process_time()
    model = grid_from_table(table(map=rows, regions={"all": area}))
    assert model.labels["all"].all()
    assert time.process_time() - started < 10  # seconds; cell by cell it is 1.6e10 steps
