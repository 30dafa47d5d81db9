"""Which truth assignments of labels and comparisons can occur at one step: a superset, from exact arithmetic.

A comparison is solved for its *core*: what remains of `term ⋈ c` once + − · / with constants, abs, and min and max with
constants are undone. Its truth depends only on the value of the core, and changes only at a few levels of that value:

    2·x + 1 > 4   core x, level 3/2          abs(x) < 3   core x, levels −3, 3          x > y   core x − y, level 0

Comparisons with the same core are evaluated together at every level, between neighbouring levels, and beyond both ends;
different cores and labels are treated as independent. So no assignment that can occur is missing, and if every core is
a variable, none is superfluous: real values realise every row.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Hashable, Sequence
from fractions import Fraction
from typing import TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import (
    Arithmetic,
    Call,
    Comparison,
    Formula,
    Label,
    Negate,
    Number,
    Term,
    Variable,
    boolean_value,
    walk,
)
from stltool.logic.printer import term_text
from stltool.logic.rewrite import MIRROR
from stltool.logic.semantics import CALL, COMPARE, COMPUTE, Real, exact

_Solved: TypeAlias = tuple[Hashable, list[Fraction], Callable[[Fraction], Fraction]]
"""A term's core, the core's values at the given levels, and a function from the core's value to the term's."""


def leaves(phi: Formula) -> tuple[Formula, ...]:
    """The labels and comparisons of φ, left to right, without repetitions."""
    return tuple(dict.fromkeys(node for node in walk(phi) if isinstance(node, Label | Comparison)))


def feasible_valuations(read: Sequence[Formula], most: int) -> tuple[NDArray[np.bool_], bool]:
    """A superset of the truth assignments that can occur, (n, n_leaves), and whether it is complete.

    If there are more than `most`, a fixed sample of that size is drawn. Assignments in which almost all leaves are
    false, or true, come first.
    """
    groups = _groups(read)
    sizes = [len(rows) for _, rows in groups]
    complete = math.prod(sizes) <= most
    if complete:
        chosen = np.array(list(itertools.product(*(range(size) for size in sizes))), dtype=np.int64)
    else:
        rng = np.random.default_rng(0)
        chosen = np.stack([rng.integers(size, size=most) for size in sizes], axis=1)
        chosen[0], chosen[1] = 0, np.array(sizes) - 1
        for i in range(min(len(sizes), most // 4)):  # one group differs from all others
            chosen[2 * i + 2], chosen[2 * i + 3] = chosen[0], chosen[1]
            chosen[2 * i + 2, i], chosen[2 * i + 3, i] = chosen[1, i], chosen[0, i]
    result = np.zeros((len(chosen), len(read)), dtype=np.bool_)
    for (columns, rows), picks in zip(groups, chosen.T, strict=True):
        result[:, columns] = rows[picks]
    result = np.unique(result, axis=0)
    holding = result.sum(axis=1)
    return result[np.argsort(np.minimum(holding, len(read) - holding), kind="stable")], complete


def tabulated(psis: Sequence[Formula], read: Sequence[Formula], rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n_rows, n_psis): the truth of formulas under assignments of what they read."""
    assigned = [dict(zip(read, row, strict=True)).get for row in rows.tolist()]
    truths = [[boolean_value(psi, row) for psi in psis] for row in assigned]
    return np.array(truths, dtype=np.bool_).reshape(len(rows), len(psis))


def _groups(read: Sequence[Formula]) -> list[tuple[list[int], NDArray[np.bool_]]]:
    """Groups of dependent columns with the rows (n, n_columns) that can occur; groups are independent."""
    groups: list[tuple[list[int], NDArray[np.bool_]]] = []
    cores: dict[Hashable, list[int]] = {}
    solved: dict[int, tuple[list[Fraction], Callable[[Fraction], bool]]] = {}
    for i, leaf in enumerate(read):
        if isinstance(leaf, Comparison):
            core, levels, truth = _solve_comparison(leaf)
            cores.setdefault(core, []).append(i)
            solved[i] = (levels, truth)
        else:
            groups.append(([i], np.array([[False], [True]])))
    for columns in cores.values():
        levels = sorted({level for i in columns for level in solved[i][0]})
        rows = {tuple(solved[i][1](value) for i in columns) for value in _cells(levels)}
        groups.append((columns, np.array(sorted(rows))))
    return groups


def _cells(levels: list[Fraction]) -> list[Fraction]:
    """Every level, a value between every two neighbouring levels, and one beyond each end."""
    if not levels:
        return [Fraction(0)]
    between = [(low + high) / 2 for low, high in itertools.pairwise(levels)]
    return [*levels, *between, levels[0] - 1, levels[-1] + 1]


