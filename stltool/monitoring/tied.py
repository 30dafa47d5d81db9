"""Early verdicts where what can come next depends on the values of earlier samples: G[0,9] (x[t+1] > x & x < 3).

With v the last samples, let S_c(q, w) be the v from which some continuation of a step that is in state q of the
automaton after c + 1 letters has the verdict w (E as in early.py):

    S_c(q, w) = all or nothing if E_c(q) is decided, else ⋃ over λ of
                { v : some new sample y has the truths λ, and (y, v) without the oldest is in S_{c+1}(δ(λ,q), w) }

These are unions of polyhedra, found by elimination in rationals (logic/regions.py). A step is decided once v is outside
of S_c(q, w) for one w: that is as early as can be. Where there are too many polyhedra, or a comparison is not linear,
this is not tried.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from stltool.logic.formula import Comparison
from stltool.logic.occurring import projected
from stltool.logic.regions import Constraint, Linear, alternatives
from stltool.monitoring.early import OPEN, YES, Engine
from stltool.monitoring.starts import Found, OpenSteps
from stltool.numbers import shortest

Polyhedron: TypeAlias = frozenset[Constraint]
Union: TypeAlias = frozenset[Polyhedron]

_MOST_LEAVES = 6
_LONGEST = 100  # horizon
_MOST_POLYHEDRA = 48  # of one union, or of the truths of one sample
_MOST_ELIMINATIONS = 3000
_MOST_LOOKED_UP = 200_000
_ALL: Union = frozenset({frozenset()})
_NOTHING: Union = frozenset()


class _TooLarge(Exception):
    """Not found out within the limits."""


class Tied:
    """Decides the open steps of a running trace by truths and values."""

    def __init__(self, engine: Engine, horizon: int, unions: list[list[tuple[Union, Union]]]) -> None:
        self._horizon = horizon
        numbers: dict[Union, int] = {}
        self._ends = [[tuple(numbers.setdefault(end, len(numbers)) for end in ends) for ends in row] for row in unions]
        constraints = list(dict.fromkeys(one for union in numbers for polyhedron in union for one in polyhedron))
        at = {one: i for i, one in enumerate(constraints)}
        self._unions = [[[at[one] for one in polyhedron] for polyhedron in union] for union in numbers]
        self._constraints = _Constraints(constraints)
        self._open = OpenSteps(engine)
        self._told: dict[int, bool] = {}

    def __deepcopy__(self, memo: dict[int, Any]) -> Tied:
        copied = Tied.__new__(Tied)
        copied.__dict__.update(self.__dict__)
        copied._open, copied._told = self._open.copied(), dict(self._told)
        return copied

    def verdict(self, step: int) -> bool | None:
        """The verdict of one of the last steps, if it was decided here."""
        return self._told.get(step)

    def read(self, truths: list[bool], values: Mapping[str, list[float]]) -> list[Found]:
        """The steps that are decided by a sample, in order. `values`: of each signal the last ones, newest first."""
        holds = self._constraints.at(values)
        known: dict[int, bool] = {}  # of unions

        def contains(union: int) -> bool:
            if union not in known:
                known[union] = any(all(map(holds.__getitem__, one)) for one in self._unions[union])
            return known[union]

        def decided(q: int, clock: int) -> bool | None:
            no, yes = map(contains, self._ends[clock][q])
            return None if no == yes else yes

        found = sorted([*self._open.read(truths), *self._open.decided(decided)])
        self._told |= dict(found)
        for step in [step for step in self._told if step < self._open.n_steps - self._horizon - 1]:
            del self._told[step]
        return found


class _Constraints:
    """Linear constraints, judged in doubles where these are certain, and in fractions elsewhere."""

    def __init__(self, constraints: list[Constraint]) -> None:
        self._given = constraints
        names = dict.fromkeys(name for one in constraints for name, _ in one.term.coefficients)
        self._names = {name: i for i, name in enumerate(names)}
        self._samples = [(base, int(steps)) for base, _, steps in (name.rpartition("\n") for name in names)]
        self._factors = np.zeros((len(constraints), len(names)))
        for i, one in enumerate(constraints):
            for name, k in one.term.coefficients:
                self._factors[i, self._names[name]] = _double(k)
        self._added = np.array([_double(one.term.constant) for one in constraints])
        self._less = np.array([one.relation != "=" for one in constraints], dtype=np.bool_)
        self._sizes = np.abs(self._factors), np.abs(self._added)

    def at(self, values: Mapping[str, list[float]]) -> list[bool]:
        """Which of them hold."""
        samples = [values[base][steps] for base, steps in self._samples]
        x = np.array(samples)
        with np.errstate(all="ignore"):
            sums = self._factors @ x + self._added
            # each factor, sample, product and sum is rounded once
            error = (len(x) + 8) * 2.0**-53 * (self._sizes[0] @ np.abs(x) + self._sizes[1]) + 1e-300
            holds: list[bool] = ((sums < 0) & self._less).tolist()
            unsure = np.flatnonzero(~(np.abs(sums) > error)).tolist()
        if unsure:
            exact = dict(zip(self._names, map(shortest, samples), strict=True))
            for i in unsure:
                term, relation = self._given[i].term, self._given[i].relation
                holds[i] = bool(Constraint(Linear((), term.at(exact)), relation).decided)
        return holds


def _double(x: Fraction) -> float:
    """The nearest double, infinite for what is not near to one, as a sum's value is then not known."""
    return float(x) if x == 0 or 2.0**-900 < abs(x) < 2.0**900 else math.inf


