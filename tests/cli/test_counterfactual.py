"""`stltool counterfactual` as its users meet it."""

import json

import stltool as stl
from tests.conftest import FACTORY, PATROLLING, SMALL


def test_the_most_probable_violation(stltool):
    code, out, err = stltool("counterfactual", PATROLLING, *SMALL, "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(task.model), task)
    [run] = stl.likely_runs(product, count=1).runs
    found = stl.counterfactual(product, run)
    assert data["visited"] == [product.model.state_name(s) for s in run.states]
    assert [one["probability"] for one in data["alternatives"]] == [one.probability for one in found.alternatives]
    code, out, _ = stltool("counterfactual", PATROLLING, *SMALL)
    assert code == 0
    assert "run       the most probable violation: violated" in out
    assert found.assumption in out
    assert len(out.splitlines()) == 6 + len(run.actions)


def test_what_play_printed_is_a_run(stltool, tmp_path):
    code, out, _ = stltool("play", PATROLLING, *SMALL, "--moves", "N>(1,1) *", "--json")
    assert code == 0
    path = tmp_path / "run.json"
    path.write_text(out)
    code, told, _ = stltool("counterfactual", PATROLLING, *SMALL, "--run", path, "--at", 0, "--exact")
    assert code == 0
    assert f"{path}: " in told
    rows = told.splitlines()[6:]
    assert len(rows) == 9  # actions
    assert [row.split()[2] for row in rows if "as it was" in row] == ["N"]


def test_faults(stltool, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text('state,action\n"(1,0)",N\n"(4,4)",\n')
    for arguments, message in [
        (["--run", path], "never leads to (4,4)"),
        (["--run", tmp_path / "none.csv"], "no such file of a run"),
        (["--at", 99], "--at"),
        (["--at", 0, "--action", "up"], "there is no action 'up'"),
    ]:
        code, _, err = stltool("counterfactual", PATROLLING, *SMALL, *arguments)
        assert (code, message in err) == (2, True), err
    sure = tmp_path / "sure.stl"
    sure.write_text(f'model "{FACTORY / "floor-5x5.toml"}"\nr := F[0,3] (x > 0)\n')
    code, _, err = stltool("counterfactual", sure)
    assert (code, "--run FILE" in err) == (2, True)
