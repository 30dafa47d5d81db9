"""A sweep file (TOML) → Sweep, read strictly: unknown keys are errors.

[sweep]
name = "small"                   results go to out/small
seeds = 10                       how many (0 … 9), or a list
settings = { episodes = 4000 }   for all runs: those of stl.learn (episodes, evaluate_every, most_steps, stop_gap), and
                                 those of methods, each of which uses the ones it has
columns = 4                      panels in a row of the figure
story = false                    show the surrogate's gap and the encodings' sizes, too

[[method]]
name = "cfer"                    a method of stl.learn
id = "cfer"                      its name here; default: the method's
faithful = true
settings = { batch = 64 }        for this method only; they override the scenario's, which override the sweep's

[[scenario]]
id = "P1"
task = "patrolling.stl"          relative to this file
model = "floor-5x5.toml"         default: the task file's model line
definition = "patrolling"        default: the task file's last one
params = { T = 10, tau = 10 }
settings = { episodes = 4000 }
published = { cfer = 0.826 }     published figures shown for comparison, by method id
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection
from decimal import Decimal
from pathlib import Path
from typing import Any

from stltool.arguments import path as path_of
from stltool.errors import SettingsError, StlToolError, near_misses
from stltool.files import read_text
from stltool.learning.learner import Learner
from stltool.learning.methods import class_of, require_setting
from stltool.learning.settings import Budget, settings_of
from stltool.learning.sweep import Method, Scenario, Sweep, read_seeds
from stltool.logic.parser import load_task
from stltool.models import MDP, load_model

_SWEEP = ("name", "seeds", "settings", "columns", "story")
_METHOD = ("id", "name", "faithful", "settings")
_SCENARIO = ("id", "task", "model", "definition", "params", "settings", "published")
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")  # valid folder names on all systems
_MISSING = object()


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep's file, its tasks and models. Raises a StlToolError that names file, position and key."""
    path = path_of(path, "load_sweep's path")
    try:
        table = tomllib.loads(read_text(path, "sweep file"), parse_float=Decimal)
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"{path}: not valid TOML: {error}") from None
    try:
        return _sweep(table, path)
    except StlToolError as error:
        text = str(error)
        raise (error if text.startswith(f"{path}: ") else type(error)(f"{path}: {text}")) from None


def _sweep(table: dict[str, Any], path: Path) -> Sweep:
    _known(table, ("sweep", "method", "scenario"), "the file")
    head = _take(table, "sweep", dict, "the file")
    where = "[sweep]"
    _known(head, _SWEEP, where)
    name = _id(_take(head, "name", str, where, path.stem), f"{where} name")
    try:
        seeds = read_seeds(_take(head, "seeds", (int, list), where, 10))
    except SettingsError as error:
        raise SettingsError(f"{where}: {error}") from None
    methods = [_method(entry, f"[[method]] {i}") for i, entry in enumerate(_entries(table, "method"), start=1)]
    _different([method.id for method in methods], "method", 'give each an id = "…" of its own')
    models: dict[Path, MDP] = {}
    scenarios = [
        _scenario(entry, i, path, methods, models) for i, entry in enumerate(_entries(table, "scenario"), start=1)
    ]
    _different([scenario.id for scenario in scenarios], "scenario", "rename one")
    columns = _take(head, "columns", int, where, min(4, math.ceil(math.sqrt(len(scenarios)))))
    if columns < 1:
        raise SettingsError(f"{where}: columns is {columns}; it must be an integer from 1")
    settings = _settings(head, where, [method.learner for method in methods])
    return Sweep(
        name, tuple(scenarios), tuple(methods), seeds, settings, columns, _take(head, "story", bool, where, False)
    )


def _method(entry: dict[str, Any], where: str) -> Method:
    _known(entry, _METHOD, where)
    name = _take(entry, "name", str, where)
    faithful = _take(entry, "faithful", bool, where, False)
    try:
        learner = class_of(name, faithful)
    except SettingsError as error:
        raise SettingsError(f"{where}: {error}") from None
    given = _id(_take(entry, "id", str, where, name), f"{where} id")
    return Method(given, learner, _settings(entry, where, [learner]))


