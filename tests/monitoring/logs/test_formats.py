"""Trace files: what is read, held against a slow and obvious reader, and what is said of files that are none."""

import csv
import io
import sys
import zipfile
from decimal import Context, Decimal
from fractions import Fraction
from unittest import mock

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FileError, MissingExtraError, NameLookupError, SizeError, StlToolError, TraceError
from stltool.monitoring.logs import npz as npz_logs
from stltool.monitoring.logs import parquet as parquet_logs
from stltool.monitoring.logs import text as text_logs


@pytest.fixture
def write(tmp_path):
    """A file of that content, text as UTF-8."""

    def written(content, name="t.csv"):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return written


def plain(signals):
    """Arrays as (type, values), so that they compare; nan equals nan."""
    return {name: (values.dtype.kind, [repr(v) for v in values.tolist()]) for name, values in signals.items()}


# ------------------------------------------------------------------------------------------------------------ CSV


@pytest.mark.parametrize(
    "text",
    [
        "x,door\n1,true\n-2.5e3,False\n",
        "\ufeffx,door\r\n1,true\r\n-2.5e3,False\r\n",
        "x ; door\n 1 ;TRUE \n -2.5e3; false\n\n\n",
        '\ufeff"x"\t "door" \n1\ttrue\n-2.5e3\tfalse',
        '"x" , "door"\n"1","true"\n "-2.5e3", "false"\n',
        "x,door\r1,tRuE\r-2.5e3,false\r\r",
        "x,door\n1,    true      \n-2.5e3,          false\n  \n",
        "x,door\n1,true\n-2.5e3,false\n\t\n",
    ],
)
def test_spellings_of_one_trace(write, text):
    signals = stl.load_trace(write(text))
    assert plain(signals) == {"x": ("f", ["1.0", "-2500.0"]), "door": ("b", ["True", "False"])}
    assert all(values.flags.c_contiguous and values.flags.writeable for values in signals.values())
    assert list(stl.load_trace(write(text), names=["door", "door"])) == ["door"]


def test_one_column_names_in_quotes_and_any_number(write):
    assert plain(stl.load_trace(write("x\n1\n0007\n+1.\n.5\n-2/4\n1e-999\n", "t.tsv"))) == {
        "x": ("f", ["1.0", "7.0", "1.0", "0.5", "-0.5", "0.0"])
    }
    assert list(stl.load_trace(write('"a, b";"c""d"; e f \n1;2;3\n'))) == ["a, b", 'c"d', "e f"]


def test_columns_that_nobody_asks_for_need_not_be_numbers(write):
    assert plain(stl.load_trace(write(b"x,note\n1,caf\xe9\n2,\xe9t\xe9\n"), ["x"])) == {"x": ("f", ["1.0", "2.0"])}
    lines = ["when,x,note,y,empty", "Mon,1,é,true,", "Tue,2,λ,2,", 'Wed,3,"a, b\nc",,']
    for many in (3, 4):
        path = write("\n".join(lines[:many]) + "\n")
        assert plain(stl.load_trace(path, ["x"])) == {"x": ("f", ["1.0", "2.0", "3.0"][: many - 1])}
        assert stl.load_trace(path, []) == {}
        with pytest.raises(TraceError, match="line 2, column when: 'Mon' is not a number"):
            stl.load_trace(path)
        with pytest.raises(TraceError, match="line 3, column y: '2' is neither true nor false, unlike the cells above"):
            stl.load_trace(path, ["x", "y"])
    with pytest.raises(NameLookupError, match=r"t.csv: there is no column nope; known names: empty, \"not\""):
        stl.load_trace(write("x,not,empty\n1,2,3\n"), ["x", "nope"])
    with pytest.raises(NameLookupError, match="there is no column Battery; did you mean battery?"):
        stl.load_trace(write("battery\n1\n"), ["Battery"])


