"""Which truth assignments of labels and comparisons occur, exactly where that can be found out.

`feasible_valuations` takes comparisons of different cores for independent. Where they share signals, every truth
assignment is tried here: by elimination (regions.py) if they are piecewise linear; by the roots of polynomials
(roots.py) if they read one signal; else one occurs if values were found that have it. Signals may also be *given*, by
earlier steps: then an assignment must occur whatever they are.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SizeError, TraceError
from stltool.logic.feasible import realised
from stltool.logic.formula import Comparison, Formula, label_names, variables
from stltool.logic.regions import Constraint, alternatives, groups, is_decimal, numbers, solved
from stltool.logic.roots import truths_of_one_signal
from stltool.logic.semantics import satisfies

_MOST_TOGETHER = 8  # comparisons that share signals
_MOST_POINTS = 400
_MOST_CASES = 256  # of one truth assignment
_MOST_CONSTRAINTS = 300  # of one elimination


def occurring(
    read: Sequence[Formula], rows: NDArray[np.bool_], given: Collection[str] = ()
) -> tuple[NDArray[np.bool_], bool]:
    """The truth assignments among `rows` (n, n_leaves) that occur, as far as known, and whether all of them do.

    `rows` must be complete. Signals are decimals; those `given` may have any values, and all must let a row occur.
    """
    if not given and realised(read):
        return rows, True
    keep, exact = np.ones(len(rows), dtype=np.bool_), True
    comparisons = {i: leaf for i, leaf in enumerate(read) if isinstance(leaf, Comparison)}
    for group in sharing(tuple(comparisons.values())):
        columns = [list(comparisons)[i] for i in group]
        found, sure = _of_group([comparisons[i] for i in columns], rows[:, columns], given)
        keep &= found
        exact &= sure
    return rows[keep], exact


def sharing(psis: Sequence[Formula]) -> list[list[int]]:
    """The formulas that read something, by position, in groups that share names with each other, directly or not."""
    together: list[tuple[set[str], list[int]]] = []
    for i, psi in enumerate(psis):
        if names := {*variables(psi), *label_names(psi)}:
            joined = [group for group in together if group[0] & names]
            together = [group for group in together if not group[0] & names]
            columns = sorted([i, *(column for _, columns in joined for column in columns)])
            together.append((names.union(*(known for known, _ in joined)), columns))
    return [columns for _, columns in together]


def _of_group(
    leaves: list[Comparison], rows: NDArray[np.bool_], given: Collection[str]
) -> tuple[NDArray[np.bool_], bool]:
    """Which of the rows to keep, and whether exactly those occur."""
    names = {name for leaf in leaves for name in variables(leaf)}
    shared = names.intersection(given)
    everything = np.ones(len(rows), dtype=np.bool_)
    if not shared and realised(leaves):
        return everything, True
    if len(leaves) > _MOST_TOGETHER:
        return everything, False
    if shared:
        truths = {row: _whatever(leaves, row, shared) for row in set(map(tuple, rows.tolist()))}
        keep = np.array([truths[tuple(row)] is not False for row in rows.tolist()])
        return keep, None not in truths.values()
    if any(alternatives(leaf, True) is None for leaf in leaves):
        occur = truths_of_one_signal(leaves, *names) if len(names) == 1 else None
        if occur is not None:
            return np.array([tuple(row) in occur for row in rows.tolist()]), True
        return everything, _all_found(leaves, set(map(tuple, rows.tolist())))
    try:
        [group] = groups(leaves, {})
    except SizeError:
        return everything, False
    return np.array([tuple(row) in group.rows for row in rows.tolist()]), group.sharp


def _all_found(leaves: Sequence[Comparison], rows: set[tuple[bool, ...]]) -> bool:
    """Whether points of a small grid have all of these truths."""
    names = sorted({name for leaf in leaves for name in variables(leaf)})
    near = {0.0, 0.5, 1.0, 3.0, 10.0}
    near |= {
        n.value * k + d for leaf in leaves for n in numbers(leaf) for k in (0.5, 1.0, 2.0) for d in (-1.0, 0.0, 1.0)
    }
    axis = sorted({sign * value for value in near for sign in (-1.0, 1.0)}, key=abs)
    missing = set(rows)
    for point in itertools.islice(itertools.product(axis, repeat=len(names)), _MOST_POINTS):
        trace = {name: np.array([value]) for name, value in zip(names, point, strict=True)}
        with contextlib.suppress(TraceError):
            missing.discard(tuple(satisfies(leaf, trace) for leaf in leaves))
        if not missing:
            return True
    return False


def _whatever(leaves: Sequence[Comparison], row: Sequence[bool], given: Collection[str]) -> bool | None:
    """Whether the truths occur whatever the given signals are: True; False: never; None: sometimes, or not known."""
    parts = [alternatives(leaf, truth) for leaf, truth in zip(leaves, row, strict=True)]
    polyhedra = [part for part in parts if part is not None]
    if len(polyhedra) < len(parts) or math.prod(map(len, polyhedra)) > _MOST_CASES:
        return None
    possible = False
    for chosen in itertools.product(*polyhedra):
        left = projected(list(itertools.chain(*chosen)), given)
        if left == []:
            return True
        possible = possible or (left is not None and projected(left, ()) is not None)
    return None if possible else False


def projected(rows: list[Constraint], given: Collection[str]) -> list[Constraint] | None:
    """What the constraints say about the given signals, if all others are chosen freely; None if they contradict.

    [] if they say nothing. Where that is not found out, others are left in.
    """
    while True:
        rows = list(dict.fromkeys(rows))
        if any(row.decided is False for row in rows):
            return None
        rows = [row for row in rows if row.decided is None]
        free = sorted({name for row in rows for name, _ in row.term.coefficients if name not in given})
        if not free:
            return rows
        equation = next((row.term for row in rows if row.relation == "==" and _has(row, free)), None)
        if equation is not None:
            name, by = next((name, solved(equation, name)) for name, _ in equation.coefficients if name in free)
            if not all(map(is_decimal, (by.constant, *(k for _, k in by.coefficients)))):
                return rows  # few decimals solve it
            rows = [row.substituted(name, by) for row in rows]
            continue
        signs = {name: [row.term.of_signal(name) for row in rows] for name in free}
        sides = {
            name: tuple([row for row, k in zip(rows, ks, strict=True) if sign * k > 0] for sign in (-1, 1))
            for name, ks in signs.items()
        }
        name = min(free, key=lambda name: len(sides[name][0]) * len(sides[name][1]))
        below, above = sides[name]
        if len(below) * len(above) > _MOST_CONSTRAINTS:
            return rows
        rows = [row for row in rows if not row.term.of_signal(name)]
        for low, high in itertools.product(below, above):
            term = low.term.times(-1 / low.term.of_signal(name)).plus(high.term, 1 / high.term.of_signal(name))
            rows.append(Constraint(term, "<=" if low.relation == high.relation == "<=" else "<"))


def _has(row: Constraint, names: Collection[str]) -> bool:
    return any(name in names for name, _ in row.term.coefficients)