def _scenario(
    entry: dict[str, Any], number: int, path: Path, methods: list[Method], models: dict[Path, MDP]
) -> Scenario:
    where = f"[[scenario]] {number}"
    own_id = _id(_take(entry, "id", str, where), f"{where} id")
    where = f"scenario {own_id}"
    _known(entry, _SCENARIO, where)
    params = _take(entry, "params", dict, where, {})
    published = _take(entry, "published", dict, where, {})
    _known(published, [method.id for method in methods], f"{where}, published")
    for method in published:
        _take(published, method, (int, float), f"{where}, published")
    task_file = path.parent / _take(entry, "task", str, where)
    try:
        task = load_task(task_file, params, _take(entry, "definition", str, where, None))
        model_file = path.parent / entry["model"] if _take(entry, "model", str, where, None) else task.model
        if model_file is None:
            raise SettingsError('neither the scenario nor its task file names a model; add model = "floor.toml"')
        if model_file not in models:
            models[model_file] = load_model(model_file)
            models[model_file].require_points()  # curves are exact
    except StlToolError as error:
        raise type(error)(f"{where}: {error}") from None
    settings = _settings(entry, where, [method.learner for method in methods])
    return Scenario(own_id, task, models[model_file], settings, published)


def _settings(entry: dict[str, Any], where: str, learners: list[type[Learner[Any]]]) -> dict[str, Any]:
    """Settings of learning, or of at least one of these learners, each in its range."""
    settings: dict[str, Any] = _take(entry, "settings", dict, where, {})
    checked, budget = {}, settings_of(Budget)
    for name, given in settings.items():
        value = float(given) if isinstance(given, Decimal) else given
        owners = [budget[name]] if name in budget else []
        owners += [settings_of(cls)[name] for cls in learners if name in settings_of(cls)]
        try:
            if not owners:
                _refuse(name, learners)
            for owner in owners:
                checked[name] = owner.checked(value)
        except SettingsError as error:
            raise SettingsError(f"{where}, settings: {error}") from None
    return checked


def _refuse(name: str, learners: list[type[Learner[Any]]]) -> None:
    """SettingsError for a setting that none of them has."""
    if len({*learners}) == 1:
        require_setting(learners[0], name)
    known = {*settings_of(Budget), *(known for cls in learners for known in settings_of(cls))}
    raise SettingsError(f"none of the sweep's methods has a setting {name!r}; {near_misses(name, known)}")


def _entries(table: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = _take(table, key, list, "the file")
    if not entries or not all(isinstance(entry, dict) for entry in entries):
        raise SettingsError(f"{key} is {entries!r}; write one or more tables [[{key}]]")
    return entries


def _take(table: dict[str, Any], key: str, kind: type | tuple[type, ...], where: str, default: Any = _MISSING) -> Any:
    """The value of a key, of that type; true and false are not numbers."""
    value = table.get(key, default)
    if value is _MISSING:
        raise SettingsError(f"{where} has no {key}; add it")
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if isinstance(value, Decimal):  # only params are exact
        value = float(value)
        if float in kinds:
            table[key] = value
    if key in table and (type(value) not in kinds):
        shown = " or ".join(_KINDS[one] for one in kinds)
        raise SettingsError(f"{where}: {key} is {value!r}; it must be {shown}")
    return value


_KINDS = {str: "text in quotes", int: "an integer", float: "a number", bool: "true or false", list: "a list",
          dict: "a table"}  # fmt: skip


def _known(table: dict[str, Any], keys: Collection[str], where: str) -> None:
    for key in table:
        if key not in keys:
            raise SettingsError(f"{where}: unknown key {key}; {near_misses(key, keys)}")


def _id(text: str, where: str) -> str:
    if not _ID.fullmatch(text):
        raise SettingsError(f"{where} is {text!r}; it names a folder; use letters, digits, and inside . _ + -")
    return text


def _different(ids: list[str], kind: str, remedy: str) -> None:
    seen: set[str] = set()
    for one in ids:
        if one.lower() in seen:  # on some systems, Seed and seed are the same folder
            raise SettingsError(f"two {kind}s are called {one} (ignoring case); {remedy}")
        seen.add(one.lower())
