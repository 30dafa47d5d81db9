"""Intervals on their way in: arrays, grids, what is refused, and the nominal model inside them."""

from decimal import Decimal as D
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import sparse

import stltool as stl
from stltool.errors import ModelError
from stltool.models import Intervals
from stltool.models.grid import grid_from_table
from stltool.testing import interval_mdps
from tests import oracles
from tests.models.test_grid import table

LOWER, UPPER = [[0.1, 0.6], [0.0, 0.5]], [[0.4, 0.9], [0.3, 1.0]]
STAY = np.eye(2)


def build(lower=(STAY, LOWER), upper=(STAY, UPPER), **changes):
    return stl.MDP.from_intervals(list(lower), list(upper), {"x": [0.0, 1.0]}, **changes)


def rows(model):
    """(state, action) → {successor: (lower, upper)}, by names."""
    found = {}
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            entries = range(model.row_start[c], model.row_start[c + 1])
            found[model.state_name(s), model.action_names[model.choice_action[c]]] = {
                model.state_name(model.target[k]): (model.intervals.lower[k], model.intervals.upper[k]) for k in entries
            }
    return found


def test_ends_stay_with_their_entries():
    model = build()
    assert rows(model) == {
        ("0", "0"): {"0": (1, 1)},
        ("0", "1"): {"0": (0.1, 0.4), "1": (0.6, 0.9)},
        ("1", "0"): {"1": (1, 1)},
        ("1", "1"): {"0": (0, 0.3), "1": (0.5, 1)},
    }
    mixed = build(lower=[sparse.csr_matrix(STAY), LOWER], upper=[STAY, sparse.csr_matrix(UPPER)])
    assert mixed.digest() == model.digest()
    one = build(lower=[STAY, [[0, 0], LOWER[1]]], upper=[STAY, [[0, 0], UPPER[1]]])
    assert one.choice_start.tolist() == [0, 1, 3]  # a row of zeros: not available


@given(interval_mdps(states=4, actions=3))
def test_the_nominal_model_lies_inside(model):
    ends, nominal = model.intervals, model.nominal()
    assert (ends.lower <= model.probability).all()
    assert (model.probability <= ends.upper).all()
    assert nominal.intervals is None
    assert (nominal.probability > 0).all()
    dense = sparse.csr_array((model.probability, model.target, model.row_start), (model.n_choices, model.n_states))
    assert np.array_equal(nominal.matrix().toarray(), dense.toarray())
    assert np.allclose(nominal.matrix().sum(axis=1), 1)
    assert np.array_equal(nominal.choice_start, model.choice_start)
    assert nominal.digest() != model.digest()
    assert nominal.nominal() is nominal


def test_the_nominal_model_takes_one_share_of_every_width():
    model = build().nominal()
    assert model.matrix().toarray()[1].tolist() == pytest.approx([0.25, 0.75])  # 0.3 missing, of 0.6
    assert model.matrix().toarray()[3].tolist() == pytest.approx([0.1875, 0.8125])  # 0.5 missing, of 0.8
    forced = build(lower=[STAY, STAY], upper=[STAY, [[1, 0.5], [0.25, 1]]])
    assert forced.n_transitions == 6
    assert forced.nominal().n_transitions == 4  # what must be 0 is left out


def test_the_nominal_model_is_given_in_decimals(floor5):
    """Whatever fractions stood beside the ends: they are not the nominal ones."""
    ends = Intervals(np.maximum(floor5.probability - 0.1, 0), np.minimum(floor5.probability + 0.2, 1))
    model = floor5.with_rows(intervals=ends, probability=ends.nominal(floor5.row_start))
    assert floor5.kinds.given_exactly
    nominal = model.nominal()
    assert not nominal.kinds.given_exactly
    assert not any(nominal.exact().defects(nominal.row_start))
    assert 10**15 % nominal.exact().denominator == 0


def test_the_digest_covers_the_ends():
    model = build()
    digests = {model.digest(), build(upper=[STAY, np.minimum(np.array(UPPER) + 0.05, 1)]).digest()}
    narrow = Intervals(model.probability.copy(), model.probability.copy())
    digests.add(model.with_rows(intervals=narrow).digest())
    digests.add(model.with_rows(intervals=None).digest())
    assert len(digests) == 4
    for ends in (model.intervals.lower, model.intervals.upper):
        with pytest.raises(ValueError, match="read-only"):
            ends[:] = 0.5


