"""Values of signals that give comparisons wanted truth values, solved exactly over the signals' ranges.

Comparisons that share signals, directly or through others, form a group; groups are independent of each other.

    linear   abs, min and max are split into cases, so that every truth assignment of the group is a union of polyhedra
             { A x ⋈ b }. Equations are substituted; then Fourier and Motzkin eliminate one signal after the other,
             which gives its interval for any values of the signals before it. All of it in rationals: an assignment is
             offered if some decimals have it, and only then; an equation that few decimals solve may be missed
    others   a table of points, each with the exact truth of every comparison: ends of ranges, constants, a grid, and
             both sides of each border between neighbouring points. What is offered is right; some may be missing

A value is a decimal that a double keeps (stltool/numbers.py: doubles mean their shortest decimal), so a trace made of
them is judged as it was solved.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, lru_cache
from typing import TypeAlias, assert_never

import numpy as np

from stltool.errors import SettingsError, SizeError, TraceError
from stltool.logic.formula import (
    Arithmetic,
    Call,
    Comparator,
    Comparison,
    Negate,
    Number,
    Term,
    Variable,
    read_by,
)
from stltool.logic.rewrite import MIRROR, OPPOSITE
from stltool.logic.semantics import satisfies
from stltool.numbers import shortest

Draw: TypeAlias = Callable[[int], int]
"""draw(n): one of 0 … n − 1; 0 is the simplest."""
Range: TypeAlias = tuple[Fraction | None, Fraction | None]
"""The lowest and the highest value of a signal; None: no limit."""
Values: TypeAlias = dict[str, Fraction]

_MOST_CASES = 64  # of one comparison with abs, min and max
_MOST_POLYHEDRA = 4096  # of a group
_MOST_CONSTRAINTS = 2000  # of one elimination
_MOST_POINTS = 400  # of a grid
_FINE = 20  # decimals that an interval offers, at least
_MOST_DIGITS = 17  # after the first of a double
_LARGEST = Fraction(sys.float_info.max)
_FREE = Fraction(10)  # how far values go where nothing limits them
_BISECTIONS = 40
_MOST_BORDERS = 6  # between two truth assignments of a table


# -------------------------------------------------------------------------------------------------------- intervals


@dataclass(frozen=True, slots=True)
class Span:
    """Reals between two ends, None if there is none, which belong to it unless open."""

    low: Fraction | None
    high: Fraction | None
    low_open: bool = False
    high_open: bool = False

    @property
    def empty(self) -> bool:
        if self.low is None or self.high is None:
            return False
        return self.low > self.high or (self.low == self.high and (self.low_open or self.high_open))

    def bounded(self) -> Span:
        """The part from which values are drawn if there is no end."""
        low, high = self.low, self.high
        if low is None and high is None:
            return Span(-_FREE, _FREE)
        if high is None:
            assert low is not None
            return Span(low, low + _reach(low), self.low_open, False)
        if low is None:
            return Span(high - _reach(high), high, False, self.high_open)
        return self

    def multiples(self, unit: Fraction) -> tuple[int, int]:
        """The first and the last n with n · unit inside; the last is before the first if there is none."""
        assert self.low is not None
        assert self.high is not None
        first, last = math.ceil(self.low / unit), math.floor(self.high / unit)
        first += self.low_open and first * unit == self.low
        last -= self.high_open and last * unit == self.high
        return first, last


def _reach(end: Fraction) -> Fraction:
    """A width that doubles near this end can resolve."""
    return max(_FREE, Fraction(10) ** (len(str(int(abs(end)))) - 1))


@dataclass(frozen=True, slots=True)
class Choices:
    """Decimals inside an interval: `simplest`, both ends (or what is next to them), and n · unit for n in `multiples`,
    those with fewest digits and nearest to 0 first."""

    simplest: Fraction
    ends: tuple[Fraction, ...] = ()
    unit: Fraction = Fraction(1)
    multiples: tuple[int, ...] = ()

    @classmethod
    @lru_cache(maxsize=4096)
    def within(cls, span: Span, scale: Fraction = Fraction(1)) -> Choices | None:
        """Multiples of `scale` with few digits; None if the interval holds none that a double keeps."""
        if span.empty:
            return None
        part = span.bounded()
        assert part.low is not None
        assert part.high is not None
        if part.low == part.high:
            return cls(part.low) if kept(part.low) and is_decimal(part.low / scale) else None
        magnitude = _magnitude_of((part.high - part.low) / scale)
        power, found = magnitude + 1, list[Fraction]()  # few multiples fit
        while True:
            unit = scale * Fraction(10) ** power
            first, last = part.multiples(unit)
            if first <= last and len(found) < 2:
                found.append(unit * min(max(first, min(0, last)), last))
            if last - first + 1 >= _FINE or (found and power < -_MOST_DIGITS):
                break
            if power < magnitude - 3 * _MOST_DIGITS:
                return None
            power -= 1
        simplest = min(found, key=_plainness)
        if not kept(simplest):
            return None
        given = (part.low, not part.low_open, first * unit), (part.high, not part.high_open, last * unit)
        ends = [end if closed and kept(end) and is_decimal(end / scale) else near for end, closed, near in given]
        if not all(map(kept, ends)):
            return cls(simplest)
        order = sorted(range(first, last + 1), key=lambda n: (n % 10 != 0, abs(n), n < 0))
        return cls(simplest, tuple(ends), unit, tuple(order))

    def pick(self, draw: Draw) -> Fraction:
        """A quarter of the draws is the simplest, a quarter one of the ends, the rest any of the multiples."""
        n = len(self.multiples)
        if not n:
            return self.simplest
        i = draw(4 * n)
        if i < n:
            return self.simplest
        if i >= 3 * n:
            return self.ends[i % 2]
        value = self.unit * self.multiples[(i - n) // 2]
        return value if kept(value) else self.simplest


def _magnitude_of(width: Fraction) -> int:
    """About log10, also beyond the range of doubles."""
    return math.floor((width.numerator.bit_length() - width.denominator.bit_length()) * math.log10(2))


def _plainness(value: Fraction) -> tuple[int, Fraction, bool]:
    """Few characters first, then what is near 0."""
    characters = len(f"{float(abs(value)):g}") if abs(value) < _LARGEST else len(str(value))
    return characters, abs(value), value < 0


def is_decimal(value: Fraction) -> bool:
    return _without_2_and_5(value.denominator) == 1


@cache
def _without_2_and_5(n: int) -> int:
    for prime in (2, 5):
        while n % prime == 0:
            n //= prime
    return n


@lru_cache(maxsize=1 << 16)
def kept(value: Fraction) -> bool:
    """Whether some double means exactly this value."""
    if not is_decimal(value):
        return False
    try:
        return shortest(float(value)) == value
    except OverflowError:
        return False


# --------------------------------------------------------------------------------------------------- linear systems


@dataclass(frozen=True, slots=True)
class Linear:
    """Σ coefficient · signal + constant."""

    coefficients: tuple[tuple[str, Fraction], ...]  # by name, none of them 0
    constant: Fraction

    @classmethod
    def of(cls, coefficients: Mapping[str, Fraction], constant: Fraction) -> Linear:
        return cls(tuple(sorted((name, k) for name, k in coefficients.items() if k)), constant)

    def plus(self, other: Linear, factor: Fraction = Fraction(1)) -> Linear:
        total = dict(self.coefficients)
        for name, k in other.coefficients:
            total[name] = total.get(name, Fraction(0)) + factor * k
        return Linear.of(total, self.constant + factor * other.constant)

    def times(self, factor: Fraction) -> Linear:
        return Linear.of({name: k * factor for name, k in self.coefficients}, self.constant * factor)

    def of_signal(self, name: str) -> Fraction:
        return dict(self.coefficients).get(name, Fraction(0))

    def without(self, name: str) -> Linear:
        return Linear(tuple(pair for pair in self.coefficients if pair[0] != name), self.constant)

    def at(self, values: Values) -> Fraction:
        return sum((k * values[name] for name, k in self.coefficients), self.constant)


@dataclass(frozen=True, slots=True)
class Constraint:
    """term < 0, or ≤ 0, or = 0."""

    term: Linear
    relation: str

    def substituted(self, name: str, by: Linear) -> Constraint:
        k = self.term.of_signal(name)
        return Constraint(self.term.without(name).plus(by, k), self.relation) if k else self

    @property
    def decided(self) -> bool | None:
        """Its truth, if it has no signal."""
        if self.term.coefficients:
            return None
        c = self.term.constant
        return c < 0 if self.relation == "<" else c <= 0 if self.relation == "<=" else c == 0


_Case: TypeAlias = tuple[tuple[Constraint, ...], Linear]


def cases(term: Term) -> list[_Case] | None:
    """The term as linear ones, each under constraints that together cover everything; None if it is not so."""
    match term:
        case Number(value):
            return [((), Linear((), shortest(value)))]
        case Variable(name):
            return [((), Linear(((name, Fraction(1)),), Fraction(0)))]
        case Negate(arg):
            return _mapped(cases(arg), lambda x: x.times(Fraction(-1)))
        case Arithmetic("+" | "-" as op, left, right):
            return _paired(cases(left), cases(right), lambda a, b: a.plus(b, Fraction(1 if op == "+" else -1)))
        case Arithmetic("*", left, right):
            return _paired(cases(left), cases(right), _product)
        case Arithmetic("/", left, right):
            return _paired(cases(left), cases(right), _quotient)
        case Arithmetic("^", left, Number(1.0)):
            return cases(left)
        case Arithmetic() | Call("sqrt"):
            return None
        case Call("abs", (arg,)):
            return _magnitude(cases(arg))
        case Call(function, args):
            known = cases(args[0])
            for arg in args[1:]:
                known = _least(known, cases(arg), "<=" if function == "min" else ">=")
            return known
        case _:
            assert_never(term)


def _mapped(found: list[_Case] | None, make: Callable[[Linear], Linear]) -> list[_Case] | None:
    return None if found is None else [(under, make(term)) for under, term in found]


def _paired(
    left: list[_Case] | None, right: list[_Case] | None, make: Callable[[Linear, Linear], Linear | None]
) -> list[_Case] | None:
    if left is None or right is None or len(left) * len(right) > _MOST_CASES:
        return None
    made = [(a[0] + b[0], make(a[1], b[1])) for a, b in itertools.product(left, right)]
    known = [(under, term) for under, term in made if term is not None]
    return known if len(known) == len(made) else None


def _product(a: Linear, b: Linear) -> Linear | None:
    if not a.coefficients:
        return b.times(a.constant)
    return None if b.coefficients else a.times(b.constant)


def _quotient(a: Linear, b: Linear) -> Linear | None:
    return None if b.coefficients or not b.constant else a.times(1 / b.constant)


def _magnitude(found: list[_Case] | None) -> list[_Case] | None:
    if found is None or 2 * len(found) > _MOST_CASES:
        return None
    up = [((*under, *_relation(term, ">=")[0]), term) for under, term in found]
    return up + [((*under, *_relation(term, "<")[0]), term.times(Fraction(-1))) for under, term in found]


def _least(left: list[_Case] | None, right: list[_Case] | None, op: Comparator) -> list[_Case] | None:
    """Either of two terms, where it is related to the other like this."""
    if left is None or right is None or 2 * len(left) * len(right) > _MOST_CASES:
        return None
    made = []
    for (under, a), (also, b) in itertools.product(left, right):
        made.append(((*under, *also, *_relation(a.plus(b, Fraction(-1)), op)[0]), a))
        made.append(((*under, *also, *_relation(a.plus(b, Fraction(-1)), OPPOSITE[op])[0]), b))
    return made


def _relation(term: Linear, op: Comparator) -> list[tuple[Constraint, ...]]:
    """term ⋈ 0 as alternatives."""
    match op:
        case "<" | "<=" | "==":
            return [(Constraint(term, op),)]
        case ">" | ">=":
            return [(Constraint(term.times(Fraction(-1)), MIRROR[op]),)]
        case "!=":
            return [*_relation(term, "<"), *_relation(term, ">")]
        case _:
            assert_never(op)


def alternatives(phi: Comparison, truth: bool) -> list[tuple[Constraint, ...]] | None:
    """The comparison, or its negation, as a union of polyhedra; None if it is not piecewise linear.

    The sign of a product is that of its factors, so a product may be compared with 0.
    """
    op = phi.op if truth else OPPOSITE[phi.op]
    if _ZERO in (phi.left, phi.right):
        product, relation = (phi.right, MIRROR[op]) if phi.left == _ZERO else (phi.left, op)
        if 1 < len(factors := _factors(product)) <= _MOST_FACTORS:
            return _of_product(factors, relation)
    found = cases(Arithmetic("-", phi.left, phi.right))
    if found is None:
        return None
    return [(*under, *rest) for under, term in found for rest in _relation(term, op)]


_ZERO = Number(0.0)
_MOST_FACTORS = 4


def _factors(term: Term) -> list[Term]:
    match term:
        case Arithmetic("*", left, right):
            return _factors(left) + _factors(right)
        case Arithmetic("^", left, Number(n)) if n == int(n) and 1 <= n <= _MOST_FACTORS:
            return _factors(left) * int(n)
        case _:
            return [term]


def _of_product(factors: list[Term], op: Comparator) -> list[tuple[Constraint, ...]] | None:
    """A product compared with 0, by the signs of its factors."""
    different = list(dict.fromkeys(factors))
    signs: list[dict[int, list[tuple[Constraint, ...]]]] = []
    for factor in different:
        found = cases(factor)
        if found is None:
            return None
        relations: dict[int, Comparator] = {-1: "<", 0: "==", 1: ">"}
        signs.append({
            sign: [(*under, *rest) for under, term in found for rest in _relation(term, relation)]
            for sign, relation in relations.items()
        })  # fmt: skip
    made = []
    for chosen in itertools.product((-1, 0, 1), repeat=len(different)):
        if _HOLDS[op](math.prod(sign ** factors.count(one) for one, sign in zip(different, chosen, strict=True))):
            for parts in itertools.product(*(of[sign] for of, sign in zip(signs, chosen, strict=True))):
                made.append(tuple(itertools.chain(*parts)))
        if len(made) > _MOST_CASES:
            return None
    return made


class Polyhedron:
    """The decimals that meet constraints: `pick` draws some, `simplest` are those that it shrinks to."""

    def __init__(self, names: Sequence[str], constraints: Sequence[Constraint]) -> None:
        self.names = tuple(names)
        self._pivots: list[tuple[str, Linear]] = []  # each in terms of signals after it
        self.sharp = True  # whether it is known to be empty if it says so
        free = self._substitute(list(dict.fromkeys(constraints)))
        self._stages = self._eliminate(free) if free is not None else None
        self._first: Choices | None = None  # of the first signal
        if self._stages:
            name, scale, rows = self._stages[0]
            self._first = Choices.within(_span(name, rows, {}), scale)
        self.simplest = self._at(lambda n: 0) if self._stages is not None else None
        if self._stages is not None and self.simplest is None:
            self.sharp = False

    def _substitute(self, rows: list[Constraint]) -> list[Constraint] | None:
        """The inequalities that remain once equations are solved for a signal each; None if there is no solution."""
        while True:
            if any(row.decided is False for row in rows):
                return None
            rows = [row for row in rows if row.decided is None]
            equation = next((row.term for row in rows if row.relation == "=="), None)
            if equation is None:
                return rows
            name, by = min(((name, solved(equation, name)) for name, _ in equation.coefficients), key=_ease)
            if not is_decimal(by.constant):
                self.sharp = not by.coefficients  # then it is one value, which is no decimal
                return None
            self._pivots.append((name, by))
            rows = list(dict.fromkeys(row.substituted(name, by) for row in rows))

    def _eliminate(self, rows: list[Constraint]) -> list[tuple[str, Fraction, list[Constraint]]] | None:
        """For each free signal, first to last: its scale, and the constraints on it and the signals before it."""
        pivots = {name for name, _ in self._pivots}
        free = [name for name in self.names if name not in pivots]
        stages = []
        for name in reversed(free):
            here = [row for row in rows if row.term.of_signal(name)]
            rest = [row for row in rows if not row.term.of_signal(name)]
            below = [row for row in here if row.term.of_signal(name) < 0]
            above = [row for row in here if row.term.of_signal(name) > 0]
            if len(below) * len(above) > _MOST_CONSTRAINTS:
                raise SizeError("comparisons of too many signals at once; compare fewer of them with each other")
            for low, high in itertools.product(below, above):
                a, b = -low.term.of_signal(name), high.term.of_signal(name)
                term = low.term.times(1 / a).plus(high.term, 1 / b)
                rest.append(Constraint(term, "<=" if low.relation == high.relation == "<=" else "<"))
            rest = list(dict.fromkeys(rest))
            if any(row.decided is False for row in rest):
                return None
            rows = [row for row in rest if row.decided is None]
            scale = math.lcm(*(_without_2_and_5(by.of_signal(name).denominator) for _, by in self._pivots), 1)
            stages.append((name, Fraction(scale), here))
        return stages[::-1]

    def _at(self, draw: Draw) -> Values | None:
        """Values drawn; None if an interval on the way has no decimal, or an equation's value has too many digits."""
        assert self._stages is not None
        values: Values = {}
        for name, scale, rows in self._stages:
            alone = not values  # its interval depends on nothing
            choices = self._first if alone else Choices.within(_span(name, rows, values), scale)
            if choices is None:
                return None
            values[name] = choices.pick(draw)
        for name, by in reversed(self._pivots):
            values[name] = by.at(values)
        return values if all(map(kept, values.values())) else None

    def span(self) -> Span:
        """The values of the only signal."""
        if self._pivots:
            value = self._pivots[0][1].constant
            return Span(value, value)
        assert self._stages
        name, _, rows = self._stages[0]
        return _span(name, rows, {})

    def pick(self, draw: Draw) -> Values:
        """Values that meet the constraints; there must be some."""
        assert self.simplest is not None
        if not self._stages:
            return self.simplest
        found = self._at(draw)
        return found if found is not None else self.simplest


