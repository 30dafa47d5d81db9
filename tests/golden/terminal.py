"""What commands print on small examples, where all is well and where a bound does not hold."""

import shutil
from pathlib import Path
from unittest import mock

import numpy as np

from tests.cli.every import CASES, SMALL, make_inputs
from tests.conftest import ROOT
from tests.golden.capture import command, said, shown

EXAMPLES = (
    "monitor/duty.stl", "monitor/shift.csv", "frozenlake/crossing-blackbox.stl", "frozenlake/lake-blackbox.toml",
)  # fmt: skip
MORE = [
    *(["check", "patrolling.stl", *SMALL, *options] for options in (
        [], ["--minimize"], ["--exact"], ["--at-least", "0.1", "--at-most", "0.2"], ["--at-least", "1e-9"],
        ["--encoding", "paper"], ["--save-policy", "best.npz"], ["--certificate", "proof.jsonl.gz"],
        ["--exact", "--at-most", "0.5"],
    )),
    ["check", "charging.stl", "-p", "T=5", "-p", "tau=3", "--encoding", "paper"],
    ["check", "docks.stl"], ["check", "uncertain.stl"], ["check", "uncertain.stl", "--nature", "with"],
    ["check", "uncertain.stl", "--nature", "nominal"],
    ["check", "uncertain.stl", "--at-least", "0.5"],
    ["why", "patrolling.stl", *SMALL, "--satisfying", "--count", "2"],
    ["why", "patrolling.stl", *SMALL, "--mass", "0.001", "--states", "2", "--minimize"],
    ["why", "decided.stl"],
    ["estimate", "patrolling.stl", *SMALL, "--at-least", "0.1", "--seed", "1"],
    ["estimate", "patrolling.stl", *SMALL, "--at-least", "0.9", "--most-runs", "10"],
    ["estimate", "patrolling.stl", *SMALL, "--epsilon", "0.1"],
    ["learn", "patrolling.stl", *SMALL, "--method", "naive", "--faithful", "-e", "20", "--out", "naive.npz"],
    ["learn", "decided.stl", "--out", "any.npz"],
    ["learn", "patrolling.stl", *SMALL, "-e", "200", "--stop-gap", "0.9", "--out", "naive.npz"],
    ["run", "decided.stl", "--out", "decided"],
    ["run", "uncertain.stl", "-e", "20", "--rollouts", "100", "--nominal", "--out", "uncertain"],
    ["run", "crossing-blackbox.stl", "-p", "T=10", "-e", "20", "--rollouts", "100", "--out", "lake"],
    ["surrogate", "charging.stl", "-p", "T=4", "-p", "tau=3"],
    ["sweep", "sweep.toml", "--workers", "1", "--out", "swept"],
    ["sweep", "sweep.toml", "--dry-run", "--workers", "1", "--out", "swept"],
    ["monitor", "duty.stl", "shift.csv"], ["monitor", "duty.stl", "shift.csv", "--at", "140"],
    ["monitor", "x > 0", "log.csv", "--steps"], ["monitor", "G[0,2] x > 0", "log.csv", "--end", "cut"],
    ["monitor", "G[0,2] x > 0", "log.csv", "--end", "hold", "--plot", "log.png"],
    ["monitor", "x > 0", "batch.npz"], ["monitor", "x > 0", "batch.npz", "--at", "1"],
    ["explain", "F[0,3] A and G[0,2] B or C"], ["explain", "G[0,5] F[0,3] G[0,2] a"], ["explain", "always a"],
    ["explain", "timed.stl"], ["explain", "charging.stl"], ["explain", "F[0,5] (A & !A) | G[0,2] B"],
    ["explain", "docks.stl"], ["explain", "uncertain.stl"],
    ["fmt", "untidy.stl", "--check"], ["fmt", "untidy.stl"], ["fmt", "untidy.stl", "--check"],
    ["export", "decided.stl", "--to", "dot", "--out", "a.dot"],
    ["certify", "certificate.jsonl"], ["certify", "proof.jsonl.gz", "patrolling.stl", *SMALL],
    ["certify", "refused.jsonl"],
    ["verify", "mixed.stl", "expected.stl", "--junit", "v.xml", "--markdown", "v.md", "--report", "v",
     "--certificates", "proofs", "--exact-seconds", "0"],
    ["lint", "mixed.stl", "untidy.stl"],
    ["run", "decided.stl", "--out", "decided", "--at-least", "1"],
]  # fmt: skip


MIXED = """
model "floor-5x5.toml"
r := F[0,2] A
all := r & F[0,5] B or C
expect Pmax(r) >= 0.99
expect Pmax(r) >= 0.999
expect P(r, policy "policy.npz") > 0
expect Pmin(F[0,2] B) >= 0
expect Pmax(F[0,5] B) <= 0.99986
expect holds(F[0,9] x > 0.5, trace "trace.csv")
"""


def entries():
    make_inputs(Path())
    for name in EXAMPLES:
        shutil.copy(ROOT / "examples" / name, ".")
    Path("decided.stl").write_text('model "floor-5x5.toml"\ndecided := F[0,3] !A\n')
    Path("timed.stl").write_text("step = 0.5s\nr := G[0,2s] a & b or always c\n")
    Path("untidy.stl").write_text("# a task\nr:=F[0,3]A&  B\n")
    Path("log.csv").write_text("when,x,door\nMon,1,true\nTue,-1,true\nWed,-2,false\nThu,-3,false\nFri,4,true\n")
    np.savez("batch.npz", x=np.array([[1.0, 2, 3], [1, -1, -2], [-1, 1, 1]]))
    Path("mixed.stl").write_text(MIXED)
    lie = Path("certificate.jsonl").read_text().replace('"upper":', '"uper":')
    Path("refused.jsonl").write_text(lie)
    with mock.patch("stltool.reporting.page.render", return_value=""):  # pictures take long
        cases = ([name, *given] for name, given in CASES.items() if name != "doctor")  # which is of this machine
        for arguments in (*cases, *MORE):
            yield shown(*arguments), said(*command(*arguments))
