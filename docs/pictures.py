"""The pictures of README and docs: `python docs/pictures.py`, or with names, `python docs/pictures.py floor front`.

learning-curve, floor  from out/patrolling, which `make demo` writes
sweep                  from out/table, which `.venv/bin/stltool sweep examples/paper/table.toml --out out/table` writes
the others             by themselves

tests/reporting/test_pictures.py and `make claims` draw them again and compare.
"""

import argparse
import functools
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import stltool as stl
from stltool.files import write_atomically
from stltool.reporting import front_data, frontier_data, load_report, parametric_data, robustness_data
from stltool.reporting.answers import survival_picture
from stltool.reporting.data import floors_data
from stltool.reporting.drawing import drawing, svg
from stltool.reporting.figures import (
    frontier_picture,
    learning_curves,
    leaves_curve,
    line_chart,
    parameter_curve,
    pareto_front,
)
from stltool.reporting.floor import floor_map
from stltool.reporting.monitor_figure import monitored
from stltool.reporting.page import curve_picture, run_pictures
from stltool.reporting.trees import tree_data

HERE = Path(__file__).parent
EXAMPLES, OUT = HERE.parent / "examples", HERE.parent / "out"
sys.path.insert(0, str(HERE.parent))  # the robot's example draws its own floor


report = functools.cache(load_report)  # which makes its page, to see whether the data are whole


def curve() -> str:
    return str(curve_picture(report(OUT / "patrolling" / "report.json")))


def floor() -> str:
    [(_, picture)] = run_pictures(report(OUT / "patrolling" / "report.json"))
    return picture


def front() -> str | bytes:
    tasks = [stl.load_task(EXAMPLES / "factory" / "tradeoff.stl", task=name) for name in ("charging", "patrolling")]
    joint = stl.build_joint_product(stl.load_model(tasks[0].model), tasks)
    return pareto_front(front_data(stl.pareto(joint)), "svg")


def margins() -> str | bytes:
    """By how much the best policies patrol the larger floor, and the one that is best for P."""
    task = stl.load_task(EXAMPLES / "factory" / "margins.stl")
    model = stl.load_model(task.model)
    best = stl.check(stl.build_product(model, task)).policy
    found = [
        robustness_data(task, model, stl.robustness_distribution(model, task, policy), judged)
        for policy, judged in ((None, None), (best, "policy"))
    ]
    return survival_picture({**found[0], "beside": found[1]}, "svg")


def parameter() -> str | bytes:
    """P of patrolling over the probability that a move succeeds."""
    task = stl.load_task(EXAMPLES / "factory" / "patrolling.stl", params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(EXAMPLES / "factory" / "floor-5x5-p.toml"), task)
    found = stl.parametric(product, over={"p": ("0.5", "1")})
    first = found.smallest(Fraction(7, 10))
    assert first is not None
    assert first.enough is not None
    data = parametric_data(found) | {"at_least": 0.7}
    data["smallest"] = {"below": float(first.below), "enough": float(first.enough)}
    return parameter_curve(data, "svg")


def frontier() -> str | bytes:
    """Which windows the best policy can keep with a probability of at least 0.95."""
    task = stl.load_task(EXAMPLES / "factory" / "patrolling.stl")
    found = stl.frontier(stl.load_model(task.model), task, "0.95", {"T": range(1, 16), "tau": range(1, 13)})
    return frontier_picture(frontier_data(found), "svg")


def log(task_file: str, log_file: str) -> str | bytes:
    task = stl.load_task(EXAMPLES / task_file)
    names = (EXAMPLES / log_file).read_text(encoding="utf-8").partition("\n")[0].split(",")
    trace = stl.load_trace(EXAMPLES / log_file, [name for name in names if name not in ("step", "note")])
    return monitored(stl.monitor(task, trace), trace, task, "svg")


def monitor() -> str | bytes:
    return log("monitor/duty.stl", "monitor/shift.csv")


def drone() -> str | bytes:
    return log("drone/rules.stl", "drone/flight.csv")


def insulin() -> str | bytes:
    return log("insulin/therapy.stl", "insulin/day.csv")


def product_of(file: str, **params: int) -> stl.Product:
    task = stl.load_task(EXAMPLES / file, params={name: str(value) for name, value in params.items()})
    return stl.build_product(stl.load_model(task.model), task)


def line(name: str, xs: Any, ys: Any) -> dict[str, Any]:
    return {"name": name, "x": list(xs), "y": list(ys)}


def chart(x: str, y: str, *lines: dict[str, Any]) -> str:
    return line_chart({"lines": lines, "x": x, "y": y}, "chart")