@pytest.mark.parametrize(
    ("text", "kind", "says"),
    [
        ("", TraceError, "t.csv: the file is empty; write the names of the signals there, such as t,x,door"),
        ("\ufeff", TraceError, "the file is empty"),
        ("\n1,2\n", TraceError, "line 1 is empty; write the names of the signals"),
        ("x,y\n", TraceError, "no data below the header; write a row per step"),
        ("x,y\n \n\n", TraceError, "no data below the header"),
        ("1,2\n3,4\n", TraceError, "line 1: expected a name, found 1; put a line with the names of the columns first"),
        ("x,true\n3,4\n", TraceError, "line 1: expected a name, found true"),
        ("x,,y\n1,2,3\n", TraceError, "line 1: column 2 has no name; name it, or name the signals to read"),
        ("x,y, x\n1,2,3\n", TraceError, "line 1: two columns are named x; every column needs a name of its own"),
        ("x;y,z\n1;2,3\n", TraceError, "line 1: a comma and a semicolon could both separate the names; use one"),
        ('x,"y\n1,2\n', TraceError, "line 1: a quote is not closed; close it on the same line"),
        ("x,y\n1,2\n1\n", TraceError, "line 3: 1 cell where the header names 2 columns"),
        ("x,y\n1,2\n1,2,3\n1\n", TraceError, "line 3: 3 cells where the header names 2 columns"),
        ("x\n1\n1,2\n", TraceError, "line 3: 2 cells where the header names 1 column"),
        ("x,y\n1,2\n\n3,4\n", TraceError, "line 3: an empty line between rows; remove it, or write a row"),
        ("x,y\r\n1,2\r\n\r\n3,4\r\n", TraceError, "line 3: an empty line between rows"),
        ("x,y\r1,2\r\r3,4\r", TraceError, "line 3: an empty line between rows"),
        ("x,y\n1,2\n\n3,4\n\r\n", TraceError, "line 3: an empty line between rows"),
        ("x\n1\n  \n3\n", TraceError, "line 3: an empty line between rows"),
        ("x,y\n1,2\n1,\t\n", TraceError, "line 3, column y: an empty cell"),
        ("x,y\n1,2\n1,\n", TraceError, "line 3, column y: an empty cell; every step needs one"),
        ("x\ty\n1\t2\n \t1\n", TraceError, "line 3, column x: an empty cell; every step needs one"),
        ("x,y\n1,2\n1,2.5.1\n", TraceError, "line 3, column y: '2.5.1' is not a number"),
        ("x,y\n1,2\n1_0,1\n", TraceError, "line 3, column x: '1_0' is not a number"),
        ("x,y\n1,2\n٣,1\n", TraceError, "line 3, column x: '٣' is not a number"),
        ("x,y\n1,2\n0x10,1\n", TraceError, "line 3, column x: '0x10' is not a number"),
        ("x;y\n1;2\n1;2,5\n", TraceError, "line 3, column y: '2,5' is not a number; write it with a decimal point"),
        ("x,y\n1,2\n1,True\n", TraceError, "line 3, column y: 'True' is not a number, unlike the cells above; write"),
        ("x\ntrue\nfalsehood\n", TraceError, "line 3, column x: 'falsehood' is neither true nor false"),
        (f"x\n1\n{'a' * 40} \n", TraceError, f"line 3, column x: '{'a' * 40}' is not a number"),
        (f"x\n1\n{'a' * 50}\n", TraceError, f"line 3, column x: '{'a' * 40}…' is not a number"),
        ('x,y\n"1",2\n3,"4\n', TraceError, "line 3: unexpected end of data; close every quote"),
        ('x,y\n"1"0,2\n', TraceError, "line 2: ',' expected after"),
        ('x,y\n1,2\n"1"0,2\n', TraceError, "line 3: ',' expected after '\"'; close every quote"),
        ("x,y\n1,2\n3,\0\n", FileError, "not a CSV file: it contains binary data (a zero byte at offset 10)"),
        ("x\0,y\n1,2\n", FileError, "not a CSV file: it contains binary data (a zero byte in line 1)"),
        (b"x,y\n1,2\n3,\xe9\n", TraceError, "line 3, column y: '\\udce9' is not a number"),
        (b"x,\xe9\n1,2\n", FileError, "not a CSV file: byte 0xe9 in line 1 is not UTF-8 text; save it as UTF-8"),
        (b"x,\x80\n1,2\n", FileError, "not a CSV file: byte 0x80 in line 1"),
        (b"x,\xff\n1,2\n", FileError, "not a CSV file: byte 0xff in line 1"),
        (b"\xff\xfex\0,\0y\0\n\0", FileError, "not a CSV file: it contains binary data (a zero byte in line 1)"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_place(write, text, kind, says):
    path = write(text)
    with pytest.raises(kind) as refused:
        stl.load_trace(path)
    assert says in str(refused.value)
    assert str(refused.value).startswith(str(path))


def test_a_decimal_comma_is_told_from_other_slips(write):
    with pytest.raises(TraceError, match=r"'1,000,5' is not a number$"):
        stl.load_trace(write("x;y\n1;2\n1;1,000,5\n"))


def test_a_header_without_end(write):
    with pytest.raises(FileError, match="line 1 has over a million characters; it should name the signals"):
        stl.load_trace(write("x," * 600_000))


CELLS = st.sampled_from(
    ["0", "1.5", "-2e3", " 7 ", "nan", "Inf", "true", "FALSE", " true", "", " ", "x", "1_0", "é", '"1"', '"a,b"',
     '"', "\t", "1,5", "true\xa0", "\xa01", "falsehood", "\x0b1", "1\x1c", "#", "'"]
)  # fmt: skip
NAMES = ("a", "b", "c")


def slow_reader(text, names):
    """Line by line with the csv module: what the cells say, or None where any is wrong. No message, no speed."""
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True))
    except csv.Error:
        return None
    while rows and len(rows[-1]) <= 1 and not "".join(rows[-1]).strip():
        rows.pop()
    header, *rows = rows
    rows = [row[: len(header)] if not "".join(row[len(header) :]).strip() else row for row in rows]
    if not rows or any(len(row) != len(header) for row in rows):
        return None
    if len(header) == 1 and any(not row[0].strip() for row in rows):
        return None
    signals = {}
    for i, name in enumerate(header):
        if name not in names:
            continue
        cells = [row[i].strip() for row in rows]
        if cells[0].lower() in ("true", "false"):
            if any(cell.lower() not in ("true", "false") for cell in cells):
                return None
            signals[name] = np.array([cell.lower() == "true" for cell in cells])
        else:
            try:
                if any("_" in cell or not cell.isascii() for cell in cells):
                    return None
                signals[name] = np.array([float(Fraction(cell) if "/" in cell else cell) for cell in cells])
            except (ValueError, ZeroDivisionError):
                return None
            if not np.isfinite(signals[name]).all():
                return None
    return plain(signals)


@given(
    width=st.integers(1, 3),
    rows=st.lists(st.lists(CELLS, min_size=1, max_size=3) | st.just([]), min_size=1, max_size=5),
    square=st.booleans(),
    names=st.lists(st.sampled_from(NAMES), unique=True),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    end=st.sampled_from(["", "\n", "\r\n\r\n", "\n \n"]),
)
@example(1, [["true"], ["    true    "], ["false"]], False, ["a"], "\n", "")
@example(1, [["\xa01"], ['"2"']], False, ["a"], "\n", "")
@example(2, [["1", "x"], ["2", "é"]], False, ["a"], "\n", "\n")
@example(2, [["1", '"'], ["2", '"']], False, ["a"], "\n", "\n")
def test_the_reader_agrees_with_a_slow_one(tmp_path_factory, width, rows, square, names, newline, end):
    if square:  # else most files would be refused for their rows' lengths
        rows = [(row + ["1"] * width)[:width] for row in rows]
    text = newline.join([",".join(NAMES[:width]), *map(",".join, rows)]) + end
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    path.write_bytes(text.encode())
    names = [name for name in names if name in NAMES[:width]]
    for large in (0, text_logs.LARGE):  # the kernel first, and cell by cell
        with mock.patch.object(text_logs, "LARGE", large):
            try:
                found = plain(stl.load_trace(path, names))
            except StlToolError:
                found = None
        if found is None or names:
            assert found == slow_reader(text, names)


def test_large_files_are_read_by_the_kernel(write, monkeypatch):
    monkeypatch.setattr(text_logs, "LARGE", 0)
    monkeypatch.setattr(text_logs._Table, "_read_cells", None)
    values = np.random.default_rng(0).normal(size=1000)
    for before in ("", "\ufeff"):
        text = before + "".join(f'{a},{b},"c"\n'.replace('"' if i else "", "") for i, (a, b) in enumerate(zip(
            ["x", *map(repr, values.tolist())], ["door", *np.where(values > 0, "True ", "false").tolist()], strict=True
        )))  # fmt: skip
        signals = stl.load_trace(write(text + "\n\n"), ["x", "door"])
        np.testing.assert_array_equal(signals["x"], values)
        np.testing.assert_array_equal(signals["door"], values > 0)


# ---------------------------------------------------------------------------------------------------- npz, Parquet


def npz(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_npz_single_traces_and_batches(tmp_path):
    single = npz(tmp_path / "t.npz", x=np.arange(3), door=np.array([True, False, True]), y=np.float32([0.5, 1, 2]))
    assert plain(stl.load_trace(single)) == {
        "x": ("i", ["0", "1", "2"]), "door": ("b", ["True", "False", "True"]), "y": ("f", ["0.5", "1.0", "2.0"])
    }  # fmt: skip
    np.savez_compressed(tmp_path / "b.npz", x=np.asfortranarray(np.ones((2, 3), ">f8")), when=np.array(["a"]))
    batch = stl.load_trace((tmp_path / "b.npz").rename(tmp_path / "b.NPZ"), ["x"])
    assert plain(batch) == {"x": ("f", ["[1.0, 1.0, 1.0]"] * 2)}


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        (
            {"x": np.array([1, "a"], dtype=object)},
            "array x: it contains Python objects, which are never",
        ),
        ({"x": np.array(["a"])}, "array x: it contains <U1; save numbers or Booleans"),
        ({"x": np.ones(2, complex)}, "array x: it contains complex128; save numbers"),
        ({"x": np.float64(1)}, "array x: its shape is (); (n_steps,) or (n_traces, n_steps) is needed"),
        ({"x": np.ones((1, 2, 3))}, "array x: its shape is (1, 2, 3); (n_steps,) or (n_traces, n_steps) is needed"),
        ({"x": np.ones((0, 3))}, "array x: its shape is (0, 3); it contains no sample"),
        (
            {"x": np.ones(3), "y": np.ones((2, 3))},
            "array y: its shape is (2, 3), that of x is (3,); give all",
        ),
    ],
)
def test_arrays_that_are_no_signals_are_refused_by_name(tmp_path, arrays, says):
    with pytest.raises(TraceError) as refused:
        stl.load_trace(npz(tmp_path / "t.npz", **arrays))
    assert says in str(refused.value)
    ok = npz(tmp_path / "ok.npz", fine=np.ones(3), **arrays)  # where nobody asks for them they do no harm
    assert list(stl.load_trace(ok, ["fine"])) == ["fine"]


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (np.array([1, 2, np.nan, np.inf]), "t.npz, array x, step 2: nan is not a finite number; every step needs a"),
        (np.float16([[1, 2], [-np.inf, 2]]), "t.npz, array x, trace 1, step 0: -inf is not a finite number"),
    ],
)
def test_what_is_not_finite_in_an_npz_is_told_with_its_place(tmp_path, bad, says):
    with pytest.raises(TraceError) as refused:
        stl.load_trace(npz(tmp_path / "t.npz", x=bad))
    assert says in str(refused.value)
    assert stl.load_trace(npz(tmp_path / "t.npz", x=bad, y=np.ones(bad.shape)), ["y"])["y"].all()


