"""The floor of a grid world with its labels, and a run on it: each cell shows the steps at which the run is there.

However long a run is, its steps in a cell are written in that cell: consecutive steps form one range, ranges that do
not fit are omitted from the middle, and a cell too small for text has a dot. Arrows are the moves between cells, each
drawn once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path

from stltool.reporting.drawing import INK, drawing, fitted, shown, svg, text_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABEL_COLOURS = ("#9ecae1", "#fdae6b", "#a1d99b", "#bcbddc", "#fa9fb5", "#fee391", "#c7e9c0", "#d9d9d9")
_BLOCKED, _GRID, _RUN = "#4a4a4a", "#cccccc", "#b2182b"
_ON_COLOUR = "#1a1a1a"  # stays dark where a dark page turns INK light (page.css)
_LEFT, _RIGHT, _BOTTOM, _TOP, _LEGEND = 0.55, 0.15, 0.5, 0.15, 1.5  # inches around the floor
_SMALL = 22.0  # points; a smaller cell has no text, and a legend explains the colours
_TEXT = 5.0  # points; smaller text is illegible
_MOST = 100  # ranges that fit into a cell
_CENTRE = 0.44  # of a cell's height: the position of its steps; its caption is above
_CAPITALS, _LINE = 0.73, 1.2  # of a font's size: the height of capitals and digits, and the line spacing

Cell: TypeAlias = tuple[int, int]
"""Column and row."""
Points: TypeAlias = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class _Sheet:
    """Axes whose unit is a cell, `points` wide."""

    axes: Axes
    points: float

    def write(self, x: float, y: float, text: str, size: float, name: str, **style: Any) -> None:
        """A line of text with its baseline at y."""
        self.axes.text(x, y, text, fontsize=size, va="baseline", gid=name, **style)

    def shapes(self, shapes: Sequence[Points], name: str, closed: bool = True, **style: Any) -> None:
        """Polygons, or lines, as one element of the picture."""
        if shapes:
            paths = [Path([*shape, shape[0]] if closed else shape, closed=closed) for shape in shapes]
            self.axes.add_patch(PathPatch(Path.make_compound_path(*paths), fill=closed, gid=name, **style))


@drawing()
def floor_map(floor: dict[str, Any], states: Sequence[int] | None = None, salt: str = "floor") -> str:
    """The floor as SVG, with the run through `states`. `floor`: width and height in cells; for each state its `column`
    and `row`; `labels` with their states; `initial` states. Cells without a state are blocked. In a composition,
    `states` are those of the whole; `stride` says which of the floor's each is (records.py)."""
    width, height = floor["width"], floor["height"]
    cells: list[Cell] = list(zip(floor["column"], floor["row"], strict=True))
    side = max(width, height, 1)
    scale = max(min(1.0, 7.0 / side), min(0.36, 16.0 / side))  # inches of a cell
    legend = _legend(floor, states) if 72 * scale < _SMALL else []
    wide = _LEFT + scale * width + _RIGHT + (_LEGEND if legend else 0.0)
    high = _BOTTOM + scale * height + _TOP
    figure = Figure(figsize=(wide, high))
    axes = figure.add_axes((_LEFT / wide, _BOTTOM / high, scale * width / wide, scale * height / high))
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.set_xlabel("column", fontsize=9)
    axes.set_ylabel("row", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_facecolor(_BLOCKED)
    sheet = _Sheet(axes, 72 * scale)
    for axis, length in ((axes.xaxis, width), (axes.yaxis, height)):
        ticks = range(0, length, _every(sheet.points))
        axis.set_ticks([tick + 0.5 for tick in ticks], [str(tick) for tick in ticks])
    path = [cells[s // floor["stride"] % len(cells)] for s in states] if states is not None else []
    moves = list(dict.fromkeys((a, b) for a, b in itertools.pairwise(path) if a != b))
    _draw_cells(sheet, floor, cells)
    if legend:
        axes.legend(handles=legend, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    captions = {} if sheet.points < _SMALL else _captions(floor, cells)
    coloured = {cells[s] for states in floor["labels"].values() for s in states}
    _draw_captions(sheet, captions, coloured, moves)
    _draw_moves(sheet, moves)
    _draw_visits(sheet, path, captions)
    return svg(figure, salt, "the floor with its labels" + (" and a run" if path else ""))


def _every(points: float) -> int:
    """The distance in cells between numbers on an axis: 1, 2, 5, 10, …"""
    steps = (k * int(10**e) for e in itertools.count() for k in (1, 2, 5))
    return next(n for n in steps if n * points >= 20)


def _colour(i: int) -> str:
    return _LABEL_COLOURS[i % len(_LABEL_COLOURS)]


def _captions(floor: dict[str, Any], cells: Sequence[Cell]) -> dict[Cell, str]:
    """The caption of each cell: its labels, and "start" if a run can start there."""
    found: dict[Cell, list[str]] = {}
    for name, states in [*floor["labels"].items(), ("start", floor["initial"])]:
        for s in states:
            found.setdefault(cells[s], []).append(name)
    return {cell: ", ".join(names) for cell, names in found.items()}


def _legend(floor: dict[str, Any], states: Sequence[int] | None) -> list[Patch]:
    """The legend for the colours of cells without captions."""
    patches = [Patch(facecolor=_colour(i), label=shown(name, 20)) for i, name in enumerate(floor["labels"])]
    if states is not None and len(states):
        patches.append(Patch(facecolor="white", edgecolor=_RUN, label="the run's start"))
        patches.append(Patch(facecolor=INK, label="the run's end"))
    return patches


def _draw_cells(sheet: _Sheet, floor: dict[str, Any], cells: Sequence[Cell]) -> None:
    """Free cells white, those of a label in its colour; a cell with several labels is divided between them."""
    style: dict[str, Any] = {"edgecolor": _GRID, "linewidth": 0.6, "zorder": 1}
    sheet.shapes([_box(*cell, 1, 1) for cell in cells], "cells", facecolor="white", **style)
    labelled: dict[Cell, list[int]] = {}
    for i, states in enumerate(floor["labels"].values()):
        for s in states:
            labelled.setdefault(cells[s], []).append(i)
    for i in range(len(floor["labels"])):
        parts = [
            _box(column + labels.index(i) / len(labels), row, 1 / len(labels), 1)
            for (column, row), labels in labelled.items()
            if i in labels
        ]
        sheet.shapes(parts, f"label-{i}", facecolor=_colour(i), **style)


def _draw_captions(
    sheet: _Sheet, captions: dict[Cell, str], coloured: set[Cell], moves: Sequence[tuple[Cell, Cell]]
) -> None:
    """Captions in the upper left corner of a cell; in the right one if a diagonal move passes only the left one."""
    size = min(10.0, max(_TEXT, 0.15 * sheet.points))
    passed = {(max(c, d), max(r, q)) for (c, r), (d, q) in moves if abs(c - d) == abs(r - q) == 1}
    for (column, row), text in captions.items():
        right = (column, row + 1) in passed and (column + 1, row + 1) not in passed
        x, y = column + (0.93 if right else 0.07), row + 0.94 - _CAPITALS * size / sheet.points
        told, colour = fitted(text, size, 0.86 * sheet.points), _ON_COLOUR if (column, row) in coloured else INK
        sheet.write(x, y, told, size, "caption", ha="right" if right else "left", color=colour, zorder=4)


def _draw_moves(sheet: _Sheet, moves: Sequence[tuple[Cell, Cell]]) -> None:
    """Arrows from cell to cell, each next to that of the move back, with heads at the border.

    The heads of diagonal moves are in the upper cell, since the lower one has its caption there.
    """
    lines, heads = [], []
    for a, b in moves:
        start, stop = (np.array([column + 0.5, row + _CENTRE]) for column, row in (a, b))
        along = (stop - start) / math.dist(start, stop)
        across = np.array([along[1], -along[0]])
        start, stop = start + 0.08 * across, stop + 0.08 * across
        long = max(0.16, 3.5 / sheet.points)
        shift = 0.13 * np.sign(along[1]) if a[0] != b[0] else 0.0
        middle, half = (start + stop) / 2 + shift * along, long / 2 * along
        lines.append([tuple(start), tuple(stop)])
        heads.append([tuple(middle + half), *(tuple(middle - half + w * long * across) for w in (0.45, -0.45))])
    sheet.shapes(lines, "moves", closed=False, edgecolor=_RUN, linewidth=1.2, zorder=2)
    sheet.shapes(heads, "heads", facecolor=_RUN, linewidth=0, zorder=2)


def _draw_visits(sheet: _Sheet, path: Sequence[Cell], captions: dict[Cell, str]) -> None:
    """The steps of each cell in a box, thick where the run ends; dots where cells are small."""
    pad = min(3.0, 0.045 * sheet.points)
    boxes: dict[str, list[Points]] = {"visits": [], "end": [], "dots": [], "start-dot": [], "end-dot": []}
    for cell, ranges in visits(path).items():
        x, y = cell[0] + 0.5, cell[1] + _CENTRE
        room = 0.88 * sheet.points - 2 * pad, (0.68 if cell in captions else 0.8) * sheet.points - 2 * pad
        fitting = _steps_text(ranges, *room, 0.125 * sheet.points) if sheet.points >= _SMALL else None
        if fitting is None:
            kind = "end-dot" if cell == path[-1] else "start-dot" if cell == path[0] else "dots"
            boxes[kind].append(_box(x - 0.2, y - 0.2, 0.4, 0.4))
            continue
        lines, size = fitting
        tall = ((len(lines) - 1) * _LINE + _CAPITALS) * size
        wide, high = (max(0.26, (points + 2 * pad) / sheet.points)  # covers the ends of the moves
                      for points in (max(text_width(line, size) for line in lines), tall))  # fmt: skip
        boxes["end" if cell == path[-1] else "visits"].append(_box(x - wide / 2, y - high / 2, wide, high))
        for i, line in enumerate(lines):
            below = tall / 2 - (_CAPITALS + i * _LINE) * size
            sheet.write(x, y + below / sheet.points, line, size, "steps", ha="center", color=_RUN, zorder=4)
    style: dict[str, Any] = {"edgecolor": _RUN, "zorder": 3}
    for kind, colour, edge in (("visits", "white", 0.7), ("end", "white", 2.0), ("dots", _RUN, 0.5),
                               ("start-dot", "white", 0.7), ("end-dot", INK, 0.7)):  # fmt: skip
        sheet.shapes(boxes[kind], kind, facecolor=colour, linewidth=edge, **style)


def _box(left: float, bottom: float, wide: float, high: float) -> Points:
    right, top = left + wide, bottom + high
    return [(left, bottom), (right, bottom), (right, top), (left, top)]


def visits(path: Sequence[Cell]) -> dict[Cell, list[tuple[int, int]]]:
    """The ranges of steps, first and last, that a path spends in each of its cells."""
    found: dict[Cell, list[tuple[int, int]]] = {}
    for cell, steps in itertools.groupby(range(len(path)), key=lambda t: path[t]):
        first, *rest = steps
        found.setdefault(cell, []).append((first, rest[-1] if rest else first))
    return found


def _steps_text(
    ranges: Sequence[tuple[int, int]], wide: float, high: float, largest: float
) -> tuple[list[str], float] | None:
    """The lines and the size of a text with the ranges, within so many points; None if none would be legible."""
    texts = [str(a) if a == b else f"{a}–{b}" for a, b in ranges]
    listed = _listed(texts)
    sizes = np.arange(min(9.0, max(_TEXT, largest)), _TEXT - 0.01, -0.5).tolist()
    for words, size in itertools.chain(((listed, size) for size in sizes), _shorter(texts, sizes[-1])):
        lines = _wrapped(words, size, wide, 1 + int((high / size - _CAPITALS) / _LINE))
        if lines is not None:
            return lines, size
    return None


def _listed(texts: Sequence[str]) -> list[str]:
    return [*(f"{text}," for text in texts[:-1]), texts[-1]]


def _shorter(texts: Sequence[str], size: float) -> Iterator[tuple[list[str], float]]:
    """The first ranges, the last one and their number; ever fewer of them, finally only the beginning."""
    for some in range(min(len(texts) - 2, _MOST), 0, -1):
        yield [*_listed(texts[:some]), "…", texts[-1], f"({len(texts)}×)"], size
    yield [f"{texts[0]}, …" if len(texts) > 1 else f"{texts[0].split('–')[0]}–…"], size
    yield [f"{texts[0].split('–')[0]}…"], size


def _wrapped(words: Sequence[str], size: float, points: float, most: int) -> list[str] | None:
    """Words in as few lines as possible; None if these are more than `most`, or a word is longer than a line."""
    lines = [""]
    for word in words:
        longer = f"{lines[-1]} {word}".strip()
        if text_width(longer, size) <= points:
            lines[-1] = longer
        elif len(lines) < most and text_width(word, size) <= points:
            lines.append(word)
        else:
            return None
    return lines
