"""`stltool check` on models with intervals."""

import json
from fractions import Fraction

import pytest

import stltool as stl
from tests.conftest import FACTORY

UNCERTAIN = str(FACTORY / "uncertain.stl")
SMALL = ["-p", "T=5", "-p", "tau=5"]


@pytest.fixture
def product():
    task = stl.load_task(UNCERTAIN, params={"T": 5, "tau": 5})
    return stl.build_product(stl.load_model(task.model), task)


@pytest.mark.parametrize("minimize", [False, True])
@pytest.mark.parametrize("nature", [None, "against", "with"])
def test_check_asks_nature(stltool, product, nature, minimize):
    options = [*(["--nature", nature] if nature else []), *(["--minimize"] if minimize else [])]
    code, out, err = stltool("check", UNCERTAIN, *SMALL, *options, "--json")
    data = json.loads(out)
    expected = stl.robust_check(product, maximize=not minimize, nature=nature or "against")
    assert (code, err, data["nature"]) == (0, "", nature or "against")
    assert [data[key] for key in ("probability", "lower", "upper")] == [
        expected.probability, expected.lower, expected.upper,
    ]  # fmt: skip
    _, out, _ = stltool("check", UNCERTAIN, *SMALL, *options)
    assert f"nature  {nature or 'against'}: at every step" in out
    told = "cooperative" if nature == "with" else "adversarial"
    assert f"{'minimum' if minimize else 'maximum'} over all policies, {told} nature" in out


def test_the_nominal_model_is_checked_when_asked(stltool, product):
    code, out, _ = stltool("check", UNCERTAIN, *SMALL, "--nature", "nominal", "--json")
    data = json.loads(out)
    nominal = stl.build_product(product.model.nominal(), product.formula)
    assert (code, data["nature"], data["probability"]) == (0, "nominal", stl.check(nominal).probability)
    assert (
        "nominal: a fixed probability inside every interval"
        in stltool("check", UNCERTAIN, *SMALL, "--nature", "nominal")[1]
    )


def test_policies_are_saved_and_judged_by_every_nature(stltool, product, tmp_path):
    values = {}
    for made in ("against", "nominal"):
        path = tmp_path / f"{made}.npz"
        assert stltool("check", UNCERTAIN, *SMALL, "--nature", made, "--save-policy", path)[0] == 0
        for nature in ("against", "with", "nominal"):
            _, out, _ = stltool("check", UNCERTAIN, *SMALL, "--nature", nature, "--policy", path, "--json")
            data = json.loads(out)
            assert (data["question"], data["nature"]) == ("policy", nature)
            values[made, nature] = data["probability"]
            assert data["gap"] == pytest.approx(data["optimum"] - data["probability"], abs=1e-15)
    assert values["against", "against"] == stl.robust_check(product).probability
    assert values["nominal", "against"] <= values["against", "against"] < values["against", "nominal"]
    assert values["against", "nominal"] <= values["nominal", "nominal"] < values["nominal", "with"]
    # asked for the least probability, nature against a policy makes it large
    _, out, _ = stltool("check", UNCERTAIN, *SMALL, "--minimize", "--policy", tmp_path / "against.npz", "--json")
    assert json.loads(out)["probability"] == values["against", "with"]


def test_at_least_holds_whatever_nature_does(stltool, product):
    guaranteed, hoped = (stl.robust_check(product, nature=nature).probability for nature in ("against", "with"))
    between = (guaranteed + hoped) / 2
    for nature, code, says in (("against", 1, "does not hold"), ("with", 0, "holds")):
        ended, out, _ = stltool("check", UNCERTAIN, *SMALL, "--nature", nature, "--at-least", between)
        assert (ended, out.rstrip().endswith(says)) == (code, True)


def test_bad_natures_and_wrong_commands_end_with_a_message(stltool, tmp_path):
    for arguments, says in (
        (["check", UNCERTAIN, "--nature", "kind"], "--nature kind: choose against, with, nominal"),
        (["check", FACTORY / "patrolling.stl", "--nature", "with"], "not intervals; leave out --nature"),
        (
            ["learn", UNCERTAIN, "--out", tmp_path / "p.npz"],
            "probabilities are intervals; use stltool check, or the ordinary model inside them (--nominal)",
        ),
        (
            ["run", UNCERTAIN, "--out", tmp_path / "run"],
            "probabilities are intervals; use stltool check, or the ordinary model inside them (--nominal)",
        ),
    ):
        code, out, err = stltool(*arguments)
        assert (code, out) == (2, "")
        assert says in err
    assert list(tmp_path.iterdir()) == []


