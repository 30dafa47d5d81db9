"""The contents of a certificate, item by item (docs/certificates.md): header, model, automaton, policy, numbers,
bounds.

The numbers are an approximation v of the values of open pairs. What is proved about them rests on their *distances*,
which the reader measures: the difference between v_t and the result of one step from v_{t+1}. Here they are bounded
beforehand:

    fixed point   U_t = opt_c ⌈Σ n·U_{t+1} / D⌉ is less than one unit too large, and not at all in sweeps that do not
                  round (checking/fixed.py): upwards 0, downwards h − j units in all
    doubles       a step of d terms (and m choices mixed) rounds n = d + 1 (+ 2m + 2) times, a share's own rounding
                  included: γ_n = n·u/(1 − n·u) of its value, which is at most 1/(1 − h·(γ_n + the rows' excess)); two
                  halves of a unit are added where numbers become integers
    intervals     a step of rows of d entries, in doubles, moves values by less than 8·d·u, and a mixture by 2·m·u + u
                  and the rounding of its m shares, as much again (checking/robust.py); two halves of a unit as above
    exact         N_t = V_t · D^(h−t): none

A minimum is listed as 1 minus a maximum: that of the probability that the formula fails.
"""

from __future__ import annotations

import itertools
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.check import NaturesAim
from stltool.checking.fixed import FixedPoint, fixed_point
from stltool.checking.induction import (
    EVERYTHING,
    OPEN,
    Arithmetic,
    Budget,
    ClusterWay,
    Digits,
    Doubles,
    Engine,
    ExactNature,
    Fixed,
    Following,
    Game,
    Integers,
    Layers,
    Nature,
    Passed,
    Values,
    Way,
    Words,
    layers_of,
)
from stltool.checking.rational import exact_arithmetic, require_room
from stltool.checking.robust import require_exact_ends, require_short_rows
from stltool.choices import Form, Indices
from stltool.errors import SizeError
from stltool.models import MDP
from stltool.models.fractions import over_one
from stltool.models.rows import Rows
from stltool.policy import Policy
from stltool.product import Product
from stltool.recheck import BITS, DIGITS, FORMAT, PLACES

if TYPE_CHECKING:
    from distributed import Client

Item: TypeAlias = dict[str, Any] | list[Any] | str
"""A line of the file: an object, a list, or its text."""
Bounds: TypeAlias = tuple[Fraction, Fraction]
I64: TypeAlias = NDArray[np.int64]
Texts: TypeAlias = NDArray[np.bytes_]

SMALLER = "shorten the windows, round the probabilities to fewer digits, or certify a result of check without exact"
_U = Fraction(1, 2**53)
_UNIT = 2**55  # for doubles: four times as fine as they are next to 1
_BLOCK = 2**24  # bits of the masks that are made at a time
_TABLE = 2**16  # numbers that layers share a table for; one layer may have more
_NUMBERS = 2**20  # digits in a line of numbers
_HEX = np.frombuffer(b"0123456789abcdef", dtype=np.uint8)


# ---------------------------------------------------------------------------------------- task, model, automaton


def header(product: Product, claim: str, policy: Policy | None, aim: NaturesAim | None = None) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "claim": claim,
        "nature": aim,
        "task": product.task_name,
        "formula": str(product.formula),
        "encoding": product.automaton.encoding,
        "horizon": product.horizon,
        "model": product.model.name,
        "policy": policy.kind if policy is not None else None,
    }


def model_items(product: Product, layers: Layers[Any, Any], form: Form | None) -> Iterator[Item]:
    """The denominators, then states of the model: number, initial share, letter.

    States in which runs can be undecided are listed with their choices; in the others runs start or are decided.
    Choices that a policy does not take are listed without successors.
    """
    model, acting, rows = product.model, layers.acting(), acting_rows(layers)
    first = layers.game.first
    shares, total = over_one(model.initial_share(s) for s in first.tolist())
    yield {"denominator": denominator_of(rows), "initial_denominator": total}
    taken = np.ones(rows.choice_start[-1], dtype=np.bool_)
    if form is not None:
        taken = _taken(layers, form, acting, rows.choice_start)
    successors = rows.target[np.repeat(taken, np.diff(rows.row_start))]
    states, listed = np.unique(np.concatenate([acting, successors, first])), iter(taken.tolist())
    share_of = dict(zip(first.tolist(), shares.tolist(), strict=True))
    choices_of = dict(zip(acting.tolist(), choices_listed(rows), strict=True))
    for s, letter in zip(states.tolist(), product.letter[states].tolist(), strict=True):
        choices = zip(choices_of.get(s, []), listed, strict=False)
        yield [s, share_of.get(s, 0), letter, *(choice if said else [] for choice, said in choices)]


