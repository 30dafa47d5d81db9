"""Costs of a model: what a step costs, by name. PRISM and Storm call them reward structures.

A step from state s by choice c along entry k of its row costs

    states[s] + choices[c] + transitions[k]

where each part is one number for every state, choice or entry of the model's rows (models/rows.py), or absent (0). A
step is paid when its action is taken, so the last state of a run costs nothing. Numbers given in fractions or decimals
are kept exactly, as probabilities are; numbers may be negative.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import mapping
from stltool.display import Card, Displayed
from stltool.errors import ModelError, near_misses
from stltool.models.fractions import Integers, Shares, decimals_of, doubles_of, floats, over_one, parsed
from stltool.numbers import NumberError

if TYPE_CHECKING:
    from hashlib import _Hash

    from stltool.models.rows import Rows, Source

Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Amounts:
    """Numbers (n,) in doubles.

    given  the same as given in fractions or decimals; None: given in doubles, which mean their shortest decimals
    """

    values: Floats
    given: Shares | None = None

    def __post_init__(self) -> None:
        self.values.setflags(write=False)  # so that the model's digest stays valid

    def __len__(self) -> int:
        return len(self.values)

    @classmethod
    def of_shares(cls, numerator: Integers, denominator: int) -> Amounts:
        """Integers over one denominator."""
        return cls(doubles_of(numerator, denominator), Shares(numerator, denominator))

    @classmethod
    def read(cls, values: ArrayLike, what: str) -> Amounts:
        """An array of numbers, Fractions or strings such as "2/5", of any shape, one after another.

        Raises ModelError naming `what`.
        """
        doubles = floats(values, what).ravel()
        array = np.asarray(values)
        if array.dtype.kind not in "OU":
            return cls(doubles)
        try:
            return cls(doubles, Shares(*over_one(parsed(array).ravel().tolist())))
        except NumberError as error:  # pragma: no cover - `floats` has read them
            raise ModelError(f"{what} does not contain numbers: {error}") from None

    @cached_property
    def exact(self) -> Shares:
        if self.given is not None:
            return self.given
        return decimals_of(self.values)

    def at(self, index: NDArray[Any]) -> Amounts:
        """Those with these indices, or where a mask is true."""
        given = Shares(self.given.numerator[index], self.given.denominator) if self.given is not None else None
        return Amounts(self.values[index], given)


@dataclass(frozen=True, eq=False)
class Entries(Amounts):
    """Numbers for the entries of rows.

    row_start, target  the rows (models/rows.py)
    origin             those that these are a part of: rows that depend on parameters lose entries where one has a value
    """

    row_start: NDArray[np.int64] = field(kw_only=True)
    target: NDArray[np.int32] = field(kw_only=True)
    origin: Entries | None = field(default=None, kw_only=True)

    @cached_property
    def keys(self) -> NDArray[np.int64]:
        """(n,) choice and successor of each entry, as one number."""
        return _keys(self.row_start, self.target)

    def along(self, rows: Rows) -> Entries | None:
        """Those of the entries of other rows of the same choices; None if one of them has no number."""
        if np.array_equal(self.row_start, rows.row_start) and np.array_equal(self.target, rows.target):
            return self
        whole = self.origin if self.origin is not None else self
        order = np.argsort(whole.keys, kind="stable")
        wanted = _keys(rows.row_start, rows.target)
        place = np.searchsorted(whole.keys, wanted, sorter=order)
        if (place == len(order)).any() or not np.array_equal(whole.keys[order[place]], wanted):
            return None
        found = whole.at(order[place])
        return Entries(found.values, found.given, row_start=rows.row_start, target=rows.target, origin=whole)


def _keys(row_start: NDArray[np.int64], target: NDArray[np.int32]) -> NDArray[np.int64]:
    choice = np.repeat(np.arange(len(row_start) - 1, dtype=np.int64), np.diff(row_start))
    return (choice << 32) + target


@dataclass(frozen=True, eq=False, repr=False)
class Cost(Displayed):
    """What a step costs (see the module's text); the parts that are None cost nothing.

    states       (n_states,) for each step that begins in a state
    choices      (n_choices,) for each step by a choice
    transitions  (n_transitions,) for each step along an entry of the rows
    """

    states: Amounts | None = None
    choices: Amounts | None = None
    transitions: Entries | None = None

    @property
    def parts(self) -> dict[str, Amounts]:
        """The parts that are given, by name."""
        return {one.name: part for one in fields(self) if (part := getattr(self, one.name)) is not None}

    @property
    def of_states_only(self) -> bool:
        """Whether a step costs the same whatever is done in its state."""
        return self.choices is None and self.transitions is None

    def _card(self) -> Card:
        shown = {
            name: f"{np.count_nonzero(part.values)} of {len(part)} nonzero, "
            f"in [{part.values.min():g}, {part.values.max():g}]"
            for name, part in self.parts.items()
            if len(part)
        }
        return Card("Cost" if shown else "Cost: nothing", [dict(shown)] if shown else [])

    @cached_property
    def range(self) -> tuple[float, float]:
        """Between which numbers the cost of a step lies."""
        parts = [part.values for part in self.parts.values() if len(part)]
        return float(sum(part.min() for part in parts)), float(sum(part.max() for part in parts))

    def digest_into(self, sha: _Hash, name: str) -> None:
        for part, amounts in self.parts.items():
            sha.update(f"cost {name} {part} {amounts.values.shape}".encode())
            sha.update(np.ascontiguousarray(amounts.values).data)


def fitted(costs: object, source: Source) -> dict[str, Cost]:
    """The costs, by name, with numbers for the entries of the source's rows.

    ModelError, naming the cost, unless they have one finite number for each state, choice or entry.
    """
    found = {}
    for name, cost in mapping(costs, "the model's costs", "{'energy': [0.0, 0.5]}").items():
        if not isinstance(cost, Cost):
            raise ModelError(f"cost {name} is not a Cost; make models by stl.MDP.from_arrays(..., costs=...)")
        for part, length in (("states", source.n_states), ("choices", source.n_choices)):
            amounts = cost.parts.get(part)
            if amounts is not None and amounts.values.shape != (length,):
                shape = amounts.values.shape
                raise ModelError(f"cost {name}: {part} have shape {shape}; give one number for each of {length}")
        if cost.transitions is not None:
            if source.on_demand:
                raise ModelError(
                    f"cost {name} has numbers for transitions, but the model's rows are computed when they are needed; "
                    "give numbers for states or choices"
                )
            entries = cost.transitions.along(source.whole())
            if entries is None:
                raise ModelError(f"cost {name} has no number for some of the transitions; leave out this cost")
            cost = replace(cost, transitions=entries)
        for part, amounts in cost.parts.items():
            bad = np.flatnonzero(~np.isfinite(amounts.values))
            if bad.size:
                number = amounts.values[bad[0]]
                raise ModelError(f"cost {name} of {part[:-1]} {bad[0]} is {number}; it must be finite")
        found[name] = cost
    return found


def read_costs(
    given: object,
    n_states: int,
    n_actions: int,
    available: NDArray[np.bool_],
    rows: tuple[NDArray[Any], NDArray[Any]] | None,
) -> dict[str, Cost]:
    """The argument `costs` of a constructor of models: name → array, or `Cost` (see `MDP.from_arrays`).

    available  (S·A,) whether a state has an action, the actions of each state together
    rows       row_start and target of the choices, for numbers by transition; None: there are no rows in memory
    """
    known = mapping(given, "the model's costs", "{'energy': [0.0, 0.5]}", optional=True)
    return {name: _read(value, name, n_states, n_actions, available, rows) for name, value in known.items()}


def _read(
    value: Any,
    name: str,
    n_states: int,
    n_actions: int,
    available: NDArray[np.bool_],
    rows: tuple[NDArray[Any], NDArray[Any]] | None,
) -> Cost:
    if isinstance(value, Cost):
        return value
    what = f"cost {name}"
    known = {"states": (n_states,), "choices": (n_states, n_actions)}
    if rows is not None:
        known["transitions"] = (n_actions, n_states, n_states)
    parts: dict[str, Any] = {}
    given = value if isinstance(value, Mapping) else {None: value}
    for key, numbers in given.items():
        if isinstance(numbers, Sequence) and numbers and all(hasattr(one, "toarray") for one in numbers):
            numbers = np.array([one.toarray() for one in numbers])
        try:
            shape = np.shape(numbers)
        except ValueError:
            raise ModelError(f"{what} does not contain numbers") from None
        part = next((part for part, its in known.items() if shape == its and key in (None, part)), None)
        if part is None:
            fitting = ", or ".join(f"{its} ({part})" for part, its in known.items() if key in (None, part))
            if not fitting:
                raise ModelError(f"{what}: {near_misses(str(key), list(known))}")
            raise ModelError(f"{what}{f': {key}' if key else ''} has shape {shape}; give {fitting}")
        if part == "states":
            parts[part] = Amounts.read(numbers, what)
        elif part == "choices":
            parts[part] = Amounts.read(numbers, what).at(available)
        else:
            assert rows is not None
            row_start, target = rows
            s, a = np.divmod(np.repeat(np.flatnonzero(available), np.diff(row_start)), n_actions)
            found = Amounts.read(np.asarray(numbers)[a, s, target], what)
            parts[part] = Entries(found.values, found.given, row_start=row_start, target=target)
    return Cost(**parts)


def united(members: Sequence[Mapping[str, Cost]]) -> dict[str, Cost]:
    """The costs of models of the same choices, with the entries of all of them. ModelError if they differ."""
    first, *others = members
    found = {}
    for name, cost in first.items():
        entries: dict[int, Fraction] = {}
        for costs in members:
            other = costs.get(name, Cost())
            same = cost.parts.keys() == other.parts.keys() and all(
                np.array_equal(part.values, getattr(other, key).values)
                for key, part in cost.parts.items()
                if key != "transitions"
            )
            if other.transitions is not None:
                exact = other.transitions.exact
                for k, key in enumerate(other.transitions.keys.tolist()):
                    same &= entries.setdefault(key, exact[k]) == exact[k]
            if not same:
                raise ModelError(f"cost {name} depends on parameters; only probabilities may")
        if cost.transitions is not None:
            keys = np.array(sorted(entries), dtype=np.int64)
            numbers = Amounts.of_shares(*over_one(entries[key] for key in keys.tolist()))
            row_start = np.searchsorted(keys >> 32, np.arange(len(cost.transitions.row_start)))
            target = (keys & 0xFFFFFFFF).astype(np.int32)
            cost = replace(cost, transitions=Entries(numbers.values, numbers.given, row_start=row_start, target=target))
        found[name] = cost
    if any(costs.keys() != first.keys() for costs in others):
        raise ModelError("the members of the family have different costs; only probabilities may depend on parameters")
    return found
