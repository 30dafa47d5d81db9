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

Noise that is unknown is written in terms of a parameter (models/parameters.py):

    success = "p"
    slip = "(1-p)/3"
    [parameters]
    p = [0.5, 1]

Several S mean that runs start in each of these cells with equal probability.

Noise that is known only approximately is written as intervals, `success = [0.9, 0.95]` or `"[9/10, 19/20]"`, and
`robust_check` takes the model: at every step nature picks each outcome's probability in its interval, so that they sum
to 1.

`stay` always stays. A move into a blocked cell or off the map leaves the robot where it is; corners may be cut.
Numbers are decimals, or fractions in quotes, and exact: rows are summed as fractions, then rounded once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import StateNames
from stltool.errors import ModelError, near_misses
from stltool.models.cells import Cells
from stltool.models.fractions import Shares, over_one
from stltool.models.mdp import MDP, GridLayout
from stltool.models.normalize import HINT, MOST_MISSING, NOTHING, rescale
from stltool.models.parameters import Affine, Parameter, read_affine, read_parameter, read_parameters
from stltool.models.toml import Faults
from stltool.numbers import NumberError, exact, number_text
from stltool.sizes import require_numbered

MOVES = {
    "king": ("stay", "N", "S", "W", "E", "NW", "SW", "NE", "SE"),
    "cross": ("stay", "N", "S", "W", "E"),
}
_BLOCKED = ord("#")
_KEYS = ("kind", "map", "cell", "moves", "success", "slip", "start", "normalize", "name", "parameters")
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
    moves = table.get("moves", "king")
    if not isinstance(moves, str) or moves not in MOVES:
        faults.add("moves", f"moves is {moves!r}; choose one of {', '.join(MOVES)}")
    noise = _noise(table, normalize or table.get("normalize") is True, faults)
    cell = faults.reading("cell", _cell, table)
    if not isinstance(table.get("name", ""), str):
        faults.add("name", f"name is {table['name']!r}; write a text in quotes")
    first = faults.reading("start", _start, table.get("start"), cells) if cells is not None else None
    faults.refuse()
    assert cells is not None
    assert noise is not None
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
    source = Cells(free, MOVES[moves], noise.success, noise.slip, noise.uncertain, noise.parameter)
    if noise.parameter is not None and noise.parameter.value is not None:
        source = source.at({noise.parameter.name: noise.parameter.value})
    return MDP(
        source,
        initial=weights / starts,
        signals={"x": _centres(column, cell), "y": _centres(row, cell)},
        labels={letter: found == ord(letter) for letter in letters if letter != "S"},
        action_names=MOVES[moves],
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


_Ends: TypeAlias = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class _Noise:
    """Lower and upper end of success and of slip, and whether an interval was written; with a parameter, their values
    at the ends of its domain."""

    success: _Ends
    slip: _Ends
    uncertain: bool
    notes: Mapping[str, str]
    parameter: Parameter | None = None


def _noise(table: Mapping[str, Any], normalize: bool, faults: Faults) -> _Noise | None:
    """None if it is faulty."""
    if "parameters" in table or any(_is_expression(table.get(key)) for key in ("success", "slip")):
        return _parametric(table, faults)
    success = faults.reading("success", _ends, table, "success", (Fraction(1), Fraction(1)))
    slip = faults.reading("slip", _ends, table, "slip", None)
    if success is None or (slip is None and "slip" in table):
        return None
    slip = slip if slip is not None else ((1 - success[1]) / 3, (1 - success[0]) / 3)
    uncertain = any(_is_interval(table.get(key)) for key in ("success", "slip"))
    place = "slip" if "slip" in table else "success"
    least, most = success[0] + 3 * slip[0], success[1] + 3 * slip[1]
    notes = {}
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
        notes["normalize"] = str(done)
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
    denominator = math.lcm(*(end.denominator for end in (*success, *slip)))
    if denominator >= 2**53:
        written = ["–".join(dict.fromkeys(map(number_text, ends))) for ends in (success, slip)]
        faults.add(
            place, f"success {written[0]} and slip {written[1]} have no common denominator below 2^53; round them"
        )
    return _Noise(success, slip, uncertain, notes)


_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)  # not the e of 1e-3


def _is_expression(value: object) -> bool:
    return isinstance(value, str) and not _is_interval(value) and _NAME.search(value) is not None


def _parametric(table: Mapping[str, Any], faults: Faults) -> _Noise | None:
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
    found: dict[str, Affine] = {}
    before = faults.count
    for key in ("success", "slip"):
        if key in table and _is_interval(table[key]):
            faults.add(key, f"{key} is an interval; with parameters, write an expression such as p, or (1-p)/3")
        elif key in table and (read := faults.reading(key, _affine, key, table[key], declared)) is not None:
            found[key] = read
            if not read.slopes and not 0 <= read.constant <= 1:
                faults.add(key, f"{key} is {number_text(read.constant)}; a probability lies between 0 and 1")
    if faults.count > before:
        return None
    success = found.get("success", Affine(Fraction(1)))
    slip = found.get("slip", Affine(Fraction(1)).plus(success, Fraction(-1)).times(Fraction(1, 3)))
    used = {**success.slopes, **slip.slopes}
    for name in declared:
        if name not in used:
            faults.add(
                ("parameters", name), f"parameter {name} does not occur in success or slip; use it, or leave it out"
            )
            return None
    total = success.plus(slip, Fraction(3))
    place = "slip" if "slip" in table else "success"
    if total.slopes or total.constant != 1:
        given = table.get("success", 1)
        remainder = f"1-({given})" if re.search(r"[-+]", str(given)) else f"1-{given}"
        faults.add(
            place,
            f"success {given} and three times slip {table.get('slip')} must sum to 1 for every value of "
            f'{" and ".join(used)}; write slip = "({remainder})/3"',
        )
        return None
    if len(used) > 1:
        faults.add("parameters", f"a grid's noise depends on one parameter, not on {' and '.join(used)}; keep one")
        return None
    parameter = declared[next(iter(used))]
    ends: list[_Ends] = []
    for key, function in (("success", success), ("slip", slip)):
        ends.append((function.at({parameter.name: parameter.lower}), function.at({parameter.name: parameter.upper})))
        for end, value in zip((parameter.lower, parameter.upper), ends[-1], strict=True):
            if not 0 <= value <= 1:
                faults.add(
                    key if key in table else place,
                    f"{key} is {number_text(value)} where {parameter.name} is {number_text(end)}; a probability lies "
                    f"between 0 and 1, so make the domain of {parameter.name} smaller",
                )
                return None
    return _Noise(ends[0], ends[1], True, {}, parameter)


def _affine(key: str, value: object, declared: Mapping[str, Parameter]) -> Affine:
    try:
        return read_affine(value, declared)
    except ModelError as error:
        raise ModelError(f"{key}: {error}") from None


def _interval_text(ends: _Ends) -> str:
    return f"[{', '.join(map(number_text, ends))}]"


def _is_interval(value: object) -> bool:
    return isinstance(value, list) or (isinstance(value, str) and value.strip().startswith("["))


def _ends(table: Mapping[str, Any], key: str, default: _Ends | None) -> _Ends | None:
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
