"""Traces in CSV and TSV files, compressed ones (.csv.gz) and standard input.

Two readers accept the same files. A kernel (kernels/cells.py) reads large ones, in which every line is a row, from
their bytes; whatever it does not take for certain goes to the other, which reads cell by cell with the csv module and
reports the line, the column and the text of a fault.
"""

from __future__ import annotations

import csv
import gzip
import io
import mmap
import os
import sys
import zlib
from array import array
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import FileError, TraceError
from stltool.monitoring.logs.clock import TimeColumn, time_column
from stltool.monitoring.logs.dates import DateError, dates, is_date
from stltool.monitoring.logs.dialect import NO_VALUE, TRUTH, Dialect, dialect_of, number_in
from stltool.monitoring.logs.missing import filled
from stltool.monitoring.logs.recording import (
    COPIES,
    NEEDED,
    SHORTER,
    WAYS,
    Asked,
    Recording,
    chosen,
    faults,
    no_value,
    option,
)
from stltool.numbers import NumberError, shown
from stltool.sizes import require_memory

STDIN = "-"
LARGE = 1 << 23  # bytes from which loading the compiled reader pays
_SAMPLE = 1 << 16  # bytes from which the length of a line is estimated
_PART = 1 << 24  # bytes that a thread reads at once, at least
_SPECIAL = 1 << 16  # cells of a part that the kernel may leave to Python


@dataclass(frozen=True)
class Source:
    """The bytes of a file, in memory or mapped into it."""

    where: str
    data: bytes | mmap.mmap

    def text(self) -> IO[str]:
        """From the beginning; bytes that are not UTF-8 become lone surrogates, harmless in columns not requested."""
        raw: Any = io.BytesIO(self.data) if isinstance(self.data, bytes) else io.BufferedReader(_Mapped(self.data))
        return io.TextIOWrapper(raw, encoding="utf-8", errors="surrogateescape", newline="")


class _Mapped(io.RawIOBase):
    """A mapped file as a stream of its own."""

    def __init__(self, data: mmap.mmap) -> None:
        self.data, self.at = data, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        piece = self.data[self.at : self.at + len(buffer)]
        buffer[: len(piece)] = piece
        self.at += len(piece)
        return len(piece)


