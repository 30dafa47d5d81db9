"""`stltool check --vary`, and values of a model's parameters by -p."""

import json
import math
import re
from fractions import Fraction

import pytest

import stltool as stl
from tests.conftest import FACTORY

FLOOR, TASK = str(FACTORY / "floor-5x5-p.toml"), str(FACTORY / "patrolling.stl")
SMALL = ["-p", "T=5", "-p", "tau=5"]


def product_at(p):
    task = stl.load_task(TASK, params={"T": 5, "tau": 5})
    return stl.build_product(stl.load_model(FLOOR).at(p=p), task)


def test_p_gives_a_parameter_of_the_model_its_value(stltool):
    code, out, err = stltool("check", TASK, *SMALL, "-p", "p=93/100", "--model", FLOOR, "--exact")
    assert (code, err) == (0, "")
    assert "exact P  73794757279959/100000000000000" in out
    code, out, err = stltool("check", TASK, *SMALL, "-p", "success=93/100", "--exact")  # any grid has it
    assert "exact P  73794757279959/100000000000000" in out
    code, out, err = stltool("pareto", FACTORY / "tradeoff.stl", "--tasks", "charging,patrolling", "-p", "success=1",
                             "--points", "2", "--json")  # fmt: skip
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["-p", "p=0.3"], "p = 0.3 lies outside its domain [0.5, 1]"),
        (["-p", "q=0.3"], "there is no param q to override"),
        (["-p", "zzz=0.3", "-p", "p=0.6"], "there is no param zzz to override; known names: T, p, tau"),
        (["-p", "q=0.3", "-p", "p=0.6"], "there is no param q to override"),
        (["-p", "p=0.7", "--vary", "p=0.6:0.8"], "-p p and --vary p both give p its values; leave one of them out"),
        (["--exact"], "the probabilities of floor-5x5-p depend on p, without a value"),
        (["--vary", "p"], "--vary p: write a parameter and its range, for example --vary p=0.5:1"),
        (["--vary", "p=0.5:x"], "--vary p=0.5:x: 'x' is not a number"),
        (["--vary", "q=0.5:1"], "the model has no parameter q; known names: p"),
        (["--vary", "p=0:1"], "p = 0 lies outside its domain [0.5, 1]"),
        (["--vary", "p=1:0.5"], "the lower end of a range comes first"),
        (["--vary", "p=0.5:1", "--exact", "--nature", "with"], "--nature is for one value of the parameter"),
        (["--vary", "p=0.5:1", "--save-policy", "p.npz"], "--save-policy is for one value of the parameter"),
    ],
)
def test_bad_ranges_end_with_a_message(stltool, options, says):
    code, out, err = stltool("check", TASK, *SMALL, "--model", FLOOR, *options)
    assert (code, out) == (2, "")
    assert says in err
    assert len(err.splitlines()) == 1


def test_a_range_is_enclosed(stltool, tmp_path):
    best = stl.check(product_at("0.93"))
    best.policy.save(tmp_path / "best.npz")
    asked = ["check", TASK, *SMALL, "--model", FLOOR, "--vary", "p=0.9:1"]
    code, out, err = stltool(*asked, "--json", "--at-least", "0.5", "--at-most", "0.99")
    data = json.loads(out)
    assert (code, err, data["holds"], data["decided"]) == (1, "", False, True)
    (piece,) = data["pieces"]
    assert len(piece["lower"]) == len(piece["upper"]) == data["horizon"] + 1
    for point in data["points"]:
        exact = stl.check(product_at(str(point["value"])))
        assert point["lower"] <= exact.lower <= exact.upper <= point["upper"]
    code, out, _ = stltool(*asked, "--at-least", "0.5")
    assert code == 0
    assert "P     maximum over all policies, for every p in [0.9, 1]" in out
    assert "P >= 0.5 everywhere  holds" in out
    policy = ["-p", "p=0.93", "--policy", tmp_path / "best.npz"]  # which is bound to the model that it was made for
    code, out, _ = stltool(*asked, *policy, "--json")
    (own,) = json.loads(out)["pieces"]
    assert code == 0
    assert all(a <= b for a, b in zip(own["lower"], piece["upper"], strict=True))
    code, out, _ = stltool(*asked, *policy)
    assert "P     the policy, for every p in [0.9, 1]" in out


def test_without_a_value_the_check_is_robust_in_the_parameter(stltool):
    code, out, err = stltool("check", TASK, *SMALL, "--model", FLOOR)
    assert (code, err) == (0, "")
    assert "nature  against: at every step, adversarial nature picks p in [0.5, 1]" in out
    code, out, err = stltool("learn", TASK, *SMALL, "--model", FLOOR, "--out", "never.npz")
    assert code == 2
    assert "depend on p, without a value; give one (-p p=…" in err


def test_polynomials_without_rounding(stltool, tmp_path):
    best = stl.check(product_at("0.93"))
    best.policy.save(tmp_path / "best.npz")
    asked = ["check", TASK, *SMALL, "--model", FLOOR, "--vary", "p=9/10:1", "--exact"]
    exactly = stl.check(product_at("0.93"), exact=True).fraction
    for own in ([], ["-p", "p=0.93", "--policy", tmp_path / "best.npz"]):
        code, out, err = stltool(*asked, *own)
        assert (code, err) == (0, "")
        assert ("one policy optimal  proved on 1 of these, in fractions" in out) == (not own)
        text = next(line.removeprefix("exact P").strip() for line in out.splitlines() if line.startswith("exact P"))
        assert polynomial(text, Fraction("0.93")) == exactly
        assert "exact P" not in stltool(*asked[:-1], *own)[1]
        code, out, err = stltool(*asked, *own, "--json", "--at-most", "1")
        data = json.loads(out)
        assert (code, err, data["holds"], data["decided"]) == (0, "", True, True)
        (piece,) = data["pieces"]
        assert (piece["proved"], piece["range"]) == (not own, ["9/10", "1"])
        assert sum(Fraction(a) * Fraction("0.93") ** k for k, a in enumerate(piece["powers"])) == exactly
        assert data["points"][3]["fraction"] == str(exactly)
    code, out, err = stltool(*asked, "--report", tmp_path / "out")
    assert (code, err) == (0, "")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "On 1 of 1 pieces one policy is optimal throughout, which is proved in fractions." in page
    code, out, err = stltool("check", TASK, "--model", FLOOR, "--vary", "p=0.9:0.90001", "--exact")
    assert (code, err) == (0, "")
    assert "exact P             of degree 18, " in out
    assert "characters long; --json prints its coefficients" in out


def polynomial(text, p):
    """The value at p of a polynomial as printed, such as 3*p^2 - p + 1/2."""
    total = Fraction(0)
    for sign, term in re.findall(r"(^-?|[+-] )(\S+)", text):
        factors = [p ** int(factor[2:] or 1) if factor[0] == "p" else Fraction(factor)
                   for factor in term.split("*")]  # fmt: skip
        total += (-1 if "-" in sign else 1) * math.prod(factors)
    return total
