"""Numbers: what one reader accepts, all accept, with one value; what is printed reads back; roundings enclose."""

import math
from fractions import Fraction

import numpy as np
import pytest
import typer
from hypothesis import assume, example, given
from hypothesis import strategies as st

import stltool as stl
from stltool import numbers
from stltool.cli.app import integer, number
from stltool.cli.steps import read_learner, read_probability
from stltool.cli.tradeoff import _read_bounds
from stltool.errors import SettingsError, StlToolError
from stltool.logic.quantities import duration, quantity
from stltool.models.grid import grid_from_table
from stltool.numbers import MOST_DIGITS, NumberError, bound_texts, difference_text, most_text, within_text

DIGITS = st.text("0123456789", min_size=1, max_size=6)
DECIMALS = st.builds(
    lambda sign, before, point, after, power: f"{sign}{before}{point}{after if point else ''}{power}",
    st.sampled_from(["", "-", "+"]),
    DIGITS,
    st.sampled_from(["", "."]),
    st.one_of(st.just(""), DIGITS),
    st.one_of(st.just(""), st.builds("{}{}".format, st.sampled_from(["e", "E", "e-", "e+"]), st.integers(0, 12))),
)
NUMBERS = st.one_of(
    DECIMALS, DECIMALS.map(lambda text: text.replace("0", "", 1)), st.builds("{}/{}".format, DIGITS, DIGITS)
)
SLIPS = st.text("0159.+-eE/_,%x٣１²½∞ ", min_size=1, max_size=8)
SHARES = st.one_of(
    st.fractions(0, 1, max_denominator=10**6).map(str),
    st.integers(0, 10**12).map(lambda n: f"{n}e-12"),
    st.decimals(0, 1, places=9).map(lambda d: f"{d:f}"),
)


def expected(text):
    """What a text means, by Python's own reader of fractions where that takes ASCII digits; else None."""
    bare = text.strip()
    if not bare.isascii() or "_" in bare:
        return None
    try:
        return Fraction(bare)
    except (ValueError, ZeroDivisionError):
        return None


def refused(door, *arguments):
    try:
        door(*arguments)
    except (NumberError, StlToolError, typer.BadParameter):
        return True
    return False


# ------------------------------------------------------------------------------- doors that take any exact number


def in_a_task_file(text):
    return stl.parse_task(f"param T = {text}\nr := x > T").params["T"]


def in_a_literal(text):
    return numbers.shortest(stl.parse(f"x > {text}").right.value)


def as_a_bound(text):
    return _read_bounds([f"A>={text}"], ">=", "--require", "A>=0.9")["A"]


EXACT = {
    "read": numbers.read,
    "exact": numbers.exact,
    "-p": lambda text: quantity("T", text),
    "a time": lambda text: duration(f"{text}s").seconds if duration(f"{text}s") else numbers.read(text),
    "--require": as_a_bound,
}


@given(st.one_of(NUMBERS, SLIPS))
@example("1_0")
@example("٣")
@example("１")
@example("1/0")
@example("+.5e-3")
def test_exact_doors_accept_the_same_texts_with_one_value(text):
    value = expected(text)
    assume("/ " not in text)
    assume(" /" not in text)  # Python's own reader changed its mind about these
    for name, door in EXACT.items():
        if value is None:
            assert refused(door, text), name
        else:
            assert door(text) == value, name


@given(NUMBERS)
def test_a_task_file_reads_what_p_reads(text):
    value = expected(text)
    assume(value is not None)
    assert in_a_task_file(text) == value


@given(SLIPS)
def test_a_task_file_refuses_what_p_refuses(text):
    assume(expected(text) is None)
    assume(not set(text[1:]) & set("+-/ "))  # then it may be an expression
    with pytest.raises(StlToolError):
        in_a_task_file(text)


# ------------------------------------------------------------------------------------------ doors of probabilities


def in_a_transition_file(text, folder):
    (folder / "m.tra").write_text(f"2 1 2\n0 0 0 {text}\n0 0 1 {1 - (expected(text) or 0)}\n", encoding="utf-8")
    return first_row(folder)


