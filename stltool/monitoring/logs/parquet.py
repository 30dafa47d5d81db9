"""Traces in Parquet files: a column per signal; needs pyarrow."""

from __future__ import annotations

from collections import Counter
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import TraceError
from stltool.extras import require
from stltool.monitoring.logs.clock import TimeColumn, time_column
from stltool.monitoring.logs.dates import DateError, dates
from stltool.monitoring.logs.missing import filled
from stltool.monitoring.logs.recording import COPIES, SHORTER, Asked, Recording, Signals, chosen, faults
from stltool.sizes import require_memory

_PIECE = 1 << 18  # decimals whose texts are in memory at once


def read_parquet(path: Path, asked: Asked) -> Recording:
    pa = require("pyarrow", f"{path}: Parquet", "write the trace as .csv or .npz")
    from pyarrow import parquet

    where = str(path)
    with faults(where, "a Parquet file", pa.ArrowException, UnicodeDecodeError), parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        column = time_column(where, schema.names, asked.time, asked.timed)
        wanted = chosen(where, schema.names, asked.names, "column")
        if asked.names is None and column is not None and _is_time(pa, schema.field(column.name).type):
            wanted.remove(column.name)
        read = [*wanted, *([column.name] if column is not None and asked.timed and column.name not in wanted else [])]
        for name, count in Counter(schema.names).items():
            if count > 1 and name in read:
                raise TraceError(f"{path}: two columns are named {name}; every column needs a name of its own")
        if not rows:
            raise TraceError(f"{path}: it contains no rows; write a row per step")
        for name in wanted:
            kind = schema.field(name).type
            if not (pa.types.is_boolean(kind) or _is_numeric(pa, kind)):
                raise TraceError(f"{path}, column {name}: it contains {kind}; write numbers or Booleans")
        require_memory(rows * 8 * len(read) * COPIES, f"{path}, {rows} rows,", SHORTER)
        signals: Signals = {}
        missing = {}
        for name in wanted:
            signals[name], none = _arrow_column(file.read(columns=[name]).column(name), pa)
            if none is not None:
                missing[name] = none
        times = None
        if column is not None and asked.timed:
            times = _arrow_times(where, column, file.read(columns=[column.name]).column(column.name), pa)
    clock = f"column {column.name}" if column is not None else None

    def at(name: str, index: tuple[int, ...]) -> str:
        return f"row {index[-1] + 1}, column {name}"

    return filled(Recording(signals, times, clock, missing), asked.missing, str(path), at)


def _is_numeric(pa: Any, kind: Any) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _is_time(pa: Any, kind: Any) -> bool:
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_date(kind))


def _arrow_column(column: Any, pa: Any) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """The values, and where there are none."""
    none = None
    if column.null_count:
        none = column.is_null().to_numpy()
        zero = Decimal(0) if pa.types.is_decimal(column.type) else False if pa.types.is_boolean(column.type) else 0
        column = column.fill_null(pa.scalar(zero, column.type))
    return (_of_decimals(column, pa) if pa.types.is_decimal(column.type) else column.to_numpy()), none


def _arrow_times(where: str, time: TimeColumn, column: Any, pa: Any) -> NDArray[Any]:
    at = f"{where}, column {time.name}"
    if column.null_count:
        row = int(column.is_null().to_numpy().argmax())
        raise TraceError(f"{where}, row {row + 1}, column {time.name}: no time; every row needs one")
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        try:
            return dates(column.to_pylist())
        except DateError as error:
            text = column[error.index].as_py()
            raise TraceError(f"{where}, row {error.index + 1}, column {time.name}: {text!r} {error}") from None
    if _is_time(pa, column.type):
        return np.asarray(column.to_numpy())
    if not _is_numeric(pa, column.type):
        raise TraceError(f"{at}: it contains {column.type}; times are timestamps, dates or numbers")
    values, _ = _arrow_column(column, pa)
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values))[0])
        raise TraceError(
            f"{where}, row {row + 1}, column {time.name}: {values[row]} is not a time; every row needs one"
        )
    return time.seconds(values, where)


def _of_decimals(column: Any, pa: Any) -> NDArray[np.float64]:
    """The double nearest to each decimal. Arrow's own cast multiplies by a power of ten, and for one decimal in ten
    is wrong in the last place (3694.20 becomes 3694.2000000000003); decimals as text are read correctly.
    """
    values = np.empty(len(column))
    for start in range(0, len(column), _PIECE):
        part = column.slice(start, _PIECE).cast(pa.string()).cast(pa.float64())
        values[start : start + _PIECE] = part.to_numpy()
    return values