NAN = float("nan")


@pytest.mark.parametrize(
    ("lower", "upper", "says"),
    [
        (
            [[0.5, 0.6], LOWER[1]],
            [[0.6, 0.9], UPPER[1]],
            "state 0, action 1: the lower ends sum to 1.1, more than 1; l",
        ),
        (LOWER, [[0.2, 0.7], UPPER[1]], "state 0, action 1: the upper ends sum to 0.9, less than 1; raise one of them"),
        ([[0.1, 0.6], [0.4, 0.5]], UPPER, r"state 1, action 1: \[0.4, 0.3\] to state 0 is not an interval of prob"),
        ([[-0.1, 0.6], LOWER[1]], UPPER, r"state 0, action 1: \[-0.1, 0.4\] to state 0 is not an interval"),
        (
            LOWER,
            [[0.4, 1.1], UPPER[1]],
            r"\[0.6, 1.1\] to state 1 is not an interval of probabilities; write 0 <= lower",
        ),
        (LOWER, [[NAN, 0.9], UPPER[1]], r"\[0.1, nan\] to state 0 is not an interval"),
        ([[NAN, 0.6], LOWER[1]], UPPER, r"\[nan, 0.4\] to state 0 is not an interval"),
        (LOWER, [[0.0, 1.0], UPPER[1]], "state 0, action 1: the lower end 0.1 to state 0 is above the upper end 0"),
        ([[0.1, 0.6], [0.0, "x"]], UPPER, "lower ends of action 1 are not numbers"),
        (LOWER, [0.4, 0.9], r"upper ends of action 1 have shape \(2,\); give a matrix"),
    ],
)
def test_bad_ends_are_refused_with_state_and_action(lower, upper, says):
    with pytest.raises(ModelError, match=says):
        build(lower=[STAY, lower], upper=[STAY, upper])


def test_shapes_must_agree():
    with pytest.raises(ModelError, match="lower ends are of 1 actions and 2 states, upper ends of 2 actions and 2"):
        build(lower=[LOWER])
    with pytest.raises(ModelError, match=r"lower ends have shape \(2, 2\); give an array \(A, S, S\)"):
        stl.MDP.from_intervals(np.array(LOWER), [UPPER], {})
    with pytest.raises(ModelError, match="upper ends contain no action"):
        build(upper=[])
    with pytest.raises(ModelError, match="state dock, action go: the lower ends sum to 1.1"):
        build(lower=[[[0.5, 0.6], [0, 0]]], upper=[[[1, 1], [1, 1]]], state_names=["dock", "x"], action_names=["go"])
    model = build()
    with pytest.raises(ModelError, match=r"the lower ends have shape \(2,\); one for each of 6 entries"):
        model.with_rows(intervals=Intervals(np.zeros(2), np.ones(2)))
    with pytest.raises(ModelError, match=r"\[0, 0\] to state 0 is not an interval .* leave out what cannot happen"):
        model.with_rows(intervals=Intervals(np.zeros(6), np.array([0.0, 1, 1, 1, 1, 1])))
    lower = np.where(model.intervals.lower == 0.1, 0.3, model.intervals.lower)
    with pytest.raises(ModelError, match=r"the probability 0.25 to state 0 is outside \[0.3, 0.4\]"):
        model.with_rows(intervals=Intervals(lower, model.intervals.upper))


# ------------------------------------------------------------------------------------------- grids

OPEN = "...\n.S.\n..."


@pytest.mark.parametrize(
    ("success", "slip"),
    [
        ([D("0.9"), D("0.95")], [D("0.01"), D("0.04")]),
        ("[0.9, 0.95]", "[1/100, 4/100]"),
        (["9/10", "19/20"], ["0.01", "1/25"]),
    ],
)
def test_noise_as_intervals(success, slip):
    model = grid_from_table(table(map=OPEN, success=success, slip=slip))
    assert not model.kinds.given_exactly
    found = rows(model)
    assert found["(1,1)", "N"] == dict.fromkeys(("(1,1)", "(0,2)", "(2,2)"), (0.01, 0.04)) | {"(1,2)": (0.9, 0.95)}
    assert found["(1,1)", "stay"] == {"(1,1)": (1, 1)}
    # off the map stays: three outcomes of four in the corner, added as fractions; their upper ends exceed 1
    assert found["(0,2)", "NW"] == {"(0,2)": (0.93, 1.0)}
    assert found["(0,2)", "E"] == {"(1,2)": (0.9, 0.95), "(0,2)": (0.02, 0.08), "(1,1)": (0.01, 0.04)}


