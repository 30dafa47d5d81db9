"""`stltool check --robustness`."""

import json

import pytest

import stltool as stl
from tests.conftest import FACTORY

TASK = str(FACTORY / "patrolling.stl")
SMALL = ["-p", "T=2", "-p", "tau=4"]


def test_all_margins_one_margin_and_the_largest(stltool, tmp_path):
    task = stl.load_task(TASK, params={"T": 2, "tau": 4})
    model = stl.load_model(task.model)
    best = stl.check(stl.build_product(model, task)).policy
    best.save(tmp_path / "best.npz")
    asked = ["check", TASK, *SMALL, "--robustness"]
    for options, policy, maximize in (([], None, True), (["--minimize"], None, False),
                                      (["--policy", tmp_path / "best.npz"], best, True)):  # fmt: skip
        found = stl.robustness_distribution(model, task, policy, maximize=maximize)
        code, out, err = stltool(*asked, *options, "--json")
        data = json.loads(out)
        assert (code, err, data["question"], data["formula"]) == (0, "", found.question, str(task.formula))
        assert (data["values"], data["lower"], data["upper"]) == (
            *(a.tolist() for a in (found.values, *found.survival)),
        )
        assert data["mean"] == (list(found.mean) if found.mean is not None else None)
        lower, upper = found.at(-0.2)
        for option, sure, never in (
            ("--at-least", lower - 1e-9, upper + 1e-9),
            ("--at-most", upper + 1e-9, lower - 1e-9),
        ):
            for bound, holds in ((sure, True), (never, False)):
                if 0 <= bound <= 1:
                    code, out, _ = stltool(*asked, *options, "--margin=-0.2", option, f"{bound:.15f}", "--json")
                    data = json.loads(out)
                    assert (code, data["holds"], data["decided"]) == (int(not holds), holds, True)
                    assert (data["values"], data["lower"], data["upper"]) == ([-0.2], [lower], [upper])
        code, out, _ = stltool(*asked, *options, "--at-least", "0.5")
        largest = found.largest(0.5)
        assert code == int(largest == -float("inf"))
        assert out.splitlines()[-1].endswith(f"{largest:g}" if code == 0 else "there is none")
    code, out, _ = stltool(*asked)
    assert "P     maximum over all policies, that the robustness is at least r, for each r" in out


def test_delays_in_both_readings(stltool, tmp_path):
    task = stl.load_task(TASK, params={"T": 3, "tau": 6})
    model = stl.load_model(task.model)
    asked = ["check", TASK, "-p", "T=3", "-p", "tau=6", "--robustness", "--time-shift", "1"]
    stl.check(stl.build_product(model, task)).policy.save(tmp_path / "best.npz")
    for options, margin, maximize in (([], None, True), (["--minimize"], None, False), (["--margin=-0.2"], -0.2, True)):
        found = stl.time_distribution(model, task, 1, margin=margin, maximize=maximize)
        code, out, err = stltool(*asked, *options, "--json")
        data = json.loads(out)
        assert (code, err, data["question"], data["margin"]) == (0, "", found.question, margin)
        for name, reading in (("predicates", "predicates"), ("whole_task", "task")):
            assert (data[name]["lower"], data[name]["upper"]) == tuple(a.tolist() for a in found.bounds[reading])
    found = stl.time_distribution(model, task, 1)
    between = f"{(found.at(1)[1] + found.at(1, 'task')[0]) / 2:.15f}"
    code, out, _ = stltool(*asked, "--at-least", between, "--at-most", "1")
    assert code == 1  # one of the readings fails
    assert [line.split("  ")[-1] for line in out.splitlines()[-4:]] == ["does not hold", "holds", "holds", "holds"]
    assert out.splitlines()[-4].startswith(f"P >= {between}, k = 1, predicates ")
    code, out, _ = stltool(*asked, "--at-least", f"{found.at(1)[0] - 1e-9:.15f}")
    assert code == 0
    assert "whole task  the whole task holds from each of the steps 0 to k on" in out
    code, _, err = stltool(*asked, "--policy", tmp_path / "best.npz")
    assert (code, "the policy ends after 7 steps, the task after 8" in err) == (2, True), err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--margin", "0.1"], "--margin 0.1 is a margin of robustness; add --robustness"),
        (
            ["--robustness", "--margin", "much"],
            "--margin much: 'much' is not a number; write, for example, --margin 0.1",
        ),
        (["--time-shift", "1"], "--time-shift 1 is robustness in time; add --robustness"),
        (["--robustness", "--time-shift", "-1"], "--time-shift -1: write a number of steps"),
        (["--robustness", "--exact"], "--exact is not supported with --robustness"),
        (["--robustness", "--save-policy", "p.npz"], "--save-policy is not supported with --robustness"),
        (["--robustness", "--encoding", "paper"], "--encoding is not supported with --robustness"),
        (["--robustness", "--at-most", "0.5"], "without --margin, --at-most is not supported with --robustness"),
        (["--robustness", "--at-least", "0"], "give a probability above 0 and at most 1"),
        (["--robustness", "--vary", "success=0.5:1"], "--robustness is for one value of the parameter"),
        (
            ["--robustness", "--model", "floor-5x5-uncertain.toml"],
            "--robustness needs probabilities without intervals; add --nominal",
        ),
        (["--robustness", "--model", "floor-5x5-p.toml"], "depend on p, without a value"),
    ],
)
def test_what_does_not_fit_ends_with_a_message(stltool, options, says):
    options = [str(FACTORY / option) if option.endswith(".toml") else option for option in options]
    code, out, err = stltool("check", TASK, *SMALL, *options)
    assert (code, out) == (2, "")
    assert says in err
    assert len(err.splitlines()) == 1