@contextmanager
def _opened(path: Path) -> Iterator[Source]:
    where = str(path)
    if where == STDIN:
        yield Source("standard input", sys.stdin.buffer.read())
    elif path.suffix.lower() == ".gz":
        with faults(where, "a gzip file", EOFError, zlib.error), gzip.open(path) as packed:
            pieces = []
            while piece := packed.read(_PART):
                pieces.append(piece)
                require_memory(sum(map(len, pieces)), where, SHORTER)
        yield Source(where, b"".join(pieces))
    elif not path.stat().st_size:
        yield Source(where, b"")
    else:
        with path.open("rb") as file:  # the map is closed with the last array that shows it
            yield Source(where, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def read_text(path: Path, asked: Asked) -> Recording:
    with faults(str(path), "CSV"), _opened(path) as source:
        return _Table.of(source, asked).read()


@dataclass(frozen=True)
class _Columns:
    """The columns read: signals first, then that of times, unless it is a signal, too. `labels` have truth values."""

    names: tuple[str, ...]
    places: tuple[int, ...]
    signals: tuple[str, ...]
    labels: frozenset[str]
    time: TimeColumn | None = None
    dated: bool = False  # the times are dates

    def kind(self, name: str) -> str:
        if self.dated and self.time is not None and name == self.time.name:
            return "date"
        return "label" if name in self.labels else "number"


@dataclass
class _Read:
    """Values by column, samples without one, the texts of dates, and whether every row is a line."""

    values: dict[str, NDArray[np.float64]]
    missing: dict[str, NDArray[np.bool_]]
    dates: list[str] | None
    plain: bool


@dataclass(frozen=True)
class _Table:
    source: Source
    asked: Asked
    dialect: Dialect
    columns: _Columns
    clock: str | None

    @classmethod
    def of(cls, source: Source, asked: Asked) -> _Table:
        """What the first lines of a file determine."""
        where = source.where
        with source.text() as file:
            dialect = dialect_of(where, file, asked.decimal, asked.names is None)
        time = time_column(where, dialect.names, asked.time, asked.timed, dialect.units)
        wanted = chosen(where, dialect.names, asked.names, "column")
        first = cls._first_cells(source, dialect, asked)
        place = {name: i for i, name in reversed([*enumerate(dialect.header)])}
        dated = time is not None and is_date(first[place[time.name]])
        if asked.names is None and time is not None and dated:
            wanted.remove(time.name)
        used = time if asked.timed else None
        names = tuple(dict.fromkeys([*wanted, *([used.name] if used is not None else [])]))
        if dated and used is not None and used.name in wanted:
            raise TraceError(f"{where}: column {used.name} has dates, which are no signal")
        dialect.require_single(where, names)
        labels = frozenset(name for name in wanted if first[place[name]].strip().lower() in TRUTH)
        places = tuple(place[name] for name in names)
        columns = _Columns(names, places, tuple(wanted), labels, used, dated and used is not None)
        return cls(source, asked, dialect, columns, f"column {time.name}" if time is not None else None)

    @staticmethod
    def _first_cells(source: Source, dialect: Dialect, asked: Asked) -> list[str]:
        """The first cell with a value of every column."""
        found = [""] * len(dialect.header)
        with source.text() as file:
            for _, row in _rows(source.where, file, dialect):
                for i, cell in enumerate(row[: len(found)]):
                    if found[i].strip().lower() in NO_VALUE:
                        found[i] = cell
                if asked.missing == "error" or not any(cell.strip().lower() in NO_VALUE for cell in found):
                    return found
            else:
                if not any(found):
                    raise TraceError(f"{source.where}: no data below the header; write a row per step")
        return found

    def read(self) -> Recording:
        data = self.source.data
        zero = data.find(b"\0")
        if zero >= 0:
            raise FileError(
                f"{self.source.where}: not a CSV file: it contains binary data (a zero byte at offset {zero})"
            )
        body = data[self.dialect.body : self.dialect.body + _SAMPLE]
        lines = body.count(b"\n") or body.count(b"\r") or 1
        rows = (len(data) - self.dialect.body) * lines / max(len(body), 1)
        width = sum(1 if name in self.columns.labels else 8 for name in self.columns.names)
        require_memory(rows * width * COPIES, f"{self.source.where}, about {rows:.3g} rows,", SHORTER)
        found = read_bytes(self) if len(data) > LARGE else None
        return self._recording(found if found is not None else self._read_cells())

    def _recording(self, read: _Read) -> Recording:
        where, columns = self.source.where, self.columns
        signals: dict[str, NDArray[Any]] = {
            name: read.values[name].astype(np.bool_) if name in columns.labels else read.values[name]
            for name in columns.signals
        }
        first = self.dialect.above + 1 if read.plain else None
        times: NDArray[Any] | None = None
        if columns.time is not None:
            if read.dates is not None:
                times = self._dates(read.dates, first)
            else:
                times = columns.time.seconds(read.values[columns.time.name], where)
        rec = Recording(signals, times, self.clock, read.missing, first)
        return filled(rec, self.asked.missing, where, lambda name, index: f"{rec.place(index[-1])}, column {name}")

    def _dates(self, texts: list[str], first: int | None) -> NDArray[np.datetime64]:
        assert self.columns.time is not None
        try:
            return dates(texts)
        except DateError as error:
            at = f"line {error.index + first}" if first is not None else f"row {error.index + 1}"
            text = texts[error.index]
            told = f"{shown(text)} {error}" if text.strip() else no_time(text)
            raise TraceError(f"{self.source.where}, {at}, column {self.columns.time.name}: {told}") from None

    # ---------------------------------------------------------------------------------------------------- cell by cell

    def _read_cells(self) -> _Read:
        columns = self.columns
        values = {name: array("d") for name in columns.names}
        signals = set(columns.signals)
        kinds = [(name, place, columns.kind(name), name in signals)
                 for name, place in zip(columns.names, columns.places, strict=True)]  # fmt: skip
        texts: list[str] = []
        gaps: dict[str, list[int]] = {}
        row_count, plain, fill = 0, True, self.asked.missing != "error"
        with self.source.text() as file:
            for line, row in _rows(self.source.where, file, self.dialect):
                row = self.dialect.cells(self.source.where, line, row)
                plain = plain and line == self.dialect.above + row_count + 1
                for name, place, kind, signal in kinds:
                    cell = row[place]
                    if kind == "date":
                        texts.append(cell)
                    elif fill and signal and cell.strip().lower() in NO_VALUE:
                        gaps.setdefault(name, []).append(row_count)
                        values[name].append(0.0)
                    else:
                        values[name].append(self._value(line, name, cell))
                row_count += 1
        missing = {}
        for name, rows in gaps.items():
            missing[name] = np.zeros(row_count, np.bool_)
            missing[name][rows] = True
        kept = {name: np.frombuffer(column, np.float64).copy() for name, column in values.items()}
        return _Read(kept, missing, texts if columns.dated else None, plain)

    def _value(self, line: int, name: str, cell: str) -> float:
        label = name in self.columns.labels
        try:
            return _truth(cell) if label else number_in(cell, self.asked.decimal)
        except NumberError as error:
            is_time = self.columns.time is not None and name == self.columns.time.name
            why = _objection(cell, label, is_time, str(error))
            raise TraceError(f"{self.source.where}, line {line}, column {name}: {why}") from None


def _rows(where: str, file: IO[str], dialect: Dialect) -> Iterator[tuple[int, list[str]]]:
    """The rows, each with the line it ends on; empty lines are ignored at the end, and an error elsewhere."""
    for _ in range(dialect.above):
        file.readline()
    reader = csv.reader(file, delimiter=dialect.separator, skipinitialspace=True, strict=True)
    empty = None
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as fault:
            raise TraceError(f"{where}, line {reader.line_num + dialect.above}: {fault}; close every quote") from None
        line = reader.line_num + dialect.above
        if not row or (len(row) == 1 and not row[0].strip()):
            empty = line if empty is None else empty
            continue
        if empty is not None:
            raise empty_line(where, empty)
        yield line, row


def empty_line(where: str, line: int) -> TraceError:
    return TraceError(f"{where}, line {line}: an empty line between rows; remove it, or write a row")


def _truth(text: str) -> float:
    if text.strip().lower() not in TRUTH:
        raise NumberError(f"{shown(text)} is neither true nor false, unlike the cells above")
    return float(TRUTH[text.strip().lower()])


def no_time(text: str) -> str:
    """The fault of a cell that has no time."""
    if not text.strip():
        return "an empty cell; every row needs a time"
    return f"{shown(text)} is not a time; write seconds, or dates such as 2026-03-01T12:00:00.25Z"


def _objection(text: str, label: bool, is_time: bool, why: str) -> str:
    """The fault of a cell, with the remedy; `why` it is not a value of its column."""
    bare = text.strip().lower()
    if is_time:
        return no_time(text)
    if not bare:
        return no_value("an empty cell")
    if not label and bare in TRUTH:
        return f"{shown(text)} is not a number, unlike the cells above; write 1 or 0"
    if "decimal point" in why and "," in text:
        return f"{why}, or read it with {option('decimal', ',')}"
    if bare in NO_VALUE:
        return f"{why}; {NEEDED}: {WAYS}"
    return f"{why}; {NEEDED}" if "finite" in why else why


# ------------------------------------------------------------------------------------------------------ from its bytes


def read_bytes(table: _Table) -> _Read | None:
    """The columns as the kernel reads them; None if a closer look is needed."""
    from stltool.kernels import cells

    columns, data = table.columns, np.frombuffer(table.source.data, np.uint8)
    kinds = np.full(len(table.dialect.header), cells.SKIPPED, np.int8)
    codes = {"number": cells.NUMBER, "label": cells.LABEL, "date": cells.TEXT}
    for name, place in zip(columns.names, columns.places, strict=True):
        kinds[place] = codes[columns.kind(name)]
    start = table.dialect.body
    bounds = _parts(table.source, data, start)
    found = _read_parts(table, data, kinds, bounds)
    if found is None and len(bounds) > 2:  # a quote inside a cell may have misled the division
        found = _read_parts(table, data, kinds, [start, len(data)])
    if found is None:
        return None
    out, parts = found
    by_place = sorted(zip(columns.places, columns.names, strict=True))
    order = [name for _, name in by_place if columns.kind(name) != "date"]
    n, before = sum(part.rows for part in parts), 0
    values = {name: out[k, :n] for k, name in enumerate(order)}
    missing: dict[str, NDArray[np.bool_]] = {}
    for part in parts:
        for k, row, begin, end in part.special.tolist():
            name, cell = order[k], bytes(data[begin:end]).decode("utf-8", "surrogateescape")
            value = _special(table, name, cell)
            if value is None:
                return None
            if np.isnan(value):
                missing.setdefault(name, np.zeros(n, np.bool_))[before + row] = True
                value = 0.0
            values[name][before + row] = value
        before += part.rows
    texts = None
    if columns.dated:
        raw = table.source.data
        texts = [raw[a:b].decode("utf-8", "replace") for part in parts for a, b in part.texts[: part.rows].tolist()]
    return _Read(values, missing, texts, plain=True)


@dataclass(frozen=True)
class _Part:
    rows: int
    texts: NDArray[np.int64]
    special: NDArray[np.int64]


def _parts(source: Source, data: NDArray[np.uint8], start: int) -> list[int]:
    """Where threads begin to read: behind line ends outside quotes."""
    from stltool.kernels import cells

    n = max(1, min(os.cpu_count() or 1, (len(data) - start) // _PART))
    bounds, quotes = [start], 0
    for i in range(1, n):
        at = max(bounds[-1], start + (len(data) - start) * i // n)
        quotes += cells.count(data, bounds[-1], at, ord('"'))
        while True:
            end = source.data.find(b"\n", at) + 1
            if not end:
                return [*bounds, len(data)]
            quotes += cells.count(data, at, end, ord('"'))
            at = end
            if quotes % 2 == 0:
                break
        bounds.append(at)
    return [*bounds, len(data)]


def _read_parts(
    table: _Table, data: NDArray[np.uint8], kinds: NDArray[np.int8], bounds: Sequence[int]
) -> tuple[NDArray[np.float64], list[_Part]] | None:
    """The columns (columns read, rows), and the parts between bounds, each read by a thread; None if one is not as it
    should be.
    """
    from stltool.kernels import cells

    dated = bool((kinds == cells.TEXT).any())
    spans = list(pairwise(bounds))
    separator, point = ord(table.dialect.separator), ord(table.asked.decimal)
    with ThreadPoolExecutor(len(spans)) as threads:
        lines = list(threads.map(lambda span: cells.count(data, span[0], span[1], ord("\n")), spans))
        read = int((kinds == cells.NUMBER).sum() + (kinds == cells.LABEL).sum())
        out = np.empty((read, sum(lines) + 1))  # the last line may have no end

        def part(number: int) -> _Part | None:
            before, most, last = sum(lines[:number]), lines[number], number == len(spans) - 1
            texts = np.empty((most + last if dated else 0, 2), np.int64)
            special = np.empty((_SPECIAL, 4), np.int64)
            how, rows, n = cells.read_rows(
                data, *spans[number], separator, point, kinds, out, before, most + last, texts, special
            )
            return _Part(rows, texts, special[:n]) if how == cells.DONE and (last or rows == most) else None

        parts = list(threads.map(part, range(len(spans))))
    whole = [one for one in parts if one is not None]
    return (out, whole) if len(whole) == len(parts) else None


def _special(table: _Table, name: str, cell: str) -> float | None:
    """The value of a cell that the kernel left; NaN if it is missing, None if the slow reader should report it."""
    if cell.strip().lower() in NO_VALUE:
        return np.nan if name in table.columns.signals and table.asked.missing != "error" else None
    try:
        return _truth(cell) if name in table.columns.labels else number_in(cell, table.asked.decimal)
    except NumberError:
        return None
