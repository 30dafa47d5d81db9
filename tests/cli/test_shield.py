"""The command `shield`."""

import pytest

import stltool as stl
from tests.conftest import FACTORY, PATROLLING, SMALL


def test_the_mask_that_is_written_keeps_what_is_printed(stltool, tmp_path):
    mask = tmp_path / "mask.npz"
    code, out, err = stltool("shield", PATROLLING, *SMALL, "--at-least", "1/2", "--rule", "ratio", "--out", mask)
    assert (code, err) == (0, "")
    assert "P >= 1/2" in out
    model, task = stl.load_model(FACTORY / "floor-5x5.toml"), stl.load_task(PATROLLING, {"T": 5, "tau": 5})
    shield = stl.Shield.load(mask, stl.build_product(model, task))
    assert (shield.at_least, shield.rule, shield.levels) == (0.5, "ratio", 64)
    (row,) = (line for line in out.splitlines() if line.startswith("the worst that obeys"))
    lower, upper = map(float, row.split()[-2:])
    assert 0.5 <= shield.least.lower == pytest.approx(lower, abs=1e-15)
    assert shield.least.upper == pytest.approx(upper, abs=1e-15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at-least", "0.999999"], "cannot be promised: its maximum P* is between 0."),
        (["--at-least", "2"], "--at-least 2: a probability lies between 0 and 1"),
        (["--at-least", "0.5", "--out", "mask.csv"], "shields are saved as .npz"),
    ],
)
def test_what_cannot_be_done_is_refused(stltool, arguments, message):
    code, out, err = stltool("shield", PATROLLING, *SMALL, *arguments)
    assert (code, out) == (2, "")
    assert message in err
