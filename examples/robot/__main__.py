"""`make robot`: the story of the robots on the terminal and as a page."""

from __future__ import annotations

import argparse
import os
import sys
from importlib.util import find_spec
from pathlib import Path

import stltool as stl
from examples.robot.controller import Plant
from examples.robot.floor import OIL, Floor, factory
from examples.robot.kinematic import Kinematic
from examples.robot.page import rows, tests, write
from examples.robot.story import story
from stltool.files import require_folder

DEFAULTS = {"kinematic": (1000, 200_000, 10_000), "mujoco": (64, 15_000, 400)}
"""Robots side by side, moves of the random walk, fresh runs for each policy: as many as a minute or two allow."""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m examples.robot", description=__doc__)
    parser.add_argument("--plant", choices=[*DEFAULTS, "auto"], default="auto", help="auto: mujoco if it is installed")
    parser.add_argument("--dry", action="store_true", help="without the oil")
    parser.add_argument("--window", type=_from_one, default=8, help="moves to visit A and B (T and tau of the task)")
    parser.add_argument("--episodes", type=_from_one, default=300, help="of learning")
    parser.add_argument("--robots", type=_from_one, help="side by side")
    parser.add_argument("--moves", type=_from_one, help="of the random walk that fills the tables")
    parser.add_argument("--runs", type=_from_one, help="fresh ones for each policy")
    parser.add_argument("--seed", type=_from_zero, default=0, help="the source of all random choices")
    parser.add_argument("--out", type=Path, default=Path("out/robot"), help="folder for the page")
    options = parser.parse_args(arguments)
    plant = options.plant if options.plant != "auto" else "mujoco" if find_spec("mujoco") else "kinematic"
    if plant == "mujoco" and not find_spec("mujoco"):
        parser.error("--plant mujoco: MuJoCo is not installed; pip install 'stltool[robot]', or use --plant kinematic")
    robots, moves, runs = (
        given or default
        for given, default in zip((options.robots, options.moves, options.runs), DEFAULTS[plant], strict=True)
    )
    floor = factory(() if options.dry else OIL)
    make_plant = physics if plant == "mujoco" else Kinematic
    try:
        require_folder(options.out)
        found = story(
            floor, lambda n: make_plant(floor, n), window=options.window, robots=robots, moves=moves,
            episodes=options.episodes, runs=runs, seed=options.seed, told=lambda text: print(text, file=sys.stderr),
        )  # fmt: skip
        page = write(found, plant, options.out)
    except stl.StlToolError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(
        f"{plant}, {'dry' if options.dry else 'with oil'}: a move to another cell succeeds {100 * found.success:.1f} %"
    )
    for question, answer in tests(found).items():
        print(f"{question}: {answer}")
    columns = ("policy", "nominal model", "cell table", "cell x heading table", "fresh runs, 99 %")
    table = [columns, *(tuple(row.values()) for row in rows(found))]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
    print(f"promise  P >= {found.promise.lower:.6f} with confidence 99 %, from {found.promise.runs} fresh runs")
    print(f"page     {page}")
    return 0


def physics(floor: Floor, n: int) -> Plant:
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")  # before mujoco is imported
    from examples.robot.physics import Physics

    return Physics(floor, n)


def _from_zero(text: str) -> int:
    if not text.isdecimal() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer from 0")
    return int(text)


def _from_one(text: str) -> int:
    if not _from_zero(text):
        raise argparse.ArgumentTypeError("0 is too few; give an integer from 1")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
