"""Gymnasium environments named in TOML (models/gymnasium).

    kind = "gymnasium"
    id = "FrozenLake-v1"
    table = "auto"                 true: its transition table, or an error; false: a black box; "auto": what there is
    ends = "merged"                "apart": S more states, for runs that have ended at an observation
    actions = ["left", "down", "right", "up"]      names, in the environment's order; default: their numbers

    [options]                      handed to gymnasium.make as they stand
    is_slippery = true

    [labels]                       name = the observations where it holds, or a Boolean for each state
    goal = [15]

    [coordinates]                  signals read off the state's number as digits, the last one running fastest:
    row = 4                        state = 4 row + column; for Tuple and MultiDiscrete, its components
    column = 4

    [signals]                      name = a number for each state
    danger = [0, 0, 0, 0, 0, 1, …]

Only environments that are installed and registered can be named: a file never makes anything be imported or evaluated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError, near_misses
from stltool.models.gymnasium import from_gymnasium, require_gymnasium
from stltool.models.gymnasium.spaces import Observations
from stltool.models.mdp import MDP
from stltool.models.toml import Fault

_KEYS = ("kind", "id", "table", "ends", "actions", "options", "labels", "coordinates", "signals", "name")


def gymnasium_from_table(table: Mapping[str, Any], default_name: str = "environment") -> MDP:
    """The MDP of the environment that a file's keys name."""
    for key in table:
        if key not in _KEYS:
            raise Fault((key,), f"unknown key {key}; {near_misses(key, _KEYS)}")
    exact = table.get("table", "auto")
    if not isinstance(exact, bool) and exact != "auto":
        raise Fault(("table",), f'table is {exact!r}; write true, false or "auto"')
    ends = table.get("ends", "merged")
    if ends not in ("merged", "apart"):
        raise Fault(("ends",), f'ends is {ends!r}; write "merged" or "apart"')
    actions = table.get("actions")
    if actions is not None and not (isinstance(actions, list) and all(isinstance(a, str) for a in actions)):
        raise Fault(("actions",), f'actions is {actions!r}; write a list of names, such as ["left", "right"]')
    sections = {key: _section(table, key) for key in ("options", "labels", "coordinates", "signals")}
    env = _make(table.get("id"), {key: _plain(value, key) for key, value in sections["options"].items()})
    observations = Observations.of(env)
    labels = {key: _told(("labels", key), observations.label, key, value) for key, value in sections["labels"].items()}
    signals = _coordinates(sections["coordinates"], observations)
    for key, value in sections["signals"].items():
        if key in signals:
            raise Fault(("signals", key), f"signal {key} is a coordinate too; rename one of them")
        signals[key] = _told(("signals", key), observations.signal, key, value)
    name = str(table.get("name", default_name))
    return from_gymnasium(env, labels, signals, table=exact, ends=ends, name=name, action_names=actions)


def _section(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    section = table.get(key, {})
    if not isinstance(section, dict):
        raise Fault((key,), f"{key} is {section!r}; write it as a table: [{key}] and below it name = value")
    return section


def _told(place: tuple[str, str], read: Callable[[str, Any], NDArray[Any]], name: str, value: Any) -> NDArray[Any]:
    """A column of the states; what is wrong with it is told with its line."""
    try:
        return read(name, value)
    except ModelError as error:
        raise Fault(place, str(error)) from None


def _make(name: object, options: dict[str, Any]) -> Any:
    gymnasium = require_gymnasium()
    if not isinstance(name, str) or not name:
        raise Fault(("id",), f'id is {name!r}; write the name of an environment, such as id = "FrozenLake-v1"')
    if ":" in name:  # gymnasium would import what stands before it
        raise Fault(
            ("id",),
            f"id is {name!r}: a file cannot have a module imported; write the name alone of an environment that is "
            "registered, or use stl.from_gymnasium in Python",
        )
    try:
        gymnasium.spec(name)
    except gymnasium.error.Error as error:
        hint = f"{error}".rstrip(".")
        raise Fault(("id",), f"id is {name!r}: {hint}; {near_misses(name, gymnasium.registry)}") from None
    try:
        return gymnasium.make(name, **{"disable_env_checker": True} | options)
    except Exception as error:  # the environment's own, on options that it does not take
        shown = ", ".join(f"{key} = {value!r}" for key, value in options.items()) or "none"
        raise Fault(("options",), f"{name} cannot be made with the options {shown}: {error}") from None


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
    raise Fault(("options", key), f"option {key} is {value!r}; write a number, a text, true or false, or a list")


def _coordinates(sizes: Mapping[str, Any], observations: Observations) -> dict[str, NDArray[np.float64]]:
    """Signals (S,) from the digits of the state's number; of a compound space, from its components."""
    if not sizes:
        return {}
    for name, size in sizes.items():
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise Fault(("coordinates", name), f"coordinate {name} is {size!r}; write how many values it has")
    shape = tuple(sizes.values())
    needed = (observations.n_states,) if observations.plain else observations.sizes
    if (math.prod(shape),) != needed if observations.plain else shape != needed:
        product = " × ".join(map(str, shape))
        what = f"has {needed[0]} states" if observations.plain else f"has {' × '.join(map(str, needed))}"
        raise Fault(("coordinates",), f"the coordinates have {product} values, and {observations.title} {what}")
    digits = np.indices(shape).reshape(len(shape), -1)
    starts = (0,) * len(shape) if observations.plain else observations.starts
    return {name: digits[i] + float(starts[i]) for i, name in enumerate(sizes)}
