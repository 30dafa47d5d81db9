"""Distinct rows of a wide table of integers, for which np.unique(axis=0) makes a type with a field per column."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def distinct_rows(table: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first position of each distinct row, and for each row the number of the distinct row equal to it.

    Distinct rows are in lexicographic order; negative numbers come last.
    """
    keys = np.ascontiguousarray(table.astype(table.dtype.newbyteorder(">")))  # big-endian bytes sort like the numbers
    places: dict[bytes, int] = {}
    equal = [places.setdefault(row.tobytes(), i) for i, row in enumerate(keys)]
    first = np.array([places[key] for key in sorted(places)], dtype=np.int64)
    number = np.empty(len(table), dtype=np.int64)
    number[first] = np.arange(len(first))
    return first, number[equal]
