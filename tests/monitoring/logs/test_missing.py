"""Samples without a value in Parquet and .npz files, held or left out."""

import numpy as np
import pytest

import stltool as stl
from stltool.errors import TraceError
from tests.monitoring.logs.test_formats import npz, parquet, plain


def test_parquet(tmp_path):
    columns = {"t": [0, 0.1, 0.2, 0.3], "x": [1.0, None, float("nan"), 4.0], "door": [True, False, None, True]}
    path = parquet(tmp_path / "t.parquet", **columns, n=[1, None, 3, 4])
    held = stl.load_trace(path, ["x", "door", "n"], step="0.1s", missing="hold")
    assert plain(held) == {
        "x": ("f", ["1.0", "1.0", "1.0", "4.0"]), "door": ("b", ["True", "False", "False", "True"]),
        "n": ("i", ["1", "1", "3", "4"]),
    }  # fmt: skip
    left = stl.load_trace(path, ["x", "door"], time="none", missing="drop")
    assert plain(left) == {"x": ("f", ["1.0", "4.0"]), "door": ("b", ["True", "True"])}
    with pytest.raises(TraceError, match="rows 1 and 4: in column t they are 0.3s apart; the step is 0.1s"):
        stl.load_trace(path, ["x", "door"], step="0.1s", missing="drop")


def test_npz(tmp_path):
    x = np.array([[1, np.nan, 3], [4, 5, np.nan]])
    path = npz(tmp_path / "b.npz", x=x)
    assert stl.load_trace(path, missing="hold")["x"].tolist() == [[1, 1, 3], [4, 5, 5]]
    with pytest.raises(TraceError, match=r"b\.npz: x has samples without a value in a batch, whose traces must be"):
        stl.load_trace(path, missing="drop")
    with pytest.raises(TraceError, match="array x, trace 1, step 0: no value, and none before it to hold"):
        stl.load_trace(npz(tmp_path / "c.npz", x=x[:, ::-1] * [[1], [1]]), missing="hold")
    assert stl.load_trace(npz(tmp_path / "s.npz", x=x[0]), missing="drop")["x"].tolist() == [1, 3]
