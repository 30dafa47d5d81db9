"""A CSV log that is still being written: its rows, one by one, as soon as each is complete."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import TraceError
from stltool.monitoring.logs.clock import Clock, RunningClock, TimeColumn, Timing, rows_are_steps, time_column
from stltool.monitoring.logs.dates import DateError, dates, is_date
from stltool.monitoring.logs.dialect import TRUTH, dialect_of, number_in
from stltool.monitoring.logs.recording import chosen
from stltool.monitoring.logs.text import empty_line, no_time
from stltool.numbers import NumberError, shown


class Following:
    """The samples of a log's named columns, its rows read as they come and their times held against the clock.

    where     the log's name in messages
    timing    what is done with its times

    Raises TraceError, with the line, for a row that is not the next step, and for a cell that is neither a number nor a
    truth value.
    """

    def __init__(self, where: str, file: IO[str], names: Sequence[str], clock: Clock, decimal: str = ".") -> None:
        self.where, self._decimal = where, decimal
        self._lines = _Remembered(file)
        self._dialect = dialect_of(where, self._lines, decimal, False)  # type: ignore[arg-type]  # reads lines only
        header = self._dialect.header
        given = clock.time if clock.used else None
        column = time_column(where, self._dialect.names, given, clock.used, self._dialect.units)
        wanted = chosen(where, self._dialect.names, names, "column")
        self._times: _Times | None = None
        if column is not None and clock.used:
            self._times = _Times(
                where, column, header.index(column.name), RunningClock(clock, where, column.name), decimal
            )
            self.timing = Timing(f"column {column.name}, every {clock.step}", f"column {column.name}")
        else:
            self.timing = rows_are_steps(clock, f"column {column.name}" if column is not None else None)
        timed = [column.name] if self._times is not None and column is not None else []
        self.timing = self.timing.beside(clock, names)
        self._dialect.require_single(where, dict.fromkeys([*wanted, *timed]))
        self._places = [(name, header.index(name)) for name in wanted]

    def __iter__(self) -> Iterator[dict[str, float]]:
        line, empty = self._dialect.above, None
        for text in self._lines.rest(line):
            line += 1
            if not text.strip():
                empty = empty or line
                continue
            if empty is not None:
                raise empty_line(self.where, empty)
            cells = next(csv.reader([text], delimiter=self._dialect.separator, skipinitialspace=True))
            cells = self._dialect.cells(self.where, line, cells)
            if self._times is not None:
                self._times.read(cells, line)
            yield {name: self._value(name, cells[place], line) for name, place in self._places}

    def _value(self, name: str, cell: str, line: int) -> float:
        truth = TRUTH.get(cell.strip().lower())
        if truth is not None:
            return truth
        try:
            return number_in(cell, self._decimal)
        except NumberError as error:
            what = error if cell.strip() else "an empty cell; every step needs a value"
            raise TraceError(f"{self.where}, line {line}, column {name}: {what}") from None


@dataclass
class _Times:
    """The column of times, whose cells are held against a clock."""

    where: str
    column: TimeColumn
    place: int
    clock: RunningClock
    decimal: str
    first: str | None = None  # the cell of the first row

    def read(self, cells: Sequence[str], line: int) -> None:
        text, at = cells[self.place], f"{self.where}, line {line}, column {self.column.name}"
        first = self.first = text if self.first is None else self.first
        time: NDArray[Any]
        try:
            if is_date(first):
                time = dates([first, text])[1:]  # all with a time zone, or none
            else:
                time = self.column.seconds(np.array([number_in(text, self.decimal)]), self.where)
        except DateError as error:
            raise TraceError(f"{at}: {f'{shown(text)} {error}' if text.strip() else no_time(text)}") from None
        except NumberError:
            raise TraceError(f"{at}: {no_time(text)}") from None
        self.clock.read(time, line)


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
