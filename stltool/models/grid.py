"""Grid worlds from ASCII maps in TOML, with the motion model of [Wang24] (docs/reproduction.md, "The floor").

    kind = "grid"
    map = '''
    BB#CC          # blocked     . free     S start     other letters are labels
    BB.CC          the last line is the bottom row
    '''
    cell = 0.2               side of a cell; x and y are the centre of the current cell
    moves = "king"           stay and eight directions; "cross": stay and four
    success = "93/100"       the move is the intended one
    slip = "7/300"           each of three others: stay, and the two neighbouring directions
    start = [1, 0]           [column, row] of the first cell, from the bottom left, where the map marks none with S
    normalize = true         rescale success and slip if they miss a sum of 1 only by rounding

Cells are [column, row], and rectangles [left, bottom, right, top] with both corners inside:

    moves = ["stay", "N", "E", "S", "W", "NE"]      own actions, in this order

    [regions]                                       more labels, several to a cell
    wet = [3, 0, 4, 1]
    shelf = [[0, 4], [3, 3, 4, 4]]                  cells and rectangles
    [noise]                                         of moves that begin in a region, or in cells of a letter of the map
    wet = { success = "8/10", slip = "1/15" }
    [one_way]                                       cells that can only be left in this direction, and never be
    E = [[2, 2]]                                    entered against it

Noise that is unknown is written in terms of a parameter (models/parameters.py):

    success = "p"
    slip = "(1-p)/3"
    [parameters]
    p = [0.5, 1]

Several S mean that runs start in each of these cells with equal probability.

Noise that is known only approximately is written as intervals, `success = [0.9, 0.95]` or `"[9/10, 19/20]"`, and
`robust_check` takes the model: at every step nature picks each outcome's probability in its interval, so that they sum
to 1.

`stay` always stays. The directions beside a move are those at 45° if a move of the grid is diagonal, else at 90°. A
move into a blocked cell, off the map or against a one-way cell leaves the robot where it is; corners may be cut.
Numbers are decimals, or fractions in quotes, and exact: rows are summed as fractions, then rounded once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.display import StateNames
from stltool.errors import ModelError, near_misses
from stltool.models.cells import COMPASS, Cells, Ends, Noise
from stltool.models.fractions import Shares, over_one
from stltool.models.mdp import MDP, GridLayout
from stltool.models.normalize import HINT, MOST_MISSING, NOTHING, rescale
from stltool.models.parameters import Affine, Parameter, read_affine, read_parameter, read_parameters
from stltool.models.toml import Faults
from stltool.numbers import NumberError, exact, number_text
from stltool.sizes import require_memory, require_numbered

MOVES = {
    "king": ("stay", "N", "S", "W", "E", "NW", "SW", "NE", "SE"),
    "cross": ("stay", "N", "S", "W", "E"),
}
_BLOCKED = ord("#")
_KEYS = ("kind", "map", "cell", "moves", "success", "slip", "start", "normalize", "name", "parameters", "regions",
         "noise", "one_way")  # fmt: skip
_NOISE_KEYS = ("success", "slip")
_NO_CELL = re.compile(r"[^#.A-Za-z]")


def grid_from_table(table: Mapping[str, Any], default_name: str = "grid", normalize: bool = False) -> MDP:
    """A grid world from the keys of its file. Raises ModelFaults with all faults."""
    faults = Faults()
    if table.get("kind") != "grid":
        faults.add("kind", f'kind is {table.get("kind")!r}; write kind = "grid"')
    for key in table:
        if key not in _KEYS:
            faults.add(key, f"unknown key {key}; {near_misses(key, _KEYS)}")
    cells = _read_map(table.get("map"), faults)
    moves = faults.reading("moves", _moves, table.get("moves", "king"))
    areas = _Areas(cells) if cells is not None else None
    regions = _regions(table, areas, faults)
    noise = _noise(table, normalize or table.get("normalize") is True, faults)
    which = _which(table, areas, regions, faults)
    barred = _barred(table, areas, faults)
    cell = faults.reading("cell", _cell, table)
    if not isinstance(table.get("name", ""), str):
        faults.add("name", f"name is {table['name']!r}; write a text in quotes")
    first = faults.reading("start", _start, table.get("start"), cells) if cells is not None else None
    faults.refuse()
    assert cells is not None
    assert noise is not None
    assert moves is not None
    assert cell is not None
    assert first is not None

    height, width = cells.shape
    free = cells != _BLOCKED
    line, column = np.nonzero(free)  # states in reading order, from the top left
    require_numbered(len(line), "free cells", "make the cells larger, or the map smaller")
    row, found = height - 1 - line, cells[free]
    weights = first[free]
    starts = int(weights.sum())
    letters = [chr(code) for code in np.flatnonzero(np.bincount(found, minlength=128)) if chr(code).isalpha()]
    require_memory(len(line) * (len(letters) + len(regions)), f"the labels of {len(line)} cells", "give fewer regions")
    labels = {letter: found == ord(letter) for letter in letters if letter != "S"}
    for region, where in regions.items():
        labels[region] = where[free] | labels.get(region, False)
    source = Cells(
        free, moves, noise.ends, noise.uncertain, noise.parameter,
        which[free] if which is not None else None, barred[free] if barred is not None else None,
    )  # fmt: skip
    if noise.parameter is not None and noise.parameter.value is not None:
        source = source.at({noise.parameter.name: noise.parameter.value})
    return MDP(
        source,
        initial=weights / starts,
        signals={"x": _centres(column, cell), "y": _centres(row, cell)},
        labels=labels,
        action_names=moves,
        state_names=StateNames(len(row), _Names(column, row)),
        layout=GridLayout(width, height, column, row),
        name=str(table.get("name", default_name)),
        exact_initial=Shares(weights, starts),
        notes=noise.notes,
    )


class _Names:
    """Column and row of each state, counted from 0 at the bottom left."""

    def __init__(self, column: NDArray[np.int64], row: NDArray[np.int64]) -> None:
        self._column, self._row = column, row

    def __call__(self, s: int) -> str:
        return f"({self._column[s]},{self._row[s]})"


def _moves(given: object) -> tuple[str, ...]:
    if isinstance(given, str) and given in MOVES:
        return MOVES[given]
    known = ("stay", *COMPASS)
    if isinstance(given, str) or not isinstance(given, list) or not given:
        raise ModelError(f'moves is {described(given)}; choose {", ".join(MOVES)}, or list them: ["stay", "N", "E"]')
    for move in given:
        if not isinstance(move, str) or move not in known:
            raise ModelError(f"moves contain {described(move)}; {near_misses(str(move), known)}")
        if given.count(move) > 1:
            raise ModelError(f"moves contain {move} twice; list it once")
    return tuple(given)


class _Areas:
    """Sets of cells of a map, as a file writes them."""

    def __init__(self, cells: NDArray[np.uint8]) -> None:
        self.cells = cells
        self.free: NDArray[np.bool_] = cells != _BLOCKED
        self._free_before = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1), dtype=np.int64)  # above and to the left
        np.cumsum(np.cumsum(self.free, axis=0), axis=1, out=self._free_before[1:, 1:])

    def read(self, what: str, given: object) -> NDArray[np.bool_]:
        """(height, width) Booleans: a cell, a rectangle, or a list of these. ModelError if one has no free cell."""
        listed = given if isinstance(given, list) and given and all(isinstance(one, list) for one in given) else [given]
        height, width = self.cells.shape
        change = np.zeros((height + 1, width + 1), dtype=np.int32)  # so that many large rectangles take little time
        corners = []
        for one in listed:
            left, bottom, right, top = self._corners(what, one)
            lines = height - 1 - top, height - bottom  # the first line is at the top
            for line, column, by in ((0, left, 1), (0, right + 1, -1), (1, left, -1), (1, right + 1, 1)):
                change[lines[line], column] += by
            corners.append((one, lines, left, right))
        found: NDArray[np.bool_] = (change.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0) & self.free
        before = self._free_before
        for one, (above, below), left, right in corners:
            if before[below, right + 1] - before[above, right + 1] == before[below, left] - before[above, left]:
                raise ModelError(f"{what}: every cell of {one} is blocked; name free cells")
        return found

    def _corners(self, what: str, given: object) -> tuple[int, int, int, int]:
        shown = given if isinstance(given, list) and len(given) <= 4 else described(given)
        if not isinstance(given, list) or len(given) not in (2, 4) or not all(type(n) is int for n in given):
            raise ModelError(
                f"{what}: {shown} is no cell; write [column, row] or a rectangle [left, bottom, right, top], counted "
                "from 0 at the bottom left, or a list of these"
            )
        left, bottom, right, top = given * (4 // len(given))
        height, width = self.cells.shape
        if left > right or bottom > top:
            raise ModelError(f"{what}: {shown} is no rectangle; write [left, bottom, right, top]")
        if left < 0 or bottom < 0 or right >= width or top >= height:
            raise ModelError(f"{what}: {shown} is not on the map of {width} × {height} cells")
        return left, bottom, right, top


def _section(table: Mapping[str, Any], key: str, example: str, faults: Faults) -> Mapping[str, Any]:
    section = table.get(key, {})
    if isinstance(section, Mapping):
        return section
    faults.add(key, f"{key} is {described(section)}; write [{key}] and below it {example}")
    return {}


def _regions(table: Mapping[str, Any], areas: _Areas | None, faults: Faults) -> dict[str, NDArray[np.bool_]]:
    """The cells of each region, (height, width) Booleans."""
    section = _section(table, "regions", "wet = [3, 0, 4, 1]", faults)
    found: dict[str, NDArray[np.bool_]] = {}
    for name, given in section.items():
        place = ("regions", name)
        if name in ("x", "y"):
            faults.add(place, f"region {name}: {name} is a signal of the grid; choose another name")
        elif not name or re.search(r"[\r\n]", name):
            faults.add(place, f"region {name!r} cannot be a label; write letters, digits and _")
        elif areas is not None:
            require_memory(
                16 * areas.cells.size + areas.cells.size * len(found), f"region {name}", "give fewer regions"
            )
            cells = faults.reading(place, areas.read, f"region {name}", given)
            if cells is not None:
                found[name] = cells
    return found


def _which(
    table: Mapping[str, Any], areas: _Areas | None, regions: Mapping[str, NDArray[np.bool_]], faults: Faults
) -> NDArray[np.int64] | None:
    """The number of each cell's noise, (height, width): 0, or the place of its region in the table `noise`, from 1."""
    section = table.get("noise")
    if not isinstance(section, Mapping) or not section or areas is None:
        return None
    names = list(section)
    number = np.zeros(areas.cells.shape, dtype=np.int64)
    for k, name in enumerate(names, start=1):
        inside = regions.get(name, np.zeros_like(areas.free))
        if len(name) == 1 and name.isascii() and name.isalpha():
            inside = inside | (areas.cells == ord(name))
        if not inside.any():
            if name not in _section(table, "regions", "", Faults()):  # else its own fault is told
                known = {*regions, *(chr(code) for code in np.unique(areas.cells).tolist() if chr(code).isalpha())}
                message = f"there is no region {name}, nor such a letter in the map; {near_misses(name, known)}"
                faults.add(("noise", name), message)
            continue
        twice = np.argwhere(inside & (number > 0))
        if len(twice):
            line, column = twice[0].tolist()
            other = names[number[line, column] - 1]
            faults.add(
                ("noise", name),
                f"cell [{column}, {len(number) - 1 - line}] has the noise of {other} and of {name}; make regions of "
                "their own that do not overlap",
            )
            continue
        number[inside] = k
    return number


