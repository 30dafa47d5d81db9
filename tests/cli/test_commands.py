"""The command line as its users meet it: output, exit codes, messages, nothing half-written."""

import gzip
import json
import os
import re
import subprocess
import sys
from fractions import Fraction

import pytest

import stltool as stl
from stltool.numbers import within_text
from tests.conftest import FACTORY, PATROLLING, SMALL


def test_check_prints_one_object(stltool):
    code, out, err = stltool("check", PATROLLING, *SMALL, "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert data["probability"] == pytest.approx(0.737948, abs=5e-7)
    assert data["lower"] <= data["probability"] <= data["upper"]
    assert (data["task"], data["horizon"], data["encoding"], data["status"]) == ("patrolling", 8, "exact", "complete")
    assert (data["states"], data["automaton_states"], data["product_states"]) == (18, 26, 468)
    assert (data["optimum"], data["gap"]) == (data["probability"], 0)


def test_check_table_and_minimum(stltool):
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--minimize")
    assert code == 0
    assert "minimum over all policies" in out
    code, out, _ = stltool("check", str(FACTORY / "reaching.stl"))
    assert "reaching := F[0,9] F[0,4] A" in out
    assert "maximum over all policies" in out


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["--at-least", "73794/100000"], 0, "P >= 73794/100000  holds"),
        (["--at-most", "0.7"], 1, "P <= 0.7  does not hold"),
        (["--at-least", "0.7", "--at-most", "0.8"], 0, "P <= 0.8  holds"),
        (["--at-least", "0.7", "--at-most", "0.73"], 1, "P <= 0.73  does not hold"),
        (["--at-least", "0.73794757279959"], 1, "undecided: the bound lies inside the enclosure; add --exact"),
        (["--at-most", "0.73794757279959"], 1, "undecided: the bound lies inside the enclosure; add --exact"),
        (["--at-least", "0.73794757279959", "--exact"], 0, "P >= 0.73794757279959  holds"),
        (["--at-most", "0.73794757279959", "--exact"], 0, "P <= 0.73794757279959  holds"),
        (["--at-least", "0.7379475727995900000001", "--exact"], 1, "does not hold"),
    ],
)  # fmt: skip
def test_verdicts_for_continuous_integration(stltool, options, code, says):
    ended, out, _ = stltool("check", PATROLLING, *SMALL, *options)
    assert ended == code
    assert out.rstrip().endswith(says)
    ended, out, _ = stltool("check", PATROLLING, *SMALL, *options, "--json")
    data = json.loads(out)
    assert (ended, data["holds"], data["decided"]) == (code, code == 0, "undecided" not in says)


def test_the_exact_fraction(stltool):
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--exact")
    assert code == 0
    assert "exact P  73794757279959/100000000000000" in out
    data = json.loads(stltool("check", PATROLLING, *SMALL, "--exact", "--json")[1])
    assert (data["exact"], data["arithmetic"]) == ("73794757279959/100000000000000", "rational")
    long = stltool("check", PATROLLING, "-p", "T=100", "--exact")[1]
    assert "a fraction of " in long


def test_certificates_are_written_and_rechecked(stltool, tmp_path):
    file = tmp_path / "c.jsonl.gz"
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--certificate", file)
    assert code == 0
    assert f"{file} proves 0.7379475727995" in out
    code, out, _ = stltool("certify", file, PATROLLING, *SMALL)
    assert code == 0
    assert "proved    0.7379475727995" in out
    assert "the same task, model and automaton" in out
    data = json.loads(stltool("certify", file, "--json")[1])
    assert (data["proved"], data["compared_with"], data["pairs"]) == (True, None, 11)
    code, _, err = stltool("certify", file, PATROLLING)
    assert code == 2
    assert "the task of this certificate is G[0,4]" in err
    changed = tmp_path / "c.jsonl"
    text = gzip.decompress(file.read_bytes()).decode()
    changed.write_text(text.replace('{"lower":"', '{"lower":"1', 1))
    code, _, err = stltool("certify", changed)
    assert code == 1
    assert "refused: " in err
    assert stltool("certify", PATROLLING)[0] == 2
    assert stltool("certify", tmp_path / "none")[0] == 2