def in_interval_ends(text, folder):
    (folder / "m.tra").write_text(f"2 2 3\n0 0 0 [{text},1]\n0 0 1 [0,1]\n1 0 1 1\n", encoding="utf-8")
    return stl.load_model(folder / "m.tra").intervals.lower[0]


def first_row(folder):
    with (folder / "m.tra").open("a", encoding="utf-8") as file:
        file.write("1 0 1 1\n")
    text = (folder / "m.tra").read_text(encoding="utf-8").replace("2 1 2\n", "2 2 3\n")
    (folder / "m.tra").write_text(text, encoding="utf-8")
    exact = stl.load_model(folder / "m.tra").exact()
    return Fraction(int(exact.numerator[0]), exact.denominator)


def in_a_grid(text, _):
    model = grid_from_table({"kind": "grid", "map": "S.", "success": text})
    entry = model.row_start[model.action_names.index("E")]  # of the left cell
    stays, moves = model.exact().numerator[entry : entry + 2].tolist()
    assert stays + moves == model.exact().denominator
    return Fraction(moves, model.exact().denominator)


def in_an_array(text, _):
    exact = stl.MDP.from_arrays([[[text, 1 - (expected(text) or 0)], [0, 1]]], {}).exact()
    return Fraction(int(exact.numerator[0]), exact.denominator)


def at_the_start(text, _):
    model = stl.MDP.from_arrays([np.eye(2)], {}, initial=[text, 1 - (expected(text) or 0)])
    return model.exact().initial_share(0)


PROBABILITIES = {
    "--at-least": lambda text, _: read_probability(text, "--at-least"),
    ".tra": in_a_transition_file,
    "grid": in_a_grid,
    "arrays": in_an_array,
    "initial": at_the_start,
}


@given(SHARES)
@example("1e-30")
@example("0.10")
def test_doors_of_probabilities_read_one_value(tmp_path_factory, text):
    folder, value = tmp_path_factory.getbasetemp(), expected(text)
    assume(0 < value < 1)
    for name, door in PROBABILITIES.items():
        if name != "grid" or (value.denominator * 3).bit_length() < 53:
            assert door(text, folder) == value, name
    assert in_interval_ends(text, folder) == float(value)