def solved(equation: Linear, name: str) -> Linear:
    return equation.without(name).times(-1 / equation.of_signal(name))


def _ease(found: tuple[str, Linear]) -> tuple[bool, int, str]:
    name, by = found
    others = math.lcm(*(_without_2_and_5(k.denominator) for _, k in by.coefficients), 1)
    return not is_decimal(by.constant), others, name


def _span(name: str, rows: Sequence[Constraint], values: Values) -> Span:
    span = Span(None, None)
    for row in rows:
        k = row.term.of_signal(name)
        end, strict = -row.term.without(name).at(values) / k, row.relation == "<"
        if k > 0 and (span.high is None or end < span.high or (end == span.high and strict)):
            span = Span(span.low, end, span.low_open, strict)
        if k < 0 and (span.low is None or end > span.low or (end == span.low and strict)):
            span = Span(end, span.high, strict, span.high_open)
    return span


# ----------------------------------------------------------------------------------------------------------- groups


@dataclass(frozen=True, eq=False)
class Group:
    """Comparisons that share signals, and every truth assignment of them that can occur.

    rows     the assignments, simplest values first
    sharp    whether no assignment is missing
    """

    names: tuple[str, ...]
    leaves: tuple[Comparison, ...]
    rows: tuple[tuple[bool, ...], ...]
    sharp: bool
    _parts: Mapping[tuple[bool, ...], Sequence[Polyhedron | Values]]

    def pick(self, row: tuple[bool, ...], draw: Draw) -> Values:
        """Values of the signals that have this truth."""
        parts = self._parts[row]
        part = parts[draw(len(parts))] if len(parts) > 1 else parts[0]
        return part.pick(draw) if isinstance(part, Polyhedron) else part

    def simplest(self, row: tuple[bool, ...]) -> Values:
        return self.pick(row, lambda n: 0)

    def spans(self, row: tuple[bool, ...]) -> list[Span] | None:
        """All values of the only signal that have this truth; None if there are several, or a table of points."""
        parts = [part for part in self._parts[row] if isinstance(part, Polyhedron)]
        if len(self.names) != 1 or len(parts) < len(self._parts[row]):
            return None
        return [part.span() for part in parts]


