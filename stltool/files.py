"""Reading text and writing results: files are replaced as a whole or not at all, and only our own.

What a command or a function writes may replace what was written there before, never a file of another origin. Text,
pages and pictures carry MARK for that, near their beginning or end; other kinds are known by their own format.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import IO

from stltool.errors import FileError

MARK = "Generator: stltool"  # in a comment or in the metadata of what is written
_NEAR = 4096  # bytes from the beginning or the end of a file that the mark is within
_SUFFIX = ".stltool"  # of temporary files and folders, which begin with a dot and the name that they will get
_LEFT = re.compile(r"\..+\.[a-z0-9_]{8}\.stltool", re.DOTALL)
_YOUNG = 5.0  # seconds; a younger one may be about to be held
_TRIAL = 1 << 16  # bytes that must fit into a results folder


def read_bytes(path: str | Path, what: str) -> bytes:
    """A file's content, or a FileError. `what` names the file's role ("policy file")."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such {what}") from None
    except IsADirectoryError:
        raise FileError(f"{path}: this is a folder, not a {what}") from None
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
    temporary, held = None, None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _tidy(folder.parent)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=_prefix(folder), suffix=_SUFFIX))
        held = _hold(temporary)
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
    finally:
        _release(held)


@contextmanager
def atomic_file(path: str | Path) -> Iterator[IO[bytes]]:
    """A binary file next to `path` that replaces it if the block succeeds, and is removed if it fails."""
    path = Path(path).resolve()  # through a link, to what it names
    require_replaceable(path)
    temporary, held = None, None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
        _tidy(path.parent)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=_prefix(path), suffix=_SUFFIX, delete=False) as file:
            temporary = file.name
            held = _hold(Path(temporary))
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
    finally:
        _release(held)


# ------------------------------------------------------------------------------------------ what killed processes leave


def _prefix(path: Path) -> str:
    """The beginning of the name of a temporary file or folder that will become `path`; a long name is cut."""
    return f".{os.fsdecode(os.fsencode(path.name)[:200])}."


def _hold(path: Path) -> int | None:
    """A descriptor whose lock shows that a temporary file or folder is in use; None if it is held already, or where
    there are no such locks. The lock ends with the process."""
    try:
        import fcntl
    except ImportError:  # on Windows
        return None
    held = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(held)
        return None
    return held


def _release(held: int | None) -> None:
    if held is not None:
        os.close(held)


_tidied: set[Path] = set()


def _tidy(folder: Path) -> None:
    """Remove temporary files and folders that killed processes left in a folder; once for each folder."""
    if folder in _tidied:
        return
    _tidied.add(folder)
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if _LEFT.fullmatch(entry.name) is None:
                continue
            with suppress(OSError):
                kind = entry.stat(follow_symlinks=False)
                if time.time() - kind.st_mtime < _YOUNG or not (S_ISREG(kind.st_mode) or S_ISDIR(kind.st_mode)):
                    continue
                held = _hold(Path(entry.path))
                if held is None:
                    continue
                try:
                    if S_ISDIR(kind.st_mode):
                        shutil.rmtree(entry.path)
                    else:
                        os.unlink(entry.path)
                finally:
                    os.close(held)


@contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """The results folder for this process alone, while it makes `what` ("run"): FileError if another one does that.

    A folder that is made for it, and is empty in the end, is removed.
    """
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot create the results folder: {error.strerror}; name another") from None
    try:
        import fcntl
    except ImportError:  # on Windows
        yield
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                f"{folder}: another {what} is writing there; wait until it ends, or name another folder (--out)"
            ) from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(held)
        if made:
            with suppress(OSError):  # it is not empty
                folder.rmdir()


def require_replaceable(path: Path) -> None:
    """FileError if `path` exists and is not a regular file but a folder, a pipe or a device."""
    if os.path.exists(path) and not path.is_file():  # unlike Path.exists, for names of any length
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
        foreign = os.path.exists(path) and path.stat().st_size > 0 and not known(path)
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
    holds: list[int | None] = []
    kept: dict[Path, Path] = {}
    replaced: list[Path] = []
    try:
        for path, content in targets.items():
            if content is not None:
                made[path] = _temporary(path, content, holds)
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
    finally:
        for held in holds:
            _release(held)
    for former in kept.values():
        former.unlink(missing_ok=True)


def _temporary(path: Path, content: bytes, holds: list[int | None]) -> str:
    """The content in a file next to `path`, with its mode, held."""
    _tidy(path.parent)
    mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=_prefix(path), suffix=_SUFFIX, delete=False) as file:
        holds.append(_hold(Path(file.name)))
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
    while not os.path.exists(existing):
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
