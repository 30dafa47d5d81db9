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


ORDER = ["holds", "undecided", "does not hold", "error"]


@pytest.mark.parametrize("before", ORDER)
@pytest.mark.parametrize("after", ORDER)
def test_every_change_of_a_verdict(stltool, tmp_path, before, after):
    """Down the order is worse, up is not: of the gate, of a sequential test, of a bound in a report."""
    for name, verdict in (("a", before), ("b", after)):
        row = {"file": "t.stl", "line": 4, "text": "expect Pmax(r) >= 0.5", "verdict": verdict, "relation": ">="}
        data = {"format": "stltool-verify-1", "version": "0", "command": None, "files": ["t.stl"], "seconds": 1.0,
                "holds": True, "counts": {}, "expectations": [row]}  # fmt: skip
        (tmp_path / f"{name}.json").write_text(json.dumps(data))
    code, out, _ = stltool("diff", tmp_path / "a.json", tmp_path / "b.json", "--worse")
    worse = ORDER.index(after) > ORDER.index(before)
    assert (code, "worse" in out.partition("differs")[0]) == (int(worse), worse)
    holds = {"holds": True, "undecided": None, "does not hold": False}
    if before in holds and after in holds:
        for one, other in (
            ({"verdict": before}, {"verdict": after}),
            ({"holds": holds[before]}, {"holds": holds[after]}),
        ):
            assert [found.worse for found in differences(one, other)] == [worse] * (before != after)
    assert not any(found.worse for found in differences({}, {"verdict": after}))  # it was not asked before
    assert [found.worse for found in differences({"verdict": before}, {})] == [before == "holds"]


def test_bounds_that_no_longer_hold_and_gaps_that_grow_are_worse():
    before = {"holds": True, "training": {"gap": {"upper": 0.01, "without_data": 0.1}}, "gap": 0.0}
    after = {"holds": None, "training": {"gap": {"upper": 0.02, "without_data": 0.1}}, "gap": 0.1}
    found = differences(before, after)
    assert [(one.what, one.worse) for one in found] == [("holds", True), ("training.gap.upper", True), ("gap", True)]
    assert not any(one.worse for one in differences(after, before))
    assert [one.worse for one in differences(before, {**before, "training": {}})] == [True]


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


WARD = """kind = "grid"
map = '''
PP..X
.#..W
S..#W
'''
cell = 1
moves = "cross"
success = "%s"
slip = "%s"
"""


@pytest.mark.parametrize(
    ("command", "options", "lines", "worse"),
    [
        ("verify", (), ["expect Pmin(danger) <= 0.5", "expect Pmax(danger) <= 0.999"], "to fewer slips"),
        ("verify", (), ["expect Pmax(danger) < 0.999"], "to fewer slips"),
        ("verify", (), ["expect Pmax(danger) >= 0.1"], "from fewer slips"),
        ("check", (), [], "from fewer slips"),
        ("check", ("--at-least", "0.1"), [], "from fewer slips"),
        ("check", ("--at-most", "0.999"), [], "to fewer slips"),
        ("check", ("--at-most", "0.999", "--at-least", "0.1"), [], "neither"),
        ("check", ("--minimize",), [], "from fewer slips"),  # the least P of safe is larger with more slips
    ],
)
def test_the_bound_asked_for_says_which_probability_is_worse(stltool, tmp_path, command, options, lines, worse):
    """In the report, its folder, and what is printed; the ward with fewer slips has the larger P of danger."""
    task = "danger := F[0,9] X" if "--minimize" not in options else "safe := G[0,9] !X"
    (tmp_path / "t.stl").write_text("\n".join(['model "ward.toml"', task, *lines, ""]))
    for name, chances in (("less", ("8/10", "1/15")), ("more", ("9/10", "1/30"))):
        (tmp_path / "ward.toml").write_text(WARD % chances)
        code, out, err = stltool(command, tmp_path / "t.stl", *options, "--report", tmp_path / name, "--json")
        assert code == 0, err
        (tmp_path / f"{name}.json").write_text(out)

    def worse_from(before, after, ending):
        files = (tmp_path / f"{before}{ending}", tmp_path / f"{after}{ending}")
        found = json.loads(stltool("diff", *files, "--json")[1])
        assert stltool("diff", *files, "--worse")[0] == bool(found["worse"])
        return found["worse"]

    for ending in ("", "/report.json", ".json"):
        found = worse_from("less", "more", ending), worse_from("more", "less", ending)
        assert found == (int(worse == "to fewer slips"), int(worse == "from fewer slips"))