def test_a_grids_nominal_model_is_the_grid_of_the_nominal_noise():
    model = grid_from_table(table(map=OPEN, success="[0.9, 0.95]", slip="[0.01, 0.04]")).nominal()
    share = Fraction(7, 100) / Fraction(14, 100)  # 1 − 0.93 missing, of widths 0.05 + 3 · 0.03
    success, slip = Fraction(9, 10) + share * Fraction(1, 20), Fraction(1, 100) + share * Fraction(3, 100)
    plain = grid_from_table(table(map=OPEN, success=str(success), slip=str(slip)))
    assert np.allclose(model.matrix().toarray(), plain.matrix().toarray(), atol=1e-15)


def test_slip_follows_success_and_points_mix_with_intervals():
    follows = grid_from_table({"kind": "grid", "map": OPEN, "success": ["7/10", "1"]})
    assert rows(follows)["(1,1)", "E"] == {
        "(1,1)": (0, 0.1), "(2,0)": (0, 0.1), "(2,2)": (0, 0.1), "(2,1)": (0.7, 1),
    }  # fmt: skip
    mixed = grid_from_table(table(map=OPEN, success="7/10", slip=[0, "1/5"]))
    assert rows(mixed)["(1,1)", "E"]["(2,1)"] == (0.7, 0.7)
    assert rows(mixed)["(1,1)", "E"]["(2,2)"] == (0, 0.2)
    never = grid_from_table(table(map=OPEN, success=[1, 1], slip=[0, 0]))
    assert rows(never)["(1,1)", "E"] == {"(2,1)": (1, 1)}


@given(st.lists(st.integers(0, 20), min_size=4, max_size=4), st.lists(st.integers(0, 9), min_size=3, max_size=3))
def test_cells_share_what_outcomes_add_up_to(ends, worth):
    """Nature over cells, with added ends, does what nature over outcomes can do: no more and no less."""
    success, slip = sorted(ends[:2]), sorted(ends[2:])
    assume(success[0] + 3 * slip[0] <= 20 <= success[1] + 3 * slip[1])
    written = {"success": [f"{n}/20" for n in success], "slip": [f"{n}/20" for n in slip]}
    model = grid_from_table({"kind": "grid", "map": "..\nS#"} | written)
    cells = {"(0,1)": worth[0], "(0,0)": worth[1], "(1,1)": worth[2]}
    outcomes = [(success, worth[0]), (slip, worth[1]), (slip, worth[1]), (slip, worth[2])]  # N, stay, NW (off), NE
    parts = oracles.vertices([(Fraction(low, 20), Fraction(high, 20)) for (low, high), _ in outcomes])
    over_outcomes = [sum(p * w for p, (_, w) in zip(part, outcomes, strict=True)) for part in parts]
    found = rows(model)["(0,0)", "N"]
    parts = oracles.vertices([tuple(Fraction(round(20 * end), 20) for end in pair) for pair in found.values()])
    over_cells = [sum(p * cells[cell] for p, cell in zip(part, found, strict=True)) for part in parts]
    assert (min(over_cells), max(over_cells)) == (min(over_outcomes), max(over_outcomes))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"success": ["0.1", "0.2"]}, "sum to 0.17 … 0.27, never to 1; widen one of them"),
        ({"success": "[0.95, 0.9]"}, r"success is \[0.95, 0.9\]; the lower end comes first"),
        ({"success": [D("0.9")]}, r"success is \[0.9\]; write an interval as \[0.9, 0.95\]"),
        ({"success": "[0.9, 0.95"}, r"success is '\[0.9, 0.95'; write an interval as"),
        ({"success": "[0.9; 0.95]"}, r"write an interval as"),
        ({"success": ["often", 1]}, "success: 'often' is not a number; write a number, or a fraction in quotes"),
        ({"success": [[0.9], 1]}, r"success: \[0.9\] is not a number"),
        ({"slip": "[-0.1, 0.1]"}, "slip is -0.1; a probability lies between 0 and 1"),
        ({"slip": [0, 1.5]}, "slip is 1.5; a probability"),
        ({"success": ["1/3", "1e-50"]}, "the lower end comes first"),
        ({"success": ["1e-50", 1], "slip": [0, 1]}, "success 1e-50–1 and slip 0–1 have no common denominator"),
    ],
)
def test_bad_noise_is_refused(changes, says):
    with pytest.raises(ModelError, match=says):
        grid_from_table(table(**changes))


