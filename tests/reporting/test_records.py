"""What commands print, and what reports are made from, is what the published schema says: no field more, none less."""

import importlib.util
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import stltool as stl
from stltool.reporting import report_data
from stltool.reporting.records import FORMATS, OUTPUTS
from tests.cli.every import CASES, COMMANDS, PRINTED, SMALL, make_inputs, print_json
from tests.conftest import ROOT
from tests.golden.capture import command

spec = importlib.util.spec_from_file_location("schema", ROOT / "docs" / "schema.py")
schema = importlib.util.module_from_spec(spec)
spec.loader.exec_module(schema)
PUBLISHED = json.loads(schema.SCHEMA.read_text(encoding="utf-8"))

# what each command prints with --json, by its name in OUTPUTS: more of what it can print
MORE = {
    "check": [
        ["check", "patrolling.stl", *SMALL, "--exact", "--at-least", "0.5", "--at-most", "0.9"],
        ["check", "patrolling.stl", *SMALL, "--stationary"],
        ["check", "patrolling.stl", *SMALL, "--model", "floor-5x5-p.toml", "-p", "p=0.9", "--policy", "policy.npz",
         "--transfer"],
        ["check", "uncertain.stl", "-p", "T=3", "-p", "tau=8"],
    ],
    "check --cost": [["check", "patrolling.stl", *SMALL, "--cost", "x", "--policy", "policy.npz"],
                     ["check", "patrolling.stl", *SMALL, "--cost", "A", "--until", "horizon"]],
    "check --for-ever": [
        ["check", "patrolling.stl", "-p", "T=3", "-p", "tau=3", "--for-ever", "all"],
        ["check", "patrolling.stl", "-p", "T=2", "-p", "tau=2", "--for-ever", "share", "--exact", "--at-most", "1"],
    ],
    "check --robustness --time-shift": [
        ["check", "patrolling.stl", *SMALL, "--robustness", "--time-shift", "1", "--at-least", "0.5"]
    ],
    "check --cost --within": [["check", "patrolling.stl", *SMALL, "--cost", "A", "--within", "2", "--exact"],
                              ["check", "patrolling.stl", *SMALL, "--cost", "A", "--within", "2", "--at-most", "1"]],
    "check --robustness": [["check", "patrolling.stl", *SMALL, "--robustness"],
                           ["check", "patrolling.stl", *SMALL, "--robustness", "--at-least", "0.1"],
                           ["check", "patrolling.stl", *SMALL, "--robustness", "--margin", "-0.4", "--at-least",
                            "0.01"]],
    "check --vary": [["check", "patrolling.stl", *SMALL, "--model", "floor-5x5-p.toml", "--vary", "p=0.8:0.9",
                      "--at-least", "0.1"]],
    "counterfactual": [["counterfactual", "patrolling.stl", *SMALL, "--at", "0", "--exact"],
                       ["counterfactual", "patrolling.stl", *SMALL, "--run", "run.csv", "--coupling", "order"]],
    "estimate --at-least": [["estimate", "patrolling.stl", *SMALL, "--at-least", "0.2"],
                            ["estimate", "patrolling.stl", *SMALL, "--at-least", "1e-9", "--indifference", "1e-10",
                             "--most-runs", "10"]],
    "frontier": [["frontier", "patrolling.stl", "--at-least", "0.99", "--vary", "T=1:3", "--vary", "tau=5,8"]],
    "explain --policy": [["explain", "patrolling.stl", *SMALL, "--policy", "policy.npz", "--most-leaves", "3"]],
    "explain": [["explain", "charging.stl", "--encoding", "paper"], ["explain", "always a"], ["explain", "timed.stl"],
                ["explain", "G[0,3] (F[0,2] (a & b) & F[0,4] a)", "--encoding", "paper"],
                ["explain", "a U[0,3] b", "--encoding", "paper"]],
    "run": [
        ["run", "patrolling.stl", *SMALL, "--episodes", "60", "--rollouts", "50", "--out", "bound", "--at-least", "0.9",
         "--until-gap", "0.5"],
    ],
    "monitor": [["monitor", "F[0,1] x > 0.5", "batch.npz"], ["monitor", "G[0,1] (x > 0.5) | F[0,1] true", "trace.csv"],
                ["monitor", "F[0,1] x > 0.5", "batch.npz", "--coverage"]],
    "monitor --follow": [["monitor", "F[0,2] x > 0.5", "trace.csv", "--follow", "--end", "cut"],
                         ["monitor", "F[0,2] x > 0.5", "trace.csv", "--follow", "--at", "0"]],
    "verify": [["verify", "all.stl", "expected.stl", "--certificates", "proofs", "--exact-seconds", "0"]],
    "why": [["why", "patrolling.stl", *SMALL, "--mass", "0.001", "--satisfying"]],
}  # fmt: skip
ALL = """
model "floor-5x5-uncertain.toml"
r := F[0,2] A
expect robust Pmax(r) >= 0.99
expect robust P(r, policy "trace.csv") >= 0.99
expect holds(F[0,2] x > 0.5, trace "batch.npz")
"""


