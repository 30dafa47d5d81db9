"""Text files of numbered lines, plain or gzipped (.gz), as PRISM and Storm write them: from the lines to arrays.

Two readers accept the same files. A kernel (kernels/lines.py) reads large ones from their bytes; whatever it does not
take for certain goes to the other, which reads line by line and knows the fault of a line. Files are read block by
block; of a packed file, the size is measured before anything is kept.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from stltool.errors import MOST_FAULTS, FileError, ModelError, SizeError, all_told
from stltool.files import text_of
from stltool.models.fractions import LARGEST_SUM, Integers, Shares, over_one
from stltool.numbers import NumberError, index, read, shortest, shown
from stltool.sizes import bytes_text, memory_limit, require_memory

LARGE = 1 << 19  # bytes from which loading the kernel pays
_BLOCK = 1 << 22  # bytes read at a time
_SHOWN = 80  # characters of a line that a message quotes
_SHORTEST = 4  # bytes of an entry
_BYTES = 64  # of memory for each entry
_PER_BYTE = 8  # bytes of memory for each one of text
_KNOWN = 1 << 10  # texts for which there is room at first
RANGE, SHORTEST = -2, 10**15  # an interval, as in kernels/lines.py; decimals below w / 10^places are the shortest
_BLANKS = re.compile(r"[ \t\r]+")
_WHITE = " \t\r\n"  # the only white space; other characters of this kind are part of words

_Item = TypeVar("_Item")


# -------------------------------------------------------------------------------------------------------------- faults


class FileFaults:
    """The faults of files, in order: the first messages, and the number of all."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.count = 0

    def add(self, message: str) -> None:
        self.count += 1
        if len(self.told) < MOST_FAULTS:
            self.told.append(message)

    def line(self, path: Path, number: int, line: str, remedy: str) -> None:
        self.add(f"{path}, line {number}: {cut(line)!r}: {remedy}")

    def error(self) -> ModelError:
        return ModelError(all_told(self.told, self.count))


def cut(line: str) -> str:
    return line if len(line) <= _SHOWN else line[: _SHOWN - 3] + "…"


def words_of(line: str) -> list[str]:
    """The words of a line without blanks around it."""
    return _BLANKS.split(line)


# --------------------------------------------------------------------------------------------------------------- files


@dataclass(frozen=True)
class File:
    """A text file; `what` is its role ("label file")."""

    path: Path
    what: str

    @property
    def packed(self) -> bool:
        return self.path.suffix.lower() == ".gz"

    @cached_property
    def size(self) -> int:
        """Bytes, unpacked; SizeError, without keeping any, if reading them could take more memory than there is."""
        if not self.packed:
            with _readable(self):
                return self.path.stat().st_size
        size, most = 0, memory_limit()
        with _readable(self), gzip.open(self.path) as file:
            while piece := file.read(_BLOCK):
                size += len(piece)
                if size * _PER_BYTE > most:
                    raise SizeError(
                        f"{self.path}: unpacked, it has more than {bytes_text(size)} of text, which would take "
                        f"{bytes_text(size * _PER_BYTE)} of memory; {bytes_text(most)} may be used; use a part of it"
                    )
        return size

    def blocks(self) -> Iterator[bytes]:
        """The content in pieces that end with a line."""
        rest: list[bytes] = []
        with _readable(self), self._opened() as file:
            first = True
            while piece := file.read(_BLOCK):
                if first and piece.startswith(b"\xef\xbb\xbf"):
                    piece = piece[3:]
                first = False
                end = piece.rfind(b"\n") + 1
                if not end:
                    rest.append(piece)
                    continue
                yield b"".join([*rest, piece[:end]])
                rest = [piece[end:]]
        if last := b"".join(rest):
            yield last

    def _opened(self) -> IO[bytes]:
        return cast(IO[bytes], gzip.open(self.path)) if self.packed else self.path.open("rb")

    def line_text(self, number: int, line: bytes) -> str:
        """A line decoded. FileError if it is not text."""
        return text_of(line, f"{self.path}, line {number}", self.what).strip(_WHITE)


@contextmanager
def _readable(file: File) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise FileError(f"{file.path}: there is no such {file.what}") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise FileError(f"{file.path}: not a gzip file, or cut off: {error}; pack it again") from None
    except OSError as error:
        raise FileError(f"{file.path}: this {file.what} cannot be read: {error.strerror}") from None


