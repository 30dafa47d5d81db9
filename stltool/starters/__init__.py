"""What `stltool new` writes: starters, and the examples, inside the package in a wheel, beside it in a checkout.

A starter is a folder of this package: a task, a model or a log, and comments that say what can be changed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from stltool.errors import SettingsError, near_misses

_HERE = Path(__file__).resolve().parent

KINDS = {
    "grid": "a robot on a floor, drawn as a map",
    "gymnasium": "a Gymnasium environment",
    "prism": "a model in PRISM's explicit files",
    "trace": "a recorded log to monitor, without a model",
}
EXAMPLES = {
    "factory": "the robot of Wang et al. (2024) on a factory floor: tasks, floors, trade-offs",
    "ward": "a delivery in a hospital, the example of the tutorial",
    "battery": "a robot that must not run flat, in PRISM's explicit files",
    "team": "two robots on one floor, a composition of grids",
    "lift": "a lift whose passengers do not wait for long",
    "zeroconf": "a protocol by which devices choose addresses",
    "frozenlake": "FrozenLake, exact and as a black box",
    "drone": "the log of a flight, judged rule by rule",
    "insulin": "a day of an insulin pump, judged by its therapy",
    "monitor": "the log of a delivery robot's shift",
    "paper": "the comparison of methods of Wang et al. (2024) as sweeps",
    "robot": "a simulated robot with wheels as a black box, in Python: learn, promise, compare",
    "deep": "a DQN on a task, judged exactly, in Python",
}
_NEXT = {
    "grid": ["stltool explain task.stl", "stltool check task.stl", "stltool run task.stl"],
    "gymnasium": ["stltool check task.stl", "stltool run task.stl"],
    "prism": ["stltool check task.stl", "stltool why task.stl"],
    "trace": ["stltool explain task.stl", "stltool monitor task.stl log.csv --plot log.png"],
    "factory": ["stltool check patrolling.stl -p T=5 -p tau=5", "stltool run patrolling.stl"],
    "frozenlake": ["stltool check crossing.stl", "stltool run crossing-blackbox.stl"],
    "monitor": ["stltool monitor duty.stl shift.csv --plot shift.png"],
    "paper": ["stltool sweep small.toml"],
    "ward": ["stltool check delivery.stl", "stltool run delivery.stl"],
    "battery": ["stltool check inspection.stl", "stltool why inspection.stl"],
    "team": ["stltool check handover.stl", "stltool why handover.stl"],
    "lift": ["stltool check service.stl --exact"],
    "zeroconf": ["stltool check address.stl --exact"],
    "drone": ["stltool monitor rules.stl flight.csv --plot flight.png"],
    "insulin": ["stltool monitor therapy.stl day.csv --plot day.png"],
    "robot": ["python . --plant kinematic --robots 100 --moves 20000 --runs 500", "python . --help"],
    "deep": ["python dqn.py --episodes 40 --seeds 2"],
}
_PROGRAMS = {"robot", "deep"}  # examples that are Python
_ALSO = {
    "deep": ["factory/floor-5x5.toml"],
    "robot": ["factory/floor-5x5.toml", "factory/patrolling.stl"],
}  # files of other examples


@dataclass(frozen=True)
class Starter:
    """Files to write, by name relative to a folder, and commands to go on with there."""

    files: dict[str, bytes]
    next: list[str]


def starter(kind: str) -> Starter:
    """The starter of a kind. Raises SettingsError for another one."""
    if kind not in KINDS:
        raise SettingsError(f"--kind {kind}: there is no such kind; {near_misses(kind, KINDS)}")
    return Starter(_files(_HERE / kind), _NEXT[kind])


def example(name: str) -> Starter:
    """An example as shipped. Raises SettingsError for another one."""
    if name not in EXAMPLES:
        raise SettingsError(f"--example {name}: there is no such example; {near_misses(name, EXAMPLES)}")
    for folder in (_HERE.parent / "examples", _HERE.parent.parent / "examples"):
        if (folder / name).is_dir():
            files = _files(folder / name)
            if name in _PROGRAMS:
                files |= {path.name: _alone(path.read_bytes(), name) for path in _program(folder / name)}
            files |= {Path(other).name: (folder / other).read_bytes() for other in _ALSO.get(name, [])}
            return Starter(files, _NEXT[name])
    raise FileNotFoundError(f"the example {name} is missing from this installation; reinstall stltool")


def _files(folder: Path) -> dict[str, bytes]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix in _SUFFIXES)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _program(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in (".py", ".html") and path.stat().st_size)


def _alone(text: bytes, name: str) -> bytes:
    """A module of an example, for a folder that is not a package: its siblings are beside it."""
    package = rb"examples\." + name.encode()
    text = re.sub(rb"\bfrom " + package + rb"\.", b"from ", text)
    text = re.sub(rb"python -m " + package + rb"\.(\w+)", rb"python \1.py", text)
    return re.sub(rb"python -m " + package + rb"\b", b"python .", text)


_SUFFIXES = {".stl", ".toml", ".csv", ".tra", ".lab", ".sta"}  # not what runs of an example have left