def _barred(table: Mapping[str, Any], areas: _Areas | None, faults: Faults) -> NDArray[np.uint8] | None:
    """The directions of the compass, as bits, in which one-way cells bar the way out of each cell, (height, width)."""
    section = _section(table, "one_way", "E = [[2, 2]]", faults)
    ways: dict[str, NDArray[np.bool_]] = {}
    for name, given in section.items():
        if name not in COMPASS:
            faults.add(("one_way", name), f"one_way: {name} is no direction; {near_misses(name, COMPASS)}")
        elif areas is not None:
            cells = faults.reading(("one_way", name), areas.read, f"one_way {name}", given)
            if cells is not None:
                ways[name] = cells
    if areas is None or not ways:
        return None
    height, width = areas.cells.shape
    barred = np.zeros((height + 2, width + 2), dtype=np.uint8)  # with a border
    some = np.logical_or.reduce(list(ways.values()))
    for bit, (move, (dx, dy)) in enumerate(COMPASS.items()):
        mask = np.uint8(1 << bit)
        out = some & ~ways.get(move, np.zeros_like(some))
        barred[1:-1, 1:-1] |= np.where(out, mask, np.uint8(0))
        for name, cells in ways.items():
            if dx * COMPASS[name][0] + dy * COMPASS[name][1] < 0:  # against it
                before = barred[1 + dy : 1 + dy + height, 1 - dx : 1 - dx + width]
                before |= np.where(cells, mask, np.uint8(0))
    return barred[1:-1, 1:-1]


