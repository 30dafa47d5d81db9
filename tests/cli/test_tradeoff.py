"""`stltool pareto` and `stltool tradeoff` as their users meet them."""

import json

import pytest

import stltool as stl
from tests.conftest import FACTORY

TASK = str(FACTORY / "tradeoff.stl")
SMALL = ["-p", "T=5", "-p", "tau=6"]
BOTH = ["--tasks", "charging,patrolling"]


@pytest.fixture(scope="module")
def front(floor5):
    tasks = [stl.load_task(TASK, {"T": 5, "tau": 6}, name) for name in ("charging", "patrolling")]
    return stl.pareto(stl.build_joint_product(floor5, tasks))


def test_pareto_prints_the_corners(stltool, front):
    code, out, err = stltool("pareto", TASK, *SMALL, *BOTH, "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    shown = [
        tuple(corner["probabilities"][n]["value"] for n in ("charging", "patrolling")) for corner in data["corners"]
    ]
    assert shown == [corner.point for corner in front.corners]
    assert data["status"] == "complete"
    assert data["tasks"]["charging"] == "F[0,4] G[0,2] C"
    assert len(data["lines"]) == data["inductions"] == front.inductions
    code, out, err = stltool("pareto", TASK, *SMALL, *BOTH)
    assert code == 0
    assert all(f"{x:.12g}" in out and f"{y:.12g}" in out for x, y in shown)
    code, out, _ = stltool("pareto", TASK, *SMALL, *BOTH, "--points", 2)
    assert "stopped after 2 points; raise points to continue" in out


def test_the_policy_of_every_corner_is_saved_and_has_its_point(stltool, front, tmp_path):
    code, out, err = stltool("pareto", TASK, *SMALL, *BOTH, "--save-policies", tmp_path / "front.npz")
    assert (code, err) == (0, "")
    assert sorted(tmp_path.iterdir()) == sorted(tmp_path / f"front-{i + 1}.npz" for i in range(len(front.corners)))
    for i, corner in enumerate(front.corners):
        path = tmp_path / f"front-{i + 1}.npz"
        assert str(path) in out
        for task, figure in zip(front.joint.tasks, corner.probabilities, strict=True):
            judged = stl.check(task, stl.load_policy(path, task))
            assert judged.probability == pytest.approx(figure.value, abs=1e-13)
    (tmp_path / "other-2.npz").write_text("x,y\n")
    code, out, err = stltool("pareto", TASK, *SMALL, *BOTH, "--save-policies", tmp_path / "other.npz")
    assert (code, out) == (2, "")
    assert "other-2.npz" in err
    code, _, err = stltool("pareto", TASK, *SMALL, *BOTH, "--save-policies", tmp_path / "front.policy")
    assert code == 2
    assert "policies of corners are saved as .npz, .csv or .json" in err


@pytest.mark.parametrize("ending", ["svg", "PNG"])
def test_pareto_draws_the_front(stltool, tmp_path, ending):
    first, again = (tmp_path / f"{name}.{ending}" for name in ("front", "again"))
    for path in (first, again):
        code, out, _ = stltool("pareto", TASK, *SMALL, *BOTH, "--plot", path)
        assert code == 0
        assert str(path) in out
    picture = first.read_bytes()
    assert picture == again.read_bytes()
    if ending == "svg":
        assert picture.startswith(b"<svg")
        assert b"P(charging)" in picture
        assert b"P(patrolling)" in picture
    else:
        assert picture.startswith(b"\x89PNG")


def test_tradeoff_prints_and_saves(stltool, front, tmp_path):
    policy = tmp_path / "policy.npz"
    arguments = [
        "tradeoff",
        TASK,
        *SMALL,
        "--objective",
        "charging",
        "--require",
        "patrolling >= 0.5",
        "--budget",
        "C<=3",
    ]
    code, out, err = stltool(*arguments, "--json", "--save-policy", policy)
    data = json.loads(out)
    assert (code, err, data["status"]) == (0, "", "complete")
    value = data["probabilities"]["charging"]["value"]
    assert value <= front.at_least(0.5)[1]
    assert data["probabilities"]["patrolling"]["lower"] >= 0.5
    assert data["costs"]["C"]["upper"] <= 3
    assert 0 <= data["gap"] < 1e-6
    assert data["size"]["variables"] == 9 * data["size"]["rows"]
    for name in ("charging", "patrolling"):
        code, out, _ = stltool("check", TASK, *SMALL, "--task", name, "--policy", policy, "--json")
        assert json.loads(out)["probability"] == pytest.approx(data["probabilities"][name]["value"], abs=1e-12)
        assert json.loads(out)["policy"] == "time-dependent, mixed"
    code, out, _ = stltool(*arguments)
    assert code == 0
    for text in (f"{value:.11g}"[:-1], ">= 0.5", "<= 3", "maximum", "no policy exceeds", "complete", "randomised"):
        assert text in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["pareto", "--tasks", "charging"], "two names are needed"),
        (["pareto", "--tasks", "charging,"], "two names are needed"),
        (["pareto", "--tasks", "charging,charging"], "two tasks are called charging"),
        (["pareto", "--tasks", "charging,resting"], "resting"),
        (["pareto", *BOTH, "--points", "1"], "give at least 2, the best corner for each task"),
        (["pareto", *BOTH, "--plot", "front.pdf"], "pictures are written as .svg or .png"),
        (["tradeoff", "--objective", "resting"], "resting"),
        (["tradeoff", "--objective", "charging", "--require", "patrolling=0.9"], 'write --require "patrolling>=0.9"'),
        (["tradeoff", "--objective", "charging", "--require", "patrolling>=much"], "'much' is not a number"),
        (["tradeoff", "--objective", "charging", "--require", ">=0.5"], "a name, >= and a number"),
        (["tradeoff", "--objective", "charging", "--require", "patrolling>=2"], "give a probability between 0 and 1"),
        (["tradeoff", "--objective", "charging", "--require", "patrolling>=nan"], "'nan' is not a finite number"),
        (["tradeoff", "--objective", "charging", "--budget", "fuel<=2"], "no signal fuel for this cost"),
        (["tradeoff", "--objective", "charging", "--budget", "C<=2", "--budget", "C<=3"], "C has two bounds"),
        (["tradeoff", "--objective", "charging", "--save-policy", "p.txt"], "policies are saved as .npz"),
        (
            ["tradeoff", "--objective", "charging", "--require", "patrolling>=0.99"],
            "P(patrolling) >= 0.99 cannot be met: its maximum is 0.956745",
        ),
    ],
)
def test_bad_input_ends_with_its_message(stltool, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    command, *rest = arguments
    code, out, err = stltool(command, TASK, *SMALL, *rest)
    assert (code, out) == (2, "")
    assert says in err
    assert list(tmp_path.iterdir()) == []
