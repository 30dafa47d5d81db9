"""One working invocation of every command, on files that `folder_of_inputs` makes: for tests over all commands."""

import json
import shutil
import subprocess
import sys

import typer.main

import stltool as stl
from stltool.cli import app
from tests.conftest import FACTORY, MORE, WHOLE

COMMANDS = typer.main.get_command(app).commands
SMALL = ("-p", "T=3", "-p", "tau=8")
SWEEP = """
[sweep]
seeds = 1
settings = { episodes = 20 }
[[method]]
name = "cfer"
[[scenario]]
id = "P"
task = "patrolling.stl"
params = { T = 3, tau = 8 }
"""
EXPECTED = """
model "floor-5x5.toml"
patrolling := G[0,2] ((F[0,7] A) & (F[0,7] (x < 0.4 & y > 0.6)))
expect Pmax(patrolling) >= 0.5
expect holds(F[0,2] x > 0.5, trace "trace.csv")
"""
CASES = {
    "run": ["patrolling.stl", *SMALL, "--episodes", "20", "--rollouts", "100", "--out", "out"],
    "check": ["patrolling.stl", *SMALL, "--policy", "policy.npz"],
    "verify": ["expected.stl", "patrolling.stl"],
    "why": ["patrolling.stl", *SMALL],
    "counterfactual": ["patrolling.stl", *SMALL, "--policy", "policy.npz"],
    "play": ["patrolling.stl", *SMALL, "--policy", "policy.npz", "--moves", ". 2 < *"],
    "surrogate": ["patrolling.stl", *SMALL],
    "tradeoff": ["tradeoff.stl", *SMALL, "--objective", "charging", "--budget", "C<=2"],
    "pareto": ["tradeoff.stl", *SMALL, "--tasks", "charging,patrolling"],
    "frontier": ["patrolling.stl", "-p", "T=3", "--at-least", "0.9", "--vary", "tau=5:8"],
    "shield": ["patrolling.stl", *SMALL, "--at-least", "0.5", "--out", "mask.npz"],
    "certify": ["certificate.jsonl", "patrolling.stl", *SMALL],
    "estimate": ["patrolling.stl", *SMALL, "--policy", "policy.npz", "--runs", "100"],
    "learn": ["patrolling.stl", *SMALL, "--episodes", "20", "--out", "learned.npz"],
    "sweep": ["sweep.toml", "--workers", "1", "--out", "swept"],
    "monitor": ["F[0,2] x > 0.5", "trace.csv"],
    "explain": ["patrolling.stl", *SMALL],
    "fmt": ["patrolling.stl"],
    "lint": ["patrolling.stl"],
    "convert": ["floor-5x5.toml", "floor.umb"],
    "export": ["patrolling.stl", *SMALL, "--to", "dot"],
    "report": ["report.json"],
    "diff": ["report.json", "report.json"],
    "new": [],
    "doctor": [],
}


def make_inputs(folder):
    """The files that CASES name."""
    for path in FACTORY.iterdir():
        shutil.copy(path, folder)
    task = stl.load_task(folder / "patrolling.stl", {"T": 3, "tau": 8})
    best = stl.check(stl.build_product(stl.load_model(task.model), task))
    best.policy.save(folder / "policy.npz")
    stl.write_certificate(best, folder / "certificate.jsonl")
    stl.report([best], None, folder / "report.html")
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "expected.stl").write_text(EXPECTED)
    (folder / "trace.csv").write_text("x\n0\n1\n1\n1\n")


# one process for all, which takes an eighth of the time; where its output goes is changed below Python, so that what C
# code writes is seen as well, and what each command leaves for the end of the process comes in the last file
ONE_BY_ONE = """
import json, os, sys
from stltool.cli import main
for name, arguments in json.load(sys.stdin).items():
    for number, kind in ((1, "out"), (2, "err")):
        file = os.open(f"{sys.argv[1]}/{name}.{kind}", os.O_WRONLY | os.O_CREAT)
        os.dup2(file, number)
        os.close(file)
    code, sys.argv[1:], here = 0, [name, *arguments, "--json"], sys.argv[1]
    try:
        main()
    except SystemExit as ended:
        code = ended.code or 0
    sys.argv[1:] = [here]
    assert code == 0, name
    sys.stdout.flush()
os.dup2(os.open(f"{sys.argv[1]}/end.out", os.O_WRONLY | os.O_CREAT), 1)
"""


PRINTED = list(CASES) if MORE >= WHOLE else ["explain"]
"""The commands that print_json runs: all of them take some seconds."""


def print_json(folder):
    """What commands print with --json, into the folder: NAME.out and NAME.err; `end.out` should be empty."""
    (folder / "inputs").mkdir()
    make_inputs(folder / "inputs")
    command = [sys.executable, "-c", ONE_BY_ONE, folder.resolve()]
    subprocess.run(
        command, cwd=folder / "inputs", input=json.dumps({name: CASES[name] for name in PRINTED}), text=True, check=True
    )