def groups(comparisons: Sequence[Comparison], ranges: Mapping[str, Range]) -> list[Group]:
    """The groups of comparisons over signals with these ranges (without limits if not given)."""
    return _groups(tuple(comparisons), tuple(ranges.items()))


@lru_cache(maxsize=64)
def _groups(comparisons: tuple[Comparison, ...], limits: tuple[tuple[str, Range], ...]) -> list[Group]:
    ranges = dict(limits)
    together: list[set[str]] = []
    for leaf in comparisons:
        own = {variable.name for variable in read_by(leaf)}
        together = [known for known in together if not known & own] + [own.union(*(k for k in together if k & own))]
    constant = [leaf for leaf in comparisons if not read_by(leaf)]
    found = [_group((), tuple(constant), ranges)] if constant else []
    for names in filter(None, together):
        leaves = [leaf for leaf in comparisons if any(variable.name in names for variable in read_by(leaf))]
        found.append(_group(tuple(sorted(names)), tuple(leaves), ranges))
    return found


def _group(names: tuple[str, ...], leaves: tuple[Comparison, ...], ranges: Mapping[str, Range]) -> Group:
    parts: dict[tuple[bool, ...], list[Polyhedron | Values]] = {}
    limits = _limits(names, ranges)
    split = [(alternatives(leaf, False), alternatives(leaf, True)) for leaf in leaves]
    if all(no is not None for no, _ in split):
        sharp = True
        for row, polyhedron in _assignments(names, limits, split):
            sharp &= polyhedron.sharp
            if polyhedron.simplest is not None:
                parts.setdefault(row, []).append(polyhedron)
    else:
        sharp = False
        for row, point in _points(names, leaves, ranges):
            parts.setdefault(row, []).append(point)
        parts = {row: sorted(points, key=lambda point: _weight(point)) for row, points in parts.items()}

    def weight(row: tuple[bool, ...]) -> tuple[int, Fraction, tuple[bool, ...]]:
        first = parts[row][0]
        point = first.simplest if isinstance(first, Polyhedron) else first
        assert point is not None
        return (*_weight(point), row)

    return Group(names, leaves, tuple(sorted(parts, key=weight)), sharp, parts)


