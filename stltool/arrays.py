"""Arrays that cannot be written to; and arrays from untrusted .npz files, where every member is measured before it is
unpacked, and nothing is unpickled."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.errors import FileError, StlToolError

_Entry = TypeVar("_Entry", bound=np.generic)


def read_only(array: NDArray[_Entry]) -> NDArray[_Entry]:
    """A view that cannot be written to.

    Kernels are compiled for such arrays and for others separately; what they read should always be of one kind.
    """
    view = array.view()
    view.flags.writeable = False
    return view


class Members:
    """The arrays of an open file, by name. Faults raise ValueError."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        names = archive.namelist()
        if len(set(names)) < len(names) or not all(name.endswith(".npy") for name in names):
            raise ValueError("its members are not arrays, or two have one name")
        self.names = tuple(name.removesuffix(".npy") for name in names)

    def declared(self, name: str) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """What the array `name` says it is, before anything is unpacked."""
        if name not in self.names:
            raise ValueError(f"it has no array {name}")
        with self._archive.open(f"{name}.npy") as member:
            there, _, declared = _heading(name, member)
        return declared, there

    def read(self, name: str, dtype: Any, shape: tuple[int | None, ...], most: int | None = None) -> NDArray[Any]:
        """The array `name`, unpacked only if it declares that type and shape, and has at most `most` entries.

        None in a shape stands for any length; `most` is then required.
        """
        if name not in self.names:
            raise ValueError(f"it has no array {name}")
        with self._archive.open(f"{name}.npy") as member:
            there, fortran, declared = _heading(name, member)
            fits = len(there) == len(shape) and all(n in (None, m) for n, m in zip(shape, there, strict=True))
            if declared != np.dtype(dtype) or fortran or not fits:
                wanted = " × ".join("n" if n is None else str(n) for n in shape)
                raise ValueError(f"{name} is {declared} of shape {there}; it must be {np.dtype(dtype)} of {wanted}")
            entries = math.prod(there)
            if most is not None and entries > most:
                raise ValueError(f"{name} has {entries} entries; at most {most} are possible")
            size = entries * np.dtype(dtype).itemsize
            data = member.read(size + 1)
        if len(data) != size:
            raise ValueError(f"{name} does not contain as many entries as it declares")
        return np.frombuffer(data, dtype=dtype).reshape(there).copy()


def _heading(name: str, member: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran's order, and type of an array, from its first bytes."""
    if np.lib.format.read_magic(member) != (1, 0):
        raise ValueError(f"{name} has another format version")
    return np.lib.format.read_array_header_1_0(member)


@contextmanager
def open_arrays(path: Path, what: str) -> Iterator[Members]:
    """The arrays of a file. Faults in it raise ValueError, or FileError if it cannot be read.

    A damaged archive fails in many ways (zlib, struct, numpy's header, encryption); all are faults of the file.
    """
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such {what}") from None
    except OSError as error:
        raise FileError(f"{path}: this {what} cannot be read: {error.strerror}") from None
    try:
        with file, zipfile.ZipFile(file) as archive:
            yield Members(archive)
    except (StlToolError, ValueError):
        raise
    except Exception as error:
        raise ValueError(f"it is not an archive of arrays ({type(error).__name__})") from error
