"""Refusals of the command line: options with values that they refuse, and other faulty command lines."""

import shutil
from pathlib import Path

from tests.cli import test_estimate, test_sweep, test_tradeoff, test_words
from tests.cli.every import CASES, SMALL, make_inputs
from tests.conftest import ROOT
from tests.golden.capture import command, memory, rows, shown

MONITOR = [
    ["tsak.stl", "log.csv"], ["folder", "log.csv"], ["task.txt", "log.csv"], ["G[0,1] x >", "log.csv"],
    ["two.stl", "log.csv", "--task", "bonded"], ["two.stl", "log.csv", "-p", "T=3"],
    ["two.stl", "log.csv", "--task", "bounded"], ["x > 0", "log.csv", "--task", "a"], ["x > 0", "log.csv", "-p", "T=3"],
    ["x > 0", "log.csv", "-p", "T"], ["true", "log.csv"], ["X > 0", "log.csv"], ["when > 0", "log.csv"],
    ["x & door", "log.csv"], ["x > 0", "none.csv"], ["x > 0", "two.stl"], ["x > 0", "log.csv", "--end", "wrap"],
    ["x > 0", "log.csv", "--at", 5], ["x > 0", "log.csv", "--trace", 0], ["x > 0", "log.csv", "--trace", 0, "--steps"],
    ["x > 0", "log.csv", "--steps", "--json"], ["x > 0", "none.csv", "--plot", "t.jpg"],
    ["x > 0", "none.csv", "--plot", "folder"], ["x > 0", "none.csv", "--plot", "two.stl/t.png"],
]  # fmt: skip


# expectations that cannot be judged
GATED = """
model "none.toml"
r := A
expect Pmax(r) > 2
expect P(r, policy "no.npz") > 0
expect holds(r, trace "no.csv")
"""
UNFIT = """
model "floor-5x5-uncertain.toml"
r := F[0,3] A
expect Pmax(r) > 0.5
expect P(r, policy "no.npz") > 0
expect robust P(r, policy "trace.csv") > 0
expect holds(r, trace "no.csv")
"""

