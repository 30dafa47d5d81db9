"""Pictures read back: where an SVG has its lines, areas, markers and texts, in the units of its axes.

Positions are mapped through the numbers that the axes show, as a reader with a ruler would do it.
"""

import itertools
import math
import re
from dataclasses import dataclass
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.textpath import TextPath
from matplotlib.transforms import Bbox

SVG, XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
_UNITS = {"": 1, "k": 1e3, "M": 1e6, "m": 1e-3}
_PLAIN = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def drawn(page):
    """The pictures of a report's page that were made before it, in order."""
    return re.findall(r'<div class="pictures">(<svg.*?</svg>)', page, flags=re.DOTALL)


@dataclass(frozen=True)
class Text:
    """A text with the box of its ink on the page (points, y downwards) and the classes of the groups around it."""

    text: str
    box: tuple[float, float, float, float]  # left, top, right, bottom
    names: tuple[str, ...]


class Panel:
    """One pair of axes."""

    def __init__(self, picture, element, x, y):
        self.picture, self.element, self.x, self.y = picture, element, x, y
        [corners] = points_of(next(element.iter("path")))
        xs, ys = x(corners[:, 0]), y(corners[:, 1])
        self.xlim, self.ylim = (xs.min(), xs.max()), (ys.min(), ys.max())

    def _mapped(self, points):
        return np.stack([self.x(points[:, 0]), self.y(points[:, 1])], axis=1)

    def names(self):
        """What of the panel has a name."""
        return {e.get("class") for e in self.element.iter()} - {None, "axes", "xtick", "ytick", "legend"}

    def shapes(self, name):
        """The lines and the polygons of a name, each as points (n, 2)."""
        groups = with_class(self.element, name)
        return [self._mapped(shape) for group in groups for shape in self.picture.outlines(group)]

    def boxes(self, name):
        """The same as boxes (left, bottom, right, top), in order."""
        return sorted((*shape.min(axis=0), *shape.max(axis=0)) for shape in self.shapes(name))

    def markers(self, name):
        """Where the markers of a name are, (n, 2)."""
        uses = [use for group in with_class(self.element, name) for use in group.iter("use")]
        return self._mapped(np.array([(float(use.get("x")), float(use.get("y"))) for use in uses]).reshape(-1, 2))

    def levels(self, name):
        """The heights of the horizontal lines of a name."""
        found = []
        for shape in self.shapes(name):
            assert np.ptp(shape[:, 1]) == 0
            np.testing.assert_allclose(sorted(shape[:, 0]), self.xlim)  # from edge to edge
            found.append(shape[0, 1])
        return found

    def colours(self, name, what="fill"):
        """The colours of a name's shapes."""
        found = {e.get(what) for group in with_class(self.element, name) for e in group.iter()}
        return found - {None, "none"}


class Picture:
    """A whole picture. `shift` is added to the numbers that axes show: of a cell, they are in its middle."""

    def __init__(self, text, shift=0.0):
        self.root = ElementTree.fromstring(text)
        for element in self.root.iter():
            element.tag = element.tag.removeprefix(SVG)
        self.defined = {e.get("id"): e for e in self.root.iter() if e.get("id")}
        found = [axes for axes in with_class(self.root, "axes") if next(with_class(axes, "xtick"), None) is not None]
        xs, ys = ([scale(axes, axis, shift) for axes in found] for axis in "xy")
        xs, ys = filled(xs[::-1])[::-1], filled(ys)  # shared with the panel below, or with the one to the left
        self.panels = [Panel(self, *own) for own in zip(found, xs, ys, strict=True)]

    @property
    def panel(self):
        [panel] = self.panels
        return panel

    def outlines(self, group):
        """Lines and polygons on the page; shapes that are defined once and used in their places, too."""
        hidden = {id(e) for defs in group.iter("defs") for e in defs.iter()}
        paths = [path for path in group.iter("path") if id(path) not in hidden]
        for path in paths:
            yield from points_of(path)
        for use in group.iter("use") if not paths else ():
            shift = float(use.get("x")), float(use.get("y"))
            for points in points_of(self.defined[use.get(f"{XLINK}href")[1:]]):
                yield points + shift

    def texts(self, name=None):
        """All texts, or those in groups of a class."""
        return [text for text in self._texts(self.root, ()) if name is None or name in text.names]

    def _texts(self, element, names):
        names = (*names, element.get("class")) if element.get("class") else names
        if element.tag == "text" and (element.text or "").strip():
            yield Text(element.text, ink(element), names)
        for child in element:
            yield from self._texts(child, names)


