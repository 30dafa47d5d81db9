"""The top of a page: digits that tell a probability from 1, frequencies in words, and one scale of odds."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stltool.reporting.headline import headline, one_in, positions, value_text


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (1.0, "no run fails"),
        (0.0, "every run fails"),
        (0.5, "50 % of runs fail"),
        (0.9999861925202476, "about one run in 72\u202f000 fails"),
        (0.99, "about one run in 100 fails"),
        (1e-9, "about one run in 1\u202f000\u202f000\u202f000 succeeds"),
        (0.02, "about one run in 50 succeeds"),
    ],
)
def test_frequencies_in_words(p, text):
    assert one_in(p) == text


@given(st.floats(0, 1))
def test_the_value_is_never_shown_as_another(p):
    """1 and 0 are shown only if they are meant, and nothing is far from what is shown."""
    text = value_text(p)
    shown = 1 - float(text[4:]) if text.startswith("1 − ") else float(text)
    assert (text == "1") == (p == 1)
    assert shown == pytest.approx(p, rel=1e-5, abs=1e-12)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=5))
def test_positions_are_in_the_order_of_the_values(values):
    rows = [{"values": [p]} for p in values]
    ticks = positions(rows)
    assert all(0 <= row["x"][0] <= 100 for row in rows)
    order = sorted(range(len(values)), key=lambda i: values[i])
    assert [rows[i]["x"][0] for i in order] == sorted(row["x"][0] for row in rows)
    assert all(later["x"] - tick["x"] >= 13 for tick, later in itertools.pairwise(ticks))


@pytest.mark.parametrize(("n", "text"), [(1, "one parameter"), (2, "2 parameters")])
def test_a_bound_says_how_many_parameters_it_knows(n, text):
    found = {"source": "learning data", "confidence": 0.99, "support": "known", "lower": 0.5, "parameters": [{}] * n}
    told = {"P_at_least": "0.5", "confidence": "99 %", "guaranteed_by": "learning data"}
    rows = headline({"checks": [], "training": True, "guarantees": [found] * 2}, [told] * 2)["rows"]
    assert [row["what"] for row in rows] == [f"Learning data, successors known, {text}"] * 2