def test_the_optimal_policy_is_saved(stltool, tmp_path):
    policy = tmp_path / "p.npz"
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--save-policy", policy)
    assert (code, out.split()[-2:]) == (0, ["policy", str(policy)])


@pytest.mark.parametrize("before", [[], ["check"], ["new"]])
def test_the_version(stltool, before):
    assert stltool(*before, "--version")[1].startswith("stltool 0.")


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("stltool ch", ["check"]),
        ("stltool check --certi", ["--certificate"]),
        ("stltool run --method naive", ["naive", "naive-er"]),
        ("stltool check --encoding p", ["paper"]),
        ("stltool new --kind gr", ["grid"]),
        ("stltool new --example ba", ["battery"]),
    ],
)
def test_shells_complete(stltool, monkeypatch, typed, completed):
    """As bash asks: the words typed so far, and which of them to complete."""
    monkeypatch.setenv("_STLTOOL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    assert stltool()[1].split() == completed


def test_help_has_a_short_form(stltool):
    for command in ([], ["check"], ["doctor"]):
        short, long = (stltool(*command, option)[1] for option in ("-h", "--help"))
        assert short == long
        assert "Example: stltool" in short


def test_quiet_shows_no_progress(stltool, monkeypatch, tmp_path):
    """A log that is impatient reports at once; with --quiet it reports nothing, and results are the same.

    From 100 episodes on there is a line at every tenth, however quickly they are learned.
    """
    monkeypatch.setattr("stltool.log.EVERY", 0.05)
    monkeypatch.setattr("stltool.reporting.terminal._PATIENCE", 0.0)
    arguments = ["learn", PATROLLING, *SMALL, "-e", "100", "--out", "policy.npz"]
    monkeypatch.chdir(tmp_path)
    loud, quiet, shortly = (stltool(*arguments, *more) for more in ([], ["--quiet"], ["-q"]))
    assert "learning (model-based): " in loud[2]
    assert quiet[2] == shortly[2] == ""
    assert quiet[1].splitlines()[1:] == loud[1].splitlines()[1:]  # the first has the seconds


def test_fractions_of_any_length(stltool, tmp_path):
    """Beyond the 4300 digits that Python writes and reads by itself."""
    (tmp_path / "m.tra").write_text("2 2 3\n0 0 0 0.99999999999999\n0 0 1 0.00000000000001\n1 0 1 1\n")
    (tmp_path / "m.lab").write_text('0="init" 1="done"\n0: 0\n1: 1\n')
    (tmp_path / "t.stl").write_text('model "m.tra"\nsoon := F[0,320] done\n')
    files = [tmp_path / "t.stl", tmp_path / "c.jsonl", tmp_path / "p.npz"]
    code, out, _ = stltool("check", files[0], "--exact", "--certificate", files[1], "--save-policy", files[2])
    assert (code, "exact P  a fraction of 89" in out) == (0, True)
    code, out, _ = stltool("certify", files[1], files[0])
    assert (code, "3.1999999999948960E-12 <= P <= 3.1999999999948961E-12" in out) == (0, True)
    assert len(json.loads(stltool("check", files[0], "--exact", "--json")[1])["exact"]) > 8600
    stltool("check", files[0], "--exact", "--policy", files[2], "--certificate", files[1])
    assert stltool("certify", files[1], files[0], "--policy", files[2])[0] == 0


def test_certificates_of_given_policies(stltool, tmp_path):
    saved, file = tmp_path / "p.npz", tmp_path / "c.jsonl"
    stltool("check", PATROLLING, *SMALL, "--save-policy", saved)
    code, _, _ = stltool("check", PATROLLING, *SMALL, "--policy", saved, "--exact", "--certificate", file)
    assert code == 0
    data = json.loads(stltool("certify", file, "--json")[1])
    assert (data["claim"], data["lower"], data["upper"]) == ("policy", *["73794757279959/100000000000000"] * 2)
    assert stltool("certify", file, PATROLLING, *SMALL, "--policy", saved)[0] == 0
    code, _, err = stltool("certify", file, "--policy", saved)
    assert (code, "give TASK, too" in err) == (2, True)


def test_an_explicit_model_on_the_command_line(stltool, tmp_path):
    (tmp_path / "m.tra").write_text("2 2 3\n0 0 0 2/3\n0 0 1 1/3\n1 0 1 1\n")
    (tmp_path / "m.lab").write_text('0="init" 1="done"\n0: 0\n1: 1\n')
    (tmp_path / "t.stl").write_text('model "m.tra"\nsoon := F[0,2] done\n')
    code, out, _ = stltool("check", tmp_path / "t.stl", "--exact")
    assert code == 0
    assert "exact P  5/9" in out


@pytest.mark.parametrize(("bound", "code", "says"), [("0.7", 0, "holds"), ("0.75", 1, "does not hold")])
def test_at_least_sets_the_exit_code(stltool, bound, code, says):
    ended, out, _ = stltool("check", PATROLLING, *SMALL, "--at-least", bound)
    assert ended == code
    assert out.rstrip().endswith(says)
    ended, out, _ = stltool("check", PATROLLING, *SMALL, "--at-least", bound, "--json")
    assert (ended, json.loads(out)["holds"]) == (code, code == 0)


def test_learn_then_check_the_policy(stltool, tmp_path):
    policy = tmp_path / "deep" / "policy.npz"
    code, out, _ = stltool("learn", PATROLLING, *SMALL, "-e", 60, "--seed", 2, "--out", policy)
    assert code == 0
    assert 60 < int(re.search(r"60 episodes, (\d+) environment steps", out)[1]) <= 60 * 8
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", policy, "--json")
    data = json.loads(out)
    assert data["question"] == "policy"
    assert data["gap"] == pytest.approx(data["optimum"] - data["probability"])
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(task.model), task)
    run = stl.learn(product, episodes=60, seed=2)
    assert stl.check(product, run.policy).probability == data["probability"]
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", policy)
    assert "the policy" in out
    assert "maximum over all policies" in out