class Cursor:
    """A place in a file: what is before it has been read.

    block   the bytes of some lines       at    where the next line begins in it
    line    the number of that line       comments   (number, text) of the lines with # so far
    """

    def __init__(self, file: File) -> None:
        self.file = file
        self._blocks = file.blocks()
        self.block, self.at, self.line = b"", 0, 1
        self.comments: list[tuple[int, str]] = []

    def more(self) -> bool:
        """Whether there are lines left in the block, or a next one."""
        if self.at >= len(self.block):
            self.block, self.at = next(self._blocks, b""), 0
        return bool(self.block)

    @property
    def bytes(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.block, dtype=np.uint8)

    def peek(self) -> str | None:
        """The next line with content, without its blanks; None at the end."""
        while self.more():
            end = self.block.find(b"\n", self.at)
            line = self.block[self.at : end if end >= 0 else len(self.block)].strip(_WHITE.encode())
            if line and not line.startswith(b"#"):
                return self.file.line_text(self.line, line)
            if line:
                self.comments.append((self.line, line.decode(errors="replace")))
            self.skip()
        return None

    def skip(self) -> None:
        """Leave a line behind."""
        end = self.block.find(b"\n", self.at)
        self.at = end + 1 if end >= 0 else len(self.block)
        self.line += 1

    def take(self) -> tuple[int, str] | None:
        """The number and the text of the next line with content, which is left behind."""
        text = self.peek()
        if text is None:
            return None
        number = self.line
        self.skip()
        return number, text


# ---------------------------------------------------------------------------------------------------- tables of texts


class Texts(Generic[_Item]):
    """What texts mean, by number, and where the kernel finds the numbers."""

    def __init__(self, meaning: Callable[[str], _Item], double: Callable[[_Item], float] | None = None) -> None:
        self._meaning, self._double = meaning, double
        self._numbers: dict[str, int] = {}
        self.items: list[_Item] = []
        self._slots = np.full(4 * _KNOWN, -1, dtype=np.int32)
        self._spans = np.zeros((_KNOWN, 2), dtype=np.int64)
        self._arena = np.zeros(16 * _KNOWN, dtype=np.uint8)
        self._doubles = np.zeros(_KNOWN)
        self._listed = False

    def number(self, text: str) -> int:
        """Its number; what `meaning` raises, if it raises."""
        if text not in self._numbers:
            item = self._meaning(text)
            number = len(self.items)
            if self._double is not None:
                if number == len(self._doubles):
                    self._doubles = np.concatenate([self._doubles, np.zeros(number)])
                self._doubles[number] = self._double(item)
            self._numbers[text] = number
            self.items.append(item)
            if self._listed:
                self._list(text, number)
        return self._numbers[text]

    @property
    def doubles(self) -> NDArray[np.float64]:
        return self._doubles

    @property
    def tables(self) -> tuple[NDArray[Any], ...]:
        """slots, spans and arena for `kernels.lines.find`."""
        if not self._listed:
            self._listed = True
            for text, number in self._numbers.items():
                self._list(text, number)
        return self._slots, self._spans, self._arena

    def _list(self, text: str, number: int) -> None:
        data = np.frombuffer(text.encode(), dtype=np.uint8)
        begin = int(self._spans[number - 1, 1]) if number else 0
        if number == len(self._spans):
            self._spans = np.concatenate([self._spans, np.zeros_like(self._spans)])
        while begin + len(data) > len(self._arena):
            self._arena = np.concatenate([self._arena, np.zeros_like(self._arena)])
        self._spans[number], self._arena[begin : begin + len(data)] = (begin, begin + len(data)), data
        if 2 * number >= len(self._slots):
            self._slots = np.full(2 * len(self._slots), -1, dtype=np.int32)
            for other in range(number):
                self._slot(other)
        self._slot(number)

    def _slot(self, number: int) -> None:
        from stltool.kernels.lines import code_of

        begin, end = self._spans[number]
        at = code_of(self._arena, begin, end) & (len(self._slots) - 1)
        while self._slots[at] >= 0:
            at = (at + 1) & (len(self._slots) - 1)
        self._slots[at] = number


# -------------------------------------------------------------------------------------------------------------- numbers


