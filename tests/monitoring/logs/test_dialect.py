"""How CSV files are written: headers, units, decimals and missing cells, by both readers, against the csv module."""

import csv
import gzip
import io
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FileError, SettingsError, TraceError
from stltool.monitoring.logs import text as text_logs
from tests.monitoring.logs.test_formats import plain

TRACE = {"x": ("f", ["1.0", "-2.5"]), "door": ("b", ["True", "False"])}


@pytest.fixture(params=["cells", "bytes"])
def load(request, tmp_path, monkeypatch):
    """A file of that text, read cell by cell and by the kernel."""
    monkeypatch.setattr(text_logs, "LARGE", 0 if request.param == "bytes" else 1 << 40)

    def loaded(content, names=("x", "door"), name="t.csv", **options):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return stl.load_trace(path, names, **options)

    return loaded


@pytest.mark.parametrize(
    "text",
    [
        "# recorded by hand\n# on a Monday\nx,door\n1,true\n-2.5,false\n",
        "#a, b\n\n# c\n\nx,door\n1,true\n-2.5,false\n",
        "# comment\n# x,door\n1,true\n-2.5,false\n",  # as numpy.savetxt writes the header
        "\ufeff#x;door\n1;true\n-2.5;false\n",
        "x,door\n[m/s],[-]\n1,true\n-2.5,false\n",
        "door,x\n-,km/h\ntrue,1\nfalse,-2.5\n",
        ",x,door\n0,1,true\n1,-2.5,false\n",  # as pandas writes its index
        "x,door,\n1,true,\n-2.5,false,\n",
        "x,door\n1,true,\n-2.5,false,\n",
        "x,door,,\n1,true,,\n-2.5,false,,\n",
        "x,door,,\n1,true\n-2.5,false,\n",
        "x,door,note,note\n1,true,a,b\n-2.5,false,c,d\n",
        "x,,door\n1,a,true\n-2.5,b,false\n",
        'x,note,door\n1,"a, ""b"" c",true\n-2.5,"",false\n',
        '"x","door"\n"1","true"\n"-2.5" ,"false"\n'.replace('" ,', '",'),
    ],
)
def test_ways_to_write_a_trace(load, text):
    assert plain(load(text)) == TRACE


def test_decimal_commas(load):
    assert plain(load("x;door\n1,0;true\n-2,5;false\n", decimal=",")) == TRACE
    assert plain(load("x\tdoor\n1,0\ttrue\n-2,5\tfalse\n", decimal=",", name="t.tsv")) == TRACE
    assert load("x\n1,5\n", ["x"], decimal=",")["x"].tolist() == [1.5]
    with pytest.raises(TraceError, match=r"line 2, column x: '2,5' is not a number; .* or read it with decimal=\",\""):
        load("x;door\n2,5;true\n")
    with pytest.raises(SettingsError, match="line 1: commas separate its cells, so they cannot be decimals, too"):
        load("x,door\n1,true\n", decimal=",")
    with pytest.raises(TraceError, match="line 3, column x: '2.5' has a decimal point, not a comma"):
        load("x;door\n1,5;true\n2.5;false\n", decimal=",")


def test_missing_cells(load):
    text = "x,door,y\n1,true,a\n,false,b\nNaN,true,c\n4,,d\n"
    with pytest.raises(
        TraceError, match='line 3, column x: an empty cell; every step needs one: missing="hold" repeats'
    ):
        load(text)
    with pytest.raises(TraceError, match="line 2, column x: 'nan' is not a finite number; every step needs a num"):
        load("x,door\nnan,true\n")
    assert plain(load(text, missing="hold")) == {
        "x": ("f", ["1.0", "1.0", "1.0", "4.0"]), "door": ("b", ["True", "False", "True", "True"])
    }  # fmt: skip
    assert plain(load(text, missing="drop")) == {"x": ("f", ["1.0"]), "door": ("b", ["True"])}
    assert load(text, ["door"], missing="drop")["door"].tolist() == [True, False, True]
    with pytest.raises(TraceError, match=r"row 1 \(line 2\), column x: no value, and none before it to hold"):
        load("x,door\n,true\n1,false\n", missing="hold")
    with pytest.raises(TraceError, match=r"\.csv: no row has a value of x"):
        load("x,door\n,true\nnan,false\n", missing="drop")
    with pytest.raises(TraceError, match="column x: 'inf' is not a finite number"):
        load("x,door\n1,true\ninf,false\n", missing="drop")
    timed = "t,x\n0,1\n0.1,\n0.2,3\n0.3,4\n"
    assert load(timed, ["x"], step="0.1s", missing="hold")["x"].tolist() == [1, 1, 3, 4]
    with pytest.raises(TraceError, match=r"rows 1 and 3 \(lines 2 and 4\): in column t they are 0.2s apart"):
        load(timed, ["x"], step="0.1s", missing="drop")
    assert load(timed, ["x"], step="0.1s", missing="drop", resample="linear")["x"].tolist() == [1, 2, 3, 4]


