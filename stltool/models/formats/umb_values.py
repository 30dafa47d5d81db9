"""The binary files of a UMB file ↔ arrays: numbers, bit sets, texts, and the bits of variables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.models.costs import Amounts
from stltool.models.formats.archive import Archive
from stltool.models.formats.umb_index import Type
from stltool.models.fractions import LARGEST_SUM, Shares, over_one
from stltool.models.intervals import Intervals

I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
U8: TypeAlias = NDArray[np.uint8]

_WORD = 64  # bits that a bit set is padded to
_RATIONAL = 128  # bits of a rational, or a multiple


# ------------------------------------------------------------------------------------------------------------- reading


def array(archive: Archive, name: str, dtype: str, n: int) -> NDArray[Any]:
    """A file as n numbers of a dtype, in place; ModelError unless it has that size."""
    return np.frombuffer(_sized(archive, name, n * np.dtype(dtype).itemsize), dtype=dtype)


def _sized(archive: Archive, name: str, size: int) -> memoryview:
    view = archive.view(name)
    if len(view) != size:
        raise archive.fault(name, f"has {len(view)} bytes; by index.json it should have {size}")
    return view


def mapping(archive: Archive, name: str, n: int, last: int, to: str) -> I64:
    """Where the pieces of n things begin (n + 1,), ascending from 0 to `last`; without a file, one piece each."""
    if name not in archive:
        if n != last:
            raise archive.fault(name, f"is missing, although there are {n} of one and {last} {to}")
        return np.arange(n + 1, dtype=np.int64)
    given = array(archive, name, "<u8", n + 1)
    if given[0] != 0 or given[-1] != last or (given[1:] < given[:-1]).any():
        wrong = next((k for k in range(n) if given[k + 1] < given[k]), None)
        where = f"entry {wrong + 1} is smaller than the one before" if wrong is not None else (
            f"it goes from {given[0]} to {given[-1]}")  # fmt: skip
        raise archive.fault(name, f"is not a list of ascending numbers from 0 to {last}, the number of {to}: {where}")
    return given.astype(np.int64)


def bits(archive: Archive, name: str, n: int) -> NDArray[np.bool_]:
    """A set of n things."""
    data = np.frombuffer(_sized(archive, name, -(-n // _WORD) * _WORD // 8), dtype=np.uint8)
    found = np.unpackbits(data, bitorder="little").view(np.bool_)
    if found[n:].any():
        raise archive.fault(name, f"has bits behind the last of {n}; they must be 0")
    return found[:n]


def texts(archive: Archive, folder: str, n: int) -> list[str]:
    """n texts, in string-mapping.bin and strings.bin."""
    size = archive.size(f"{folder}/strings.bin") if f"{folder}/strings.bin" in archive else 0
    name = f"{folder}/string-mapping.bin"
    if name not in archive:
        raise archive.fault(name, "is missing")
    start = mapping(archive, name, n, size, "bytes of strings.bin").tolist()
    data = bytes(archive.view(f"{folder}/strings.bin")) if size else b""
    found = []
    for k in range(n):
        try:
            found.append(data[start[k] : start[k + 1]].decode())
        except UnicodeDecodeError:
            raise archive.fault(f"{folder}/strings.bin", f"is not UTF-8 in text {k}") from None
    return found


def amounts(archive: Archive, name: str, kind: Type, n: int) -> Amounts:
    """Numbers; NaN and infinities stay, for the model to refuse by name."""
    if kind.name == "double":
        return Amounts(array(archive, name, "<f8", n).astype(np.float64))
    if kind.name == "rational":
        shares = rationals(archive, name, kind.size, n)
        return Amounts.of_shares(shares.numerator, shares.denominator)
    given = array(archive, name, "<i8" if kind.name == "int" else "<u8", n)
    largest = max(abs(int(given.min())), int(given.max())) if n else 0
    numerator = given.astype(np.int64) if largest < LARGEST_SUM else np.array(given.tolist(), dtype=object)
    return Amounts.of_shares(numerator, 1)


def probabilities(archive: Archive, name: str, kind: Type, n: int) -> Floats | Shares | Intervals:
    """Probabilities of that type."""
    if kind.name == "double":
        return array(archive, name, "<f8", n).astype(np.float64)
    if kind.name == "rational":
        return rationals(archive, name, kind.size, n)
    if kind.name == "double-interval":
        ends = array(archive, name, "<f8", 2 * n)
    else:
        shares = rationals(archive, name, kind.size // 2, 2 * n)
        lower, upper = (Shares(shares.numerator[i::2], shares.denominator) for i in (0, 1))
        return Intervals.of_shares(lower, upper)
    return Intervals(ends[::2].astype(np.float64), ends[1::2].astype(np.float64))


def rationals(archive: Archive, name: str, size: int, n: int) -> Shares:
    """Exact numbers of `size` bits each: a signed numerator, and a denominator that is not 0."""
    words = size // _RATIONAL
    data = np.frombuffer(_sized(archive, name, n * size // 8), dtype=np.uint8).reshape(n, 2, 8 * words)
    if not data[:, 1].any(axis=1).all():
        k = int(np.flatnonzero(~data[:, 1].any(axis=1))[0])
        raise archive.fault(name, f"divides by zero in entry {k}")
    if words == 1:
        numerator = np.ascontiguousarray(data[:, 0]).view("<i8").ravel().astype(np.int64)
        below = np.ascontiguousarray(data[:, 1]).view("<u8").ravel()
        denominators = np.unique(below)
        one = 1
        for denominator in denominators.tolist():
            one = np.lcm(np.array([one], dtype=object), denominator)[0]
            if one >= LARGEST_SUM:
                break
        largest = max(abs(int(numerator.min(initial=0))), int(numerator.max(initial=0)))
        if one < LARGEST_SUM and largest * (one // int(denominators[0]) if n else 1) < LARGEST_SUM:
            factor = np.array([one // d for d in denominators.tolist()], dtype=np.int64)
            return Shares(numerator * factor[np.searchsorted(denominators, below)], int(one))
    unique, which = np.unique(data.reshape(n, -1), axis=0, return_inverse=True)
    half = 8 * words
    values = [
        Fraction(int.from_bytes(row[:half], "little", signed=True), int.from_bytes(row[half:], "little"))
        for row in map(bytes, unique)
    ]
    found, denominator = over_one(values)
    return Shares(found[which.ravel()], denominator)


def bits_of(rows: U8, offset: int, size: int) -> NDArray[np.uint64]:
    """Bits `offset` … `offset` + size − 1 of every row, size ≤ 64, as numbers."""
    begin, shift = divmod(offset, 8)
    value = np.zeros(len(rows), dtype=np.uint64)
    for k in range(-(-(shift + size) // 8)):
        byte = rows[:, begin + k].astype(np.uint64)
        at = 8 * k - shift
        value |= byte << np.uint64(at) if at >= 0 else byte >> np.uint64(-at)
    return value & np.uint64(2**size - 1)


def integers_of(rows: U8, offset: int, size: int, signed: bool) -> list[int]:
    """The same for any size, as Python's integers."""
    found = [0] * len(rows)
    for k in range(0, size, 64):
        part = bits_of(rows, offset + k, min(64, size - k)).tolist()
        found = [value | (more << k) for value, more in zip(found, part, strict=True)]
    if signed:
        top = 1 << (size - 1)
        found = [value - 2 * top if value & top else value for value in found]
    return found


