"""The decimals of doubles against what Python prints."""

from fractions import Fraction

import numpy as np

from stltool.kernels.decimals import decimals


def found(values):
    values = np.asarray(values, dtype=np.float64)
    whole, places = np.empty(len(values), np.int64), np.empty(len(values), np.int64)
    decimals(values, whole, places)
    return whole.tolist(), places.tolist()


def test_whole_numbers_and_places_are_what_is_printed():
    rng = np.random.default_rng(20)
    tens = 10.0 ** np.arange(-6, 17)
    twos = 2.0 ** rng.integers(-18, 51, 200)
    values = np.concatenate([
        rng.random(4000) * 10.0 ** rng.integers(-6, 16, 4000),
        np.round(rng.random(2000) * 1000, 3),
        -(rng.integers(0, 999, 1000) / 100 + rng.integers(0, 999, 1000) / 1000),
        rng.integers(1, 2**53, 1000) / 2.0 ** rng.integers(0, 60, 1000),
        tens, np.nextafter(tens, 0), np.nextafter(tens, np.inf), -tens,
        twos, twos * (1 + 2.0**-52 * rng.integers(0, 4, 200)), np.nextafter(twos, 0),
        np.arange(1, 400) * 0.125, [0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.7e308, 9.5e-7, 1e15],
    ])  # fmt: skip
    whole, places = found(values)
    settled = [(value, m, k) for value, m, k in zip(values.tolist(), whole, places, strict=True) if k >= 0]
    assert [(v, m, k) for v, m, k in settled if Fraction(m, 10**k) != Fraction(repr(v))] == []
    inside = (np.abs(values) >= 1e-6) & (np.abs(values) < 1e15)
    assert len(settled) >= 0.93 * inside.sum()
    assert not any(k >= 0 for v, k in zip(values.tolist(), places, strict=True) if v and not 1e-6 <= abs(v) < 1e15)


def test_short_decimals_are_all_settled():
    values = np.arange(-5000, 5000) / 1000
    whole, places = found(values)
    powers = {2.0**k for k in range(-10, 3)}
    assert all(k >= 0 for v, k in zip(values.tolist(), places, strict=True) if abs(v) not in powers)
    assert whole[5000] == 0
    assert places[5000] == 0
