"""Comparisons of one signal x, by the roots of polynomials: which truth assignments occur, exactly.

Both sides of a comparison are rational functions of x, or one of several (abs, min, max; the operand of a root on top),
each on a side of the roots of some polynomial. So is their difference's sign, and the truth of all comparisons changes
only at roots of finitely many polynomials. These are isolated by Sturm's theorem [Basu06, §2.2.2]: in the chain p, p′,
−rem(p, p′), … the values at a change their sign V(a) times, and p has V(a) − V(b) different roots in (a,b].

One decimal of each interval between neighbouring roots is judged, and every root that is a decimal: samples are
decimals, so what is true at irrational roots never occurs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple, TypeAlias, assert_never

import numpy as np

from stltool.errors import TraceError
from stltool.logic.formula import Arithmetic, Call, Comparison, Negate, Number, Term, Variable
from stltool.logic.regions import Choices, Span, kept
from stltool.logic.semantics import satisfies
from stltool.numbers import shortest

Polynomial: TypeAlias = tuple[Fraction, ...]
"""Coefficients of x⁰, x¹, …; the last one is not 0."""

_MOST_DEGREE = 24  # of all polynomials together
_MOST_EXPONENT = 12
_MOST_CASES = 16
_ONE: Polynomial = (Fraction(1),)


class _Cases(NamedTuple):
    """The rational functions (numerator, denominator) that a term may be, between the roots of the polynomials."""

    functions: list[tuple[Polynomial, Polynomial]]
    borders: list[Polynomial]


def truths_of_one_signal(leaves: Sequence[Comparison], name: str) -> set[tuple[bool, ...]] | None:
    """The truth assignments that occur; None if that is not found out."""
    borders: set[Polynomial] = set()
    for leaf in leaves:
        found = _borders(leaf)
        if found is None:
            return None
        borders.update(p for p in found if len(p) > 1)
    product = _ONE
    for p in sorted(borders, key=len):
        product = _times(product, _divided(p, _common(p, product))[0])
        if len(product) - 1 > _MOST_DEGREE:
            return None
    points = _points(_without_repetitions(product))
    if points is None:
        return None
    rows = set()
    for point in points:
        trace = {name: np.array([float(point)])}
        try:
            rows.add(tuple(satisfies(leaf, trace) for leaf in leaves))
        except TraceError:  # not a sample that a monitor accepts
            continue
    return rows


# --------------------------------------------------------------------------------------------- from comparisons


def _borders(leaf: Comparison) -> list[Polynomial] | None:
    """Polynomials between whose roots the truth of a comparison does not change."""
    sides = [_side(leaf.left), _side(leaf.right)]
    if sides[0] is None or sides[1] is None:
        return None
    (left, under), (right, below) = sides[0], sides[1]
    found = left.borders + right.borders
    for (a, b), (c, d) in itertools.product(left.functions, right.functions):
        if under and below:  # sqrt(a/b) and sqrt(c/d)
            found += [a, c]
        elif under:
            found += [a, c, _minus(_times(a, _times(d, d)), _times(b, _times(c, c)))]
            continue
        elif below:
            found += [a, c, _minus(_times(c, _times(b, b)), _times(d, _times(a, a)))]
            continue
        found.append(_minus(_times(a, d), _times(b, c)))
    return found


def _side(term: Term) -> tuple[_Cases, bool] | None:
    """A side of a comparison; True: its root."""
    if isinstance(term, Call) and term.function == "sqrt":
        cases = _cases(term.args[0])
        return None if cases is None else (cases, True)
    cases = _cases(term)
    return None if cases is None else (cases, False)


def _cases(term: Term) -> _Cases | None:
    match term:
        case Number(value):
            return _Cases([(_trimmed([shortest(value)]), _ONE)], [])
        case Variable():
            return _Cases([((Fraction(0), Fraction(1)), _ONE)], [])
        case Negate(arg):
            found = _cases(arg)
            return None if found is None else _Cases([(_times((Fraction(-1),), a), b) for a, b in found.functions],
                                                     found.borders)  # fmt: skip
        case Arithmetic("^", left, Number(n)) if n == int(n) and 1 <= n <= _MOST_EXPONENT:
            found = _cases(left)
            return None if found is None else _Cases(
                [(_power(a, int(n)), _power(b, int(n))) for a, b in found.functions], found.borders
            )  # fmt: skip
        case Arithmetic("+" | "-" | "*" | "/" as op, left, right):
            return _joined(op, _cases(left), _cases(right))
        case Call("abs", (arg,)):
            found = _cases(arg)
            if found is None:
                return None
            both = [*found.functions, *((_times((Fraction(-1),), a), b) for a, b in found.functions)]
            return _within(both, found.borders + [a for a, _ in found.functions])
        case Call("min" | "max", args):
            parts = [_cases(arg) for arg in args]
            known = [part for part in parts if part is not None]
            if len(known) < len(parts):
                return None
            functions = [one for part in known for one in part.functions]
            borders = [border for part in known for border in part.borders]
            borders += [_minus(_times(a, d), _times(b, c)) for (a, b), (c, d) in itertools.combinations(functions, 2)]
            return _within(functions, borders)
        case Arithmetic() | Call():
            return None
        case _:
            assert_never(term)


def _within(functions: list[tuple[Polynomial, Polynomial]], borders: list[Polynomial]) -> _Cases | None:
    return _Cases(functions, borders) if len(functions) <= _MOST_CASES else None


def _joined(op: str, left: _Cases | None, right: _Cases | None) -> _Cases | None:
    if left is None or right is None:
        return None
    borders, functions = left.borders + right.borders, []
    for (a, b), (c, d) in itertools.product(left.functions, right.functions):
        if op == "*":
            functions.append((_times(a, c), _times(b, d)))
        elif op == "/":
            if not c:
                return None
            functions.append((_times(a, d), _times(b, c)))
            borders.append(c)
        else:
            e, f = _times(a, d), _times(c, b)
            functions.append((_minus(e, f) if op == "-" else _plus(e, f), _times(b, d)))
    return _within(functions, borders)


# --------------------------------------------------------------------------------------------------- polynomials


def _trimmed(coefficients: Sequence[Fraction]) -> Polynomial:
    n = len(coefficients)
    while n and not coefficients[n - 1]:
        n -= 1
    return tuple(coefficients[:n])


def _plus(p: Polynomial, q: Polynomial) -> Polynomial:
    return _trimmed([a + b for a, b in itertools.zip_longest(p, q, fillvalue=Fraction(0))])


def _minus(p: Polynomial, q: Polynomial) -> Polynomial:
    return _trimmed([a - b for a, b in itertools.zip_longest(p, q, fillvalue=Fraction(0))])


def _times(p: Polynomial, q: Polynomial) -> Polynomial:
    found = [Fraction(0)] * max(0, len(p) + len(q) - 1)
    for (i, a), (j, b) in itertools.product(enumerate(p), enumerate(q)):
        found[i + j] += a * b
    return _trimmed(found)


def _power(p: Polynomial, n: int) -> Polynomial:
    return p if n == 1 else _times(p, _power(p, n - 1))


def _divided(p: Polynomial, q: Polynomial) -> tuple[Polynomial, Polynomial]:
    """Quotient and remainder."""
    rest, quotient = list(p), [Fraction(0)] * max(0, len(p) - len(q) + 1)
    for i in reversed(range(len(quotient))):
        quotient[i] = factor = rest[i + len(q) - 1] / q[-1]
        for j, b in enumerate(q):
            rest[i + j] -= factor * b
    return _trimmed(quotient), _trimmed(rest[: len(q) - 1])


def _common(p: Polynomial, q: Polynomial) -> Polynomial:
    """The greatest common divisor."""
    while q:
        p, q = q, _primitive(_divided(p, q)[1])
    return tuple(a / p[-1] for a in p)


def _derivative(p: Polynomial) -> Polynomial:
    return tuple(i * a for i, a in enumerate(p))[1:]


def _without_repetitions(p: Polynomial) -> Polynomial:
    """The polynomial with the same roots, each once, and integers without a common factor for coefficients."""
    return _primitive(_divided(p, _common(p, _derivative(p)))[0] if len(p) > 1 else p)


def _primitive(p: Polynomial) -> Polynomial:
    """The positive multiple whose coefficients are integers without a common factor: they grow least in remainders."""
    scale = math.lcm(*(a.denominator for a in p))
    whole = [int(a * scale) for a in p]
    return tuple(Fraction(n // math.gcd(*whole)) for n in whole)


def _sign(p: Polynomial, x: Fraction) -> int:
    """The sign of a polynomial with integer coefficients, computed in integers."""
    value, power = 0, 1
    for a in reversed(p):
        value = value * x.numerator + a.numerator * power
        power *= x.denominator
    return (value > 0) - (value < 0)


# ------------------------------------------------------------------------------------------------------- roots


def _points(p: Polynomial) -> list[Fraction] | None:
    """A decimal between every two neighbouring roots and beyond both ends, and the roots that are decimals.

    None if doubles do not keep a decimal between two roots.
    """
    roots = _isolated(p)
    pairs: list[tuple[Fraction | None, Fraction | None]] = [(None, None), *roots, (None, None)]
    points = [low for low, high in roots if low == high and kept(low)]
    for before, after in itertools.pairwise(pairs):
        low, high = before[1], after[0]  # roots themselves if these are rational
        choices = Choices.within(
            Span(low, high, low is not None and low == before[0], high is not None and high == after[1])
        )
        if choices is None:
            return None
        points.append(choices.simplest)
    return points


def _isolated(p: Polynomial) -> list[tuple[Fraction, Fraction]]:
    """An open interval with rational ends about each root, in order, that contains no other; both ends are the root if
    it is rational."""
    if len(p) < 2:
        return []
    chain = [p, _derivative(p)]
    while len(chain[-1]) > 1:
        chain.append(_primitive(tuple(-a for a in _divided(chain[-2], chain[-1])[1])))

    def changes(x: Fraction) -> int:
        signs = [sign for sign in (_sign(q, x) for q in chain) if sign]
        return sum(a != b for a, b in itertools.pairwise(signs))

    leading = abs(p[-1])
    bound = Fraction(1 << (1 + math.ceil(max(abs(a) / leading for a in p[:-1]))).bit_length())  # Cauchy's
    waiting = [(-bound, bound, changes(-bound), changes(bound))]
    found: list[tuple[Fraction, Fraction]] = []
    while waiting:
        low, high, before, after = waiting.pop()
        if before - after > 1:
            middle = (low + high) / 2
            at = changes(middle)
            waiting += [(middle, high, at, after), (low, middle, before, at)]
        elif before - after == 1:
            found.append(_narrowed(p, low, high))
    return found


def _narrowed(p: Polynomial, low: Fraction, high: Fraction) -> tuple[Fraction, Fraction]:
    """An interval as short as `_isolated` has it about the only root in (low, high]; both ends if it is rational."""
    leading, above = abs(p[-1]), _sign(p, high)
    narrow = min(1 / (2 * leading), Fraction(1, 1 << 24))
    while above and high - low > narrow:
        middle = (low + high) / 2
        sign = _sign(p, middle)
        if sign == -above:
            low = middle
        else:
            high, above = middle, sign
    rational = math.floor(high * leading) / leading  # the only one with this denominator
    return (rational, rational) if rational > low and not _sign(p, rational) else (low, high)
