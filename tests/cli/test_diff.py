"""`stltool diff`: what changed between two results, whatever their order, and whether for the worse."""

import copy
import json

import numpy as np
import pytest

import stltool as stl
from stltool.checking.evidence import evidence_of
from stltool.reporting import report_data, verification_data
from stltool.reporting.differences import differences, summarised
from tests.conftest import FACTORY


@pytest.fixture(scope="module")
def report():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(task.model), task)
    run = stl.learn(product, "model-based", episodes=60, seed=0)
    bounds = [stl.guarantee(product, run.policy, run.counts, support=support) for support in ("unknown", "known")]
    checks = [stl.check(product), stl.check(product, run.policy)]
    evidence = evidence_of(product, run.policy, 0)
    return json.loads(json.dumps(report_data(checks, run, guarantees=bounds, evidence=evidence)))


@pytest.fixture
def two(report, stltool, tmp_path):
    """Run diff on the report and a changed copy: (exit code, stdout, stderr)."""

    def run(change, *options):
        other = copy.deepcopy(report)
        change(other)
        for name, data in (("a", report), ("b", other)):
            (tmp_path / f"{name}.json").write_text(json.dumps(data))
        return stltool("diff", tmp_path / "a.json", tmp_path / "b.json", *options)

    return run


def test_times_and_order_are_no_difference(two):
    def change(data):
        data["training"]["seconds"] += 3
        data["command"] = "stltool check"
        data["checks"].reverse()
        data["guarantees"].reverse()
        for check in data["checks"]:
            check["seconds"] = 0.0

    code, text, _ = two(change)
    assert (code, text) == (0, "same  all but times; numbers up to 1e-09\n")


def test_a_smaller_probability_is_worse(two, report):
    def change(data):
        data["checks"][1]["probability"] -= 1e-3

    code, text, _ = two(change)
    assert code == 1
    assert "policy].probability" in text
    assert "-0.001 worse" in text
    assert text.endswith("differs  in 1 place, of which 1 for the worse\n")
    assert two(change, "--tolerance", "0.01")[0] == 0
    found = json.loads(two(change, "--json")[1])
    assert found["worse"] == 1
    assert [one["before"] for one in found["differences"]] == [report["checks"][1]["probability"]]


@pytest.mark.parametrize(
    ("change", "bad"),
    [
        (lambda data: data["checks"][1].update(probability=1.0), False),
        (lambda data: data["guarantees"][0].update(lower=0.0), True),
        (lambda data: data["guarantees"][0].update(lower=1.0), False),
        (lambda data: data["guarantees"].pop(1), True),
        (lambda data: data["guarantees"].append({**data["guarantees"][1], "source": "fresh runs"}), False),
        (lambda data: data.update(formula="true"), False),
    ],
)
def test_only_what_is_worse_fails_if_only_that_is_asked(two, change, bad):
    assert two(change)[0] == 1
    assert two(change, "--worse")[0] == bad


def test_bounds_that_no_longer_hold_and_gaps_that_grow_are_worse():
    before = {"asked": {"holds": True}, "gap": {"upper": 0.01, "without_data": 0.1}}
    after = {"asked": {"holds": None}, "gap": {"upper": 0.02, "without_data": 0.1}}
    found = differences(before, after)
    assert [(one.what, one.worse) for one in found] == [("asked.holds", True), ("gap.upper", True)]
    assert not any(one.worse for one in differences(after, before))


def test_expectations_are_matched_by_their_text(tmp_path):
    """Whatever line they are on; one that no longer holds, or is gone, is worse."""

    def verified(*lines):
        (tmp_path / "coin.toml").write_text('kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = 0.5\n')
        path = tmp_path / "task.stl"
        path.write_text("\n".join(['model "coin.toml"', "param p = 0.5", "reach := F[0,1] A", *lines, ""]))
        return json.loads(json.dumps(verification_data(stl.verify(path))))

    first, second = "expect Pmax(reach) >= p", "expect Pmin(reach) <= 0"
    before = verified(first, second, "expect Pmax(reach) > 0")
    assert differences(before, verified(second, "", first, "expect Pmax(reach) > 0")) == []
    after = copy.deepcopy(verified(second, first))
    after["expectations"][1]["verdict"] = "undecided"
    found = {one.what: one.worse for one in differences(before, after)}
    gone, changed = (f"expectations[{tmp_path / 'task.stl'}, expect {text}]" for text in ("Pmax(reach) > 0", first[7:]))
    assert found[gone]
    assert found[f"{changed}.verdict"]
    assert not any(one.worse for one in differences(after, before) if one.what.startswith("expectations"))


def test_parts_that_differ_in_many_places_are_summed_up(two, report):
    def change(data):
        for i, step in enumerate(data["run"]["steps"]):
            step["action"], step["state"] = f"a{i}", f"s{i}"

    text = two(change)[1]
    assert "places; --all shows them" in text
    assert len(text.splitlines()) == 3
    assert len(two(change, "--all")[1].splitlines()) > 12
    long = {"history": list(range(1000))}
    (one,) = differences(long, {"history": [*range(999), 7]})
    assert (one.before, one.after) == ("1000 entries, [999] = 999", "1000 entries, [999] = 7")
    (one,) = differences(long, {"history": list(range(1001))})
    assert (one.before, one.after) == ("1000 entries", "1001 entries, [1000] = 1000")
    assert summarised([one]) == [one]


def test_changed_leaves_are_found_wherever_they_are(report):
    """Any number of the report, changed alone, is found; unless it is a time."""

    def leaves(data, path):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            if isinstance(value, dict | list):
                yield from leaves(value, (*path, key))
            elif isinstance(value, int | float) and not isinstance(value, bool) and key not in ("seconds", "time"):
                yield (*path, key)

    places = list(leaves(report, ()))
    rng = np.random.default_rng(0)
    for i in rng.choice(len(places), size=min(40, len(places)), replace=False).tolist():
        other = copy.deepcopy(report)
        *path, last = places[i]
        record = other
        for key in path:
            record = record[key]
        record[last] += 1
        assert differences(report, other), places[i]
    assert not differences(report, copy.deepcopy(report))


def test_what_cannot_be_compared_is_refused(stltool, tmp_path, report):
    (tmp_path / "a.json").write_text(json.dumps(report))
    (tmp_path / "b.json").write_text('{"format": "stltool-sweep-1"}')
    (tmp_path / "c.json").write_text("[1]")
    for other, says in (
        ("b.json", "compare two of the same kind"),
        ("c.json", "not the JSON file of a report"),
        ("d.json", "there is no such report"),
    ):
        code, out, err = stltool("diff", tmp_path / "a.json", tmp_path / other)
        assert (code, out) == (2, "")
        assert says in err
    code, _, err = stltool("diff", tmp_path / "a.json", tmp_path / "a.json", "--tolerance", "-1")
    assert code == 2
    assert "--tolerance -1: give a number from 0" in err
