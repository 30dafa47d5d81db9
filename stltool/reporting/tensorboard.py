"""Learning curves as TensorBoard events."""

from __future__ import annotations

from pathlib import Path

from stltool.errors import FileError
from stltool.extras import require
from stltool.learning import Training


def require_tensorboard() -> None:
    """MissingExtraError where TensorBoard is not installed, before the work."""
    require("tensorboard", "a learning curve in TensorBoard", "write --history FILE.csv")


def write_tensorboard(training: Training, folder: str | Path) -> None:
    """The learning curve as TensorBoard scalars over environment steps, a new event file in `folder`."""
    require_tensorboard()
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.summary.writer.event_file_writer import EventFileWriter

    try:
        writer = EventFileWriter(str(folder))
        for point in training.history:
            values = {"episode": float(point.episode), "exact_probability": point.probability}
            for tag, value in values.items():
                if value is not None:
                    summary = Summary(value=[Summary.Value(tag=tag, simple_value=value)])
                    writer.add_event(Event(step=point.steps, summary=summary))
        writer.close()
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror}") from None