def test_learn_prints_json_and_takes_settings(stltool, tmp_path):
    code, out, err = stltool(
        "learn", PATROLLING, *SMALL, "-m", "naive-er", "--faithful", "-e", 20, "--set", "batch=8", "--set",
        "scale=printed", "--out", tmp_path / "p.npz", "--json",
    )  # fmt: skip
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert (data["method"], data["faithful"]) == ("naive-er", True)
    assert (data["settings"]["batch"], data["settings"]["scale"]) == (8, "printed")


def test_the_optimal_policy_can_be_saved_and_checked(stltool, tmp_path):
    policy = tmp_path / "best.npz"
    assert stltool("check", PATROLLING, *SMALL, "--save-policy", policy)[0] == 0
    _, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", policy, "--json")
    assert json.loads(out)["gap"] == 0


@pytest.mark.parametrize("kind", ["stationary", "memoryless"])
def test_policies_that_do_not_know_the_step(stltool, tmp_path, kind):
    task, policy = FACTORY / "tradeoff.stl", tmp_path / "p.npz"
    options = ("--task", "charging", "-p", "T=3", f"--{kind}")
    code, out, err = stltool("check", task, *options, "--save-policy", policy, "--exact", "--json")
    assert (code, err) == (0, "")
    data = json.loads(out)
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    product = stl.build_product(model, stl.load_task(task, {"T": 3}, "charging"))
    found = stl.stationary(product, memory="automaton" if kind == "stationary" else "none")
    assert data["stationary"]["kind"] == kind
    assert data["stationary"]["bound"] == found.bound
    assert data["probability"] == pytest.approx(found.probability)
    assert float(Fraction(data["exact"])) == data["probability"]
    code, out, _ = stltool("check", task, *options[:-1], "--policy", policy, "--json")
    assert json.loads(out)["probability"] == pytest.approx(found.probability, abs=1e-12)
    code, out, _ = stltool("check", task, *options, "--minimize", "--at-most", "0.5")
    assert code == 0
    assert f"no deterministic {kind} policy has less than 0" in out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--memoryless"], "exclude each other; give one of them"),
        (["--policy", "p.npz"], "exclude each other"),
        (["--save-policy", "p.policy"], "policies that do not know the step are saved as .npz"),
        (["--cluster", "tcp://127.0.0.1:9"], "--cluster is for the optimum and for given policies"),
        (["--model", str(FACTORY / "floor-5x5-uncertain.toml")], "needs probabilities without intervals"),
    ],
)
def test_stationary_with_what_does_not_fit(stltool, tmp_path, monkeypatch, options, says):
    monkeypatch.chdir(tmp_path)
    code, out, err = stltool("check", FACTORY / "patrolling.stl", "--stationary", *options)
    assert (code, out) == (2, "")
    assert says in " ".join(err.split())
    assert list(tmp_path.iterdir()) == []


