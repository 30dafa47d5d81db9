"""The pictures of README and docs are what their commands draw today.

Compared in the units of their axes, not byte by byte: another version of matplotlib may move a margin.
"""

import importlib.util
import re

import pytest

import stltool as stl
from stltool.reporting.data import floors_data
from tests.conftest import ROOT
from tests.reporting.svg import Picture, same_picture
from tests.reporting.test_floor import Picture as Floor
from tests.reporting.test_floor import require_run
from tests.test_claims import DEMO

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def pictures():
    spec = importlib.util.spec_from_file_location("pictures", DOCS / "pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def committed(name):
    return (DOCS / f"{name}.svg").read_text(encoding="utf-8")


def test_the_demo_of_the_readme_is_that_of_the_makefile():
    assert f"$(BIN)/{DEMO}\n" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_every_picture_of_the_docs_has_its_command(pictures):
    shown = {path.stem for path in DOCS.glob("*.svg")}
    assert shown == set(pictures.PICTURES)
    pages = "".join(path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *DOCS.glob("*.md")])
    assert shown == set(re.findall(r"!\[[^]]*\]\((?:docs/)?([\w-]+)\.svg\)", pages))


CHARTS = [
    "margins",
    "parameter",
    "frontier",
    "front",
    "monitor",
    "battery",
    "lift",
    "frozenlake",
    "zeroconf",
    "drone",
    "insulin",
]


@pytest.mark.parametrize("name", CHARTS)
def test_a_committed_picture_is_what_is_drawn_today(pictures, name):
    same_picture(Picture(committed(name)), Picture(pictures.PICTURES[name]()))


@pytest.mark.parametrize("name", ["learning-curve", "floor"])
def test_the_committed_pictures_of_the_demo(pictures, demo, monkeypatch, name):
    monkeypatch.setattr(pictures, "OUT", demo / "out")
    same_picture(Picture(committed(name)), Picture(pictures.PICTURES[name]()))


def test_the_committed_ward_has_the_most_probable_delivery():
    task = stl.load_task(ROOT / "examples" / "ward" / "delivery.stl")
    product = stl.build_product(stl.load_model(task.model), task)
    (run,) = stl.likely_runs(product, satisfied=True, count=1).runs
    require_run(Floor(committed("ward")), next(floors_data(product.model)), run.states)


def test_the_committed_robot_drives_as_it_does_today(pictures):
    """Its floor has no axes: the corners of every patch and line are compared, and the numbers of the moves."""

    def drawn(text):
        paths = re.findall(r'<path[^>]* d="([^"]*)"', text)
        return re.findall(r">([^<>\s]+)</text>", text), [
            float(n) for path in paths for n in re.findall(r"-?[\d.]+", path)
        ]

    (names, numbers), (names_today, numbers_today) = drawn(committed("robot")), drawn(pictures.PICTURES["robot"]())
    assert names == names_today
    assert {"A", "B", "C", "0", "13"} <= set(names)
    assert numbers == pytest.approx(numbers_today, abs=0.05)


def test_the_committed_floor_has_the_demos_run(pictures, demo):
    data = pictures.report(demo / "out" / "patrolling" / "report.json")
    require_run(Floor(committed("floor")), data["floors"][0], data["run"]["states"])


def test_the_committed_sweep_has_the_papers_scenarios_and_their_optima():
    """Its curves take minutes; which panels it has and where their optima are takes none."""
    sweep = stl.load_sweep(ROOT / "examples" / "paper" / "table.toml")
    picture = Picture(committed("sweep"))
    titles = [text.text.partition(":")[0] for text in picture.texts() if ", T = " in text.text]
    assert titles == [scenario.id for scenario in sweep.scenarios]
    assert {text.text for text in picture.texts("legend")} == {*(method.id for method in sweep.methods), "optimum"}
    for panel, scenario in zip(picture.panels, sweep.scenarios, strict=True):
        best = stl.check(scenario.product, keep_policy=False).probability
        assert panel.levels("optimum") == pytest.approx([best], abs=2e-3)
        episodes = {**sweep.settings, **scenario.settings}["episodes"]
        steps = episodes * (scenario.product.horizon + 2)  # published episodes go on to the end
        for i in range(len(sweep.methods)):
            [median] = panel.shapes(f"median-{i}")
            assert len(median) > 10
            assert median[-1, 0] == pytest.approx(steps, rel=0.02)
