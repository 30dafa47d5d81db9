"""The floor picture, read back from its SVG: cells, labels, starts, and the run with every step in its cell."""

import itertools
import re
import time
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stltool.reporting import report_data
from stltool.reporting.floor import floor_map, visits
from tests.conftest import many, some
from tests.reporting import svg
from tests.reporting.svg import drawn, overlapping

Picture = partial(svg.Picture, shift=0.5)


def layout(rows, labels=(), initial=()):
    """A floor from its map, top row first: # is blocked."""
    height, width = len(rows), len(rows[0])
    cells = [(column, height - 1 - line) for line in range(height) for column in range(width)
             if rows[line][column] != "#"]  # fmt: skip
    return {
        "member": "", "stride": 1,
        "width": width, "height": height, "column": [c for c, _ in cells], "row": [r for _, r in cells],
        "labels": {name: list(states) for name, states in dict(labels).items()}, "initial": list(initial),
    }  # fmt: skip


def cells_of(floor):
    return list(zip(floor["column"], floor["row"], strict=True))


def walk(floor, steps, seed):
    """A run that stays, or moves to a neighbour."""
    rng, cells = np.random.default_rng(seed), cells_of(floor)
    states = [0]
    for _ in range(steps):
        c, r = cells[states[-1]]
        near = [i for i, (d, q) in enumerate(cells) if max(abs(c - d), abs(r - q)) <= 1]
        states.append(int(rng.choice(near)))
    return states


def covered(boxes):
    """The cells that boxes cover, parts of them added up."""
    found = {}
    for left, bottom, right, top in boxes:
        cell = int(left + 1e-6), int(bottom + 1e-6)
        assert cell[0] - 1e-3 <= left < right <= cell[0] + 1 + 1e-3
        assert (bottom, top) == pytest.approx((cell[1], cell[1] + 1), abs=1e-3)
        found[cell] = found.get(cell, 0) + right - left
    return found


def cell_of(panel, text):
    left, top, right, bottom = text.box
    return int(panel.x((left + right) / 2)), int(panel.y((top + bottom) / 2))


def told_steps(picture):
    """What stands in each cell, as (ranges shown before a gap, ranges after it, how many are said to be)."""
    lines = {}
    for text in picture.texts("steps"):
        lines.setdefault(cell_of(picture.panel, text), []).append(text.text)
    found = {}
    for cell, parts in lines.items():
        text, count = re.fullmatch(r"(.*?)(?: \((\d+)×\))?", " ".join(parts)).groups()
        head, gap, tail = text.partition("…")
        found[cell] = (*(ranges(part) for part in (head, tail)), bool(gap), count and int(count))
    return found


def ranges(text):
    found = []
    for part in filter(None, re.split(r",? ", text.strip().rstrip(","))):
        first, _, last = part.rstrip("–").partition("–")
        found.append((int(first), int(last or first)))
    return found


def require_run(picture, floor, states):
    """The run that the picture shows is this one; everything about a cell is in it, and nothing hides a text."""
    panel, cells = picture.panel, cells_of(floor)
    path = [cells[s] for s in states]
    whole = {}
    for step, cell in enumerate(path):  # slow and obvious
        steps = whole.setdefault(cell, [])
        if steps and steps[-1][1] == step - 1:
            steps[-1] = (steps[-1][0], step)
        else:
            steps.append((step, step))
    assert visits(path) == whole
    dots = {(int(x), int(y)) for name in ("dots", "start-dot", "end-dot") for x, y, _, _ in panel.boxes(name)}
    told = told_steps(picture)
    assert told.keys() | dots == whole.keys()
    assert not told.keys() & dots
    for cell, (head, tail, gap, count) in told.items():
        if not gap:
            assert head == whole[cell]
            continue
        assert count in (None, len(whole[cell]))
        assert head[0][0] == whole[cell][0][0]
        assert head[1:] == whole[cell][1 : len(head)]
        assert tail == whole[cell][len(whole[cell]) - len(tail) :]
    ends = [(int(x), int(y)) for name in ("end", "end-dot") for x, y, _, _ in panel.boxes(name)]
    assert ends == [path[-1]]
    moves = {(a, b) for a, b in itertools.pairwise(path) if a != b}
    assert sorted(read_moves(panel)) == sorted(moves)
    # all of it inside
    boxes = [box for name in ("visits", "end", "dots", "start-dot", "end-dot") for box in panel.boxes(name)]
    assert len(boxes) == len(whole)
    for left, bottom, right, top in boxes:
        assert int(left) < left < right < int(left) + 1
        assert int(bottom) < bottom < top < int(bottom) + 1
    frames = {(int(box[0]), int(box[1])): box for box in boxes}
    for text in picture.texts("steps"):
        left, bottom, right, top = frames[cell_of(panel, text)]
        assert left < panel.x(text.box[0]) < panel.x(text.box[2]) < right
        assert bottom < panel.y(text.box[3]) < panel.y(text.box[1]) < top
    texts = picture.texts()
    assert not [(texts[i].text, texts[j].text) for i, j in overlapping([text.box for text in texts])]
    captions = [text.box for text in picture.texts("caption")]
    for box in captions:
        x0, x1 = panel.x(box[0]), panel.x(box[2])
        y0, y1 = panel.y(box[3]), panel.y(box[1])
        assert int(x0) < x0 < x1 < int(x0) + 1
        assert int(y0) < y0 < y1 < int(y0) + 1
        frame = frames.get((int(x0), int(y0)))
        assert frame is None or frame[3] < y0


