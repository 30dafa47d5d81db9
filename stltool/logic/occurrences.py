"""Every occurrence of a sub-formula in a formula, and the formula with one occurrence replaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stltool.logic.formula import (
    Constant,
    Formula,
    Iff,
    Implies,
    Not,
    Rise,
    atoms,
    children,
    is_temporal,
    with_children,
)


@dataclass(frozen=True, slots=True)
class Occurrence:
    """One occurrence in the list of all.

    path      the operand to descend into at each operator, from the root
    parent    the index of the operator above it; -1 for the root
    operands  the indices of its own operands
    polarity  1 if making it true can only make the whole formula true, −1 if only false, 0 under ↔ and rise
    """

    formula: Formula
    path: tuple[int, ...]
    parent: int
    operands: tuple[int, ...]
    polarity: int


def occurrences(phi: Formula) -> tuple[Occurrence, ...]:
    """Every occurrence, outside in, left to right: the root first, operands after their operator."""
    found: list[tuple[Formula, tuple[int, ...], int, int]] = []
    operands: list[list[int]] = []
    stack: list[tuple[Formula, tuple[int, ...], int, int]] = [(phi, (), -1, 1)]
    while stack:
        node, path, parent, polarity = stack.pop()
        index = len(found)
        found.append((node, path, parent, polarity))
        operands.append([])
        if parent >= 0:
            operands[parent].append(index)
        for i, child in reversed(list(enumerate(children(node)))):
            stack.append((child, (*path, i), index, polarity * _sign(node, i)))
    return tuple(
        Occurrence(node, path, parent, tuple(below), polarity)
        for (node, path, parent, polarity), below in zip(found, operands, strict=True)
    )


def _sign(phi: Formula, operand: int) -> int:
    if isinstance(phi, Iff | Rise):
        return 0
    return -1 if isinstance(phi, Not) or (isinstance(phi, Implies) and operand == 0) else 1


def polarities(phi: Formula) -> dict[Formula, int]:
    """The polarity of each of φ's `atoms`, in their order: 1 or −1 if all its occurrences have it, else 0."""
    found: dict[Formula, set[int]] = {atom: set() for atom in atoms(phi)}
    stack: list[tuple[Formula, int]] = [(phi, 1)]
    seen: set[tuple[int, int]] = set()  # shared operands are visited once for each sign
    while stack:
        node, sign = stack.pop()
        if (id(node), sign) in seen:
            continue
        seen.add((id(node), sign))
        if isinstance(node, Not) or is_temporal(node):
            stack += [(child, sign * _sign(node, i)) for i, child in enumerate(children(node))]
        elif not isinstance(node, Constant):
            found[node].add(sign)
    return {atom: next(iter(signs)) if len(signs) == 1 else 0 for atom, signs in found.items()}


def with_replaced(phi: Formula, path: Sequence[int], new: Formula) -> Formula:
    """φ with the occurrence at `path` replaced by `new`."""
    above = [phi]
    for i in path:
        above.append(children(above[-1])[i])
    result = new
    for node, i in zip(reversed(above[:-1]), reversed(path), strict=True):
        operands = children(node)
        result = with_children(node, (*operands[:i], result, *operands[i + 1 :]))
    return result
