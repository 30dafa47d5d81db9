"""Samples without a value: an error, the last value held, or rows dropped. Infinite ones are always an error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import TraceError
from stltool.monitoring.logs.recording import NEEDED, WAYS, Missing, Recording, Signals, no_value, option

At = Callable[[str, tuple[int, ...]], str]
"""The place of a sample within its file in messages, by signal and indices."""


def filled(recording: Recording, missing: Missing, where: str, at: At) -> Recording:
    """The recording of a file `where`, with a finite value in every sample.

    Raises TraceError, with the place, if that cannot be.
    """
    signals: Signals = {name: np.asarray(values) for name, values in recording.signals.items()}
    gaps: dict[str, NDArray[np.bool_]] = {}
    for name, values in signals.items():
        none = recording.missing.get(name, np.False_)
        wrong = none if missing == "error" else np.False_
        if values.dtype.kind == "f" and not (finite := np.isfinite(values)).all():
            wrong = wrong | (~finite if missing == "error" else np.isinf(values) & ~none)
            none = none | np.isnan(values)
        if np.any(wrong):
            index = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise TraceError(f"{where}, {at(name, index)}: {_fault(recording, name, values, index)}")
        if np.any(none):
            gaps[name] = np.asarray(none)
    if not gaps:
        return replace(recording, signals=signals, missing={})
    if missing == "hold":
        return replace(
            recording,
            signals=signals | {name: _held(name, signals[name], gaps[name], where, at) for name in gaps},
            missing={},
        )
    return _dropped(recording, signals, gaps, where)


def _fault(recording: Recording, name: str, values: NDArray[Any], index: tuple[int, ...]) -> str:
    if name in recording.missing and recording.missing[name][index]:
        return no_value()
    value = values[index]
    return f"{value} is not a finite number; " + (NEEDED if np.isinf(value) else f"{NEEDED}: {WAYS}")


def _held(name: str, values: NDArray[Any], none: NDArray[np.bool_], where: str, at: At) -> NDArray[Any]:
    """Every missing sample replaced by the last one before it."""
    if none[..., 0].any():
        index = (*(int(i) for i in np.argwhere(none[..., 0])[0]), 0)
        raise TraceError(
            f"{where}, {at(name, index)}: no value, and none before it to hold; "
            f"{option('missing', 'drop')} drops the row"
        )
    last = np.maximum.accumulate(np.where(none, 0, np.arange(none.shape[-1])), axis=-1)
    return np.take_along_axis(values, last, axis=-1)


def _dropped(recording: Recording, signals: Signals, gaps: Mapping[str, NDArray[np.bool_]], where: str) -> Recording:
    """Without the rows in which a signal has no value."""
    if isinstance(recording.times, Mapping):
        kept = {name: ~gaps[name] if name in gaps else slice(None) for name in signals}
        times: Any = {name: recording.times[name][kept[name]] for name in signals}
        return _some_left(
            replace(recording, signals={name: signals[name][kept[name]] for name in signals}, times=times, missing={}),
            where,
        )
    name, none = next(iter(gaps.items()))
    if none.ndim == 2:
        raise TraceError(
            f"{where}: {name} has samples without a value in a batch, whose traces must be of one length; "
            f"{option('missing', 'hold')} repeats the last value"
        )
    keep = ~np.logical_or.reduce(list(gaps.values()))
    rows = np.arange(len(keep)) if recording.rows is None else recording.rows
    times = recording.times[keep] if recording.times is not None else None
    kept_signals = {name: values[keep] for name, values in signals.items()}
    return _some_left(replace(recording, signals=kept_signals, times=times, rows=rows[keep], missing={}), where)


def _some_left(recording: Recording, where: str) -> Recording:
    for name, values in recording.signals.items():
        if not values.shape[-1]:
            raise TraceError(f"{where}: no row has a value of {name}, so every row would be dropped")
    return recording
