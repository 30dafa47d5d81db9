"""Traces in MCAP files, as robots record them: a signal per field of a topic's messages; needs the package mcap.

    /imu.acceleration.x, /wheels.speed.0     fields of messages in JSON; those of ROS 2 and Protobuf are decoded by
                                             mcap-ros2-support and mcap-protobuf-support, if they are installed

Every message has the time at which it was logged; with `time="publish_time"`, at which it was published. It is an
example of a reader by the interface for other packages (readers.py).
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.extras import require
from stltool.logic.names import near_names
from stltool.monitoring.logs.recording import Recording, faults, option

_TIMES = ("log_time", "publish_time")
_OTHERS = ("mcap_ros2.decoder", "mcap_protobuf.decoder")  # if they are installed
_DEEPEST = 20


def read_mcap(path: Path, names: list[str] | None, time: str | None) -> Recording:
    """The fields of an MCAP file's messages that are numbers or Booleans."""
    require("mcap", f"{path}: MCAP", "write the trace as .csv or .parquet")
    from mcap.exceptions import DecoderNotFoundError, McapError
    from mcap.reader import make_reader

    time = time or _TIMES[0]
    if time not in _TIMES:
        raise SettingsError(f"{path}: {option('time', time)}: messages have {' and '.join(_TIMES)}")
    values: dict[str, array[float]] = {}
    stamps: dict[str, array[int]] = {}
    kinds: dict[str, type] = {}
    broken = (McapError, DecoderNotFoundError, ValueError, EOFError)
    with faults(str(path), "an MCAP file", *broken), path.open("rb") as file:
        reader = make_reader(file, decoder_factories=_decoders())
        summary = reader.get_summary()
        topics = sorted({channel.topic for channel in summary.channels.values()}) if summary is not None else None
        if topics is not None and names is not None:
            topics = [topic for topic in topics if any(_within(topic, name) for name in names)]
        messages = 0
        for _, channel, message, content in reader.iter_decoded_messages(topics=topics, log_time_order=True):
            messages += 1
            for name, value in _fields(channel.topic, content, 0):
                if names is not None and name not in values and name not in names:
                    continue
                kind = kinds.setdefault(name, bool if isinstance(value, bool) else float)
                if isinstance(value, bool) is not (kind is bool):
                    raise TraceError(f"{path}, message {messages} of {channel.topic}: {name} is {value}, unlike before")
                values.setdefault(name, array("d")).append(_double(path, name, value))
                stamps.setdefault(name, array("q")).append(getattr(message, time))
    if not values and names is None:
        raise TraceError(f"{path}: its messages have no number and no truth value")
    for name in names or ():
        if name not in values:
            known = list(values) if names is None else _known(path)
            raise NameLookupError(f"{path}: there is no field {name}; {near_names(name, known)}")
    signals = {name: np.array(values[name], np.bool_ if kinds[name] is bool else np.float64) for name in values}
    return Recording(signals, {name: np.array(stamps[name], "M8[ns]") for name in values}, time)


def _known(path: Path) -> list[str]:
    return list(read_mcap(path, None, None).signals)


def _within(topic: str, name: str) -> bool:
    return name == topic or name.startswith(f"{topic}.")


def _double(path: Path, name: str, value: Any) -> float:
    number = float(value)
    if isinstance(value, int) and int(number) != value:
        raise TraceError(f"{path}: {name} is {value}: integers beyond 2^53 are not doubles")
    return number


def _fields(name: str, content: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """The numbers and truth values in a message, by the names that lead to them."""
    if isinstance(content, bool | int | float | np.number | np.bool_):
        yield name, content.item() if isinstance(content, np.generic) else content
    elif depth > _DEEPEST or isinstance(content, str | bytes) or content is None:
        return
    elif isinstance(content, Mapping):
        for key, value in content.items():
            yield from _fields(f"{name}.{key}", value, depth + 1)
    elif isinstance(content, Sequence | np.ndarray):  # Protobuf's repeated fields and ROS 2's arrays are no lists
        for i, value in enumerate(content):
            yield from _fields(f"{name}.{i}", value, depth + 1)
    elif hasattr(content, "DESCRIPTOR"):  # Protobuf
        for field in content.DESCRIPTOR.fields:
            yield from _fields(f"{name}.{field.name}", getattr(content, field.name), depth + 1)
    else:  # ROS 2
        for key in getattr(content, "__slots__", ()):
            yield from _fields(f"{name}.{key.lstrip('_')}", getattr(content, key), depth + 1)


def _decoders() -> list[Any]:
    import importlib

    from mcap.decoder import DecoderFactory

    class Json(DecoderFactory):
        def decoder_for(self, message_encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
            return json.loads if message_encoding == "json" else None

    found: list[Any] = [Json()]
    for module in _OTHERS:
        try:
            found.append(importlib.import_module(module).DecoderFactory())
        except ImportError:
            continue
    return found
