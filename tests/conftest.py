import contextlib
import functools
import gc
import hashlib
import math
import os
import random
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import pytest
import typer.main
from filelock import FileLock, Timeout
from hypothesis import HealthCheck, settings

import stltool as stl
from stltool.kernels.cache import KernelCache
from tests import slow

T = TypeVar("T")

MORE = float(os.environ.get("STLTOOL_MORE", "0.1"))
WHOLE = 0.3  # from there on, no test and no parameter is left out: CI's share of `make soak`


def many(n: int) -> int:
    """n random instances, mutations or runs times STLTOOL_MORE: .1 in `make test`, more in `make soak`."""
    return max(1, round(n * MORE))


def soaked(n: int) -> int:
    """At least n random instances in `make soak`, and few where there is less time: with the square of STLTOOL_MORE."""
    return max(8, math.ceil(n * (MORE / 30) ** 2))


def some(cases: Iterable[T]) -> list[T]:
    """Of cases that are much alike, many(as there are): all of them in `make soak`."""
    cases = list(cases)
    drawn = random.Random(0).sample(range(len(cases)), min(len(cases), many(len(cases))))
    return [cases[i] for i in sorted(drawn)]


settings.register_profile(
    "random", deadline=None, print_blob=True, max_examples=many(100),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)  # fmt: skip
settings.register_profile("ci", settings.get_profile("random"), derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "random"))

typer.main.get_command = functools.cache(typer.main.get_command)
"""The command line is built once, not again for each command that a test runs in this process."""

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"
OUTSIDE = Path(os.environ.get("STLTOOL_OUTSIDE_DATA", ROOT.parent / "shared" / "data"))
"""Files of others, which are not part of the project (tests/data/README.md)."""

FACTORY = ROOT / "examples" / "factory"
PATROLLING = str(FACTORY / "patrolling.stl")
SMALL = ["-p", "T=5", "-p", "tau=5"]


def pytest_collection_modifyitems(config, items):
    listed = slow.listed()
    for item in items:
        if slow.of_all_parameters(item.nodeid) in listed:
            item.add_marker("slow")
    beyond = slow.beyond((item.nodeid for item in items), listed)
    for item in items:
        if slow.of_all_parameters(item.nodeid) in beyond:
            item.add_marker("soak")
    if MORE < WHOLE and not any("::" in argument for argument in config.args):
        left_out = {name for names in beyond.values() for name in names} if not slow.measured() else set()
        left_out |= {item.nodeid for item in items if of_soak_alone(item)}
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in left_out])
        items[:] = [item for item in items if item.nodeid not in left_out]


def of_soak_alone(item) -> bool:
    return any(mark.kwargs.get("only") for mark in item.iter_markers("soak"))


gc.disable()  # until the tests run: importing and collecting them makes what stays, and takes a quarter less time


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop():
    """What was imported and collected stays: the garbage collector need not look at it again and again, nor often."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 100)
    gc.enable()


def needs_outside(name: str) -> pytest.MarkDecorator:
    """Skip a test that compares with a file of others where that is not present."""
    return pytest.mark.skipif(
        not (OUTSIDE / name).exists(), reason=f"compares with files of others, which are absent: {name}"
    )


@pytest.fixture(scope="session")
def floor5() -> stl.MDP:
    return stl.load_model(FACTORY / "floor-5x5.toml")


@pytest.fixture(scope="session")
def floor10() -> stl.MDP:
    return stl.load_model(FACTORY / "floor-10x10.toml")


@pytest.fixture
def patrolling(floor5):
    """The small sanity task: patrolling with T = tau = 5 on the 5 x 5 floor."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    return stl.build_product(floor5, task)


@pytest.fixture
def flagged(floor5):
    """The same with the paper's flags, which are exact here."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    return stl.build_product(floor5, task, encoding="paper")


@pytest.fixture(scope="session")
def once(tmp_path_factory, worker_id):
    """once(name, make): the folder that make(folder) fills, in whichever of the tests' processes comes first."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent

    def made(name, make):
        folder, half = shared / name, shared / f"half of {name}"
        with FileLock(shared / f"{name}.lock"):
            if not folder.exists():
                shutil.rmtree(half, ignore_errors=True)
                half.mkdir()
                make(half)
                half.rename(folder)
        return folder

    return made


@pytest.fixture(scope="session")
def demo(once):
    """The folder in which `make demo` was run: its out/, and in `printed` what it said."""
    from tests import test_claims as claims

    def make(folder):
        for part in ("examples", "bench", "docs"):
            (folder / part).symlink_to(ROOT / part, target_is_directory=True)
        (folder / "printed").write_text(claims.execute(claims.DEMO, folder, False), encoding="utf-8")

    return once("demo", make)


@pytest.fixture(scope="session", autouse=True)
def each_kernel_is_compiled_once(worker_id, testrun_uid):
    """Of the processes that share the tests, one compiles a kernel, and the others wait and load it."""
    if worker_id == "master":
        yield
        return
    folder = Path(tempfile.gettempdir(), f"stltool-tests-{testrun_uid}")
    load, save, held = KernelCache.load_overload, KernelCache.save_overload, {}

    def load_overload(self, sig, target_context):
        found = load(self, sig, target_context)
        if found is not None or self.cache_path is None:
            return found
        key = hashlib.sha256(repr((self.cache_path, self._name, sig)).encode()).hexdigest()[:16]
        lock = FileLock(folder / key)
        with contextlib.suppress(Timeout):  # of who cannot compile it, or was killed
            lock.acquire(timeout=60)
        held[self._name, sig] = lock
        found = load(self, sig, target_context)
        if found is not None:
            held.pop((self._name, sig)).release()
        return found

    def save_overload(self, sig, data):
        save(self, sig, data)
        if lock := held.pop((self._name, sig), None):
            lock.release()

    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KernelCache, "load_overload", load_overload)
        patch.setattr(KernelCache, "save_overload", save_overload)
        yield