def _taken(layers: Layers[Any, Any], form: Form, acting: I64, start: I64) -> NDArray[np.bool_]:
    """Which choices a policy takes anywhere; those of the states `acting` begin at `start`."""
    found = np.zeros(start[-1], dtype=np.bool_)
    for first, last, layer in layers.reached:
        s, q = layers.pairs_reached(layer)
        begin, t = start[np.searchsorted(acting, s)], last
        while t >= first:
            taken = form.at(t, s, q)
            if form.deterministic:
                found[begin + taken] = True
            else:
                which, number = np.nonzero(taken)
                found[begin[which] + number] = True
            t = form.alike(t)[0] - 1
    return found


def acting_rows(layers: Layers[Any, Any]) -> Rows:
    """The states that undecided runs can leave, in order."""
    return layers.rows.some(layers.asked.at(layers.acting()))


def choices_listed(rows: Rows) -> Iterator[list[list[int]]]:
    """The choices of each state: each successor followed by its numerator, or by those of its interval's ends."""
    numbers = rows.intervals.exact[:2] if rows.intervals is not None else (rows.numerator,)
    columns = rows.target, *numbers
    entries = itertools.chain.from_iterable(zip(*(column.tolist() for column in columns), strict=True))
    lengths, counts = iter((len(columns) * np.diff(rows.row_start)).tolist()), np.diff(rows.choice_start).tolist()
    for n in counts:
        yield [[*itertools.islice(entries, length)] for length in itertools.islice(lengths, n)]


def denominator_of(rows: Rows) -> int:
    """The denominator of the numbers of `choices_listed`."""
    return rows.intervals.exact[2] if rows.intervals is not None else rows.denominator


def automaton_items(product: Product) -> Iterator[Item]:
    """Sizes and steps, then δ for each letter, then the verdicts that hold from each of these steps on."""
    automaton = product.automaton
    yield {
        "states": automaton.n_states,
        "letters": automaton.n_letters,
        "start": int(automaton.initial),
        "verdicts": automaton.verdict_starts.tolist(),
    }
    for row in itertools.chain(automaton.delta, automaton.verdict_rows):
        yield row.tolist()


# ------------------------------------------------------------------------------------------------------ policy


def following(
    product: Product, policy: Policy, budget: Budget, exact: bool = True, engine: Engine = "auto"
) -> Layers[Any, Any]:
    """The layers of a policy's runs; unless `exact`, a mixture's weights are divided by their sum in doubles."""
    form = policy.form if exact or policy.deterministic else _ToOne(policy.form)
    return layers_of(Game.of(product), TRUE, Following(form), engine=engine, budget=budget)


class PolicyItems:
    """A policy's choices in the reachable pairs, in blocks of steps that share them, from the last step back."""

    def __init__(self, layers: Layers[Any, Any], product: Product, form: Form) -> None:
        self._layers, self._product, self._form = layers, product, form
        self._back = layers.reached.back()
        self._next = next(self._back, None)

    def before(self, t: int) -> tuple[int, Iterator[Item]]:
        """The block that ends before step t: its first step, and its items."""
        first = max(0, self._form.alike(t - 1)[0])
        n_states, codes = self._product.automaton.n_states, np.empty(0, dtype=np.int64)
        while self._next is not None and self._next.last >= first:
            s, q = self._layers.pairs_reached(self._next.layer)
            codes = np.union1d(codes, s * n_states + q)
            if self._next.first < first:
                break
            self._next = next(self._back, None)
        return first, self._items(first, t - 1, *np.divmod(codes, n_states))

    def all(self) -> Iterator[Item]:
        t = self._product.horizon
        while t > 0:
            t, items = self.before(t)
            yield from items

    def _items(self, first: int, last: int, s: I64, q: I64) -> Iterator[Item]:
        yield {"policy": [first, last]}
        taken = self._form.at(last, s, q)
        n_choices, n_states = np.diff(self._product.model.choice_start), self._product.automaton.n_states
        shares: list[list[int]] = []
        if not self._form.deterministic:
            rows, taken = np.unique(taken, axis=0, return_inverse=True)
            shares, taken = [_integers(row) for row in rows.tolist()], taken.ravel()
        order = np.lexsort((q, taken, s))
        s, q, taken = s[order], q[order], taken[order]
        begin = np.flatnonzero((np.diff(s, prepend=-1) != 0) | (np.diff(taken, prepend=-1) != 0))
        masks = _masks(begin, q, n_states)
        for state, mask, what in zip(s[begin].tolist(), masks, taken[begin].tolist(), strict=True):
            yield [state, mask, shares[what][: n_choices[state]] if shares else what]


