"""A CSV log that is still being written: its rows, one by one, as soon as each is complete."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from typing import IO

from stltool.errors import TraceError
from stltool.monitoring.logs.dialect import TRUTH, dialect_of, number_in
from stltool.monitoring.logs.recording import chosen
from stltool.numbers import NumberError, shown


def samples(where: str, file: IO[str], names: Sequence[str], decimal: str = ".") -> Iterator[dict[str, float]]:
    """The samples of the named columns. Raises TraceError, with the line, for what is not a number or a truth value."""
    lines = _Remembered(file)
    dialect = dialect_of(where, lines, decimal, False)  # type: ignore[arg-type]  # reads lines only
    wanted = chosen(where, dialect.names, names, "column")
    dialect.require_single(where, wanted)
    places = [(name, dialect.header.index(name)) for name in wanted]
    number = dialect.above
    for line in lines.rest(dialect.above):
        number += 1
        if not line.strip():
            continue
        cells = next(csv.reader([line], delimiter=dialect.separator, skipinitialspace=True))
        if len(cells) < len(dialect.header):
            raise TraceError(f"{where}, line {number}: {len(cells)} cells where the header has {len(dialect.header)}")
        sample: dict[str, float] = {}
        for name, place in places:
            try:
                truth = TRUTH.get(cells[place].strip().lower())
                sample[name] = number_in(cells[place], decimal) if truth is None else truth
            except NumberError as error:
                what = error if cells[place].strip() else f"{shown(cells[place])} is no value; every step needs one"
                raise TraceError(f"{where}, line {number}, column {name}: {what}") from None
        yield sample


class _Remembered:
    """Lines that can be read a second time."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self._lines: list[str] = []

    def readline(self, limit: int = -1) -> str:
        line = self._file.readline(limit)
        if line:
            self._lines.append(line)
        return line

    def rest(self, first: int) -> Iterator[str]:
        """The lines from one on."""
        yield from self._lines[first:]
        while line := self._file.readline():
            yield line
