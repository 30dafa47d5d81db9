"""Checkpoints: the complete state of a run between two episodes, so that it can be resumed exactly.

An .npz file without pickle: a JSON header (the run, its progress, the states of the generators, a digest of the
content) and the arrays of history, counts and learner. It is replaced atomically: a run killed at any moment leaves the
last checkpoint intact.

A file is accepted, before any kernel sees an entry, only if all of this holds: it belongs to this run (task, model,
method, settings, seed); its arrays are those of a run of this learner, with their types and shapes, and none that
declares others is unpacked; the digest matches; entries are in range; and they are consistent: counts with steps, and
the arrays of the learner with the counts (`Learner.check`).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arrays import Members, open_arrays
from stltool.errors import SettingsError, named
from stltool.files import require_folder, require_replaceable, write_atomically
from stltool.learning.kept import Kept
from stltool.learning.trainer import Point, Progress, Status, Trainer

FORMAT = "stltool-checkpoint-3"
_LONGEST_HEADER = 1 << 20
_GENERATORS = ("PCG64", "PCG64DXSM")


def save_checkpoint(
    path: Path,
    what: Mapping[str, Any],
    progress: Progress,
    trainer: Trainer,
    generators: Sequence[np.random.Generator],
) -> None:
    """Save the current state of the run `what` (its task, model, method and settings, by name)."""
    arrays = {f"learner {name}": kept.values for name, kept in kept_arrays(trainer).items()}
    arrays |= {f"counts {name}": array for name, array in trainer.counts.arrays().items()}
    points = progress.history
    arrays["history episode"] = np.array([point.episode for point in points], dtype=np.int64)
    arrays["history steps"] = np.array([point.steps for point in points], dtype=np.int64)
    values = [math.nan if point.probability is None else point.probability for point in points]
    arrays["history probability"] = np.array(values, dtype=np.float64)
    gaps = [math.nan if point.gap is None else point.gap for point in points]
    arrays["history gap"] = np.array(gaps, dtype=np.float64)
    arrays["history time"] = np.array([point.time for point in points], dtype=np.float64)
    header = {
        "format": FORMAT,
        "what": dict(what),
        "episode": progress.episode,
        "steps": progress.steps,
        "status": progress.status,
        "alarms": {tie: list(alarm) for tie, alarm in trainer.counts.alarms.items()},
        "generators": [generator.bit_generator.state for generator in generators],
    }
    write_atomically(path, packed(header, arrays))


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of a checkpoint."""
    buffer = io.BytesIO()
    text = json.dumps({**header, "digest": _digest(header, arrays)})
    members = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    members["header"] = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    np.savez(buffer, **members)  # type: ignore[arg-type]  # numpy's stub takes any name for allow_pickle
    return buffer.getvalue()


def load_checkpoint(
    path: Path, what: Mapping[str, Any], trainer: Trainer, generators: Sequence[np.random.Generator]
) -> Progress:
    """Restore the run; SettingsError if the file is damaged, of another version, or of another run."""
    try:
        with open_arrays(path, "checkpoint") as members:
            header = _header(members)
            _require_format(path, header)
            _require_same(path, header, what)
            _require_length(path, header, trainer)
            arrays = _arrays(members, header, trainer)
        if header["digest"] != _digest({k: v for k, v in header.items() if k != "digest"}, arrays):
            raise ValueError("its content was changed")
        progress = _progress(header, arrays, trainer)
        trainer.counts.restore({name: arrays[f"counts {name}"] for name in ("codes", "contexts", "seen")})
        trainer.counts.alarms = _alarms(header["alarms"], trainer)
        _require_counts(progress, trainer)
        for name, kept in kept_arrays(trainer).items():
            kept.take(name, arrays[f"learner {name}"])
        if trainer.state is not None:
            trainer.learner.check(trainer.state)
        states = [_state(generator, state) for generator, state in zip(generators, header["generators"], strict=True)]
        for generator, state in zip(generators, states, strict=True):
            generator.bit_generator.state = state
    except ValueError as error:
        raise SettingsError(
            f"{path} is not a checkpoint, or a damaged one: {error}; delete it and start again"
        ) from error
    return progress


def require_checkpoint(path: str | Path | None, resume: bool) -> None:
    """Raise an error, before the work, if a checkpoint could not be written, or would replace a run that is not to be
    resumed."""
    if path is None:
        if resume:
            raise SettingsError(
                f"{named('resume', 'resume=True')} needs the checkpoint to continue from; give "
                f"{named('checkpoint', 'checkpoint=FILE')}"
            )
        return
    place = Path(path).resolve()  # through a link, to what it names
    require_replaceable(place)
    require_folder(place.parent)
    if Path(path).exists() and not resume:
        raise SettingsError(f"{path} exists; resume it ({named('resume', 'resume=True')}), or delete it to begin again")


