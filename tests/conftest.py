import functools
import os
from pathlib import Path

import pytest
import typer.main
from hypothesis import HealthCheck, settings

import stltool as stl

MORE = float(os.environ.get("STLTOOL_MORE", "1"))


def many(n: int) -> int:
    """n random instances, mutations or runs; `make soak` asks for STLTOOL_MORE times as many."""
    return max(1, round(n * MORE))


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
