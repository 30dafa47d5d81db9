"""Comparisons that read several steps, over the finitely many values that signals have in a model.

With V the values of x in the states of a model, and ⊙ any comparison of x[t+k] and x[t]:

    x[t+k] ⊙ x[t]  =  ⋁ over v in V of (x == v now) ∧ (v' ⊙ v for the value v' of x, k steps later)

which is exact. Values v for which the same v' satisfy the comparison are one case. Where several signals are read at
one step, v stands for their values together, as they occur in states.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SizeError
from stltool.logic.formula import (
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Interval,
    Negate,
    Number,
    Once,
    Or,
    Term,
    Variable,
    delay,
    distinct,
    read_by,
)
from stltool.logic.names import written
from stltool.logic.shifts import reads_ahead, replaced, with_variables
from stltool.monitoring.states import Reals, truth

MOST_COMBINATIONS = 1_000_000
MOST_COMPARISONS = 10_000  # that take the place of one


@dataclass(frozen=True, slots=True)
class Cases:
    """A comparison of several steps, and the cases it was rewritten into."""

    comparison: Comparison
    values: Mapping[str, int]
    cases: int

    def __str__(self) -> str:
        read = " and ".join(f"{n} values of {written(name)}" for name, n in self.values.items())
        return f"{self.comparison} is judged by {read}: {self.cases} {'case' if self.cases == 1 else 'cases'}"


def by_values(phi: Formula, signals: Mapping[str, Reals]) -> tuple[Formula, list[Cases]]:
    """φ without comparisons of several steps, equivalent on traces whose samples are those of states.

    `signals` contain an array (n_states,) for each name that such comparisons read. Raises SizeError if there are too
    many combinations of values.
    """
    if not any(isinstance(node, Comparison) and delay(node) for node in distinct(phi)):
        return phi, []
    found: list[Cases] = []

    def rewrite(node: Formula) -> Formula:
        later, c = (node.interval.a, node.arg) if isinstance(node, Eventually) else (0, node)
        assert isinstance(c, Comparison)
        return _by_values(c, later, signals, found)

    return replaced(phi, _reads_several_steps, rewrite), found


def _reads_several_steps(phi: Formula) -> bool:
    """Whether this is a comparison of several steps; with F[k,k] before it if all of them lie ahead then."""
    return (isinstance(phi, Comparison) and delay(phi) > 0) or reads_ahead(phi)


def _by_values(c: Comparison, later: int, signals: Mapping[str, Reals], found: list[Cases]) -> Formula:
    """A comparison `later` steps ahead, as a disjunction over the values of its signals."""
    read = read_by(c)
    steps = sorted({variable.delay for variable in read}, reverse=True)  # earliest first
    names = [sorted({variable.name for variable in read if variable.delay == step}) for step in steps]
    values = [np.unique(np.column_stack([signals[name] for name in group]), axis=0) for group in names]
    sizes = [len(rows) for rows in values]
    if math.prod(sizes) > MOST_COMBINATIONS:
        of = ", ".join(f"{n} of {' and '.join(map(written, group))}" for n, group in zip(sizes, names, strict=True))
        raise SizeError(
            f"{c} reads several steps, where the model has {of}: {math.prod(sizes):.3g} combinations of values, over "
            f"{MOST_COMBINATIONS}; compare signals with fewer values"
        )
    table = _table(c, steps, names, values)
    places = [later - step for step in steps]
    try:
        formula = _Cases(places, names, values).of(table)
    except SizeError:
        of = " and ".join(map(written, dict.fromkeys(itertools.chain(*names))))
        raise SizeError(
            f"{c} reads several steps; over values of {of} it takes over {MOST_COMPARISONS} comparisons, too many; "
            "compare signals with fewer values"
        ) from None
    cases = len(formula.args) if isinstance(formula, Or) else int(formula != Constant(False))
    counts = {name: len(np.unique(signals[name])) for name in dict.fromkeys(itertools.chain(*names))}
    found.append(Cases(c, counts, cases))
    return formula


def _table(
    c: Comparison, steps: Sequence[int], names: Sequence[Sequence[str]], values: Sequence[Reals]
) -> NDArray[np.bool_]:
    """The truth of the comparison for each combination of values, one axis for each step."""
    plain = with_variables(c, lambda variable: Variable(f"{variable.delay} {variable.name}", span=variable.span))
    sizes = [len(rows) for rows in values]
    index = np.indices(sizes).reshape(len(sizes), -1)
    columns = {
        f"{step} {name}": np.ascontiguousarray(rows[place, i])
        for step, group, rows, place in zip(steps, names, values, index, strict=True)
        for i, name in enumerate(group)
    }
    return truth(plain, columns, {}, index.shape[1]).reshape(sizes)


class _Cases:
    """The disjunction over the values at the first of some steps, of those for which the rest of a table differs."""

    def __init__(self, places: Sequence[int], names: Sequence[Sequence[str]], values: Sequence[Reals]) -> None:
        self.places, self.names, self.values = places, names, values
        self.left = MOST_COMPARISONS

    def of(self, table: NDArray[np.bool_], i: int = 0) -> Formula:
        """For the steps from the i-th on, whose values are the axes of the table."""
        if table.ndim == 1:
            return self.at(i, table)
        rows, which = np.unique(table.reshape(len(table), -1), axis=0, return_inverse=True)
        cases: list[Formula] = []
        for number, row in enumerate(rows):
            if row.any():
                rest = self.of(row.reshape(table.shape[1:]), i + 1)
                more = rest.args if isinstance(rest, And) else (rest,)
                cases.append(And((self.at(i, which.ravel() == number), *more)))
        return Or(tuple(cases)) if len(cases) > 1 else cases[0] if cases else Constant(False)

    def at(self, i: int, among: NDArray[np.bool_]) -> Formula:
        """That the signals have one of these rows of values at the i-th step; false where there is no such step."""
        psi, place = self.among(i, among), self.places[i]
        if place == 0:
            return psi
        window = Interval(abs(place), abs(place))
        return Eventually(window, psi) if place > 0 else Once(window, psi)

    def among(self, i: int, among: NDArray[np.bool_]) -> Formula:
        """That the signals have one of some rows of values, of those that occur."""
        if among.all():
            return Constant(True)
        variables, values = [Variable(name) for name in self.names[i]], self.values[i]
        if len(variables) == 1:
            found = _ranges(variables[0], values[:, 0], among)
        else:
            self.spend(int(among.sum()) * len(variables))
            found = [
                And(tuple(Comparison("==", x, _number(v)) for x, v in zip(variables, row, strict=True)))
                for row in values[among].tolist()
            ]
        self.spend(len(found))
        return Or(tuple(found)) if len(found) > 1 else found[0] if found else Constant(False)

    def spend(self, comparisons: int) -> None:
        self.left -= comparisons
        if self.left < 0:
            raise SizeError("too many comparisons")


def _ranges(x: Variable, values: NDArray[np.float64], among: NDArray[np.bool_]) -> list[Formula]:
    """That x has one of some values: ranges of those that occur, which are ascending."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], among, [False]])))
    found: list[Formula] = []
    for first, last in zip(borders[::2], borders[1::2] - 1, strict=True):
        low, high = _number(values[first]), _number(values[last])
        if first == 0:
            found.append(Comparison("<=", x, high))
        elif last == len(values) - 1:
            found.append(Comparison(">=", x, low))
        elif first == last:
            found.append(Comparison("==", x, low))
        else:
            found.append(And((Comparison(">=", x, low), Comparison("<=", x, high))))
    return found


def _number(value: float) -> Term:
    number = Number(abs(float(value)))
    return Negate(number) if value < 0 else number
