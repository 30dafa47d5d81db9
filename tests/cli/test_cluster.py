"""`stltool check --cluster`, on a cluster of this process's threads."""

import json

import pytest

from tests.conftest import FACTORY, PATROLLING, SMALL

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address():
    settings = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "protocol": "tcp://"}
    with distributed.LocalCluster(**settings, dashboard_address=":0", silence_logs=50) as cluster:
        yield cluster.scheduler_address


def test_the_same_answer(address, stltool):
    given = ["check", PATROLLING, *SMALL, "--json", "--at-least", "0.5"]
    (code, there, _), (other, here, _) = (stltool(*given, *more) for more in (["--cluster", address], []))
    there, here = json.loads(there), json.loads(here)
    assert there.pop("engine") == "cluster"
    assert here.pop("engine") != "cluster"
    assert code == other == 0
    assert {**there, "seconds": 0} == {**here, "seconds": 0}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--exact"], "--exact does not run on a cluster; leave --cluster out"),
        (["--model", str(FACTORY / "floor-5x5-uncertain.toml")], "add --nominal"),
        (["--save-policy", "best.policy", "--resume"], "--resume does not run on a cluster"),
    ],
)
def test_what_it_does_not_do(more, message, address, stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = stltool("check", PATROLLING, *SMALL, "--cluster", address, *more)
    assert code == 2
    assert message in err
