"""Size checks: requests that would not fit into memory, or would take too long, are refused with figures and remedies.

This module also decides the width of integers: states, letters and automaton states are numbered in int32, and larger
numbers are refused; choices are as wide as the model needs (`integer_type`); counters are int64.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import real
from stltool.errors import SettingsError, SizeError, named

_USABLE = 0.8  # of the memory that is free now
_LITTLE = 2**20  # bytes
_MOST_DAYS = 7
_MOST_NUMBERED = 2**31 - 2  # so that one more, and the total, still fit int32

IntegerType: TypeAlias = type[np.int16] | type[np.int32] | type[np.int64]
UnsignedType: TypeAlias = type[np.uint8] | type[np.uint16] | type[np.uint32]
Numbers: TypeAlias = NDArray[np.signedinteger[Any]]
"""Integers of a sufficient type."""


def integer_type(largest: int) -> IntegerType:
    """The type for numbers from −1 (none) to `largest`: int16 if sufficient, else int32, else int64."""
    for candidate in (np.int16, np.int32):
        if largest <= np.iinfo(candidate).max:
            return candidate
    return np.int64


def unsigned_type(largest: int) -> UnsignedType:
    """The smallest type for numbers from 0 to `largest`."""
    return np.uint8 if largest < 2**8 else np.uint16 if largest < 2**16 else np.uint32


def require_numbered(n: int, what: str, remedy: str) -> None:
    """Raise SizeError, before they are numbered, if n things are more than int32 can number."""
    if n > _MOST_NUMBERED:
        raise SizeError(f"{n} {what} are more than can be numbered (at most {_MOST_NUMBERED}); {remedy}")


def memory_limit(given: int | None = None) -> int:
    """Bytes that may be allocated: `given`, or four fifths of the free memory.

    This is the memory available on the machine, within the limits of the operating system: `ulimit -v`, and the memory
    of a container.
    """
    if given is not None:
        return require_limit(given)
    import psutil

    free = [psutil.virtual_memory().available, *_left_by_ulimit(), *_left_by_container()]
    return int(max(0, min(free)) * _USABLE)


def _left_by_ulimit() -> list[int]:
    """The address space that `ulimit -v` leaves to this process, if it is set."""
    import psutil

    try:
        import resource
    except ImportError:  # not on Windows
        return []
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return [] if most == resource.RLIM_INFINITY else [most - int(psutil.Process().memory_info().vms)]


def _left_by_container(root: Path = Path("/sys/fs/cgroup")) -> list[int]:
    """The memory that this process's control groups (version 2), up to the root, leave if they have limits."""
    try:
        own = next(line for line in Path("/proc/self/cgroup").read_text().splitlines() if line.startswith("0::"))
        group = root / own.removeprefix("0::").strip().lstrip("/")
    except (OSError, StopIteration):
        return []
    left = []
    for folder in (group, *group.parents):
        if root not in (folder, *folder.parents):
            break
        try:
            most, used = ((folder / name).read_text().strip() for name in ("memory.max", "memory.current"))
            left += [int(most) - int(used)] if most != "max" else []
        except (OSError, ValueError):
            continue
    return left


def require_limit(given: object) -> int:
    """A limit in bytes that was given; SettingsError for anything but a number from 0."""
    limit = real(given, "memory_limit", "2e9")
    if limit < 0:
        raise SettingsError(f"memory_limit is {given}; give bytes from 0, such as 2e9")
    return int(limit)


def seconds_of(given: object, what: str) -> float:
    """A limit in seconds, the argument `what`; SettingsError for anything but a number from 0."""
    limit = float(real(given, what, "60"))
    if limit < 0:
        raise SettingsError(f"{named(what)} is {given}; give seconds from 0, such as 60")
    return limit


def require_memory(needed: float, what: str, remedy: str, limit: int | None = None) -> None:
    """Raise SizeError, before anything is allocated, if `needed` bytes are over the limit.

    Less than a megabyte, without a limit of the user's, is never refused: asking the system would take longer.
    """
    if limit is None and needed < _LITTLE:
        return
    allowed = memory_limit(limit)
    if needed > allowed:
        raise SizeError(
            f"{what} would take {bytes_text(needed)} of memory; {bytes_text(allowed)} may be used; {remedy}"
        )


def bytes_text(n: float) -> str:
    """A number of bytes in readable form: 1.5 GB."""
    n, unit = float(min(n, 10**300)), "B"
    for larger in ("kB", "MB", "GB", "TB", "PB"):
        if n < 1000:
            break
        n, unit = n / 1000, larger
    return f"{n:.3g} {unit}"


def require_time(operations: float, rate: float, what: str, remedy: str, limit: float | None = None) -> None:
    """Raise SizeError if `operations` at `rate` per second would take more than a week, or than `limit` seconds."""
    seconds = operations / rate
    if seconds > _MOST_DAYS * 86400:
        raise SizeError(f"{what} would take about {seconds / 86400:.3g} days; {remedy}")
    if limit is not None and seconds > limit:
        raise SizeError(f"{what} would take about {seconds:.3g} s, over the limit of {limit:.3g} s; {remedy}")