def test_run_learns_checks_and_reports(stltool, tmp_path):
    code, out, err = stltool("run", PATROLLING, *SMALL, "-e", 100, "--out", tmp_path)
    assert code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["policy.npz", "report.html", "report.json"]
    data = json.loads((tmp_path / "report.json").read_text())
    for check in data["checks"]:
        assert within_text(check["probability"], check["lower"], check["upper"]) in out
    assert "learning (model-based): 100 of 100" in err
    assert data["command"].startswith("stltool run")
    page = (tmp_path / "report.html").read_text()
    (tmp_path / "report.html").unlink()
    assert stltool("report", tmp_path / "report.json")[0] == 0
    assert (tmp_path / "report.html").read_text() == page
    code, out, err = stltool("run", PATROLLING, *SMALL, "-e", 20, "--out", tmp_path, "--json")
    assert json.loads(out)["checks"][0]["probability"] == data["checks"][0]["probability"]
    assert err == ""


def test_explain(stltool, tmp_path):
    code, out, _ = stltool("explain", PATROLLING)
    assert code == 0
    assert "F[0,10) A, F[0,10) x < 0.4 & y > 0.6" in out
    _, out, _ = stltool("explain", PATROLLING, "--json")
    data = json.loads(out)
    assert (data["horizon"], data["samples_needed"], data["product_states"]) == (18, 19, 18 * 101)
    assert (data["automaton_states"], data["flag_states"]) == (101, 121)
    assert data["history_states"] == sum(3**i for i in range(11))  # letters that occur on the floor: A, B, neither
    assert [(part["delay"], part["states"]) for part in data["parts"]] == [(9, 11), (9, 11)]
    assert data["fragment"] == {
        "outer": "G[0,10)", "parts": ["F[0,10) A", "F[0,10) x < 0.4 & y > 0.6"], "equal_windows": True,
    }  # fmt: skip
    assert (data["ambiguities"], data["tree"]["operator"], data["tree"]["line"]) == ([], "G[0,9]", 6)
    path = tmp_path / "deep.stl"
    path.write_text("deep := G[0,5] F[0,3] G[0,2] a\n")
    code, out, _ = stltool("explain", path)
    assert code == 0
    assert "depth 3" in out
    assert "G[0,5]  horizon 10\n└── F[0,3]  horizon 5\n    └── G[0,2]  horizon 2\n        └── a\n" in out


