"""The container of a UMB file: a tar archive, possibly compressed with gzip or xz, of small named files.

An archive that is not compressed is mapped into memory: its files are read in place. Names and sizes are checked
against the archive's own length before anything is read.
"""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping
from pathlib import Path

from stltool.errors import FileError, ModelError
from stltool.models.formats.packed import Data, mapped, stream, unpacked

_MOST_FILES = 100_000
_MAGIC, _MAGIC_AT = b"ustar", 257
_FACTOR = 3.0  # bytes that a byte of an archive takes: itself, and the model's arrays


class Archive:
    """The files of an archive, by name."""

    def __init__(self, path: Path, what: str) -> None:
        self.path = path
        self._data = unpacked(mapped(path, what), path, what, _FACTOR)
        self._where = _members(self._data, path, what)

    def __contains__(self, name: str) -> bool:
        return name in self._where

    def size(self, name: str) -> int:
        """The size of a file in bytes."""
        return self._where[name][1]

    def view(self, name: str) -> memoryview:
        """The bytes of a file, in place; ModelError if it is missing."""
        if name not in self._where:
            raise self.fault(name, "is missing; write the file again")
        start, size = self._where[name]
        return memoryview(self._data)[start : start + size]

    def fault(self, name: str, fault: str) -> ModelError:
        return ModelError(f"{self.path}: {name} {fault}")


def _members(data: Data, path: Path, what: str) -> dict[str, tuple[int, int]]:
    """Where each file begins, and its size."""
    found: dict[str, tuple[int, int]] = {}
    # sparse files, and headers that claim to be longer than the archive, are refused by what tarfile makes of them
    try:
        with tarfile.open(fileobj=stream(data), mode="r:") as tar:
            for number, member in enumerate(tar):
                name = member.name.removeprefix("./")
                if member.isdir():
                    continue
                if number >= _MOST_FILES:
                    raise FileError(f"{path}: not a {what}: it contains more than {_MOST_FILES} files")
                if not member.isreg() or member.issparse():
                    raise FileError(f"{path}: not a {what}: {name!r} in it is not a regular file")
                if member.size < 0 or member.offset_data + member.size > len(data):
                    raise FileError(f"{path}: {name!r} in it is cut off; was the file copied completely?")
                if name in found:
                    raise FileError(f"{path}: not a {what}: it contains {name!r} twice")
                found[name] = member.offset_data, member.size
    except (tarfile.TarError, ValueError, OverflowError, EOFError, OSError, IndexError, KeyError) as error:
        raise FileError(f"{path}: not a {what}: it is not a tar archive, or a damaged one ({error})") from None
    return found


def archived(files: Mapping[str, bytes]) -> bytes:
    """A tar archive of these files, in order; always the same bytes for the same files."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size, entry.mode = len(content), 0o644
            tar.addfile(entry, io.BytesIO(content))
    return out.getvalue()


def only_file(data: Data, path: Path, what: str) -> Data:
    """The content of a tar archive of one file; other bytes unchanged."""
    if data[_MAGIC_AT : _MAGIC_AT + len(_MAGIC)] != _MAGIC:
        return data
    where = list(_members(data, path, what).values())
    if len(where) != 1:
        raise FileError(f"{path}: not a {what}: it is an archive of {len(where)} files")
    start, size = where[0]
    return data[start : start + size]
