"""Gymnasium environments named in TOML (models/gymnasium).

    kind = "gymnasium"
    id = "FrozenLake-v1"
    table = "auto"                 true: its transition table, or an error; false: a black box; "auto": a table if any
    ends = "merged"                "apart": S more states, for runs that have ended at an observation
    normalize = false              true: rescale rows of the table that miss a sum of 1 only by rounding
    actions = ["left", "down", "right", "up"]      names, in the environment's order; default: their numbers

    [options]                      passed to gymnasium.make unchanged
    is_slippery = true

    [labels]                       name = the observations where it holds, or a Boolean for each state
    goal = [15]

    [coordinates]                  signals that are the digits of the state's number, the last one varying fastest:
    row = 4                        state = 4 row + column; for Tuple and MultiDiscrete, its components
    column = 4

    [signals]                      name = a number for each state
    danger = [0, 0, 0, 0, 0, 1, …]

    [cells]                        for real observations: signal = edges between cells, or the width of each; signals
    x = 0.2                        are then numbers of components, and a label may be "info.KEY"
    v = [-1, 0, 1]

Only installed and registered environments can be named: a file never causes an import or an evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError, near_misses
from stltool.models.gymnasium import from_gymnasium, require_gymnasium
from stltool.models.gymnasium.spaces import Observations
from stltool.models.mdp import MDP
from stltool.models.toml import Faults

_KEYS = ("kind", "id", "table", "ends", "normalize", "actions", "options", "labels", "coordinates", "signals", "cells",
         "name")  # fmt: skip


def gymnasium_from_table(table: Mapping[str, Any], default_name: str = "environment", normalize: bool = False) -> MDP:
    """The MDP of the environment that a file describes. Raises ModelFaults listing all faults."""
    faults = Faults()
    for key in table:
        if key not in _KEYS:
            faults.add(key, f"unknown key {key}; {near_misses(key, _KEYS)}")
    exact = table.get("table", "auto")
    if not isinstance(exact, bool) and exact != "auto":
        faults.add("table", f'table is {exact!r}; write true, false or "auto"')
    ends = table.get("ends", "merged")
    if ends not in ("merged", "apart"):
        faults.add("ends", f'ends is {ends!r}; write "merged" or "apart"')
    actions = table.get("actions")
    if actions is not None and not (isinstance(actions, list) and all(isinstance(a, str) for a in actions)):
        faults.add("actions", f'actions is {actions!r}; write a list of names, such as ["left", "right"]')
    sections: dict[str, dict[str, Any]] = {}
    for key in ("options", "labels", "coordinates", "signals", "cells"):
        sections[key] = table.get(key, {})
        if not isinstance(sections[key], dict):
            faults.add(key, f"{key} is {sections[key]!r}; write it as a table: [{key}] and below it name = value")
            sections[key] = {}
    env = _make(table.get("id"), sections["options"], faults)
    if env is not None and (sections["cells"] or any(map(_of_info, sections["labels"].values()))):
        return _of_cells(env, table, sections, default_name, faults)
    observations = faults.reading("id", Observations.of, env) if env is not None else None
    if observations is None:
        faults.refuse()
    assert observations is not None
    labels: dict[str, NDArray[np.bool_]] = {}
    for key, value in sections["labels"].items():
        label = faults.reading(("labels", key), observations.label, key, value)
        labels |= {key: label} if label is not None else {}
    signals = _coordinates(sections["coordinates"], observations, faults)
    for key, value in sections["signals"].items():
        if key in signals:
            faults.add(("signals", key), f"signal {key} is a coordinate too; rename one of them")
        signal = faults.reading(("signals", key), observations.signal, key, value)
        signals |= {key: signal} if signal is not None else {}
    faults.refuse()
    name = str(table.get("name", default_name))
    normalize = normalize or table.get("normalize") is True
    return from_gymnasium(
        env, labels, signals, table=exact, ends=ends, name=name, action_names=actions, normalize=normalize
    )  # fmt: skip


def _of_info(label: object) -> bool:
    from stltool.models.gymnasium.cells import of_step  # gymnasium is slow to load

    return of_step(label)


def _of_cells(
    env: Any, table: Mapping[str, Any], sections: Mapping[str, dict[str, Any]], default_name: str, faults: Faults
) -> MDP:
    """The black box of an environment whose observations are divided into cells."""
    if sections["coordinates"]:
        faults.add("coordinates", "coordinates are of finitely many observations; leave them out, or the cells")
    faults.refuse()
    cells = {key: _plain(value, key) for key, value in sections["cells"].items()}
    found = faults.reading(
        "cells" if cells else "labels",
        lambda env: from_gymnasium(
            env, sections["labels"], sections["signals"], cells=cells or None, action_names=table.get("actions"),
            table=table.get("table", "auto"), name=str(table.get("name", default_name)),
        ),
        env,
    )  # fmt: skip
    faults.refuse()
    assert found is not None
    return found


def _make(name: object, options: Mapping[str, Any], faults: Faults) -> Any:
    """The environment; None if it cannot be made."""
    gymnasium = require_gymnasium()
    before = faults.count
    if not isinstance(name, str) or not name:
        faults.add("id", f'id is {name!r}; write the name of an environment, such as id = "FrozenLake-v1"')
    elif ":" in name:  # gymnasium would import what precedes the colon
        faults.add(
            "id",
            f"id is {name!r}: a file cannot import a module; write only the name of a registered environment, "
            "or use stl.from_gymnasium in Python",
        )
    else:
        try:
            gymnasium.spec(name)
        except gymnasium.error.Error as error:
            hint = f"{error}".rstrip(".")
            faults.add("id", f"id is {name!r}: {hint}; {near_misses(name, gymnasium.registry)}")
    plain = {key: faults.reading(("options", key), _plain, value, key) for key, value in options.items()}
    if faults.count > before:
        return None
    try:
        return gymnasium.make(name, **{"disable_env_checker": True} | plain)
    except Exception as error:  # raised by the environment for options that it does not accept
        shown = ", ".join(f"{key} = {value!r}" for key, value in plain.items()) or "none"
        faults.add("options", f"{name} cannot be made with the options {shown}: {error}")
        return None


def _plain(value: Any, key: str) -> Any:
    """Numbers, texts, Booleans, lists and tables of them, as gymnasium.make takes them."""
    if isinstance(value, Decimal):
        return float(value)
    if isinstance(value, list):
        return [_plain(item, key) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item, key) for name, item in value.items()}
    if isinstance(value, bool | int | str):
        return value
    raise ModelError(f"option {key} is {value!r}; write a number, a string, true or false, or a list")


def _coordinates(
    sizes: Mapping[str, Any], observations: Observations, faults: Faults
) -> dict[str, NDArray[np.float64]]:
    """Signals (S,) from the digits of the state's number, or from the components of a compound space."""
    wrong = [name for name, size in sizes.items() if isinstance(size, bool) or not isinstance(size, int) or size < 1]
    for name in wrong:
        faults.add(("coordinates", name), f"coordinate {name} is {sizes[name]!r}; write how many values it has")
    if not sizes or wrong:
        return {}
    shape = tuple(sizes.values())
    needed = (observations.n_states,) if observations.plain else observations.sizes
    if (math.prod(shape),) != needed if observations.plain else shape != needed:
        product = " × ".join(map(str, shape))
        what = f"has {needed[0]} states" if observations.plain else f"has {' × '.join(map(str, needed))}"
        faults.add("coordinates", f"the coordinates have {product} values, and {observations.title} {what}")
        return {}
    digits = np.indices(shape).reshape(len(shape), -1)
    starts = (0,) * len(shape) if observations.plain else observations.starts
    return {name: digits[i] + float(starts[i]) for i, name in enumerate(sizes)}
