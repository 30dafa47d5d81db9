"""Policies too large for memory: a file of layers, written from the last step back and read through a memory map.

    line 1       the header, JSON, padded with spaces so that the next byte is at a multiple of 8
    a layer      keys int64, bits uint64, choice uint8/16/32, each little-endian and padded to a multiple of 8
    the index    JSON: [first, last, offset, words, choices] for each layer, in the order written
    16 bytes     the position of the index (uint64, little-endian), and "STLTOOL2"

Layers are those of stltool/choices.py. A reader checks each one before use.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stltool.choices import Listed
from stltool.errors import FileError, PolicyError

_END = b"STLTOOL2"
_TYPES = {"uint8": np.uint8, "uint16": np.uint16, "uint32": np.uint32}
_LONGEST_HEADER = 2**20


class LayeredWriter:
    """Writes a file layer by layer; `index` lists its layers. With an `index`, continues a file that may have more."""

    def __init__(self, file: IO[bytes], header: dict[str, Any], index: list[tuple[int, ...]] | None = None) -> None:
        line, begin = _first_line(header)
        self.index: list[tuple[int, ...]] = index or []
        self._file, self._choice = file, np.dtype(header["choice"])
        if index is None:
            file.write(line)
            return
        end = begin
        if index:
            _, _, offset, words, choices = index[-1]
            end = offset + 16 * words + _padded(choices * self._choice.itemsize)
        file.truncate(end)
        file.seek(end)

    def add(self, listed: Listed) -> None:
        offset = self._file.tell()
        choice = np.ascontiguousarray(listed.choice, dtype=self._choice)
        for array in (listed.keys, listed.bits):
            self._file.write(np.ascontiguousarray(array).data)
        self._file.write(choice.data)
        self._file.write(b"\0" * (_padded(choice.nbytes) - choice.nbytes))
        self.index.append((listed.first, listed.last, offset, len(listed.keys), len(choice)))

    def finish(self) -> None:
        """Write the index; nothing can be added afterwards."""
        offset = self._file.tell()
        self._file.write(json.dumps(self.index).encode() + offset.to_bytes(8, "little") + _END)


def _first_line(header: dict[str, Any]) -> tuple[bytes, int]:
    """The first line, and the position after it."""
    line = json.dumps(header).encode()
    begin = _padded(len(line) + 1)
    return line.ljust(begin - 1) + b"\n", begin


def require_index(path: Path, header: dict[str, Any], index: list[tuple[int, ...]]) -> None:
    """ValueError unless an unfinished file begins with this header and has these layers."""
    line, end = _first_line(header)
    size = np.dtype(header["choice"]).itemsize
    with path.open("rb") as file:
        if file.read(len(line)) != line:
            raise ValueError
    before = None
    for first, last, offset, words, choices in index:
        if offset != end or words < 0 or choices < 0 or first > last or before not in (None, last + 1):
            raise ValueError
        end, before = offset + 16 * words + _padded(choices * size), first
    if path.stat().st_size < end:
        raise ValueError


def is_layered(path: str | Path) -> bool:
    """Whether a file ends as a layered policy file does."""
    try:
        with Path(path).open("rb") as file:
            file.seek(-len(_END), os.SEEK_END)
            return file.read() == _END
    except OSError:
        return False


def read_header(path: str | Path) -> dict[str, Any]:
    """The first line; PolicyError if it is not a header."""
    try:
        with Path(path).open("rb") as file:
            header = json.loads(file.readline(_LONGEST_HEADER))
        if not isinstance(header, dict) or header.get("choice") not in _TYPES:
            raise ValueError
    except (OSError, ValueError, RecursionError):
        raise PolicyError(f"{path}: not a layered policy file of this version; write one with --save-policy") from None
    return header


def read_layers(path: str | Path) -> tuple[dict[str, Any], list[Listed]]:
    """The header and the layers in ascending order of steps, as views of the file.

    Raises PolicyError if the index does not fit the file; the contents of layers are not checked.
    """
    header = read_header(path)
    kind = _TYPES[header["choice"]]
    try:
        data: NDArray[np.uint8] = np.memmap(path, dtype=np.uint8, mode="r")
        start = int.from_bytes(data[-16:-8].tobytes(), "little")
        if data[-8:].tobytes() != _END or not 0 < start <= len(data) - 16:
            raise ValueError
        index = json.loads(data[start:-16].tobytes())
        layers = [_layer(data[:start], kind, *row) for row in sorted(index)]
    except OSError as error:
        raise FileError(f"{path}: this policy file cannot be read: {error.strerror or error}") from None
    except (ValueError, TypeError, RecursionError):
        raise PolicyError(
            f"{path}: a damaged policy file: its index does not match its contents; write it again"
        ) from None
    return header, layers


def _layer(data: NDArray[np.uint8], kind: Any, first: int, last: int, offset: int, words: int, choices: int) -> Listed:
    size = np.dtype(kind).itemsize
    if any(type(n) is not int or not 0 <= n < 2**63 for n in (first, last, offset, words, choices)) or offset % 8:
        raise ValueError
    middle, end = offset + 8 * words, offset + 16 * words
    if end + choices * size > len(data):
        raise ValueError
    keys, bits = data[offset:middle].view(np.int64), data[middle:end].view(np.uint64)
    return Listed(first, last, keys, bits, data[end : end + choices * size].view(kind))


def _padded(n: int) -> int:
    return -(-n // 8) * 8