# ------------------------------------------------------------------------------------------------------------- writing


def packed_bits(values: NDArray[np.bool_]) -> bytes:
    size = -(-len(values) // _WORD) * _WORD // 8
    return np.packbits(values, bitorder="little").tobytes().ljust(size, b"\0")


def packed_texts(values: Iterable[str]) -> tuple[bytes, bytes]:
    """string-mapping.bin and strings.bin."""
    encoded = [value.encode("utf-8", errors="backslashreplace") for value in values]
    start = np.zeros(len(encoded) + 1, dtype="<u8")
    np.cumsum([len(one) for one in encoded], out=start[1:])
    return start.tobytes(), b"".join(encoded)


def packed_rationals(shares: Shares, least: int = 0) -> tuple[int, bytes]:
    """The size of a number in bits, at least `least`, and the numbers in lowest terms."""
    unique, which = np.unique(shares.numerator, return_inverse=True)
    values = [Fraction(int(number), shares.denominator) for number in unique.tolist()]
    half = max(64 * max((-(-_width(value) // 64) for value in values), default=1), least // 2)
    table = np.frombuffer(
        b"".join(
            value.numerator.to_bytes(half // 8, "little", signed=True) + value.denominator.to_bytes(half // 8, "little")
            for value in values
        ),
        dtype=np.uint8,
    ).reshape(len(values), -1)
    return 2 * half, table[which].tobytes()


def _width(value: Fraction) -> int:
    return max(abs(value.numerator).bit_length() + 1, value.denominator.bit_length() + 1)


def whole_numbers(values: Sequence[float] | Floats) -> bool:
    """Whether doubles are integers that every tool represents exactly."""
    given = np.asarray(values)
    return bool(((given == np.rint(given)) & (np.abs(given) <= 2**53)).all())
