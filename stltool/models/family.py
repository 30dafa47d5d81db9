"""Models whose probabilities depend on parameters, from members of the family at the ends of the domains.

Rows are linear in the parameters, and each depends on at most one: so the member with every parameter at its lower
end, and for each parameter the one with it at its upper end, determine the whole family.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import require
from stltool.errors import ModelError, SettingsError
from stltool.models.costs import united
from stltool.models.fractions import over_one
from stltool.models.mdp import MDP
from stltool.models.parameters import Affine, Parameter, Ties, Values, read_affine, read_parameters
from stltool.models.rows import starts, tied

_Row = dict[int, Fraction]
"""The probabilities of a choice, by successor."""


def from_members(build: Callable[..., MDP], parameters: Mapping[str, Any]) -> MDP:
    """As `MDP.from_family`."""
    if not callable(build):
        raise SettingsError("from_family's build is not callable; give a function of the parameters that makes an MDP")
    declared = _declared(parameters)
    try:
        inspect.signature(build).bind(**declared)
    except TypeError as error:
        raise SettingsError(f"from_family's build cannot be called with {', '.join(declared)}: {error}") from None
    except ValueError:  # it has no signature
        pass
    return _family(lambda values: build(**values), declared)


def from_expressions(transitions: Any, parameters: Mapping[str, Any], **rest: Any) -> MDP:
    """As `MDP.from_arrays` with `parameters`."""
    declared = _declared(parameters)
    try:
        matrices = [np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix) for matrix in transitions]
    except (TypeError, ValueError):
        raise ModelError("transitions must be an array (A, S, S) or a list of (S, S) matrices") from None
    known: dict[Any, Affine] = {}
    used: set[str] = set()

    def function(entry: Any, a: int, place: tuple[int, ...]) -> Affine:
        if entry not in known:
            try:
                known[entry] = read_affine(entry, declared)
            except ModelError as error:
                raise ModelError(f"transitions of action {a}, entry {list(place)}: {error}") from None
            used.update(known[entry].slopes)
        return known[entry]

    functions: list[NDArray[Any]] = []
    for a, matrix in enumerate(matrices):
        found = np.empty(matrix.shape, dtype=object)
        for place in np.ndindex(matrix.shape):
            found[place] = function(matrix.item(place), a, place)
        functions.append(found)
    for name in declared:
        if name not in used:
            raise ModelError(f"parameter {name} does not occur in the transitions; use it, or leave it out")

    def build(values: Values) -> MDP:
        at: list[ArrayLike] = [np.vectorize(lambda f: f.at(values), otypes=[object])(one) for one in functions]
        return MDP.from_arrays(at, **rest)

    return _family(build, declared)


def _declared(parameters: object) -> dict[str, Parameter]:
    declared = read_parameters(parameters)
    if not declared:
        raise ModelError("there are no parameters; declare some, such as {'p': (0.5, 1)}")
    return declared


def _family(build: Callable[[Values], MDP], declared: dict[str, Parameter]) -> MDP:
    lower = {name: one.lower for name, one in declared.items()}
    base = _member(build, lower)
    tops = [_member(build, {**lower, name: one.upper}) for name, one in declared.items()]
    middle = {name: (one.lower + one.upper) / 2 for name, one in declared.items()}
    centre = _member(build, middle)
    for other in (*tops, centre):
        _require_alike(base, other)
    rows, rows_of_tops, rows_of_centre = _rows(base), [_rows(top) for top in tops], _rows(centre)
    parameters = tuple(declared.values())
    lengths: list[int] = []
    target: list[int] = []
    first: list[Fraction] = []
    last: list[Fraction] = []
    parameter: list[int] = []
    for c, row in enumerate(rows):
        moved = [k for k, top in enumerate(rows_of_tops) if top[c] != row]
        if len(moved) > 1:
            names = " and ".join(parameters[k].name for k in moved)
            raise ModelError(f"{base.place(c)}: the row depends on {names}; a row may depend on one parameter")
        end = rows_of_tops[moved[0]][c] if moved else row
        successors = sorted({*row, *end})
        one = parameters[moved[0]] if moved else None
        x = one.share(middle[one.name]) if one is not None else Fraction(0)
        none = Fraction(0)
        for s in {*successors, *rows_of_centre[c]}:
            if (1 - x) * row.get(s, none) + x * end.get(s, none) != rows_of_centre[c].get(s, none):
                raise ModelError(
                    f"{base.place(c)}: the probability to state {base.state_name(s)} is not linear in "
                    f"{' and '.join(declared)}; probabilities must be, such as (1-p)/3"
                )
        lengths.append(len(successors))
        target += successors
        first += [row.get(s, none) for s in successors]
        last += [end.get(s, none) for s in successors]
        parameter += [moved[0] if moved else 0] * len(successors)
    shares, denominator = over_one([*first, *last])
    ties = Ties(
        parameters, shares[: len(first)], shares[len(first) :], denominator, np.array(parameter, dtype=np.int16)
    )
    row_start = starts(np.array(lengths, dtype=np.int64))
    source = tied(base.choice_start, base.choice_action, row_start, np.array(target, dtype=np.int32), ties)
    family = replace(base, source=source, costs=united([one.costs for one in (base, *tops, centre)]))
    values = {one.name: one.value for one in parameters if one.value is not None}
    if len(values) == len(parameters):
        return replace(family, source=source.at(values))
    if values:
        without = next(one.name for one in parameters if one.value is None)
        raise ModelError(
            f"parameter {without} has no value, and others have one; give every parameter a value, or none"
        )
    return family


def _member(build: Callable[[Values], MDP], values: Values) -> MDP:
    at = ", ".join(f"{name} = {value}" for name, value in values.items())
    try:
        member = build(values)
    except ModelError as error:
        raise ModelError(f"at {at}: {error}") from None
    require(member, MDP, f"the model at {at}")
    member.require_points()
    return member


def _require_alike(one: MDP, other: MDP) -> None:
    same = (
        one.n_states == other.n_states
        and np.array_equal(one.choice_start, other.choice_start)
        and np.array_equal(one.choice_action, other.choice_action)
        and one.action_names == other.action_names
        and np.array_equal(one.initial, other.initial)
        and all(
            mine.keys() == theirs.keys() and all(np.array_equal(mine[key], theirs[key]) for key in mine)
            for mine, theirs in ((one.signals, other.signals), (one.labels, other.labels))
        )
    )
    if not same:
        raise ModelError(
            "members of the family differ in more than their probabilities; states, choices, labels, signals and the "
            "start must not depend on parameters"
        )


def _rows(model: MDP) -> list[_Row]:
    rows = model.rows
    share = {n: Fraction(n, rows.denominator) for n in set(rows.numerator.tolist())}
    entries = list(zip(rows.target.tolist(), [share[n] for n in rows.numerator.tolist()], strict=True))
    return [dict(entries[a:b]) for a, b in zip(rows.row_start[:-1].tolist(), rows.row_start[1:].tolist(), strict=True)]
