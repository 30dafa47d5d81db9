"""Learning curves as TensorBoard events, one folder per run."""

from __future__ import annotations

import io
import math
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from stltool.errors import FileError
from stltool.extras import require
from stltool.files import require_folder, write_atomically
from stltool.learning import Training
from stltool.learning.trainer import Point
from stltool.product import Product
from stltool.reporting.data import training_data

_LEAST = 2.0**-53  # the distance of 1 from the next double below
_UNSAFE = re.compile(r"[^\w.+-]+", re.ASCII)


def require_tensorboard(folder: str | Path) -> None:
    """Raise an error, before the work, if TensorBoard is not installed or its folder could not be written."""
    require("tensorboard", "a learning curve in TensorBoard", "write --history FILE.csv")
    require_folder(folder)


def write_tensorboard(training: Training, folder: str | Path) -> Path:
    """The learning curve as TensorBoard events in a new folder inside `folder`; returns the new folder.

    Scalars over environment steps, each at the time when it was evaluated: `episode`, and if the model is known
    `probability/P`, `probability/1-P` and `probability/log10(1-P)`. TensorBoard keeps single precision, in which
    1 − 1e-9 is 1, so distances from 1 are computed in doubles. Method and settings are hyperparameters.
    """
    require_tensorboard(folder)
    from tensorboard.compat.proto.event_pb2 import Event, SourceMetadata
    from tensorboard.summary.writer.record_writer import RecordWriter

    data = training_data(training)
    times = [point.time for point in training.history]
    buffer = io.BytesIO()
    writer = RecordWriter(buffer)
    source = SourceMetadata(writer="stltool")
    writer.write(Event(wall_time=times[0], file_version="brain.Event:2", source_metadata=source).SerializeToString())
    home = cast(Product, training.policy.home)  # learners do not support joint products
    for summary in _descriptions(data, f"{home.task_name} := {home.formula}", times):
        writer.write(Event(wall_time=times[0], summary=summary).SerializeToString())
    for point in training.history:
        writer.write(_event(point).SerializeToString())
    run = _new_folder(Path(folder), f"{home.task_name}-{data['method']}", data, times[-1])
    try:
        write_atomically(run / f"events.out.tfevents.{int(times[-1]):010d}.stltool", buffer.getvalue())
    except FileError:
        with suppress(OSError):  # TensorBoard would list an empty folder as a run
            run.rmdir()
        raise
    return run


def _new_folder(folder: Path, what: str, data: Mapping[str, Any], finished: float) -> Path:
    """A unique name that identifies the run: patrolling-cfer-seed0-20260131-235959."""
    published = "-published" if data["faithful"] else ""
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(finished))
    name = _UNSAFE.sub("-", f"{what}{published}-seed{data['seed']}-{stamp}")
    names = (name if i == 1 else f"{name}-{i}" for i in range(1, 10**6))
    return next(folder / free for free in names if not (folder / free).exists())


def _event(point: Point) -> Any:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary

    values = {"episode": float(point.episode)}
    if point.probability is not None:
        rest = 1.0 - point.probability
        values |= {
            "probability/P": point.probability,
            "probability/1-P": rest,
            "probability/log10(1-P)": math.log10(max(rest, _LEAST)),
        }
    told = [Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()]
    return Event(wall_time=point.time, step=point.steps, summary=Summary(value=told))


def _descriptions(data: Mapping[str, Any], task: str, times: list[float]) -> Iterator[Any]:
    """Summaries of the run: the task as text, method and settings as hyperparameters."""
    from tensorboard.plugins.hparams.summary_v2 import hparams_pb
    from tensorboard.plugins.text.summary_v2 import text_pb

    named = {key: data[key] for key in ("method", "faithful", "seed")} | data["budget"] | data["settings"]
    plain = {key: value if isinstance(value, bool | int | float | str) else str(value) for key, value in named.items()}
    yield text_pb("task", f"    {task}")  # indented: verbatim, not Markdown
    yield hparams_pb(plain, trial_id=f"{data['method']}-{data['seed']}-{times[-1]}", start_time_secs=times[0])
