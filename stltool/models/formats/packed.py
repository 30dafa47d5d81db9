"""Compressed files, measured before they are unpacked: gzip, and xz.

What a compressed file unpacks to cannot be told from its size or its header. So unpacking first counts, and keeps only
what is small; a file that would take more than the memory there is, is refused as soon as that is known.
"""

from __future__ import annotations

import gzip
import io
import lzma
import mmap
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

from stltool.errors import FileError, SizeError
from stltool.sizes import bytes_text, memory_limit

Data: TypeAlias = "bytes | bytearray | mmap.mmap"

GZIP, XZ = b"\x1f\x8b\x08", b"\xfd7zXZ\0"
_PIECE = 1 << 18  # bytes unpacked at a time
_SMALL = 1 << 28  # bytes that are kept while they are counted, if the memory is large enough
_SHARE = 8  # of the memory that may be used: what is kept while it is counted
_DICTIONARY = 1 << 28  # bytes that xz may take for its dictionary, four times those of `xz -9`


def mapped(path: Path, what: str) -> Data:
    """The bytes of a file, mapped into memory; FileError if there is none or it is empty."""
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such {what}") from None
    except ValueError:
        raise FileError(f"{path}: not a {what}: it is empty") from None
    except OSError as error:
        raise FileError(f"{path}: this {what} cannot be read: {error.strerror}") from None


def unpacked(data: Data, path: Path, what: str, factor: float = 1.0) -> Data:
    """The content of a gzip or xz file; other bytes unchanged.

    factor  bytes that a byte of it takes when it is read
    Raises SizeError before more memory is taken than there is, FileError if the file is damaged.
    """
    head = data[: len(XZ)]
    pieces = _gzip if head.startswith(GZIP) else _xz if head == XZ else None
    if pieces is None:
        return data
    allowed = memory_limit() / factor
    small = min(_SMALL, allowed / _SHARE)
    kept, total = bytearray(), 0
    try:
        for piece in pieces(data):
            total += len(piece)
            if total <= small:
                kept += piece
            elif total > allowed:
                raise SizeError(
                    f"{path}: this {what} of {bytes_text(len(data))} unpacks to more than {bytes_text(allowed)}, the "
                    "most that can be read in the memory that may be used; use a part of the model"
                )
        if total <= small:
            return kept
        whole, at = bytearray(total), 0
        for piece in pieces(data):
            whole[at : at + len(piece)] = piece
            at += len(piece)
        return whole
    except (EOFError, OSError, zlib.error, lzma.LZMAError) as error:
        fault = "it ends too early" if isinstance(error, EOFError) else str(error)
        raise FileError(f"{path}: this {what} is compressed and cannot be unpacked: {fault}") from None


class _Stream(io.RawIOBase):
    """Bytes in memory, or mapped into it, as a stream; they are not copied."""

    def __init__(self, data: Data) -> None:
        self._data, self._at = data, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: len(self._data)}[whence]
        self._at = max(base + offset, 0)
        return self._at

    def readinto(self, buffer: Any) -> int:
        piece = self._data[self._at : self._at + len(buffer)]
        buffer[: len(piece)] = piece
        self._at += len(piece)
        return len(piece)


def stream(data: Data) -> io.BufferedReader:
    return io.BufferedReader(_Stream(data))


def _gzip(data: Data) -> Iterator[bytes]:
    with gzip.GzipFile(fileobj=stream(data)) as file:
        while piece := file.read(_PIECE):
            yield piece


def _xz(data: Data) -> Iterator[bytes]:
    at = 0
    while at < len(data):  # streams follow each other, with zeros between them
        stream = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_DICTIONARY)
        while not stream.eof:
            given = data[at : at + _PIECE] if stream.needs_input else b""
            if stream.needs_input and not given:
                raise EOFError
            at += len(given)
            yield stream.decompress(given, _PIECE)
        at -= len(stream.unused_data)
        while data[at : at + 4] == bytes(4):
            at += 4