# command lines, each on the files of `make_inputs` and those below
FAULTY = [
    *(["check", "patrolling.stl", *options] for options in (
        ["--policy", "policy.npz"], ["--policy", "patrolling.stl"], ["-p", "T"], ["-p", "TT=3"], ["-p", "T=many"],
        ["-p", "T=3", "-p", "T=4"], ["--task", "patrol"], ["--encoding", "fast"], ["--at-least", "1.2"],
        ["--at-least", "much"], ["--model", "row.toml"], ["--polcy", "p.npz"], ["--nature", "with"], ["--nominal"],
        ["--model", "floor-5x5-uncertain.toml", "--nature", "kind"],
        ["--model", "floor-5x5-uncertain.toml", "--memoryless"], ["--stationary", "--memoryless"],
        ["--stationary", "--save-policy", "p.policy"], ["--transfer"], ["--policy-model", "floor-5x5.toml"],
    )),
    ["check", "bare.stl"], ["check", "none.stl"], ["check"], ["chek", "patrolling.stl"],
    *(["run", "patrolling.stl", *options] for options in (
        ["--method", "cefr"], ["--episodes", "0"], ["-m", "cfer", "--set", "optimist=3"], ["--set", "optimism"],
        [*SMALL, "-e", "1", "--out", "bare.stl"], ["--set", "seed=3"], ["--set", "evaluate_every=3"],
        ["-m", "cfer", "--set", "caution=3", "--set", "caution=4"], ["--set", "optimism=abc"], ["--seed", "-1"],
        ["-m", "naive-er", "--set", "memory=99999999999999"], ["--confidence", "1"], ["--rollouts", "-3"],
    )),
    ["run", "crossing-blackbox.stl", "--rollouts", "0", "--out", "out"],
    *(["learn", "patrolling.stl", "-o", "p.npz", *options] for options in (
        ["-m", "cfer", "--set", "gamma=0.1"], ["-m", "naive-er", "--set", "batch=1_0"],
        ["-m", "naive-er", "--set", "batch=2.5"],
        ["--most-steps", "3"],
        ["--resume"], ["--method", "cfper"], ["--method", "model-based", "--faithful"], ["--history", "patrolling.stl"],
        ["--checkpoint", "p.npz"], ["--history", "trace.csv"],
    )),
    ["learn", "patrolling.stl", "--out", "q.txt"], ["learn", "patrolling.stl", "--out", "."],
    ["learn", "patrolling.stl", "--out", "patrolling.stl"], ["report", "bare.stl"], ["report", "none.json"],
    *(["estimate", "patrolling.stl", *SMALL, *options] for options in (
        *(options for options, _ in rows(test_estimate.test_bad_options_end_with_a_message)),
        ["--alpha", "0.5", "--beta", "0.5", "--at-least", "0.5"],
    )),
    *(["sweep", "sweep.toml", "--out", "swept", *options] for options, _ in rows(
        test_sweep.test_bad_options_end_with_their_message)),
    *([name, "tradeoff.stl", *test_tradeoff.SMALL, *options] for (name, *options), _ in rows(
        test_tradeoff.test_bad_input_ends_with_its_message)),
    *(["monitor", *options] for options in MONITOR),
    ["explain", "F[0,2s] a", "--step", "5"], ["explain", "patrolling.stl", "--step", "1s"],
    ["explain", "patrolling.stl", "--unit", "s"], ["explain", "F[0,2] a", "--step", "1s"],
    ["explain", "F[0,2] a", "--unit", "parsec"], ["explain", "F[0,2.5] a"],
    ["explain", "F[0,2] a", "--task", "b"],
    ["surrogate", "shift.stl"], ["surrogate", "uncertain.stl"], ["surrogate", "patrolling.stl", "--gamma", "1"],
    ["pareto", "tradeoff.stl", "--tasks", "charging,patrolling", "--model", "floor-5x5-uncertain.toml"],
    ["why", "patrolling.stl", "--minimize", "--policy", "policy.npz"], ["why", "patrolling.stl", "--count", "0"],
    ["certify", "certificate.jsonl", "patrolling.stl"], ["certify", "certificate.jsonl", "charging.stl"],
    ["certify", "patrolling.stl"], ["certify", "certificate.jsonl", "--policy", "policy.npz"],
    ["export", "patrolling.stl", "--to", "pdf"], ["export", "patrolling.stl", "--to", "dot", "--out", "a.pdf"],
    ["fmt", "broken.stl"], ["fmt", "none.stl"], ["lint", "broken.stl", "gated.stl"],
    *(["verify", *files] for files in (["bare.stl"], ["broken.stl", "none.stl"], ["gated.stl"], ["unfit.stl"])),
    ["verify", "expected.stl", "--junit", "expected.stl"], ["verify", "expected.stl", "--exact-seconds", "-1"],
    ["run", "patrolling.stl", "--at-least", "1.2"],
    ["run", "crossing-blackbox.stl", "--at-least", "0.5", "--out", "out"],
]  # fmt: skip


def entries():
    make_inputs(Path())
    for name in ("crossing-blackbox.stl", "lake-blackbox.toml"):
        shutil.copy(ROOT / "examples" / "frozenlake" / name, name)
    Path("bare.stl").write_text("task := F[0,3] A\n")
    Path("broken.stl").write_text("task := F[0,3 A\n")
    Path("gated.stl").write_text(GATED)
    Path("unfit.stl").write_text(UNFIT)
    Path("two.stl").write_text("bounded := G[0,9] x > 0\nforever := x > 0\n")
    Path("row.toml").write_text('kind = "grid"\nmap = "SA"\nsuccess = 0.9\nslip = 0.1\n')
    Path("log.csv").write_text("when,x,door\nMon,1,true\nTue,-1,true\nWed,-2,false\nThu,-3,false\nFri,4,true\n")
    Path("folder").mkdir()
    seen = {"--cluster"}  # that waits for one
    for name, option, value in test_words.TABLE:
        if option not in seen:  # those that several commands have say the same in each
            seen.add(option)
            given = test_words.INSTEAD.get((name, option), CASES[name])
            yield refused(name, *given, *test_words.BESIDE.get((name, option), []), option, value)
    for arguments in FAULTY:
        yield refused(*arguments)
    with memory(50_000):
        yield refused("check", "patrolling.stl", *SMALL, "--save-policy", "p.npz")
        yield refused("tradeoff", *CASES["tradeoff"], "--save-policy", "p.npz")
        yield refused("why", *CASES["why"])


def refused(*arguments):
    code, out, err = command(*arguments)
    assert (code in (1, 2), out) == (True, ""), (arguments, code, out, err)
    return shown(*arguments), err if "╭─ Error" not in err else panel(err)


def panel(err):
    """What typer says in a frame, in one line."""
    lines = [line.strip(" │") for line in err.partition("╭─ Error")[2].splitlines()[1:-1]]
    return f"error: {' '.join(lines).strip()}"
