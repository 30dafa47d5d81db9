"""Blocks judged by the kernel: what numpy finds, to the bit, gaps and borders included."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.kernels import passes
from stltool.monitoring import compiled, offline
from stltool.testing import formulas, traces

SEMANTICS = ("both", "boolean", "robustness")


@pytest.fixture(params=[None, 8], ids=["whole", "small tiles"])
def tiles(request, monkeypatch):
    if request.param is not None:
        monkeypatch.setattr(passes, "TILE", request.param)


def judged(monkeypatch, how, *arguments):
    """Bytes of verdicts and robustness, or the message; whether the kernel was used throughout.

    how   "numpy", "blocks" for the kernel in blocks that are checked before, "whole" for whole arrays if possible
    """
    used = []

    def judge(*given):
        used.append(_judge_quickly(*given))
        return used[-1]

    def whole(*given):
        done = how == "whole" and _whole(*given)
        used.extend(["whole"] * done)
        return done

    with monkeypatch.context() as patch:
        patch.setattr(offline, "worthwhile", lambda samples: how != "numpy")
        patch.setattr(offline, "judge_quickly", judge)
        patch.setattr(compiled.Compiled, "whole", whole)
        try:
            found = stl.monitor(*arguments)
        except stl.StlToolError as error:
            return str(error), used
    return [None if one is None else (one.shape, one.tobytes()) for one in (found.verdicts, found.robustness)], used


_judge_quickly, _whole = offline.judge_quickly, compiled.Compiled.whole


@given(
    phi=formulas(longest=6, max_leaves=6),
    n=st.integers(1, 40),
    rows=st.integers(1, 5) | st.integers(8, 10),
    end=st.sampled_from(["error", "cut", "hold"]),
    semantics=st.sampled_from(SEMANTICS),
    data=st.data(),
)
def test_the_kernel_finds_what_numpy_finds(phi, n, rows, end, semantics, data):
    drawn = [data.draw(traces(n)) for _ in range(min(rows, 3))]
    order = data.draw(st.permutations([i % len(drawn) for i in range(rows)]))
    batch = {name: np.stack([drawn[i][name] for i in order]) for name in drawn[0]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passes, "TILE", data.draw(st.sampled_from([4, 16, 1024])))
        patch.setattr(offline, "SAMPLES", data.draw(st.sampled_from([8, 1 << 16])))
        expected, _ = judged(patch, "numpy", phi, batch, end, semantics)
        for how in ("blocks", "whole"):
            assert judged(patch, how, phi, batch, end, semantics)[0] == expected


LONG = [
    "always[0,50](eventually[0,20](x > 0.5) and eventually[0,20](y > 0.5))",
    "(x < y) U[3,17] (-y <= -0.25 & !A)",
    "(x == 0.5) <-> F[2,9] (y != 0.5 | A)",
    "G[0,5] F[0,300] (0.02 > x)",
    "true U[0,4] (x + y > 0.7)",
    "F[1,1] (y > 0.5)",
    "G[0,7] (x * y <= 0.25)",
    "-0 < x -> G[1,4] (x >= 0)",
    "G[0,2] A | F[1,3] (x > 0.5)",
]


@pytest.mark.parametrize("text", LONG)
@pytest.mark.parametrize("end", ["error", "cut", "hold"])
def test_long_traces_and_borders(text, end, tiles, monkeypatch):
    """Samples are decimals of one place, so that margins are 0 often, and truth has to be computed by itself."""
    phi, rng = stl.parse(text), np.random.default_rng(0)
    for shape in ((3000,), (40, 320)):
        signals = {"x": rng.random(shape).round(1), "y": rng.random(shape).round(1), "A": rng.random(shape) < 0.1}
        for semantics in SEMANTICS:
            expected, _ = judged(monkeypatch, "numpy", phi, signals, end, semantics)
            for how in ("blocks", "whole"):
                found, used = judged(monkeypatch, how, phi, signals, end, semantics)
                assert found == expected
                assert used
                assert all(used)


def test_gaps_go_to_numpy(monkeypatch):
    x = np.linspace(-1, 1, 201)
    for text in ("1 / x > 2", "x != 0 -> F[0,3] 1 / x > 2"):
        for semantics in SEMANTICS:
            arguments = stl.parse(text), {"x": x}, "cut", semantics
            found, used = judged(monkeypatch, "whole", *arguments)
            assert found == judged(monkeypatch, "numpy", *arguments)[0]
            assert not all(used)
    large = {"x": np.array([1e308, -1e308, 0.0]), "y": np.array([-1e308, 1e308, 1.0])}
    arguments = stl.parse("F[0,1] x > y"), large, "cut"
    assert judged(monkeypatch, "whole", *arguments) == (judged(monkeypatch, "numpy", *arguments)[0], [False])


@pytest.mark.parametrize("end", ["error", "cut", "hold"])
@pytest.mark.parametrize("shape", [(200,), (3, 40), (2, 9000)])
def test_samples_are_checked_wherever_they_are(shape, end, tiles, monkeypatch):
    """A sample that is not finite is named, whichever the kernel reads it with; large ones are judged in numpy."""
    phi, rng = stl.parse("G[0,20] (x > 0.5 | F[0,3] y >= x)"), np.random.default_rng(0)
    for at in (0, 17, -1):
        for value in (np.nan, np.inf, -1e300):
            signals = {name: rng.random(shape) for name in "xy"}
            signals["y"].reshape(-1, shape[-1])[-1, at] = value
            for semantics in SEMANTICS:
                expected, _ = judged(monkeypatch, "numpy", phi, signals, end, semantics)
                assert judged(monkeypatch, "whole", phi, signals, end, semantics)[0] == expected
                assert isinstance(expected, str) == (value != -1e300)


def test_arrays_are_read_as_they_lie(monkeypatch):
    """Views of others in whole, what has to be converted in blocks."""
    phi, rng = stl.parse("F[0,9] (x > 0.3 & A)"), np.random.default_rng(0)
    x, A = rng.random((7, 90)), rng.random((7, 90)) < 0.5
    views = [
        ({"x": x[1::2, 3:], "A": A[::2, 3:][:3]}, ["whole"]),
        ({"x": np.broadcast_to(x[0], (5, 90)), "A": A[:5]}, ["whole"]),
        ({"x": x[:, ::-1], "A": A}, [True]),
        ({"x": x.astype(np.float32), "A": A}, [True]),
        ({"x": x.astype(">f8"), "A": A.astype(int)}, [True]),
        ({"x": x[:, :1], "A": A[:, :1]}, ["whole"]),
    ]
    for signals, used in views:
        expected = judged(monkeypatch, "numpy", phi, signals, "cut")[0]
        assert judged(monkeypatch, "whole", phi, signals, "cut") == (expected, used)


def test_what_looks_back_goes_to_numpy():
    for text, known in (("F[0,3] x > 0", True), ("once[0,3] x > 0", False), ("1 > 0 & x > 0", False)):
        assert compiled.compilable(offline.compile_formula(stl.parse(text))) is known


def test_the_compiler_is_loaded_once_it_pays(monkeypatch):
    monkeypatch.setattr(compiled, "_seen", 0)
    assert compiled.worthwhile(1)  # loaded here
    monkeypatch.delitem(sys.modules, "numba")
    assert not compiled.worthwhile(1000)
    assert compiled.worthwhile(compiled._MANY)
