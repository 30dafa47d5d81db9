"""Model files in TOML: read with decimals kept exactly, and all faults reported at once, with their lines."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

from stltool.errors import MOST_FAULTS, ModelError, all_told
from stltool.files import read_text
from stltool.source import Source, Span

_NAME = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_KEY = rf"{_NAME}(?:\s*\.\s*{_NAME})*"
_LINE = re.compile(rf"\s*(?:\[\s*(?P<table>{_KEY})\s*\]\s*(?:#.*)?$|(?P<key>{_KEY})\s*=\s*(?P<value>.*))")
_T = TypeVar("_T")


@dataclass(frozen=True)
class Fault:
    """A fault in a key, or a key of a table; `cell` is the position in a multi-line string: (line, column)."""

    place: tuple[str, ...]
    message: str
    cell: tuple[int, int] | None = None

    def __str__(self) -> str:
        if self.cell is None:
            return self.message
        return f"{self.place[-1]} line {self.cell[0] + 1}, column {self.cell[1] + 1}: {self.message}"


class ModelFaults(ModelError):
    """The faults in the table of a model file; `faults` are the first of `count`."""

    def __init__(self, faults: list[Fault], count: int) -> None:
        super().__init__(all_told([str(fault) for fault in faults], count))
        self.faults, self.count = faults, count


@dataclass
class Faults:
    """Collects the faults of a table."""

    found: list[Fault] = field(default_factory=list)  # for each key, the first ones, as many as a message lists
    count: int = 0
    by_key: dict[str, int] = field(default_factory=dict)

    def add(self, place: str | tuple[str, ...], message: str, cell: tuple[int, int] | None = None) -> None:
        place = (place,) if isinstance(place, str) else place
        self.count += 1
        self.by_key[place[0]] = self.by_key.get(place[0], 0) + 1
        if self.by_key[place[0]] <= MOST_FAULTS:
            self.found.append(Fault(place, message, cell))

    def reading(self, place: str | tuple[str, ...], read: Callable[..., _T], *arguments: Any) -> _T | None:
        """The result of `read`; None if it raises ModelError, which is added to the faults."""
        try:
            return read(*arguments)
        except ModelError as error:
            self.add(place, str(error))
            return None

    def refuse(self) -> None:
        """ModelFaults if there are any."""
        if self.found:
            raise ModelFaults(self.found, self.count)


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """The table in a file, and the text of the file."""
    text = read_text(path, "model file")
    try:
        return tomllib.loads(text, parse_float=Decimal), text
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not valid TOML: {error}") from None


def located(path: Path, text: str, error: ModelFaults) -> ModelError:
    """The faults with their lines in the file, in order."""
    lines, source = _Lines(text), Source(str(path), text)

    def told(fault: Fault) -> str:
        start, line = lines.start(fault), lines.of(fault.place)
        if start is not None:
            return Span(source, start, start + 1).show(fault.message)
        return f"{path}, line {line}: {fault}" if line is not None else f"{path}: {fault}"

    ordered = sorted(error.faults, key=lambda fault: (lines.of(fault.place) or 0, fault.cell or ()))
    return ModelError(all_told([told(fault) for fault in ordered[:MOST_FAULTS]], error.count))


class _Lines:
    """The lines of the keys in a TOML text; only keys at the beginning of a line are found."""

    def __init__(self, text: str) -> None:
        self.texts = text.split("\n")
        self.known: dict[tuple[str, ...], int] = {}
        self.first: dict[tuple[str, ...], int] = {}  # the line on which a multi-line string begins
        table: tuple[str, ...] = ()
        inside = ""  # the closing quotes of the multi-line string that contains the current line, if any
        for number, line in enumerate(self.texts, start=1):
            if inside:
                inside = "" if inside in line else inside
                continue
            found = _LINE.match(line)
            if found is None:
                continue
            if found["table"] is not None:
                table = _parts(found["table"])
                self.known.setdefault(table, number)
                continue
            key = (*table, *_parts(found["key"]))
            self.known.setdefault(key, number)
            quotes = found["value"][:3]
            if quotes in ("'''", '"""') and quotes not in (rest := found["value"][3:]):
                inside = quotes
                self.first[key] = number + (not rest.strip("\r"))  # a line break directly after the quotes is dropped

    def of(self, place: tuple[str, ...]) -> int | None:
        """The line of a key, or of the table that contains it."""
        return next((self.known[place[:n]] for n in range(len(place), 0, -1) if place[:n] in self.known), None)

    def start(self, fault: Fault) -> int | None:
        """The position of the character at fault in a multi-line string."""
        if fault.cell is None or fault.place not in self.first:
            return None
        row, column = fault.cell
        number = self.first[fault.place] + row - 1
        start = sum(len(line) + 1 for line in self.texts[:number]) + column
        if number == self.known[fault.place] - 1:  # after the quotes
            start += max(self.texts[number].find(quotes) for quotes in ("'''", '"""')) + 3
        return start


def _parts(key: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in re.findall(_NAME, key))
