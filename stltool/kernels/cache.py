"""Machine code of the kernels on disk: where and how it is stored.

It is stored in the first writable location of: the folder named by NUMBA_CACHE_DIR, `__pycache__` next to the sources,
the user's cache folder. Earlier locations that are not writable are read, so that an administrator can compile for
others. Without any, each process compiles for itself.

Each kernel and signature has its own files, written at once and replaced as a whole: processes that compile at the same
time write the same content, and none waits for another. (In numba's own layout, two signatures compiled at the same
time can get the same file.) A damaged file is compiled again. Neither a full disk nor a vanished folder ends a run.

Folders of other sources in the same location are removed: no new process can use them. A process still running with
the older sources has loaded what it needs, or compiles it again. Folders of the same sources and another compiler
(several Pythons sharing a checkout) stay until they have not been used for a month.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import llvmlite
import numba
import numpy as np
from numba.core import config as _numba_config
from numba.core.caching import IndexDataCacheFile, _Cache
from numba.core.compiler import CompileResult

from stltool.kernels.jit import HERE, SOURCES, tell_compiling

config = cast(Any, _numba_config)  # its settings are created at import

_UNUSED = 30 * 86400  # seconds
_TOUCHED = 86400
_CODE_SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")  # of numba's NUMBA_*


def _load_array_functions() -> None:
    """numba's functions of arrays, without scipy.linalg, which is a third of the time before the first kernel.

    numba imports it only to see whether there is one, and it is among our dependencies; a compiled function that calls
    it asks again.
    """
    from numba.np import linalg

    ensure = getattr(linalg, "ensure_blas", None)
    if ensure is not None:
        linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        if ensure is not None:
            linalg.ensure_blas = ensure


_load_array_functions()


def compiler() -> str:
    """A digest of the compiler and its settings; the processor is part of each file's key."""
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version, sys.flags.optimize)
    settings = [getattr(config, name, None) for name in _CODE_SETTINGS]
    return hashlib.sha256(repr((versions, settings)).encode()).hexdigest()[:16]


def folders() -> tuple[list[Path], Path | None]:
    """The folders that can contain code of these sources and this compiler; and the one to write to, None if none.

    The latter is the last of the former.
    """
    name = f"numba-{SOURCES}-{compiler()}"
    readable: list[Path] = []
    for place in _places():
        folder = place / name
        if _can_write(folder):
            _clean(place, folder)
            return [*readable, folder], folder
        if folder.is_dir():
            readable.append(folder)
    return readable, None


def _places() -> Iterator[Path]:
    mine = hashlib.sha256(os.fsencode(HERE.resolve())).hexdigest()[:16]  # different for another installation
    if config.CACHE_DIR:
        yield Path(config.CACHE_DIR, f"stltool-{mine}")
    yield HERE / "__pycache__"
    import platformdirs

    yield platformdirs.user_cache_path("stltool", appauthor=False) / f"kernels-{mine}"


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _clean(place: Path, mine: Path) -> None:
    """Remove what cannot be used again from a location; see the module docstring."""
    now = time.time()
    with contextlib.suppress(OSError):
        if now - mine.stat().st_mtime > _TOUCHED:
            os.utime(mine)  # in use
        for folder in place.glob("numba-*-*"):
            same_sources = folder.name.split("-")[1] == SOURCES
            if not same_sources or now - folder.stat().st_mtime > _UNUSED:
                shutil.rmtree(folder, ignore_errors=True)


_folders = functools.cache(folders)  # once per process


class KernelCache(_Cache):
    """The cache from which numba's dispatcher loads a kernel's machine code, and in which it saves it."""

    def __init__(self, name: str, on_disk: bool) -> None:
        self._name, self._on_disk = name, on_disk

    @property
    def cache_path(self) -> str | None:
        written = _folders()[1] if self._on_disk else None
        return None if written is None else str(written)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        for folder in _folders()[0] if self._on_disk else ():
            try:
                found = self._file(folder, sig, target_context.codegen()).load(self._key(sig, target_context.codegen()))
                if found is not None:
                    return CompileResult._rebuild(target_context, *found)
            except Exception:  # a damaged file fails in many ways; it is replaced once the kernel is compiled
                continue
        tell_compiling(kept=self.cache_path is not None)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        folder = _folders()[1] if self._on_disk else None
        if folder is None or data.library.has_dynamic_globals or data.lifted:  # these cannot be stored
            return
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            file = self._file(folder, sig, data.codegen)
            file.flush()  # numba reads the old index before it writes a new one, so a damaged one must be gone
            file.save(self._key(sig, data.codegen), data._reduce())

    @staticmethod
    def _key(sig: Any, codegen: Any) -> tuple[Any, ...]:
        return sig, codegen.magic_tuple()

    def _file(self, folder: Path, sig: Any, codegen: Any) -> Any:
        key = hashlib.sha256(repr(self._key(sig, codegen)).encode()).hexdigest()[:16]
        return IndexDataCacheFile(str(folder), f"{self._name}-{key}", folder.name)

    def enable(self) -> None:
        """Nothing; as the next two, a part of the interface that numba does not need."""

    def disable(self) -> None: ...

    def flush(self) -> None: ...