def test_files_that_are_no_npz(tmp_path, write):
    with pytest.raises(FileError, match="not an .npz file; write one with numpy.savez"):
        stl.load_trace(write("x\n1\n", "t.npz"))
    with zipfile.ZipFile(tmp_path / "z.npz", "w") as archive:
        archive.writestr("notes.txt", "no array")
    with pytest.raises(FileError, match="cannot be read as an .npz file"):
        stl.load_trace(tmp_path / "z.npz")
    whole = bytearray(npz(tmp_path / "t.npz", x=np.arange(100.0)).read_bytes())
    whole[400] ^= 255
    with pytest.raises(FileError, match="cannot be read as an .npz file: Bad CRC-32"):
        stl.load_trace(write(bytes(whole), "broken.npz"))
    with pytest.raises(NameLookupError, match="there is no array y; known names: x"):
        stl.load_trace(tmp_path / "t.npz", ["y"])


def parquet(path, **columns):
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    from pyarrow import parquet

    parquet.write_table(pa.table(columns), path)
    return path


def test_parquet(tmp_path):
    dotted = {"a.b": np.float32([0.5, 1])}
    decimals = [Decimal("0.25"), Decimal(3)]
    path = parquet(tmp_path / "t.parquet", x=[1, 2], door=[True, False], d=decimals, when=["a", None], **dotted)
    assert plain(stl.load_trace(path, ["door", "x", "a.b", "d"])) == {
        "door": ("b", ["True", "False"]), "x": ("i", ["1", "2"]), "a.b": ("f", ["0.5", "1.0"]),
        "d": ("f", ["0.25", "3.0"]),
    }  # fmt: skip
    with pytest.raises(TraceError, match="column when: it contains string; write numbers or Booleans"):
        stl.load_trace(path)
    with pytest.raises(NameLookupError, match="there is no column door2; did you mean door?"):
        stl.load_trace(path, ["door2"])