def read_moves(panel):
    """From which cell to which the lines lead; each has a head that points so."""
    lines, heads = panel.shapes("moves"), panel.shapes("heads")
    assert len(lines) == len(heads)
    for (start, stop), (tip, one, other) in zip(lines, heads, strict=True):
        along = (stop - start) / np.linalg.norm(stop - start)
        base = (one + other) / 2
        assert (tip - base) / np.linalg.norm(tip - base) == pytest.approx(along, abs=0.02)
        assert base == pytest.approx(start + along * np.dot(base - start, along), abs=0.01)  # on its line
        yield tuple(map(int, start)), tuple(map(int, stop))


ROWS = st.integers(2, 7).flatmap(
    lambda width: st.lists(st.text("..#", min_size=width, max_size=width), min_size=2, max_size=6)
).filter(lambda rows: any("." in row for row in rows))  # fmt: skip


@given(ROWS, st.data())
@settings(max_examples=many(25))
def test_what_a_floor_shows_is_what_it_was_given(rows, data):
    floor = layout(rows)
    states = st.integers(0, len(floor["column"]) - 1)
    floor["labels"] = data.draw(st.dictionaries(st.sampled_from("ABCD"), st.lists(states, unique=True), max_size=3))
    floor["initial"] = data.draw(st.lists(states, unique=True, max_size=2))
    run = data.draw(st.none() | st.lists(states, min_size=1, max_size=30))
    picture = Picture(floor_map(floor, run))
    panel, cells = picture.panel, cells_of(floor)
    assert panel.xlim == pytest.approx((0, floor["width"]), abs=1e-3)
    assert panel.ylim == pytest.approx((0, floor["height"]), abs=1e-3)
    assert covered(panel.boxes("cells")) == pytest.approx(dict.fromkeys(cells, 1), abs=2e-3)
    sharing = {cell: sum(cells.index(cell) in own for own in floor["labels"].values()) for cell in cells}
    colours = []
    for i, own in enumerate(floor["labels"].values()):
        expected = {cells[s]: 1 / sharing[cells[s]] for s in own}
        assert covered(panel.boxes(f"label-{i}")) == pytest.approx(expected, abs=2e-3)
        colours += panel.colours(f"label-{i}")
    assert len(set(colours)) == len(colours)
    captions = {}
    for name, own in [*floor["labels"].items(), ("start", floor["initial"])]:
        for s in own:
            captions.setdefault(cells[s], []).append(name)
    shown = {cell_of(panel, text): text.text for text in picture.texts("caption")}
    assert shown.keys() == captions.keys()
    for cell, names in captions.items():
        whole = ", ".join(names)
        assert shown[cell] == whole or (len(whole) > 9 and whole.startswith(shown[cell].removesuffix("…")))
    if run is not None:
        require_run(picture, floor, run)
    else:
        assert not picture.texts("steps")


def test_what_is_no_cell_is_dark():
    panel = Picture(floor_map(layout(["..", "#."]))).panel
    background = next(panel.element.iter("path"))
    assert background.get("fill") == "#4a4a4a"
    assert panel.colours("cells") == {"white", "#ffffff"} & panel.colours("cells")
    assert covered(panel.boxes("cells")).keys() == {(0, 1), (1, 1), (1, 0)}


