"""What a command does with the files that its parameters name: read them, or write them.

Each parameter that names a file declares this in its annotation, next to its help text. Before a command begins, the
files it would write are compared with all files it reads and with each other: a result never replaces an input.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stltool.errors import SettingsError, StlToolError

Given = Mapping[str, Any]
"""The command's arguments, by parameter."""


def itself(path: Path) -> Iterable[Path]:
    return [path]


@dataclass(frozen=True)
class Reads:
    """The parameter names a file that is read, the command's `what`; `files` yields all files read for it."""

    what: str
    files: Callable[[Path], Iterable[Path]] = itself


@dataclass(frozen=True)
class Writes:
    """The parameter names a file that is written, or a folder; `files` yields all files written for it.

    `default` gives the path if the option is not given; None if nothing is written then.
    """

    files: Callable[[Path], Iterable[Path]] = itself
    default: Callable[[Given], Path | None] = lambda given: None


@dataclass(frozen=True)
class Parameter:
    """A parameter that names files: its name in messages, and its role."""

    shown: str
    roles: tuple[Reads | Writes, ...]


def require_apart(parameters: Mapping[str, Parameter], given: Given) -> None:
    """SettingsError if a command would write a file it reads, or two results to one file; links are followed."""
    written = list(_written(parameters, given))
    if not written:
        return
    read = list(_read(parameters, given))
    for number, (option, path) in enumerate(written):
        for what, source in read:
            if _same(path, source):
                named = what if str(path) == str(source) else f"{what}, {source}"
                raise SettingsError(f"{option}: {path} would replace {named}; name another file")
        for other, twin in written[:number]:
            if _same(path, twin):
                both = f"{other} and {option} would both" if other != option else f"{option} would twice"
                raise SettingsError(f"{both} write {path}; name a file for each")


def require_inside(parameters: Mapping[str, Parameter], given: Given) -> None:
    """SettingsError if a file that is given names one outside its own folder, or an environment, which is a program.

    For files of strangers. Links are followed, those of the given files too.
    """
    for shown, role, source, file in _reads(parameters, given):
        replaced = role.files is task_files and given.get("model") is not None  # the task's own model is not read
        if not file.exists() or (replaced and file != source):
            continue
        folder = source.parent.resolve()
        if not _resolved(file).is_relative_to(folder):
            by = f"{file} is a link that leads" if file == source else f"{source} names {file}, which is"
            raise SettingsError(f"--sandbox: {by} outside the folder of {shown}; give it a copy in that folder")
        if _runs_code(file):
            raise SettingsError(f"--sandbox: {file} names a Gymnasium environment, which is a program; it is not run")


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a link to itself
        return path.absolute()


def _runs_code(path: Path) -> bool:
    if path.suffix.lower() != ".toml" or not path.is_file():
        return False
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")).get("kind") == "gymnasium"
    except (OSError, ValueError, RecursionError):
        return False


def _written(parameters: Mapping[str, Parameter], given: Given) -> Iterable[tuple[str, Path]]:
    for name, parameter in parameters.items():
        for role in parameter.roles:
            if isinstance(role, Writes):
                for path in _paths(given.get(name)) or filter(None, [role.default(given)]):
                    yield from ((parameter.shown, file) for file in role.files(path))


def _read(parameters: Mapping[str, Parameter], given: Given) -> Iterable[tuple[str, Path]]:
    for shown, role, path, file in _reads(parameters, given):
        yield f"the {role.what}" if file == path else f"a file that {shown} needs", file


def _reads(parameters: Mapping[str, Parameter], given: Given) -> Iterable[tuple[str, Reads, Path, Path]]:
    """Each parameter that is read, its role, the path given, and every file that is read for it."""
    for name, parameter in parameters.items():
        for role in parameter.roles:
            if isinstance(role, Reads):
                for path in _paths(given.get(name)):
                    yield from ((parameter.shown, role, path, file) for file in role.files(path))


def _paths(value: Any) -> list[Path]:
    """One path, several paths, or none."""
    values = value if isinstance(value, list) else [] if value is None else [value]
    return [Path(one) for one in values]


def _same(path: Path, other: Path) -> bool:
    try:
        if path.samefile(other):
            return True
    except (OSError, ValueError):  # one of them does not exist, or is not a path
        pass
    try:
        return path.resolve() == other.resolve()
    except (OSError, RuntimeError, ValueError):  # a link to itself, or a formula too long for a path
        return False


# ------------------------------------------------------------------------------------------------ what is read for it


def model_files(path: Path) -> Iterable[Path]:
    """A model file and its companion files."""
    from stltool.models.load import companions

    return [path, *companions(path)]


def task_files(path: Path) -> Iterable[Path]:
    """A task file and the files of its model; only the path itself if it cannot be read as a task file."""
    from stltool.logic.parser import survey_task

    try:
        model = survey_task(path).model if path.is_file() else None
    except (StlToolError, OSError, ValueError):
        model = None
    return [path, *(model_files(model) if model is not None else ())]


def expectation_files(path: Path) -> Iterable[Path]:
    """A task file, the files of its model, and the policies and traces that its expectations name."""
    import stltool as stl
    from stltool.gate import task_reads

    try:
        task = stl.load_task(path, unbounded=True) if path.is_file() else None
    except (StlToolError, OSError, ValueError):
        task = None
    return [*task_files(path), *(task_reads(task) if task is not None else ())]


def sweep_files(path: Path) -> Iterable[Path]:
    """A sweep file, its tasks and their models."""
    yield path
    try:
        scenarios = tomllib.loads(path.read_text(encoding="utf-8")).get("scenario", [])
    except (OSError, ValueError, RecursionError):
        return
    for scenario in scenarios if isinstance(scenarios, list) else []:
        for key, files in (("task", task_files), ("model", model_files)):
            if isinstance(scenario, dict) and isinstance(named := scenario.get(key), str):
                yield from files(path.parent / named)


# ----------------------------------------------------------------------------------------------------- what is written


def within(*names: str) -> Callable[[Path], Iterable[Path]]:
    """Files of a folder."""
    return lambda folder: [folder / name for name in names]


def task_folder(given: Given) -> Path | None:
    """The folder of `run` without --out: out/NAME, with the name of the task."""
    import stltool as stl

    try:
        return Path("out") / stl.load_task(given["task"], task=given["name"]).name
    except StlToolError:
        return None


def sweep_folder(given: Given) -> Path | None:
    """The folder of `sweep` without --out: out/NAME, with the name of the sweep."""
    try:
        table = tomllib.loads(given["file"].read_text(encoding="utf-8"))
        return Path("out", str(table["sweep"].get("name", given["file"].stem)))
    except (OSError, ValueError, RecursionError, LookupError, AttributeError, TypeError):
        return None


def written_model(path: Path) -> Iterable[Path]:
    """A model file and its companion files."""
    from stltool.models.save import written_files

    return written_files(path)


def beside(ending: str) -> Callable[[Path], Iterable[Path]]:
    """The file of the same name with another extension."""
    return lambda path: [path.with_suffix(ending)]
