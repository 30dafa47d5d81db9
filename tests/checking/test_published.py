"""Probabilities that PRISM's own tests state, on models written anew and on PRISM's files."""

import tomllib
from fractions import Fraction

import pytest

import stltool as stl
from tests import published
from tests.conftest import DATA, OUTSIDE, needs_outside

PUBLISHED = tomllib.loads((DATA / "prism.toml").read_text(encoding="utf-8"))
LONG = "60"  # steps within which the robot and the die have come close to what they come to in the end


@pytest.mark.parametrize("name", ["line", "skips", "levels"])
def test_properties_with_bounds_to_the_last_digit(name):
    model = getattr(published, name)()
    for side, properties in PUBLISHED[name].items():
        for formula, value in properties:
            product = stl.build_product(model, stl.parse(formula))
            found = stl.check(product, maximize=side != "Pmin", exact=True, keep_policy=False).fraction
            assert found == Fraction(value), (side, formula)


def comes_to(model, text, value):
    """The maximum of a formula, exactly where it has a bound of its own, from below where K is one."""
    product = stl.build_product(model, stl.parse(text.replace("K", LONG)))
    found = stl.check(product, exact=True, keep_policy=False).fraction
    return 0 <= value - found < 1e-9 if "K" in text else found == value


@needs_outside("prism")
@pytest.mark.parametrize("form", ["robot.prism", "robot.prism.exact", "robot.prism.rows"])
def test_the_robot_in_each_of_prisms_files(form):
    model = stl.load_model(OUTSIDE / "prism" / "mdp" / f"{form}.tra")
    for text, value in PUBLISHED["robot"]["Pmax"]:
        assert comes_to(model, text, Fraction(value)), text


@needs_outside("prism")
def test_the_robot_with_intervals():
    model = stl.load_model(OUTSIDE / "prism" / "imdp" / "robot.prism.tra")
    asked = PUBLISHED["robot"]["nature"]
    product = stl.build_product(model, stl.parse(asked["formula"].replace("K", LONG)))
    for nature in ("against", "with"):
        found = stl.robust_check(product, nature=nature)
        assert found.lower - 1e-9 <= float(asked[nature]) <= found.upper + 1e-9, nature


@needs_outside("prism")
@pytest.mark.parametrize("form", ["dice.pm", "dice.pm.exact", "dice.pm.rows"])
def test_the_die_of_knuth_and_yao_is_fair(form):
    model = stl.load_model(OUTSIDE / "prism" / "dtmc" / f"{form}.tra")
    for text, value in PUBLISHED["dice"]["P"]:
        assert comes_to(model, text, Fraction(value)), text
