"""Rows of a grid world, made when they are asked for: they depend on the ways out of a cell, and on its noise.

A cell's *kind* is which of its eight neighbours it can be left for (free ones, unless a one-way cell bars the way), and
the noise of its moves. Cells of one kind have the same rows, up to where the neighbours stand; the rows of each kind
that the map has are kept (`kinds`, whose targets are directions): a million cells have a table of a few thousand
entries. States are numbered in reading order from the top left, so the entries of
a row, which are ordered by state, are ordered by direction for every cell alike.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from math import lcm
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.arrays import read_only
from stltool.models.fractions import LARGEST_SUM, Shares, doubles_of
from stltool.models.intervals import Intervals
from stltool.models.parameters import Parameter, Ties, Values
from stltool.models.rows import I32, I64, Chances, Outcome, Rows, Source, starts
from stltool.sizes import Numbers, integer_type, unsigned_type

Ends: TypeAlias = tuple[Fraction, Fraction]
Noise: TypeAlias = tuple[Ends, Ends]
"""The probability of success, and of each of three slips."""

_Share = TypeVar("_Share")

COMPASS = {
    "N": (0, 1),
    "NE": (1, 1),
    "E": (1, 0),
    "SE": (1, -1),
    "S": (0, -1),
    "SW": (-1, -1),
    "W": (-1, 0),
    "NW": (-1, 1),
}
READING = ("NW", "N", "NE", "W", "stay", "E", "SW", "S", "SE")
"""Directions in the order of the states that they lead to."""


class Cells(Source):
    """The rows of the free cells of a map.

    free      (height, width) Booleans, the top row first        moves   names of `COMPASS`, or "stay"
    noises    for each noise, the ends of two probabilities (equal ones where these are known exactly): that a move is
              the action's, and of each of three others: stay, and the two directions beside it (`beside`)
    which     (n_states,) the noise of each cell; None: the first
    barred    (n_states,) uint8: the bits of the directions of `COMPASS` in which a cell cannot be left; None: none
    parameter if they depend on one: `noises` are then the values at the ends of its domain

    Every grid with one exact noise is a member of a family: that of its success probability, anywhere in [0, 1].
    """

    def __init__(
        self,
        free: NDArray[np.bool_],
        moves: tuple[str, ...],
        noises: Sequence[Noise],
        uncertain: bool,
        parameter: Parameter | None = None,
        which: I64 | None = None,
        barred: NDArray[np.uint8] | None = None,
    ) -> None:
        self._moves, self._uncertain, self._parameter = moves, uncertain, parameter
        self._noises = tuple(noises)
        self._family: Cells | None = None
        height, width = free.shape
        around = np.full((height + 2, width + 2), -1, dtype=np.int32)
        inside = around[1:-1, 1:-1]
        inside[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
        self._around, self._cell = around.ravel(), np.flatnonzero(around >= 0).astype(np.int32)
        steps = {**COMPASS, "stay": (0, 0)}
        self._offset = np.array([steps[name][0] - steps[name][1] * (width + 2) for name in READING], dtype=np.int32)
        used = circle(moves)  # other directions do not make a difference
        masks = np.zeros(len(self._cell), dtype=np.int64)
        for bit, name in enumerate(COMPASS):
            if name in used:
                open_there = self._around[self._cell + self._offset[READING.index(name)]] >= 0
                if barred is not None:
                    open_there &= (barred >> np.uint8(bit)) & np.uint8(1) == 0
                masks |= open_there.astype(np.int64) << bit
        codes = masks if which is None else masks * len(self._noises) + which
        present = np.flatnonzero(np.bincount(codes))
        number = np.zeros(int(codes.max()) + 1, dtype=unsigned_type(len(present) - 1))
        number[present] = np.arange(len(present))
        self._kind = number[codes]
        ways, noise = (present, np.zeros_like(present)) if which is None else np.divmod(present, len(self._noises))
        self._ways = [
            _Way(frozenset(name for bit, name in enumerate(COMPASS) if mask >> bit & 1), k)
            for mask, k in zip(ways.tolist(), noise.tolist(), strict=True)
        ]
        self._table = _table(self._ways, moves, self._noises, uncertain, parameter)

    @property
    def n_states(self) -> int:
        return len(self._cell)

    @property
    def n_choices(self) -> int:
        return len(self._cell) * len(self._moves)

    @cached_property
    def n_transitions(self) -> int:
        entries = np.diff(self._table.row_start[self._table.choice_start])
        return int(np.bincount(self._kind, minlength=len(entries)) @ entries)

    @cached_property
    def choice_start(self) -> I64:
        return read_only(np.arange(self.n_states + 1, dtype=np.int64) * len(self._moves))

    @cached_property
    def choice_action(self) -> I32:
        return np.tile(np.arange(len(self._moves), dtype=np.int32), self.n_states)

    @property
    def most_choices(self) -> int:
        return len(self._moves)

    @property
    def kinds(self) -> Rows:
        return self._table

    @property
    def uncertain(self) -> bool:
        return self._uncertain

    @property
    def widest(self) -> int:
        return self._table.widest

    def rows(self, states: I64) -> Rows:
        found = self._table.some(self._kind[states].astype(np.int64))
        assert found.entry is not None
        cells = np.repeat(self._cell[states], np.diff(found.row_start[found.choice_start]))
        target = self._around[cells + self._offset[found.target]]
        few: Numbers = found.entry.astype(integer_type(len(self._table.target)))  # int16 for one noise: ≤ 256 · 9 · 4
        return Rows(found.choice_start, found.row_start, target, found.chances, few)

    def outcomes(self, s: int, number: int) -> list[Outcome]:
        if self._parameter is not None or any(low != high for noise in self._noises for low, high in noise):
            return super().outcomes(s, number)  # nominal probabilities of intervals
        way = self._ways[int(self._kind[s])]
        found = []
        noise = [share for share, _ in self._noises[way.noise]]
        for name, direction, share in _outcomes(self._moves[number], circle(self._moves), noise, Fraction(1)):
            there = READING.index(direction if direction in way.out else "stay")
            target = int(self._around[self._cell[s] + self._offset[there]])
            found += [Outcome(name, target, share)] if share else []
        return found

    def nominal(self) -> Cells:
        """Entries whose probability must be 0 are left out."""
        if not self._uncertain:
            return self
        return self._other(_nominal(self._table), False, None, self.family)

    @property
    def family(self) -> Cells | None:
        if self._parameter is not None:
            return self
        if self._family is None and not self._uncertain and len(self._noises) == 1:
            third = Fraction(1, 3)
            self._family = self._made([((Fraction(0), Fraction(1)), (third, Fraction(0)))], SUCCESS, None)
        return self._family

    def at(self, values: Values) -> Cells:
        assert self._parameter is not None
        x = self._parameter.share(self._parameter.require(values[self._parameter.name]))
        return self._made([(_between(one, x, x), _between(other, x, x)) for one, other in self._noises], None, self)

    def narrowed(self, parameters: tuple[Parameter, ...]) -> Cells:
        assert self._parameter is not None
        (narrow,) = parameters
        x, y = (self._parameter.share(end) for end in (narrow.lower, narrow.upper))
        return self._made([(_between(one, x, y), _between(other, x, y)) for one, other in self._noises], narrow, None)

    def _made(self, noises: Sequence[Noise], parameter: Parameter | None, family: Cells | None) -> Cells:
        """The same cells with other noise."""
        uncertain = parameter is not None
        table = _table(self._ways, self._moves, noises, uncertain, parameter)
        found = self._other(table, uncertain, parameter, family)
        found._noises = tuple(noises)
        return found

    def _other(self, table: Rows, uncertain: bool, parameter: Parameter | None, family: Cells | None) -> Cells:
        found = object.__new__(Cells)
        found.__dict__.update(self.__dict__)
        found.__dict__.pop("n_transitions", None)
        found._table, found._uncertain, found._parameter, found._family = table, uncertain, parameter, family
        return found


SUCCESS = Parameter("success", Fraction(0), Fraction(1))
"""The parameter of a grid whose file declares none."""


def _between(ends: Ends, x: Fraction, y: Fraction) -> Ends:
    """Where shares x and y of the way from the first end to the last lie."""
    return (1 - x) * ends[0] + x * ends[1], (1 - y) * ends[0] + y * ends[1]


def circle(moves: Sequence[str]) -> list[str]:
    """The directions that a robot with these moves goes or slips in, clockwise: all eight if a move is diagonal."""
    return [name for name in COMPASS if len(name) == 1 or any(len(move) == 2 for move in moves)]


def _outcomes(
    move: str, around: Sequence[str], noise: Sequence[_Share], whole: _Share
) -> list[tuple[str, str, _Share]]:
    """What may happen to a move: its name, the direction that the robot then goes in, and its share of the whole.

    around  the directions that it goes or slips in, clockwise      noise  the shares of success and of each slip
    """
    if move == "stay":
        return [("stay", "stay", whole)]
    place = around.index(move)
    success, slip = noise
    left, right = around[place - 1], around[(place + 1) % len(around)]
    return [("success", move, success), ("stay", "stay", slip), ("left", left, slip), ("right", right, slip)]


class _Way(NamedTuple):
    """A kind of cells: the directions in which they can be left, and the number of their noise."""

    out: frozenset[str]
    noise: int


def _table(
    ways: Sequence[_Way],
    moves: tuple[str, ...],
    noises: Sequence[Noise],
    uncertain: bool,
    parameter: Parameter | None,
) -> Rows:
    """The rows of a cell by its kind.

    Outcomes that lead to the same cell (a wall stands there) add their ends: a distribution over cells within the added
    ends always comes from one over outcomes, for a cell's share y of [Σ l_j, Σ u_j] can be split as
    l_j + θ·(u_j − l_j) with one θ in [0, 1], and totals agree.
    """
    denominator = lcm(*(end.denominator for noise in noises for ends in noise for end in ends))
    shares = [[[int(end * denominator) for end in ends] for ends in noise] for noise in noises]
    around = circle(moves)
    lengths: list[int] = []
    target: list[int] = []
    least: list[int] = []
    most: list[int] = []
    for way, move in itertools.product(ways, moves):
        lower, upper = [0] * len(READING), [0] * len(READING)
        for _, direction, ends in _outcomes(move, around, shares[way.noise], [denominator, denominator]):
            there = READING.index(direction if direction in way.out else "stay")
            lower[there] += ends[0]
            upper[there] += ends[1]
        possible = [k for k, ends in enumerate(zip(lower, upper, strict=True)) if any(ends)]
        lengths.append(len(possible))
        target += possible
        least += [lower[k] for k in possible]
        most += [upper[k] for k in possible]
    row_start = starts(np.array(lengths, dtype=np.int64))
    choice_start = np.arange(len(ways) + 1, dtype=np.int64) * len(moves)
    low, high = (np.array(ends, dtype=np.int64 if 4 * denominator < LARGEST_SUM else object) for ends in (least, most))
    directions = np.array(target, dtype=np.int32)
    if not uncertain:
        given = Shares(low, denominator)
        return Rows(choice_start, row_start, directions, Chances(doubles_of(low, denominator), row_start, given))
    ties = None
    if parameter is not None:
        ties = Ties((parameter,), low, high, denominator, np.zeros(len(low), dtype=np.int16))
        low, high = np.minimum(low, high), np.maximum(low, high)
    # of the ends before they are cut to 1, so that the nominal model has one noise everywhere
    nominal = Intervals(doubles_of(low, denominator), doubles_of(high, denominator)).nominal(row_start)
    cut = Intervals.of_shares(Shares(low, denominator), Shares(np.minimum(high, denominator), denominator))
    return Rows(choice_start, row_start, directions, Chances(nominal, row_start, intervals=cut, ties=ties))


def _nominal(table: Rows) -> Rows:
    kept = table.probability > 0
    row_start = starts(kept)[table.row_start]
    chances = Chances(table.probability[kept], row_start)
    return replace(table, row_start=row_start, target=table.target[kept], chances=chances)