@dataclass(frozen=True)
class _Noise:
    """For the grid, and then for each region of the table `noise`: the ends of success and of slip; with a parameter,
    their values at the ends of its domain. `uncertain`: whether these differ."""

    ends: tuple[Noise, ...]
    uncertain: bool
    notes: Mapping[str, str]
    parameter: Parameter | None = None


@dataclass(frozen=True)
class _Section:
    """A part of the file that gives success and slip, and where it stands."""

    keys: Mapping[str, Any]
    where: tuple[str, ...] = ()

    def at(self, key: str) -> tuple[str, ...]:
        return (*self.where, key)

    @property
    def last(self) -> tuple[str, ...]:
        """The key to blame for a sum."""
        return self.at("slip" if "slip" in self.keys else "success")


def _sections(table: Mapping[str, Any], faults: Faults) -> list[_Section]:
    found = [_Section(table)]
    for name, given in _section(table, "noise", 'wet = { success = "8/10" }', faults).items():
        if not isinstance(given, Mapping) or not given:
            faults.add(("noise", name), f'noise {name} is {described(given)}; write {name} = {{ success = "8/10" }}')
            continue
        for key in given:
            if key not in _NOISE_KEYS:
                faults.add(("noise", name, key), f"noise {name}: unknown key {key}; {near_misses(key, _NOISE_KEYS)}")
        found.append(_Section(given, ("noise", name)))
    return found


