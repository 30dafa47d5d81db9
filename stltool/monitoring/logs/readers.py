"""Readers of trace files by the extension of the file's name; others' are found by entry points.

A package that reads logs of another format declares, in its pyproject.toml,

    [project.entry-points."stl.trace_readers"]
    bag = "its_module:read_bag"

and so does a script by `stl.trace_readers[".bag"] = read_bag`. The function takes the path, the names to read (None:
all) and the time that the user named (None: its own choice), and returns a `Recording`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import replace
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from stltool.arguments import described
from stltool.display import Card, Displayed
from stltool.errors import FileError, NameLookupError, StlToolError, TraceError
from stltool.logic.names import near_names
from stltool.monitoring.logs.missing import filled
from stltool.monitoring.logs.recording import Asked, Recording

Reader: TypeAlias = Callable[[Path, "list[str] | None", "str | None"], Recording]

GROUP = "stl.trace_readers"
_TEXT, _HERE = "text:read_text", "stltool.monitoring.logs"
_OWN = {
    ".csv": _TEXT, ".tsv": _TEXT, ".npz": "npz:read_npz", ".parquet": "parquet:read_parquet", ".csv.gz": _TEXT,
    ".tsv.gz": _TEXT,
}  # fmt: skip
_LIKE_OTHERS = {".mcap": f"{_HERE}.mcap:read_mcap"}  # by the interface for other packages


class TraceReaders(MutableMapping[str, Reader], Displayed):
    """Readers of other formats than CSV, NumPy's and Parquet: extension → function(path, names, time) → Recording.

    Those of installed packages are found by their entry points in the group "stl.trace_readers", and imported when a
    file is read. Raises FileError if one cannot be imported.
    """

    def __init__(self) -> None:
        self._given: dict[str, Reader] = {}

    def __getitem__(self, extension: str) -> Reader:
        if extension in self._given:
            return self._given[extension]
        found = {extension_of(point.name): point for point in entry_points(group=GROUP)}.get(extension)
        if found is not None:
            try:
                return cast(Reader, found.load())
            except Exception as error:
                raise FileError(
                    f"the reader of {extension} files, {found.value}, cannot be imported: {error}"
                ) from None
        return cast(Reader, _function(_LIKE_OTHERS[extension]))

    def __setitem__(self, extension: str, reader: Reader) -> None:
        if not isinstance(extension, str) or not extension.startswith(".") or extension in _OWN:
            raise FileError(f"{described(extension)} is not an extension of other trace files; write one, such as .bag")
        if not callable(reader):
            raise FileError(f"the reader of {extension} files is {described(reader)}; give a function")
        self._given[extension] = reader

    def __delitem__(self, extension: str) -> None:
        del self._given[extension]

    def __iter__(self) -> Iterator[str]:
        found = (extension_of(point.name) for point in entry_points(group=GROUP))
        return iter(dict.fromkeys([*_LIKE_OTHERS, *found, *self._given]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def _card(self) -> Card:
        return Card(f"TraceReaders of {', '.join(self)} files", [])


trace_readers = TraceReaders()


def extension_of(name: str) -> str:
    """The extension that an entry point names, with or without its dot."""
    return f".{name.lower().lstrip('.')}"


def extensions() -> list[str]:
    """All extensions that are read."""
    return list(dict.fromkeys([*_OWN, *trace_readers]))


def read_recording(path: Path, asked: Asked) -> Recording:
    """The content of a trace file; FileError if no reader takes it."""
    name = path.name.lower()
    known = _OWN if any(name.endswith(one) for one in _OWN) or str(path) == "-" else trace_readers
    fitting = [extension for extension in known if name.endswith(extension)]
    if str(path) == "-":
        extension = ".csv"
    elif fitting:
        extension = max(fitting, key=len)
    else:
        raise FileError(f"{path}: not a trace file; traces are read from {', '.join(extensions())} files")
    if str(path) != "-":
        require_trace_file(path)
    if extension in _OWN:
        return cast(Recording, _function(f"{_HERE}.{_OWN[extension]}")(path, asked))
    return _of_others(path, extension, asked)


def require_trace_file(path: Path) -> None:
    """FileError unless there is a regular file."""
    if not path.exists():
        raise FileError(f"{path}: there is no such trace file")
    if not path.is_file():
        raise FileError(f"{path}: this trace file cannot be read: it is not a regular file")


def _function(place: str) -> Callable[..., Any]:
    module, _, name = place.partition(":")
    return cast(Callable[..., Any], getattr(import_module(module), name))


def _of_others(path: Path, extension: str, asked: Asked) -> Recording:
    """What another's reader returns, checked as a file's content is."""
    reader, names = trace_readers[extension], None if asked.names is None else list(asked.names)
    try:
        found = reader(path, names, asked.time)
    except StlToolError:
        raise
    except Exception as error:  # whatever a file or a reader does
        raise FileError(f"{path}: the reader of {extension} files failed: {type(error).__name__}: {error}") from None
    if not isinstance(found, Recording):
        raise FileError(f"{path}: the reader of {extension} files returned {described(found)}, not a stl.Recording")
    for name in names or ():
        if name not in found.signals:
            raise NameLookupError(f"{path}: there is no signal {name}; {near_names(name, found.signals)}")
    if names is not None:
        kept = {name: found.signals[name] for name in names}
        missing = {name: none for name, none in found.missing.items() if name in kept}
        found = replace(found, signals=kept, missing=missing)
    _require_arrays(path, found)
    return filled(found, asked.missing, str(path), lambda name, index: f"signal {name}, {found.place(index[-1])}")


def _require_arrays(path: Path, found: Recording) -> None:
    """TraceError unless the arrays are samples, and there is a time for each."""
    shapes: dict[str, tuple[int, ...]] = {}
    own = found.times if isinstance(found.times, Mapping) else None
    for name, values in found.signals.items():
        array = np.asarray(values)
        shapes[name] = array.shape
        if array.dtype.kind not in "biuf" or array.ndim not in (1, 2) or not array.size:
            kind = f"{array.dtype} of shape {array.shape}"
            raise TraceError(f"{path}, signal {name}: the reader returned {kind}; samples are numbers or Booleans")
        times: Any = own.get(name) if own is not None else found.times
        if times is not None and np.shape(times) not in (array.shape, array.shape[-1:]):
            raise TraceError(f"{path}, signal {name}: the reader returned another number of times than of samples")
        if own is None and array.shape != next(iter(shapes.values())):
            first = next(iter(shapes))
            raise TraceError(
                f"{path}, signal {name}: its shape is {array.shape}, that of {first} is {shapes[first]}; signals "
                "recorded apart need times of their own"
            )
        if own is not None and times is None:
            raise TraceError(f"{path}, signal {name}: the reader returned no times for it, but for other signals")