class Written(Shares):
    """Numbers as written in a file, w / 10^places or texts; integers over one denominator are made when needed.

    places   −1: text number w
    """

    def __init__(self, w: NDArray[np.int64], places: NDArray[np.int8], texts: list[Fraction]) -> None:
        vars(self).update(w=w, places=places, texts=texts)

    w: NDArray[np.int64]
    places: NDArray[np.int8]
    texts: list[Fraction]

    def at(self, kept: NDArray[Any]) -> Written:
        return Written(self.w[kept], self.places[kept], self.texts)

    def __getitem__(self, k: int) -> Fraction:
        places, w = int(self.places[k]), int(self.w[k])
        return self.texts[w] if places < 0 else Fraction(w, 10**places)

    @cached_property
    def _over_one(self) -> tuple[Integers, int]:
        plain = self.places >= 0
        most = int(self.places.max(initial=0))
        if plain.all() and 10**most < LARGEST_SUM:
            tens = 10 ** (most - np.arange(most + 1, dtype=np.int64))
            largest = max(
                (
                    int(np.abs(self.w[self.places == k]).max()) * 10 ** (most - k)
                    for k in np.unique(self.places).tolist()
                ),
                default=0,
            )
            if largest < LARGEST_SUM:
                numerator = self.w * tens[self.places]
                common = int(np.gcd(np.gcd.reduce(numerator, initial=0), 10**most))
                numerator //= common
                return numerator, 10**most // common
        key, which = np.unique(np.stack([self.w, self.places.astype(np.int64)]), axis=1, return_inverse=True)
        values = (
            self.texts[w] if places < 0 else Fraction(w, 10**places) for w, places in zip(*key.tolist(), strict=True)
        )
        shares, denominator = over_one(values)
        return shares[which.ravel()], denominator

    @property
    def numerator(self) -> Integers:
        return self._over_one[0]

    @property
    def denominator(self) -> int:
        return self._over_one[1]


# -------------------------------------------------------------------------------------------------------------- entries


@dataclass(frozen=True)
class Form:
    """What the lines of a file are.

    limits   what each index must be below: (states,) of .srew, (states, states) of a chain, with choices three
    worded   whether a word may follow
    ranged   whether a number may be an interval
    by_row   whether a line is a whole row: state, then number:successor …
    shown    the form of a line, for messages; `number` describes its number
    """

    limits: tuple[int, ...]
    shown: str
    number: str
    worded: bool = False
    ranged: bool = False
    by_row: bool = False

    @property
    def n_states(self) -> int:
        return self.limits[0]


@dataclass(eq=False)
class Entries:
    """The entries of a file, in the order of its lines.

    lead     (indices − 1, n), all but the last index; `last` (n,)
    word     (n,) numbers of `words`, −1 for none
    value    (n,) doubles, or the lower ends of intervals; `upper` (n,) or None
    exact    the numbers exactly (without intervals)
    inexact  whether ends of intervals are not the shortest decimals of their doubles
    faulty   the line of each fault, and (state, choice) if it is known of what; None: of a line that has no place
    """

    file: File
    form: Form
    begin: int  # the number of the line before the first one
    lead: NDArray[np.int32]
    last: NDArray[np.int32]
    value: NDArray[np.float64]
    upper: NDArray[np.float64] | None
    exact: Written
    word: NDArray[np.int32]
    words: list[str]
    faults: list[tuple[int, str, str]] = field(default_factory=list)
    n_faults: int = 0
    skipped: set[int] = field(default_factory=set)
    faulty: set[tuple[int, ...]] = field(default_factory=set)
    garbled: bool = False
    inexact: bool = False

    def __len__(self) -> int:
        return len(self.value)

    @property
    def rounded(self) -> bool:
        """Whether ends of intervals, or numbers beside them, are not the shortest decimals of their doubles."""
        exact, points = self.exact, self.exact.places != RANGE
        long = np.flatnonzero(points & ((exact.places < 0) | (np.abs(exact.w) >= SHORTEST)))
        return self.inexact or any(exact[k] != shortest(float(self.value[k])) for k in long.tolist())

    def lines_of(self, which: Iterable[int]) -> dict[int, tuple[int, str]]:
        """The line of entries, its number and its text: reads the file again."""
        wanted = sorted(set(which))
        found: dict[int, tuple[int, str]] = {}
        cursor, first, k = Cursor(self.file), 0, 0
        while k < len(wanted) and (taken := cursor.take()) is not None:
            number, text = taken
            if number <= self.begin or number in self.skipped:
                continue
            first += sum(":" in word for word in words_of(text)) if self.form.by_row else 1
            while k < len(wanted) and wanted[k] < first:
                found[wanted[k]] = taken
                k += 1
        return found