def _integers(weights: list[float]) -> list[int]:
    """Integers in the same proportions."""
    shares = [Fraction(weight) for weight in weights]
    whole = math.lcm(*(share.denominator for share in shares))
    numbers = [int(share * whole) for share in shares]
    common = math.gcd(*numbers)
    return [number // common for number in numbers]


@dataclass(frozen=True, eq=False)
class _ToOne:
    """A mixture whose weights are divided by their sum, which may differ slightly from 1."""

    form: Form
    deterministic = False

    @property
    def stationary(self) -> bool:
        return self.form.stationary

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        return _divided(self.form.at(t, s, q))

    def row(self, t: int) -> NDArray[Any]:
        return _divided(self.form.row(t))

    def alike(self, t: int) -> tuple[int, int]:
        return self.form.alike(t)

    def mixtures(self) -> NDArray[np.float64]:
        return _divided(self.form.mixtures())


def _divided(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    divided: NDArray[np.float64] = weights / weights.sum(axis=-1, keepdims=True)
    return divided


# ----------------------------------------------------------------------------------------------------- numbers


class Numbers(ABC):
    """Values of open pairs as integers. `unit` is the integer for 1 in the last layer that was made."""

    arithmetic: Arithmetic

    @property
    @abstractmethod
    def unit(self) -> int: ...

    @abstractmethod
    def integers(self, values: Values) -> list[int]: ...

    @abstractmethod
    def places(self, values: Values, unit: int) -> tuple[int, Texts, I64]:
        """How many numbers stay in the table; those to be added to it, as long as the unit; each value's position."""

    @abstractmethod
    def bounds(self, layers: Layers[Any, Any], model: MDP, at_start: list[int]) -> Bounds:
        """Bounds on the goal's probability, from the values at the game's first pairs."""


class Rounded(Numbers):
    """Doubles or fixed point; `high` and `low` bound the sums of distances upwards and downwards."""

    unit = 0

    def __init__(self, arithmetic: Arithmetic, unit: int, high: Fraction, low: Fraction) -> None:
        self.arithmetic, self.unit, self.high, self.low = arithmetic, unit, high, low
        self._known = self._place = np.empty(0, dtype=np.int64)  # numbers in the table, ascending; positions

    @classmethod
    def of(cls, layers: Layers[Any, Any], model: MDP) -> Rounded:
        """In fixed point, if that proves tighter bounds."""
        in_doubles = cls._in_doubles(layers)
        scale = None if layers.allowed.mixed else fixed_point(model, layers.kinds)
        if scale is None:
            return in_doubles
        in_fixed = cls._in_fixed(scale, layers.game.horizon)
        return in_fixed if in_fixed.low <= in_doubles.low + in_doubles.high else in_doubles

    @classmethod
    def of_nature(cls, layers: Layers[Any, Any], minimal: bool) -> Rounded:
        """For rows of intervals that contain a distribution exactly."""
        rows = acting_rows(layers)
        roundings = 8 * rows.longest + (4 * rows.most_choices + 4 if layers.allowed.mixed else 0)
        far = layers.game.horizon * (roundings * _U + Fraction(1, _UNIT))
        return cls(Nature(minimal, maximize=True), _UNIT, far, far)

    @classmethod
    def _in_fixed(cls, scale: FixedPoint, h: int) -> Rounded:
        low = Fraction(scale.roundings(h), scale.one)
        return cls(Fixed(scale.denominator, scale.one, maximize=True), scale.one, Fraction(0), low)

    @classmethod
    def _in_doubles(cls, layers: Layers[Any, Any]) -> Rounded:
        h, rows = layers.game.horizon, acting_rows(layers)
        n = rows.longest + 1 + (2 * rows.most_choices + 2 if layers.allowed.mixed else 0)
        gamma = n * _U / (1 - n * _U) if n * _U < 1 else Fraction(1)
        _, excess = defects(rows)
        room = 1 - h * (gamma + excess)
        step = (gamma / room + Fraction(1, _UNIT)) * (1 + excess) + _U**2 if room > 0 else Fraction(1)
        return cls(Doubles(maximize=True), _UNIT, h * step, h * step)

    def integers(self, values: Values) -> list[int]:
        found: list[int] = self._rounded(values).tolist()
        return found

    def places(self, values: Values, unit: int) -> tuple[int, Texts, I64]:
        numbers, n = self._rounded(values), len(self._known)
        at = np.searchsorted(self._known, numbers) if n else np.zeros(len(numbers), dtype=np.int64)
        there = np.append(self._known, -1)[at] == numbers
        first, number = _met(numbers[~there])
        new = numbers[~there][first]
        if n and n + len(new) > _TABLE:
            self._known = self._place = np.empty(0, dtype=np.int64)
            return self.places(values, unit)
        places = np.append(self._place, 0)[at]
        places[~there] = n + number
        order = np.argsort(known := np.concatenate([self._known, new]))
        self._known, self._place = known[order], np.append(self._place, np.arange(n, n + len(new)))[order]
        return n, _digits(new[:, None], 63, len(f"{unit:x}")), places

    def bounds(self, layers: Layers[Any, Any], model: MDP, at_start: list[int]) -> Bounds:
        return _around(layers, model, Fraction(1, self.unit), at_start, self.high, self.low)

    def _rounded(self, values: Values) -> I64:
        whole: I64 = values if values.dtype.kind == "i" else np.rint(values * self.unit).astype(np.int64)
        return whole


class Exact(Numbers):
    """Values without any rounding."""

    def __init__(self, arithmetic: Digits | Integers) -> None:
        self.arithmetic: Digits | Integers = arithmetic
        self._known: dict[int, int] = {}  # each number's position in the table, in units of 1/_unit
        self._unit = 1

    @property
    def unit(self) -> int:
        return self.arithmetic.one

    def integers(self, values: Values) -> list[int]:
        return [self.arithmetic.number(value) for value in values]

    def places(self, values: Values, unit: int) -> tuple[int, Texts, I64]:
        width = len(f"{unit:x}")
        if isinstance(self.arithmetic, Digits):
            texts = _digits(values, self.arithmetic.bits, width)
        else:
            texts = np.array([f"{value:0{width}x}" for value in values.tolist()], dtype=f"S{width}")
        first, which = _met(texts)
        texts = texts[first]
        growth, self._unit = unit // self._unit, unit
        known = {number * growth: place for number, place in self._known.items()}
        n, numbers = len(known), [int(text, 16) for text in texts.tolist()]
        new = np.array([number not in known for number in numbers], dtype=np.bool_)
        if n and n + new.sum() > _TABLE:
            known, n, new = {}, 0, np.ones(len(numbers), dtype=np.bool_)
        places = np.array([known.setdefault(number, len(known)) for number in numbers], dtype=np.int64)
        self._known = known
        return n, texts[new], places[which]

    def bounds(self, layers: Layers[Any, Any], model: MDP, at_start: list[int]) -> Bounds:
        return _around(layers, model, Fraction(1, self.unit), at_start, Fraction(0), Fraction(0))


def _met(values: NDArray[Any]) -> tuple[I64, I64]:
    """The index where each distinct value first occurs, in order, and each value's number among the distinct ones."""
    _, first, which = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return first[order], number[which.ravel()]


def _digits(limbs: I64, bits: int, width: int) -> Texts:
    """Numbers of limbs (n, k) of `bits` bits each, least significant first, as hexadecimal numbers of `width` digits
    each."""
    found = np.zeros((len(limbs), width), dtype=np.uint8)
    for i in range(width):
        limb, shift = divmod(4 * i, bits)
        digit = limbs[:, limb] >> shift if limb < limbs.shape[1] else np.zeros(len(limbs), dtype=np.int64)
        if shift + 4 > bits and limb + 1 < limbs.shape[1]:
            digit |= limbs[:, limb + 1] << (bits - shift)
        found[:, width - 1 - i] = digit & 15
    return _HEX[found].view(f"S{width}").ravel()


def defects(rows: Rows) -> tuple[Fraction, Fraction]:
    """The largest amounts by which a row's sum is below 1, and above 1; intervals contain a distribution exactly."""
    if rows.intervals is not None:
        return Fraction(0), Fraction(0)
    D = rows.denominator
    sums = [D, *np.add.reduceat(rows.numerator, rows.row_start[:-1]).tolist()] if len(rows.target) else [D]
    return Fraction(D - min(sums), D), Fraction(max(sums) - D, D)


def _around(
    layers: Layers[Any, Any], model: MDP, unit: Fraction, at_start: list[int], high: Fraction, low: Fraction
) -> Bounds:
    """Bounds on Σ ι·V_0 from the total distances, and from how far rows and the initial distribution are from summing
    to 1."""
    h, starts, total = layers.game.horizon, layers.game.first.tolist(), model.initial_total
    value = sum((model.initial_share(s) * v for s, v in zip(starts, at_start, strict=True)), Fraction(0)) * unit
    missing, excess = defects(acting_rows(layers))
    room = 1 - h * excess
    if room <= 0:
        return Fraction(0), Fraction(1)
    none, all_ = Fraction(0), Fraction(1)
    high, low = ((far + h * (missing + excess)) / room * max(total, all_) for far in (high, low))
    return max(value - low - max(total - 1, none), none), min(value + high + max(1 - total, none), all_)


# ------------------------------------------------------------------------------------------------------ layers


class Listing:
    """Layers as lines, from the last step back."""

    def __init__(self, numbers: Numbers, n_states: int) -> None:
        self._numbers, self._n_states, self._unit = numbers, n_states, 1

    def layer(self, first: int, last: int, s: I64, q: I64, values: Values, unit: int) -> Iterator[Item]:
        """Steps first … last: the pairs (s, q), in order, and their values, as the arithmetic holds them."""
        if unit.bit_length() > BITS:
            raise SizeError(f"numbers of {unit.bit_length()} bits are too long for a certificate; {SMALLER}")
        known, new, places = self._numbers.places(values, unit)
        yield {"layer": [first, last], "scale": f"{unit // self._unit:x}", "known": known}
        self._unit = unit
        for i in range(0, len(new), most := max(1, _NUMBERS // new.itemsize)):
            yield [new[i : i + most].tobytes().decode()]
        size, kind = next((size, kind) for most, size, kind in _PLACES if known + len(new) <= most)
        begin = np.flatnonzero(np.diff(s, prepend=-1))
        text = places.astype(kind).tobytes().hex()
        cuts = (2 * size * np.append(begin, len(s))).tolist()
        masks = _masks(begin, q, self._n_states)
        for state, mask, (a, b) in zip(s[begin].tolist(), masks, itertools.pairwise(cuts), strict=True):
            yield f'[{state},"{mask}","{text[a:b]}"]'


_PLACES = tuple((most, struct.calcsize(code), np.dtype(f">u{struct.calcsize(code)}")) for most, code in PLACES)


class Proof:
    """All items except the conclusion; the bounds that they prove are known once all are made."""

    bounds: Bounds

    def __init__(
        self,
        product: Product,
        policy: Policy | None,
        claim: str,
        exact: bool,
        budget: Budget,
        memory_limit: int | None,
        client: Client | None = None,
        aim: NaturesAim | None = None,
    ) -> None:
        self._client = client
        self._product, self._claim, self._header = product, claim, header(product, claim, policy, aim)
        engine: Engine = "auto" if client is None else "words"
        self._form: Form | None = None
        self._policy: PolicyItems | None = None
        if claim == "policy":
            assert policy is not None
            self.layers = following(product, policy, budget, exact, engine)
            self._form = policy.form
            self._policy = PolicyItems(self.layers, product, policy.form)
        else:
            goal = FALSE if claim == "minimum" else TRUE
            self.layers = layers_of(Game.of(product), goal, EVERYTHING, engine=engine, budget=budget)
        self.numbers: Numbers
        if aim is None:
            D = self.layers.rows.denominator
        else:
            require_short_rows(self.layers.kinds)
            D = require_exact_ends(product, self.layers.kinds)
        if D >= 10**DIGITS or (exact and product.horizon * D.bit_length() > BITS):
            raise SizeError(
                f"probabilities over a common denominator of {D.bit_length()} bits, over {product.horizon} steps, are "
                f"too long for a certificate; {SMALLER}"
            )
        if aim is not None:
            minimal = (aim == "least") == (claim != "minimum")  # of a minimum, numbers are of the other verdict
            if exact:
                require_room(self.layers, 64, memory_limit=memory_limit)
                self.numbers = Exact(ExactNature(minimal, D, maximize=True))
            else:
                self.numbers = Rounded.of_nature(self.layers, minimal)
        elif exact:
            self.numbers = Exact(exact_arithmetic(self.layers, True, memory_limit=memory_limit))
        else:
            self.numbers = Rounded.of(self.layers, product.model)

    def items(self) -> Iterator[Item]:
        """The items of the file, in order."""
        yield self._header
        yield from model_items(self._product, self.layers, self._form)
        yield from automaton_items(self._product)
        yield from self._steps()

    def _steps(self) -> Iterator[Item]:
        """Layer after layer; steps that share one are listed once, except where the policy changes."""
        t, policy_from = self._product.horizon, 0 if self._policy is None else self._product.horizon
        listing = Listing(self.numbers, self._product.automaton.n_states)
        for first, layer, values, one in self._stretches():
            while t > first:
                if t == policy_from and self._policy is not None:
                    policy_from, items = self._policy.before(t)
                    yield from items
                begin = max(first, policy_from)
                yield from listing.layer(begin, t - 1, *self.layers.pairs(layer), values[OPEN:], one)
                t = begin

    def _way(self) -> Way | ClusterWay:
        arithmetic = self.numbers.arithmetic
        if self._client is None:
            return Way(self.layers, arithmetic, maximize=True)
        assert isinstance(self.layers, Words)
        assert isinstance(arithmetic, Doubles | Fixed)
        return ClusterWay(self._client, self.layers, arithmetic)

    def _stretches(self) -> Iterator[tuple[int, Any, Values, int]]:
        """For each stretch of steps that share a layer: its first step, the layer, its values and their unit."""
        way = self._way()
        at, first, unit, h = way.end(), self._product.horizon, 1, self._product.horizon
        held: Passed | None = None  # steps from `first` on share this layer
        for step in way.back(at):
            empty = not self.layers.n_open(step.at.ahead)
            if held is None:
                held, first = at, step.last + 1  # from here on every verdict is known
            if not step.again and not (empty and not self.layers.n_open(held.ahead)):
                if first < h:
                    yield first, held.ahead, way.by_slot(held), unit
                held, unit = step.at, unit if empty else self.numbers.unit
            at, first = step.at, step.first
        held = at if held is None else held
        if h:
            yield 0, held.ahead, way.by_slot(held), unit
        at_start = way.by_slot(at)[self.layers.first_slots(at.ahead)]
        lower, upper = self.numbers.bounds(self.layers, self._product.model, self.numbers.integers(at_start))
        self.bounds = (1 - upper, 1 - lower) if self._claim == "minimum" else (lower, upper)


def _masks(begin: I64, q: I64, n_states: int) -> Iterator[str]:
    """The sets q[begin[i]:begin[i+1]] of numbers below n_states, as bits of hexadecimal numbers."""
    ends = np.append(begin[1:], len(q))
    width = 8 * (n_states // 8 + 1)
    for rows in range(0, len(begin), most := max(1, _BLOCK // width)):
        part = slice(begin[rows], ends[min(rows + most, len(begin)) - 1])
        owner = np.repeat(np.arange(len(begin[rows : rows + most])), (ends - begin)[rows : rows + most])
        bits = np.zeros((len(begin[rows : rows + most]), width), dtype=np.bool_)
        bits[owner, width - 1 - q[part]] = True
        packed = np.packbits(bits, axis=1)
        yield from (row.tobytes().hex().lstrip("0") for row in packed)