def test_a_policy_next_to_a_minimum_and_a_bound_from_above_are_judged_alike():
    policy = {"question": "policy", "optimum_upper": 0.1, "lower": 0.2, "probability": 0.2}
    minimum = {"question": "minimum", "probability": 0.1}
    for checks in ([policy], [minimum, policy]):
        more = [checks[0], {**policy, "probability": 0.3}][-len(checks) :]
        assert [one.worse for one in differences({"checks": checks}, {"checks": more})] == [True]
        assert not any(one.worse for one in differences({"checks": more}, {"checks": checks}))
    upper = {"confidence": 0.9, "side": "upper", "upper": 0.5, "lower": 0.0}
    assert [one.worse for one in differences(upper, {**upper, "upper": 0.6})] == [True]
    assert [one.worse for one in differences(upper, {**upper, "upper": 0.4})] == [False]


def test_a_report_shows_each_change_once(report):
    """The page's explorer repeats the policy and the run, each check the task and the sizes."""
    other = copy.deepcopy(report)
    other["explorer"]["claim"] = None
    for record in (other, *other["checks"]):
        record["model_digest"] = "0"
    assert [one.what for one in differences(report, other)] == ["model_digest"]


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
    """Any number of the report, changed alone, is found; unless it is a time, or in what a page's explorer repeats."""

    def leaves(data, path):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            if key != "explorer" and isinstance(value, dict | list):
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
    (tmp_path / "c.json").write_text("[1]")
    (tmp_path / "e.json").write_text("{}")
    (tmp_path / "f.json").write_text('{"format": "stltool-sweep-1"}')
    (tmp_path / "g.json").write_text('{"format": "stltool-policy-2", "formula": "true"}')
    (tmp_path / "folder").mkdir()
    (tmp_path / "t.stl").write_text('model "ward.toml"\ndanger := F[0,9] X\n')
    (tmp_path / "ward.toml").write_text(WARD % ("9/10", "1/30"))
    for name, command in (("check", ["check"]), ("estimate", ["estimate", "--runs", 10])):
        (tmp_path / f"{name}.json").write_text(stltool(*command, tmp_path / "t.stl", "--json")[1])
    (tmp_path / "doctor.json").write_text(
        json.dumps(dict.fromkeys(["version", "python", "system", "extras", "faults"]))
    )
    for other, says in (
        ("check.json", "the first file is stltool-report-1, the second the output of check --json; compare two of the"),
        ("c.json", "not the JSON file of a report"),
        ("d.json", "there is no such report"),
        ("e.json", "no result that can be compared: an object with no fields; give a report.json, or what one of"),
        ("f.json", "no result that can be compared: an object with format; give"),
        ("g.json", "no result that can be compared: an object with format, formula; give"),
        ("doctor.json", "an object with version, python, system, extras and 1 more; give"),
        ("folder", "folder/report.json: there is no such report"),
    ):
        code, out, err = stltool("diff", tmp_path / "a.json", tmp_path / other)
        assert (code, out) == (2, "")
        assert says in err
    assert stltool("diff", tmp_path / "e.json", tmp_path / "e.json")[:2] == (2, "")
    code, _, err = stltool("diff", tmp_path / "check.json", tmp_path / "estimate.json")
    assert code == 2
    assert "is the output of check --json, the second the output of estimate --json" in err
    for name in ("check", "estimate"):
        assert stltool("diff", tmp_path / f"{name}.json", tmp_path / f"{name}.json")[0] == 0
    code, _, err = stltool("diff", tmp_path / "a.json", tmp_path / "a.json", "--tolerance", "-1")
    assert code == 2
    assert "--tolerance -1: give a number from 0" in err
