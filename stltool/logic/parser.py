"""Text → Formula / Task. `syntax` finds the statements and their trees, `builder` turns them into nodes."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import cast

from stltool.arguments import described, flag, mapping, require
from stltool.arguments import path as path_of
from stltool.errors import FileError, SettingsError, StlSyntaxError, named, near_misses
from stltool.files import read_text
from stltool.logic.builder import FORMULAS, Builder
from stltool.logic.expectation import Expectation
from stltool.logic.formula import Formula, Term
from stltool.logic.quantities import Duration, ParamValue, Quantity, duration, one, quantity
from stltool.logic.syntax import LONGEST_TEXT, Document, branches, read, refuse
from stltool.logic.task import Task
from stltool.numbers import NumberError
from stltool.source import Source

_NO_TASKS = {".toml", ".tra", ".lab", ".sta"}  # files of models


def parse(
    text: str,
    params: Mapping[str, ParamValue] | None = None,
    name: str = "formula",
    step: str | Duration | None = None,
    unbounded: bool = False,
    unit: str | Duration | None = None,
) -> Formula:
    """The formula written in `text`; `params` gives values to the names used in its bounds and predicates.

    `name` stands for the text in messages; `step` ("0.1s") is the duration of a step, needed where bounds are times
    with units; `unit` ("s", or "step") is what plain numbers in bounds are, needed where a step is given. `unbounded`
    allows temporal operators without an interval, or with inf as upper bound, which only monitors can judge (at the end
    of a trace). Raises StlSyntaxError with line, column and a caret.
    """
    return formula_task(text, params, name, step, unbounded, unit).formula


def formula_task(
    text: str,
    params: Mapping[str, ParamValue] | None = None,
    name: str = "formula",
    step: str | Duration | None = None,
    unbounded: bool = False,
    unit: str | Duration | None = None,
) -> Task:
    """The formula written in `text` as a task of that name, which keeps its text; arguments as for `parse`."""
    _require_text("parse", text, name, params, unbounded)
    document = read(Source(name, text), "formula")
    refuse(document.faults)
    return _build_formula(document, _step(step), _unit(unit), unbounded, _exact(params))


def parse_task(
    text: str,
    params: Mapping[str, ParamValue] | None = None,
    task: str | None = None,
    name: str = "task",
    path: str | Path | None = None,
    unbounded: bool = False,
) -> Task:
    """The task described by the text of a task file; see `load_task`."""
    _require_text("parse_task", text, name, params, unbounded)
    require(task, str, "parse_task's task", _CHOICE, optional=True)
    path = path_of(path, "parse_task's path") if path is not None else None
    return _build(read(Source(name, text), "task"), path, unbounded, task, _exact(params))


def load_task(
    path: str | Path,
    params: Mapping[str, ParamValue] | None = None,
    task: str | None = None,
    unbounded: bool = False,
) -> Task:
    """Read a task file.

    `params` overrides param lines of the file; `task` chooses a definition (default: the last); `unbounded` allows
    temporal operators without an interval, which only monitors can judge. Raises FileError if the file cannot be read
    as text, and StlSyntaxError, listing every fault, if it does not parse.
    """
    path = path_of(path, "load_task's path")
    require(task, str, "load_task's task", _CHOICE, optional=True)
    _require_text("load_task", "", "", params, unbounded)
    text = _task_text(path)
    return parse_task(text, params, task, name=str(path), path=path, unbounded=unbounded)


@dataclass(frozen=True)
class Survey:
    """What a task file says as far as it can be understood, and its faults, in text order.

    `task` is None if there are any; what the statements without faults say is there all the same. `params` are the
    names on its param lines.
    """

    path: Path
    faults: tuple[str, ...]
    task: Task | None
    model: Path | None
    definitions: Mapping[str, Formula | Term]
    expectations: tuple[Expectation, ...]
    params: frozenset[str]


def _task_text(path: Path) -> str:
    """The text of a task file. FileError, with what to give instead, for a folder, no file, or a model file."""
    if path.is_dir():
        tasks = sorted(other.name for other in path.glob("*.stl"))
        remedy = f"name its task files, such as {path / tasks[0]}" if tasks else "name a task file; it has none (.stl)"
        raise FileError(f"{path}: this is a folder; {remedy}")
    siblings = [] if path.exists() else [other.name for other in path.parent.glob("*.stl")]
    if siblings:
        raise FileError(f"{path}: there is no such task file; {near_misses(path.name, siblings)}")
    text = read_text(path, "task file", LONGEST_TEXT)
    if path.suffix.lower() in _NO_TASKS:
        try:
            sweep = path.suffix.lower() == ".toml" and "sweep" in tomllib.loads(text)
        except tomllib.TOMLDecodeError:
            sweep = False
        if sweep:
            raise FileError(f"{path}: this is a sweep file; give it to stltool sweep, or give the .stl task")
        raise FileError(f"{path}: this is a model file; give the .stl task, which names its model, or use --model")
    return text


def survey_task(path: Path, params: Mapping[str, ParamValue] | None = None) -> Survey:
    """A task file, whose formulas may be unbounded, read for its expectations. FileError if it cannot be read.

    `params` overrides those of its param lines that it names; other names in it are ignored.
    """
    document = read(Source(str(path), _task_text(path)), "task")
    lines = [branches(tree) for tree in document.trees if tree.data == "params"]
    declared = frozenset(str(param.children[0]) for line in lines for param in line)
    overrides = _exact({name: value for name, value in (params or {}).items() if name in declared})
    builder = _builder(document, True, overrides)
    faults = [fault.message for fault in sorted([*document.faults, *builder.faults], key=lambda fault: fault.start)]
    task = None
    if not faults:
        try:
            task = _finished(builder, document, path, True, None, overrides)
        except StlSyntaxError as error:
            faults.append(str(error))
    model = path.parent / builder.model if builder.model is not None else None
    return Survey(path, tuple(faults), task, model, builder.definitions, tuple(builder.expectations), declared)


_CHOICE = "name one of the file's definitions in quotes"


def _require_text(caller: str, text: object, name: object, params: object, unbounded: object) -> None:
    """ArgumentError unless each argument is of the right kind."""
    require(text, str, f"{caller}'s text", "write it in quotes; for a file, stl.load_task(path)")
    require(name, str, f"{caller}'s name", "write it in quotes")
    mapping(params, f"{caller}'s params", "{'T': 20}", optional=True)
    flag(unbounded, f"{caller}'s unbounded")


def _build_formula(
    document: Document,
    step: Duration | None,
    unit: Duration | None,
    unbounded: bool,
    params: Mapping[str, Quantity],
    more: Mapping[str, ParamValue] | None = None,
) -> Task:
    values = {**params, **_exact(more)}
    for param in sorted(values.keys() - document.names):
        close = near_misses(param, document.names)
        told = close if close.startswith("did") else "no such name occurs in it"
        raise StlSyntaxError(f"{document.source.name}: this formula has no param {param}; {told}")
    builder = Builder(document.source, values, step=step, unit=unit, unbounded=unbounded, lines=False)
    formula = builder.whole_formula(document.trees[0])
    builder.require_shallow(formula)
    rebuild = partial(_build_formula, document, step, unit, unbounded, values)
    name = document.source.name
    return Task(name, formula, params=values, step=step, unit=unit, document=document, rebuild=rebuild)


def _build(
    document: Document,
    path: Path | None,
    unbounded: bool,
    task: str | None,
    overrides: Mapping[str, Quantity],
    more: Mapping[str, ParamValue] | None = None,
) -> Task:
    """The task of a text that is already parsed; the overrides in `more` replace earlier ones."""
    overrides = {**overrides, **_exact(more)}
    builder = _builder(document, unbounded, overrides)
    refuse([*document.faults, *builder.faults])
    return _finished(builder, document, path, unbounded, task, overrides)


def _builder(document: Document, unbounded: bool, overrides: Mapping[str, Quantity]) -> Builder:
    """What the statements say; its faults come on top of the document's."""
    faulty = [name for fault in document.faults for name in fault.names]
    builder = Builder(document.source, overrides=overrides, unbounded=unbounded, faulty=faulty)
    builder.statements(document.trees)
    return builder