def require_generators(generators: Sequence[np.random.Generator]) -> None:
    """SettingsError if a generator is of a kind whose state is not checked when it is read."""
    for generator in generators:
        kind = type(generator.bit_generator).__name__
        if kind not in _GENERATORS:
            raise SettingsError(
                f"the environment's generator is a {kind}; a checkpoint needs one of numpy.random.default_rng"
            )


# ------------------------------------------------------------------------------------------------------ the schema


def kept_arrays(trainer: Trainer) -> dict[str, Kept]:
    """The learner's arrays, by name, with their ranges; SettingsError if they cannot be stored."""
    if trainer.state is None:
        return {}
    arrays = trainer.learner.arrays(trainer.state)
    kept = {name: array if isinstance(array, Kept) else Kept(array) for name, array in arrays.items()}
    for name, one in kept.items():
        if one.values.dtype.kind not in "biuf":
            raise SettingsError(
                f"{trainer.learner.name} cannot be checkpointed: its array {name} is of {one.values.dtype}; "
                "use numbers or Booleans"
            )
    return kept


def _header(members: Members) -> dict[str, Any]:
    raw = members.read("header", np.uint8, (None,), most=_LONGEST_HEADER)
    try:
        header = json.loads(raw.tobytes().decode("utf-8"))
    except RecursionError:
        raise ValueError("its header is nested too deeply") from None
    if not isinstance(header, dict) or "format" not in header:
        raise ValueError("its header is incomplete")
    return header


def _require_format(path: Path, header: dict[str, Any]) -> None:
    version = header["format"]
    if version != FORMAT:
        raise SettingsError(
            f"{path} has the format {version!r}, and this version of stltool reads {FORMAT!r}; "
            "finish the run with the version that started it, or start again"
        )
    expected = {"format", "what", "episode", "steps", "status", "alarms", "generators", "digest"}
    if header.keys() != expected or not isinstance(header["what"], dict) or not isinstance(header["generators"], list):
        raise ValueError("its header is not that of a run")


def _require_same(path: Path, header: dict[str, Any], what: Mapping[str, Any]) -> None:
    there = header["what"]
    for name in dict.fromkeys([*what, *there]):
        was, here = (repr(side[name]) if name in side else "not set" for side in (there, what))
        if was != here:
            raise SettingsError(
                f"{path} is of another run: its {name.removeprefix('setting ')} is {was}, here it is {here}; "
                "resume it with the original arguments, or give another checkpoint file"
            )


def _require_length(path: Path, header: dict[str, Any], trainer: Trainer) -> None:
    episode, steps, episodes = _index(header, "episode"), _index(header, "steps"), trainer.budget.episodes
    if episode > episodes:
        raise SettingsError(f"{path} has {episode} episodes already, and {named('episodes')} is {episodes}; give more")
    if steps > episode * trainer.length:
        raise ValueError(f"{episode} episodes cannot take {steps} steps")


def _arrays(members: Members, header: dict[str, Any], trainer: Trainer) -> dict[str, NDArray[Any]]:
    """All arrays, each of the type and shape that a run of this learner has."""
    counts, episode, steps = trainer.counts, _index(header, "episode"), _index(header, "steps")
    rows = min(counts.n_choices * counts.n_states * counts.n_contexts, steps)
    points = episode + 1  # one before the first episode, where there is nothing to learn
    schema: dict[str, tuple[Any, tuple[int | None, ...], int | None]] = {
        "counts codes": (np.int64, (None,), rows),
        "counts contexts": (np.int64, (None,), rows),
        "counts seen": (np.int64, (None,), rows),
        "history episode": (np.int64, (None,), points),
        "history steps": (np.int64, (None,), points),
        "history probability": (np.float64, (None,), points),
        "history gap": (np.float64, (None,), points),
        "history time": (np.float64, (None,), points),
    }
    schema |= {
        f"learner {name}": (kept.values.dtype, kept.values.shape, None) for name, kept in kept_arrays(trainer).items()
    }
    strange = set(members.names) ^ {*schema, "header"}
    if strange:
        raise ValueError(f"its arrays are not those of {trainer.learner.name}: {', '.join(sorted(strange))}")
    return {name: members.read(name, *expected) for name, expected in schema.items()}