@pytest.mark.parametrize(
    ("width", "precision", "scale"),
    [
        (32, 9, 2),
        (32, 9, 9),
        (64, 18, 2),
        (64, 18, 7),
        (128, 12, 2),
        (128, 38, 19),
        (128, 38, 38),
        (256, 76, 0),
        (256, 76, 40),
    ],
)
def test_parquet_decimals_are_the_nearest_doubles(tmp_path, monkeypatch, width, precision, scale):
    """Against Python's own: arrow's cast of decimals to doubles is off by one unit in the last place now and then."""
    import pyarrow as pa

    rng = np.random.default_rng(width + scale)
    lengths = rng.integers(1, precision + 1, 3000)
    texts = ["".join(map(str, rng.integers(0, 10, n))) for n in lengths]
    cents = ["369420", "0", "9" * precision, "1", *(str(n) for n in range(1000))]
    given_values = [
        Decimal(sign + digits).scaleb(-scale, Context(prec=100)) for sign in ("", "-") for digits in (*texts, *cents)
    ]
    column = pa.array(given_values, getattr(pa, f"decimal{width}")(precision, scale))
    path = parquet(tmp_path / "t.parquet", x=pa.chunked_array([column.slice(0, 7), column.slice(7)]))
    monkeypatch.setattr(parquet_logs, "_PIECE", 1000)
    assert stl.load_trace(path)["x"].tolist() == [float(value) for value in given_values]
    with pytest.raises(TraceError, match="row 2, column x: no value"):
        stl.load_trace(parquet(tmp_path / "t.parquet", x=pa.array([given_values[0], None], column.type)))