def test_explain_tells_what_may_be_misread_and_what_has_no_horizon(stltool, tmp_path):
    path = tmp_path / "task.stl"
    path.write_text("step = 0.5s\nr := G[0,2s] a & b or always c\n")
    code, out, _ = stltool("explain", path)
    assert code == 0
    assert "none: an interval has no end; only monitors and check --for-ever judge this" in out
    assert "not analysed: the formula has no horizon" in out
    assert "└── G[0,inf)\n    └── c\n" in out
    assert "warning: " in out
    assert "here it means ((G[0,2s] a) & b) | (G c)" in out
    data = json.loads(stltool("explain", path, "--json")[1])
    assert (data["horizon"], data["step"], len(data["ambiguities"])) == (None, "0.5s", 1)
    assert [node["horizon"] for node in data["tree"]["operands"]] == [4, None]


def test_explain_warns_of_tasks_that_say_nothing_and_of_idle_parts(stltool):
    for text, warning in (
        ("G[0,5] (x > 5 & x < 3)", "this task can never hold: x > 5 & x < 3 never holds\n    G[0,5] (x > 5 & x < 3)\n"),
        ("(F[0,3] a) | (G[0,3] !a)", "this task holds on every trace"),
        ("(G[0,9] a) & (G[0,5] a)", "G[0,5] a is vacuous; with true in its place, the task still means G[0,9]"),
    ):
        code, out, _ = stltool("explain", text)
        assert (code, f": {warning}" in out) == (0, True)
        assert out.count("warning: ") == 1
    data = json.loads(stltool("explain", "(G[0,T] a) & (G[0,5] a)", "-p", "T=9", "--json")[1])
    assert data["meaning"]["vacuous"][0]["means"] == "G[0,9] a"
    assert (data["meaning"]["can_hold"], data["meaning"]["can_fail"], len(data["warnings"])) == (True, True, 1)
    _, out, _ = stltool("explain", PATROLLING)
    assert "warning" not in out
    assert re.search(r"^holds for example on +A, x < 0.4, y > 0.6 for 10 steps$", out, flags=re.MULTILINE)


def test_every_name_that_a_message_lists_can_be_typed(stltool, tmp_path):
    trace = tmp_path / "trace.csv"
    trace.write_text('Engine Speed (rpm),G,"say ""hi""",x\n1000,80,1,0\n2000,90,1,0\n')
    code, _, err = stltool("monitor", "speed > 3", trace)
    assert code == 2
    listed = re.search(r"known names: (.*)", err)[1].split(", ")
    assert listed == ['"Engine Speed (rpm)"', '"G"', '"say ""hi"""', "x"]
    for name in listed:
        code, out, _ = stltool("monitor", f"G[0,1] ({name} >= 0)", trace, "--json")
        assert (code, json.loads(out)["holds"]) == (0, True)
    code, _, err = stltool("monitor", '"Engine Sped (rpm)" > 3', trace)
    assert 'did you mean "Engine Speed (rpm)"?' in err


def test_comparisons_of_several_steps_tell_their_cases(stltool, tmp_path):
    path = tmp_path / "task.stl"
    path.write_text(f'model "{FACTORY / "floor-5x5.toml"}"\nr := G[0,3] (x[t+1] - x[t] <= 0.2)\n')
    code, out, err = stltool("check", path, "--json")
    told = "x - x[t-1] <= 0.2 is judged by 5 values of x: "
    assert (code, told in err, told in json.loads(out)["model_notes"][-1]) == (0, True, True)