class _Reading:
    """Entries while they are read."""

    def __init__(self, cursor: Cursor, form: Form, room: int) -> None:
        self.cursor, self.form = cursor, form
        room = max(min(room, cursor.file.size // _SHORTEST + 1), 1)
        require_memory(_BYTES * room, f"{cursor.file.path}: reading {room} entries", "use a part of the model")
        width = 3 if form.by_row else len(form.limits)
        self.lead, self.last = np.empty((width - 1, room), dtype=np.int32), np.empty(room, dtype=np.int32)
        self.value, self.w = np.empty(room), np.empty(room, dtype=np.int64)
        self.places, self.word = np.empty(room, dtype=np.int8), np.empty(room, dtype=np.int32)
        self.upper = np.empty(0)
        self.row = 0
        self.texts: Texts[Fraction] = Texts(_number, float)
        self.named: Texts[str] = Texts(str)
        self.seen = np.zeros(form.n_states if form.by_row else 0, dtype=np.int32)
        self.begin = cursor.line - 1
        self.faults: list[tuple[int, str, str]] = []
        self.n_faults, self.garbled, self.inexact = 0, False, False
        self.skipped: set[int] = set()
        self.faulty: set[tuple[int, ...]] = set()

    @property
    def entries(self) -> Entries:
        n = self.row
        return Entries(
            self.cursor.file, self.form, self.begin, self.lead[:, :n], self.last[:n], self.value[:n],
            self.upper[:n] if len(self.upper) else None,
            Written(self.w[:n], self.places[:n], self.texts.items), self.word[:n], self.named.items,
            self.faults, self.n_faults, self.skipped, self.faulty, self.garbled, self.inexact,
        )  # fmt: skip

    def grow(self) -> None:
        room = len(self.value) * 2
        require_memory(_BYTES * room, f"{self.cursor.file.path}: reading {room} entries", "use a part of the model")

        def grown(array: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([array, np.empty_like(array)], axis=-1)

        self.lead, self.last = grown(self.lead), grown(self.last)
        self.value, self.w = grown(self.value), grown(self.w)
        self.places, self.word = grown(self.places), grown(self.word)
        if len(self.upper):
            self.upper = grown(self.upper)

    def widen(self) -> None:
        self.upper = self.value.copy()

    # ------------------------------------------------------------------------------------------------- line by line

    def line_by_line(self) -> None:
        while (taken := self.cursor.take()) is not None:
            self.line(*taken)

    def line(self, number: int, text: str) -> None:
        """Add the entries of a line, or its fault."""
        words = words_of(text)
        try:
            if self.form.by_row:
                self._row(words)
            else:
                self._entry(words)
        except _Fault as fault:
            self.n_faults += 1
            self.skipped.add(number)
            if len(self.faults) < MOST_FAULTS:
                self.faults.append((number, cut(text), fault.remedy))
            if fault.place is None:
                self.garbled = True
            else:
                self.faulty.add(fault.place)

    def _entry(self, words: list[str]) -> None:
        form = self.form
        n = len(form.limits)
        written = f'write "{form.shown}"'
        try:
            found = [index(word) for word in words[: n - 1 or 1]]
        except NumberError:
            found = []
        if len(found) < (n - 1 or 1):
            raise _Fault(f"{written} with {form.number}")
        if found[0] >= form.limits[0]:
            raise _Fault(_outside(form))
        if n > 2 and found[1] >= form.limits[1]:
            raise _Fault(f"a state has at most {form.limits[1]} choices")
        place = tuple(found)
        try:
            if n > 1:
                found.append(index(words[n - 1]))
            number = words[n]
            if len(words) > n + 1 + form.worded:
                raise _Fault(written, place)
            lower, upper = self._ends(number)
        except IndexError:
            raise _Fault(written, place) from None
        except NumberError as error:
            raise _Fault(f"{error}; {written} with {form.number}", place) from None
        if found[-1] >= form.limits[-1]:
            raise _Fault(_outside(form), place)
        word = words[n + 1] if len(words) > n + 1 else None
        self._add(found, number, lower, upper, word)

    def _row(self, words: list[str]) -> None:
        form = self.form
        written = f'write "{form.shown}"'
        try:
            state = index(words[0])
        except NumberError:
            raise _Fault(written) from None
        if state >= form.n_states:
            raise _Fault(_outside(form))
        word = None
        if form.worded and len(words) > 1 and ":" not in words[-1]:
            word = words.pop()
        place = (state, int(self.seen[state]))
        found = []
        self.seen[state] += 1
        for pair in words[1:]:
            number, colon, successor = pair.partition(":")
            try:
                target = index(successor)
                lower, upper = self._ends(number)
            except NumberError as error:
                raise _Fault(f"{error}; {written} with {form.number}", place) from None
            if not colon:
                raise _Fault(written, place)
            if target >= form.n_states:
                raise _Fault(_outside(form), place)
            found.append((target, number, lower, upper))
        for target, number, lower, upper in found:
            self._add([*place, target], number, lower, upper, word)

    def _ends(self, text: str) -> tuple[float, float]:
        if not (self.form.ranged and text.startswith("[") and text.endswith("]")):
            value = self.texts.doubles[self.texts.number(text)]
            return value, value
        ends = text[1:-1].split(",")
        if len(ends) != 2:
            raise NumberError(f"{text!r} is not an interval")
        lower, upper = (_number(end) for end in ends)
        self.inexact |= any(shortest(float(end)) != end for end in (lower, upper))
        return float(lower), float(upper)

    def _add(self, found: list[int], text: str, lower: float, upper: float, word: str | None) -> None:
        if self.row == len(self.value):
            self.grow()
        row = self.row
        self.lead[:, row], self.last[row] = found[:-1], found[-1]
        if text.startswith("["):
            if not len(self.upper):
                self.widen()
            self.w[row], self.places[row] = 0, RANGE
        else:
            self.w[row], self.places[row] = self.texts.number(text), -1
        self.value[row] = lower
        if len(self.upper):
            self.upper[row] = upper
        self.word[row] = self.named.number(word) if word is not None else -1
        self.row += 1

    # ------------------------------------------------------------------------------------------------- by the kernel

    def by_kernel(self) -> None:
        from stltool.kernels import lines as kernels

        cursor, form = self.cursor, self.form
        limits = np.array(form.limits, dtype=np.int64)
        while cursor.more():
            texts, named = (*self.texts.tables, self.texts.doubles), self.named.tables
            into: Any = self.lead, self.last, self.value, self.upper, self.w, self.places, self.word, texts, named
            data = cursor.bytes
            where = data, cursor.at, len(data), cursor.line, self.row
            if form.by_row:
                ended = kernels.rows(*where, form.n_states, form.worded, self.seen, *into)
            else:
                ended = kernels.entries(*where, limits, form.worded, *into)
            status, cursor.at, cursor.line, self.row, unknown = ended
            match status:
                case kernels.FULL:
                    self.grow()
                case kernels.WIDE if form.ranged:
                    self.widen()
                case kernels.TEXT | kernels.WORD:
                    self._learn(cursor, unknown, status == kernels.WORD)
                case kernels.ODD | kernels.WIDE:
                    taken = cursor.take()
                    assert taken is not None
                    self.line(*taken)

    def _learn(self, cursor: Cursor, at: int, is_word: bool) -> None:
        """Add the text at `at` to its table; its line is faulty if it has no meaning."""
        end = cursor.block.find(b"\n", at)
        stop = end if end >= 0 else len(cursor.block)
        cursor.file.line_text(cursor.line, cursor.block[cursor.at : stop])
        text = words_of(cursor.block[at:stop].decode().strip(_WHITE))[0]
        if not is_word and self.form.by_row:
            text = text.partition(":")[0]
        table: Texts[Any] = self.named if is_word else self.texts
        before = len(table.items)
        with suppress(NumberError):
            table.number(text)
        if len(table.items) == before:
            taken = cursor.take()
            assert taken is not None
            self.line(*taken)


@dataclass
class _Fault(Exception):
    """A fault of a line: the remedy, and of which (state, choice), if that can be told."""

    remedy: str
    place: tuple[int, ...] | None = None


def _outside(form: Form) -> str:
    return f"states are 0 … {form.n_states - 1} by the first line"


def _number(text: str) -> Fraction:
    value = read(text)
    try:
        double = float(value)
    except OverflowError:
        raise NumberError(f"{shown(text)} is too large for a double") from None
    if value and not double:
        raise NumberError(f"{shown(text)} is too small for a double; write 0, or leave the line out")
    return value


def read_entries(cursor: Cursor, form: Form, room: int) -> Entries:
    """The entries from the cursor to the end of the file, about `room`. Raises FileError, SizeError."""
    reading = _Reading(cursor, form, room)
    if cursor.file.size >= LARGE:
        reading.by_kernel()
    else:
        reading.line_by_line()
    return reading.entries
