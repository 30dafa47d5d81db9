"""The command `surrogate`."""

import json

import pytest

from tests.conftest import FACTORY, PATROLLING, SMALL


def test_the_command(stltool):
    code, out, _ = stltool("surrogate", PATROLLING)
    lines = out.splitlines()
    assert code == 0
    assert lines[0] == "task  patrolling := G[0,9] ((F[0,9] A) & (F[0,9] (x < 0.4 & y > 0.6)))"
    assert lines[1].startswith("P*    0.99999302109469")
    assert lines[2].split("  ")[0] == "surrogate"
    assert lines[3].startswith("discounted γ = 0.999  0.9999929528973")
    assert lines[3].split()[5] == "6.8e-08"
    assert lines[4].startswith("episode ")
    assert len(lines) == 5
    code, out, err = stltool("surrogate", PATROLLING, *SMALL, "--gamma", 0.99, "--json")
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert (data["task"], data["horizon"]) == ("patrolling", 8)
    assert [(row["reading"], row["gamma"]) for row in data["surrogates"]] == [("discounted", 0.99), ("episode", None)]
    assert all(row["greatest_lower"] <= row["optimum_upper"] for row in data["surrogates"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((FACTORY / "patrolling.stl", "--gamma", 1), "gamma is 1.0; it must be between 0 and 1"),
        ((FACTORY / "shift.stl",), "the paper's fragment"),
        ((FACTORY / "uncertain.stl",), "probabilities are intervals"),
    ],
)
def test_bad_input_ends_with_its_message(stltool, arguments, says):
    code, out, err = stltool("surrogate", *arguments)
    assert (code, out) == (2, "")
    assert says in err
    assert "Traceback" not in err


def test_intervals_by_their_nominal_probabilities(stltool):
    code, out, _ = stltool("surrogate", FACTORY / "uncertain.stl", "--nominal")
    assert code == 0
    assert "discounted" in out
