"""Where a policy goes while it is found, from the last step back: into memory, or into a file, to be resumed.

The file is written as a layered policy file (stltool/layered.py), under the name with `.partial` until it is whole.
Beside it `.state` holds what the induction needs to go on: the layer ahead with its values, and how much of the file
belongs to it. The pass forward is made again, since it gives the same layers. A state is of one question, told by a
key; what goes on from it gives the same bits.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.words import Layer, Words
from stltool.choices import Listed
from stltool.errors import FileError
from stltool.files import atomic_file
from stltool.layered import LayeredWriter, read_layers, require_index


@dataclass(frozen=True, eq=False)
class Passed:
    """Where an induction is: the next step back is `before` − 1, from this layer and its values."""

    before: int
    ahead: Any
    values: NDArray[Any]
    swept: int


class Recorder(Protocol):
    """What `solve` tells of its way; choices are added from the last step back."""

    def resume(self, layers: Any) -> Passed | None:
        """Called first: where to go on from; None: at the end. What begins anew gives no layers."""

    def add(self, listed: Listed) -> None: ...

    def passed(self, at: Passed) -> None:
        """Called after every stretch."""

    def layers(self) -> Sequence[Listed]:
        """What was added, in ascending order of steps."""

    def close(self) -> None:
        """The induction ended, one way or another."""


class InMemory:
    """Keeps what is added."""

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

    def close(self) -> None:
        return


_LAYER = ("states", "start", "word", "open", "sure", "tiles", "sure_choice")


class OnDisk:
    """A file of the policy (see the module's text).

    header  its first line          key    what tells this question from others
    every   seconds between states  again  whether to go on from a state of this key, where there is one
    """

    def __init__(self, path: Path, header: dict[str, Any], key: str, every: float, again: bool) -> None:
        self.path, self._key, self._every = path, key, every
        self._partial, self._state = (path.with_name(path.name + ending) for ending in (".partial", ".state"))
        self._header, self._again = header, again
        self._writer: LayeredWriter | None = None
        self._last = time.monotonic()

    def resume(self, layers: Any) -> Passed | None:
        found = self._saved(layers) if self._again and isinstance(layers, Words) else None
        if found is None:
            self._writer = LayeredWriter(self._partial, self._header)
            return None
        at, index = found
        self._writer = LayeredWriter(self._partial, self._header, index)
        return at

    def add(self, listed: Listed) -> None:
        assert self._writer is not None
        self._writer.add(listed)

    def passed(self, at: Passed) -> None:
        by_tiles = isinstance(at.ahead, Layer) and at.values.shape == (8 * at.ahead.n_tiles,)
        if by_tiles and time.monotonic() - self._last >= self._every:
            self._save(at)
            self._last = time.monotonic()

    def layers(self) -> list[Listed]:
        assert self._writer is not None
        self._writer.finish()
        os.replace(self._partial, self.path)
        self._state.unlink(missing_ok=True)
        return read_layers(self.path)[1]

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()

    def _save(self, at: Passed) -> None:
        assert self._writer is not None
        self._writer.flush()
        arrays: dict[str, Any] = {name: getattr(at.ahead, name) for name in _LAYER}
        numbers = np.array([at.before, at.swept], dtype=np.int64)
        index = np.array(self._writer.index, dtype=np.int64).reshape(-1, 5)
        key = np.frombuffer(self._key.encode(), dtype=np.uint8)
        with atomic_file(self._state) as file:
            np.savez(file, key=key, numbers=numbers, index=index, values=at.values, **arrays)

    def _saved(self, layers: Words) -> tuple[Passed, list[tuple[int, ...]]] | None:
        """The state that is there, and what of the file belongs to it; None where there is none of this question."""
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
        except Exception:  # a damaged archive fails in many ways, all of them the file's
            raise FileError(
                f"{self._state}: not a state of this version that belongs to {self.path.name}; delete it to begin anew"
            ) from None
        return Passed(before, ahead, values, swept), index