def test_a_row_of_units_gives_the_unit_of_the_time(load):
    text = "time,x\nms,m/s\n0,1\n100,2\n200,3\n"
    assert load(text, ["x"], step="0.1s")["x"].tolist() == [1, 2, 3]
    with pytest.raises(TraceError, match=r"rows 1 and 2 \(lines 3 and 4\): in column time they are 0.1s apart"):
        load(text, ["x"], step="1s")


def test_the_line_of_the_names_is_told_whatever_stands_between_it_and_the_rows(load):
    for text, line in (("x,x\nm,s\n1,2\n", 1), ("# by hand\nx,x\nm,s\n1,2\n", 2)):
        with pytest.raises(TraceError, match=f"line {line}: two columns are named x"):
            load(text, ["x"])


@pytest.mark.parametrize("row", ["n/a,true", "abc,true", "nan,-", "soon,later", "1,m/s"])
def test_a_row_of_values_is_never_taken_for_units(load, row):
    with pytest.raises(TraceError, match="line 2, column (x|door)"):
        load(f"x,door\n{row}\n1,true\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("# only a comment\n", "line 2 is empty|the file is empty"),
        ("# by hand\n1,2\n", "line 2: expected a name, found 1; put a line with the names of the columns first"),
        (",,\n1,2,3\n", "line 1: no column has a name"),
        ("x,door,x\n1,true,2\n", "line 1: two columns are named x"),
        ("x,door\n1,true,5\n", "line 2: 3 cells where the header names 2 columns"),
        ("x,door,\n1,true,\n2\n", "line 3: 1 cell where the header names 2 columns"),
        ("x,door\n1,true\n\n2,false\n", "line 3: an empty line between rows"),
    ],
)
def test_files_that_are_no_traces(load, text, says):
    with pytest.raises(TraceError, match=says):
        load(text)


def test_compressed_files_and_standard_input(load, tmp_path, monkeypatch):
    text = "x,door\n1,true\n-2.5,false\n"
    assert plain(load(gzip.compress(text.encode()), name="t.csv.gz")) == TRACE
    with pytest.raises(FileError, match="t.csv.gz: cannot be read as"):
        load(text, name="t.csv.gz")
    with pytest.raises(FileError, match="t.csv.gz: cannot be read as"):
        load(gzip.compress(text.encode() * 100)[:-9], name="t.csv.gz")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert plain(stl.load_trace("-", ["x", "door"])) == TRACE
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"")))
    with pytest.raises(TraceError, match="standard input: the file is empty"):
        stl.load_trace("-")


NUMBERS = st.floats(allow_nan=False, allow_infinity=False).map(repr) | st.from_regex(
    r"-?[0-9]{1,25}(\.[0-9]{0,25})?", fullmatch=True
)


@given(rows=st.lists(st.tuples(NUMBERS, NUMBERS, st.text('a," \n', max_size=5)), min_size=1, max_size=6),
       parts=st.integers(1, 40))  # fmt: skip
def test_parts_read_side_by_side_are_the_whole(tmp_path_factory, rows, parts):
    """Quoted notes with separators and line ends, divided among threads anywhere."""
    path = tmp_path_factory.mktemp("parts") / "t.csv"
    with path.open("w", newline="") as file:
        csv.writer(file, quoting=csv.QUOTE_ALL).writerows([("a", "b", "note"), *rows])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_logs, "LARGE", 0)
        patch.setattr(text_logs, "_PART", parts)
        patch.setattr(text_logs.os, "cpu_count", lambda: 4)
        found = stl.load_trace(path, ["b", "a"])
    for k, name in enumerate("ab"):
        np.testing.assert_array_equal(found[name], [float(row[k]) for row in rows])
