"""`diagnose`: what this installation of stltool has, what it lacks, and what for.

Packages and their least versions are those of the installed metadata, or of the pyproject.toml next to the code where
stltool runs from its sources: the metadata of an editable install are as old as its installation. Each package is
really imported, so one that is there but broken is found, too. Nothing is downloaded or changed, except that the folder
for compiled kernels is made, as by the first command that compiles.
"""

from __future__ import annotations

import importlib
import os
import platform
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from packaging.markers import default_environment
from packaging.requirements import Requirement

Status = Literal["ok", "missing", "too old", "broken"]

PURPOSES = {
    "cluster": "sweeps and checks on a dask cluster",
    "falsify": "other optimisers for stltool.testing.falsify",
    "gymnasium": "Gymnasium environments as models, and models as environments",
    "mcap": "traces in MCAP files, as robots record them",
    "parquet": "traces in Parquet files",
    "storm": "models in PRISM's language and in JANI",
    "tensorboard": "learning curves as TensorBoard events",
    "trees": "policies as decision trees, with explain --policy",
    "robot": "the physical robot of the sources' examples/robot",
}
"""Extra → what it is for. Those of developers are not listed."""

_MODULES = {
    "lazy-loader": "lazy_loader",
    "mcap-protobuf-support": "mcap_protobuf",
    "mcap-ros2-support": "mcap_ros2",
    "scikit-learn": "sklearn",
}  # package → what is imported, where the names differ


@dataclass(frozen=True)
class Package:
    """A package that is needed: `extra` None for every installation.

    needed   its least version, as in ">=2"; version: the one installed, None if there is none
    fault    what is wrong, in words; None if nothing is
    """

    name: str
    needed: str
    version: str | None
    status: Status
    extra: str | None = None
    fault: str | None = None


@dataclass(frozen=True)
class Diagnosis:
    """What `stltool doctor` reports.

    cache     the folder where compiled kernels are kept; None: they are compiled in every process
    kernels   how many of them are there now
    memory    bytes: of the machine, available now, and what stltool would allocate at most
    check     how the small check went: None, or what was wrong
    stale     why the installed metadata are not those of this code, and the remedy; None if they are
    """

    version: str
    python: str
    system: str
    threads: int
    place: Path
    packages: tuple[Package, ...]
    cache: Path | None
    kernels: int
    memory: tuple[int, int, int]
    check: str | None
    stale: str | None = None

    @property
    def faults(self) -> list[str]:
        """What keeps stltool from working, each with its remedy; without extras that are simply not installed."""
        found = []
        for one in self.packages:
            needed = one.name + one.needed
            if one.extra is None and one.status == "missing":
                found.append(f"{one.name} is not installed; pip install '{needed}'")
            elif one.status == "too old":
                found.append(f"{one.name} {one.version} is too old; pip install --upgrade '{needed}'")
            elif one.status == "broken":
                found.append(f"{one.name} cannot be imported ({one.fault}); pip install --force-reinstall '{needed}'")
        if self.cache is None:
            found.append(
                "no folder for compiled kernels can be written, so every process compiles for itself; set "
                "NUMBA_CACHE_DIR to a writable folder"
            )
        if self.check is not None:
            found.append(f"a small check went wrong: {self.check}; reinstall stltool")
        return found

    def missing(self, extra: str) -> list[Package]:
        """What of an extra is not there."""
        return [one for one in self.packages if one.extra == extra and one.status == "missing"]


def diagnose() -> Diagnosis:
    """Look at this installation. Imports every package that is there, which takes some seconds."""
    import psutil

    from stltool.sizes import memory_limit

    place = Path(__file__).resolve().parent
    installed = metadata.requires("stltool") or []
    here = _of_sources(place.parent)
    listed = installed if here is None else here
    packages = tuple(_package(*one) for one in _required(listed))
    cache, kernels = _cache() if _works(packages, "numba") else (None, 0)
    machine = psutil.virtual_memory()
    return Diagnosis(
        version=metadata.version("stltool"),
        python=platform.python_version(),
        system=f"{platform.system()} {platform.release()}, {platform.machine()}",
        threads=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        place=place,
        packages=packages,
        cache=cache,
        kernels=kernels,
        memory=(int(machine.total), int(machine.available), memory_limit()),
        check=_small_check(),
        stale=_stale(listed, installed, place.parent) if here is not None else None,
    )


def _of_sources(folder: Path) -> list[str] | None:
    """The requirements in the pyproject.toml of stltool's sources, written as in metadata; None if it is not there."""
    try:
        project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        if project["name"] != "stltool":
            return None
        plain, extras = list(project["dependencies"]), project["optional-dependencies"]
        return plain + [f'{text}; extra == "{extra}"' for extra, texts in extras.items() for text in texts]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _stale(listed: Sequence[str], installed: Sequence[str], folder: Path) -> str | None:
    """What to do if the requirements of the sources are not those of the installed metadata; those of users only, since
    the others are written differently in the two."""
    here, there = (
        {(re.sub("[-_.]+", "-", one.name), str(one.specifier), extra) for one, extra in _required(texts)}
        for texts in (listed, installed)
    )
    if here == there:
        return None
    return (
        f"the metadata of this installation are not those of its sources, which were used here; pip install -e {folder}"
    )


def _required(texts: Sequence[str]) -> Iterator[tuple[Requirement, str | None]]:
    """The packages of a plain installation, then those of its extras for users, from what metadata list."""
    here: dict[str, Any] = {**default_environment()}
    listed = [Requirement(text) for text in texts]
    for extra in (None, *PURPOSES):
        for one in listed:
            always = one.marker is None or one.marker.evaluate({**here, "extra": ""})
            if extra is None:
                needed = always
            else:
                needed = not always and one.marker is not None and one.marker.evaluate({**here, "extra": extra})
            if needed:
                yield one, extra


def _package(required: Requirement, extra: str | None) -> Package:
    name, needed = required.name, str(required.specifier)
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Package(name, needed, None, "missing", extra)
    if not required.specifier.contains(version, prereleases=True):
        return Package(name, needed, version, "too old", extra)
    try:
        importlib.import_module(_MODULES.get(name, name).replace("-", "_"))
    except Exception as error:  # whatever is wrong in there
        return Package(name, needed, version, "broken", extra, f"{type(error).__name__}: {error}".splitlines()[0])
    return Package(name, needed, version, "ok", extra)


def _works(packages: tuple[Package, ...], name: str) -> bool:
    return any(one.name == name and one.status == "ok" for one in packages)


def _cache() -> tuple[Path | None, int]:
    from stltool.kernels.cache import folders

    readable, written = folders()
    return written, sum(len(list(folder.glob("*.nbc"))) for folder in readable if folder.is_dir())


def _small_check() -> str | None:
    """P of reaching the goal in two steps, each succeeding with 3/4, must be 15/16."""
    try:
        import stltool as stl

        model = stl.MDP.from_arrays([[["1/4", "3/4"], [0, 1]]], {}, labels={"goal": [False, True]})
        found = stl.check(stl.build_product(model, stl.parse("F[0,2] goal")), exact=True).fraction
    except Exception as error:  # whatever is wrong with this installation
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return None if str(found) == "15/16" else f"its result is {found} instead of 15/16"


def in_virtual_environment() -> bool:
    """Whether this Python is one of a virtual environment."""
    return sys.prefix != sys.base_prefix
