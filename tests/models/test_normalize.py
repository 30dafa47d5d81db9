"""Rows that miss 1 by rounding: refused with the way out, and rescaled on request so that exact answers exist."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

import stltool as stl
from stltool.errors import ModelError
from stltool.models.fractions import over_one
from stltool.models.normalize import rescale

THIRD = 1 / 3


def rows_of(model):
    exact = model.exact()
    shares = [Fraction(int(n), exact.denominator) for n in exact.numerator]
    return [shares[a:b] for a, b in zip(model.row_start[:-1], model.row_start[1:], strict=True)]


def one_row(*row, **named):
    n = len(row)
    return stl.MDP.from_arrays([[list(row), *np.eye(n)[1:].tolist()]], {}, **named)


def test_thirds_become_thirds():
    model = one_row(THIRD, THIRD, THIRD, labels={"arrived": [0, 0, 1]}, normalize=True)
    assert rows_of(model)[0] == [Fraction(1, 3)] * 3
    assert model.notes["normalize"] == (
        "normalize rescaled 1 of 4 distributions to sum to 1 exactly; no probability changed by more than 3.3e-17"
    )
    product = stl.build_product(model, stl.parse("F[0,1] arrived"))
    assert stl.check(product, exact=True).fraction == Fraction(1, 3)


@pytest.mark.parametrize(
    ("row", "exactly"),
    [
        ((0.8, (1 - 0.8) / 2, (1 - 0.8) / 2), ["4/5", "1/10", "1/10"]),
        ((2 * THIRD, THIRD), ["2/3", "1/3"]),
        ((0.333333, 0.333333, 0.333333), ["1/3", "1/3", "1/3"]),
        ((0.142857, 0.857142), ["1/7", "6/7"]),
        ((0.5, 0.25, 0.25), ["1/2", "1/4", "1/4"]),
        ((0.1, 0.2, 0.7), ["1/10", "1/5", "7/10"]),
        (("1/3", "0.333333", "0.333333"), ["1/3", "1/3", "1/3"]),
    ],
)
def test_small_fractions_are_found(row, exactly):
    assert rows_of(one_row(*row, normalize=True))[0] == [Fraction(text) for text in exactly]


def test_what_sums_to_1_stays_as_it_is():
    row = (0.123456789, 0.876543211)
    model = one_row(*row, normalize=True)
    assert rows_of(model)[0] == [Fraction("0.123456789"), Fraction("0.876543211")]
    assert model.notes == {"normalize": "normalize changed nothing: all probabilities sum to 1 exactly"}
    assert model.digest() == one_row(*row).digest()
    assert one_row(*row).notes == {}


@pytest.mark.parametrize(
    ("kind", "form"), [(np.float16, np.asarray), (np.float32, np.asarray), (np.float32, sparse.csr_array)]
)
def test_short_floats_are_their_decimals(kind, form):
    swap = form(np.array([[0.1, 0.9], [0.75, 0.25]], kind))
    model = stl.MDP.from_arrays([swap], {})
    assert model.probability.tolist() == [0.1, 0.9, 0.75, 0.25]
    assert rows_of(model) == [[Fraction(1, 10), Fraction(9, 10)], [Fraction(3, 4), Fraction(1, 4)]]


def test_float32_rows_have_a_way_out():
    rng = np.random.default_rng(0)
    P = rng.random((2, 5, 5), dtype=np.float32)
    P /= P.sum(axis=-1, keepdims=True)
    with pytest.raises(
        ModelError, match=r"sum to (1|0\.99)\d*.*not 1 .and those of \d more rows.*normalize=True.*--nor"
    ):
        stl.MDP.from_arrays(P, {})
    model = stl.MDP.from_arrays(P, {}, normalize=True)
    assert all(sum(row) == 1 for row in rows_of(model))
    assert np.abs(model.probability - P[:, :, :].transpose(1, 0, 2).ravel()).max() < 1e-7
    stl.check(stl.build_product(model, stl.parse("F[0,1] true")), exact=True)


def test_doubles_within_the_tolerance_cannot_be_checked_exactly_without():
    model = one_row(THIRD, THIRD, THIRD)
    product = stl.build_product(model, stl.parse("F[0,1] true"))
    with pytest.raises(ModelError, match="there is no exact answer; .*normalize=True .on the command line --normalize"):
        stl.check(product, exact=True)


def test_the_initial_distribution_is_a_row_too():
    model = stl.MDP.from_arrays([np.eye(4)], {}, initial=[0, 0.333333, 0.333333, 0.333333], normalize=True)
    assert [model.exact().initial_share(s) for s in range(4)] == [0, *[Fraction(1, 3)] * 3]
    assert model.initial.tolist() == [0, THIRD, THIRD, THIRD]
    assert "1 of 5 distributions" in model.notes["normalize"]
    with pytest.raises(
        ModelError, match="initial distribution sums to 0.999999, not 1; rows that miss 1 only by rounding"
    ):
        stl.MDP.from_arrays([np.eye(4)], {}, initial=[0, 0.333333, 0.333333, 0.333333])


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            (0.5, 0.4),
            "state 0, action 0: the probabilities sum to 0.9, not 1; normalize rescales rows that miss 1 by at",
        ),
        ((0.5, 0.502), "sum to 1.002, not 1; normalize rescales"),
        ((np.nan, 1.0), "state 0, action 0: nan to state 0 is not a probability"),
        ((-0.1, 1.1), "state 0, action 0: -0.1 to state 0 is not a probability"),
        ((7.0, 3.0), "state 0, action 0: 7 to state 0 is not a probability"),
    ],
)
def test_what_is_no_rounding_is_refused(row, says):
    with pytest.raises(ModelError, match=says):
        one_row(*row, normalize=True)


@given(
    st.lists(st.integers(1, 10**6), min_size=1, max_size=6),
    st.lists(st.fractions(-1, 1), min_size=6, max_size=6),
    st.sampled_from([0, 10**-15, 10**-9, 10**-4]),
)
def test_rows_sum_to_1_and_hardly_change(weights, noise, scale):
    """Whatever distribution is rounded off a little: it comes back as one, entries changed by little more than that."""
    row = [Fraction(w, sum(weights)) for w in weights]
    given_row = [p * (1 + Fraction(scale) * e) for p, e in zip(row, noise, strict=False)]
    (numerator, denominator), done = rescale(over_one(given_row), np.array([0, len(row)]), str)
    found = [Fraction(int(n), denominator) for n in numerator]
    missing = abs(1 - sum(given_row))
    assert sum(found) == 1
    assert min(found) > 0
    changes = [abs(a - b) for a, b in zip(given_row, found, strict=True)]
    assert done.largest == max(changes)
    assert max(changes) <= max(missing, Fraction(1, 2**50)) + Fraction(len(row), 10**18)
    assert (done.rows == 0) == (missing == 0)


@given(st.lists(st.integers(1, 30), min_size=2, max_size=5))
def test_fractions_in_doubles_come_back(weights):
    """Doubles whose decimals miss 1 by rounding are the fractions of small denominators that they are nearest to."""
    row = [Fraction(w, sum(weights)) for w in weights]
    decimals = [Fraction(repr(float(p))) for p in row]
    found = rows_of(one_row(*map(float, row), normalize=True))[0]
    assert found == (decimals if sum(decimals) == 1 else row)


def test_tiny_entries_stay_positive():
    model = one_row(1e-25, 0.4999999, 0.5, normalize=True)
    assert 0.9e-25 < model.probability[0] < 1.1e-25
    assert sum(rows_of(model)[0]) == 1


# ------------------------------------------------------------------------------------------------------------ files


def write(folder, name, text):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_grid_files(tmp_path):
    text = 'kind = "grid"\nmap = "S.A"\nsuccess = 0.93\nslip = 0.0233333\n'
    path = write(tmp_path, "g.toml", text)
    with pytest.raises(
        ModelError, match=r"g.toml, line 4: success 0.93 and three times slip 0.0233333 sum to 0.9999999, not"
    ) as caught:
        stl.load_model(path)
    assert "normalize = true" in str(caught.value)
    asking = write(tmp_path, "n.toml", text + "normalize = true\n")
    for model in (stl.load_model(path, normalize=True), stl.load_model(asking)):
        assert {sum(row) for row in rows_of(model)} == {1}
        assert rows_of(model)[model.action_names.index("E")] == [Fraction(7, 100), Fraction(93, 100)]
        assert "normalize rescaled 1 of 1 distributions" in model.notes["normalize"]
    with pytest.raises(ModelError, match="line 5: normalize is 'yes'; write true or false"):
        stl.load_model(write(tmp_path, "b.toml", text + 'normalize = "yes"\n'))
    with pytest.raises(ModelError, match="normalize rescales rows that miss 1 by at most 0.001"):
        stl.load_model(
            write(tmp_path, "c.toml", 'kind = "grid"\nmap = "S."\nsuccess = 0.9\nslip = 0.1\n'), normalize=True
        )


def test_intervals_and_black_boxes_have_nothing_to_rescale(tmp_path):
    grid = write(tmp_path, "g.toml", 'kind = "grid"\nmap = "S."\nsuccess = [0.9, 0.95]\n')
    rows = write(tmp_path, "i.tra", "1 1 1\n0 0 0 [0.5,1]\n")
    lake = write(tmp_path, "l.toml", 'kind = "gymnasium"\nid = "FrozenLake-v1"\ntable = false\n')
    for path, what in ((grid, "intervals"), (rows, "intervals"), (lake, "unknown")):
        note = stl.load_model(path, normalize=True).notes["normalize"]
        assert note == f"normalize changed nothing: the model's probabilities are {what}"
        assert "normalize" not in stl.load_model(path).notes


def test_transition_files(tmp_path):
    tra = "3 3 5\n0 0 0 0.333333\n0 0 1 0.333333\n0 0 2 0.333333\n1 0 1 1\n2 0 2 1\n"
    path = write(tmp_path, "m.tra", tra)
    with pytest.raises(
        ModelError, match="m.tra, line 2: state 0, choice 0: the probabilities sum to 0.999999, not 1; rows"
    ):
        stl.load_model(path)
    model = stl.load_model(path, normalize=True)
    assert rows_of(model)[0] == [Fraction(1, 3)] * 3
    assert model.probability.tolist() == [THIRD, THIRD, THIRD, 1, 1]
    assert "1 of 3 distributions" in model.notes["normalize"]
