"""A trace file → signals: CSV, NumPy's .npz, Parquet, by the file extension.

    load_trace("log.csv")  →  {"x": float64 (n_steps,), "door": bool (n_steps,), …}

CSV has two readers. The fast one, `numpy.loadtxt`, is used only for files in which every line break ends a row and
every separator ends a cell, and only if it reports no error. All others go to the slow reader, which accepts the same
files and reports the line, the column and the text of a fault.
"""

from __future__ import annotations

import csv
import math
import mmap
import zipfile
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import path as path_of
from stltool.arguments import texts
from stltool.errors import FileError, NameLookupError, TraceError
from stltool.extras import require
from stltool.logic.names import near_names
from stltool.numbers import NumberError, double, shown
from stltool.sizes import require_memory

Signals: TypeAlias = dict[str, NDArray[Any]]

_SEPARATORS = {",": "a comma", ";": "a semicolon", "\t": "a tab"}
_TRUTH = {"true": True, "false": False}
_LONGEST_LINE = 1 << 20  # characters of a header; anything longer is not a header
_SAMPLE = 1 << 16  # bytes from which the length of a line is estimated
_LABEL_WIDTH = 8  # bytes that the fast reader keeps of a label's cell
_PIECE = 1 << 18  # decimals whose texts are in memory at once
_COPIES = 2.5  # of the table in memory, at most, while it is read
_NEEDED = "every step needs a number"
_REMEDY = "give a shorter part of the trace, or name fewer signals"


def load_trace(path: str | Path, names: Iterable[str] | None = None) -> Signals:
    """The signals of a trace file: name → array (n_steps,) of numbers or Booleans; of an .npz also (n_traces, n_steps).

    The extension determines the format: `.csv` or `.tsv` (a line of names, then a row per step; cells are numbers,
    which become doubles, or true and false), `.npz` (an array per signal) or `.parquet` (a column per signal; needs
    pyarrow). With `names`, only those signals are read, and other columns need not be numbers. Raises FileError if the
    file does not have the format of its extension, TraceError, with the position, if its content is not a trace,
    NameLookupError if a name is missing, and SizeError before allocating more memory than there is.
    """
    path = path_of(path, "load_trace's path")
    wanted = None if names is None else list(dict.fromkeys(texts(names, "load_trace's names")))
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise FileError(f"{path}: not a trace file; traces are read from {', '.join(_READERS)} files")
    if not path.exists():
        raise FileError(f"{path}: there is no such trace file")
    if not path.is_file():
        raise FileError(f"{path}: this trace file cannot be read: it is not a regular file")
    return reader(path, wanted)


def _chosen(path: Path, known: Sequence[str], names: Sequence[str] | None, what: str) -> list[str]:
    """The names to read: all names in the file, or those requested."""
    there = set(known)
    for name in names or ():
        if name not in there:
            raise NameLookupError(f"{path}: there is no {what} {name}; {near_names(name, known)}")
    return list(known if names is None else names)


