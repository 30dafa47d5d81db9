"""The top of a page: digits that tell a probability from 1, frequencies in words, and one scale of odds."""

import itertools
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stltool.numbers import bound_texts
from stltool.reporting.headline import headline, one_in, positions


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (1.0, "no run fails"),
        (0.0, "every run fails"),
        (0.5, "50 % of runs fail"),
        (0.73794757279959, "about 26.2 % of runs fail"),
        (0.9999861925202476, "about one run in 72\u202f000 fails"),
        (0.99, "about one run in 100 fails"),
        (1e-9, "about one run in 1\u202f000\u202f000\u202f000 succeeds"),
        (0.02, "about one run in 50 succeeds"),
    ],
)
def test_frequencies_in_words(p, text):
    assert one_in(p) == text


@st.composite
def enclosed(draw):
    """P and an enclosure of it, as wide as rounding errors make it, or as a policy's with intervals."""
    p = draw(st.one_of(st.floats(0, 1), st.floats(0, 1e-3).map(lambda x: 1 - x), st.sampled_from([0.0, 0.5, 1.0])))
    below, above = (draw(st.sampled_from([0.0, 1e-17, 1e-13, 1e-6, 0.1])) for _ in range(2))
    return {"question": "policy", "probability": p, "lower": max(0.0, p - below), "upper": min(1.0, p + above),
            "gap": 0.0}  # fmt: skip


@given(enclosed())
def test_what_the_top_says_lies_in_the_enclosure_printed_below_it(check):
    """The headline, the scale and the sentences; and 1 and 0 only if they are meant."""
    least, most = map(Decimal, bound_texts(check["lower"], check["upper"]))
    optimum = {**check, "question": "maximum"}
    policy = {**check, "gap": 1.0, "optimum_lower": check["lower"], "optimum_upper": check["upper"]}
    top = headline({"checks": [policy, optimum], "training": None}, [])
    assert top["value"].startswith("P = ")
    texts = [top["value"].removeprefix("P = "), *(row["text"] for row in top["rows"])]
    texts.append(top["lead"].partition("No policy does better than ")[2].removesuffix("."))
    assert len(texts) == 4
    for text in texts:
        assert least <= Decimal(text) <= most
        assert (text in ("0", "1")) == (check["probability"] in (0, 1))


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
