"""Encodings counted and built, the surrogate's figures in words."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.encodings import compare_encodings, state_histories
from stltool.errors import FragmentError
from stltool.reporting import encoding_data, encoding_rows, surrogate_data, surrogate_rows
from stltool.reporting.story import count_text
from stltool.testing import mdps
from tests import oracles
from tests.conftest import FACTORY, many


@given(mdps(states=4), st.integers(1, 4))
@settings(max_examples=many(40))
def test_state_histories_are_the_paths_of_the_model(model, length):
    follows = {s: {s2 for row in oracles.choices(model, s) for s2, p in row if p} for s in range(model.n_states)}
    paths = [
        path
        for path in itertools.product(range(model.n_states), repeat=length)
        if all(b in follows[a] for a, b in itertools.pairwise(path))
    ]
    ends = np.bincount([path[-1] for path in paths], minlength=model.n_states)
    assert state_histories(model, length) == ends.tolist()


def test_what_each_encoding_takes(patrolling):
    """Patrolling with τ = 5 on 18 cells of nine actions: flags 6 · 6, histories of three letters (3⁶ − 1)/2."""
    data = encoding_data(compare_encodings(patrolling))
    assert data["flags"] == {"automaton_states": 36, "product_states": 648, "q_entries": 5832, "q_bytes": 46656}
    assert data["exact"]["automaton_states"] == 26 == patrolling.automaton.n_states
    assert data["history"]["automaton_states"] == 364
    assert data["remembered_steps"] == 5
    histories = data["state_histories"]
    assert histories["all"] == 18**5
    assert histories["q_entries"] == 9 * histories["possible"] == 9 * sum(state_histories(patrolling.model, 5))
    assert histories["possible"] < histories["all"] / 100
    assert data["optimum"] == pytest.approx(0.737948, abs=1e-6)
    assert data["history_optimum"] == pytest.approx(data["optimum"], abs=1e-12)
    assert data["history_refused"] is None
    json.dumps(data)


def test_histories_that_do_not_fit_are_counted_only(floor5):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 15, "tau": 15})
    product = stl.build_product(floor5, task)
    data = encoding_data(compare_encodings(product))
    assert data["history"]["automaton_states"] == (3**16 - 1) // 2
    assert data["history_optimum"] is None
    assert "history encoding" in data["history_refused"]
    assert data["state_histories"]["all"] == 18**15
    large = encoding_data(compare_encodings(stl.build_product(floor5, stl.parse("F[0,2) F[0,2000) A"))))
    assert large["history"] is None
    assert large["state_histories"]["all"] == 18**2000
    rows = encoding_rows({"P2": data, "large": large})
    assert rows[0]["P* on letters"] == rows[1]["P* on letters"] == "too large"
    assert rows[0]["|Σ|^τ"] == "6.75e+18"
    assert rows[0]["letters"] == "27.9 GB"
    assert (rows[1]["× letters"], rows[1]["letters"]) == ("over 1e300", "")
    assert [list(row) for row in rows] == [list(rows[0])] * 2
    assert (count_text(9_999_999), count_text(10**7)) == ("9999999", "1.00e+7")


def test_a_task_without_flags_has_nothing_to_compare(floor5):
    with pytest.raises(FragmentError, match="until"):
        compare_encodings(stl.build_product(floor5, stl.parse("F[0,3) (A U[0,2) B)")))


def test_histories_are_learned_like_flags_only_slower(floor5):
    """With every entry that a transition speaks for, memories that tell the same apart learn the same, bit by bit."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 7})
    runs = [
        stl.learn(stl.build_product(floor5, task, encoding), "cfer", episodes=200, seed=1)
        for encoding in ("paper", "history")
    ]
    assert [point.steps for point in runs[0].history] == [point.steps for point in runs[1].history]
    for flags, histories in zip(*(run.history for run in runs), strict=True):
        assert flags.probability == pytest.approx(histories.probability, abs=1e-9)
    assert runs[0].history[-1].probability > 0.5


def test_rows_of_the_surrogate(floor5, patrolling):
    loses = stl.build_product(floor5, stl.parse("F[0,3) (F[0,6) A & F[0,6) B & F[0,6) C)"))
    readings = {
        name: [surrogate_data(stl.surrogate_optimum(product, reading)) for reading in ("discounted", "episode")]
        for name, product in (("tour", loses), ("patrolling", patrolling))
    }
    tour, patrol = surrogate_rows(readings)
    assert list(tour) == list(patrol) == [
        "scenario", "optimum P*", "gap, discounted γ = 0.999", "at worst, discounted γ = 0.999", "gap, episode",
        "at worst, episode",
    ]  # fmt: skip
    assert tour["gap, discounted γ = 0.999"] == "0.017"
    assert tour["gap, episode"] == "none"
    assert patrol["optimum P*"] == "0.737948"
    first = readings["tour"][0]
    assert first["gap"] == first["optimum"] - first["at_random"]
    for name in ("at_random", "least", "greatest", "optimum"):
        assert first[f"{name}_lower"] <= first[name] <= first[f"{name}_upper"]
