"""The clock of a log: its times are held against the declared step, and signals are put on the step's grid.

Row i, at time s_i, is step i if |s_i − s_0 − i·step| ≤ tolerance·step for every i: compared with the grid, not with the
row before, since small differences of one sign add up. Differences of dates are exact; of doubles they are within two
units in the last place of the largest time, which are granted in addition.

On the grid, step k is the time s_0 + k·step. A sample within the tolerance of it is taken as it is; elsewhere "hold"
takes the last sample before, "linear" the line between the samples on both sides, and of Booleans the last one.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from stltool.errors import NameLookupError, SettingsError, TraceError, near_misses
from stltool.logic.quantities import UNITS, Duration
from stltool.monitoring.doubles import short_decimals
from stltool.monitoring.logs.recording import SHORTER, Recording, Signals, option
from stltool.sizes import require_memory

Resample: TypeAlias = Literal["hold", "linear"]
Reals: TypeAlias = NDArray[np.float64]

TOLERANCE = 0.01  # of a step
NO_TIME = "none"  # as the name of the time column
_TIMES = ("time", "t", "timestamp")
_BRACKETED = re.compile(r"(.*?)\s*(?:\[(.*)\]|\((.*)\))\s*")
_UNITS = {
    name: scale
    for scale, names in (
        (UNITS["s"], "s sec secs second seconds"),
        (UNITS["ms"], "ms msec msecs millisecond milliseconds"),
        (UNITS["us"], "us µs μs usec usecs microsecond microseconds"),
        (UNITS["ns"], "ns nsec nsecs nanosecond nanoseconds"),
        (UNITS["min"], "min mins minute minutes"),
        (UNITS["h"], "h hr hrs hour hours"),
        (24 * UNITS["h"], "d day days"),
    )
    for name in names.split()
}
_ROUNDING = 1e-9  # of a step
_RESAMPLE = f"{option('resample', 'hold')} or {option('resample', 'linear')}"
_ROWS = f"{option('time', 'none')} takes rows as steps"


@dataclass(frozen=True)
class Clock:
    """How the times of a log become steps. `time` is the column that the user named, or "none"."""

    step: Duration | None = None
    time: str | None = None
    resample: Resample | None = None
    tolerance: float = TOLERANCE

    @property
    def used(self) -> bool:
        return self.step is not None and self.time != NO_TIME


@dataclass(frozen=True)
class Timing:
    """What was done with the times of a log: in words, and the column, or None if rows are steps."""

    says: str | None = None
    column: str | None = None
    start: str | None = None  # the first time, as the log has it
    unused: str | None = None  # the column that looks like a time but was not used, for want of a step

    def beside(self, clock: Clock, names: Collection[str]) -> Timing:
        """Nothing, if the times were not wanted: no step is declared, and their column is a signal, or "none" given."""
        signal = self.unused is not None and self.unused.removeprefix("column ") in names
        return Timing() if signal or (clock.time == NO_TIME and clock.step is None) else self


# ------------------------------------------------------------------------------------------------------ the time column


@dataclass(frozen=True)
class TimeColumn:
    """A column of times, and its unit in seconds, if one is written."""

    name: str
    scale: Fraction | None = None
    unit: str | None = None

    def seconds(self, values: NDArray[Any], where: str) -> NDArray[Any]:
        """Numbers of the column as seconds; dates as they are."""
        if values.dtype.kind in "mM":
            return values
        if self.unit is not None and self.scale is None:
            raise TraceError(
                f"{where}: the unit {self.unit} of column {self.name} is not known; write s, ms, us, ns, min or h"
            )
        scale = self.scale if self.scale is not None else Fraction(1)
        return values * scale.numerator / scale.denominator if scale != 1 else values


def without_unit(name: str) -> tuple[str, str | None]:
    """A column's name and the unit in brackets behind it: `t [ms]`, `time (s)`."""
    found = _BRACKETED.fullmatch(name)
    if found is None or not found[1]:
        return name, None
    return found[1], next(unit for unit in found.groups()[1:] if unit is not None).strip()


