"""Reading text and writing results: files are replaced as a whole or not at all, and only our own.

What a command or a function writes may replace what was written there before, never a file of another origin. Text,
pages and pictures carry MARK for that, near their beginning or end; other kinds are known by their own format.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from stltool.errors import FileError

MARK = "Generator: stltool"  # in a comment or in the metadata of what is written
_NEAR = 4096  # bytes from the beginning or the end of a file that the mark is within
_TRIAL = 1 << 16  # bytes that must fit into a results folder


def read_bytes(path: str | Path, what: str) -> bytes:
    """A file's content, or a FileError. `what` names the file's role ("policy file")."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such {what}") from None
    except OSError as error:
        raise FileError(f"{path}: this {what} cannot be read: {error.strerror}") from None


def read_text(path: str | Path, what: str, most: int | None = None) -> str:
    """The text of a file, or a FileError with the reason. `what` names the file's role ("task file").

    A file of more than `most` bytes is not read at all.
    """
    if most is not None and Path(path).is_file() and (size := Path(path).stat().st_size) > most:
        raise FileError(f"{path}: not a {what}: it has {size} bytes, and a {what} has at most {most}")
    return text_of(read_bytes(path, what), path, what)


def text_of(data: bytes, path: str | Path, what: str) -> str:
    """The text encoded by the bytes of a file, or a FileError with the reason."""
    if b"\0" in data:
        raise FileError(f"{path}: not a {what}: it contains binary data (a zero byte at offset {data.index(0)})")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path}: not a {what}: byte {error.start} ({data[error.start]:#04x}) is not UTF-8 text; "
            "save the file as UTF-8"
        ) from None


def write_atomically(path: str | Path, data: bytes | str) -> None:
    """Write `data` next to `path` and move it into place, so that a crash leaves the old file."""
    with atomic_file(path) as file:
        file.write(data.encode("utf-8", errors="backslashreplace") if isinstance(data, str) else data)


def write_folder(folder: str | Path, files: Mapping[str, bytes]) -> None:
    """Make a folder with these files, by name relative to it: all of them or none.

    FileError if there is something already; an empty folder is filled.
    """
    folder = Path(folder).absolute()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileError(f"{folder}: it exists, and nothing is replaced; name a new folder")
    temporary = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
        for name, content in files.items():
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
            (temporary / name).write_bytes(content)
        os.chmod(temporary, 0o777 & ~_umask())
        if folder.exists():
            folder.rmdir()
        os.replace(temporary, folder)
    except BaseException as error:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        if isinstance(error, OSError):
            raise FileError(f"{folder}: cannot be made: {error.strerror}") from None
        raise


@contextmanager
def atomic_file(path: str | Path) -> Iterator[IO[bytes]]:
    """A binary file next to `path` that replaces it if the block succeeds, and is removed if it fails."""
    path = Path(path).resolve()  # through a link, to what it names
    require_replaceable(path)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = file.name
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode)
        os.replace(temporary, path)
    except BaseException as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise FileError(f"{path}: cannot be written: {error.strerror}") from None
        raise


def require_replaceable(path: Path) -> None:
    """FileError if `path` exists and is not a regular file but a folder, a pipe or a device."""
    if path.exists() and not path.is_file():
        raise FileError(f"{path}: cannot be written: it is not a regular file; name another")


def is_marked(path: Path) -> bool:
    """Whether a file carries our mark."""
    return MARK.encode() in _ends(path)


def is_data(path: Path) -> bool:
    """Whether a file begins as the JSON of one of our formats."""
    return b'"format": "stltool-' in _ends(path)


def begins(*heading: str) -> Callable[[Path], bool]:
    """Whether a CSV file has this first line."""
    line = ",".join(heading).encode()
    return lambda path: _ends(path).partition(b"\n")[0].strip() == line


def _ends(path: Path) -> bytes:
    with path.open("rb") as file:
        first = file.read(_NEAR)
        file.seek(max(len(first), path.stat().st_size - _NEAR))
        return first + file.read(_NEAR)


def require_own(path: str | Path, what: str, known: Callable[[Path], bool]) -> None:
    """FileError if a non-empty file exists that is not a `what` ("policy") according to `known`: it would be lost."""
    path = Path(path)
    require_replaceable(path)
    try:
        foreign = path.exists() and path.stat().st_size > 0 and not known(path)
    except OSError:  # what cannot be read is not known to be ours
        foreign = True
    if foreign:
        raise FileError(
            f"{path}: this file does not contain a {what} that stltool wrote, and would be lost; name another file, or "
            "move this one away"
        )


def require_result(path: str | Path, what: str, known: Callable[[Path], bool] = is_marked) -> None:
    """FileError, before the work, if a result file could not be written after it; creates nothing."""
    require_own(path, what, known)
    require_folder(Path(path).resolve().parent)  # through a link, to what it names


def write_result(path: str | Path, data: bytes | str, what: str, known: Callable[[Path], bool] = is_marked) -> None:
    """Write a result whole or not at all; FileError if that would replace a file that is not a `what` of ours."""
    require_own(path, what, known)
    write_atomically(path, data)


def write_results(files: Mapping[Path, bytes | None], what: str, known: Callable[[Path], bool] = is_marked) -> None:
    """Write files that belong together, all of them or none; None removes the file, if there is one.

    FileError, before anything is changed, if that would replace or remove a file that is not a `what` of ours.
    """
    targets = {path.resolve(): content for path, content in files.items()}
    for path in targets:
        require_result(path, what, known)
    made: dict[Path, str] = {}
    kept: dict[Path, Path] = {}
    replaced: list[Path] = []
    try:
        for path, content in targets.items():
            if content is not None:
                made[path] = _temporary(path, content)
        for path in targets:
            if path.exists():
                kept[path] = path.with_name(f".{path.name}.{os.getpid()}.old")
                os.replace(path, kept[path])
            if path in made:
                os.replace(made[path], path)
                del made[path]
                replaced.append(path)
    except BaseException as error:
        for path in replaced:
            path.unlink(missing_ok=True)
        for path, former in kept.items():
            os.replace(former, path)
        for temporary in made.values():
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise FileError(f"{path}: cannot be written: {error.strerror}") from None
        raise
    for former in kept.values():
        former.unlink(missing_ok=True)


def _temporary(path: Path, content: bytes) -> str:
    """The content in a file next to `path`, with its mode."""
    mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
    os.chmod(file.name, mode)
    return file.name


def require_folder(path: str | Path) -> None:
    """FileError, before the work, if a results folder could not be created or written after it.

    Tried with an unnamed temporary file; nothing is left behind.
    """
    existing = Path(path).resolve()
    while not existing.exists():
        existing = existing.parent
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        fault = f"{existing} is not a writable directory"
        raise FileError(f"{path}: cannot create the results folder: {fault}; name another")
    try:
        with tempfile.TemporaryFile(dir=existing) as file:
            file.write(bytes(_TRIAL))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        fault = f"{existing}: {error.strerror}"
        raise FileError(f"{path}: cannot create the results folder: {fault}; name another") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
