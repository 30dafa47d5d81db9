"""Boolean formulas over arrays: the truth of ψ at every state of a model, exactly as in the slow semantics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import FragmentError, NameLookupError, TraceError
from stltool.logic.formula import Formula, formula_of, is_temporal, label_names, variables
from stltool.logic.names import near_names
from stltool.logic.parser import parse
from stltool.logic.semantics import robustness, satisfies
from stltool.monitoring.blocks import Block, Machine
from stltool.monitoring.program import compile_formula

Reals: TypeAlias = NDArray[np.float64]
Booleans: TypeAlias = NDArray[np.bool_]
Definition: TypeAlias = str | Formula
"""A formula, or its text."""


def truth(psi: Formula, signals: Mapping[str, Reals], labels: Mapping[str, Booleans], n: int) -> Booleans:
    """The truth of a formula without temporal operators at each of n states, (n,) bool.

    `signals` and `labels` contain arrays (n,) for every name in ψ. A state is judged like a trace of one step. Raises
    TraceError if the truth at a state depends on a term without a value.
    """
    if is_temporal(psi):
        raise ValueError(f"{psi} is temporal; it has no truth at a single state")
    program = compile_formula(psi)
    columns: dict[str, NDArray[Any]] = {name: labels[name].reshape(n, 1) for name in program.labels}
    columns |= {name: signals[name].reshape(n, 1) for name in program.variables}
    [found] = Machine(program, margins=False).run(Block(columns, n, 1))
    holds: Booleans = found[:, 0]
    if holds.dtype == np.bool_:
        return holds
    for s in np.flatnonzero(holds == 0)[:1].tolist():
        try:
            satisfies(psi, {name: column[s] for name, column in columns.items()})
        except TraceError as error:
            raise TraceError(f"state {s}: {error}") from None
    return holds > 0


def margins(psi: Formula, signals: Mapping[str, Reals], labels: Mapping[str, Booleans], n: int) -> Reals:
    """The robustness of a formula without temporal operators at each of n states, (n,); arguments as of `truth`.

    Exact, then rounded to double: by the slow semantics, once for each combination of values. Raises TraceError if it
    does not exist at a state.
    """
    columns = {name: labels[name] for name in label_names(psi)} | {name: signals[name] for name in variables(psi)}
    table = np.array([np.broadcast_to(column, n) for column in columns.values()], dtype=np.float64).reshape(-1, n)
    _, first, which = np.unique(table, axis=1, return_index=True, return_inverse=True)
    found = np.empty(len(first))
    for number, s in enumerate(first.tolist()):
        try:
            found[number] = robustness(psi, {name: column[s : s + 1] for name, column in columns.items()})
        except TraceError as error:
            raise TraceError(f"state {s}: {error}") from None
    values: Reals = found[which.ravel()]
    return values


def label_of(
    name: str, formula: object, signals: Mapping[str, Reals], labels: Mapping[str, Booleans], n: int
) -> Booleans:
    """Where a label that a formula, or its text, defines holds among n states, (n,) bool.

    Raises StlSyntaxError with the position in the text, NameLookupError for names that are not among `signals` and
    `labels`, FragmentError if the formula is temporal, TraceError as `truth`.
    """
    psi = parse(formula, name=name) if isinstance(formula, str) else formula_of(formula, f"label {name}")
    for wanted, known, other, kind, remedy in (
        (label_names(psi), labels, signals, "label", "compare it with a number"),
        (variables(psi), signals, labels, "signal", "use it without comparing"),
    ):
        for own, span in wanted.items():
            if own not in known:
                hint = f"it is a {'signal' if kind == 'label' else 'label'}; {remedy}"
                message = f"there is no {kind} {own}; {hint if own in other else near_names(own, [*known, *other])}"
                raise NameLookupError(span.show(message) if span is not None else f"label {name}: {message}")
    if is_temporal(psi):
        raise FragmentError(
            f"label {name}: {psi} is about several steps; a label is a formula without temporal operators, over one "
            "state"
        )
    try:
        return truth(psi, signals, labels, n)
    except TraceError as error:
        raise TraceError(f"label {name}: {error}") from None