def require_valid(data, kind):
    """Also that the same data, with a field more or one less, is not valid."""
    chosen = {"$ref": f"#/$defs/{kind}", "$defs": PUBLISHED["$defs"]}
    checker = jsonschema.Draft202012Validator(chosen)
    checker.validate(data)
    assert not checker.is_valid({**data, "another": 1})
    assert not checker.is_valid({key: value for key, value in data.items() if key != next(iter(data))})


def test_the_schema_is_what_the_records_say():
    jsonschema.Draft202012Validator.check_schema(PUBLISHED)
    assert schema.SCHEMA.read_text(encoding="utf-8") == schema.text(), "python docs/schema.py"


def test_every_output_is_tried():
    assert set(OUTPUTS) <= {*CASES, *MORE}
    computed = {name.split()[0] for name in OUTPUTS}
    assert set(COMMANDS) - computed == {
        "certify",
        "convert",
        "diff",
        "doctor",
        "export",
        "fmt",
        "lint",
        "new",
        "report",
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("records")
    make_inputs(made)
    np.savez(made / "batch.npz", x=np.array([[1.0, 2, 3], [1, -1, -2], [-1, 1, 1]]))
    (made / "all.stl").write_text(ALL)
    (made / "run.csv").write_text('state,action\n"(1,0)",N\n"(1,1)",\n')
    (made / "timed.stl").write_text("step = 0.5s\nr := G[0,2s] (a | always c)\n")
    return made


@pytest.mark.soak
@pytest.mark.parametrize("name", [name for name in OUTPUTS if name in MORE or name in PRINTED])
def test_commands_print_what_the_schema_says(name, folder, once, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("stltool.reporting.page.render", lambda *given: "")  # pictures take long
    kind = PUBLISHED["commands"][name]["$ref"].rpartition("/")[2]
    printed = [(once("json", print_json) / f"{name}.out").read_text(encoding="utf-8")] if name in PRINTED else []
    for arguments in MORE.get(name, []):
        _, out, err = command(*arguments, "--json")
        assert out, err
        printed.append(out)
    for out in printed:
        data = json.loads(out)
        require_valid(data, kind)
        if "format" in data:
            jsonschema.validate(data, PUBLISHED)
            assert FORMATS[data["format"]].__name__ == kind


def test_files_name_their_format(folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("stltool.reporting.page.render", lambda data: "")
    assert command("verify", *CASES["verify"], "--report", "verified")[0] == 0
    for path in (Path("report.json"), Path("verified/report.json")):
        jsonschema.validate(json.loads(path.read_text(encoding="utf-8")), PUBLISHED)
    assert [name.rpartition("-")[2].isdigit() for name in FORMATS] == [True] * len(FORMATS)


def test_a_report_of_all_that_there_is_keeps_to_it(patrolling):
    run = stl.learn(patrolling, "cfer", episodes=40, seed=1)
    data = report_data(
        [stl.check(patrolling, exact=True), stl.check(patrolling, run.policy)],
        run,
        estimates=[stl.estimate(patrolling, run.policy, runs=20)],
        guarantees=[stl.guarantee(patrolling, run.policy, run.counts)],
        stationary=[stl.stationary(patrolling, most=1)],
    )
    require_valid(json.loads(json.dumps(data)), "ReportRecord")
