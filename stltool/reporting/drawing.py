"""Common to all pictures: matplotlib's default style whatever the user's is, and a figure as SVG, PNG or PDF."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from xml.etree import ElementTree

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from stltool.files import MARK

INK = "#222222"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito's

_ILLEGAL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")  # in XML
_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
_COUNTED = re.compile(r"_\d+$")  # matplotlib's element names: axes_1, xtick_3
_KEPT = ("axes", "xtick", "ytick", "legend")  # kept as classes
_LONG = re.compile(r"-?\d+\.\d{4,}")  # thousandths of a point suffice, and are the same on every machine
_FONT = re.compile(r"(?P<style>.*?)\s*(?P<size>[\d.]+px)\s+(?P<family>.*)")


@contextmanager
def drawing() -> Iterator[None]:
    """matplotlib's defaults in place of the user's settings; text between $ signs is not typeset as a formula."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({"text.parse_math": False, "svg.fonttype": "none", "path.simplify": False})
        yield


def picture(figure: Figure, kind: str, salt: str, title: str) -> str | bytes:
    """A figure as svg, png or pdf, the same bytes every time.

    `salt` distinguishes its elements from those of another picture on the same page; `title` describes it to those who
    cannot see it.
    """
    metadata = {
        "svg": {"Date": None, "Creator": None},
        "png": {"Software": MARK},
        "pdf": {"CreationDate": None, "Creator": MARK, "Producer": None},
    }
    buffer = io.BytesIO()
    with drawing(), _any_glyph():
        matplotlib.rcParams["svg.hashsalt"] = salt
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata[kind])
    return _clean(buffer.getvalue().decode("utf-8"), title) if kind == "svg" else buffer.getvalue()


def svg(figure: Figure, salt: str, title: str) -> str:
    """A figure as SVG text, for a page or a file."""
    return str(picture(figure, "svg", salt, title))


def _clean(text: str, title: str) -> str:
    """matplotlib's SVG, made suitable for a page whose content security policy allows no inline styles.

    Style sheets and `style` attributes become attributes; metadata and comments are removed. Element names stay if
    something refers to them, and become classes otherwise, since several pictures share a page.
    """
    root = ElementTree.fromstring(_ILLEGAL.sub("\ufffd", text))
    referred = {match for element in root.iter() for value in element.attrib.values()
                for match in re.findall(r"^#(.+)$|^url\(#(.+)\)$", value) for match in match if match}  # fmt: skip
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in (f"{_SVG}metadata", f"{_SVG}style"):
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        attributes: dict[str, str] = {}
        for name, value in element.attrib.items():
            if name == "style":
                attributes |= _presentation(value)
            elif name == "id" and value not in referred:
                kind = _COUNTED.sub("", value)
                if kind == value or kind in _KEPT:
                    attributes["class"] = kind
            elif name != "type" and not value.startswith("rotate(-0 "):
                value = _LONG.sub(lambda number: f"{float(number[0]):.3f}".rstrip("0").rstrip("."), value)
                attributes[f"xlink:{name.removeprefix(_XLINK)}" if name.startswith(_XLINK) else name] = value
        element.attrib.clear()
        element.attrib.update(attributes)
    families = {text.attrib.pop("font-family") for text in root.iter("text")}
    if families:
        [root.attrib["font-family"]] = families  # the one of drawing()
    root.attrib.update({
        "xmlns": _SVG[1:-1], "xmlns:xlink": _XLINK[1:-1], "role": "img", "aria-label": title,
        "stroke-linejoin": "round", "stroke-linecap": "butt",  # matplotlib's style sheet for all elements
    })  # fmt: skip
    root.insert(0, ElementTree.Comment(f" {MARK} "))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _presentation(style: str) -> dict[str, str]:
    """A style as attributes: `fill: none; stroke: #222222`."""
    attributes: dict[str, str] = {}
    for declaration in filter(None, (part.strip() for part in style.split(";"))):
        name, _, value = (part.strip() for part in declaration.partition(":"))
        if name == "font" and (font := _FONT.fullmatch(value)):  # in older versions of matplotlib
            attributes |= {"font-size": font["size"], "font-family": font["family"]}
            for word in font["style"].split():
                attributes["font-style" if word in ("italic", "oblique") else "font-weight"] = word
        else:
            attributes[name] = value
    return attributes


def shown(text: str, longest: int = 60) -> str:
    """A user's name as one line of a picture: shortened, and without characters that cannot be drawn."""
    text = _ILLEGAL.sub("\ufffd", " ".join(str(text).split()))
    text = text if len(text) <= longest else text[: longest - 1] + "…"
    return f" {text}" if text.startswith("_") else text  # legends omit names with a leading underscore


def fitted(text: str, size: float, points: float) -> str:
    """As much of a name as fits into a width in points."""
    whole = shown(text)
    lengths = (shown(whole, longest) for longest in range(len(whole), 0, -1))
    return next((cut for cut in lengths if text_width(cut, size) <= points), "…")


def alone(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which values (n,) have no finite neighbour, so that a line through them has no length."""
    drawn = np.isfinite(np.concatenate([[np.nan], values, [np.nan]]))
    return np.asarray(drawn[1:-1] & ~drawn[:-2] & ~drawn[2:])


def text_width(text: str, size: float) -> float:
    """The width of a line in points, in the font of the pictures."""
    return size * sum(map(_advance, text))


@lru_cache(maxsize=4096)
def _advance(character: str) -> float:
    """The advance width of a character, in units of the font size."""
    with drawing(), _any_glyph():
        between, without = (
            TextPath((0, 0), text, size=100, prop=FontProperties()).get_extents().width
            for text in (f"o{character}o", "oo")
        )
    return float(between - without) / 100


@contextmanager
def _any_glyph() -> Iterator[None]:
    """Without the warning that the font lacks a letter: viewers of the SVG use their own font."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield
