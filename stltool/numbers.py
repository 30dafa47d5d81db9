"""Numbers as written ↔ exact values: the only module that reads, prints and rounds them.

    number    an integer, a decimal, or a fraction of two integers:   7   -0.25   .5   1e-3   2/3

All texts with numbers are read here (task files, -p, --at-least, model files, arrays of fractions, traces, the command
line's options), so all of them accept the same texts and mean the same value. Digits are 0 to 9: no
underscores, no other alphabet's digits, no decimal comma. A decimal means that decimal, not the nearest double; a
double given as a number means the shortest decimal that identifies it (0.1 is 1/10).

A limit, `LIMIT`, keeps a typing error from filling the memory: 1000 digits, and sizes between 1e-1000 and 1e1000.
`read` restores the exact value that `number_text` printed.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from numbers import Real
from typing import TypeAlias

from stltool.arguments import described

MOST_DIGITS = 1000
LIMIT = f"numbers have at most {MOST_DIGITS} digits, and sizes between 1e-{MOST_DIGITS} and 1e{MOST_DIGITS} or 0"

Exactable: TypeAlias = "int | float | str | Decimal | Fraction"
"""Types with an exact value: doubles mean their shortest decimal."""

_DECIMAL = re.compile(r"([+-]?)(?:(\d+)(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?", re.ASCII)
_FRACTION = re.compile(r"([+-]?)(\d+)[ \t]*/[ \t]*(\d+)", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
_READABLE = 30  # characters; up to here a decimal is printed rather than a fraction or an exponent
_LONGEST_INDEX = 18  # digits
_SHOWN = 40  # characters of a text that a message repeats


class NumberError(ValueError):
    """The fault of a text where a number is expected: "'1_0' is not a number; write it without underscores"."""


# ------------------------------------------------------------------------------------------------------------ reading


def read(text: str) -> Fraction:
    """The exact value of an integer, a decimal or a fraction. Raises NumberError with the reason."""
    bare = text.strip()
    if found := _DECIMAL.fullmatch(bare):
        sign, before, after, only, power = found.groups()
        digits, places = (before or "") + (after or only or ""), len(after or only or "")
        return _value(text, sign, digits, power or "0", places)
    if found := _FRACTION.fullmatch(bare):
        sign, numerator, denominator = found.groups()
        p, q = _value(text, sign, numerator), _value(text, "", denominator)
        if q == 0:
            raise NumberError(f"{shown(text)} divides by zero")
        return p / q
    raise NumberError(_objection(text))


def exact(value: object) -> Fraction:
    """The exact value of a number, or of a text as `read` takes it; a double means its shortest decimal.

    Raises NumberError for anything else: Booleans, NaN, infinities.
    """
    if isinstance(value, Fraction):
        return value
    if isinstance(value, bool):
        raise NumberError(f"{value} is not a number")
    if isinstance(value, int) and value.bit_length() > 4 * MOST_DIGITS:  # too long to be printed at all
        raise NumberError(f"an integer of {value.bit_length()} bits is out of range: {LIMIT}")
    if not isinstance(value, str | Real | Decimal):
        raise NumberError(f"{described(value)} is not a number")
    return read(value if isinstance(value, str) else str(value))


def whole(text: str) -> int:
    """An integer. Raises NumberError for other texts."""
    bare = text.strip()
    if _WHOLE.fullmatch(bare) is None:
        raise NumberError(f"{shown(text)} is not an integer" + _remedy(text))
    if len(bare) > MOST_DIGITS and len(bare.lstrip("+-0")) > MOST_DIGITS:
        raise NumberError(f"{shown(text)} is out of range: {LIMIT}")
    return int(bare)


def index(text: str) -> int:
    """The number of a state, a line or the like: only digits. Raises NumberError for other texts."""
    if not (text.isascii() and text.isdigit()) or len(text) > _LONGEST_INDEX:
        raise NumberError(f"{shown(text)} is not an index; write only digits")
    return int(text)


def double(text: str) -> float:
    """The double nearest to a number, however many digits it has. Raises NumberError if there is none."""
    bare = text.strip()
    try:
        # ASCII text without underscores that float reads as a finite number is a decimal
        value = float(bare) if bare.isascii() and "_" not in bare else math.nan
    except ValueError:
        value = math.nan
    if math.isfinite(value):
        return value
    try:
        value = math.inf if _DECIMAL.fullmatch(bare) else float(read(bare))
    except OverflowError:  # of a fraction
        value = math.inf
    if math.isinf(value):
        raise NumberError(f"{shown(text)} is too large for a double; the largest is {sys.float_info.max:.6g}")
    return value


def shortest(value: float) -> Fraction:
    """The shortest decimal that identifies a finite double, exactly."""
    return Fraction(repr(float(value)))


def _value(text: str, sign: str, digits: str, power: str = "0", places: int = 0) -> Fraction:
    digits = digits.lstrip("0")
    if not digits:
        return Fraction(0)
    short = power.lstrip("+-0")  # an exponent can be long too
    exponent = int(power) - places if len(short) < 9 else 10**9
    if len(digits) > MOST_DIGITS or abs(len(digits) - 1 + exponent) > MOST_DIGITS:
        raise NumberError(f"{shown(text)} is out of range: {LIMIT}")
    value = int(sign + digits)
    return Fraction(value * 10**exponent) if exponent >= 0 else Fraction(value, 10**-exponent)


def shown(text: str) -> str:
    """A text in quotes, cut if it is long."""
    text = text.strip()
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "…")


def _objection(text: str) -> str:
    if not text.strip():
        return "the text is empty"
    if text.strip().lstrip("+-").lower() in ("nan", "inf", "infinity"):
        return f"{shown(text)} is not a finite number"
    return f"{shown(text)} is not a number" + _remedy(text)


def _remedy(text: str) -> str:
    """What to write instead, for common slips."""
    for wrong, instead, says in (
        ("_", "", "write it without underscores"),
        (",", ".", "write it with a decimal point"),
        ("%", "", "write a percentage as a decimal or a fraction, such as 0.05 or 5/100"),
        ("−", "-", "write the minus sign as -"),
    ):
        if wrong in text and _is_number(text.replace(wrong, instead)):
            return f"; {says}"
    if any(c.isnumeric() and not c.isascii() for c in text):
        return "; digits are 0 to 9"
    return ""


def _is_number(text: str) -> bool:
    bare = text.strip()
    return bool(_DECIMAL.fullmatch(bare) or _FRACTION.fullmatch(bare))


# ----------------------------------------------------------------------------------------------------------- printing


def number_text(value: Fraction) -> str:
    """A number as a decimal, or as a fraction if that is shorter or the only way; `read` restores it."""
    with long_numbers():
        decimal = _decimal_text(value)
        fraction = str(value)
    if decimal is None or _READABLE < len(decimal) > len(fraction):
        return fraction
    return decimal


def _decimal_text(value: Fraction) -> str | None:
    """The number as a decimal; None if it does not terminate, or only with too many digits."""
    rest, powers = value.denominator, []
    for factor in (2, 5):
        count = 0
        while rest % factor == 0:
            rest, count = rest // factor, count + 1
        powers.append(count)
    places = max(powers)
    if rest != 1 or places > 4 * MOST_DIGITS:
        return None
    digits = str(abs(value.numerator) * (10**places // value.denominator))
    sign = "-" if value < 0 else ""
    plain = digits if not places else f"{digits.zfill(places + 1)[:-places]}.{digits.zfill(places + 1)[-places:]}"
    significant = digits.rstrip("0") or "0"
    if len(significant) > MOST_DIGITS:
        return None
    point = "." if len(significant) > 1 else ""
    scientific = f"{significant[0]}{point}{significant[1:]}e{len(digits) - 1 - places}"
    fits = len(digits.lstrip("0")) <= MOST_DIGITS
    return sign + (plain if fits and (len(plain) <= _READABLE or len(plain) <= len(scientific)) else scientific)


def fraction_text(value: Fraction, longest: int | None = None) -> str:
    """A fraction in full, or its length if it has more than `longest` characters."""
    with long_numbers():
        whole_text = str(value)
    if longest is None or len(whole_text) <= longest:
        return whole_text
    return f"a fraction of {len(whole_text)} digits; --json prints it"


@contextmanager
def long_numbers() -> Iterator[None]:
    """Allow printing integers of any length, which Python limits to a few thousand digits."""
    longest = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        yield
    finally:
        sys.set_int_max_str_digits(longest)


def probability_text(value: float) -> str:
    """A probability with enough digits to distinguish it from 0 and 1."""
    if 0.999 < value < 1:
        return f"1 − {1 - value:.3g}"
    return f"{value:.6g}"


def within_text(value: float, lower: float | Fraction, upper: float | Fraction, digits: int = 15) -> str:
    """A value between bounds, in as many digits, from `digits` on, as it takes to lie between the printed bounds, and
    to be told from 0 and 1."""
    least, most = map(Decimal, bound_texts(lower, upper))
    texts = [f"{value:.{n}g}" for n in range(digits, 18)]
    fitting = (text for text in texts if least <= Decimal(text) <= most and (text in ("0", "1")) == (value in (0, 1)))
    return next(fitting, texts[-1])


def difference_text(value: float, digits: int = 3) -> str:
    """A difference of probabilities: in so many digits, and more where it would be rounded up to 1."""
    texts = [f"{value:.{n}g}" for n in range(digits, 18)]
    return next((text for text in texts if float(text) < 1 or value >= 1), texts[-1])


# ----------------------------------------------------------------------------------------------------------- rounding


def round_down(value: Fraction) -> float:
    """The largest double not above the value."""
    nearest = float(value)
    return nearest if Fraction(nearest) <= value else math.nextafter(nearest, -math.inf)


def round_up(value: Fraction) -> float:
    """The smallest double not below the value."""
    nearest = float(value)
    return nearest if Fraction(nearest) >= value else math.nextafter(nearest, math.inf)


def floor_text(bound: float | Fraction, digits: int = 6) -> str:
    """A lower bound with this many digits, rounded down."""
    return f"{_in_digits(bound, digits, ROUND_FLOOR):f}"


def ceiling_text(bound: float | Fraction, digits: int = 6) -> str:
    """An upper bound with this many digits, rounded up."""
    return f"{_in_digits(bound, digits, ROUND_CEILING):f}"


def most_text(value: float, digits: int = 3) -> str:
    """What something is at most, however small: in this many digits, rounded up."""
    return f"{_in_digits(value, digits, ROUND_CEILING):g}"


def bound_texts(lower: float | Fraction, upper: float | Fraction) -> tuple[str, str]:
    """An enclosure in 17 digits, rounded outwards, so that the printed interval encloses, too."""
    return str(_in_digits(lower, 17, ROUND_FLOOR)), str(_in_digits(upper, 17, ROUND_CEILING))


def _in_digits(bound: float | Fraction, digits: int, rounding: str) -> Decimal:
    return Context(prec=digits, rounding=rounding).divide(*map(Decimal, bound.as_integer_ratio()))