def _looks_like_a_time(column: str) -> bool:
    """By its name; T [°C] is a temperature."""
    name, unit = without_unit(column)
    return name.lower() in _TIMES and (name.lower() != "t" or unit in (None, "", "-") or str(unit).lower() in _UNITS)


def time_column(
    where: str, known: Sequence[str], given: str | None, timed: bool, units: Mapping[str, str] | None = None
) -> TimeColumn | None:
    """The column of times: the one given, by its name or with a unit behind it, or one whose name says so.

    `units` are those of a units row. Raises NameLookupError if the one given is missing, SettingsError if the choice is
    not clear and the times are needed.
    """
    name, unit = given, None
    if given is None:
        looks = [one for one in known if _looks_like_a_time(one)]
        if not looks:
            return None
        if len(looks) > 1 and timed:
            raise SettingsError(
                f"{where}: columns {' and '.join(looks)} could both be the time; choose: {option('time', looks[0])}"
            )
        name = looks[0]
    elif given not in known:
        name, unit = without_unit(given)
        if unit is None or name not in known:
            asked = given if given.strip() else f'"{given}"'
            raise NameLookupError(f"{where}: there is no column {asked} for the time; {near_misses(given, known)}")
    assert name is not None
    written = unit or without_unit(name)[1] or (units or {}).get(name)
    unit = written.strip("[]() -") if written else None
    return TimeColumn(name, _UNITS.get(unit.lower()) if unit else None, unit or None)


# -------------------------------------------------------------------------------------------------------- rows → steps


def on_steps(recording: Recording, clock: Clock, where: str, labels: Collection[str] = ()) -> tuple[Signals, Timing]:
    """The signals of a recording with a sample per step. Raises TraceError if its times do not fit the step."""
    signals = dict(recording.signals)
    if not clock.used or recording.times is None:
        return signals, _rows_are_steps(recording, clock, where)
    assert clock.step is not None
    grid = _Grid(clock.step, clock, where, recording, labels)
    if isinstance(recording.times, Mapping):
        return grid.of_own_times(signals, recording.times)
    return grid.of_rows(signals, np.asarray(recording.times))


def _rows_are_steps(recording: Recording, clock: Clock, where: str) -> Timing:
    if isinstance(recording.times, Mapping):
        raise TraceError(
            f"{where}: its signals were not recorded together; declare a step and put them on its grid with {_RESAMPLE}"
        )
    if clock.resample is not None:
        raise SettingsError(f"{where}: there is no time column to resample by; name it: {option('time', 't')}")
    return rows_are_steps(clock, recording.clock)


def rows_are_steps(clock: Clock, unused: str | None) -> Timing:
    """What is done with the times of a log whose rows are steps; `unused` is what it calls them, if it has any."""
    if clock.step is None:
        return Timing(f"rows are steps; the {unused} is not used" if unused else None, unused=unused)
    says = f"rows are steps of {clock.step}"
    return Timing(says if clock.time == NO_TIME else f"{says}; there is no column of times")