@contextmanager
def _faults(path: Path, what: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of the system and of a format's library into a FileError."""
    caught: tuple[type[Exception], ...] = (OSError, *kinds)
    try:
        yield
    except caught as fault:
        told = fault.strerror if isinstance(fault, OSError) and fault.strerror else str(fault).partition("\n")[0]
        raise FileError(f"{path}: cannot be read as {what}: {told or type(fault).__name__}") from None


# ------------------------------------------------------------------------------------------------------------- CSV


@dataclass(frozen=True)
class _Table:
    """What the first two lines of a CSV file determine."""

    path: Path
    separator: str
    header: list[str]
    body: int  # where the data begin, in bytes after the byte order mark, if any
    labels: frozenset[str]  # the columns whose first cell is true or false


def _read_csv(path: Path, names: list[str] | None) -> Signals:
    with _faults(path, "CSV"):
        table = _csv_table(path)
        wanted = _chosen(path, table.header, names, "column")
        if _is_plain(table, wanted):
            signals = _read_fast(table, wanted)
            if signals is not None:
                return signals
        return _read_slowly(table, wanted)


def _csv_table(path: Path) -> _Table:
    with _opened(path) as file:
        line = file.readline(_LONGEST_LINE).removeprefix("\ufeff")
        if "\0" in line:
            raise FileError(f"{path}: not a CSV file: it contains binary data (a zero byte in line 1)")
        bad = next((ord(c) & 0xFF for c in line if "\udc80" <= c <= "\udcff"), None)
        if bad is not None:
            raise FileError(f"{path}: not a CSV file: byte {bad:#04x} in line 1 is not UTF-8 text; save it as UTF-8")
        if len(line) == _LONGEST_LINE:
            raise FileError(f"{path}: not a CSV file: line 1 has over a million characters; it should name the signals")
        if not line.strip():
            what = "line 1 is empty" if line else "the file is empty"
            raise TraceError(f"{path}: {what}; write the names of the signals there, such as t,x,door")
        separator, header = _csv_header(path, line)
        first = next((row for _, row in _rows(path, file, separator, 1)), None)
    if first is None:
        raise TraceError(f"{path}: no data below the header; write a row per step")
    labels = frozenset(name for name, cell in zip(header, first, strict=False) if cell.strip().lower() in _TRUTH)
    return _Table(path, separator, header, len(line.encode()), labels)


def _csv_header(path: Path, line: str) -> tuple[str, list[str]]:
    """The separator and the names in the first line."""
    where = f"{path}, line 1"
    pieces = line.split('"')
    if len(pieces) % 2 == 0:
        raise TraceError(f"{where}: a quote is not closed; close it on the same line")
    outside = "".join(pieces[::2])
    separators = [separator for separator in _SEPARATORS if separator in outside.strip("\r\n")]
    if len(separators) > 1:
        found = " and ".join(_SEPARATORS[separator] for separator in separators)
        raise TraceError(
            f"{where}: {found} could both separate the names; use one, and quote names that contain the other"
        )
    separator = separators[0] if separators else ","
    header = [name.strip() for name in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    seen: set[str] = set()
    for number, name in enumerate(header, start=1):
        if not name:
            raise TraceError(f"{where}: column {number} has no name; every column needs one")
        if name in seen:
            raise TraceError(f"{where}: two columns are named {name}; every column needs a name of its own")
        if _is_value(name):
            raise TraceError(f"{where}: expected a name, found {name}; put a line with the names of the columns first")
        seen.add(name)
    return separator, header


def _is_plain(table: _Table, wanted: Sequence[str]) -> bool:
    """Whether lines are rows: no quotes, and no empty lines except at the end. SizeError if the table would not fit."""
    with table.path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        zero = data.find(b"\0")
        if zero >= 0:
            raise FileError(f"{table.path}: not a CSV file: it contains binary data (a zero byte at offset {zero})")
        start = table.body + 3 * data[:3].startswith(b"\xef\xbb\xbf")
        sample = data[start : start + _SAMPLE]
        rows = (len(data) - start) * (sample.count(b"\n") or sample.count(b"\r") or 1) / len(sample)
        width = np.dtype(_cell_types(table, wanted)).itemsize
        require_memory(rows * width * _COPIES, f"{table.path}, about {rows:.3g} rows,", _REMEDY)
        if data.find(b'"', start) >= 0:
            return False
        gaps = [place for place in (data.find(gap, start) for gap in (b"\n\n", b"\n\r", b"\r\r")) if place >= 0]
        return not gaps or not data[min(gaps) :].strip()


def _cell_types(table: _Table, wanted: Sequence[str]) -> list[tuple[str, str]]:
    """The type in which the fast reader reads each column; a single byte for columns not requested."""
    asked = set(wanted)
    return [
        (f"{i}", "S1" if name not in asked else f"S{_LABEL_WIDTH}" if name in table.labels else "f8")
        for i, name in enumerate(table.header)
    ]


def _read_fast(table: _Table, wanted: Sequence[str]) -> Signals | None:
    """The columns read by numpy.loadtxt; None if an error, or the text of a label, needs a closer look."""
    try:
        cells = np.loadtxt(
            table.path, dtype=_cell_types(table, wanted), delimiter=table.separator, skiprows=1, comments=None,
            encoding="utf-8", ndmin=1,
        )  # fmt: skip
    except ValueError:
        return None
    signals: Signals = {}
    places = {name: i for i, name in enumerate(table.header)}
    for name in wanted:
        column = cells[str(places[name])]
        if name in table.labels:
            texts, which = np.unique(column, return_inverse=True)
            if any(len(text) == _LABEL_WIDTH for text in texts.tolist()):
                return None  # the cell may have been longer than what was kept
            truths = [_TRUTH.get(text.decode("latin-1").strip().lower()) for text in texts.tolist()]
            if None in truths:
                return None
            signals[name] = np.array(truths, dtype=np.bool_)[which]
        else:
            signals[name] = np.ascontiguousarray(column)
            if not np.isfinite(signals[name]).all():
                return None
    return signals


def _read_slowly(table: _Table, wanted: Sequence[str]) -> Signals:
    """The columns read cell by cell; faults are reported with line and column."""
    asked = set(wanted)
    places = [(i, name, name in table.labels) for i, name in enumerate(table.header) if name in asked]
    columns: dict[str, array[Any]] = {name: array("b" if name in table.labels else "d") for name in wanted}
    with _opened(table.path) as file:
        file.readline()
        for line, row in _rows(table.path, file, table.separator, 1):
            if len(row) != len(table.header):
                raise TraceError(
                    f"{table.path}, line {line}: {_count(len(row), 'cell')} where the header names "
                    f"{_count(len(table.header), 'column')}"
                )
            for i, name, label in places:
                try:
                    columns[name].append(_truth(row[i]) if label else double(row[i]))
                except NumberError as error:
                    why = _objection(row[i], label, str(error))
                    raise TraceError(f"{table.path}, line {line}, column {name}: {why}") from None
    return {
        name: np.frombuffer(column, np.bool_ if name in table.labels else np.float64).copy()
        for name, column in columns.items()
    }


def _rows(path: Path, file: IO[str], separator: str, before: int) -> Iterator[tuple[int, list[str]]]:
    """The rows, each with the line it ends on; empty lines are ignored at the end, and an error elsewhere."""
    reader = csv.reader(file, delimiter=separator, skipinitialspace=True, strict=True)
    empty = None
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as fault:
            raise TraceError(f"{path}, line {reader.line_num + before}: {fault}; close every quote") from None
        line = reader.line_num + before
        if not row or (len(row) == 1 and not row[0].strip()):
            empty = line if empty is None else empty
            continue
        if empty is not None:
            raise TraceError(f"{path}, line {empty}: an empty line between rows; remove it, or write a row")
        yield line, row


def _opened(path: Path) -> IO[str]:
    """The text; bytes that are not UTF-8 become lone surrogates, which are harmless in columns not requested."""
    return path.open(encoding="utf-8", errors="surrogateescape", newline="")


def _truth(text: str) -> bool:
    if text.strip().lower() not in _TRUTH:
        raise NumberError(f"{shown(text)} is neither true nor false, unlike the cells above")
    return _TRUTH[text.strip().lower()]


def _is_value(text: str) -> bool:
    for read in (_truth, double):
        try:
            read(text)
        except NumberError:
            continue
        return True
    return text.lower() in ("nan", "inf")


def _objection(text: str, label: bool, why: str) -> str:
    """The fault of a cell, with the remedy; `why` it is not a value of its column."""
    if not text.strip():
        return "an empty cell; every step needs a value"
    if not label and text.strip().lower() in _TRUTH:
        return f"{shown(text)} is not a number, unlike the cells above; write 1 or 0"
    return f"{why}; {_NEEDED}" if "finite" in why else why


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s'[: n != 1]}"


# ------------------------------------------------------------------------------------------------------- npz, Parquet


def _read_npz(path: Path, names: list[str] | None) -> Signals:
    if not zipfile.is_zipfile(path):
        raise FileError(f"{path}: not an .npz file; write one with numpy.savez")
    broken = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, RuntimeError)
    with _faults(path, "an .npz file", *broken), np.load(path, allow_pickle=False) as file:
        wanted = _chosen(path, file.files, names, "array")
        shapes: dict[str, tuple[int, ...]] = {}
        taken = 0
        for name in wanted:
            shapes[name], dtype = _npy_header(file.zip, name)
            where = f"{path}, array {name}"
            if dtype.kind not in "biuf":
                kind = "Python objects, which are never loaded" if dtype.kind == "O" else f"{dtype}"
                raise TraceError(f"{where}: it contains {kind}; save numbers or Booleans")
            if len(shapes[name]) not in (1, 2):
                raise TraceError(f"{where}: its shape is {shapes[name]}; (n_steps,) or (n_traces, n_steps) is needed")
            if 0 in shapes[name]:
                raise TraceError(f"{where}: its shape is {shapes[name]}; it contains no sample")
            if shapes[name] != shapes[wanted[0]]:
                raise TraceError(
                    f"{where}: its shape is {shapes[name]}, that of {wanted[0]} is {shapes[wanted[0]]}; "
                    "give all signals of a trace the same shape"
                )
            taken += math.prod(shapes[name]) * dtype.itemsize
        require_memory(taken, f"{path}", _REMEDY)
        signals = {name: file[name] for name in wanted}
    for name, values in signals.items():
        if values.dtype.kind == "f" and not (finite := np.isfinite(values)).all():
            *trace, step = (int(i) for i in np.argwhere(~finite)[0])
            at = f"trace {trace[0]}, step {step}" if trace else f"step {step}"
            raise TraceError(f"{path}, array {name}, {at}: {values[(*trace, step)]} is not a finite number; {_NEEDED}")
    return signals


def _npy_header(archive: zipfile.ZipFile, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, without reading it."""
    members = archive.namelist()
    with archive.open(name if name in members else f"{name}.npy") as member:
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
    return shape, dtype


def _read_parquet(path: Path, names: list[str] | None) -> Signals:
    pa = require("pyarrow", f"{path}: Parquet", "write the trace as .csv or .npz")
    from pyarrow import parquet

    with _faults(path, "a Parquet file", pa.ArrowException), parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        for name, count in zip(*np.unique(schema.names, return_counts=True), strict=True):
            if count > 1:
                raise TraceError(f"{path}: two columns are named {name}; every column needs a name of its own")
        wanted = _chosen(path, schema.names, names, "column")
        if not rows:
            raise TraceError(f"{path}: it contains no rows; write a row per step")
        for name in wanted:
            kind = schema.field(name).type
            if not (pa.types.is_boolean(kind) or _is_numeric(pa, kind)):
                raise TraceError(f"{path}, column {name}: it contains {kind}; write numbers or Booleans")
        require_memory(rows * 8 * len(wanted) * _COPIES, f"{path}, {rows} rows,", _REMEDY)
        return {name: _arrow_column(path, name, file.read(columns=[name]).column(name), pa) for name in wanted}


def _is_numeric(pa: Any, kind: Any) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _arrow_column(path: Path, name: str, column: Any, pa: Any) -> NDArray[Any]:
    if column.null_count:
        row = column.is_null().to_numpy().argmax()
        raise TraceError(f"{path}, row {row + 1}, column {name}: no value; every step needs one")
    values: NDArray[Any] = _of_decimals(column, pa) if pa.types.is_decimal(column.type) else column.to_numpy()
    if values.dtype.kind == "f" and not (finite := np.isfinite(values)).all():
        row = int(np.flatnonzero(~finite)[0])
        raise TraceError(f"{path}, row {row + 1}, column {name}: {values[row]} is not a finite number; {_NEEDED}")
    return values


def _of_decimals(column: Any, pa: Any) -> NDArray[np.float64]:
    """The double nearest to each decimal. Arrow's own cast multiplies by a power of ten, and for one decimal in ten
    is wrong in the last place (3694.20 becomes 3694.2000000000003); decimals as text are read correctly.
    """
    values = np.empty(len(column))
    for start in range(0, len(column), _PIECE):
        part = column.slice(start, _PIECE).cast(pa.string()).cast(pa.float64())
        values[start : start + _PIECE] = part.to_numpy()
    return values


_READERS: dict[str, Callable[[Path, list[str] | None], Signals]] = {
    ".csv": _read_csv, ".tsv": _read_csv, ".npz": _read_npz, ".parquet": _read_parquet,
}  # fmt: skip
