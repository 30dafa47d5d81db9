"""Boolean formulas over arrays: the truth of ψ at every state of a model, exactly as the slow semantics has it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import (
    Comparison,
    Formula,
    Label,
    Negate,
    Number,
    Term,
    Variable,
    children,
    is_temporal,
    label_names,
    variables,
    walk,
    with_children,
)
from stltool.logic.semantics import satisfies

Reals: TypeAlias = NDArray[np.float64]
Booleans: TypeAlias = NDArray[np.bool_]

_COMPARE = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip


def truth(psi: Formula, signals: Mapping[str, Reals], labels: Mapping[str, Booleans], n: int) -> Booleans:
    """The truth of a formula without temporal operators at each of n states, (n,) bool.

    `signals` and `labels` hold arrays (n,) for every name in ψ. Each distinct combination of the names' values is
    judged once by the slow semantics, exact arithmetic included; a comparison without arithmetic is decided by doubles,
    which order as the decimals they print as. Raises TraceError where a term has no value.
    """
    if is_temporal(psi):
        raise ValueError(f"{psi} is temporal; it has no truth at a single state")
    columns: dict[str, NDArray[np.float64]] = {}
    for node in walk(psi):
        if isinstance(node, Comparison) and _plain(node.left) and _plain(node.right):
            compared = _COMPARE[node.op](_plain_value(node.left, signals), _plain_value(node.right, signals))
            columns[str(node)] = np.broadcast_to(compared, (n,)).astype(np.float64)
    if isinstance(psi, Comparison) and columns:
        decided: Booleans = columns[str(psi)] != 0
        return decided
    if isinstance(psi, Label):
        return labels[psi.name]
    plain = _without_plain(psi, columns)
    for name in variables(plain):
        columns[name] = signals[name]
    for name in label_names(plain):
        if name not in columns:
            columns[name] = labels[name].astype(np.float64)
    used = list(columns)
    table = np.stack([columns[name] for name in used], axis=1) if used else np.zeros((n, 0))
    rows, which = np.unique(table, axis=0, return_inverse=True)
    judged = np.array(
        [satisfies(plain, {name: [value] for name, value in zip(used, row, strict=True)}) for row in rows]
    )
    result: Booleans = judged[which.ravel()]
    return result


def _plain(term: Term) -> bool:
    """A signal or a number, with no arithmetic to round."""
    return isinstance(term, Variable | Number) or (isinstance(term, Negate) and _plain(term.arg))


def _plain_value(term: Term, signals: Mapping[str, Reals]) -> Reals | float:
    if isinstance(term, Variable):
        return signals[term.name]
    if isinstance(term, Negate):
        return -_plain_value(term.arg, signals)
    assert isinstance(term, Number)
    return term.value


def _without_plain(phi: Formula, columns: Mapping[str, object]) -> Formula:
    """Plain comparisons as labels of their own text, already decided."""
    if isinstance(phi, Comparison):
        return Label(str(phi)) if str(phi) in columns else phi
    return with_children(phi, tuple(_without_plain(child, columns) for child in children(phi)))
