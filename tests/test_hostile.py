"""Mutated files of every format: each is read rightly or refused with its name, whatever its bytes.

They are fuzzed with coverage, too (bench/fuzz_*.py).
"""

import gzip
import zipfile

import numpy as np
import pytest

import stltool as stl
from stltool.errors import StlToolError
from stltool.reporting.page import load_report
from tests.conftest import PATROLLING, many

PIECES = [
    b"", b"0", b"-1", b"1e999", b"nan", b"null", b"[]", b"{}", b'"', b",", b"\n", b"\x00", b"\xff\xfe", b"[[[[",
    b"99999999999999999999", b"\x1b[31m", b"1_0", "é".encode(), b"<script>", b"true", b"-0", b"\xf0\x9f",
]  # fmt: skip


def mutations(seed, data, count):
    """Copies of the bytes with one to four pieces cut out, replaced, repeated or put in."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        found = bytearray(data)
        for _ in range(rng.integers(1, 5)):
            at, cut = int(rng.integers(len(found) + 1)), int(rng.integers(12))
            kind = rng.integers(5)
            if kind == 0:
                del found[at:]
            elif kind == 1:
                found[at:at] = found[at : at + 40]
            elif kind == 2 and found:
                found[at % len(found)] ^= 1 << int(rng.integers(8))
            else:
                found[at : at + cut] = PIECES[rng.integers(len(PIECES))]
        yield bytes(found)


def trace():
    return {"x": np.arange(6) / 4, "door": np.array([0, 1, 1, 0, 1, 1], bool), "height": np.arange(6.0)}


def csv(folder):
    signals = trace()
    rows = [",".join(signals), *(",".join(str(float(v)) for v in row) for row in zip(*signals.values(), strict=True))]
    (folder / "a.csv").write_text("\n".join(rows))


def packed(folder):
    csv(folder)
    (folder / "a.csv.gz").write_bytes(gzip.compress((folder / "a.csv").read_bytes(), mtime=0))


def parquet(folder):
    arrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(arrow.table(trace()), folder / "a.parquet")


def product():
    task = stl.load_task(PATROLLING, params={"T": 2, "tau": 5})
    return stl.build_product(stl.load_model(task.model), task)


def report(folder):
    stl.report(stl.check(product()), path=folder / "a.html")


FILES = {
    "a.csv": (csv, stl.load_trace),
    "a.csv.gz": (packed, stl.load_trace),
    "a.npz": (lambda folder: np.savez(folder / "a.npz", **trace()), stl.load_trace),
    "a.parquet": (parquet, stl.load_trace),
    "a.json": (report, load_report),
}


@pytest.mark.soak
@pytest.mark.parametrize("name", FILES)
def test_mutated_files_are_read_or_refused(name, tmp_path):
    make, read = FILES[name]
    make(tmp_path)
    file = tmp_path / name
    whole = file.read_bytes()
    read(file)
    refused = 0
    for data in mutations(1, whole, many(200)):
        file.write_bytes(data)
        try:
            read(file)
        except StlToolError as error:
            refused += 1
            assert name in str(error), data
    assert refused


@pytest.mark.parametrize("load", [stl.load_task, stl.load_model, stl.load_trace])
@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "loop"])
def test_names_that_no_file_has(load, name, tmp_path):
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    with pytest.raises(StlToolError):
        load(tmp_path / f"{name}.csv")


@pytest.mark.parametrize("header", ["{'shape': (3, }", "[" * 200, "{'descr': '<f8'}", "3", "é", "{'descr': [], 1: 2}"])
def test_headers_of_arrays_that_are_no_headers(header, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        text = f"{header}\n".encode()
        archive.writestr("x.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text)
    with pytest.raises(StlToolError, match="a.npz: cannot be read as an .npz file"):
        stl.load_trace(tmp_path / "a.npz")


def test_names_of_columns_that_are_not_utf8(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    path = tmp_path / "a.parquet"
    pytest.importorskip("pyarrow.parquet").write_table(arrow.table({"abc": [1.0, 2.0]}), path)
    path.write_bytes(path.read_bytes().replace(b"abc", b"\xff\xfe\xfd"))
    with pytest.raises(StlToolError, match=r"a\.parquet: cannot be read as a Parquet file"):
        stl.load_trace(path)