def _weight(values: object) -> tuple[int, Fraction]:
    """How far from simple values are: digits, then size."""
    assert isinstance(values, dict)
    return sum(len(str(value)) for value in values.values()), sum(map(abs, values.values()), Fraction(0))


def _limits(names: Sequence[str], ranges: Mapping[str, Range]) -> list[Constraint]:
    found = []
    for name in names:
        low, high = ranges.get(name, (None, None))
        one = Linear(((name, Fraction(1)),), Fraction(0))
        if low is not None:
            found.append(Constraint(Linear((), low).plus(one, Fraction(-1)), "<="))
        if high is not None:
            found.append(Constraint(one.plus(Linear((), high), Fraction(-1)), "<="))
    return found


def _assignments(
    names: Sequence[str],
    limits: Sequence[Constraint],
    split: Sequence[tuple[list[tuple[Constraint, ...]] | None, list[tuple[Constraint, ...]] | None]],
) -> Iterator[tuple[tuple[bool, ...], Polyhedron]]:
    """Every truth assignment with a polyhedron of it; those that are empty are followed no further."""
    waiting: list[tuple[tuple[bool, ...], tuple[Constraint, ...]]] = [((), tuple(limits))]
    made = 0
    while waiting:
        row, rows = waiting.pop()
        polyhedron = Polyhedron(names, rows)
        made += 1
        if made > _MOST_POLYHEDRA:
            raise SizeError(
                f"{len(split)} comparisons of {', '.join(names)} have over {_MOST_POLYHEDRA} combinations; compare "
                "fewer of them"
            )
        if polyhedron.simplest is None and polyhedron.sharp:
            continue
        if len(row) == len(split):
            yield row, polyhedron
            continue
        for truth in (False, True):
            for more in split[len(row)][truth] or []:
                waiting.append(((*row, truth), (*rows, *more)))