ROOM = layout(["....."] * 5, {"A": [0, 1, 5], "long name of a label": [7, 12]}, [0])
HALL = layout(["." * 10] * 10, {"A": range(30), "B": range(55, 60)}, [0])


@pytest.mark.parametrize(("floor", "steps", "seed"), [
    (ROOM, 80, 0), (ROOM, 80, 1), (HALL, 80, 0), (HALL, 80, 1), (ROOM, 400, 0), (layout(["..", "##"]), 81, 0)
])  # fmt: skip
def test_a_long_run_stays_readable(floor, steps, seed):
    states = walk(floor, steps, seed)
    picture = Picture(floor_map(floor, states))
    require_run(picture, floor, states)
    told = told_steps(picture)
    assert told.keys() == {cells_of(floor)[s] for s in states}  # numbers everywhere, dots nowhere
    if steps == 80:
        assert not any(gap for _, _, gap, _ in told.values())  # and all of them


def test_a_cell_visited_more_often_than_is_readable_tells_first_last_and_how_often():
    floor = layout(["..", ".."])
    run = [t % 2 for t in range(401)]
    head, tail, gap, count = told_steps(Picture(floor_map(floor, run)))[0, 1]
    assert (gap, count, tail) == (True, 201, [(400, 400)])
    assert len(head) > 5
    assert head == [(t, t) for t in range(0, 2 * len(head), 2)]


def test_a_run_of_100000_steps_is_drawn_at_once():
    floor = layout(["..", ".."])
    began = time.perf_counter()
    picture = Picture(floor_map(floor, [t % 2 for t in range(100_001)]))
    assert time.perf_counter() - began < 10  # minutes, if every way to shorten it were tried
    assert told_steps(picture)[0, 1][1:] == ([(100_000, 100_000)], True, 50_001)


@pytest.mark.parametrize("width", [30, 90])
def test_a_large_floor(width):
    floor = layout(["." * width] * 3, {"A": [0, 1], "B": [5]}, [1])
    run = walk(floor, 60, 1)
    picture = Picture(floor_map(floor, run))
    require_run(picture, floor, run)
    legend = [text.text for text in picture.texts("legend")]
    if width == 30:
        assert legend == []
        assert [text.text for text in picture.texts("caption")] == ["A", "A, start"[:8], "B"]
    else:  # cells too small for text
        assert legend == ["A", "B", "the run's start", "the run's end"]
        assert picture.texts("steps") == picture.texts("caption") == []
        cells = cells_of(floor)
        assert [(int(x), int(y)) for x, y, _, _ in picture.panel.boxes("start-dot")] == [cells[run[0]]]


def test_jumps_and_standing_still():
    floor = layout(["....."] * 2)
    for run in ([0, 9, 0, 3], [4] * 12, [2]):
        require_run(Picture(floor_map(floor, run)), floor, run)


def test_axes_are_numbered():
    picture = Picture(floor_map(layout(["." * 12] * 3)))
    assert [t.text for t in picture.texts("xtick")] == [str(i) for i in range(12)]
    wide = Picture(floor_map(layout(["." * 90] * 3)))
    assert [t.text for t in wide.texts("xtick")][:3] == ["0", "2", "4"]


@pytest.mark.soak
@pytest.mark.parametrize(
    "name", some(["$x$", "a $\\frac$", "<b>", "\x01\x00", "\ud800", "x" * 5000, "充电", "_under", "_" * 99])
)
def test_any_name_of_a_label_can_be_drawn(name):
    floor = layout(["..", ".."], {name: [0]}, [])
    picture = Picture(floor_map(floor))
    [caption] = picture.texts("caption")
    if len(name) < 6 and name.isprintable() and name.isascii():
        assert caption.text.strip() == name
    assert cell_of(picture.panel, caption) == (0, 1)
    wide = layout(["." * 90] * 3, {name: [0]}, [])
    assert len(Picture(floor_map(wide)).texts("legend")) == 1


def test_a_report_shows_the_run_that_it_tells(patrolling):
    import stltool as stl
    from stltool.checking.evidence import evidence_of
    from stltool.reporting import render

    best = stl.check(patrolling)
    data = report_data([best], evidence=evidence_of(patrolling, best.policy, seed=3))
    page = render(data)
    runs = data["why"]["runs"][0]["state_indices"], data["run"]["states"]
    for picture, run in zip(drawn(page), runs, strict=True):
        require_run(Picture(picture), data["floors"][0], run)
