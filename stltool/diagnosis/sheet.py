"""The value of every sub-formula at every step of a trace of which some samples are known, operator by operator.

From the root down, two questions are answered for all steps at once:

    critical   which values of atoms are surely needed: those on a path on which every alternative is needed
    decisive   a set of values of the operands that decides an operator's value at given steps: one alternative where
               one suffices (the earliest), and all where all are needed

with `φ U ψ` as the alternatives u in t+a … t+b, each the conjunction of ψ at u and φ at t … u−1.
"""

from __future__ import annotations

from typing import NamedTuple, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.diagnosis.knowledge import Atom, Knowledge, Known
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    horizon,
    is_temporal,
    with_children,
)
from stltool.monitoring.kleene import Kleene, Trits

Steps = NDArray[np.bool_]
"""A set of steps of the block, as a mask (steps,)."""


class Needed(NamedTuple):
    """An operand, the steps at which it is needed, and its value there, 1 or −1."""

    operand: int
    steps: Steps
    value: int


class Sheet:
    """Values are (steps,) arrays of −1, 0, 1; beyond the decided steps of an operator they are 0."""

    def __init__(self, knowledge: Knowledge, known: Known) -> None:
        self.knowledge, self.known = knowledge, known
        self.block = knowledge.block
        self.n = self.block.steps
        self._atoms = {atom.formula: i for i, atom in enumerate(knowledge.atoms)}
        self._values: dict[int, tuple[Formula, Trits]] = {}  # by the node's id: hashing nodes would be quadratic

    def __getitem__(self, phi: Formula) -> Trits:
        if id(phi) not in self._values:
            self._values[id(phi)] = phi, self._compute(phi)  # with the node, so that its id stays its own
        return self._values[id(phi)][1]

    def _compute(self, phi: Formula) -> Trits:
        if isinstance(phi, Not):
            return np.negative(self[phi.arg])
        if not is_temporal(phi):
            if isinstance(phi, Constant):
                return np.full(self.n, 1 if phi.value else -1, dtype=np.int8)
            return self._atom(phi).values(self.known)
        labels: tuple[Formula, ...] = tuple(Label(str(i)) for i in range(len(children(phi))))
        columns = {str(i): self[child][None] for i, child in enumerate(children(phi))}
        one = with_children(phi, labels)
        values = np.zeros(self.n, dtype=np.int8)
        if self.block.end == "open" and horizon(one) >= self.n:  # below an operator of the past, which does not look
            return values
        found = Kleene(one).judge(columns, self.n, self.block.end)[0]
        values[: len(found)] = found
        return values

    def _atom(self, psi: Formula) -> Atom:
        if psi in self._atoms:
            return self.knowledge.atoms[self._atoms[psi]]
        return Atom(psi, self.knowledge.names, self.block)  # a part of one

    # ---------------------------------------------------------------------------------------------------- critical

    def critical(self, at: int) -> NDArray[np.bool_]:
        """(n_atoms, steps) bool: where an atom's value is surely needed for the root's value at a step."""
        found = np.zeros((len(self.knowledge.atoms), self.n), dtype=np.bool_)
        root = np.zeros(self.n, dtype=np.bool_)
        root[at] = True
        stack = [(self.knowledge.phi, root)]
        while stack:
            phi, steps = stack.pop()
            if isinstance(phi, Not):
                stack.append((phi.arg, steps))
            elif is_temporal(phi):
                operands = zip(children(phi), self._needed_by(phi, steps), strict=True)
                stack += [(child, below) for child, below in operands if below.any()]
            elif not isinstance(phi, Constant):
                found[self._atoms[phi]] |= steps
        return found

    def _needed_by(self, phi: Formula, steps: Steps) -> list[Steps]:
        """For each operand, the steps at which it is surely needed, if φ is at `steps`."""
        value = self[phi]
        match phi:
            case And(args) | Or(args):
                alike = -1 if isinstance(phi, And) else 1  # one such operand decides
                count = np.sum([self[arg] == alike for arg in args], axis=0)
                return [steps & ((value == -alike) | ((count == 1) & (self[arg] == alike))) for arg in args]
            case Implies(left, right):
                alone = (self[left] == -1) != (self[right] == 1)
                every = value == -1
                return [steps & (every | (alone & (self[left] == -1))), steps & (every | (alone & (self[right] == 1)))]
            case Iff():
                return [steps, steps]
            case Eventually(interval, arg) | Always(interval, arg):
                alike = 1 if isinstance(phi, Eventually) else -1
                a, b = self._bounds(interval)
                every = self.spread(steps & (value == -alike), a, b)
                one = self[arg] == alike
                counts = np.concatenate([[0], np.cumsum(one)])
                starts = np.flatnonzero(steps & (value == alike))
                lows, highs = np.minimum(starts + a, self.n), np.minimum(starts + b + 1, self.n)
                if self.block.end == "hold":  # several steps stand for the last sample
                    lows = np.minimum(lows, self.n - 1)
                single = starts[counts[highs] - counts[lows] == 1]
                witnesses = self._next(one)[np.minimum(single + a, self.n - 1)]
                every[witnesses] = True
                return [every]
            case Once(interval, arg) | Historically(interval, arg):
                alike = 1 if isinstance(phi, Once) else -1
                a, b = self._bounds(interval)
                every = self._before(steps & (value == -alike), a, b)
                one = self[arg] == alike
                counts = np.concatenate([[0], np.cumsum(one)])
                ends = np.flatnonzero(steps & (value == alike))
                lows = np.maximum(ends - b, 0)
                single = lows[counts[np.maximum(ends - a + 1, 0)] - counts[lows] == 1]
                every |= self._at(self._next(one)[single])
                return [every]
            case Until() | Release() | Since() | Trigger() | Rise():
                return [np.zeros_like(steps) for _ in children(phi)]  # not sought
            case Constant() | Label() | Comparison() | Not():
                raise ValueError(f"{phi} has no temporal operator at its root")
            case _:
                assert_never(phi)

    # ---------------------------------------------------------------------------------------------------- decisive

    def decisive(self, phi: Formula, steps: Steps, value: int) -> list[Needed]:
        """Values of the operands that decide φ, whose value is `value` at all of `steps`."""
        match phi:
            case Constant() | Label() | Comparison():
                return []
            case Not():
                return [Needed(0, steps, -value)]
            case And(args) | Or(args):
                if (value == 1) == isinstance(phi, And):
                    return [Needed(i, steps, value) for i in range(len(args))]
                return self._first_of([(i, arg, value) for i, arg in enumerate(args)], steps)
            case Implies(left, right):
                if value == -1:
                    return [Needed(0, steps, 1), Needed(1, steps, -1)]
                return self._first_of([(0, left, -1), (1, right, 1)], steps)
            case Iff(left, _):
                found = []
                for sign in (1, -1):
                    some = steps & (self[left] == sign)
                    found += [Needed(0, some, sign), Needed(1, some, sign * value)] if some.any() else []
                return found
            case Eventually(interval, arg) | Always(interval, arg):
                a, b = self._bounds(interval)
                if (value == 1) == isinstance(phi, Always):
                    return self._some(0, self.spread(steps, a, b), value)
                starts = np.minimum(np.flatnonzero(steps) + a, self.n - 1)
                return self._some(0, self._at(self._next(self[arg] == value)[starts]), value)
            case Once(interval, arg) | Historically(interval, arg):
                a, b = self._bounds(interval)
                if (value == 1) == isinstance(phi, Historically):
                    return self._some(0, self._before(steps, a, b), value)
                lows = np.maximum(np.flatnonzero(steps) - b, 0)
                return self._some(0, self._at(self._next(self[arg] == value)[lows]), value)
            case Until(interval, left, right):
                return self._until(self[left], self[right], *self._bounds(interval), steps, value)
            case Since(interval, left, right):
                return self._since(self[left], self[right], *self._bounds(interval), steps, value)
            case Release(interval, left, right):
                return _negated(self._until(-self[left], -self[right], *self._bounds(interval), steps, -value))
            case Trigger(interval, left, right):
                return _negated(self._since(-self[left], -self[right], *self._bounds(interval), steps, -value))
            case Rise(arg):
                before = self._before(steps, 1, 1)
                if value == 1:
                    return [Needed(0, steps, 1), *self._some(0, before, -1)]
                low = steps & (self[arg] == -1)
                return [*self._some(0, low, -1), *self._some(0, self._before(steps & ~low, 1, 1), 1)]
            case _:
                assert_never(phi)

    def _until(self, left: Trits, right: Trits, a: int, b: int, steps: Steps, value: int) -> list[Needed]:
        starts = np.flatnonzero(steps)
        last = self.n - 1
        lows = np.minimum(starts + a, last if self.block.end == "hold" else self.n)
        highs = np.minimum(starts + b, last)
        if value == 1:
            witnesses = self._next(right == 1)[np.minimum(lows, last)]
            stops = np.where(starts + a > last, self.n, witnesses)  # a held witness comes after the last sample
            return [*self._some(0, self._ranges(starts, stops), 1), *self._some(1, self._at(witnesses), 1)]
        counts = np.concatenate([[0], np.cumsum(right == -1)])
        stops = np.maximum(highs + 1, lows)
        never = counts[stops] - counts[lows] == stops - lows  # ψ does not come at all
        breaks = np.minimum(self._next(left == -1)[starts], last)
        until = np.where(never, highs, np.minimum(breaks, highs)) + 1
        return [
            *self._some(0, self._at(breaks[~never]), -1),
            *self._some(1, self._ranges(lows, np.maximum(until, lows)), -1),
        ]

    def _since(self, left: Trits, right: Trits, a: int, b: int, steps: Steps, value: int) -> list[Needed]:
        ends = np.flatnonzero(steps)
        lows, highs = np.maximum(ends - b, 0), ends - a  # none if a step before 0 would be the last
        if value == 1:
            witnesses = self._last(right == 1)[highs]
            return [*self._some(0, self._ranges(witnesses + 1, ends + 1), 1), *self._some(1, self._at(witnesses), 1)]
        counts = np.concatenate([[0], np.cumsum(right == -1)])
        stops = np.maximum(highs + 1, lows)
        never = counts[stops] - counts[lows] == stops - lows
        breaks = np.maximum(self._last(left == -1)[ends], 0)
        since = np.where(never, lows, np.maximum(breaks, lows))
        return [
            *self._some(0, self._at(breaks[~never]), -1),
            *self._some(1, self._ranges(np.minimum(since, stops), stops), -1),
        ]

    def _first_of(self, operands: list[tuple[int, Formula, int]], steps: Steps) -> list[Needed]:
        """At each step the first operand that has the given value."""
        found, rest = [], steps
        for i, arg, value in operands:
            found += self._some(i, rest & (self[arg] == value), value)
            rest = rest & (self[arg] != value)
        return found

    def _some(self, operand: int, steps: Steps, value: int) -> list[Needed]:
        return [Needed(operand, steps, value)] if steps.any() else []

    def _bounds(self, interval: Interval) -> tuple[int, int]:
        return min(interval.a, self.n), self.n if interval.b is None else min(interval.b, self.n)

    def _next(self, truth: Steps) -> NDArray[np.int64]:
        """At each step the next one, itself included, at which truth is true; n if there is none."""
        indices = np.where(truth, np.arange(self.n), self.n)
        return np.minimum.accumulate(indices[::-1])[::-1]

    def _last(self, truth: Steps) -> NDArray[np.int64]:
        """At each step the last one so far, itself included, at which truth is true; −1 if there is none."""
        return np.maximum.accumulate(np.where(truth, np.arange(self.n), -1))

    def _at(self, indices: NDArray[np.int64]) -> Steps:
        steps = np.zeros(self.n, dtype=np.bool_)
        steps[indices[indices < self.n]] = True
        return steps

    def _ranges(self, firsts: NDArray[np.int64], stops: NDArray[np.int64]) -> Steps:
        """The steps of all ranges first … stop − 1."""
        edges = np.zeros(self.n + 1, dtype=np.int64)
        np.add.at(edges, np.minimum(firsts, self.n), 1)
        np.add.at(edges, np.minimum(stops, self.n), -1)
        return np.cumsum(edges)[: self.n] > 0

    def _before(self, steps: Steps, a: int, b: int) -> Steps:
        """The steps t−b … t−a for every t in `steps`, from the first of the block on."""
        ends = np.flatnonzero(steps)
        return self._ranges(np.maximum(ends - b, 0), np.maximum(ends - a + 1, 0))

    def spread(self, steps: Steps, a: int, b: int) -> Steps:
        """The steps t+a … t+b for every t in `steps`, within the block; held at its end if samples are."""
        starts = np.flatnonzero(steps)
        found = self._ranges(np.minimum(starts + a, self.n), np.minimum(starts + b + 1, self.n))
        if self.block.end == "hold" and (starts + b >= self.n).any():
            found[self.n - 1] = True
        return found


def _negated(needed: list[Needed]) -> list[Needed]:
    return [Needed(operand, steps, -value) for operand, steps, value in needed]
