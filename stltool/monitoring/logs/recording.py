"""What a reader makes of a trace file, before its rows become steps; and what it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import Card, Displayed, counted
from stltool.errors import FileError, NameLookupError, TraceError, named
from stltool.logic.names import near_names
from stltool.streams import control_character

Signals: TypeAlias = dict[str, NDArray[Any]]
Missing: TypeAlias = Literal["error", "hold", "drop"]
Times: TypeAlias = NDArray[Any] | Mapping[str, NDArray[Any]]

COPIES = 2.5  # of the table in memory, at most, while it is read
SHORTER = "give a shorter part of the trace, or name fewer signals"
NEEDED = "every step needs a number"


def option(argument: str, value: str) -> str:
    """An argument with its value, in a message."""
    return named(argument, f'{argument}="{value}"')


WAYS = f"{option('missing', 'hold')} repeats the last, {option('missing', 'drop')} drops the row"


def no_value(what: str = "no value") -> str:
    """The fault of a sample without a value, with the remedy."""
    return f"{what}; every step needs one: {WAYS}"


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Displayed):
    """The content of a trace file. Readers of other formats (`stl.trace_readers`) return it.

    signals   name → array (n_rows,), or (n_traces, n_rows) for a batch, of numbers or Booleans
    times     when the rows were recorded: an array (n_rows,), or of the signals' shape, of seconds, or of NumPy's
              datetime64 or timedelta64; name → array for signals that have rows of their own; None if it is not known
    clock     what the times are called, such as "column t"
    missing   name → Booleans of the signal's shape, true where it has no value; so is NaN in `signals`
    first     the line of the first row, if every row is a line of text
    rows      the number of every row in the file, from 0, if some were left out
    """

    signals: Mapping[str, NDArray[Any]]
    times: Times | None = None
    clock: str | None = None
    missing: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    first: int | None = None
    rows: NDArray[np.int64] | None = None

    def place(self, *rows: int) -> str:
        """Rows, which are counted from 1, and their lines."""
        many = "s"[: len(rows) > 1]
        own = [row if self.rows is None else int(self.rows[row]) for row in rows]
        numbers = " and ".join(f"{row + 1}" for row in own)
        lines = "" if self.first is None else " and ".join(f"{row + self.first}" for row in own)
        return f"row{many} {numbers}" + (f" (line{many} {lines})" if lines else "")

    def _card(self) -> Card:
        rows = {name: "×".join(map(str, np.shape(values))) for name, values in self.signals.items()}
        facts = {"times": self.clock or ("given" if self.times is not None else "none")}
        return Card(f"Recording of {counted(len(rows), 'signal')}", [facts], (("signal", "samples"), [*rows.items()]))


@dataclass(frozen=True)
class Asked:
    """What a reader is asked for: signals, or all of them; the time, if the rows are judged against a step.

    time      the column that the user named
    timed     whether the times are needed
    decimal   the sign of a decimal in text
    missing   what becomes of samples without a value
    """

    names: Sequence[str] | None = None
    time: str | None = None
    timed: bool = False
    decimal: str = "."
    missing: Missing = "error"


def chosen(where: str, known: Sequence[str], names: Sequence[str] | None, what: str) -> list[str]:
    """The names to read: all names in the file, or those requested."""
    there = set(known)
    for name in names or ():
        if name not in there:
            raise NameLookupError(f"{where}: there is no {what} {name}; {near_names(name, known)}")
    read = list(known if names is None else names)
    for name in read:
        if control := control_character(name):
            raise TraceError(f"{where}: the {what} {name!r} has the control character {control} in its name; rename it")
    return read


@contextmanager
def faults(where: str, what: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of the system and of a format's library into a FileError."""
    caught: tuple[type[Exception], ...] = (OSError, *kinds)
    try:
        yield
    except caught as fault:
        told = fault.strerror if isinstance(fault, OSError) and fault.strerror else str(fault).partition("\n")[0]
        raise FileError(f"{where}: cannot be read as {what}: {told or type(fault).__name__}") from None