def test_a_parquet_price_is_what_it_says(tmp_path):
    path = parquet(tmp_path / "t.parquet", x=[Decimal("3694.20")])
    assert stl.monitor(stl.parse("x <= 3694.2"), stl.load_trace(path)).verdicts.all()


@pytest.mark.parametrize("kind", ["int64", "uint64"])
def test_parquet_integers_that_are_no_doubles(tmp_path, kind):
    path = parquet(tmp_path / "t.parquet", x=np.array([5, 2**53 + 1], kind))
    with pytest.raises(TraceError, match="signal x is 9007199254740993 at step 1: integers beyond"):
        stl.monitor(stl.parse("x > 0"), stl.load_trace(path))


def test_parquet_that_is_no_trace(tmp_path, write):
    gaps = parquet(
        tmp_path / "gaps.parquet", x=[1.0, 2.0, None, None], door=[True, None, True, True], y=[float("nan")] * 4
    )
    with pytest.raises(TraceError, match="row 3, column x: no value; every step needs one"):
        stl.load_trace(gaps)
    with pytest.raises(TraceError, match="row 2, column door: no value"):
        stl.load_trace(gaps, ["door"])
    with pytest.raises(TraceError, match="row 1, column y: nan is not a finite number; every step needs a number"):
        stl.load_trace(gaps, ["y"])
    with pytest.raises(TraceError, match="it contains no rows; write a row per step"):
        stl.load_trace(parquet(tmp_path / "none.parquet", x=np.array([], float)))
    with pytest.raises(TraceError, match="column x: it contains list<"):
        stl.load_trace(parquet(tmp_path / "lists.parquet", x=[[1, 2]]))
    with pytest.raises(FileError, match="cannot be read as a Parquet file: "):
        stl.load_trace(write("x\n1\n", "t.parquet"))
    import pyarrow as pa
    from pyarrow import parquet as pq

    twice = pa.table([[1], [2]], names=["x", "x"])
    pq.write_table(twice, tmp_path / "twice.parquet")
    with pytest.raises(TraceError, match="two columns are named x"):
        stl.load_trace(tmp_path / "twice.parquet", ["x"])


