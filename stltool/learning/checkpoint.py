"""Checkpoints: everything a run is made of between two episodes, so that it goes on to the same bits.

An .npz file without pickle: a JSON header (what the run is, how far it is, the generators' states) and the arrays of
learner and counts. It is replaced atomically: a run killed at any moment leaves the last one whole.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SettingsError
from stltool.files import read_bytes, write_atomically
from stltool.learning.counts import Counts
from stltool.learning.learner import Learner
from stltool.learning.trainer import Point, Progress

FORMAT = "stltool-checkpoint-1"


def save_checkpoint(
    path: Path,
    what: Mapping[str, Any],
    progress: Progress,
    learner: Learner,
    counts: Counts,
    generators: list[np.random.Generator],
) -> None:
    """Write the run `what` (its task, model, method and settings, by name) as it stands."""
    header = {
        "format": FORMAT,
        "what": dict(what),
        "episode": progress.episode,
        "steps": progress.steps,
        "finished": progress.finished,
        "history": [dataclasses.astuple(point) for point in progress.history],
        "generators": [generator.bit_generator.state for generator in generators],
    }
    arrays: dict[str, NDArray[Any]] = {f"learner {name}": array for name, array in learner.arrays().items()}
    arrays |= {f"counts {name}": array for name, array in counts.arrays().items()}
    buffer = io.BytesIO()
    arrays["header"] = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # numpy's stub takes every name for allow_pickle
    write_atomically(path, buffer.getvalue())


def load_checkpoint(
    path: Path,
    what: Mapping[str, Any],
    learner: Learner,
    counts: Counts,
    generators: list[np.random.Generator],
) -> Progress:
    """Restore the run; SettingsError where the file is damaged, of another version, or of another run."""
    data = read_bytes(path, "checkpoint")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes().decode("utf-8"))
            arrays = {name: archive[name] for name in archive.files if name != "header"}
        version = str(header["format"])
    except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise SettingsError(f"{path} is no checkpoint, or a damaged one; delete it and start again") from error
    if version != FORMAT:
        raise SettingsError(
            f"{path} has the format {version!r}, and this version of stltool reads {FORMAT!r}; "
            "finish the run with the version that began it, or start again"
        )
    for name, here in what.items():
        there = header["what"].get(name)
        if there != here:
            raise SettingsError(
                f"{path} is of another run: its {name} is {there!r}, here it is {here!r}; "
                "resume it as it was begun, or give another checkpoint file"
            )
    try:
        learner.restore({k.removeprefix("learner "): v for k, v in arrays.items() if k.startswith("learner ")})
        counts.restore({k.removeprefix("counts "): v for k, v in arrays.items() if k.startswith("counts ")})
        for generator, state in zip(generators, header["generators"], strict=True):
            generator.bit_generator.state = state
        history = [Point(*row) for row in header["history"]]
        return Progress(int(header["episode"]), int(header["steps"]), history, bool(header["finished"]))
    except (ValueError, KeyError, TypeError) as error:
        raise SettingsError(f"{path} is a damaged checkpoint; delete it and start again") from error
