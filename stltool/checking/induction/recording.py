"""Where a policy is written while it is computed, from the last step back: to memory, or to a resumable file.

The file is a layered policy file (stltool/layered.py), with the suffix `.partial` until it is complete. Next to it,
`.state` holds what the induction needs to continue: the layer ahead with its values, and how much of the file belongs
to it. It is written from time to time, and when something ends the induction early, such as Ctrl-C. The forward pass is
repeated, since it gives the same layers. A state belongs to one question, identified by a key, and to the arithmetic in
use; continuing from it gives the same bits. A state that is not resumed is never replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.words import Layer, Words
from stltool.choices import Listed
from stltool.errors import FileError, PolicyError, SettingsError, named
from stltool.files import atomic_file, require_own, require_replaceable
from stltool.layered import LayeredWriter, read_header, read_layers, require_index


@dataclass(frozen=True, eq=False)
class Passed:
    """The position of an induction: the next backward step is `before` − 1, from this layer and its values."""

    before: int
    ahead: Any
    values: NDArray[Any]
    swept: int


class Recorder(Protocol):
    """What `solve` reports on its way; choices are added from the last step back."""

    def resume(self, layers: Any) -> Passed | None:
        """Called first: where to continue from; None: start from the last step."""

    def add(self, listed: Listed) -> None: ...

    def passed(self, at: Passed) -> None:
        """Called after every stretch."""

    def layers(self) -> Sequence[Listed]:
        """The choices added, in ascending order of steps."""

    def close(self, whole: bool) -> None:
        """The induction ended; not `whole`: early."""


class InMemory:
    """Keeps the choices in memory."""

    def __init__(self) -> None:
        self._found: list[Listed] = []

    def resume(self, layers: Any) -> Passed | None:
        return None

    def add(self, listed: Listed) -> None:
        self._found.append(listed)

    def passed(self, at: Passed) -> None:
        return

    def layers(self) -> list[Listed]:
        return self._found[::-1]

    def close(self, whole: bool) -> None:
        return


_LAYER = ("states", "start", "word", "open", "sure", "tiles", "sure_choice")


class OnDisk:
    """A file of the policy (see the module's text).

    header  its first line          key identifies the question and the arithmetic (`key_of`)
    every   seconds between states   again  whether to continue from a state of this key, if there is one
    """

    def __init__(self, path: Path, header: dict[str, Any], key: str, every: float, again: bool) -> None:
        self.path, self._key, self._every = path, key, every
        self._path = path.resolve()  # links are followed
        self._partial, self._state = files_beside(path)
        self._header, self._again = header, again
        self._file: IO[bytes] | None = None
        self._writer: LayeredWriter | None = None
        self._at: tuple[Passed, int] | None = None  # the position, and how many layers the file had there
        self._last = time.monotonic()

    def resume(self, layers: Any) -> Passed | None:
        found = self._saved(layers) if self._again and isinstance(layers, Words) else None
        at, index = found if found is not None else (None, None)
        with self._writing():
            if at is None:
                self._state.unlink(missing_ok=True)
            self._partial.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._partial.open("wb" if index is None else "r+b")
            self._writer = LayeredWriter(self._file, self._header, index)
        return at

    def add(self, listed: Listed) -> None:
        assert self._writer is not None
        with self._writing():
            self._writer.add(listed)

    def passed(self, at: Passed) -> None:
        assert self._writer is not None
        if isinstance(at.ahead, Layer) and at.values.shape == (8 * at.ahead.n_tiles,):  # by tiles
            self._at = (at, len(self._writer.index))
            if time.monotonic() - self._last >= self._every:
                self._save()
                self._last = time.monotonic()

    def layers(self) -> list[Listed]:
        assert self._writer is not None
        with self._writing():
            self._writer.finish()
            self._sync()
            os.replace(self._partial, self._path)
            self._state.unlink(missing_ok=True)
        self._at = None
        return read_layers(self.path)[1]

    def close(self, whole: bool) -> None:
        if self._at is not None and not whole:
            with suppress(FileError):  # a full disk, which is reported to the caller already
                self._save()
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            if not self._state.exists():  # nothing can continue from it
                self._partial.unlink(missing_ok=True)

    def _save(self) -> None:
        assert self._writer is not None
        assert self._at is not None
        at, n_layers = self._at
        with self._writing():
            self._sync()
        arrays: dict[str, Any] = {name: getattr(at.ahead, name) for name in _LAYER}
        numbers = np.array([at.before, at.swept], dtype=np.int64)
        index = np.array(self._writer.index[:n_layers], dtype=np.int64).reshape(-1, 5)
        key = np.frombuffer(self._key.encode(), dtype=np.uint8)
        with atomic_file(self._state) as file:
            np.savez(file, key=key, numbers=numbers, index=index, values=at.values, **arrays)

    def _sync(self) -> None:
        assert self._file is not None
        self._file.flush()
        os.fsync(self._file.fileno())

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise FileError(f"{self._partial}: cannot write it: {error.strerror}") from None

    def _saved(self, layers: Words) -> tuple[Passed, list[tuple[int, ...]]] | None:
        """The existing state, and how much of the file belongs to it; None if there is none for this question."""
        if not self._state.is_file() or not self._partial.is_file():
            return None
        try:
            with np.load(self._state, allow_pickle=False) as saved:
                arrays = {name: saved[name] for name in saved.files}
            if arrays.pop("key").tobytes().decode() != self._key:
                return None
            numbers, rows = arrays.pop("numbers"), arrays.pop("index")
            if numbers.dtype != np.int64 or numbers.shape != (2,) or rows.dtype != np.int64 or rows.shape[1:] != (5,):
                raise ValueError
            (before, swept), index = numbers.tolist(), [tuple(row) for row in rows.tolist()]
            if not 0 <= before == index[-1][0] or swept < 0:
                raise ValueError
            require_index(self._partial, self._header, index)
            values = arrays.pop("values")
            ahead = Layer(*(arrays.get(name) for name in _LAYER))  # type: ignore[arg-type]  # checked in the next line
            layers.require(ahead, values)
        except Exception:  # a damaged archive fails in many ways, all caused by the file
            raise _damaged(self._state, self.path) from None
        return Passed(before, ahead, values, swept), index


def files_beside(path: Path) -> list[Path]:
    """The paths of the unfinished policy and of the state."""
    path = path.resolve()
    return [path.with_name(path.name + ending) for ending in (".partial", ".state")]


def key_of(question: Sequence[Any], arithmetic: str) -> str:
    """The key that identifies a state of this question in this arithmetic."""
    return f"{hashlib.sha256(json.dumps(question).encode()).hexdigest()} {arithmetic}"


def stopped_in(path: Path, question: Sequence[Any], again: bool) -> str | None:
    """The arithmetic in which a stopped run continues; None if there is no stopped run.

    Raises SettingsError if the work of a stopped run would be lost: it is not resumed, or belongs to another question.
    FileError if the existing files are not ours.
    """
    partial, state = files_beside(path)
    require_own(partial, "policy that is being written", _begins_as_ours)
    require_replaceable(state)
    if not state.exists():
        return None
    try:
        with np.load(state, allow_pickle=False) as saved:
            key = str(saved["key"].tobytes().decode())
    except Exception:  # as above
        raise _damaged(state, path) from None
    if not again:
        raise SettingsError(
            f"{state} holds a stopped run; resume it ({named('resume', 'resume=True')}), or delete it to start again"
        )
    known, _, arithmetic = key.partition(" ")
    if known != key_of(question, "").strip():
        raise SettingsError(
            f"{state} holds a stopped run with another task, model, options or version of stltool; "
            "resume it with those, or delete the file to start again"
        )
    return arithmetic


def _damaged(state: Path, path: Path) -> FileError:
    return FileError(f"{state}: not a state of {path.name} in this version of stltool; delete it to start again")


def _begins_as_ours(path: Path) -> bool:
    try:
        read_header(path)
    except PolicyError:
        return False
    return True
