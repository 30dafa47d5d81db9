"""Small questions are answered in numpy: numba is not even imported, and the bits are those of the kernels."""

import json
import subprocess
import sys

import numpy as np
import pytest

from stltool.arrays import read_only
from stltool.checking.induction.arithmetic import natures_choice
from stltool.kernels import edges as kernels
from tests.conftest import FACTORY, many

QUESTIONS = {
    "check": "stl.check(product)",
    "minimum": "stl.check(product, maximize=False)",
    "fixed": "stl.check(product, arithmetic='fixed')",
    "doubles": "stl.check(product, arithmetic='double')",
    "exact": "stl.check(product, exact=True)",
    "policy": "stl.check(product, stl.check(product).policy)",
    "exact policy": "stl.check(product, stl.check(product).policy, exact=True)",
    "robust": "stl.robust_check(blurred)",
    "optimistic": "stl.robust_check(blurred, nature='with')",
}
PROGRAM = """
import dataclasses, json, sys
import numpy as np
import stltool as stl

task = stl.load_task({task!r})
model = stl.load_model(task.model)
product = stl.build_product(model, task)
wide = stl.load_model({folder!r} + "/blurred.toml")
blurred = stl.build_product(wide, task)
for name, question in json.load(sys.stdin).items():
    eval(question)
    print(name, sorted({{"numba", "scipy", "matplotlib", "jinja2", "stltool.learning"}} & set(sys.modules)))
"""


def test_small_questions_load_no_compiler(tmp_path):
    """One after another in one process, which loads nothing on the way either."""
    floor = (FACTORY / "floor-5x5.toml").read_text()
    lines = [line for line in floor.splitlines() if not line.startswith(("success", "slip"))]
    (tmp_path / "blurred.toml").write_text("\n".join([*lines, "success = [0.9, 0.95]", "slip = [0.01, 0.04]"]))
    code = PROGRAM.format(task=str(FACTORY / "patrolling.stl"), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, input=json.dumps(QUESTIONS))
    assert (done.stdout.splitlines(), done.stderr) == ([f"{name} []" for name in QUESTIONS], "")


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(40)))
@pytest.mark.parametrize("ascending", [True, False])
def test_natures_choice_is_the_kernels_to_the_bit(seed, ascending):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 12, rng.integers(1, 60))
    start = np.concatenate([[0], np.cumsum(lengths)])
    e = int(start[-1])
    lower, width = read_only(rng.random(e) / 12), rng.random(e) * (rng.random(e) < 0.7)
    ahead = np.round(rng.random(20), rng.integers(1, 4))  # with equal ones
    entry, child = rng.permutation(e), rng.integers(0, 20, e)
    budget = np.maximum(1 - np.add.reduceat(lower[entry], start[:-1]), 0)
    choice, wanted = np.arange(len(lengths)), np.empty(len(lengths))
    kernels.nature(start, entry, child, lower, width, budget, choice, ascending, ahead, 0, len(lengths), wanted)
    found = natures_choice(start, lower[entry], width[entry], budget, ahead[child], ascending)
    assert np.array_equal(found, wanted)