@given(SLIPS)
@example("1_0/100")
@example("٣/4")
@example("0,5")
@example("50%")
def test_doors_of_probabilities_refuse_the_same_texts(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp()
    assume(expected(text) is None)
    assume(text.strip())
    assume(" " not in text)
    for name, door in (*PROBABILITIES.items(), ("interval", in_interval_ends)):
        assert refused(door, text, folder), name


# ------------------------------------------------------------------------------------------------ doors of doubles


def in_a_trace(text, folder):
    (folder / "t.csv").write_text(f"x,y\n{text},1\n", encoding="utf-8")
    return stl.load_trace(folder / "t.csv")["x"][0]


def in_a_trace_with_quotes(text, folder):
    (folder / "t.csv").write_text(f'x,y\n"{text}",1\n', encoding="utf-8")
    return stl.load_trace(folder / "t.csv")["x"][0]


def in_a_states_file(text, folder):
    for ending, content in (("tra", "1 1 1\n0 0 0 1\n"), ("sta", f"(x)\n0:({text})\n")):
        (folder / f"s.{ending}").write_text(content, encoding="utf-8")
    return stl.load_model(folder / "s.tra").signals["x"][0]


DOUBLES = {
    "double": lambda text, _: numbers.double(text),
    "options": lambda text, _: number(text),
    "trace": in_a_trace,
    "trace, read slowly": in_a_trace_with_quotes,
    ".sta": in_a_states_file,
    "signals": lambda text, _: stl.MDP.from_arrays([np.eye(1)], {"x": [text]}).signals["x"][0],
}


@given(st.one_of(NUMBERS, SLIPS))
@example("1_0")
@example("٣")
@example("1e999")
@example("nan")
@example("-inf")
@example("3694.20")
def test_doors_of_doubles_accept_the_same_texts_with_one_value(tmp_path_factory, text):
    folder, value = tmp_path_factory.getbasetemp(), expected(text)
    assume(text.strip() == text)
    assume(" " not in text)
    assume("," not in text)
    for name, door in DOUBLES.items():
        if value is None or abs(value) > Fraction(np.finfo(float).max):
            assert refused(door, text, folder), name
        else:
            assert door(text, folder) == float(value), name
    if value is not None and text[0] not in "+-" and "/" not in text and abs(value) < Fraction(np.finfo(float).max):
        assert in_a_literal(text) == numbers.shortest(float(value))


@given(st.one_of(st.integers(-(10**12), 10**12).map(str), SLIPS))
def test_integers_of_options_and_settings(text):
    value = expected(text)
    if value is not None and not set(text) & set("./eE"):
        assert integer(text) == value
        whole = value
    else:
        with pytest.raises(typer.BadParameter):
            integer(text)
        whole = None
    for method, name, found in (("naive-er", "memory", whole), ("cfer", "optimism", value)):
        if found is not None and found > 0:
            assert getattr(read_learner(method, False, [f"{name}={text}"]), name) == float(found)
        else:
            with pytest.raises(SettingsError):
                read_learner(method, False, [f"{name}={text}"])


def test_numbers_of_toml_keep_their_digits(tmp_path):
    digits = "0.12345678901234567890123"
    (tmp_path / "t.stl").write_text('model "g.toml"\nparam c = 1, k = 1\nr := F[0,3] (x > c) & k * x > 0\n')
    (tmp_path / "g.toml").write_text('kind = "grid"\nmap = "S."\nsuccess = 0.93\ncell = 0.1\n')
    model = stl.load_model(tmp_path / "g.toml")
    assert model.signals["x"].tolist() == [0.05, 0.15]
    assert model.exact().denominator == 300
    sweep = f"""
        [sweep]
        seeds = 1
        [[method]]
        name = "cfer"
        [[scenario]]
        id = "a"
        task = "t.stl"
        params = {{ c = {digits}, k = "1/3" }}
    """
    (tmp_path / "s.toml").write_text(sweep)
    params = stl.load_sweep(tmp_path / "s.toml").scenarios[0].task.params
    assert params == {"c": Fraction(digits), "k": Fraction(1, 3)}


# ------------------------------------------------------------------------------------------------- limits, printing


@pytest.mark.parametrize(
    "text",
    [
        "1" * MOST_DIGITS, "0." + "1" * MOST_DIGITS, "1e1000", "1e-1000", "9.99e999", "-1e1000", "0e99999999999999",
        "0" * 5000 + "1", f"{'7' * MOST_DIGITS}/{'9' * MOST_DIGITS}",
    ],
)  # fmt: skip
def test_the_limit_includes(text):
    value = numbers.read(text)
    assert numbers.read(numbers.number_text(value)) == value


@pytest.mark.parametrize(
    "text",
    [
        "1" * (MOST_DIGITS + 1), "0." + "1" * (MOST_DIGITS + 1), "1e1001", "10e1000", "1e-1001", "0.1e-1000",
        "1e999999999999999999999", f"1/{'9' * (MOST_DIGITS + 1)}", "1e-" + "9" * 10**5,
    ],
)  # fmt: skip
def test_the_limit_excludes_and_is_told(text):
    with pytest.raises(NumberError, match="out of range: numbers have at most 1000 digits, and sizes between 1e-1000"):
        numbers.read(text)
    with pytest.raises(StlToolError, match="out of range: numbers have at most 1000 digits"):
        stl.parse_task("param T = 1\nr := x > T", params={"T": text})


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("1_000", "'1_000' is not a number; write it without underscores"),
        ("0,5", "'0,5' is not a number; write it with a decimal point"),
        ("5%", "write a percentage as a decimal or a fraction"),
        ("−5", "write the minus sign as -"),
        ("٣", "digits are 0 to 9"),
        ("nan", "'nan' is not a finite number"),
        ("", "the text is empty"),
        ("1/0", "'1/0' divides by zero"),
        ("x" * 100, "'" + "x" * 40 + "…' is not a number"),
        (True, "True is not a number"),
        (b"1", "b'1' is not a number"),
        (math.inf, "'inf' is not a finite number"),
        (10**4000, "an integer of 13288 bits is out of range"),
        (None, "None is not a number"),
    ],
)
def test_what_is_wrong_is_told(value, says):
    with pytest.raises(NumberError) as caught:
        numbers.exact(value)
    assert says in str(caught.value)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_doubles_mean_their_shortest_decimal(value):
    for given_as in (value, np.float64(value), repr(value)):
        assert numbers.exact(given_as) == Fraction(repr(value)) == numbers.shortest(value)
    assert numbers.double(repr(value)) == value


