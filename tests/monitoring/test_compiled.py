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


def judged(monkeypatch, quickly, *arguments):
    """Bytes of verdicts and robustness, or the message; whether the kernel was used throughout."""
    used = []

    def judge(*given):
        used.append(_judge_quickly(*given))
        return used[-1]

    with monkeypatch.context() as patch:
        patch.setattr(offline, "worthwhile", lambda samples: quickly)
        patch.setattr(offline, "judge_quickly", judge)
        try:
            found = stl.monitor(*arguments)
        except stl.StlToolError as error:
            return str(error), used
    return [None if one is None else (one.shape, one.tobytes()) for one in (found.verdicts, found.robustness)], used


_judge_quickly = offline.judge_quickly


@given(
    phi=formulas(longest=6, max_leaves=6),
    n=st.integers(1, 40),
    rows=st.integers(1, 5),
    end=st.sampled_from(["error", "cut", "hold"]),
    semantics=st.sampled_from(SEMANTICS),
    data=st.data(),
)
def test_the_kernel_finds_what_numpy_finds(phi, n, rows, end, semantics, data):
    drawn = [data.draw(traces(n)) for _ in range(rows)]
    batch = {name: np.stack([one[name] for one in drawn]) for name in drawn[0]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passes, "TILE", data.draw(st.sampled_from([4, 16, 1024])))
        patch.setattr(offline, "SAMPLES", data.draw(st.sampled_from([8, 1 << 16])))
        expected, _ = judged(patch, False, phi, batch, end, semantics)
        assert judged(patch, True, phi, batch, end, semantics)[0] == expected


LONG = [
    "always[0,50](eventually[0,20](x > 0.5) and eventually[0,20](y > 0.5))",
    "(x < y) U[3,17] (-y <= -0.25 & !A)",
    "(x == 0.5) <-> F[2,9] (y != 0.5 | A)",
    "G[0,5] F[0,300] (0.02 > x)",
    "true U[0,4] (x + y > 0.7)",
    "G[0,7] (x * y <= 0.25)",
    "-0 < x -> G[1,4] (x >= 0)",
]


@pytest.mark.parametrize("text", LONG)
@pytest.mark.parametrize("end", ["error", "cut", "hold"])
def test_long_traces_and_borders(text, end, tiles, monkeypatch):
    """Samples are decimals of one place, so that margins are 0 often, and truth has to be computed by itself."""
    phi, rng = stl.parse(text), np.random.default_rng(0)
    for shape in ((3000,), (40, 320)):
        signals = {"x": rng.random(shape).round(1), "y": rng.random(shape).round(1), "A": rng.random(shape) < 0.1}
        for semantics in SEMANTICS:
            expected, _ = judged(monkeypatch, False, phi, signals, end, semantics)
            found, used = judged(monkeypatch, True, phi, signals, end, semantics)
            assert found == expected
            assert used
            assert all(used)


def test_gaps_go_to_numpy(monkeypatch):
    x = np.linspace(-1, 1, 201)
    for text in ("1 / x > 2", "x != 0 -> F[0,3] 1 / x > 2"):
        for semantics in SEMANTICS:
            arguments = stl.parse(text), {"x": x}, "cut", semantics
            found, used = judged(monkeypatch, True, *arguments)
            assert found == judged(monkeypatch, False, *arguments)[0]
            assert not all(used)
    large = {"x": np.array([1e308, -1e308, 0.0]), "y": np.array([-1e308, 1e308, 1.0])}
    arguments = stl.parse("F[0,1] x > y"), large, "cut"
    assert judged(monkeypatch, True, *arguments) == (judged(monkeypatch, False, *arguments)[0], [False])


def test_what_looks_back_goes_to_numpy():
    for text, known in (("F[0,3] x > 0", True), ("once[0,3] x > 0", False), ("1 > 0 & x > 0", False)):
        assert compiled.compilable(offline.compile_formula(stl.parse(text))) is known


def test_the_compiler_is_loaded_once_it_pays(monkeypatch):
    monkeypatch.setattr(compiled, "_seen", 0)
    assert compiled.worthwhile(1)  # loaded here
    monkeypatch.delitem(sys.modules, "numba")
    assert not compiled.worthwhile(1000)
    assert compiled.worthwhile(compiled._MANY)