def test_a_formula_may_have_times(stltool, tmp_path):
    assert json.loads(stltool("explain", "F[0,2s] a", "--step", "500ms", "--json")[1])["formula"] == "F[0,4] a"
    assert "no step is declared; give --step 0.1s" in stltool("explain", "F[0,2s] a")[2]
    assert "write 2s or 2 steps, or give --unit s or --unit step" in stltool("explain", "F[0,2] a", "--step", "1s")[2]
    assert "is not a unit of time; write --unit s" in stltool("explain", "F[0,2] a", "--unit", "parsec")[2]
    for unit, horizon in (("s", 4), ("step", 2), ("500 ms", 2), ("min", 240)):
        data = json.loads(stltool("explain", "F[0,2] a", "--step", "500ms", "--unit", unit, "--json")[1])
        assert data["horizon"] == horizon
    code, _, err = stltool("explain", PATROLLING, "--unit", "s")
    assert (code, "a task file declares its own unit; write unit = s there" in err) == (2, True)
    assert "is not a positive time with a unit" in stltool("explain", "F[0,2s] a", "--step", "3")[2]
    code, _, err = stltool("explain", PATROLLING, "--step", "1s")
    assert (code, "a task file declares its own step; write step = 1s there" in err) == (2, True)
    trace = tmp_path / "trace.csv"
    trace.write_text("a\n0\n0\n0\n0\n1\n")
    assert stltool("monitor", "F[0,2s] a", trace, "--step", "0.5s")[0] == 0
    assert stltool("monitor", "F[0,2s] a", trace, "--step", "1s")[0] == 1
    assert stltool("monitor", "eventually a", trace, "--end", "cut")[0] == 0
    code, _, err = stltool("monitor", "eventually a", trace)
    assert (code, "only monitors of whole traces judge it, with end cut or hold" in err) == (2, True)


def test_a_param_is_given_once(stltool):
    code, _, err = stltool("explain", "F[0,T] a", "-p", "T=3", "-p", "T=4")
    assert (code, "-p T is given twice, 3 and 4; give it once" in err) == (2, True)


def test_a_large_tree_is_cut():
    tree = stl.explain(stl.parse_task("r := " + " & ".join(f"a{i}" for i in range(2000)) + " | b"))["tree"]
    assert len(tree["operands"][0]["operands"]) < 600
    assert tree["operands"][0]["operands"][-1]["operator"] == "…"


def test_the_papers_encoding_warns(stltool, tmp_path):
    path = tmp_path / "task.stl"
    path.write_text("task := F[0,3) (F[0,2) A & G[0,4) B)\n")
    model = FACTORY / "floor-5x5.toml"
    code, _, err = stltool("check", path, "--model", model, "--encoding", "paper")
    assert code == 0
    assert "only approximates" in err
    code, out, _ = stltool("explain", path, "--encoding", "paper")
    assert code == 0
    assert "the encoding says True, the formula is False" in out
    code, _, err = stltool("check", path, "--model", model)
    assert (code, "only approximates" in err) == (0, False)


BAD_TASKS = {
    "unknown label": ("task := F[0,3] Dock", "the model has no label Dock"),
    "empty interval": ("task := F[3,3) A", "the interval [3,3) is empty"),
    "non-integer bound": ("task := F[0,2.5] A", "2.5 is not an integer number of steps"),
    "chained comparison": ("task := F[0,2] (0.1 < x < 0.4)", "write (x > 0.1 & x < 0.4)"),
    "missing model": ('model "none.toml"\ntask := F[0,2] A', "none.toml: there is no such model file"),
    "enormous window": ("task := G[0,5] F[0,10^12) A", "grows over 100000 states"),
    "binary": ("\0\1\2", "not a task file: it contains binary data"),
    "syntax": ("task := G[0,5] (A &", "the text ends here; expected a formula"),
    "no task": ("# nothing", "the file defines no task"),
}


@pytest.mark.parametrize("kind", BAD_TASKS)
def test_bad_tasks_end_with_a_message_and_code_2(stltool, tmp_path, kind):
    text, says = BAD_TASKS[kind]
    path = tmp_path / "task.stl"
    path.write_text(text if "model" in text else f'model "{FACTORY / "floor-5x5.toml"}"\n{text}')
    for command in (
        ["check", path],
        ["run", path, "--out", tmp_path / "out"],
        ["learn", path, "--out", tmp_path / "p.npz"],
    ):
        code, out, err = stltool(*command)
        assert code == 2, command
        assert "error: " in err
        assert says in err
        assert out == ""
    assert [entry.name for entry in tmp_path.iterdir()] == ["task.stl"]  # nothing half-written