@dataclass(frozen=True)
class _Grid:
    step: Duration
    clock: Clock
    where: str
    recording: Recording
    labels: Collection[str]

    @property
    def seconds(self) -> float:
        return float(self.step.seconds)

    @property
    def column(self) -> str:
        return self.recording.clock or "its times"

    def of_rows(self, signals: Signals, times: NDArray[Any]) -> tuple[Signals, Timing]:
        """Signals whose rows were recorded together."""
        batch = any(np.ndim(values) == 2 for values in signals.values())
        rows = np.atleast_2d(times)
        steps = [self._in_steps(one, number if batch and len(rows) > 1 else None) for number, one in enumerate(rows)]
        start = _shown_time(times.flat[0])
        if self.clock.resample is None:
            for number, (one, slack) in enumerate(steps):
                self._require_uniform(one, slack, number if batch and len(rows) > 1 else None)
            return signals, Timing(f"{self.column}, every {self.step}", self.recording.clock, start)
        self._require_room(max(one[-1] for one, _ in steps), len(signals), len(rows))
        found: Signals = {}
        for name, values in signals.items():
            parts = np.atleast_2d(values)
            own = steps if len(steps) == len(parts) else steps * len(parts)
            put = [self._put(name, part, *one) for part, one in zip(parts, own, strict=True)]
            if len({len(one) for one in put}) > 1:
                lengths = sorted({len(one) for one in put})
                raise TraceError(
                    f"{self.where}: on the grid of {self.step} its traces have {lengths[0]} to {lengths[-1]} samples; "
                    "give each a file of its own"
                )
            found[name] = np.stack(put) if values.ndim == 2 else put[0]
        return found, Timing(self._resampled(*steps[0]), self.recording.clock, start)

    def of_own_times(self, signals: Signals, times: Mapping[str, NDArray[Any]]) -> tuple[Signals, Timing]:
        """Signals that were recorded each at its own times."""
        own = [np.asarray(times[name]) for name in signals]
        if all(np.array_equal(own[0], one) for one in own[1:]):
            return self.of_rows(signals, own[0])
        if self.clock.resample is None:
            a, b = next(
                (a, b) for a, b in zip(signals, [*signals][1:], strict=False) if not np.array_equal(times[a], times[b])
            )
            raise TraceError(
                f"{self.where}: {a} and {b} were not recorded together; put them on the step's grid with {_RESAMPLE}"
            )
        first, last = max(one[0] for one in own), max(one[-1] for one in own)
        if self.clock.resample == "linear":
            lines = [one[-1] for name, one in zip(signals, own, strict=True) if not self._is_label(name, signals[name])]
            last = min(lines, default=last)
        n = int(np.floor(_seconds(np.array([first, last]))[-1] / self.seconds + self._tolerance(0.0))) + 1
        if n < 1:
            raise TraceError(f"{self.where}: the signals were not recorded at the same time; no step has all of them")
        self._require_room(n - 1.0, len(signals), 1)
        found, longest = {}, (0.0, "")
        for name, one in zip(signals, own, strict=True):
            self._in_steps(one, None, name)
            seconds = _seconds(np.concatenate([[first], one]))[1:]  # from the first step on
            steps = seconds / self.seconds
            found[name] = self._put(name, np.asarray(signals[name]), steps, _slack(one) / self.seconds, n)
            held = np.diff(np.append(seconds, max(seconds[-1], (n - 1) * self.seconds)))
            longest = max(longest, (float(held.max()), name))
        says = f"{self.column}, on steps of {self.step} ({self.clock.resample}): {n} steps"
        if longest[0] > 1.5 * self.seconds:
            says += f"; the longest time without a sample is {longest[0]:.6g}s, of {longest[1]}"
        return found, Timing(says, self.recording.clock, _shown_time(first))

    def _in_steps(self, times: NDArray[Any], trace: int | None, signal: str | None = None) -> tuple[Reals, float]:
        """The times in steps from the first one on, and the rounding in them; TraceError unless they increase."""
        seconds = _seconds(times)
        late = np.flatnonzero(~(np.diff(seconds) > 0))
        if len(late):
            i = int(late[0])
            raise _late(self._at(trace, signal, i, i + 1), self.column, times[i], times[i + 1])
        return seconds / self.seconds, _slack(times) / self.seconds

    def _tolerance(self, slack: float) -> float:
        return _tolerated(self.clock, slack)

    def _require_uniform(self, steps: Reals, slack: float, trace: int | None) -> None:
        off = np.abs(steps - np.arange(len(steps)))
        wrong = np.flatnonzero(off > self._tolerance(slack))
        if not len(wrong):
            return
        i = int(wrong[0])
        gap = float(steps[i] - steps[i - 1])
        apart = abs(gap - 1) > self._tolerance(2 * slack)
        at = self._at(trace, None, i - 1, i) if apart else self._at(trace, None, i)
        usual = float(np.median(np.diff(steps)))
        told = _off(at, self.column, self.clock, i, gap if apart else None, float(off[i]), usual)
        more = f" (and {len(wrong) - 1} more row{'s'[: len(wrong) > 2]})" if len(wrong) > 1 else ""
        raise TraceError(f"{told}{more}; {_RESAMPLE} puts the signals on the step's grid, {_ROWS}")

    def _at(self, trace: int | None, signal: str | None, *rows: int) -> str:
        of = f", trace {trace}" if trace is not None else f", {signal}" if signal is not None else ""
        return f"{self.where}{of}, {self.recording.place(*rows)}"

    def _require_room(self, last: float, signals: int, traces: int) -> None:
        require_memory((last + 1) * 8 * 4 * max(signals, 1) * traces, f"{self.where} on steps of {self.step}", SHORTER)

    def _is_label(self, name: str, values: NDArray[Any]) -> bool:
        return name in self.labels or np.asarray(values).dtype == np.bool_

    def _put(self, name: str, values: NDArray[Any], steps: Reals, slack: float, n: int | None = None) -> NDArray[Any]:
        """A signal at steps 0 … n−1, from its samples at `steps`; n: as many as there are."""
        near = self._tolerance(slack)
        grid = np.arange(int(np.floor(steps[-1] + near)) + 1 if n is None else n, dtype=np.float64)
        before, on = self._samples(steps, grid, near)
        held = values[before]
        if self.clock.resample == "hold" or self._is_label(name, values):
            return held
        after = np.minimum(before + 1, len(steps) - 1)
        between = ~on & (after > before)
        result = held.astype(np.float64)
        a, b = before[between], after[between]
        share = (grid[between] - steps[a]) / (steps[b] - steps[a])
        low, high = values[a].astype(np.float64), values[b].astype(np.float64)
        result[between] = low * (1 - share) + high * share
        return result

    @staticmethod
    def _samples(steps: Reals, grid: Reals, near: float) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """For every step the sample on it or the last one before, and whether it is on it."""
        before = np.maximum(np.searchsorted(steps, grid, side="right") - 1, 0)
        after = np.minimum(before + 1, len(steps) - 1)
        early = np.abs(steps[before] - grid) <= near
        soon = ~early & (np.abs(steps[after] - grid) <= near)
        return np.where(soon, after, before), early | soon

    def _resampled(self, steps: Reals, slack: float) -> str:
        near = self._tolerance(slack)
        grid = np.arange(int(np.floor(steps[-1] + near)) + 1, dtype=np.float64)
        before, on = self._samples(steps, grid, near)
        used = np.zeros(len(steps), np.bool_)
        used[before] = True
        if self.clock.resample == "linear":
            used[np.minimum(before + 1, len(steps) - 1)[~on]] = True
        says = f"{self.column}, on steps of {self.step} ({self.clock.resample}): {len(grid)} steps of {len(steps)} rows"
        gaps = np.diff(steps)
        if len(gaps) and gaps.max() > 1.5:
            row = int(gaps.argmax())
            says += f"; the longest gap is {gaps[row] * self.seconds:.6g}s, after {self.recording.place(row)}"
        if not used.all():
            says += f"; {int((~used).sum())} rows lie between steps and are not judged"
        return says