def _noise(table: Mapping[str, Any], normalize: bool, faults: Faults) -> _Noise | None:
    """None if it is faulty."""
    sections = _sections(table, faults)
    given = [section.keys.get(key) for section in sections for key in _NOISE_KEYS]
    if table.get("parameters", {}) != {} or any(map(_is_expression, given)):
        return _parametric(table, sections, faults)
    notes: dict[str, str] = {}
    read = [_plain(section, normalize, notes, faults) for section in sections]
    ends = tuple(one for one in read if one is not None)
    if len(ends) < len(read):
        return None
    denominator = math.lcm(*{end.denominator for noise in ends for pair in noise for end in pair})
    if denominator >= 2**53:
        faults.add(sections[-1].last, f"{_texts(ends)} have no common denominator below 2^53; round them")
    return _Noise(ends, any(map(_is_interval, given)), notes)


def _texts(ends: Sequence[Noise]) -> str:
    parts = (("–".join(dict.fromkeys(map(number_text, pair))) for pair in noise) for noise in ends[:4])
    return ", ".join("success {} and slip {}".format(*noise) for noise in parts)


def _plain(section: _Section, normalize: bool, notes: dict[str, str], faults: Faults) -> Noise | None:
    """The ends of success and slip in numbers or intervals; None if they are faulty."""
    table = section.keys
    success = faults.reading(section.at("success"), _ends, table, "success", (Fraction(1), Fraction(1)))
    slip = faults.reading(section.at("slip"), _ends, table, "slip", None)
    if success is None or (slip is None and "slip" in table):
        return None
    slip = slip if slip is not None else ((1 - success[1]) / 3, (1 - success[0]) / 3)
    uncertain = any(_is_interval(table.get(key)) for key in _NOISE_KEYS)
    place = section.last
    least, most = success[0] + 3 * slip[0], success[1] + 3 * slip[1]
    if uncertain and normalize:
        notes["normalize"] = NOTHING.format("intervals")
    if not uncertain and normalize:
        row = [success[0], slip[0], slip[0], slip[0]]
        scaled = faults.reading(
            place, rescale, over_one(row), np.array([0, 4]), lambda _: "success and three times slip"
        )
        if scaled is None:
            return None
        (numerator, one), done = scaled
        success, slip = ((share, share) for share in (Fraction(int(numerator[k]), one) for k in (0, 1)))
        told = f"{section.where[-1]}: {done}" if section.where else str(done)
        notes["normalize"] = "; ".join(filter(None, [notes.get("normalize"), told]))
    elif not uncertain and least != 1:
        shown = [number_text(value) for value in (success[0], slip[0], least)]
        hint = f"; {HINT}" if abs(least - 1) <= MOST_MISSING else ""
        faults.add(place, "success {} and three times slip {} sum to {}, not 1{}".format(*shown, hint))
    elif not least <= 1 <= most:
        faults.add(
            place,
            f"success {_interval_text(success)} and three times slip {_interval_text(slip)} sum to "
            f"{number_text(least)} … {number_text(most)}, never to 1; widen one of them",
        )
    return success, slip


