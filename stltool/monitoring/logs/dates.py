"""ISO dates as text → NumPy's datetime64[ns], in UTC where they name their zone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d+))?)? ?(Z|UTC|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE
)
_YEARS = range(1678, 2262)  # that nanoseconds in 64 bits reach


class DateError(ValueError):
    """A text is not a date; `index` is its position."""

    def __init__(self, index: int, says: str) -> None:
        super().__init__(says)
        self.index = index


def is_date(text: str) -> bool:
    """Whether a text is written as an ISO date."""
    return _DATE.fullmatch(text.strip()) is not None


def dates(texts: Sequence[str]) -> NDArray[np.datetime64]:
    """The times of ISO dates, such as 2026-03-01T12:00:00.25Z; all with a zone, or none. Raises DateError."""
    local: list[str] = []
    minutes: list[int] = []
    zoned = None
    for index, text in enumerate(texts):
        found = _DATE.fullmatch(text.strip())
        if found is None or int(found[1][:4]) not in _YEARS:
            raise DateError(index, "is not a date such as 2026-03-01T12:00:00.25Z")
        if zoned is None:
            zoned = found[4] is not None
        elif zoned is not (found[4] is not None):
            raise DateError(index, f"names {'no' if zoned else 'a'} time zone, unlike the dates above")
        local.append(f"{found[1]}T{found[2] or '00:00'}" + (f".{found[3][:9]}" if found[3] else ""))
        minutes.append(_offset(found[4]))
    try:
        stamps = np.array(local, "M8[ns]")
    except ValueError:  # 31 February
        raise DateError(_first_bad(local), "is not a date") from None
    return stamps - np.array(minutes, "m8[m]")  # type: ignore[no-any-return]


def _offset(zone: Any) -> int:
    """The minutes that a zone is ahead of UTC."""
    if zone is None or zone.upper() in ("Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return int(f"{zone[0]}1") * (60 * int(digits[:2]) + int(digits[2:]))


def _first_bad(texts: Sequence[str]) -> int:
    for index, text in enumerate(texts):
        try:
            np.datetime64(text, "ns")
        except ValueError:
            return index
    raise AssertionError("every text is a date")