# -------------------------------------------------------------------------------------------- rows that come one by one


class RunningClock:
    """The times of a log that is still being written: each row is held against the step as it comes.

    A row that `on_steps` refuses is refused here, by the same message as far as the rows so far tell.
    """

    def __init__(self, clock: Clock, where: str, column: str) -> None:
        assert clock.step is not None
        self.clock, self.where, self.column = clock, where, f"column {column}"
        self._seconds = float(clock.step.seconds)
        self._first: NDArray[Any] | None = None
        self._before: tuple[NDArray[Any], int] | None = None
        self._n = 0

    def read(self, time: NDArray[Any], line: int) -> None:
        """The time (1,) of the next row, in seconds or as a date. TraceError if the row is not the next step."""
        if self._first is None or self._before is None:
            self._first, self._before, self._n = time, (time, line), 1
            return
        i, (last, line_before) = self._n, self._before
        times = np.concatenate([self._first, last, time])
        rows = f"{self.where}, rows {i} and {i + 1} (lines {line_before} and {line})"
        since = _seconds(times)
        if not since[2] > since[1]:
            raise _late(rows, self.column, last[0], time[0])
        slack = _slack(times) / self._seconds
        before, now = (since[1:] / self._seconds).tolist()
        if abs(now - i) > _tolerated(self.clock, slack):
            gap = now - before
            apart = abs(gap - 1) > _tolerated(self.clock, 2 * slack)
            at = rows if apart else f"{self.where}, row {i + 1} (line {line})"
            usual = gap if i == 1 else 1.0  # the rows before were steps
            told = _off(at, self.column, self.clock, i, gap if apart else None, abs(now - i), usual)
            raise TraceError(f"{told}; {_ROWS}; without --follow, {_RESAMPLE} puts the signals on the step's grid")
        self._before, self._n = (time, line), i + 1


