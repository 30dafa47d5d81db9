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
        ({"moves": "knight"}, "moves is 'knight'; choose one of king, cross"),
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
        ({"moves": ["king"]}, r"moves is \['king'\]; choose one of"),
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
F, line 9: moves is 'knight'; choose one of king, cross
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