_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)  # not the e of 1e-3


def _is_expression(value: object) -> bool:
    return isinstance(value, str) and not _is_interval(value) and _NAME.search(value) is not None


def _parametric(table: Mapping[str, Any], sections: Sequence[_Section], faults: Faults) -> _Noise | None:
    """Noise that depends on a parameter."""
    given = table.get("parameters", {})
    if not isinstance(given, Mapping):
        faults.reading("parameters", read_parameters, given)
        return None
    declared = {}
    for name, domain in given.items():
        parameter = faults.reading(("parameters", name), read_parameter, name, domain)
        if parameter is None:
            return None
        declared[name] = parameter
    before = faults.count
    found = [_expressions(section, declared, faults) for section in sections]
    read = [one for one in found if one is not None]
    if faults.count > before or len(read) < len(found):
        return None
    used = list(dict.fromkeys(name for pair in read for one in pair for name in one.slopes))
    for name in declared:
        if name not in used:
            faults.add(
                ("parameters", name), f"parameter {name} does not occur in success or slip; use it, or leave it out"
            )
            return None
    if len(used) > 1:
        faults.add("parameters", f"a grid's noise depends on one parameter, not on {' and '.join(used)}; keep one")
        return None
    parameter = declared[used[0]]
    both = [_at_ends(section, pair, parameter, faults) for section, pair in zip(sections, read, strict=True)]
    ends = tuple(one for one in both if one is not None)
    return _Noise(ends, True, {}, parameter) if len(ends) == len(both) else None


def _expressions(section: _Section, declared: Mapping[str, Parameter], faults: Faults) -> tuple[Affine, Affine] | None:
    """Success and slip as functions of parameters; None if they are faulty."""
    table = section.keys
    found: dict[str, Affine] = {}
    before = faults.count
    for key in _NOISE_KEYS:
        place = section.at(key)
        if key in table and _is_interval(table[key]):
            faults.add(place, f"{key} is an interval; with parameters, write an expression such as p, or (1-p)/3")
        elif key in table and (read := faults.reading(place, _affine, key, table[key], declared)) is not None:
            found[key] = read
            if not read.slopes and not 0 <= read.constant <= 1:
                faults.add(place, f"{key} is {number_text(read.constant)}; a probability lies between 0 and 1")
    if faults.count > before:
        return None
    success = found.get("success", Affine(Fraction(1)))
    slip = found.get("slip", Affine(Fraction(1)).plus(success, Fraction(-1)).times(Fraction(1, 3)))
    total = success.plus(slip, Fraction(3))
    if total.slopes or total.constant != 1:
        used = " and ".join({**success.slopes, **slip.slopes})
        given = table.get("success", 1)
        remainder = f"1-({given})" if re.search(r"[-+]", str(given)) else f"1-{given}"
        always = f" for every value of {used}" if used else ""
        faults.add(
            section.last,
            f"success {given} and three times slip {table.get('slip')} must sum to 1{always}; write slip = "
            f'"({remainder})/3"',
        )
        return None
    return success, slip


def _at_ends(section: _Section, pair: tuple[Affine, Affine], parameter: Parameter, faults: Faults) -> Noise | None:
    """Success and slip at the ends of the parameter's domain; None if one is no probability there."""
    found: list[Ends] = []
    for key, function in zip(_NOISE_KEYS, pair, strict=True):
        ends = function.at({parameter.name: parameter.lower}), function.at({parameter.name: parameter.upper})
        for end, value in zip((parameter.lower, parameter.upper), ends, strict=True):
            if not 0 <= value <= 1:
                faults.add(
                    section.at(key) if key in section.keys else section.last,
                    f"{key} is {number_text(value)} where {parameter.name} is {number_text(end)}; a probability lies "
                    f"between 0 and 1, so make the domain of {parameter.name} smaller",
                )
                return None
        found.append(ends)
    return found[0], found[1]


def _affine(key: str, value: object, declared: Mapping[str, Parameter]) -> Affine:
    try:
        return read_affine(value, declared)
    except ModelError as error:
        raise ModelError(f"{key}: {error}") from None