def tied(engine: Engine, horizon: int, made: Mapping[str, tuple[str, int]]) -> Tied | None:
    """The exact engine of a formula whose comparisons read earlier samples, (signal, steps before) by the name that is
    `made` for them; None if it is too large."""
    if engine.delta is None or horizon > _LONGEST or len(engine.leaves) > _MOST_LEAVES:
        return None
    try:
        return Tied(engine, horizon, _unions(engine, horizon, made))
    except _TooLarge:
        return None


def _unions(engine: Engine, horizon: int, made: Mapping[str, tuple[str, int]]) -> list[list[tuple[Union, Union]]]:
    """By clock and state: S for false, and for true."""
    assert engine.delta is not None
    assert engine.letter is not None
    by_letter: dict[int, set[Polyhedron]] = {}
    for code, letter in enumerate(engine.letter.tolist()):
        by_letter.setdefault(letter, set()).update(_truths(engine, code, made))
    letters = {letter: frozenset(found) for letter, found in by_letter.items() if found}
    before = _Before(letters)
    delta, n_states = engine.delta.tolist(), engine.delta.shape[1]
    rows: list[list[tuple[Union, Union]]] = []
    after: list[tuple[Union, Union]] = []
    for c in range(horizon, -1, -1):
        row: list[tuple[Union, Union]] = []
        for q in range(n_states):
            outcome = _outcome(engine, c, q)
            if outcome != OPEN or c == horizon:
                row.append((_NOTHING, _ALL) if outcome == YES else (_ALL, _NOTHING))
                continue
            ends = [(letter, after[delta[letter][q]]) for letter in letters]
            no, yes = (_merged(before(letter, end[w]) for letter, end in ends) for w in range(2))
            row.append((no, yes))
        rows.append(row)
        after = row
    return rows[::-1]


def _outcome(engine: Engine, c: int, q: int) -> int:
    if engine.closed is not None:
        return int(engine.closed[c, q])
    assert engine.first is not None
    assert engine.outcome is not None
    return int(engine.outcome[q]) if c >= engine.first[q] else OPEN


class _Before:
    """The values from which a letter can come, and then those of a union are reached."""

    def __init__(self, letters: Mapping[int, Union]) -> None:
        self._letters = letters
        self._known: dict[tuple[int, Union], Union] = {}
        self._left, self._eliminations = _MOST_LOOKED_UP, _MOST_ELIMINATIONS

    def __call__(self, letter: int, union: Union) -> Union:
        self._left -= 1
        if self._left < 0:
            raise _TooLarge
        if (letter, union) not in self._known:
            pairs = itertools.product(self._letters[letter], union)
            self._known[letter, union] = _merged(self._of(now, then) for now, then in pairs)
        return self._known[letter, union]

    def _of(self, now: Polyhedron, then: Polyhedron) -> Union:
        self._eliminations -= 1
        if self._eliminations < 0:
            raise _TooLarge
        rows = [*now, *(_renamed(row, _earlier) for row in then)]
        given = {name for row in rows for name, _ in row.term.coefficients if not name.endswith(_NEW)}
        left = projected(rows, given)
        if left is None:
            return _NOTHING
        if any(name not in given for row in left for name, _ in row.term.coefficients):
            raise _TooLarge
        return _NOTHING if projected(left, ()) is None else frozenset({frozenset(left)})


def _merged(unions: Any) -> Union:
    """One union of several, without polyhedra that lie in others by having all of their constraints."""
    found: set[Polyhedron] = set().union(*unions)
    if frozenset() in found:
        return _ALL
    least = {one for one in found if not any(other < one for other in found)}
    if len(least) > _MOST_POLYHEDRA:
        raise _TooLarge
    return frozenset(least)


def _truths(engine: Engine, code: int, made: Mapping[str, tuple[str, int]]) -> set[Polyhedron]:
    """The new samples, and the values before them, with the truths of a code."""

    def name_of(name: str) -> str:
        base, steps = made.get(name, (name, 0))
        return _at(base, steps - 1)

    parts = []
    for i, leaf in enumerate(engine.leaves):
        if isinstance(leaf, Comparison):
            found = alternatives(leaf, bool(code >> i & 1))
            if found is None:
                raise _TooLarge
            parts.append(found)
    if math.prod(map(len, parts)) > _MOST_POLYHEDRA:
        raise _TooLarge
    joined = (itertools.chain(*chosen) for chosen in itertools.product(*parts))
    polyhedra = [frozenset(_renamed(row, name_of) for row in rows) for rows in joined]
    return {one for one in polyhedra if projected(list(one), ()) is not None}


_NEW = "\n-1"


def _at(name: str, steps: int) -> str:
    """A signal's sample so many steps before the last one; −1 for the next one."""
    return f"{name}\n{steps}"


def _earlier(name: str) -> str:
    """The same sample, seen one step earlier."""
    base, _, steps = name.rpartition("\n")
    return _at(base, int(steps) - 1)


def _renamed(row: Constraint, name_of: Callable[[str], str]) -> Constraint:
    coefficients = {name_of(name): k for name, k in row.term.coefficients}
    return Constraint(Linear.of(coefficients, row.term.constant), row.relation)