# ------------------------------------------------------------------------------------------------- tables of points


def _points(
    names: tuple[str, ...], leaves: tuple[Comparison, ...], ranges: Mapping[str, Range]
) -> Iterator[tuple[tuple[bool, ...], Values]]:
    """Points with the exact truth of every comparison."""
    if not names:
        if (found := _signs(leaves, {})) is not None:
            yield tuple(_HOLDS[leaf.op](sign) for leaf, sign in zip(leaves, found, strict=True)), {}
        return
    constants = sorted({shortest(n.value) for leaf in leaves for n in numbers(leaf)})
    most = max([*map(abs, constants), Fraction(5)])
    fine = max(3, min(65, math.floor(_MOST_POINTS ** (1 / len(names))) - 2 * len(constants) - 3))
    axes: list[list[Fraction]] = []
    for name in names:
        low, high = ranges.get(name, (None, None))
        low = (-2 * most if high is None else min(-2 * most, high - 2 * most)) if low is None else low
        high = max(2 * most, low + 2 * most) if high is None else high
        step = (high - low) / (fine - 1)
        grid = {low, high, *(_rounded(low + i * step, 4) for i in range(fine))}
        grid |= {value for c in [*constants, Fraction(0)] for value in (c, -c)}
        axes.append(sorted(value for value in grid if low <= value <= high and kept(value)))
    if math.prod(map(len, axes)) > 20 * _MOST_POINTS:
        raise SettingsError(
            f"comparisons of {', '.join(names)} at once are not linear; values for more than two or three signals that "
            "are multiplied, or under a root, are not found: compare fewer of them, or write them linearly"
        )
    seen: dict[tuple[Fraction, ...], tuple[int, ...] | None] = {}

    def signs(point: tuple[Fraction, ...]) -> tuple[int, ...] | None:
        if point not in seen:
            seen[point] = _signs(leaves, dict(zip(names, point, strict=True)))
        return seen[point]

    crossed: Counter[tuple[tuple[int, ...], tuple[int, ...]]] = Counter()
    for point in itertools.product(*axes):
        here = signs(point)
        for i, axis in enumerate(axes):
            after = axis[axis.index(point[i]) + 1 :][:1]
            if not after:
                continue
            there = signs((*point[:i], after[0], *point[i + 1 :]))
            if here is None or there is None or here == there:
                continue
            crossed[here, there] += 1
            if crossed[here, there] <= _MOST_BORDERS:
                _bisect(point, i, after[0], signs)
    for point, found in seen.items():
        if found is not None:
            yield (
                tuple(_HOLDS[leaf.op](sign) for leaf, sign in zip(leaves, found, strict=True)),
                dict(zip(names, point, strict=True)),
            )