def test_parquet_without_pyarrow(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    says = r"Parquet needs the package pyarrow, .*; pip install 'stltool\[parquet\]', or write the trace"
    with pytest.raises(MissingExtraError, match=says):
        stl.load_trace(write("", "t.parquet"))


# ------------------------------------------------------------------------------------------------------------ any


def test_files_that_are_none(tmp_path, write):
    with pytest.raises(FileError, match=r"t.xlsx: not a trace file; traces are read from .csv, .tsv, .npz"):
        stl.load_trace(write("", "t.xlsx"))
    for ending in (".csv", ".npz", ".parquet"):
        with pytest.raises(FileError, match=f"none{ending}: there is no such trace file"):
            stl.load_trace(tmp_path / f"none{ending}")
        (tmp_path / f"folder{ending}").mkdir()
        with pytest.raises(FileError, match=f"folder{ending}: this trace file cannot be read: it is not a regular"):
            stl.load_trace(tmp_path / f"folder{ending}")


@pytest.mark.soak(only=True)
def test_what_would_not_fit_is_refused_before_it_is_read(tmp_path, write, monkeypatch):
    """The memory asked for follows the columns that are read; of npz and Parquet it is known exactly."""
    asked = []
    for module in (npz_logs, text_logs):
        monkeypatch.setattr(module, "require_memory", lambda needed, *_: asked.append(needed))
    npz_file = npz(tmp_path / "t.npz", x=np.ones(1000), y=np.ones(1000, np.int16), door=np.ones(1000, bool))
    stl.load_trace(npz_file)
    assert asked == [8000 + 2000 + 1000]
    for end in ("\n", "\r\n", "\r"):
        csv_file = write(f"x,y,note{end}" + f"1.5,2.5,ab{end}" * 10_000)
        stl.load_trace(csv_file, ["x", "y"])
        assert asked.pop() == pytest.approx(10_000 * (8 + 8) * 2.5, rel=1e-3)
    wide = write(",".join(f"x{i}" for i in range(50_000)) + "\n" + ",".join("1" * 50_000) + "\n")
    assert len(stl.load_trace(wide)) == 50_000
    assert 50_000 * 8 * 2.5 <= asked.pop() <= 50_000 * 8 * 2.5 * 2


def test_so_it_is_of_parquet(tmp_path, monkeypatch):
    asked = []
    path = parquet(tmp_path / "t.parquet", x=[1.0] * 1000, y=[1.0] * 1000, z=[1.0] * 1000)
    monkeypatch.setattr(parquet_logs, "require_memory", lambda needed, *_: asked.append(needed))
    stl.load_trace(path, ["x", "z"])
    assert asked == [1000 * 2 * 8 * 2.5]


@pytest.mark.parametrize("name", ["t.csv", "t.npz", "t.parquet"])
def test_nothing_is_read_then(tmp_path, write, monkeypatch, name):
    if name == "t.csv":
        path = write("x\n1\n2\n", name)
    else:
        path = (npz if name == "t.npz" else parquet)(tmp_path / name, x=np.ones(2))
    monkeypatch.setattr("stltool.sizes.memory_limit", lambda limit: 10)
    monkeypatch.setattr("stltool.sizes._LITTLE", 0)
    with pytest.raises(
        SizeError, match=r"of memory; 10 B may be used; give a shorter part of the trace, or name fewer"
    ):
        stl.load_trace(path)


@pytest.mark.parametrize("cell", ["true    garbage", "false\t\t\t1", "true     x"])
def test_nothing_behind_a_label_is_dropped(tmp_path, cell):
    path = tmp_path / "t.csv"
    path.write_text(f"A,x\ntrue,1\n{cell},2\n")
    with pytest.raises(TraceError, match="line 3, column A"):
        stl.load_trace(path)
    path.write_text("A,x\ntrue,1\n  true     ,2\n")
    assert stl.load_trace(path)["A"].tolist() == [True, True]
