"""Examples, the package's tour, and the README's code run as they stand."""

import doctest
import importlib
import re
import runpy

import pytest

import stltool as stl
from stltool.errors import SettingsError
from tests.conftest import ROOT

ALL = sorted((ROOT / "examples").rglob("*.stl"))
LOGS = [path for path in ALL if list(path.parent.glob("*.csv"))]
TASKS = [path for path in ALL if path not in LOGS]
MODELS = {"battery": "robot", "lift": "lift", "zeroconf": "zeroconf"}  # written by a script of the same name
RECORDED = {"drone": "flight", "insulin": "day"}


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


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem)
def test_every_example_log_is_judged_and_somewhere_violated(path):
    task = stl.load_task(path)
    (log,) = path.parent.glob("*.csv")
    names = log.read_text(encoding="utf-8").partition("\n")[0].split(",")
    found = stl.monitor(task, stl.load_trace(log, [name for name in names if name not in ("step", "note")]))
    assert found.verdicts.any()
    assert not found.verdicts.all()


@pytest.mark.parametrize(("folder", "name"), [*MODELS.items(), *RECORDED.items()])
def test_scripts_write_the_files_that_lie_beside_them(folder, name, tmp_path):
    importlib.import_module(f"examples.{folder}.{name}").main(tmp_path)
    written = sorted(path.name for path in tmp_path.iterdir())
    assert len(written) >= (3 if folder in MODELS else 1)
    for file in written:
        there = (ROOT / "examples" / folder / file).read_text(encoding="utf-8")
        assert (tmp_path / file).read_text(encoding="utf-8") == there, f"python -m examples.{folder}.{name}"


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_every_example_task_is_in_canonical_layout(path):
    text = path.read_text(encoding="utf-8")
    assert stl.format_task(text) == text
    assert stl.ambiguities(stl.load_task(path).document) == []


def test_the_tour_of_the_package_runs():
    results = doctest.testmod(stl)
    assert results.attempted >= 8
    assert results.failed == 0


def test_the_readmes_python_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        (tmp_path / "program.py").write_text(block.replace('"examples/', f'"{ROOT.as_posix()}/examples/'))
        runpy.run_path("program.py", run_name="__main__")


def test_the_readmes_commands_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^make (\w+)", text, flags=re.MULTILINE))
    assert targets >= {"demo", "test"}
    assert all(re.search(rf"^{target}:", makefile, flags=re.MULTILINE) for target in targets)