def _finished(
    builder: Builder,
    document: Document,
    path: Path | None,
    unbounded: bool,
    task: str | None,
    overrides: Mapping[str, Quantity],
) -> Task:
    """The task of a text without faults in its statements."""
    name = document.source.name
    if not builder.definitions:
        raise StlSyntaxError(f"{name}: the file defines no task; write one, such as reach := F[0,10] A")
    if overrides.keys() - builder.params.keys():
        unknown = min(overrides.keys() - builder.params.keys())
        raise StlSyntaxError(f"{name}: there is no param {unknown} to override; {near_misses(unknown, builder.params)}")
    chosen = task if task is not None else list(builder.definitions)[-1]
    if chosen not in builder.definitions:
        raise StlSyntaxError(f"{name}: there is no definition {chosen}; {near_misses(chosen, builder.definitions)}")
    formula = builder.definitions[chosen]
    if not isinstance(formula, FORMULAS):
        raise StlSyntaxError(
            f"{name}: {chosen} is a number, not a task; end the file with a formula, or choose one by name"
        )
    builder.require_shallow(cast(Formula, formula))
    task_read = Task(
        chosen,
        cast(Formula, formula),
        params=builder.params,
        definitions=builder.definitions,
        path=path,
        step=builder.step,
        unit=builder.unit,
        expectations=tuple(builder.expectations),
        document=document,
        rebuild=partial(_build, document, path, unbounded, chosen, overrides),
    )
    return replace(task_read, model=task_read.folder / builder.model) if builder.model is not None else task_read


def _exact(params: Mapping[str, ParamValue] | None) -> dict[str, Quantity]:
    return {name: quantity(name, value) for name, value in (params or {}).items()}


def _step(step: str | Duration | None) -> Duration | None:
    try:
        value = duration(step) if isinstance(step, str) else step
    except NumberError:
        value = None
    if step is not None and (not isinstance(value, Duration) or value.seconds <= 0 or value.steps):
        raise SettingsError(
            f"{named('step')} {described(step)} is not a positive time with a unit; write, for example, "
            f"{named('step', 'step=0.1s')}"
        )
    return value


def _unit(unit: str | Duration | None) -> Duration | None:
    try:
        value = (one(unit) or duration(unit)) if isinstance(unit, str) else unit
    except NumberError:
        value = None
    if unit is not None and (not isinstance(value, Duration) or min(value.seconds, value.steps) < 0 or value == _NONE):
        examples = named("unit", "unit='s'"), named("unit", "unit='step'")
        raise SettingsError(
            f"{named('unit')} {described(unit)} is not a unit of time; write {examples[0]}, another of "
            f"{', '.join(_UNITS)}, or {examples[1]}"
        )
    return value


_NONE = Duration(Fraction(0))
_UNITS = ("ns", "us", "ms", "s", "min", "h")
