"""Probabilities as given: integers over a common denominator, in addition to the doubles that approximate them.

A decimal or a fraction in a file means exactly that number, not the nearest double. A row of doubles in an array means
their shortest decimals (0.1 is 1/10) if these sum to 1; otherwise it means their binary values, and the amount by which
it misses 1 is its *defect*.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.errors import ModelError
from stltool.numbers import NumberError, exact, shortest
from stltool.sizes import require_memory

Integers: TypeAlias = NDArray[Any]
"""int64 if numbers and denominator are below 2^62, else Python integers in an object array."""

LARGEST_SUM = 2**62  # bound on sums in int64


@dataclass(frozen=True, eq=False)
class Shares:
    """Numbers exactly: number k is numerator[k] / denominator."""

    numerator: Integers = field(repr=False)
    denominator: int

    def __getitem__(self, k: int) -> Fraction:
        return Fraction(int(self.numerator[k]), self.denominator)


@dataclass(frozen=True, eq=False)
class Fractions:
    """An MDP's probabilities, exactly: entry k is numerator[k] / denominator.

    numerator            (n_transitions,) integers      denominator          common to all of them
    initial              (n_states,) integers           initial_denominator  common to all of them
    """

    numerator: Integers = field(repr=False)
    denominator: int
    initial: Integers = field(repr=False)
    initial_denominator: int

    def defects(self, row_start: NDArray[np.int64]) -> tuple[Fraction, Fraction]:
        """The largest |Σ row − 1|, and that of the initial distribution; 0 if they are distributions."""
        sums = np.add.reduceat(self.numerator, row_start[:-1])
        rows = max(abs(int(sums.max()) - self.denominator), abs(int(sums.min()) - self.denominator))
        start = abs(sum(self.initial.tolist()) - self.initial_denominator)
        return Fraction(rows, self.denominator), Fraction(start, self.initial_denominator)

    def initial_share(self, s: int) -> Fraction:
        return Fraction(int(self.initial[s]), self.initial_denominator)


def over_one(values: Iterable[Fraction]) -> tuple[Integers, int]:
    """Fractions as integers, and their least common denominator."""
    known = list(values)
    denominator = math.lcm(*{value.denominator for value in known})
    require_memory(
        len(known) * max(denominator.bit_length() // 8, 8),
        f"{len(known)} probabilities over their common denominator of {denominator.bit_length()} bits",
        "round them to decimals of fewer digits",
    )
    found = [value.numerator * (denominator // value.denominator) for value in known]
    whole = all(abs(number) < LARGEST_SUM for number in (denominator, *found))  # so that rows can be summed
    return np.array(found, dtype=np.int64 if whole else object), denominator


def doubles_of(numerator: Integers, denominator: int) -> NDArray[np.float64]:
    """The doubles nearest to numerator / denominator, for numbers below 8."""
    if numerator.dtype != object and denominator < 2**50:  # both are doubles, and division rounds once
        quotients: NDArray[np.float64] = numerator / denominator
        return quotients
    unique, which = np.unique(numerator, return_inverse=True)
    return np.array([int(n) / denominator for n in unique])[which]


def decimals_of(values: NDArray[np.float64]) -> Shares:
    """The shortest decimals of doubles, exactly."""
    unique, which = np.unique(values, return_inverse=True)
    numerator, denominator = over_one(map(shortest, unique.tolist()))
    return Shares(numerator[which], denominator)


def of_doubles(
    values: NDArray[np.float64], row_start: NDArray[np.int64], decimals: bool = False
) -> tuple[Integers, int]:
    """Doubles as integers over one denominator: shortest decimals in rows where these sum to 1, else binary values.

    `decimals` takes the shortest decimals whatever their sums.
    """
    unique, which = np.unique(values, return_inverse=True)
    short = [shortest(value) for value in unique.tolist()]
    shares, denominator = over_one(short)
    numerator = shares[which]
    wrong = np.add.reduceat(numerator, row_start[:-1]) != denominator
    if decimals or not wrong.any():
        return numerator, denominator
    readings = [*short, *map(Fraction, unique.tolist())]
    taken, which = np.unique(which + len(unique) * np.repeat(wrong, np.diff(row_start)), return_inverse=True)
    shares, denominator = over_one(readings[k] for k in taken.tolist())
    return shares[which], denominator


def parsed(array: NDArray[Any]) -> NDArray[np.object_]:
    """Fractions from numbers and strings, element by element."""
    parsed: NDArray[np.object_] = np.frompyfunc(exact, 1, 1)(array)
    return parsed


def nearest(array: Any) -> Any:
    """An array or sparse matrix in doubles, itself if it is in doubles. Raises TypeError unless it contains numbers.

    Shorter floats are read as their shortest decimals: 0.1 in 32 bits is 0.1, not 0.10000000149.
    """
    if array.dtype.kind not in "biuf":
        raise TypeError
    doubles = array.astype(np.float64, copy=False)
    if array.dtype.kind == "f" and array.dtype.itemsize < 8:
        short, long = (m.data if hasattr(m, "data") and hasattr(m, "indptr") else m for m in (array, doubles))
        values, which = np.unique(short, return_inverse=True)
        long[...] = np.array([float(str(value)) for value in values])[which].reshape(long.shape)
    return doubles


def floats(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """A new array of doubles: numbers, or the nearest doubles of strings and Fractions."""
    try:
        array = np.asarray(values)
        doubles: NDArray[np.float64] = (parsed(array) if array.dtype.kind in "OU" else nearest(array)).astype(
            np.float64
        )
    except NumberError as error:
        raise ModelError(f"{what} does not contain numbers: {error}") from None
    except (TypeError, ValueError, OverflowError):
        raise ModelError(f"{what} does not contain numbers") from None
    if array.dtype.kind in "iu" and array.dtype.itemsize == 8:
        large = array[(array > 2**53) | (array < -(2**53))].tolist()
        wrong = next((value for value in large if int(float(value)) != value), None)
        if wrong is not None:
            raise ModelError(f"{what} contains {wrong}, which is not representable as a double; give floats")
    return doubles
