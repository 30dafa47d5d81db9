"""Traces in NumPy's .npz: an array per signal, (n_steps,) or (n_traces, n_steps)."""

from __future__ import annotations

import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import FileError, TraceError
from stltool.monitoring.logs.clock import time_column
from stltool.monitoring.logs.missing import filled
from stltool.monitoring.logs.recording import SHORTER, Asked, Recording, chosen, faults
from stltool.sizes import require_memory

# what damage to an archive, to what is packed in it, and to the headers of arrays, which are texts of Python, raises
_BROKEN = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, RuntimeError, ValueError, TypeError,
    LookupError, SyntaxError, tokenize.TokenError,
)  # fmt: skip


def read_npz(path: Path, asked: Asked) -> Recording:
    where = str(path)
    if not zipfile.is_zipfile(path):
        raise FileError(f"{path}: not an .npz file; write one with numpy.savez")
    with (
        faults(where, "an .npz file", *_BROKEN),
        path.open("rb") as archive,  # which numpy would leave open if the archive is damaged
        np.load(archive, allow_pickle=False) as file,
    ):
        heads = {name: _npy_header(file.zip, name) for name in file.files}
        column = time_column(where, file.files, asked.time, asked.timed)
        wanted = chosen(where, file.files, asked.names, "array")
        if asked.names is None and column is not None and heads[column.name][1].kind in "mM":
            wanted.remove(column.name)
        _require_signals(where, wanted, heads)
        extra = [column.name] if column is not None and asked.timed and column.name not in wanted else []
        require_memory(
            sum(math.prod(heads[name][0]) * heads[name][1].itemsize for name in [*wanted, *extra]), where, SHORTER
        )
        signals = {name: file[name] for name in wanted}
        times = None
        if column is not None and asked.timed:
            shapes = {heads[name][0] for name in wanted} or {heads[column.name][0]}
            times = column.seconds(_times(where, column.name, file[column.name], shapes), where)
    clock = f"column {column.name}" if column is not None else None

    def at(name: str, index: tuple[int, ...]) -> str:
        *trace, step = index
        return f"array {name}, " + (f"trace {trace[0]}, step {step}" if trace else f"step {step}")

    return filled(Recording(signals, times, clock), asked.missing, str(path), at)


def _require_signals(where: str, wanted: list[str], heads: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]) -> None:
    for name in wanted:
        shape, dtype = heads[name]
        at = f"{where}, array {name}"
        if dtype.kind not in "biuf":
            kind = "Python objects, which are never loaded" if dtype.kind == "O" else f"{dtype}"
            raise TraceError(f"{at}: it contains {kind}; save numbers or Booleans")
        if len(shape) not in (1, 2):
            raise TraceError(f"{at}: its shape is {shape}; (n_steps,) or (n_traces, n_steps) is needed")
        if 0 in shape:
            raise TraceError(f"{at}: its shape is {shape}; it contains no sample")
        if shape != heads[wanted[0]][0]:
            raise TraceError(
                f"{at}: its shape is {shape}, that of {wanted[0]} is {heads[wanted[0]][0]}; "
                "give all signals of a trace the same shape"
            )


def _times(where: str, name: str, times: NDArray[Any], shapes: set[tuple[int, ...]]) -> NDArray[Any]:
    """The times of the rows: one for each, or for each of every trace."""
    at = f"{where}, array {name}"
    if times.dtype.kind not in "iufmM":
        raise TraceError(f"{at}: it contains {times.dtype}; times are numbers, datetime64 or timedelta64")
    for shape in shapes:
        if times.shape not in (shape, shape[-1:]):
            raise TraceError(
                f"{at}: its shape is {times.shape}, that of the signals is {shape}; a time per step is needed"
            )
    none = ~np.isfinite(times)
    if none.any():
        index = tuple(int(i) for i in np.argwhere(none)[0])
        raise TraceError(f"{at}, step {index[-1]}: {times[index]} is not a time; every step needs one")
    return times


def _npy_header(archive: zipfile.ZipFile, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, without reading it."""
    members = archive.namelist()
    with archive.open(name if name in members else f"{name}.npy") as member:
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
    return shape, dtype
