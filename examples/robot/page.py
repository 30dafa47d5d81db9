"""The story as a page: one HTML file with its pictures, and the report that `stltool run` would write."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

import stltool as stl
from examples.robot.floor import HALF, Floor
from examples.robot.story import Story
from stltool.files import write_atomically

TEMPLATE = Path(__file__).with_name("page.html")
_TICKS = 60  # poses of a move


def rows(story: Story) -> list[dict[str, str]]:
    """What is said of each policy, as text."""
    return [
        {
            "policy": one.name,
            "nominal": f"{one.nominal:.4f}",
            "cells": f"{one.cells:.4f}",
            "headings": f"{one.headings:.4f}",
            "runs": f"{one.runs.probability:.4f} [{one.runs.lower:.4f}, {one.runs.upper:.4f}]",
        }
        for one in story.judged
    ]


def tests(story: Story) -> dict[str, str]:
    """The Markov tests, as sentences."""
    return {
        f"is a state: {question}": f"{'no' if found.rejected else 'not refuted'}, {found.p_text}, "
        f"moves {100 * found.dependence:.1f} % of the probability"
        for question, found in story.tests.items()
    }


def write(story: Story, plant: str, folder: Path) -> Path:
    """Write robot.html and report.html into a folder that can be written (`stltool.files.require_folder`)."""
    folder.mkdir(parents=True, exist_ok=True)
    stl.report([], story.training, folder / "report.html", guarantees=[story.promise], product=story.product)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    page = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        story=story, plant=plant, rows=rows(story), tests=tests(story), floor=_floor_picture(story, plant),
        comparison=_comparison(story),
    )  # fmt: skip
    write_atomically(folder / "robot.html", page)
    return folder / "robot.html"


def _floor_picture(story: Story, plant: str) -> str:
    """The run's track over the floor: rendered by MuJoCo where that and OpenGL are present, drawn otherwise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    draw_track(figure.add_subplot(), story.walk.floor, story.track, rendered=plant == "mujoco")
    return _png(figure)


def draw_track(axes: Any, floor: Floor, track: np.ndarray, rendered: bool = False) -> None:
    """The floor and a robot's way over it, with the number of each move."""
    if not rendered or not _render(axes, floor, track):
        _draw(axes, floor)
    axes.plot(track[:, 0], track[:, 1], color="black", lw=1.6)
    stops = track[::_TICKS]
    axes.plot(stops[:, 0], stops[:, 1], "o", color="black", ms=5)
    for k, (x, y, _) in enumerate(stops):
        axes.annotate(str(k), (x, y), xytext=(4, 4), textcoords="offset points", fontsize=10)
    axes.set_xlim(-0.15, floor.width + 0.15)
    axes.set_ylim(-0.15, floor.height + 0.15)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _render(axes: Any, floor: Floor, track: np.ndarray) -> bool:
    """Show the floor as MuJoCo renders it; False if there is no OpenGL."""
    from examples.robot.physics import Physics, picture

    plant = Physics(floor, 1)
    plant.place(np.array([0]), track[-1:])
    try:
        pixels, extent = picture(plant, 0)
    except Exception as error:  # MuJoCo raises whatever the graphics driver does
        axes.set_title(f"not rendered: {error}", fontsize=7)
        return False
    axes.imshow(pixels, extent=extent)
    return True


def _draw(axes: Any, floor: Floor) -> None:
    from matplotlib.patches import Circle, Rectangle

    colours = {"A": "#9ab8e8", "B": "#e8a49a", "C": "#a5d8a8"}
    for name, cells in floor.nominal.labels.items():
        for x, y in floor.centres[cells]:
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, color=colours.get(name, "#eeeeee"), lw=0))
            axes.text(x - 0.42, y + 0.3, name, color="#555555")
    for x, y in floor.blocks:
        axes.add_patch(Rectangle((x - HALF, y - HALF), 2 * HALF, 2 * HALF, color="#777777"))
    for patch in floor.oil:
        axes.add_patch(Circle((patch.x, patch.y), patch.radius, color="#40382a", alpha=0.8))
    axes.add_patch(Rectangle((0, 0), floor.width, floor.height, fill=False, color="#777777", lw=3))


def _comparison(story: Story) -> str:
    """For every policy, what the models predict next to the interval of the fresh runs."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 1 + 0.7 * len(story.judged)), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(story.judged))[::-1]
    for name, marker, values in (
        ("nominal model", "s", [one.nominal for one in story.judged]),
        ("cell table", "v", [one.cells for one in story.judged]),
        ("cell × heading table", "^", [one.headings for one in story.judged]),
    ):
        axes.plot(values, place, marker, label=name, ms=7)
    estimates = [one.runs for one in story.judged]
    middle = np.array([found.probability for found in estimates])
    ends = [middle - [found.lower for found in estimates], [found.upper for found in estimates] - middle]
    axes.errorbar(middle, place, xerr=ends, fmt="ko", capsize=4, label="fresh runs, 99 %")
    axes.set_yticks(place, [one.name for one in story.judged])
    axes.set_ylim(-0.5, len(place) - 0.5)
    axes.set_xlabel("probability that the task is satisfied")
    axes.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=4, frameon=False, fontsize=8)
    axes.grid(axis="x", color="#dddddd")
    return _png(figure)


def _png(figure: Any) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    return base64.b64encode(content.getvalue()).decode()
