"""Parameters of models: expressions, grids, arrays and functions, against members written out."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import ModelError, SettingsError
from stltool.models.parameters import read_affine, read_parameters
from tests.conftest import FACTORY

DECLARED = read_parameters({"p": ("1/2", 1), "q_2": (0, 1)})
P, Q = Fraction(3, 4), Fraction(1, 7)
FLOOR = (FACTORY / "floor-5x5.toml").read_text()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("p", P), ("1", Fraction(1)), ("(1-p)/3", (1 - P) / 3), ("-p + 1", 1 - P), ("2*p - p*2 + 1/3", Fraction(1, 3)),
        ("1 - p/2 - q_2*0.5", 1 - P / 2 - Q / 2), ("3*(p+(q_2-1))/(2*2)", 3 * (P + Q - 1) / 4), ("1e-3*p", P / 1000),
        ("+.5", Fraction(1, 2)), ("--p", P), ("7/300", Fraction(7, 300)), (" p ", P), (0.1, Fraction(1, 10)),
    ],
)  # fmt: skip
def test_expressions_mean_what_they_say(text, value):
    assert read_affine(text, DECLARED).at({"p": P, "q_2": Q}) == value


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("p*p", "multiplies parameters"), ("(p-p)*q_2 + q_2*p", "multiplies parameters"), ("1/p", "divides by a param"),
        ("p/0", "divides by zero"), ("r", "no parameter r; known names: p, q_2"), ("2p", r"write \* between factors"),
        ("(1-p", "not closed"), ("1-p)", "never opened"), ("", "ends too early"), ("p^2", r"'\^' has no meaning"),
        ("1 -", "ends too early"), ("p p", "write \\* between"), ("1e9999*p", "out of range"), (True, "not a number"),
        ("__import__('os')", r"unexpected '\('"), ("p; q_2", "';' has no meaning"),
        ("(" * 60 + "p" + ")" * 60, "too long"), ("*p", "operand is missing"),
    ],
)  # fmt: skip
def test_other_texts_are_refused(text, fault):
    with pytest.raises(ModelError, match=fault):
        read_affine(text, DECLARED)


def grid(tmp_path, success='"p"', slip='slip = "(1-p)/3"', parameters="[parameters]\np = [0.5, 1]"):
    lines = [line for line in FLOOR.splitlines() if not line.startswith(("success", "slip"))]
    path = tmp_path / "floor.toml"
    path.write_text("\n".join([*lines, f"success = {success}", slip, parameters]))
    return path


@pytest.mark.parametrize("p", ["1/2", "2/3", "93/100", 1])
def test_a_grid_with_a_parameter_is_the_grid_with_its_value(tmp_path, p):
    written = tmp_path / "written.toml"
    noise = Fraction(p), (1 - Fraction(p)) / 3
    written.write_text(FLOOR.replace('"93/100"', f'"{noise[0]}"').replace('"7/300"', f'"{noise[1]}"'))
    expected = stl.load_model(written)
    for slip in ('slip = "(1-p)/3"', ""):
        family = stl.load_model(grid(tmp_path, slip=slip))
        assert [(one.name, one.lower, one.upper) for one in family.parameters] == [("p", Fraction(1, 2), 1)]
        member = family.at(p=p)
        assert replace(member, name=expected.name).digest() == expected.digest()
        assert np.array_equal(member.rows.numerator * expected.rows.denominator,
                              expected.rows.numerator * member.rows.denominator)  # fmt: skip
        assert member.family.parameters == family.parameters
        inner = family.within(p=(p, 1))
        assert inner.at(p=p).digest() == member.digest()
        if p != 1:  # where slips are never possible
            assert np.array_equal(family.rows.tied_at({"p": Fraction(p)}), inner.rows.tied_at({"p": Fraction(p)}))


def test_every_exact_grid_is_of_the_family_of_its_success_probability(tmp_path):
    plain = stl.load_model(FACTORY / "floor-5x5.toml")
    assert not plain.parameters
    assert plain.family.parameters[0].domain == "[0, 1]"
    assert plain.at(success="93/100").digest() == plain.digest()
    with_p = stl.load_model(grid(tmp_path)).at(p="2/3")
    assert np.array_equal(plain.at(success="2/3").probability, with_p.probability)
    assert stl.load_model(FACTORY / "floor-5x5-uncertain.toml").family is None


def test_a_value_in_the_file_is_used(tmp_path):
    model = stl.load_model(grid(tmp_path, parameters="[parameters]\np = { domain = [0.5, 1], value = 0.93 }"))
    assert not model.parameters
    assert model.digest() == stl.load_model(FACTORY / "floor-5x5.toml").digest()
    assert model.at(p=1).n_transitions < model.n_transitions


def test_a_parameter_without_a_value_is_not_a_model_to_check(tmp_path):
    model = stl.load_model(grid(tmp_path))
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    for ask in (stl.check, stl.learn, stl.sensitivity):
        with pytest.raises(SettingsError, match="depend on p, without a value"):
            ask(product)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"success": '"q"'}, "line 12: success: 'q': there is no parameter q"),
        ({"slip": 'slip = "(1-p)/4"'}, "must sum to 1 for every value of p"),
        ({"success": '"0.9"', "slip": ""}, "parameter p does not occur in success or slip"),
        ({"success": "[0.9, 0.95]"}, "success is an interval"),
        ({"parameters": "[parameters]\np = [0.5, 1.1]"}, "success is 1.1 where p is 1.1"),
        ({"parameters": ""}, r"declare it at the end of the model file:\n  \[parameters\]\n  p = \[0.5, 1\]"),
        ({"parameters": "[parameters]\np = 0.5"}, "line 15: parameter p is 0.5; write its domain"),
        ({"parameters": "[parameters]\np = [1, 0.5]"}, "the lower end comes first"),
        ({"parameters": "[parameters]\np = { domain = [0.5, 1], value = 0.3 }"}, "p = 0.3 lies outside its domain"),
        ({"parameters": "parameters = 3"}, "parameters is 3"),
    ],
)  # fmt: skip
def test_faults_of_a_grid_are_reported_with_their_line(tmp_path, changes, fault):
    with pytest.raises(ModelError, match=fault):
        stl.load_model(grid(tmp_path, **changes))


ROWS = [[["p", "1-p", 0], [0, 1, 0], ["1/3", "(1-q)/3", "(1+q)/3"]], [[0, 0, 1], ["q", 0, "1-q"], [0.25, 0.75, 0]]]
LABELS = {"A": [0, 0, 1]}


def written_out(p, q):
    return stl.MDP.from_arrays(
        [[[p, 1 - p, 0], [0, 1, 0], [Fraction(1, 3), (1 - q) / 3, (1 + q) / 3]],
         [[0, 0, 1], [q, 0, 1 - q], [Fraction(1, 4), Fraction(3, 4), 0]]], {}, labels=LABELS,
    )  # fmt: skip


@pytest.mark.parametrize("make", [
    lambda domains: stl.MDP.from_arrays(ROWS, {}, labels=LABELS, parameters=domains),
    lambda domains: stl.MDP.from_family(written_out, domains),
])  # fmt: skip
def test_arrays_and_functions_give_the_members_written_out(make):
    family = make({"p": (0, 1), "q": ("1/4", 1)})
    for p, q in ((0, 1), (1, Fraction(1, 4)), (Fraction(1, 3), Fraction(2, 5))):
        member, expected = family.at(p=p, q=q), written_out(Fraction(p), Fraction(q))
        assert member.digest() == expected.digest()
        assert member.exact().numerator.tolist() == [
            n * member.exact().denominator // expected.exact().denominator for n in expected.exact().numerator.tolist()
        ]
    named = make({"p": {"domain": (0, 1), "value": 0}, "q": {"domain": ("1/4", 1), "value": 1}})
    assert named.digest() == written_out(Fraction(0), Fraction(1)).digest()


def test_faults_of_families_name_the_row():
    with pytest.raises(ModelError, match=r"action 0, entry \[0, 1\]: 'p\*p' multiplies"):
        stl.MDP.from_arrays([[["p", "p*p"], [0, 1]]], {}, parameters={"p": (0, 1)})
    with pytest.raises(ModelError, match="at p = 1: state 0, action 0: the probabilities sum to 2, not 1"):
        stl.MDP.from_arrays([[["p", "1"], [0, 1]]], {}, parameters={"p": (0, 1)})
    with pytest.raises(ModelError, match="state 0, action 0: the row depends on p and q"):
        stl.MDP.from_arrays(
            [[["p", "q", "1-p-q"], [0, 1, 0], [0, 0, 1]]], {}, parameters={"p": (0, ".5"), "q": (0, ".5")}
        )
    with pytest.raises(ModelError, match="to state 0 is not linear in p"):
        stl.MDP.from_family(lambda p: stl.MDP.from_arrays([[[p * p, 1 - p * p], [0, 1]]], {}), {"p": (0, 1)})
    with pytest.raises(ModelError, match="differ in more than their probabilities"):
        stl.MDP.from_family(lambda p: stl.MDP.from_arrays([[[p, 1 - p], [0, 1]]], {"x": [p, 0]}), {"p": (0, 1)})
    with pytest.raises(ModelError, match="parameter q does not occur"):
        stl.MDP.from_arrays([[["p", "1-p"], [0, 1]]], {}, parameters={"p": (0, 1), "q": (0, 1)})
    with pytest.raises(ModelError, match="parameter q has no value"):
        stl.MDP.from_family(written_out, {"p": {"domain": (0, 1), "value": 1}, "q": (0, 1)})
    with pytest.raises(ModelError, match="there are no parameters"):
        stl.MDP.from_family(written_out, {})
    with pytest.raises(ModelError, match="p = 2 lies outside its domain"):
        stl.MDP.from_arrays([[["p", "1-p"], [0, 1]]], {}, parameters={"p": (0, 1)}).at(p=2)


def test_values_and_ranges_are_checked():
    family = stl.MDP.from_arrays(ROWS, {}, labels=LABELS, parameters={"p": (0, 1), "q": (0, 1)})
    with pytest.raises(SettingsError, match="no parameter r"):
        family.at(r=1)
    with pytest.raises(SettingsError, match="no value is given for q"):
        family.at(p=1)
    with pytest.raises(SettingsError, match="the range of p is 3; give two numbers"):
        family.within(p=3)
    with pytest.raises(ModelError, match="the lower end of a range comes first"):
        family.within(p=(1, 0.5))
    with pytest.raises(SettingsError, match="do not depend on parameters"):
        written_out(Fraction(0), Fraction(1)).at(p=1)