def test_a_report_tells_the_nature(product, tmp_path):
    results = [stl.robust_check(product, nature=nature) for nature in ("against", "with")]
    mine = stl.robust_check(product, results[0].policy, nature="with")
    stl.report([*results, mine], None, tmp_path / "robust.html")
    page = (tmp_path / "robust.html").read_text()
    assert "maximum over all policies, adversarial nature" in page
    assert "the policy&#39;s value, cooperative nature" in page
    data = json.loads((tmp_path / "robust.json").read_text())
    assert [check["nature"] for check in data["checks"]] == ["against", "with", "with"]
    assert data["checks"][0]["gap"] == data["checks"][1]["gap"] == 0
    assert data["checks"][2]["gap"] == pytest.approx(results[1].probability - mine.probability)
    assert data["run"] is None


def test_certificates_of_intervals_and_of_nominal_probabilities(stltool, tmp_path):
    path = tmp_path / "proof.jsonl"
    for options, says in (
        ([], "the maximum over all policies, where nature's choice in the intervals makes P least"),
        (["--nature", "with"], "makes P greatest"), (["--minimize"], "the minimum over all policies, where nature's"),
    ):  # fmt: skip
        code, out, _ = stltool("check", UNCERTAIN, *SMALL, *options, "--certificate", path)
        assert (code, "proof.jsonl proves " in out) == (0, True)
        code, out, _ = stltool("certify", path, UNCERTAIN, *SMALL)
        assert (code, says in out, "nominal" in out) == (0, True, False)
        assert "are intervals, each with probabilities that sum to 1 exactly" in out
    data = json.loads(stltool("certify", path, UNCERTAIN, *SMALL, "--json")[1])
    assert (data["claim"], data["nature"], data["nominal"]) == ("minimum", "greatest", False)
    point = ["--model", str(FACTORY / "floor-5x5.toml")]
    code, _, err = stltool("certify", path, UNCERTAIN, *SMALL, *point)
    assert (code, "is for a model with intervals, unlike" in err) == (2, True)
    assert stltool("check", UNCERTAIN, *SMALL, "--nature", "nominal", "--certificate", path)[0] == 0
    code, out, _ = stltool("certify", path, UNCERTAIN, *SMALL)
    assert (code, "with its nominal probabilities; nothing is proved about its intervals" in out) == (0, True)
    assert json.loads(stltool("certify", path, UNCERTAIN, *SMALL, "--json")[1])["nominal"] is True
    code, out, _ = stltool("check", UNCERTAIN, *SMALL, "--nature", "nominal", "--exact")
    assert (code, "exact P  " in out) == (0, True)


def test_the_nominal_model_on_the_ordinary_road(stltool, tmp_path):
    """Learned on the nominal probabilities, judged against nature; nothing takes them unasked."""
    policy = tmp_path / "p.npz"
    code, _, err = stltool("learn", UNCERTAIN, *SMALL, "--out", policy, "--episodes", "5")
    assert (code, "--nominal" in err) == (2, True)
    assert stltool("learn", UNCERTAIN, *SMALL, "--out", policy, "--episodes", "5", "--nominal")[0] == 0
    code, out, _ = stltool("check", UNCERTAIN, *SMALL, "--policy", policy)
    assert (code, "the policy, adversarial nature" in out) == (0, True)
    for command in ("why", "estimate"):
        assert stltool(command, UNCERTAIN, *SMALL, "--nominal")[0] == 0
    same = [stltool("check", UNCERTAIN, *SMALL, *how)[1] for how in (["--nominal"], ["--nature", "nominal"])]
    assert same[0] == same[1] != stltool("check", UNCERTAIN, *SMALL)[1]
    code, _, err = stltool("check", UNCERTAIN, *SMALL, "--nominal", "--nature", "with")
    assert (code, "leave out --nature with or --nominal" in err) == (2, True)
    code, _, err = stltool("why", FACTORY / "patrolling.stl", "--nominal")
    assert (code, "the model's probabilities are not intervals" in err) == (2, True)


def test_a_bound_inside_the_enclosure_is_decided_exactly(stltool, product):
    value = stl.robust_check(product).probability
    code, out, _ = stltool("check", UNCERTAIN, *SMALL, "--at-least", repr(value))
    assert (code, out.rstrip().endswith("undecided: the bound lies inside the enclosure; add --exact")) == (1, True)
    exact = stl.robust_check(product, exact=True).fraction
    for bound, code in ((exact, 0), (exact + Fraction(1, 10**40), 1)):
        found, out, _ = stltool("check", UNCERTAIN, *SMALL, "--at-least", str(bound), "--exact")
        assert (found, str(exact) in out) == (code, True)