@given(st.fractions(), st.integers(-900, 900))
@example(Fraction(1, 2**900), 0)
@example(Fraction(1, 3), 900)
def test_what_is_printed_reads_back(value, power):
    for one in (value, value * Fraction(10) ** power):
        assert numbers.read(numbers.number_text(one)) == one
        assert numbers.read(numbers.fraction_text(one)) == one


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Fraction(1, 10), "0.1"), (Fraction(-1, 3), "-1/3"), (Fraction(7), "7"), (Fraction(0), "0"),
        (Fraction(-25, 10000), "-0.0025"), (Fraction(10) ** 40, "1e40"), (Fraction(12, 10**40), "1.2e-39"),
        (Fraction(10**12), "1000000000000"), (Fraction(1, 2**60), f"1/{2**60}"),
    ],
)  # fmt: skip
def test_printed_numbers_are_short(value, text):
    assert numbers.number_text(value) == text


@given(st.fractions(-10, 10))
def test_roundings_enclose(value):
    assert Fraction(numbers.round_down(value)) <= value <= Fraction(numbers.round_up(value))
    assert Fraction(numbers.floor_text(value)) <= value <= Fraction(numbers.ceiling_text(value))
    low, high = numbers.bound_texts(value, value)
    assert Fraction(low) <= value <= Fraction(high)
    assert Fraction(high) - Fraction(low) <= Fraction(1, 10**15)


@given(st.floats(0, 1), st.floats(0, 1e-15), st.floats(0, 1e-15), st.integers(1, 17))
def test_a_printed_value_lies_between_the_printed_bounds(value, below, above, digits):
    lower, upper = max(0.0, value - below), min(1.0, value + above)
    text = within_text(value, lower, upper, digits)
    least, most = bound_texts(lower, upper)
    assert Fraction(least) <= Fraction(text) <= Fraction(most)
    assert (text in ("0", "1")) == (value in (0, 1))
    if (short := f"{value:.{digits}g}") != text and short not in ("0", "1"):
        assert not Fraction(least) <= Fraction(short) <= Fraction(most)


@given(st.floats(0, 1), st.integers(1, 6))
def test_what_something_is_at_most_is_rounded_up(value, digits):
    shown = Fraction(most_text(value, digits))
    assert Fraction(value) <= shown <= Fraction(value) * (1 + Fraction(10, 10**digits))


@pytest.mark.parametrize(
    ("value", "lower", "upper", "text"),
    [
        (0.9979835367685961, 0.9979835367685961, 0.9979835367685961, "0.99798353676859608"),
        (0.5, 0.4999999999999999, 0.5000000000000001, "0.5"),
    ],
)
def test_a_value_gets_as_many_digits_as_it_takes(value, lower, upper, text):
    assert within_text(value, lower, upper) == text


@pytest.mark.parametrize(
    ("value", "digits", "text"), [(0.998, 2, "0.998"), (0.99996, 3, "0.99996"), (0.5, 2, "0.5"), (1.0, 2, "1")]
)
def test_a_difference_below_1_is_not_rounded_to_1(value, digits, text):
    assert difference_text(value, digits) == text
