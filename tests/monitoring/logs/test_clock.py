"""The clock of a log: whether its times fit the step, and what is on the step's grid, held against fractions."""

import warnings
from datetime import datetime, timedelta
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import NameLookupError, SettingsError, SizeError, TraceError, UnusedTimeWarning
from tests.monitoring.logs.test_formats import npz, parquet, plain


@pytest.fixture
def log(tmp_path):
    """A CSV file of columns."""

    def written(name="log.csv", **columns):
        path = tmp_path / name
        rows = zip(*columns.values(), strict=True)
        path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
        return path

    return written


def fits(times, step, tolerance):
    """The definition, in fractions."""
    steps = [(time - times[0]) / step for time in times]
    return all(b > a for a, b in pairwise(steps)) and all(abs(at - i) <= tolerance for i, at in enumerate(steps))


def on_grid(times, values, step, tolerance, how):
    """The definition, in fractions: a sample on every step of the grid."""
    steps = [(time - times[0]) / step for time in times]
    found, k = [], 0
    while k <= steps[-1] + tolerance:
        before = max(i for i, at in enumerate(steps) if at <= k)
        after = min(before + 1, len(steps) - 1)
        if abs(steps[before] - k) <= tolerance:
            found.append(values[before])
        elif abs(steps[after] - k) <= tolerance:
            found.append(values[after])
        elif how == "hold":
            found.append(values[before])
        else:
            share = (k - steps[before]) / (steps[after] - steps[before])
            found.append(values[before] + (values[after] - values[before]) * share)
        k += 1
    return found


MILLIS = st.lists(st.integers(1, 400), min_size=1, max_size=8)


@given(gaps=MILLIS | st.lists(st.integers(97, 103), min_size=1, max_size=8), start=st.integers(-10**6, 10**6),
       tolerance=st.sampled_from([0, 10, 50]), dated=st.booleans())  # fmt: skip
def test_times_against_the_definition(tmp_path_factory, gaps, start, tolerance, dated):
    """Gaps in milliseconds, a step of 0.1 s, a tolerance in thousandths of it."""
    millis = np.cumsum([start, *gaps])
    times = [Fraction(int(one), 1000) for one in millis]
    values = [float(i * i) for i in range(len(times))]
    path = tmp_path_factory.mktemp("clock") / "t.npz"
    npz(path, x=values, t=millis.astype("M8[ms]") if dated else millis / 1000, door=[v % 2 == 0 for v in values])
    options = {"step": "0.1s", "tolerance": tolerance / 1000}
    try:
        accepted = stl.load_trace(path, ["x"], **options)["x"].tolist() == values
    except TraceError as error:
        accepted = False
        assert "times must increase" in str(error) or "puts the signals on the step's grid" in str(error)
    assert accepted is fits(times, Fraction(1, 10), Fraction(tolerance, 1000))
    for how in ("hold", "linear"):
        signals = stl.load_trace(path, ["x", "door"], resample=how, **options)
        expected = on_grid(times, values, Fraction(1, 10), Fraction(tolerance, 1000), how)
        np.testing.assert_allclose(signals["x"], [float(v) for v in expected], rtol=1e-12)
        held = on_grid(times, [v % 2 == 0 for v in values], Fraction(1, 10), Fraction(tolerance, 1000), "hold")
        assert signals["door"].tolist() == held


def test_samples_on_the_grid_are_taken_as_they_are(log):
    """Their decimals: 0.3 is at three steps of 0.1 although doubles say otherwise."""
    path = log(t=[f"{i / 10}" for i in range(30)], x=[f"{i}.1" for i in range(30)])
    for how in ("hold", "linear"):
        assert stl.load_trace(path, ["x"], step="0.1s", resample=how)["x"].tolist() == [i + 0.1 for i in range(30)]


