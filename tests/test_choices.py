"""Forms of policies that list only what matters, against dictionaries of what they were made from."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stltool.choices import Choices, Mixtures, Table, Through, distinct, listed, mixed
from tests.conftest import many

SHAPE, C = (4, 70), 3


@st.composite
def mixtures(draw):
    """A form, and (t, s, q) → weights, of steps 0 … 5; steps that do the same follow each other at times."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    otherwise = draw(
        st.sampled_from(
            [
                Table(rng.integers(C, size=SHAPE).astype(np.int16)),
                Table(rng.dirichlet(np.ones(C), size=SHAPE)),
                Choices(SHAPE, 6, [listed(1, 4, 2, *np.divmod(np.arange(5, 280, 3), 70), np.ones(92, np.uint8))]),
            ]
        )
    )
    known, layers, before = {}, [], None
    for t in range(5, -1, -1):
        if before is None or rng.random() < 0.6:
            codes = np.flatnonzero(rng.random(280) < rng.choice([0, 0.1, 1]))
            weights = np.eye(C)[rng.integers(C, size=len(codes))] * 0.5 + rng.integers(2) / 6
            weights /= weights.sum(axis=1, keepdims=True)
        layer = mixed(before, t, codes, weights)
        if before is not None and layer.last > t:
            layers[-1] = layer
        else:
            layers.append(layer)
        before = layer
        known |= {(t, *divmod(int(c), 70)): w for c, w in zip(codes, weights, strict=True)}
    return Mixtures(SHAPE, layers[::-1], otherwise, C), known, otherwise


@given(mixtures())
@settings(max_examples=many(60))
def test_mixtures_do_what_is_listed_and_elsewhere_what_the_other_form_does(case):
    form, known, otherwise = case
    seen = set()
    for t in range(6):
        row = form.row(t)
        first, last = form.alike(t)
        assert first <= t <= last
        for other in range(first, min(last, 5) + 1):
            assert np.array_equal(row, form.row(other))
        for s, q in np.ndindex(SHAPE):
            there = otherwise.at(t, np.array([s]), np.array([q]))[0]
            wanted = known.get((t, s, q), np.eye(C)[there] if otherwise.deterministic else there)
            assert np.array_equal(row[s, q], wanted)
            seen.add(tuple(sorted(wanted.tolist())))
        s, q = np.array([3, 0, 2]), np.array([69, 0, 64])
        assert np.array_equal(form.at(t, s, q), row[s, q])
        memory = np.array([64, 1, 69])
        assert np.array_equal(Through(form, memory).at(t, s, np.array([2, 0, 1])), row[s, [69, 64, 1]])
    found = list(map(tuple, form.mixtures().tolist()))
    assert len(found) == len(set(found))
    assert seen <= set(found)


@given(st.integers(0, 2**32 - 1), st.integers(0, 40))
@settings(max_examples=many(40))
def test_distinct_rows_are_all_of_them_and_say_where_they_are(seed, n):
    rows = np.random.default_rng(seed).integers(3, size=(n, 2)) / 3
    found, which = distinct(rows)
    assert np.array_equal(found[which], rows)
    assert len({tuple(row) for row in rows.tolist()}) == len(found)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(4, 71), (5, 200), (4, 64), (9, 65)]))
@settings(max_examples=many(40))
def test_choices_move_to_another_shape(seed, shape):
    rng = np.random.default_rng(seed)
    s, q = np.nonzero(rng.random((4, 64)) < 0.3)
    choices = Choices((4, 70), 3, [listed(1, 1, 2, s, q, rng.integers(5, size=len(s)).astype(np.uint8))])
    moved = choices.resized(shape)
    assert moved.row(1).shape == shape
    for t in range(3):
        assert np.array_equal(moved.row(t)[:4, :64], choices.row(t)[:4, :64])
    assert not moved.row(1)[4:].any()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=many(30))
def test_one_pair_has_the_choice_of_many_where_it_is_listed(seed):
    rng, layers, known = np.random.default_rng(seed), [], {}
    for first, last in ((1, 1), (2, 4), (6, 6)):
        codes = np.flatnonzero(rng.random(280) < rng.choice([0, 0.1, 1]))
        choice = rng.integers(C, size=len(codes)).astype(np.uint8)
        layers.append(listed(first, last, 2, *np.divmod(codes, 70), choice))
        known |= {(t, code): a for t in range(first, last + 1) for code, a in zip(codes, choice, strict=True)}
    form = Choices(SHAPE, 8, layers)
    for t in rng.permutation(8).tolist():
        for code in range(280):
            s, q = divmod(code, 70)
            assert form.one(t, s, q) == known.get((t, code), -1)
            assert form.at(t, np.array([s]), np.array([q])) == known.get((t, code), 0)
