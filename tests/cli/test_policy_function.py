"""`--policy-function MODULE:FUNCTION`, the policies of users' own programs, as users meet them."""

import json
import shutil
import sys

import pytest

import stltool as stl
from tests.conftest import PATROLLING, SMALL

AGENT = """
import stltool as stl

best = None

def act(here):
    global best
    if best is None:
        task = stl.load_task("patrolling.stl", params={"T": 5, "tau": 5})
        best = stl.check(stl.build_product(stl.load_model(task.model), task)).policy
    return int(best.at(here.step, [here.state], [here.memory])[0])

class Lazy:
    def act(self, here):
        return "stay"

lazy = Lazy()
count = 3

def wrong(here):
    return "up"

def broken(here):
    return here.weather
"""


@pytest.fixture(autouse=True)
def agent(tmp_path, monkeypatch):
    """A module of the user's, in the folder that commands are run in."""
    (tmp_path / "my_agent.py").write_text(AGENT)
    (tmp_path / "faulty_agent.py").write_text("1 / 0")
    for name in ("patrolling.stl", "floor-5x5.toml"):
        shutil.copy(PATROLLING.replace("patrolling.stl", name), tmp_path)
    monkeypatch.chdir(tmp_path)
    before, path = set(sys.modules), list(sys.path)
    yield
    for name in set(sys.modules) - before:
        if name.endswith("_agent"):
            del sys.modules[name]
    sys.path[:] = path


def test_commands_judge_it(stltool, patrolling):
    best = stl.check(patrolling)
    code, out, _ = stltool("check", "patrolling.stl", *SMALL, "--policy-function", "my_agent:act", "--json")
    data = json.loads(out)
    assert (code, data["question"]) == (0, "policy")
    assert data["lower"] <= best.probability <= data["upper"]
    assert data["probability"] == pytest.approx(data["optimum"], abs=1e-12)
    code, out, _ = stltool("estimate", "patrolling.stl", *SMALL, "--policy-function", "my_agent:lazy.act", "-n", 50)
    assert code == 0
    assert "policy   my_agent:lazy.act (time-dependent, deterministic)" in out
    assert "runs     50, 0 satisfied" in out
    code, out, _ = stltool("why", "patrolling.stl", *SMALL, "--policy-function", "my_agent:act", "-k", 1)
    assert code == 0
    assert "policy  my_agent:act (time-dependent, deterministic)" in out


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("my_agent", "--policy-function my_agent: write MODULE:FUNCTION, such as my_agent:act"),
        ("my_agent:", "write MODULE:FUNCTION"),
        ("my agent:act", "write MODULE:FUNCTION"),
        ("her_agent:act", "importing her_agent raised ModuleNotFoundError: No module named 'her_agent'"),
        ("faulty_agent:act", "importing faulty_agent raised ZeroDivisionError: division by zero"),
        ("my_agent:ac", "there is no ac in it; did you mean act?"),
        ("my_agent:lazy.ac", "there is no ac in it"),
        ("my_agent:count", "count is 3, not a function; name a function"),
        ("my_agent:wrong", "the policy function returned 'up' at step 0, state (1,0)"),
        ("my_agent:broken", "the policy function raised AttributeError at step 0, state (1,0)"),
    ],
)
def test_what_is_none_is_refused(stltool, given, says):
    for command in ("check", "estimate", "why"):
        code, out, err = stltool(command, "patrolling.stl", *SMALL, "--policy-function", given)
        assert (code, out) == (2, "")
        assert says in err


def test_one_policy_at_a_time(stltool, patrolling):
    stl.check(patrolling).policy.save("p.npz")
    two = ("--policy", "p.npz", "--policy-function", "my_agent:act")
    for command in ("check", "estimate", "why"):
        code, _, err = stltool(command, "patrolling.stl", *SMALL, *two)
        assert code == 2
        assert "--policy and --policy-function each give a policy; keep one of them" in err
    for option in ("--stationary", "--memoryless"):
        code, _, err = stltool("check", "patrolling.stl", option, "--policy-function", "my_agent:act")
        assert code == 2
        assert "exclude each other" in err
    code, _, err = stltool("why", "patrolling.stl", "--minimize", "--policy-function", "my_agent:act")
    assert code == 2
    assert "--policy-function for a given one" in err


def test_no_file_names_one(tmp_path):
    """Reading a task, a model or a sweep imports nothing."""
    (tmp_path / "task.stl").write_text('policy_function := F[0,1] "my_agent:act"\n')
    task = stl.load_task(tmp_path / "task.stl")
    assert task.formula == stl.F(stl.label("my_agent:act"), 0, 1)  # a label of that name
    assert "my_agent" not in sys.modules
