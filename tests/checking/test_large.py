"""A product of millions of pairs, solved from every state within a small address space, its policy on disk."""

import subprocess
import sys

import pytest

PROGRAM = r"""
import resource, sys
import psutil
import stltool as stl

n, tau, room = map(int, sys.argv[1:])
cell = lambda x, y: "A" if x % 15 < 2 and y % 15 < 2 else "B" if x % 15 in (8, 9) and y % 15 in (8, 9) else "."
rows = ["".join(cell(x, y) for x in range(n)) for y in range(n)]
with open("floor.toml", "w") as file:
    text = "\n".join(rows)
    file.write(f'kind = "grid"\nsuccess = "93/100"\nslip = "7/300"\nstart = [0, 0]\nmap = \'\'\'{text}\'\'\'')
phi = stl.parse(f"G[0,{tau}) (F[0,{tau}) A & F[0,{tau}) B)")
small = stl.build_product(stl.load_model("floor.toml"), stl.parse("G[0,3) (F[0,3) A & F[0,3) B)"))
stl.check(small, engine="words", values="all", policy_file="small.policy")  # loads the machine code
product = stl.build_product(stl.load_model("floor.toml"), phi)
process = psutil.Process()
before = process.memory_info().vms
resource.setrlimit(resource.RLIMIT_AS, (before + room, resource.RLIM_INFINITY))
found = stl.check(product, engine="words", values="all", policy_file="best.policy")
print(product.n_states, found.lower, found.probability, found.upper, found.values.least.value)
again = stl.check(product, stl.load_policy("best.policy", product), engine="words")
print(again.probability)
"""


@pytest.mark.soak(only=True)
def test_millions_of_pairs_from_every_state_in_a_small_address_space(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "60", "20", "300000000"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    n, lower, value, upper, least = map(float, first.split())
    assert n > 1_000_000
    assert 0 < least <= value + 1e-12
    assert lower <= value <= upper <= 1
    assert lower <= float(second) <= upper
    dense = 2 * 38 * n  # a table of choices, two bytes for each step and pair, without the values
    assert (tmp_path / "best.policy").stat().st_size < dense / 2
