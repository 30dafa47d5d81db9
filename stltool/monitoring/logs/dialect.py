"""How a CSV file is written: what stands above its rows, its separator, and the names and units of its columns.

comments     lines that begin with #; if none of the lines below has names, the last comment has them
the header   a line of names; unnamed columns (an index in front, cells behind trailing commas) cannot be read
units        a line of units below it, such as s,m/s,-
rows         separated as the header is
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import IO

from stltool.display import counted
from stltool.errors import FileError, SettingsError, TraceError
from stltool.monitoring.logs.dates import is_date
from stltool.monitoring.logs.recording import option
from stltool.numbers import NumberError, double

SEPARATORS = {",": "a comma", ";": "a semicolon", "\t": "a tab"}
TRUTH = {"true": True, "false": False}
NO_VALUE = frozenset(["", "nan", "na", "n/a", "null", "none"])
"""Cells that stand for a missing value, in small letters."""
_LONGEST_LINE = 1 << 20  # characters of a header; anything longer is not a header
_MOST_COMMENTS = 1000
_UNIT = re.compile(r"[\[(].*[\])]|[-%°‰]|[A-Za-zµμΩ°%][\w²³/*·^°%µμΩ.()-]{0,15}")
_SURE = re.compile(
    r"[\[(].*[\])]|%|°C?|[nµμum]?s|ms|min|h|deg|rad|[cmk]?m|[mk]g|g|N|Nm|[kM]?Hz|rpm|[mk]?[VAW]|k?Pa|bar|[ck]?m/s|km/h|K|C"
    r"|m/s(\^?2|²)|deg/s|rad/s"
)


@dataclass(frozen=True)
class Dialect:
    """`header`, in line `line`, has a name for every cell of a row, "" for unnamed ones; the rows begin `above` lines
    down, at byte `body`; `units` are those of a units row, by name.
    """

    separator: str
    header: tuple[str, ...]
    line: int
    above: int
    body: int
    units: dict[str, str]

    @property
    def names(self) -> list[str]:
        return [name for name in self.header if name]

    def require_single(self, where: str, names: Iterable[str]) -> None:
        """TraceError if two columns have one of these names."""
        counts = Counter(self.header)
        for name in names:
            if counts[name] > 1:
                raise TraceError(
                    f"{where}, line {self.line}: two columns are named {name}; every column needs a name of its own"
                )

    def cells(self, where: str, line: int, row: list[str]) -> list[str]:
        """The cells of a row, one for every column: rows may lack unnamed cells behind the last name, or have more
        empty ones.
        """
        if len(row) == len(self.header):
            return row
        named = max(i for i, name in enumerate(self.header) if name) + 1
        if len(row) < named or any(cell.strip() for cell in row[len(self.header) :]):
            found, wanted = counted(len(row), "cell"), counted(named, "column")
            raise TraceError(f"{where}, line {line}: {found} where the header names {wanted}")
        return [*row, *[""] * (len(self.header) - len(row))]


def dialect_of(where: str, file: IO[str], decimal: str, named_columns: bool) -> Dialect:
    """The dialect of a file, opened at its beginning; `named_columns`: whether every column is to be read.

    Raises FileError if the file is not text, TraceError, with the line, if it has no names.
    """
    lines = _Lines(where, file)
    comment, top = None, lines.next()
    while top.startswith("#") and lines.number <= _MOST_COMMENTS:
        comment, top = (lines.number, top), lines.next()
        while not top.strip() and top:
            top = lines.next()
    if comment is None or not (top and _has_value(where, lines.number, top, decimal)):
        number, header, first = lines.number, top, None
        if not header.strip():
            what = f"line {number} is empty" if header else "the file is empty"
            raise TraceError(f"{where}: {what}; write the names of the signals there, such as t,x,door")
    else:
        (number, header), first = comment, top
        header = header.lstrip("#")
    separator, names = _names(where, number, header, decimal)
    above, body = (lines.number, lines.bytes) if first is None else (lines.number - 1, lines.bytes - _bytes(top))
    row = first if first is not None else lines.next()
    units: dict[str, str] = {}
    if row and (found := _units(row, separator, names)):
        units, above, body = found, lines.number, lines.bytes
        row = lines.next()
    cells = _split(row, separator)
    if first is not None and not len(names) <= len(cells) <= len(names) + (not cells[-1]):
        raise TraceError(
            f"{where}, line {lines.number}: expected a name, found {cells[0]}; put a line with the "
            "names of the columns first"
        )
    names += [""] * (_trailing(row, separator, len(names)))
    _require_names(where, number, names, named_columns)
    return Dialect(separator, tuple(names), number, above, body, units)


def is_value(text: str, decimal: str = ".") -> bool:
    """Whether a cell is a number or a truth value."""
    if text.strip().lower() in TRUTH or text.strip().lower() in ("nan", "inf"):
        return True
    try:
        number_in(text, decimal)
    except NumberError:
        return False
    return True


def number_in(text: str, decimal: str) -> float:
    """The number in a cell. Raises NumberError."""
    if decimal == ".":
        return double(text)
    if "." in text:
        raise NumberError(f"{text.strip()!r} has a decimal point, not a comma")
    return double(text.replace(decimal, "."))


class _Lines:
    """The first lines of a file, counted."""

    def __init__(self, where: str, file: IO[str]) -> None:
        self.where, self.file, self.number, self.bytes = where, file, 0, 0

    def next(self) -> str:
        line = self.file.readline(_LONGEST_LINE)
        self.number += 1
        self.bytes += _bytes(line)
        at = f"{self.where}: not a CSV file"
        if "\0" in line:
            raise FileError(f"{at}: it contains binary data (a zero byte in line {self.number})")
        bad = next((ord(c) & 0xFF for c in line if "\udc80" <= c <= "\udcff"), None)
        if bad is not None and self.number == 1:
            raise FileError(f"{at}: byte {bad:#04x} in line 1 is not UTF-8 text; save it as UTF-8")
        if len(line) == _LONGEST_LINE:
            raise FileError(f"{at}: line {self.number} has over a million characters; it should name the signals")
        return line.removeprefix("\ufeff") if self.number == 1 else line


def _bytes(line: str) -> int:
    return len(line.encode("utf-8", "surrogateescape"))


def _split(line: str, separator: str) -> list[str]:
    """The cells of one line; of a line whose quotes are not closed, what the csv module makes of it."""
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def _separators(line: str, decimal: str) -> list[str]:
    outside = "".join(line.split('"')[::2]).strip("\r\n")
    return [separator for separator in SEPARATORS if separator in outside and separator != decimal]


def _has_value(where: str, number: int, line: str, decimal: str) -> bool:
    """Whether a line has a value, so that it is a row."""
    separators = _separators(line, decimal)
    cells = _split(line, separators[0] if separators else ",")
    return any(is_value(cell, decimal) or is_date(cell) for cell in cells)


def _names(where: str, number: int, line: str, decimal: str) -> tuple[str, list[str]]:
    """The separator and the names in the header."""
    at = f"{where}, line {number}"
    if line.count('"') % 2:
        raise TraceError(f"{at}: a quote is not closed; close it on the same line")
    separators = _separators(line, decimal)
    if len(separators) > 1:
        found = " and ".join(SEPARATORS[separator] for separator in separators)
        raise TraceError(
            f"{at}: {found} could both separate the names; use one, and quote names that contain the other"
        )
    if not separators and decimal == "," and "," in line:
        raise SettingsError(
            f"{at}: commas separate its cells, so they cannot be decimals, too; leave out {option('decimal', ',')}"
        )
    separator = separators[0] if separators else ";" if decimal == "," else ","
    return separator, _split(line, separator)


def _units(line: str, separator: str, names: list[str]) -> dict[str, str]:
    """The units in a line, by name; none if it is not a line of units."""
    cells = _split(line, separator)
    filled = [cell for cell in cells if cell]
    if len(cells) < len([name for name in names if name]) or not filled:
        return {}
    if not all(_UNIT.fullmatch(cell) and cell.lower() not in NO_VALUE and not is_value(cell) for cell in filled):
        return {}
    if not any(_SURE.fullmatch(cell) for cell in filled):
        return {}
    return {name: cell for name, cell in zip(names, cells, strict=False) if name and cell}


def _trailing(line: str, separator: str, columns: int) -> int:
    """1 if rows end with a separator that the header does not have."""
    cells = _split(line, separator)
    return int(len(cells) == columns + 1 and not cells[-1])


def _require_names(where: str, number: int, names: list[str], all_columns: bool) -> None:
    at = f"{where}, line {number}"
    last = max((i for i, name in enumerate(names) if name), default=-1)
    if last < 0:
        raise TraceError(f"{at}: no column has a name; write the names of the signals there, such as t,x,door")
    counts = Counter(names)
    for i, name in enumerate(names):
        if not name and 0 < i < last and all_columns:
            raise TraceError(f"{at}: column {i + 1} has no name; name it, or name the signals to read")
        if name and counts[name] > 1 and all_columns:
            raise TraceError(f"{at}: two columns are named {name}; every column needs a name of its own")
        if name and is_value(name):
            raise TraceError(f"{at}: expected a name, found {name}; put a line with the names of the columns first")
