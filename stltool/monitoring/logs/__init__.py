"""A trace file → signals with a sample per step.

load_trace("log.csv", step="0.1s")  →  {"x": float64 (n_steps,), "door": bool (n_steps,), …}

recording.py     what a reader makes of a file, and what it is asked for
readers.py       the reader of a file, by its extension; those of other packages
dialect.py, text.py, dates.py, npz.py, parquet.py, mcap.py     the formats
missing.py       samples without a value
clock.py         rows → steps: the times against the declared step, or on its grid
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from stltool.arguments import described, one_of, real, require, texts
from stltool.arguments import path as path_of
from stltool.errors import SettingsError, UnusedTimeWarning, named
from stltool.logic.formula import Composable, label_names, variables
from stltool.logic.quantities import Duration, duration
from stltool.logic.task import Task
from stltool.monitoring.logs.clock import NO_TIME, TOLERANCE, Clock, Resample, Timing, on_steps
from stltool.monitoring.logs.readers import read_recording, trace_readers
from stltool.monitoring.logs.recording import Asked, Missing, Recording, Signals, option
from stltool.numbers import NumberError

__all__ = ["Log", "Reading", "Recording", "load_trace", "trace_readers"]


@dataclass(frozen=True)
class Reading:
    """How logs are read: everything but the step and the names, which a task gives."""

    time: str | None = None
    resample: Resample | None = None
    tolerance: float = TOLERANCE
    decimal: str = "."
    missing: Missing = "error"

    def __post_init__(self) -> None:
        require(self.time, str, "the time of a trace", f"name its column, or {option('time', 'none')}", optional=True)
        if self.resample is not None:
            one_of(self.resample, "resample", get_args(Resample))
        one_of(self.missing, "missing", get_args(Missing))
        one_of(self.decimal, "decimal", (".", ","))
        if not 0 <= real(self.tolerance, "tolerance", "0.01") < 0.5:
            raise SettingsError(
                f"{named('tolerance')} is {described(self.tolerance)}; give a part of a step below a half"
            )
        if self.time == NO_TIME and self.resample is not None:
            raise SettingsError(
                f"{option('resample', self.resample)} needs the times, which "
                f"{option('time', 'none')} leaves unused; keep one of them"
            )

    @property
    def times_asked(self) -> str | None:
        """The argument that needs a step, as a message shows it; None if there is none."""
        if self.resample is not None:
            return option("resample", self.resample)
        return option("time", self.time) if self.time is not None and self.time != NO_TIME else None

    def untimed(self) -> Reading:
        """The same without times, for tasks without a step."""
        return replace(self, time=None, resample=None)

    def clock(self, step: Duration | None) -> Clock:
        """How times become steps of a declared duration. SettingsError if times are asked for and none is declared."""
        if step is None and self.times_asked is not None:
            raise SettingsError(
                f"{self.times_asked}: the duration of a step is not declared; a task file does so by a line such as "
                f"step = 0.1s, a formula by {option('step', '0.1s')}"
            )
        return Clock(step, self.time, self.resample, float(self.tolerance))

    def log(self, path: Path, names: Sequence[str] | None, step: Duration | None, labels: Collection[str] = ()) -> Log:
        """The signals of a file, with a sample per step."""
        clock = self.clock(step)
        column = None if self.time == NO_TIME else self.time
        recording = read_recording(path, Asked(names, column, clock.used, self.decimal, self.missing))
        signals, timing = on_steps(recording, clock, _shown(path), labels)
        return Log(path, signals, timing.beside(clock, names or ()))


@dataclass(frozen=True, eq=False)
class Log:
    """A file's signals, and what was done with its times."""

    path: Path
    signals: Signals
    timing: Timing

    @property
    def where(self) -> str:
        return _shown(self.path)


def load_trace(
    path: str | Path,
    names: Iterable[str] | Composable | None = None,
    *,
    time: str | None = None,
    step: str | Duration | None = None,
    resample: Resample | None = None,
    tolerance: float = TOLERANCE,
    decimal: str = ".",
    missing: Missing = "error",
) -> Signals:
    """The signals of a trace file: name → array (n_steps,) of numbers or Booleans; of an .npz also (n_traces, n_steps).

    path        .csv, .tsv (also .gz; a line of names, then a row per step), .npz (an array per signal), .parquet (a
                column per signal; needs pyarrow), .mcap (a signal per field; needs mcap), others by
                `stl.trace_readers`; "-" is CSV from standard input
    names       the signals to read, so that other columns need not be numbers; or the formula or task that reads them,
                of which labels are never interpolated and a task's step is the default of `step`
    step        the duration of a step, such as "0.1s"; the times of the rows are then compared with it
    time        the column of times, optionally with its unit ("t [ms]"); by default the one called time, t or
                timestamp, in any case, with or without a unit in brackets. "none": rows are steps, whatever the times
    resample    "hold" or "linear" puts the signals on the step's grid, from the first time on
    tolerance   by how much of a step a time may be off
    decimal     "," in files with decimal commas
    missing     "hold" repeats the last value where there is none, "drop" leaves such rows out

    Without a step rows are steps, and UnusedTimeWarning reports a column of times. Raises FileError if the file does
    not have the format of its extension, TraceError, with the position, if its content is not a trace or its times do
    not fit the step, NameLookupError if a name is missing, SettingsError for arguments that do not go together, and
    SizeError before allocating more memory than there is.
    """
    path = path_of(path, "load_trace's path")
    labels: Collection[str] = ()
    if isinstance(names, Composable):
        formula = names._formula()
        labels = set(label_names(formula))
        step = names.step if step is None and isinstance(names, Task) else step
        names = [*variables(formula), *labels]
    wanted = None if names is None else list(dict.fromkeys(texts(names, "load_trace's names")))
    reading = Reading(time, resample, tolerance, decimal, missing)
    log = reading.log(path, wanted, step_of(step), labels)
    if log.timing.unused is not None:
        told = f"{log.where}: rows are steps; the {log.timing.unused} is not used, since no step is declared: step=…"
        warnings.warn(told, UnusedTimeWarning, stacklevel=2)
    return log.signals


def step_of(given: Any) -> Duration | None:
    """The duration of a step, given as text."""
    if given is None or isinstance(given, Duration):
        return given
    try:
        found = duration(given) if isinstance(given, str) else None
    except NumberError:
        found = None
    if found is None or found.seconds <= 0:
        raise SettingsError(f"{named('step')} is {described(given)}; give a time, such as 0.1s")
    return found


def _shown(path: Path) -> str:
    return "standard input" if str(path) == "-" else str(path)