def test_a_file_with_intervals(tmp_path):
    path = tmp_path / "floor.toml"
    path.write_text('kind = "grid"\nmap = "S."\nsuccess = [0.9, 0.95]\nslip = "[0.01, 0.04]"')
    assert rows(stl.load_model(path))["(0,0)", "E"] == {"(1,0)": (0.9, 0.95), "(0,0)": (0.03, 0.12)}
    path.write_text('kind = "grid"\nmap = "S."\nsuccess = [0.9, 0.8]')
    with pytest.raises(ModelError, match="floor.toml, line 3: success is .* the lower end comes first"):
        stl.load_model(path)


# ------------------------------------------------------------------------------------------- PRISM's explicit files


def test_transition_files_with_intervals(tmp_path):
    path = tmp_path / "m.tra"
    path.write_text(
        "2 3 6\n0 0 0 [0.1,2/5] try\n0 0 1 [0.6,0.9] try\n0 1 0 1 stay\n0 1 1 [0,0] stay\n1 0 1 0.5\n1 0 0 [0,1/2]\n"
    )
    model = stl.load_model(path)
    assert rows(model) == {
        ("0", "try"): {"0": (0.1, 0.4), "1": (0.6, 0.9)},
        ("0", "stay"): {"0": (1, 1)},
        ("1", "0"): {"0": (0, 0.5), "1": (0.5, 0.5)},
    }
    assert not model.kinds.given_exactly
    assert model.nominal().matrix().toarray()[0].tolist() == pytest.approx([0.25, 0.75])


@pytest.mark.parametrize(
    ("share", "says"),
    [
        ("[0.9,0.6]", r"line 2: .*\[0.9,0.6\] is not a probability"),
        ("[-1,1]", r"line 2: .*\[-1,1\] is not a probability"),
        ("[0.6;0.9]", r"line 2: .*with a decimal or a fraction such as 2/5, or \[0.6,0.9\]"),
        ("[0.6,0.9", r"line 2: .*or \[0.6,0.9\]"),
        ("[0.6,0.7,0.8]", r"line 2: .*or \[0.6,0.9\]"),
        ("[0.6,0.9]", "m.tra, line 2: state 0, choice 0: the upper ends sum to 0.9, less than 1"),
    ],
)
def test_bad_intervals_in_transition_files(tmp_path, share, says):
    path = tmp_path / "m.tra"
    path.write_text(f"1 1 1\n0 0 0 {share}\n")
    with pytest.raises(ModelError, match=says):
        stl.load_model(path)


@pytest.mark.parametrize("by_kernel", [False, True])
def test_ends_in_explicit_files_are_exact_or_no_exact_answer_is_given(tmp_path, monkeypatch, by_kernel):
    """A double in place of what was written would be another model."""
    for module in ("lines", "explicit"):
        monkeypatch.setattr(f"stltool.models.formats.{module}.LARGE", 0 if by_kernel else 1 << 40)
    for first, second, exact in [
        ("[0.1,0.3]", "[0.7,0.9]", Fraction(7, 10)),
        ("[0.25,0.5]", "0.75", Fraction(3, 4)),
        ("0.3", "[0.700000000000000,0.7]", Fraction(7, 10)),
        ("[1/3,1/2]", "[1/2,2/3]", None),
        ("[0.1,0.33333333333333333]", "[0.66,0.9]", None),
        ("1/3", "[0.6,0.7]", None),
        ("0.33333333333333333", "[0.6,0.7]", None),
    ]:
        (tmp_path / "m.tra").write_text(f"2 2 3\n0 0 0 {first}\n0 0 1 {second}\n1 0 1 1\n")
        (tmp_path / "m.lab").write_text('0="init" 1="done"\n0: 0\n1: 1\n')
        product = stl.build_product(stl.load_model(tmp_path / "m.tra"), stl.parse("F[0,1] done"))
        if exact is None:
            with pytest.raises(ModelError, match="were rounded when they were read"):
                stl.robust_check(product, exact=True)
        else:
            assert stl.robust_check(product, exact=True).fraction == exact
