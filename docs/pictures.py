"""The README's pictures, from the demo's report: `make demo && .venv/bin/python docs/pictures.py`."""

from pathlib import Path

from stltool.files import write_atomically
from stltool.reporting import load_report
from stltool.reporting.figures import floor_map, learning_curve

HERE = Path(__file__).parent
data = load_report(HERE.parent / "out" / "patrolling" / "report.json")
write_atomically(HERE / "learning-curve.svg", learning_curve(data))
write_atomically(HERE / "floor.svg", floor_map(data))