def _interval_text(ends: Ends) -> str:
    return f"[{', '.join(map(number_text, ends))}]"


def _is_interval(value: object) -> bool:
    return isinstance(value, list) or (isinstance(value, str) and value.strip().startswith("["))


def _ends(table: Mapping[str, Any], key: str, default: Ends | None) -> Ends | None:
    """A probability, or an interval of two: `[0.9, 0.95]`, `["9/10", "19/20"]` or `"[9/10, 19/20]"`."""
    value = table.get(key)
    if value is None:
        return default
    if _is_interval(value):
        parts = value if isinstance(value, list) else value.strip().removeprefix("[").removesuffix("]").split(",")
        if len(parts) != 2 or (isinstance(value, str) and not value.strip().endswith("]")):
            shown = f"[{', '.join(map(str, value))}]" if isinstance(value, list) else repr(value)
            raise ModelError(f'{key} is {shown}; write an interval as [0.9, 0.95] or ["9/10", "19/20"]')
        lower, upper = (_fraction(key, part) for part in parts)
    else:
        lower = upper = _fraction(key, value)
    if lower < 0 or upper > 1:
        wrong = lower if lower < 0 else upper
        raise ModelError(f"{key} is {number_text(wrong)}; a probability lies between 0 and 1")
    if lower > upper:
        raise ModelError(f"{key} is {_interval_text((lower, upper))}; the lower end comes first")
    return lower, upper


def _read_map(text: object, faults: Faults) -> NDArray[np.uint8] | None:
    """The cells as ASCII codes, lines from the top; None if the map is faulty."""
    if not isinstance(text, str) or not text.strip():
        faults.add("map", "the grid has no map; write map = '''…''' with one line per row")
        return None
    before = faults.count
    rows: list[str] = []
    for number, line in enumerate(text.splitlines()):
        row, indent = line.strip(), len(line) - len(line.lstrip())
        for found in _NO_CELL.finditer(row):
            faults.add(
                "map",
                f"{found.group()!r} is not a cell; use # (blocked), . (free), S (start) or a letter (label)",
                (number, indent + found.start()),
            )
        if row and rows and len(row) != len(rows[0]):
            faults.add("map", f"this row has {len(row)} cells, the first has {len(rows[0])}", (number, indent))
        rows += [row] if row else []
    if set("".join(rows)) == {"#"}:
        faults.add("map", "every cell of the map is blocked")
    if faults.count > before:
        return None
    return np.frombuffer("".join(rows).encode("ascii"), dtype=np.uint8).reshape(len(rows), -1)


def _start(given: object, cells: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The weight of each cell as a start, in the shape of `cells`: the key `start`, or the S cells with equal
    weights."""
    marked: NDArray[np.int64] = (cells == ord("S")).astype(np.int64)
    height, width = cells.shape
    if given is None:
        if not marked.any():
            raise ModelError(
                "the map has no start; mark a cell S, or write start = [column, row] (from the bottom left)"
            )
        return marked
    if marked.any():
        raise ModelError("the map marks a start S and the key start gives one; keep one of them")
    if not (isinstance(given, list) and len(given) == 2 and all(type(n) is int for n in given)):
        raise ModelError(f"start is {given!r}; write start = [column, row], counted from 0 at the bottom left")
    c, r = given
    if not (0 <= r < height and 0 <= c < width) or cells[height - 1 - r, c] == _BLOCKED:
        raise ModelError(f"start = [{c}, {r}] is blocked or off the map of {width} × {height} cells")
    marked[height - 1 - r, c] = 1
    return marked


def _centres(position: NDArray[np.int64], cell: Fraction) -> NDArray[np.float64]:
    """Centre coordinates, each the double nearest to the exact value."""
    values = np.array([float((p + Fraction(1, 2)) * cell) for p in range(int(position.max()) + 1)])
    return values[position]


def _cell(table: Mapping[str, Any]) -> Fraction:
    cell = _fraction("cell", table.get("cell", 1))
    if not Fraction(1, 10**100) <= cell <= 10**100:
        raise ModelError(f"cell is {number_text(cell)}; the side of a cell is positive, between 1e-100 and 1e100")
    return cell


def _fraction(key: str, value: object) -> Fraction:
    try:
        return exact(value)
    except NumberError as error:
        raise ModelError(f'{key}: {error}; write a number, or a fraction in quotes such as "7/300"') from None