def ward() -> str:
    """The most probable run of the best policy."""
    product = product_of("ward/delivery.stl")
    run = stl.likely_runs(product, satisfied=True, count=1).runs[0]
    (floor,) = floors_data(product.model)
    return str(floor_map(floor, run.states))


def team(member: int) -> str:
    """What one of two robots does in the most probable run of the best policy."""
    product = product_of("team/handover.stl")
    run = stl.likely_runs(product, satisfied=True, count=1).runs[0]
    floor = list(floors_data(product.model))[member]
    return str(floor_map(floor, run.states, f"team{member}"))


def lift() -> str:
    """The best policy, and one that goes to the nearest call."""
    patience = range(2, 6)
    products = [product_of("lift/service.stl", patience=k) for k in patience]

    def nearest(here: Any) -> str:
        called = [floor for floor in range(3) if f"call{floor}" in here.labels]
        aim = min(called, key=lambda floor: abs(floor - here.signals["floor"]), default=here.signals["floor"])
        return "open" if aim == here.signals["floor"] else "up" if aim > here.signals["floor"] else "down"

    best = [stl.check(product).probability for product in products]
    simple = [stl.check(product, stl.Policy.from_function(product, nearest)).probability for product in products]
    return chart("patience, steps", "P", line("best", patience, best), line("nearest call first", patience, simple))


def zeroconf() -> str:
    """The best policy for the time there is, and those that ask a fixed number of times before they take an address."""
    soon = range(3, 15)
    products = [product_of("zeroconf/address.stl", soon=k) for k in soon]
    lines = [line("best", soon, [nines(stl.check(product)) for product in products])]
    for times in (1, 2, 4):

        def policy(here: Any, times: int = times) -> str:
            return "take" if here.signals["asked"] == times else here.actions[-1]

        found = [nines(stl.check(product, stl.Policy.from_function(product, policy))) for product in products]
        lines.append(line(f"asks {times} times" if times > 1 else "asks once", soon, found))
    return chart("steps", "−log₁₀(1 − P)", *lines)


def nines(found: stl.CheckResult) -> float:
    return -float(np.log10(1 - found.probability))


def battery() -> str:
    """What the charge demanded at the end costs."""
    text = (EXAMPLES / "battery" / "inspection.stl").read_text(encoding="utf-8")
    model = stl.load_model(EXAMPLES / "battery" / "robot.tra")
    charges = range(1, 15)
    values = []
    for charge in charges:
        task = stl.parse_task(text.replace("charge >= 7", f"charge >= {charge}"))
        values.append(stl.check(stl.build_product(model, task), keep_policy=False).probability)
    return chart("charge demanded at the end", "P", line("best", charges, values))


def frozenlake() -> str:
    """The best P within a number of steps, and of never falling in."""
    steps = range(10, 81, 10)
    values = [stl.check(product_of("frozenlake/crossing.stl", T=T), keep_policy=False).probability for T in steps]
    return chart("T, steps", "P(!hole U[0,T] goal)", line("best", steps, values))


def robot() -> str:
    """A shift of the kinematic robot under the nominal model's best policy."""
    from matplotlib.figure import Figure

    from examples.robot.floor import factory
    from examples.robot.kinematic import Kinematic
    from examples.robot.page import draw_track
    from examples.robot.story import patrolling, run_of

    place = factory()
    product = stl.build_product(place.nominal, patrolling(10))
    best = stl.check(product).policy
    assert best is not None
    complete = stl.Policy(product, np.maximum(best.table, 0))  # where no run of the model leads: stay
    track, _ = run_of(product, complete, Kinematic(place, 1), seed=0)
    figure = Figure(figsize=(4.2, 4.2), layout="constrained")
    with drawing():
        draw_track(figure.add_subplot(), place, track)
    return svg(figure, "robot", "the way of a robot over the factory floor")


def sweep() -> str | bytes:
    return learning_curves(load_report(OUT / "table" / "report.json"), "svg")


def leaves() -> str | bytes:
    """What trees lose to the optimal policy of the paper's patrolling task; half a minute."""
    return leaves_curve(tree_data(stl.policy_tree(product_of("factory/patrolling.stl"))), "svg")


PICTURES: dict[str, Callable[[], str | bytes]] = {
    "learning-curve": curve, "floor": floor, "front": front, "monitor": monitor, "sweep": sweep,
    "ward": ward, "battery": battery, "lift": lift, "frozenlake": frozenlake, "zeroconf": zeroconf, "drone": drone,
    "team-r1": functools.partial(team, 0), "team-r2": functools.partial(team, 1),
    "insulin": insulin, "robot": robot, "leaves": leaves,
    "margins": margins, "parameter": parameter, "frontier": frontier,
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