_HOLDS: dict[Comparator, Callable[[int], bool]] = {
    "<": lambda s: s < 0, "<=": lambda s: s <= 0, ">": lambda s: s > 0, ">=": lambda s: s >= 0,
    "==": lambda s: s == 0, "!=": lambda s: s != 0,
}  # fmt: skip


def _bisect(
    point: tuple[Fraction, ...], i: int, other: Fraction,
    signs: Callable[[tuple[Fraction, ...]], tuple[int, ...] | None],
) -> None:  # fmt: skip
    """Look at both sides of the border between two points, and at short decimals on it."""
    low, high = point[i], other

    def at(value: Fraction) -> tuple[int, ...] | None:
        return signs((*point[:i], value, *point[i + 1 :]))

    start = at(low)
    for _ in range(_BISECTIONS):
        middle = shortest(float((low + high) / 2))
        if middle in (low, high):
            break
        if at(middle) == start:
            low = middle
        else:
            high = middle
    for digits in range(13):
        value = _rounded((low + high) / 2, digits)
        if kept(value) and point[i] <= value <= other:
            at(value)


def _rounded(value: Fraction, digits: int) -> Fraction:
    return Fraction(round(value * 10**digits), 10**digits)


def _signs(leaves: Sequence[Comparison], values: Values) -> tuple[int, ...] | None:
    """The sign of left − right for each; None where a term has no value."""
    trace = {name: np.array([float(value)]) for name, value in values.items()}
    found = []
    try:
        for leaf in leaves:
            if satisfies(Comparison(">", leaf.left, leaf.right), trace):
                found.append(1)
            else:
                found.append(0 if satisfies(Comparison("==", leaf.left, leaf.right), trace) else -1)
    except TraceError:
        return None
    return tuple(found)


def numbers(leaf: Comparison) -> list[Number]:
    def inside(term: Term) -> list[Number]:
        match term:
            case Number():
                return [term]
            case Variable():
                return []
            case Negate(arg):
                return inside(arg)
            case Arithmetic(_, left, right):
                return inside(left) + inside(right)
            case Call(_, args):
                return [number for arg in args for number in inside(arg)]
            case _:
                assert_never(term)

    return inside(leaf.left) + inside(leaf.right)