def _progress(header: dict[str, Any], arrays: Mapping[str, NDArray[Any]], trainer: Trainer) -> Progress:
    """The progress of the run, including its learning curve."""
    episode, steps, status = _index(header, "episode"), _index(header, "steps"), header["status"]
    if status is not None and status not in get_args(Status):
        raise ValueError(f"its status is {status!r}")
    if (status == "nothing to learn") != (trainer.state is None):
        raise ValueError(f"its status is {status!r}")
    columns = ("episode", "steps", "probability", "time", "gap")
    at, of, values, times, gaps = (arrays[f"history {name}"] for name in columns)
    if len({len(at), len(of), len(values), len(times), len(gaps)}) > 1:
        raise ValueError("its learning curve has columns of different lengths")
    every = trainer.budget.evaluate_every
    due = set(range(every, episode + 1, every)) if len(at) >= episode // every else {-1}
    first = 0 if status == "nothing to learn" else 1
    if ((at < first) | (at > episode)).any() or (at[1:] <= at[:-1]).any() or not due <= set(at.tolist()):
        raise ValueError("its learning curve is not of its episodes")
    if ((of < 0) | (of > steps)).any() or (of[1:] < of[:-1]).any():
        raise ValueError("its learning curve is not of its steps")
    if status is not None and (not len(at) or at[-1] != episode or of[-1] != steps):
        raise ValueError("its learning curve does not reach its end")
    known = ~np.isnan(values)
    if (known != trainer.knows).any() and trainer.state is not None:
        raise ValueError("its learning curve does not fit what is known of the model")
    if not ((values[known] >= 0) & (values[known] <= 1)).all() or not np.isfinite(times).all():
        raise ValueError("its learning curve contains a number that is not a probability")
    certified = ~np.isnan(gaps)
    if (certified != (trainer.certifier is not None)).any() or not ((gaps >= 0) & (gaps <= 1))[certified].all():
        raise ValueError("its learning curve does not fit the gaps that are to be certified")
    points = zip(at.tolist(), of.tolist(), values.tolist(), times.tolist(), gaps.tolist(), strict=True)
    history = [
        Point(e, s, None if math.isnan(p) else p, when, None if math.isnan(gap) else gap)
        for e, s, p, when, gap in points
    ]
    return Progress(episode, steps, history, status)


def _require_counts(progress: Progress, trainer: Trainer) -> None:
    """ValueError unless there is one transition a step, each of which the model can take."""
    counts, tables = trainer.counts, trainer.environment.tables
    if sum(counts.seen.tolist()) != progress.steps:
        raise ValueError(f"{sum(counts.seen.tolist())} transitions were counted in {progress.steps} steps")
    if tables is not None:
        choices = np.repeat(np.arange(counts.n_choices), np.diff(tables.row_start))
        possible = choices * counts.n_states + tables.target
        if not np.isin(counts.choice * counts.n_states + counts.target, possible).all():
            raise ValueError("a transition was counted that the model does not have")


def _alarms(given: Any, trainer: Trainer) -> dict[str, tuple[float, int]]:
    """The alarms that rang, of models with these states and choices."""
    fine = isinstance(given, dict) and (not given or trainer.certifier is not None)
    least, most = -trainer.counts.n_choices, trainer.counts.n_states
    if not fine or not all(
        isinstance(alarm, list)
        and [type(number) for number in alarm] == [float, int]
        and math.isfinite(alarm[0])
        and least <= alarm[1] < most
        for alarm in given.values()
    ):
        raise ValueError("its alarms are not those of a run")
    return {tie: (alarm[0], alarm[1]) for tie, alarm in given.items()}


def _state(generator: np.random.Generator, state: Any) -> dict[str, Any]:
    """The state of a generator of the same kind and stream; of one seed only the position in it differs."""
    here: Any = generator.bit_generator.state
    limits = {"has_uint32": 2, "uinteger": 1 << 32}
    fine = (
        isinstance(state, dict)
        and state.keys() == here.keys()
        and state["bit_generator"] == here["bit_generator"]
        and isinstance(state["state"], dict)
        and state["state"].keys() == here["state"].keys() == {"state", "inc"}
        and state["state"]["inc"] == here["state"]["inc"]
        and type(state["state"]["state"]) is int
        and 0 <= state["state"]["state"] < 1 << 128
        and all(type(state[name]) is int and 0 <= state[name] < limit for name, limit in limits.items())
    )
    if not fine:
        raise ValueError("a generator's state is not one that this seed leads to")
    found: dict[str, Any] = state
    return found


def _index(header: dict[str, Any], name: str) -> int:
    value = header[name]
    if type(value) is not int or not 0 <= value < 1 << 62:
        raise ValueError(f"its {name} is {value!r}")
    return value


def _digest(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of the whole content, against damage, not against forgery."""
    found = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.asarray(arrays[name], order="C")
        found.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        found.update(array.tobytes())
    return found.hexdigest()