def scale(axes, axis, shift):
    """The map from the page to an axis, from its first and last number; None where it shows none."""
    ticks = []
    for tick in with_class(axes, f"{axis}tick"):
        label = "".join(text.text or "" for text in tick.iter("text"))
        if label and (value := number(label)) is not None:
            ticks.append((float(next(tick.iter("use")).get(axis)), value + shift, label))
    if not ticks:
        return None
    (a, low, label), (b, high, _) = ticks[0], ticks[-1]
    if label[-1] in "⁻⁰¹²³⁴⁵⁶⁷⁸⁹":
        low, high = math.log10(low), math.log10(high)
        return lambda at: 10 ** (low + (np.asarray(at) - a) * (high - low) / (b - a))
    return lambda at: low + (np.asarray(at) - a) * (high - low) / (b - a)


def filled(scales):
    """None replaced by what stands before it, at the beginning by what comes first; if all have names, by points."""
    last = next((known for known in scales if known is not None), lambda at: -np.asarray(at))
    return [last := known or last for known in scales]


def with_class(element, name):
    return (e for e in element.iter() if e.get("class") == name)


def number(label):
    """A tick's label as a number: 2.5k, −0.2, 10⁻³; None for a name."""
    if re.fullmatch("10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", label):
        return 10.0 ** int(label[2:].translate(_PLAIN))
    found = re.fullmatch(r"(-?[\d.]+)([kMm]?)", label.translate(_PLAIN))
    return float(found[1]) * _UNITS[found[2]] if found else None


def points_of(path):
    """The corners of a path's parts, each (n, 2), without the one that closes it."""
    parts = []
    for command, numbers in re.findall(r"([MLCz])([^MLCz]*)", path.get("d")):
        point = list(map(float, numbers.split()))
        if command == "M":
            parts.append([point])
        elif command == "L" and point != parts[-1][0]:
            parts[-1].append(point)
        elif command == "C":
            parts[-1].append(point[-2:])
    return [np.array(part) for part in parts]


@cache
def outline(text, size):
    """Letters have points where they extend farthest, so that their curves need not be solved for their extrema."""
    with rc_context({"text.parse_math": False}):
        path = TextPath((0, 0), text, size=size)
    points = path.vertices[path.codes != path.CLOSEPOLY]
    return Bbox([points.min(axis=0), points.max(axis=0)])


def ink(element):
    """The box of a text on the page; its font is taken to be matplotlib's."""
    turn, size = element.get("transform", ""), float(element.get("font-size").removesuffix("px"))
    moved = re.match(r"translate\((\S+) (\S+)\)", turn)
    x, y = map(float, moved.groups() if moved else (element.get("x"), element.get("y")))
    box = outline(element.text, size)
    shift = {"start": 0, "middle": box.width / 2, "end": box.width}[element.get("text-anchor", "start")]
    left, right, top, bottom = -shift, box.width - shift, -box.y1, -box.y0
    if "rotate" in turn and "rotate(-0" not in turn:
        assert "rotate(-90" in turn
        left, right, top, bottom = top, bottom, -right, -left
    return x + left, y + top, x + right, y + bottom


def overlapping(boxes, slack=0.25):
    """Pairs of boxes (left, top, right, bottom) that share more than a hair's breadth."""
    return [
        (i, j)
        for (i, a), (j, b) in itertools.combinations(enumerate(boxes), 2)
        if min(a[2], b[2]) - max(a[0], b[0]) > slack and min(a[3], b[3]) - max(a[1], b[1]) > slack
    ]


def same_picture(one, other):
    """Two pictures show the same: their texts, and the shapes and markers of every name, panel by panel."""
    assert sorted(text.text for text in one.texts()) == sorted(text.text for text in other.texts())
    assert len(one.panels) == len(other.panels)
    for panel, twin in zip(one.panels, other.panels, strict=True):
        room = np.array([np.ptp(panel.xlim), np.ptp(panel.ylim)])
        assert (*panel.xlim, *panel.ylim) == pytest.approx((*twin.xlim, *twin.ylim), abs=0.01 * room.max())
        assert panel.names() == twin.names()
        for name in panel.names():
            for a, b in itertools.chain(
                zip(panel.shapes(name), twin.shapes(name), strict=True), [(panel.markers(name), twin.markers(name))]
            ):
                assert a.shape == b.shape
                np.testing.assert_allclose(a / room, b / room, atol=0.005)
