"""Examples, the package's tour, and the README's code run as they stand."""

import doctest
import re
import subprocess
import sys

import pytest

import stltool as stl
from stltool.errors import SettingsError
from tests.conftest import ROOT

TASKS = sorted(path for path in (ROOT / "examples").rglob("*.stl") if path.parent.name != "monitor")  # which has logs


def test_there_are_examples():
    assert {path.name for path in TASKS} >= {"reaching.stl", "charging.stl", "patrolling.stl"}


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_example_task_can_be_checked(path):
    task = stl.load_task(path)
    product = stl.build_product(stl.load_model(task.model), task)
    if product.model.blackbox is not None:
        with pytest.raises(SettingsError, match="is a black box; use stl.learn and stl.estimate"):
            stl.check(product)
        return
    best = stl.check(product) if product.model.intervals is None else stl.robust_check(product)
    assert (0.69 if path.parent.name == "frozenlake" else 0.9) < best.probability <= best.upper <= 1


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_example_task_is_in_canonical_layout(path):
    text = path.read_text(encoding="utf-8")
    assert stl.format_task(text) == text
    assert stl.ambiguities(stl.load_task(path).document) == []


def test_the_tour_of_the_package_runs():
    results = doctest.testmod(stl)
    assert results.attempted >= 8
    assert results.failed == 0


def test_the_readmes_python_runs(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        code = block.replace('"examples/', f'"{ROOT.as_posix()}/examples/')
        done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_the_readmes_commands_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^make (\w+)", text, flags=re.MULTILINE))
    assert targets >= {"demo", "test"}
    assert all(re.search(rf"^{target}:", makefile, flags=re.MULTILINE) for target in targets)
