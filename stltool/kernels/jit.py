"""The decorator of all kernels: numba compiles them, and machine code on disk is never older than the sources.

numba's own cache compares the file of the stored function, but not the files of the functions it calls, although their
code is compiled into it: after an edit or an upgrade of a callee, its callers in other files would keep using the old
one. So machine code is stored in a separate folder for each state of *all* sources here and of the compiler:

    <place>/numba-<digest of the sources>-<digest of the compiler>/

kernels/cache.py lists the locations. This module imports numba only when a kernel is declared, and the package
imports it before the source of any kernel is read, so that the digest cannot be newer than the code.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])
_Files: TypeAlias = tuple[tuple[str, int, int], ...]

HERE = Path(__file__).parent


def _files() -> _Files:
    """Name, time of change and size of every source here; none if they are not in a folder (but in an archive)."""
    try:
        with os.scandir(HERE) as entries:
            found = [(entry.name, entry.stat()) for entry in entries if entry.name.endswith(".py")]
    except OSError:
        return ()
    return tuple(sorted((name, stat.st_mtime_ns, stat.st_size) for name, stat in found))


def _digest(files: _Files) -> str:
    sha = hashlib.sha256()
    for name, _, _ in files:
        source = (HERE / name).read_bytes()
        sha.update(f"{name}\0{len(source)}\0".encode() + source)
    return sha.hexdigest()[:16]


_FILES = _files()
SOURCES = _digest(_FILES)


def kernel(
    function: _Kernel, *, counts: bool = True, lock: bool = False, part: bool = False, ieee: bool = False
) -> _Kernel:
    """Compile `function` with numba, without Python and without its lock; `.py_func` is the Python function.

    For functions of some nanoseconds: without `counts`, references to arrays are not counted, which takes longer than
    that; such a kernel makes no arrays, and calls only its like. With `lock`, Python's lock is kept, and C can call it.
    A `part` is called by kernels only, and is compiled into them; Python runs its `.py_func`. With `ieee`, a quotient
    by 0 is infinite or not a number, as in numpy; otherwise it is an exception, for which each division is checked.

    The machine code is stored on disk, unless a source here has changed since this process began: the code that Python
    has read may then be older or newer than the digest.
    """
    from numba import njit

    from stltool.kernels.compiling import Kernel, KernelCompiler, Part, PartCompiler

    # what C code calls is left out elsewhere, and what Python calls of parts: each takes time to compile
    options: dict[str, Any] = {"no_cfunc_wrapper": not lock, "no_cpython_wrapper": part}
    if not counts:
        options["_nrt"] = False
    if ieee:
        options["error_model"] = "numpy"
    pipeline = PartCompiler if part else KernelCompiler
    compiled: Any = njit(nogil=not lock, pipeline_class=pipeline, **options)(function)
    if hasattr(compiled, "py_func"):  # with NUMBA_DISABLE_JIT it is the function itself
        compiled.__class__ = Part if part else Kernel
        from stltool.kernels.cache import KernelCache

        name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        compiled._cache = KernelCache(name, on_disk=bool(_FILES) and _files() == _FILES)
    return cast(_Kernel, compiled)


part = functools.partial(kernel, part=True)


def compiles() -> bool:
    """Whether kernels are compiled: with NUMBA_DISABLE_JIT they are not."""
    from numba.core import config

    return not config.DISABLE_JIT  # type: ignore[attr-defined]


_listeners: list[Callable[[bool], None]] = []


@contextmanager
def compiling(tell: Callable[[bool], None]) -> Iterator[None]:
    """tell(whether it will be kept on disk) is called once, before the first kernel that this block compiles."""
    _listeners.append(tell)
    try:
        yield
    finally:
        if tell in _listeners:
            _listeners.remove(tell)


def tell_compiling(kept: bool) -> None:
    """Called by the cache when a kernel is about to be compiled."""
    while _listeners:
        _listeners.pop()(kept)