def test_other_bad_input_ends_with_code_2(stltool, tmp_path):
    policy = tmp_path / "p.npz"
    assert stltool("check", PATROLLING, *SMALL, "--save-policy", policy)[0] == 0
    no_model = tmp_path / "task.stl"
    no_model.write_text("task := F[0,3] A\n")
    row = tmp_path / "row.toml"
    row.write_text('kind = "grid"\nmap = "SA"\nsuccess = 0.9\nslip = 0.1\n')
    cases = [
        (["check", PATROLLING, "--policy", policy], "this policy is for the task"),
        (["check", PATROLLING, "--policy", PATROLLING], "not a policy file"),
        (["check", PATROLLING, "-p", "T"], "is not NAME=VALUE"),
        (["check", PATROLLING, "-p", "TT=3"], "there is no param TT to override; did you mean T"),
        (["check", PATROLLING, "-p", "T=many"], "is not a number"),
        (["check", PATROLLING, "--task", "patrol"], "there is no definition patrol; did you mean patrolling"),
        (["check", PATROLLING, "--encoding", "fast"], "'fast'; choose exact, paper, history, running or safety"),
        (["check", PATROLLING, "--at-least", "1.2"], "a probability lies between 0 and 1"),
        (["check", no_model], "names no model; add a line such as"),
        (["check", no_model, "--model", row], "sum to 1.2, not 1"),
        (["run", PATROLLING, "--method", "cefr"], "did you mean cfer"),
        (["run", PATROLLING, "--episodes", "0"], "episodes is 0"),
        (["run", PATROLLING, "-m", "cfer", "--set", "optimist=3"], "no setting 'optimist'; did you mean optimism"),
        (["run", PATROLLING, *SMALL, "-e", "1", "--out", no_model], "is not a writable directory; name another"),
        (["run", PATROLLING, "--set", "seed=3"], "--set seed: this setting has its own option; use --seed"),
        (["run", PATROLLING, "--set", "evaluate_every=3"], "its own option; use --evaluate-every"),
        (["run", PATROLLING, "-m", "cfer", "--set", "caution=3", "--set", "caution=4"], "--set caution is given twice"),
        (
            ["learn", PATROLLING, "-o", "p.npz", "--set", "gamma=0.1"],
            "model-based has no setting gamma; naive as published",
        ),
        (
            ["learn", PATROLLING, "-o", "p.npz", "-m", "naive-er", "--set", "batch=1_0"],
            "batch is '1_0'; it must be an integer",
        ),
        (
            ["learn", PATROLLING, "-o", "p.npz", "-m", "naive-er", "--set", "batch=2.5"],
            "batch is '2.5'; it must be an integer",
        ),
        (["learn", PATROLLING, "-o", "p.npz", "--most-steps", "3"], "--most-steps is 3, and one episode takes 18"),
        (["run", PATROLLING, "--set", "optimism=abc"], "--set optimism is 'abc'; it must be a number above 0"),
        (["run", PATROLLING, "--seed", "-1"], "seed is -1; give an integer from 0"),
        (
            ["run", PATROLLING, "-m", "naive-er", "--set", "memory=99999999999999"],
            "a replay memory of 99999999999999 transitions",
        ),
        (["learn", PATROLLING, *SMALL, "-e", "1", "--out", tmp_path / "q.txt"], "policies are saved as .npz"),
        (["learn", PATROLLING, *SMALL, "-e", "1", "--out", tmp_path], "not a regular file"),
        (["report", no_model], "not the JSON file of a report"),
        (["report", tmp_path], f"this is a folder; name its data, such as {tmp_path / 'report.json'}"),
        (["check", no_model, "--model", tmp_path], "this is a folder; name a model file"),
        (["check"], "Missing argument"),
        (["chek", PATROLLING], "No such command"),
    ]
    for arguments, says in cases:
        code, _, err = stltool(*arguments)
        assert code == 2, arguments
        assert says in " ".join(err.replace("│", " ").split()), arguments