def _tolerated(clock: Clock, slack: float) -> float:
    """How far from its step a row may be, in steps, the rounding of its time being `slack`."""
    return clock.tolerance + slack + _ROUNDING


def _late(at: str, column: str, before: Any, now: Any) -> TraceError:
    return TraceError(
        f"{at}: {column} goes from {_shown_time(before)} to {_shown_time(now)}; times must increase from row to row; "
        f"mend the log, or {_ROWS}"
    )


def _off(at: str, column: str, clock: Clock, row: int, gap: float | None, off: float, usual: float) -> str:
    """The fault of a row that is not its step: so many steps after the row before, or away from the grid.

    With a hint, if steps that `usual`ly follow one another look like times of another unit.
    """
    assert clock.step is not None
    if gap is None:
        return (
            f"{at}: in {column} it is {off:.3g} of a step away from step {row}; the step is {clock.step}, and "
            f"{clock.tolerance:.3g} of it is tolerated"
        )
    told = f"{at}: in {column} they are {gap * float(clock.step.seconds):.6g}s apart; the step is {clock.step}"
    for unit in ("ms", "us", "ns", "min", "h"):
        if abs(usual * float(_UNITS[unit]) - 1) <= clock.tolerance:
            name = without_unit(column.removeprefix("column "))[0]
            return f"{told} (if the column is in {unit}, give {option('time', f'{name} [{unit}]')})"
    return told


def _seconds(times: NDArray[Any]) -> Reals:
    """Seconds since the first time, of the decimals that the times are written as."""
    if times.dtype.kind == "f" and (short := short_decimals(times.astype(np.float64))) is not None:
        whole, places = short
        return cast(Reals, (whole - whole[0]) / 10.0**places)
    since = times - times[0] if times.dtype.kind != "u" else times.astype(np.float64) - float(times[0])
    if since.dtype.kind == "m":
        return cast(Reals, since.astype("m8[ns]").astype(np.int64) / 1e9)
    return since.astype(np.float64)


def _slack(times: NDArray[Any]) -> float:
    """The rounding of times, in seconds."""
    return 2 * float(np.spacing(np.abs(times).max())) if times.dtype.kind == "f" else 0.0


def _shown_time(time: Any) -> str:
    """A time as the log has it."""
    if isinstance(time, np.datetime64):
        text = str(time)
        return text.rstrip("0").rstrip(".") if "." in text else text
    if isinstance(time, np.timedelta64):
        time = time / np.timedelta64(1, "s")
    return f"{float(time):.12g}s"
