"""UMB, the unified Markov binary format of Storm, PRISM, Modest and stormvogel: reading and writing.

A UMB file is a tar archive (possibly compressed) of index.json, which declares what there is, and of one small binary
file for each array (formats/umb_index.py, formats/umb_values.py):

    state-to-choices, choice-to-branches       as `choice_start` and `row_start` of models/rows.py
    branch-to-target, branch-to-probability    doubles, fractions of any size, or intervals of them
    actions/choices                            the actions of choices, and their names
    annotations/aps, annotations/rewards       labels, and costs of states, choices and branches
    valuations/states                          the variables of states: signals

Labels and costs have the names that Storm uses, their aliases. Truth values are 0 and 1 as signals. Variables that are
texts, or that some states do not have, are not signals; they are in the names of states. Names of states that do not
follow from the variables are among the parameters of the tool, since Storm reads no annotations by texts.

Nothing in a file is trusted: sizes, counts and ranges are checked before anything is computed from them.

Source: https://github.com/pmc-tools/umb, version 1 of 2026.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import StateNames
from stltool.errors import ModelError, StlToolError, marked
from stltool.models.costs import Amounts
from stltool.models.formats.archive import Archive, archived
from stltool.models.formats.given import INIT, Given, Valuation, model_of
from stltool.models.formats.umb_index import ENTITIES, INDEX, NAMES, TOOL, VERSION, Index, Variable, read_index
from stltool.models.formats.umb_values import (
    amounts,
    array,
    bits,
    bits_of,
    integers_of,
    mapping,
    packed_bits,
    packed_rationals,
    packed_texts,
    probabilities,
    texts,
    whole_numbers,
)
from stltool.models.fractions import Shares
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.models.rows import spans, starts
from stltool.numbers import number_text, shortest
from stltool.sizes import require_memory, require_numbered

Floats: TypeAlias = NDArray[np.float64]

WHAT = "UMB file"
LONGEST_NAMES = 1 << 24  # characters of all names of states, up to which they are written
_BYTES_A_BRANCH, _BYTES_A_STATE, _BYTES_A_VALUE = 60, 60, 24


def load_umb(path: Path, loading: Loading) -> MDP:
    """Read a UMB file. Raises FileError, ModelError and SizeError, naming the file in the archive."""
    archive = Archive(path, WHAT)
    index = read_index(archive)
    require_numbered(max(index.n_states, index.n_choices), f"states or choices of {path}", "use a part of the model")
    variables = sum(len(one) for one, _ in index.valuations.classes) if index.valuations is not None else 0
    of_states = _BYTES_A_STATE + len(index.labels) + _BYTES_A_VALUE * (variables + len(index.rewards))
    of_branches = _BYTES_A_BRANCH + _BYTES_A_VALUE * len(index.rewards)
    require_memory(
        float(of_branches) * index.n_branches + float(of_states) * (index.n_states + index.n_choices),
        f"{path}: {index.n_branches} branches of {index.n_states} states",
        "use a part of the model",
    )
    given = _given(archive, index)
    try:
        return model_of(given, index.name or path.stem, loading)
    except ModelError as error:
        raise ModelError(f"{path}: {marked(error)}") from None


def _given(archive: Archive, index: Index) -> Given:
    n_states, n_choices, n_branches = index.n_states, index.n_choices, index.n_branches
    choice_start = mapping(archive, "state-to-choices.bin", n_states, n_choices, "choices")
    row_start = mapping(archive, "choice-to-branches.bin", n_choices, n_branches, "branches")
    if index.players == 0 and (np.diff(choice_start) > 1).any():
        s = int(np.flatnonzero(np.diff(choice_start) > 1)[0])
        raise archive.fault("state-to-choices.bin", f"gives state {s} several choices, but #players is 0: a chain")
    empty = np.flatnonzero(np.diff(row_start) == 0)
    if empty.size:
        raise archive.fault("choice-to-branches.bin", f"gives choice {empty[0]} no branch; every choice has one")
    initial = np.zeros(n_states, dtype=np.bool_)
    if index.n_initial:
        initial = bits(archive, "state-is-initial.bin", n_states)
    if int(initial.sum()) != index.n_initial:
        fault = f"marks {initial.sum()} states, but index.json declares {index.n_initial} initial states"
        raise archive.fault("state-is-initial.bin", fault)
    action, words = _actions(archive, index)
    signals, names, notes = _variables(archive, index)
    return Given(
        choice_start,
        row_start,
        _targets(archive, index),
        _probabilities(archive, index),
        action,
        words,
        initial,
        {one.name: bits(archive, f"{one.folder}/states/values.bin", n_states) for one in index.labels},
        signals,
        index.state_names or names,
        _rewards(archive, index),
        notes,
    )


def _targets(archive: Archive, index: Index) -> NDArray[np.int32]:
    name = "branch-to-target.bin"
    if name not in archive:
        return np.zeros(index.n_branches, dtype=np.int32)
    target = array(archive, name, "<u8", index.n_branches)
    if target.size and target.max() >= index.n_states:
        k = int(np.flatnonzero(target >= index.n_states)[0])
        raise archive.fault(name, f"leads to state {target[k]} in branch {k}; states are 0 … {index.n_states - 1}")
    return target.astype(np.int32)


def _probabilities(archive: Archive, index: Index) -> Any:
    name = "branch-to-probability.bin"
    found = probabilities(archive, name, index.probabilities, index.n_branches)
    if isinstance(found, np.ndarray):
        wrong = ~((found >= 0) & (found <= 1 + 1e-9))
        if wrong.any():
            k = int(np.flatnonzero(wrong)[0])
            raise archive.fault(name, f"has {found[k]:.12g} in branch {k}, which is not a probability")
    elif isinstance(found, Shares):
        wrong = np.asarray((found.numerator < 0) | (found.numerator > found.denominator), dtype=np.bool_)
        if wrong.any():
            k = int(np.flatnonzero(wrong)[0])
            raise archive.fault(name, f"has {number_text(found[k])} in branch {k}, which is not a probability")
    else:
        wrong = ~((found.lower >= 0) & (found.lower <= found.upper) & (found.upper <= 1))
        if wrong.any():
            k = int(np.flatnonzero(wrong)[0])
            ends = f"[{found.lower[k]:.12g}, {found.upper[k]:.12g}]"
            raise archive.fault(name, f"has {ends} in branch {k}, which is not an interval of probabilities")
    return found


def _actions(archive: Archive, index: Index) -> tuple[NDArray[np.int64], list[str]]:
    """The action of every choice and the names of actions; an empty name is none."""
    folder, n = "actions/choices", index.n_actions
    if not n:
        return np.full(index.n_choices, -1, dtype=np.int64), []
    action = np.zeros(index.n_choices, dtype=np.int64)
    if f"{folder}/values.bin" in archive:
        given = array(archive, f"{folder}/values.bin", "<u4", index.n_choices)
        if given.size and given.max() >= n:
            k = int(np.flatnonzero(given >= n)[0])
            raise archive.fault(f"{folder}/values.bin", f"gives choice {k} action {given[k]}; there are {n}")
        action = given.astype(np.int64)
    if f"{folder}/string-mapping.bin" in archive:
        words = texts(archive, folder, n)
    else:
        require_memory(100.0 * n, f"{archive.path}: {n} actions", "declare only those that occur")
        words = [f"a{k}" for k in range(n)]  # as Storm names them
    known: dict[str, int] = {}
    number = np.array([known.setdefault(word, len(known)) if word else -1 for word in words], dtype=np.int64)
    return number[action], list(known)


def _rewards(archive: Archive, index: Index) -> dict[str, dict[str, Amounts]]:
    counts = dict(zip(ENTITIES, (index.n_states, index.n_choices, index.n_branches), strict=True))
    return {
        reward.name: {
            {"branches": "transitions"}.get(entity, entity): amounts(
                archive, f"{reward.folder}/{entity}/values.bin", reward.type, counts[entity]
            )
            for entity in reward.applies_to
        }
        for reward in index.rewards
    }


# ------------------------------------------------------------------------------------------------------------ variables


_Read: TypeAlias = "tuple[Floats, Callable[[int], str]]"


def _variables(archive: Archive, index: Index) -> tuple[dict[str, Floats], Sequence[str] | None, dict[str, str]]:
    """Signals, names of states, and what is to be noted."""
    if index.valuations is None:
        return {}, None, {}
    folder, n = "valuations/states", index.n_states
    classes = index.valuations.classes
    kind = np.zeros(n, dtype=np.int64)
    if f"{folder}/valuation-to-class.bin" in archive:
        given = array(archive, f"{folder}/valuation-to-class.bin", "<u4", n)
        if given.max() >= len(classes):
            fault = f"gives state {given.argmax()} class {given.max()}; there are {len(classes)}"
            raise archive.fault(f"{folder}/valuation-to-class.bin", fault)
        kind = given.astype(np.int64)
    start = starts(np.array([size for _, size in classes], dtype=np.int64)[kind])
    data = array(archive, f"{folder}/valuations.bin", "u1", int(start[-1]))
    words = texts(archive, folder, index.valuations.n_strings) if index.valuations.n_strings else []
    values: dict[str, Floats] = {}
    shown: dict[str, list[tuple[NDArray[np.int64], Callable[[int], str]]]] = {}
    missing: dict[str, str] = {}
    for k, (variables, size) in enumerate(classes):
        states = np.flatnonzero(kind == k)
        rows = data[spans(start[states], start[states + 1])].reshape(len(states), size) if len(classes) > 1 else (
            data.reshape(n, size))  # fmt: skip
        for variable in variables:
            there = np.ones(len(states), dtype=np.bool_)
            if variable.optional:
                there = bits_of(rows, variable.offset - 1, 1) == 1
            found, text = _read(archive, rows, variable, words)
            column = values.setdefault(variable.name, np.full(n, np.nan))
            column[states[there]] = found[there]
            shown.setdefault(variable.name, []).append((states[there], text))
            if variable.type.name == "string":
                missing[variable.name] = "a text"
    for name, column in values.items():
        if name not in missing and np.isnan(column).any():
            s = int(np.flatnonzero(np.isnan(column))[0])
            if not any(s in states for states, _ in shown[name]):
                missing[name] = f"without a value in state {s}"
    notes = {}
    if missing:
        left = ", ".join(f"{name} ({why})" for name, why in missing.items())
        notes["signal"] = f"variables that are not signals, but in the names of states: {left}"
    signals = {name: column for name, column in values.items() if name not in missing}
    truths = {variable.name for variables, _ in classes for variable in variables if variable.type.name == "bool"}
    names = Valuation(signals, list(values), truths, {name: shown[name] for name in missing})
    return signals, StateNames(n, names) if values else None, notes


def _read(archive: Archive, rows: NDArray[np.uint8], variable: Variable, words: list[str]) -> _Read:
    """The values of a variable as doubles, and as texts by row."""
    kind, offset = variable.type, variable.offset
    size, name = kind.size, "valuations/states/valuations.bin"
    match kind.name:
        case "bool":
            truth = np.array([value != 0 for value in integers_of(rows, offset, size, False)]) if size > 64 else (
                bits_of(rows, offset, size) != 0)  # fmt: skip
            return truth.astype(np.float64), lambda k: str(bool(truth[k])).lower()
        case "string":
            which = bits_of(rows, offset, size).astype(np.int64)
            if which.size and not 0 <= int(which.min()) <= int(which.max()) < len(words):
                raise archive.fault(name, f"gives {variable.name} a text that there is not; there are {len(words)}")
            return np.full(len(rows), np.nan), lambda k: words[which[k]]
        case "double":
            doubles = bits_of(rows, offset, size).view(np.float64)
            if not np.isfinite(doubles).all():
                raise archive.fault(name, f"gives {variable.name} a value that is not a finite number")
            return doubles.copy(), lambda k: number_text(shortest(doubles[k]))
        case "rational":
            above = integers_of(rows, offset, size // 2, True)
            below = integers_of(rows, offset + size // 2, size // 2, False)
            if 0 in below:
                raise archive.fault(name, f"divides by zero in {variable.name} of state {below.index(0)}")
            numbers = [_double(a, b) for a, b in zip(above, below, strict=True)]
        case _:
            if size <= 53 and abs(variable.plus) < 2**53:
                raw = bits_of(rows, offset, size).astype(np.int64)
                if kind.name == "int":
                    raw = np.where(raw >> (size - 1) != 0, raw - (1 << size), raw)
                small = (raw + variable.plus).astype(np.float64)
                return small, lambda k: str(int(small[k]))
            if size <= 64 and not variable.plus:
                raw64 = bits_of(rows, offset, size)
                signed = (raw64 << np.uint64(64 - size)).view(np.int64) >> np.int64(64 - size)
                near = (signed if kind.name == "int" else raw64).astype(np.float64)
                return near, lambda k: number_text(shortest(near[k]))
            wide = integers_of(rows, offset, size, kind.name == "int")
            numbers = [_double(value + variable.plus, 1) for value in wide]
    found = np.array(numbers, dtype=np.float64)
    if not np.isfinite(found).all():
        raise archive.fault(name, f"gives {variable.name} a value that is too large for a double")
    return found, lambda k: number_text(shortest(found[k]))


def _double(above: int, below: int) -> float:
    try:
        return above / below
    except OverflowError:
        return np.inf


# -------------------------------------------------------------------------------------------------------------- writing


def umb_bytes(model: MDP) -> bytes:
    """A UMB file of the model. Exact probabilities are written as fractions, doubles as doubles."""
    rows = model.rows
    chain = model.n_choices == model.n_states == int((np.diff(model.choice_start) == 1).sum())
    files: dict[str, bytes] = {}
    if not chain:
        files["state-to-choices.bin"] = model.choice_start.astype("<u8").tobytes()
    files["state-is-initial.bin"] = packed_bits(model.initial > 0)
    files["choice-to-branches.bin"] = rows.row_start.astype("<u8").tobytes()
    files["branch-to-target.bin"] = rows.target.astype("<u8").tobytes()
    if rows.intervals is not None:
        kind = {"type": "double-interval", "size": 128}
        content = np.stack([rows.intervals.lower, rows.intervals.upper], axis=1).astype("<f8").tobytes()
    else:
        given = Shares(rows.numerator, rows.denominator) if rows.given_exactly else None
        kind, content = _number_file(Amounts(rows.probability, given))
    files["branch-to-probability.bin"] = content
    files["actions/choices/values.bin"] = model.choice_action.astype("<u4").tobytes()
    _add_texts(files, "actions/choices", model.action_names)
    annotations: dict[str, dict[str, Any]] = {}
    for k, (name, values) in enumerate(sorted(model.labels.items())):
        if name == INIT:
            continue
        key = _key(name, k, annotations.get("aps", {}))
        annotations.setdefault("aps", {})[key] = {
            "alias": name, "applies-to": ["states"], "type": {"type": "bool", "size": 1}
        }  # fmt: skip
        files[f"annotations/aps/{key}/states/values.bin"] = packed_bits(values)
    for k, (name, cost) in enumerate(sorted(model.costs.items())):
        key = _key(name, k, annotations.get("rewards", {}))
        parts = {{"transitions": "branches"}.get(part, part): numbers for part, numbers in cost.parts.items()}
        if not parts:
            parts = {"states": Amounts(np.zeros(model.n_states))}
        sizes, contents = _alike(parts)
        annotations.setdefault("rewards", {})[key] = {"alias": name, "applies-to": list(parts), "type": sizes}
        files |= {f"annotations/rewards/{key}/{part}/values.bin": content for part, content in contents.items()}
    from_variables = Valuation.of(model)
    names = from_variables.others_of(model, LONGEST_NAMES)
    valuations = _valuations(model, from_variables, files)
    index = {
        "format-version": VERSION,
        "format-revision": 0,
        "file-data": {
            "tool": TOOL, "tool-version": metadata.version("stltool"),
            **({"parameters": {NAMES: names}} if names is not None else {}),
        },
        "model-data": {"name": model.name},
        "transition-system": {
            "time": "discrete", "#players": 0 if chain else 1, "#states": model.n_states, "#initial-states": 1,
            "#choices": model.n_choices, "#choice-actions": model.n_actions, "#branches": len(rows.target),
            "#branch-actions": 0, "#observations": 0, "branch-probability-type": kind,
        },
        **({"annotations": annotations} if annotations else {}),
        **({"valuations": valuations} if valuations else {}),
    }  # fmt: skip
    return archived({INDEX: json.dumps(index, indent=1).encode(), **files})


def is_own_umb(path: Path) -> bool:
    """Whether stltool wrote this UMB file."""
    try:
        return bool(json.loads(bytes(Archive(path, WHAT).view(INDEX)))["file-data"]["tool"] == TOOL)
    except (StlToolError, ValueError, LookupError, TypeError, RecursionError):
        return False


def _add_texts(files: dict[str, bytes], folder: str, values: Sequence[str]) -> None:
    files[f"{folder}/string-mapping.bin"], files[f"{folder}/strings.bin"] = packed_texts(values)


def _key(name: str, number: int, taken: dict[str, Any]) -> str:
    """An identifier of the format for a name; the name itself if it is one."""
    fitting = "".join(c if c in "abcdefghijklmnopqrstuvwxyz0123456789_-" else "-" for c in name.lower())
    return name if name == fitting and name not in taken and name else f"{number}-{fitting}"


def _number_file(numbers: Amounts) -> tuple[dict[str, Any], bytes]:
    if numbers.given is None:
        return {"type": "double", "size": 64}, numbers.values.astype("<f8").tobytes()
    size, content = packed_rationals(numbers.given)
    return {"type": "rational", "size": size}, content


def _alike(parts: dict[str, Amounts]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The files of a reward, which has one type: exact if all its parts are."""
    if any(numbers.given is None for numbers in parts.values()):
        return {"type": "double", "size": 64}, {
            part: numbers.values.astype("<f8").tobytes() for part, numbers in parts.items()
        }
    packed = {part: packed_rationals(numbers.exact) for part, numbers in parts.items()}
    size = max(size for size, _ in packed.values())
    if any(one < size for one, _ in packed.values()):
        packed = {part: packed_rationals(numbers.exact, size) for part, numbers in parts.items()}
    return {"type": "rational", "size": size}, {part: content for part, (_, content) in packed.items()}


def _valuations(model: MDP, names: Valuation, files: dict[str, bytes]) -> dict[str, Any]:
    """Signals as variables of states: integers where they are."""
    if not model.signals:
        return {}
    variables, columns = [], []
    for name, values in model.signals.items():
        kind = "bool" if name in names.truths else "int" if whole_numbers(values) else "double"
        variables.append({"name": name, "type": {"type": kind, "size": 64}})
        columns.append(values.astype("<f8" if kind == "double" else "<i8").view("<u8"))
    table = np.stack(columns, axis=1)
    files["valuations/states/valuations.bin"] = table.tobytes()
    unique = len(np.unique(table, axis=0)) == len(table)
    return {"states": {"unique": unique, "classes": [{"variables": variables}]}}
