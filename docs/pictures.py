"""The pictures of README and docs, after `make demo` and `.venv/bin/stltool sweep examples/paper/table.toml`."""

from pathlib import Path

import stltool as stl
from stltool.files import write_atomically
from stltool.reporting import load_report, write_front_picture
from stltool.reporting.figures import floor_map, learning_curve, learning_curves

HERE = Path(__file__).parent
data = load_report(HERE.parent / "out" / "patrolling" / "report.json")
write_atomically(HERE / "learning-curve.svg", learning_curve(data))
write_atomically(HERE / "floor.svg", floor_map(data))
shift = HERE.parent / "examples" / "factory" / "tradeoff.stl"
tasks = [stl.load_task(shift, task=name) for name in ("charging", "patrolling")]
joint = stl.build_joint_product(stl.load_model(tasks[0].model), tasks)
write_front_picture(stl.pareto(joint), HERE / "front.svg")
paper = load_report(HERE.parent / "out" / "table" / "report.json")
write_atomically(HERE / "sweep.svg", learning_curves(paper, "svg"))