def test_the_installed_command(tmp_path):
    """Once as a real process, from another folder."""
    command = [sys.executable, "-m", "stltool", "check", PATROLLING, *SMALL, "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env={**os.environ})
    assert done.returncode == 0
    assert json.loads(done.stdout)["optimum"] == pytest.approx(0.737948, abs=5e-7)
    help_text = subprocess.run([sys.executable, "-m", "stltool", "--help"], capture_output=True, text=True).stdout
    assert all(command in help_text for command in ("run", "check", "learn", "explain", "report"))


def test_several_first_states_are_told_with_their_weights(stltool, tmp_path):
    task = FACTORY / "docks.stl"
    told = "2 states with probability 0.5 each: (0,0), (3,0)"
    for arguments in (["check", task], ["explain", task], ["run", task, "-e", "2", "--out", tmp_path]):
        code, out, _ = stltool(*arguments)
        assert code == 0
        assert re.search(rf"starts in +{re.escape(told)}", out), arguments
    assert f"Runs start in {told}." in (tmp_path / "report.html").read_text(encoding="utf-8")
    code, out, _ = stltool("check", task, "--json")
    data = json.loads(out)
    assert (data["initial"], data["initial_states"], data["model_notes"]) == (told, 2, [])
    code, out, _ = stltool("check", PATROLLING, *SMALL)
    assert "starts in" not in out
    code, out, _ = stltool("explain", PATROLLING, *SMALL)
    assert re.search(r"starts in +\(1,0\)\n", out)


def test_a_policy_goes_to_a_file_while_it_is_found(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--save-policy", "best.policy", "--json")
    found = json.loads(out)
    assert (code, os.listdir()) == (0, ["best.policy"])
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--policy", "best.policy", "--json")
    assert json.loads(out)["probability"] == found["probability"]
    code, _, err = stltool("check", PATROLLING, *SMALL, "--save-policy", "best.npz", "--resume")
    assert (code, "--resume continues a policy file; add --save-policy FILE.policy" in err) == (2, True)
    code, out, _ = stltool("check", PATROLLING, *SMALL, "--save-policy", "best.policy", "--resume", "--json")
    assert json.loads(out)["probability"] == found["probability"]


def test_what_is_certain_is_said(stltool):
    for options, said in (
        (["-p", "T=1"], "certain  no policy can satisfy it"),
        (["--minimize"], "certain  some policy surely does not satisfy it"),
    ):
        code, out, _ = stltool("check", FACTORY / "charging.stl", *options)
        assert (code, said in out) == (0, True)
    assert "certain " not in stltool("check", PATROLLING, *SMALL)[1]


@pytest.mark.parametrize(
    ("bound", "code", "told", "as_json"), [("0.5", 0, "holds", False), ("0.999", 1, "does not hold", True)]
)
def test_a_run_may_be_asked_for_a_bound(stltool, tmp_path, bound, code, told, as_json):
    given = ["-e", 60, "--rollouts", 100, "--out", tmp_path, "--at-least", bound, *["--json"] * as_json]
    got, out, err = stltool("run", PATROLLING, "-p", "T=3", "-p", "tau=8", *given)
    assert (got, "error" in err) == (code, False)
    data = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    policy = next(check for check in data["checks"] if check["question"] == "policy")
    assert data["asked"] == [{"claim": f"P >= {bound}", "holds": code == 0}]
    assert (policy["lower"] >= float(bound)) == (code == 0)
    assert json.loads(out) == data if as_json else f"P >= {bound}" in out
    assert as_json or re.search(rf"^P >= {bound} +{told}$", out, flags=re.MULTILINE)


def test_a_run_with_a_bound_that_is_none_begins_nothing(stltool, tmp_path):
    code, _, err = stltool("run", PATROLLING, "--at-least", "1.5", "--out", tmp_path / "out")
    assert (code, "a probability lies between 0 and 1" in err) == (2, True)
    assert not (tmp_path / "out").exists()
