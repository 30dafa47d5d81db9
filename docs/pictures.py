"""The pictures of README and docs: `python docs/pictures.py`, or with names, `python docs/pictures.py floor front`.

learning-curve, floor  from out/patrolling, which `make demo` writes
sweep                  from out/table, which `.venv/bin/stltool sweep examples/paper/table.toml --out out/table` writes
front, monitor         by themselves

tests/reporting/test_pictures.py and `make claims` draw them again and compare.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import stltool as stl
from stltool.files import write_atomically
from stltool.reporting import front_data, load_report
from stltool.reporting.figures import learning_curves, pareto_front
from stltool.reporting.monitor_figure import monitored
from stltool.reporting.page import curve_picture, run_picture

HERE = Path(__file__).parent
EXAMPLES, OUT = HERE.parent / "examples", HERE.parent / "out"


def curve() -> str:
    return str(curve_picture(load_report(OUT / "patrolling" / "report.json")))


def floor() -> str:
    return str(run_picture(load_report(OUT / "patrolling" / "report.json")))


def front() -> str | bytes:
    tasks = [stl.load_task(EXAMPLES / "factory" / "tradeoff.stl", task=name) for name in ("charging", "patrolling")]
    joint = stl.build_joint_product(stl.load_model(tasks[0].model), tasks)
    return pareto_front(front_data(stl.pareto(joint)), "svg")


def monitor() -> str | bytes:
    task = stl.load_task(EXAMPLES / "monitor" / "duty.stl")
    trace = stl.load_trace(EXAMPLES / "monitor" / "shift.csv", ["battery", "x", "y", "docked"])
    return monitored(stl.monitor(task, trace), trace, task, "svg")


def sweep() -> str | bytes:
    return learning_curves(load_report(OUT / "table" / "report.json"), "svg")


PICTURES: dict[str, Callable[[], str | bytes]] = {
    "learning-curve": curve, "floor": floor, "front": front, "monitor": monitor, "sweep": sweep,
}  # fmt: skip

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"default: {', '.join(PICTURES)}")
    parser.add_argument("--reports", type=Path, default=OUT, help="where the reports are, default: out")
    parser.add_argument("--out", type=Path, default=HERE, help="where the pictures go, default: docs")
    asked = parser.parse_args()
    OUT = asked.reports
    for name in asked.names or PICTURES:
        write_atomically(asked.out / f"{name}.svg", PICTURES[name]())