def test_zones_may_have_minutes(log):
    """Noon in Nepal is a quarter past six in Greenwich; half past eight in Newfoundland is noon there."""
    times = [
        "2026-03-01 12:00:00+05:45",
        "2026-03-01 06:15:00.1Z",
        "2026-03-01 02:45:00.2-0330",
        "2026-03-01 08:15:00.3+02",
    ]
    path = log(t=times, x=[1, 2, 3, 4])
    assert stl.load_trace(path, ["x"], step="0.1s")["x"].tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (["0", "0.1", "0.1", "0.3"], "rows 2 and 3 (lines 3 and 4): column t goes from 0.1s to 0.1s"),
        (["0", "0.2", "0.1"], "rows 2 and 3 (lines 3 and 4): column t goes from 0.2s to 0.1s; times must increase"),
        (["0", "0.1", "0.3", "0.4"], "rows 2 and 3 (lines 3 and 4): in column t they are 0.2s apart; the step is"),
        (["0", "0.1", "0.2", "0.3012"], "rows 3 and 4 (lines 4 and 5): in column t they are 0.1012s apart"),
        ([f"{i * 0.1002:.4f}" for i in range(9)], "row 7 (line 8): in column t it is 0.012 of a step away from step 6"),
        (["0", "100", "200"], "(if the column is in ms, give time=\"t [ms]\")"),
        (["0", "0.1", ""], "line 4, column t: an empty cell; every row needs a time"),
        (["0", "soon", "0.2"], "line 3, column t: 'soon' is not a time; write seconds, or dates such as 2026"),
        (["2026-03-01 12:00:00", "2026-03-01T12:00:00.100Z"], "column t: '2026-03-01T12:00:00.100Z' names a time zone"),
        (["2026-03-01", "2026-02-30"], "line 3, column t: '2026-02-30' is not a date"),
        (["2026-03-01", "01.03.2026"], "line 3, column t: '01.03.2026' is not a date such as"),
    ],
)  # fmt: skip
def test_times_at_fault_are_told_with_their_rows(log, times, says):
    with pytest.raises(TraceError) as refused:
        stl.load_trace(log(t=times, x=[1] * len(times)), ["x"], step="0.1s")
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("time", [5, 5.1, 5.2]), ("T", [0, 0.1, 0.2]), ("Timestamp", [0, 0.1, 0.2]), ("t [ms]", [3, 103, 203]),
        ("Time (us)", [0, 100000, 200000]), ("timestamp[ns]", [10**18, 10**18 + 10**8, 10**18 + 2 * 10**8]),
        ("time (min)", [0, "1/600", "2/600"]),
        ("t", ["2026-03-01T12:00:00Z", "2026-03-01T13:00:00.1+01:00", "2026-03-01 12:00:00,2 UTC"]),
    ],
)  # fmt: skip
def test_columns_of_times(log, name, values):
    path = log(**{"x": [1, 2, 3], name: [f'"{value}"' for value in values]})
    assert stl.load_trace(path, ["x"], step="0.1s")["x"].tolist() == [1, 2, 3]
    with pytest.raises(TraceError, match="the step is 0.3s"):
        stl.load_trace(path, ["x"], step="0.3s")
    with pytest.warns(UnusedTimeWarning, match=r"rows are steps; the column .* is not used, since no step is declared"):
        stl.load_trace(path, ["x"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stl.load_trace(path, ["x"], time="none")


def test_a_temperature_is_no_time(log):
    path = log(**{"T [°C]": [20, 21, 19], "time [-]": [0, 0.1, 0.2], "x": [1, 2, 3]})
    assert stl.load_trace(path, ["x"], step="0.1s")["x"].tolist() == [1, 2, 3]
    with pytest.raises(TraceError, match=r"in column time \[-\] they are 0.1s apart"):
        stl.load_trace(path, ["x"], step="1s")


def test_the_column_can_be_named(log):
    path = log(x=[1, 2, 3], when=[0, 100, 200], t=[20, 21, 19])
    assert len(stl.load_trace(path, ["x"], step="0.1s", time="when [ms]")["x"]) == 3
    with pytest.raises(NameLookupError, match="there is no column wen for the time; did you mean when?"):
        stl.load_trace(path, ["x"], step="0.1s", time="wen")
    with pytest.raises(NameLookupError, match='there is no column "" for the time; known names: t, when, x'):
        stl.load_trace(path, ["x"], step="0.1s", time="")
    both = log(x=[1, 2], t=[0, 0.1], Time=[0, 0.1])
    with pytest.raises(SettingsError, match='columns t and Time could both be the time; choose: time="t"'):
        stl.load_trace(both, ["x"], step="0.1s")
    with pytest.raises(TraceError, match="the unit fortnights of column x is not known; write s, ms, us, ns, min or h"):
        stl.load_trace(both, ["x"], step="0.1s", time="x [fortnights]")
    with pytest.raises(SettingsError, match='time="t": the duration of a step is not declared'):
        stl.load_trace(both, ["x"], time="t")
    with pytest.raises(SettingsError, match='resample="hold" needs the times, which time="none" leaves unused'):
        stl.load_trace(both, ["x"], time="none", resample="hold")
    with pytest.raises(SettingsError, match="there is no time column to resample by"):
        stl.load_trace(log(x=[1, 2]), step="0.1s", resample="hold")
    for wrong in ({"tolerance": 0.5}, {"tolerance": -1}, {"resample": "cubic"}, {"missing": "skip"}, {"decimal": ";"}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            stl.load_trace(both, ["x"], step="0.1s", **wrong)
    for step in ("0.1", "fast", "-1s", "0s", "3 steps", 5):
        with pytest.raises(SettingsError, match="give a time, such as 0.1s"):
            stl.load_trace(both, ["x"], step=step)


def test_a_formula_or_a_task_names_what_it_reads(log):
    path = log(t=["0", "0.2"], x=[0, 2], door=[0, 1], note=["a", "b"])
    task = stl.parse_task("step = 0.1s\nphi := G[0,0.1s] (x >= 0 | door)")
    assert plain(stl.load_trace(path, task, resample="linear")) == {
        "x": ("f", ["0.0", "1.0", "2.0"]), "door": ("f", ["0.0", "0.0", "1.0"])  # labels are held
    }  # fmt: skip
    with pytest.warns(UnusedTimeWarning):
        assert list(stl.load_trace(path, stl.parse("x > 0 & door"))) == ["x", "door"]
    assert list(stl.load_trace(path, ["t", "x"])) == ["t", "x"]  # no warning: the times are a signal


def test_tables_with_dates(tmp_path):
    pa = pytest.importorskip("pyarrow")
    start = datetime(2026, 3, 1, 12)
    stamps = [start + timedelta(seconds=i / 4) for i in (0, 1, 2, 4)]
    for kind in (pa.timestamp("us"), pa.timestamp("ns", "Europe/Berlin"), pa.string(), pa.duration("ms")):
        values = [f"{one}Z" for one in stamps] if kind == pa.string() else stamps
        values = [one - start for one in stamps] if pa.types.is_duration(kind) else values
        path = parquet(tmp_path / "t.parquet", x=[1.0, 2, 3, 5], timestamp=pa.array(values, kind))
        with pytest.raises(TraceError, match="rows 3 and 4: in column timestamp they are 0.5s apart"):
            stl.load_trace(path, ["x"], step="0.25s")
        assert stl.load_trace(path, ["x"], step="0.25s", resample="linear")["x"].tolist() == [1, 2, 3, 4, 5]
    assert list(stl.load_trace(path, time="none")) == ["x"]  # dates are no signals
    for times, row in (([0.0, np.nan, 1.0], 2), ([np.inf, 0.0, np.nan], 1)):
        with pytest.raises(TraceError, match=rf"row {row}, column t: (nan|inf) is not a time; every row needs one"):
            stl.load_trace(parquet(tmp_path / "n.parquet", x=[1.0, 2, 3], t=times), ["x"], step="1s")
    gaps = parquet(tmp_path / "g.parquet", x=[1.0, 2], timestamp=pa.array([start, None], pa.timestamp("us")))
    with pytest.raises(TraceError, match="row 2, column timestamp: no time; every row needs one"):
        stl.load_trace(gaps, ["x"], step="1s")


def test_batches(tmp_path):
    x = np.arange(6.0).reshape(2, 3)
    path = npz(tmp_path / "b.npz", x=x, t=[0, 0.1, 0.2])
    assert stl.load_trace(path, ["x"], step="0.1s")["x"].tolist() == x.tolist()
    own = npz(tmp_path / "o.npz", x=x, t=[[0, 0.1, 0.2], [7, 7.1, 7.4]])
    with pytest.raises(TraceError, match="o.npz, trace 1, rows 2 and 3: in column t they are 0.3s apart"):
        stl.load_trace(own, ["x"], step="0.1s")
    with pytest.raises(TraceError, match="its traces have 3 to 5 samples; give each a file of its own"):
        stl.load_trace(own, ["x"], step="0.1s", resample="hold")
    assert stl.load_trace(path, ["x"], step="0.05s", resample="linear")["x"][1].tolist() == [3, 3.5, 4, 4.5, 5]
    with pytest.raises(TraceError, match=r"array t: its shape is \(2,\), that of the signals is \(2, 3\); a time per"):
        stl.load_trace(npz(tmp_path / "w.npz", x=x, t=[0, 1]), ["x"], step="1s")
    with pytest.raises(TraceError, match=r"array t: its shape is \(\), that of the signals is \(3,\); a time per step"):
        stl.load_trace(npz(tmp_path / "s.npz", x=x[0], t=0.0), ["x"], step="1s")
    with pytest.raises(TraceError, match="array t, step 1: nan is not a time"):
        stl.load_trace(npz(tmp_path / "n.npz", x=x, t=[0, np.nan, 1]), ["x"], step="1s")


def test_a_grid_that_would_not_fit_is_refused_before_it_is_made(log):
    with pytest.raises(SizeError, match=r"log.csv on steps of 0.000001s would take .*of memory"):
        stl.load_trace(log(t=[0, 10**10], x=[1, 2]), ["x"], step="1us", resample="hold")


def test_how_many_rows_are_off_the_grid_is_told(log):
    for times, more in (([0, 0.1, 0.25, 0.3], ""), ([0, 0.15, 0.25, 0.3], " (and 1 more row)")):
        with pytest.raises(TraceError) as refused:
            stl.load_trace(log(t=times, x=times), ["x"], step="0.1s")
        assert ("more row" in str(refused.value)) == bool(more)
        assert more in str(refused.value)
    with pytest.raises(TraceError, match=r"\(and 2 more rows\)"):
        stl.load_trace(log(t=[0, 0.15, 0.25, 0.35], x=[0, 1, 2, 3]), ["x"], step="0.1s")