def _solve_comparison(phi: Comparison) -> tuple[Hashable, list[Fraction], Callable[[Fraction], bool]]:
    """The core, its levels, and a function from the core's value to the truth of the comparison."""
    op, left, right = phi.op, phi.left, phi.right
    if _constant(right) is None and (_constant(left) is not None or term_text(left) > term_text(right)):
        op, left, right = MIRROR[op], right, left
    compare, border, fixed = COMPARE[op], _constant(right), _constant(left)
    if border is None:  # the sign of a difference; if a power may be rounded, only of these two terms
        core: Hashable = Arithmetic("-", left, right) if _is_exact(left) and _is_exact(right) else (left, right)
        return core, [Fraction(0)], lambda value: compare(value, 0)
    if fixed is not None:
        return "no variable", [], lambda _: compare(fixed, border)
    core, levels, at = _solve(left, [border]) if _is_exact(left) else (left, [border], _itself)
    return core, levels, lambda value: compare(at(value), border)


def _solve(term: Term, levels: list[Fraction]) -> _Solved:
    match term:
        case Negate(arg):
            core, found, at = _solve(arg, [-level for level in levels])
            return core, found, lambda value: -at(value)
        case Arithmetic("+" | "-" | "*" | "/" as op, left, right):
            return _solve_arithmetic(term, op, _constant(left), _constant(right), levels)
        case Call("abs", (arg,)):
            core, found, at = _solve(arg, [*levels, *(-level for level in levels)])
            return core, found, lambda value: abs(at(value))
        case Call("min" | "max" as function, args):
            constants = [_constant(arg) for arg in args]
            if constants.count(None) == 1:
                core, found, at = _solve(args[constants.index(None)], levels)
                known = [constant for constant in constants if constant is not None]
                choose = CALL[function]
                return core, found, lambda value: _fraction(choose(at(value), *known))
        case Number() | Variable() | Call() | Arithmetic():
            pass
        case _:
            assert_never(term)
    return term, levels, _itself


def _solve_arithmetic(
    term: Arithmetic, op: str, left: Fraction | None, right: Fraction | None, levels: list[Fraction]
) -> _Solved:
    """`_solve` for a term with a constant operand; any other term, and any divisor, is a core of its own."""
    forward = COMPUTE[term.op]
    k = right if right is not None else left
    if k is None or (op == "/" and not right):
        return term, levels, _itself
    arg = term.left if right is not None else term.right

    def undo(level: Fraction) -> Fraction:
        match op:
            case "+":
                return level - k
            case "-":
                return level + k if right is not None else k - level
            case "*":
                return level / k
            case _:
                return level * k

    core, found, at = _solve(arg, [undo(level) for level in levels if k or op != "*"])
    if right is not None:
        return core, found, lambda value: _fraction(forward(at(value), k))
    return core, found, lambda value: _fraction(forward(k, at(value)))


def _itself(value: Fraction) -> Fraction:
    return value


def _fraction(value: Real) -> Fraction:
    """The value of a term without roots and powers of finite operands."""
    assert isinstance(value, Fraction)
    return value


def _constant(term: Term) -> Fraction | None:
    """The exact value of a term without variables, roots or powers; None for other terms."""
    match term:
        case Number(value):
            return _fraction(exact(value))
        case Negate(arg):
            inner = _constant(arg)
            return None if inner is None else -inner
        case Arithmetic("+" | "-" | "*" | "/" as op, left, right):
            a, b = _constant(left), _constant(right)
            return None if a is None or b is None or (op == "/" and not b) else _fraction(COMPUTE[op](a, b))
        case Call("abs" | "min" | "max" as function, args):
            values = [_constant(arg) for arg in args]
            known = [value for value in values if value is not None]
            return _fraction(CALL[function](*known)) if len(known) == len(values) else None
        case Variable() | Arithmetic() | Call():
            return None
        case _:
            assert_never(term)


def _is_exact(term: Term) -> bool:
    """Whether the value is never rounded: the term has no power."""
    match term:
        case Number() | Variable():
            return True
        case Negate(arg):
            return _is_exact(arg)
        case Arithmetic(op, left, right):
            return op != "^" and _is_exact(left) and _is_exact(right)
        case Call(_, args):
            return all(_is_exact(arg) for arg in args)
        case _:
            assert_never(term)


def realised(read: Sequence[Formula]) -> bool:
    """Whether real values realise every row of `feasible_valuations`, whatever values some of the signals are given.

    So it is if every core is one signal, or a linear combination of signals that no other core contains.
    """
    cores: dict[Hashable, list[str]] = {}
    for leaf in read:
        if isinstance(leaf, Label):
            cores[leaf] = [leaf.name]
        elif isinstance(leaf, Comparison) and (core := _solve_comparison(leaf)[0]) != "no variable":
            names = _linear_names(core)
            if names is None or len(set(names)) < len(names):
                return False
            cores[core] = names
    every = [name for names in cores.values() for name in names]
    return len(set(every)) == len(every)


def _linear_names(core: object) -> list[str] | None:
    """The signals of a linear combination, with repetitions; None for any other term."""
    match core:
        case Number():
            return []
        case Variable(name):
            return [name]
        case Negate(arg):
            return _linear_names(arg)
        case Arithmetic("+" | "-", left, right):
            a, b = _linear_names(left), _linear_names(right)
            return None if a is None or b is None else a + b
        case Arithmetic("*" | "/" as op, left, right) if _constant(right) or (op == "*" and _constant(left)):
            return _linear_names(left if _constant(right) else right)
        case _:
            return None
